"""The ROS 2 lane: the motion-mode services and the velocity topic in a DDS domain, without a ROS 2 installation.

Names, types, layouts and settings are those of a ROS 2 node on `rmw_cyclonedds_cpp`. Nodes on another middleware can
send velocities, but get no answer from the services: each middleware pairs replies with requests in a way of its own.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from asimov_gym.edge.lifecycle import Lifecycle
from asimov_gym.edge.motion_modes_messages import SERVICES, TOPICS, Service
from asimov_gym.edge.motion_modes_service import MotionModes
from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.udp import is_loopback

try:
    from cyclonedds.core import DDSException, GuardCondition, ReadCondition, WaitSet
    from cyclonedds.core import InstanceState as Instance
    from cyclonedds.core import SampleState as Sample
    from cyclonedds.core import ViewState as View
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from asimov_gym.edge.transports.ros2_domain import (
        MAX_DOMAIN_ID,
        confine,
        environment_domain_id,
        open_domain,
    )
    from asimov_gym.edge.transports.ros2_types import dds_type, from_dds, paired_dds_type, to_dds
except ImportError as missing:
    raise ImportError("serving ROS 2 needs Cyclone DDS: pip install 'asimov-gym[ros2]'") from missing

REPLY_PATIENCE_S = 0.1
"""A reply is held this long until its client's reader is known here."""
DEPTH = 10
"""Requests or replies kept: what ROS 2 sets for services."""

_POLL_S = 0.005
_IDLE_S = 0.5
_MILLISECOND = 1_000_000
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Reply:
    """A reply that waits for its client."""

    sample: Any
    writer: DataWriter
    reader: DataReader
    client: int
    """Handle of the client's writer, whose request it answers."""
    deadline: float


