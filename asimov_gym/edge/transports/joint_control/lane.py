"""The lane: a gRPC server on an event loop in a thread of its own."""

from __future__ import annotations

import asyncio
import logging
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING

from asimov_gym.edge.edge import Edge
from asimov_gym.edge.joint_control import JointControlPort
from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.udp import check_port, is_loopback

if TYPE_CHECKING:
    import grpc.aio

LICENCE_LINE = (
    "messages of bosdyn-api, Boston Dynamics SDK licence: for this simulator and that maker's robots, no other hardware"
)
"""What must be said when the lane starts."""
_GRACE_S = 0.2
_log = logging.getLogger(__name__)


class JointControlLane(Lifecycle):
    """Serves one simulated robot's joint control between `start` and `stop`, or as a context manager.

    Nothing is encrypted or authenticated, and leases are not asked for: whoever reaches the port can drive the robot.

    Args:
        edge: of the robot.
        port: TCP port; 0 for any free one, known after `start`.
        listen: address that it is opened on.

    Raises:
        TransportError: the port is out of range.
    """

    def __init__(self, edge: Edge, port: int, listen: str = "127.0.0.1") -> None:
        check_port("--joint-control", port)
        self.port = port
        self.listen = listen
        self.joint_control = JointControlPort(edge)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: grpc.aio.Server | None = None
        self._thread: threading.Thread | None = None

    @property
    def connect_line(self) -> str:
        """What a client needs to know, for people."""
        host = f"[{self.listen}]" if ":" in self.listen else self.listen
        return f"grpc://{host}:{self.port} (insecure channel)"

    def start(self) -> None:
        """Open the port and serve, in a thread. No effect while it runs.

        Raises:
            TransportError: the message package is not installed, or the port cannot be opened.
        """
        if self._thread is not None:
            return
        try:
            from asimov_gym.edge.transports.joint_control.services import Services
        except ImportError as problem:
            raise TransportError(
                f"joint control needs the message package ({problem}): pip install 'asimov-gym[joint-control]'"
            ) from None
        opened: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(Services, opened), name="joint-control", daemon=True)
        self._thread.start()
        try:
            opened.result()
        except BaseException:
            self._thread.join()
            self._thread = None
            raise
        self.joint_control.attach()
        if not is_loopback(self.listen):
            _log.warning(
                "joint control is served on %s:%d, which is not loopback: nothing on it is authenticated, anyone who "
                "reaches this port can drive the robot",
                self.listen,
                self.port,
            )

    def _run(self, services: type, opened: Future[None]) -> None:
        loop = self._loop = asyncio.new_event_loop()
        try:
            loop.run_until_complete(self._open(services, opened))
            if opened.exception() is None:
                loop.run_forever()
        finally:
            loop.run_until_complete(loop.shutdown_asyncgens())
            loop.close()

    async def _open(self, services: type, opened: Future[None]) -> None:
        import grpc.aio

        from asimov_gym.edge.transports.joint_control.services import MAX_MESSAGE_BYTES

        loop = asyncio.get_running_loop()
        options = [("grpc.so_reuseport", 0), ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES)]
        self._server = grpc.aio.server(options=options)
        self._server.add_generic_rpc_handlers(services(self.joint_control, loop).handlers())
        host = f"[{self.listen}]" if ":" in self.listen else self.listen
        try:
            bound = self._server.add_insecure_port(f"{host}:{self.port}")
            if bound == 0:
                raise RuntimeError("the address cannot be used")
            self.port = bound
            await self._server.start()
        except RuntimeError:
            await self._server.stop(None)
            opened.set_exception(
                TransportError(
                    f"cannot serve joint control on port {self.port} of {self.listen}: in use, or not ours to open; "
                    "choose another with --joint-control"
                )
            )
            return
        opened.set_result(None)

    def stop(self) -> None:
        """Stop serving: a run ends in DAMP and the streams are cut. No effect if it does not run."""
        if self._thread is None:
            return
        assert self._loop is not None and self._server is not None
        self.joint_control.detach()
        asyncio.run_coroutine_threadsafe(self._server.stop(_GRACE_S), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._thread = self._server = self._loop = None
