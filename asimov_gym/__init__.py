"""Train, judge and rehearse the walking of the Asimov 1 humanoid.

Importing this package registers the Gymnasium environments `Asimov-Walk-v0`, `Asimov-Trajectory-v0` and
`Asimov-Velocity-v0`; nothing of the simulator is loaded before one is made.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from gymnasium.envs.registration import register, registry

try:
    __version__ = version("asimov-gym")
except PackageNotFoundError:  # a source tree on the path, never installed
    __version__ = "0+source"

ENVIRONMENT_IDS = ("Asimov-Walk-v0", "Asimov-Trajectory-v0", "Asimov-Velocity-v0")
"""Ids that this package registers."""


def _register() -> None:
    for env_id in ENVIRONMENT_IDS:
        if env_id in registry:
            continue
        name = env_id.split("-")[1]
        module = f"asimov_gym.envs.{name.lower()}"
        register(env_id, entry_point=f"{module}:{name}Env", vector_entry_point=f"{module}:vector_env")


_register()
