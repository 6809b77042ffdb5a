"""What a robot says of itself before anything else: `GET /api/version` on the UDP lane, `edge.getSystemInfo` in a room.

Clients accept model `asimov_1` and the version line 0.2 only, so a simulator shows itself by a key of its own.
"""

from __future__ import annotations

from asimov_gym import __version__

ROBOT_MODEL = "asimov_1"
ROBOT_OS_VERSION = "0.2.0"
"""Version line of the robot's software whose behaviour is simulated."""
SIMULATOR_KEY = "simulator"
"""Only a simulated robot has it."""


def facts() -> dict[str, str]:
    """The robot's facts, as they go into JSON."""
    return {
        "robot_model": ROBOT_MODEL,
        "robot_os_version": ROBOT_OS_VERSION,
        SIMULATOR_KEY: f"asimov-gym {__version__}",
    }


def is_simulated(reply: dict[str, object]) -> bool:
    """Whether a robot's facts carry the simulator's mark."""
    return bool(reply.get(SIMULATOR_KEY))