class Ros2Lane(Lifecycle):
    """Serves motion modes in a DDS domain between `start` and `stop`, or as a context manager.

    Args:
        modes: the service.
        domain_id: from 0 to 232; None for the environment's `ROS_DOMAIN_ID`.
        listen: address that it is served on. On a loopback address nothing leaves or enters the machine.

    Raises:
        TransportError: the domain's number is out of range.
    """

    def __init__(self, modes: MotionModes, domain_id: int | None = None, listen: str = "127.0.0.1") -> None:
        self.domain_id = environment_domain_id() if domain_id is None else domain_id
        if not 0 <= self.domain_id <= MAX_DOMAIN_ID:
            raise TransportError(f"domain_id must be from 0 to {MAX_DOMAIN_ID}, got {self.domain_id}")
        self.listen = listen
        self.confined = False
        """Whether nothing from outside this machine can reach the lane; known after `start`."""
        self._modes = modes
        self._endpoints: _Endpoints | None = None
        self._thread: threading.Thread | None = None

    @property
    def connect_line(self) -> str:
        """Where it is served, and the one thing to know before trying it, for people."""
        local = " and ROS_LOCALHOST_ONLY=1" if is_loopback(self.listen) else ""
        return (
            f"domain {self.domain_id} on {self.listen}, for nodes with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp{local}; "
            "nodes on another middleware can publish velocities but get no answer from the services"
        )

    def start(self) -> None:
        """Join the domain and serve, in a thread. No effect while it runs.

        Raises:
            TransportError: the domain cannot be opened.
        """
        if self._thread is not None:
            return
        self._endpoints = _Endpoints(self._modes, self.domain_id, self.listen)
        self.confined = self._endpoints.confined
        self._thread = threading.Thread(target=self._endpoints.serve, name="ros2-lane", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Leave the domain. No effect if it is not joined."""
        if self._thread is None or self._endpoints is None:
            return
        self._endpoints.end()
        self._thread.join()
        self._thread = self._endpoints = None


class _Endpoints:
    """What is open in the domain. Cyclone closes each part with its last reference, so the domain must go last."""

    def __init__(self, modes: MotionModes, domain_id: int, listen: str) -> None:
        self._modes = modes
        self._domain = open_domain(domain_id, listen)
        self._ended = False
        self._held: list[_Reply] = []
        try:
            self._participant = DomainParticipant(domain_id)
            self.confined = confine(domain_id, listen)
            self._wake = GuardCondition(self._participant)
            self._waiting = WaitSet(self._participant)
            self._waiting.attach(self._wake)
            self._takers: list[tuple[DataReader, Callable[[Any], None]]] = []
            for name, service in SERVICES.items():
                self._add_service(name, service)
            for name, message in TOPICS.items():
                self._add_topic(name, message)
        except DDSException as problem:
            raise TransportError(f"cannot serve in ROS 2 domain {domain_id}: {problem}") from None

    def _add_service(self, name: str, service: Service) -> None:
        identity = "".join(f".{byte:x}" for byte in self._participant.guid.bytes[:12])
        user_data = f"serviceid={identity[1:]}.0.0.0.{len(self._takers):x};".encode()
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=100 * _MILLISECOND),
            Policy.Durability.Volatile,
            Policy.History.KeepLast(DEPTH),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(user_data),
        )
        request_type, response_type = paired_dds_type(service.request), paired_dds_type(service.response)
        requests = Topic(self._participant, f"rq{name}Request", request_type)
        replies = Topic(self._participant, f"rr{name}Reply", response_type)
        writer = DataWriter(self._participant, replies, qos)
        reader = DataReader(self._participant, requests, qos)

        def answer(sample: Any) -> None:
            response = self._modes.call(name, from_dds(service.request, sample))
            pairing = {"client_id": sample.client_id, "sequence_number": sample.sequence_number}
            reply = to_dds(response, response_type, **pairing)
            deadline = time.monotonic() + REPLY_PATIENCE_S
            self._held.append(_Reply(reply, writer, reader, sample.sample_info.publication_handle, deadline))

        self._take_from(reader, answer)

    def _add_topic(self, name: str, message: type) -> None:
        # Best effort: it takes what reliable writers send as well as what others do.
        qos = Qos(
            Policy.Reliability.BestEffort,
            Policy.Durability.Volatile,
            Policy.History.KeepLast(DEPTH),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        topic = Topic(self._participant, f"rt{name}", dds_type(message))
        reader = DataReader(self._participant, topic, qos)
        self._take_from(reader, lambda sample: self._modes.publish(name, from_dds(message, sample)))

    def _take_from(self, reader: DataReader, take: Callable[[Any], None]) -> None:
        self._takers.append((reader, take))
        self._waiting.attach(ReadCondition(reader, Sample.Any | View.Any | Instance.Any))

    # -- the lane's thread -------------------------------------------------------------------------

    def end(self) -> None:
        """Have `serve` close everything and return."""
        self._ended = True
        self._wake.set(True)

    def serve(self) -> None:
        """Take what comes in, until `end`."""
        while not self._ended:
            try:
                self._waiting.wait(round((_POLL_S if self._held else _IDLE_S) * 1000) * _MILLISECOND)
            except DDSException as problem:
                _log.warning("ROS 2: %s", problem)
                time.sleep(_POLL_S)
            for reader, take in self._takers:
                self._take_all(reader, take)
            self._held = [reply for reply in self._held if not self._sent(reply)]
        self._close()

    def _close(self) -> None:
        """Let go of everything, the parts before the whole."""
        self._held.clear()
        self._takers.clear()
        del self._waiting, self._wake, self._participant, self._domain

    def _take_all(self, reader: DataReader, take: Callable[[Any], None]) -> None:
        while True:
            try:
                samples = reader.take(1)
                if not samples:
                    return
                if samples[0].sample_info.valid_data:
                    take(samples[0])
            except Exception:  # bytes that are no such message, or a defect of ours: the others get their answers
                _log.exception("ROS 2: a message on %s was not taken", reader.topic.name)

    def _sent(self, reply: _Reply) -> bool:
        """Send a reply if its client can get it; whether there is nothing more to do for it."""
        try:
            asker = reply.reader.get_matched_publication_data(reply.client)
            if asker is None:
                return True  # gone
            client = _client_id(asker)
            if client is not None and not _has_reader(reply.writer, client):
                late = time.monotonic() >= reply.deadline
                if late:
                    _log.warning("ROS 2: no reader of the client for a reply on %s", reply.writer.topic.name)
                return late
            reply.writer.write(reply.sample)
        except Exception:
            _log.exception("ROS 2: a reply on %s was not sent", reply.writer.topic.name)
        return True


def _has_reader(writer: DataWriter, client: bytes) -> bool:
    for handle in writer.get_matched_subscriptions():
        endpoint = writer.get_matched_subscription_data(handle)
        if endpoint is not None and _client_id(endpoint) == client:
            return True
    return False


def _client_id(endpoint: Any) -> bytes | None:
    """What an endpoint's user data says of its client; None where it says nothing."""
    user_data: Any = endpoint.qos[Policy.Userdata]
    for entry in [] if user_data is None else user_data.data.split(b";"):
        key, _, value = entry.partition(b"=")
        if key == b"clientid":
            return value
    return None
