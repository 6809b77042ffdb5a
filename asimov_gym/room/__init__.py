"""A small development room on loopback that the public LiveKit client library joins, for people without a server.

    with RoomThread() as room:
        print(room.url, room.token(None, "robot", can_update_own_metadata=True))

Development only: it listens on loopback addresses alone, and says what it leaves out (`RoomServer.statement`).
"""

from importlib.util import find_spec

_NEEDED = {"aiohttp": "aiohttp", "aiortc": "aiortc", "jwt": "PyJWT", "livekit.protocol": "livekit-protocol"}


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


if _missing := [name for module, name in _NEEDED.items() if not _installed(module)]:
    raise ImportError(f"the room needs {', '.join(_missing)}: pip install 'asimov-gym[room]'")

from asimov_gym.room.errors import RoomError, TokenError  # noqa: E402
from asimov_gym.room.limits import RoomLimits  # noqa: E402
from asimov_gym.room.server import RoomServer  # noqa: E402
from asimov_gym.room.thread import RoomThread  # noqa: E402
from asimov_gym.room.tokens import ROLES, Grants, RoomKeys  # noqa: E402

__all__ = ["ROLES", "Grants", "RoomError", "RoomKeys", "RoomLimits", "RoomServer", "RoomThread", "TokenError"]
