"""The vendor's message modules. Importing this needs the optional package `bosdyn-api`.

The modules build their classes as they are imported and bring no types, so everything out of them is `Any` here; where
a signature says `Any`, its docstring names the message.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

basic_command_pb2: Any = import_module("bosdyn.api.basic_command_pb2")
header_pb2: Any = import_module("bosdyn.api.header_pb2")
lease_pb2: Any = import_module("bosdyn.api.lease_pb2")
robot_command_pb2: Any = import_module("bosdyn.api.robot_command_pb2")
robot_state_pb2: Any = import_module("bosdyn.api.robot_state_pb2")
time_sync_pb2: Any = import_module("bosdyn.api.time_sync_pb2")
