"""The edge: commands checked, telemetry and events out, and the simulated robot with its in-process session."""

from asimov_gym.edge.async_session import AsyncSession, aconnect
from asimov_gym.edge.control import Client, Control, Dialect, Handover, Source
from asimov_gym.edge.edge import Edge
from asimov_gym.edge.events import Code
from asimov_gym.edge.listener import EdgeListener
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.edge.session import Session, connect, wait_until
from asimov_gym.edge.verdict import DropReason, Note, Tally, Verdict

__all__ = [
    "AsyncSession",
    "Client",
    "Code",
    "Control",
    "Dialect",
    "DropReason",
    "Edge",
    "EdgeListener",
    "Handover",
    "Note",
    "Session",
    "SimulatedRobot",
    "Source",
    "Tally",
    "Verdict",
    "aconnect",
    "connect",
    "wait_until",
]
