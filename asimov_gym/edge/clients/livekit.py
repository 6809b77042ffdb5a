"""A client's lane through a LiveKit room: the same names and topics as the robot's, from the other end."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from asimov_gym.edge.clients.link import LinkReceiver
from asimov_gym.edge.clients.livekit_session import COMMANDS_WAITING, ROBOT_TIMEOUT_S, RoomSession
from asimov_gym.edge.control import Dialect
from asimov_gym.edge.loop_thread import LoopThread
from asimov_gym.edge.transports.livekit_join import LEAVE_TIMEOUT_S, JoinError, RoomAddress, hide_token, load_rtc

CLOSE_TIMEOUT_S = 10.0
"""For the last commands to go out and the room to be left."""

_log = logging.getLogger(__name__)


class LiveKitLink:
    """A client's end of a LiveKit room.

    The robot is the participant that publishes a robot's data track (or, in dialect `cloud`, sends packets of topic
    `state`): the first one seen, until it leaves. Anyone whose token lets them publish can pose as a robot: give
    `robot` where others share the room.

    Short losses of the connection are mended by the client library; meanwhile nothing is sent, so that no command acts
    long after it was given. When the library gives up, the link is lost.

    Args:
        url: of the server, `ws://` or `wss://`.
        token: opens the room; its `sub` is this client's identity.
        dialect: to be spoken; None for what the robot publishes, `cloud` where it publishes both.
        robot: identity of the robot; None for the first one seen.
        timeout: s, for a robot to be seen after joining.

    Raises:
        ValueError: the URL or the token cannot be right.
    """

    velocity_expires = False

    def __init__(
        self,
        url: str,
        token: str,
        dialect: Dialect | None = None,
        robot: str | None = None,
        timeout: float = ROBOT_TIMEOUT_S,
    ) -> None:
        self._address = RoomAddress(url, token)
        self._dialect = dialect
        self.address = url
        self.facts: Mapping[str, Any] | None = None
        self.silence_hint = "The robot is in the room but reports nothing: does it run, or is it in lockstep?"
        self._wanted = robot
        self._timeout = timeout
        self._thread: LoopThread | None = None
        self._session: RoomSession | None = None
        self._opened = threading.Event()
        self._failure: str | None = None
        self._lost: str | None = None

    @property
    def dialect(self) -> Dialect:
        """What is spoken; when it was left open, known once a robot was seen."""
        dialect = self._dialect if self._session is None else self._session.dialect
        return dialect or Dialect.CLOUD

    @property
    def carries_events(self) -> bool:
        """Events belong to dialect `cloud`."""
        return self.dialect is Dialect.CLOUD

    def open(self, receiver: LinkReceiver) -> None:
        """Join the room, find the robot, ask for its facts.

        Raises:
            ImportError: the client library is not installed.
        """
        rtc = load_rtc()
        self._thread = LoopThread("livekit-link", lambda: self._serve(rtc, receiver))
        self._thread.start()
        try:
            self._opened.wait()
        except BaseException:  # Ctrl-C
            self.close()
            raise
        if self._failure is not None:
            self.close()
            raise ConnectionError(self._failure)

    def send(self, packet: bytes, streamed: bool = False) -> None:
        """Queue one command for the room's thread."""
        session = self._session
        if session is None or self._lost is not None:
            raise ConnectionError(self._lost or f"the link to {self.address} is not open")
        if not session.permitted:
            raise ConnectionError("this client's token lets it watch, not command: it has no canPublishData")
        if not session.linked:
            raise ConnectionError(f"the connection to the room at {self.address} is interrupted; it is being mended")
        if not session.queue(packet, streamed):
            raise ConnectionError(f"the room at {self.address} takes no commands: {COMMANDS_WAITING} are waiting")

    def close(self) -> None:
        """Send what is queued, and leave."""
        thread, session = self._thread, self._session
        if thread is None:
            return
        self._lost = self._lost or f"the link to {self.address} is closed"
        if session is not None and self._opened.is_set():
            session.finish()
        else:
            thread.cancel()
        if not thread.join(CLOSE_TIMEOUT_S):
            _log.warning("the last commands did not go out in time")
            thread.cancel()
            thread.join(LEAVE_TIMEOUT_S + 1.0)
        self._thread = None

    # -- in the thread -------------------------------------------------------------------------------------

    async def _serve(self, rtc: ModuleType, receiver: LinkReceiver) -> None:
        session = self._session = RoomSession(rtc, self._address, self._dialect, self._wanted, receiver)
        try:
            self.facts = await session.enter(self._timeout)
            self._opened.set()
            lost = await session.stay()
        except (JoinError, ConnectionError) as problem:
            self._failure = str(problem)
            return
        except Exception as problem:
            self._failure = hide_token(f"the room at {self.address}: {problem!r}", self._address.token)
            return
        finally:
            if not self._opened.is_set() and self._failure is None:
                self._failure = f"the room at {self.address} was left before it was entered"
            await session.exit()
            self._opened.set()
        if lost is not None and self._lost is None:
            self._lost = f"the room at {self.address} is lost: {lost}"
            receiver.on_lost(self._lost)
