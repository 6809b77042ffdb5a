"""Clock synchronisation: how far a client's clock is behind the robot's, from round trips that the client measures."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from itertools import count
from typing import Any

from google.protobuf.duration_pb2 import Duration

from asimov_gym.edge.transports.joint_control.stamps import microseconds, response_header, stamp
from asimov_gym.edge.transports.joint_control.vendor import header_pb2, time_sync_pb2

SAMPLES_NEEDED = 3
"""Round trips before the estimate counts. Our choice."""
MAX_CLIENTS = 64
"""Clients remembered; the one that was silent longest is forgotten."""


@dataclass(frozen=True)
class Estimate:
    """What one round trip says."""

    round_trip_us: int
    skew_us: int
    """Robot's clock minus the client's."""

    def message(self) -> Any:
        """As a `TimeSyncEstimate`."""
        return time_sync_pb2.TimeSyncEstimate(
            round_trip_time=_duration(self.round_trip_us), clock_skew=_duration(self.skew_us)
        )


@dataclass
class _Known:
    """A client's clock so far."""

    samples: int = 0
    best: Estimate | None = None
    measured_us: int = 0


class TimeSync:
    """Answers `TimeSyncUpdate`. The client with the shortest round trip so far tells the skew best."""

    def __init__(self) -> None:
        self._clients: OrderedDict[str, _Known] = OrderedDict()
        self._numbers = count(1)

    def knows(self, identifier: str) -> bool:
        """Whether a client of that identifier has ever asked."""
        return identifier in self._clients

    def update(self, request: Any, received_us: int, now_us: int) -> Any:
        """One exchange; gives a `TimeSyncUpdateResponse`.

        Args:
            request: a `TimeSyncUpdateRequest`, with the round trip of the exchange before, if there was one.
            received_us: robot time of its arrival.
            now_us: robot time.
        """
        identifier = request.clock_identifier
        estimate = None
        if request.HasField("previous_round_trip"):
            if identifier not in self._clients:
                problem = "a round trip needs the clock_identifier of an earlier answer"
                code = header_pb2.CommonError.CODE_INVALID_REQUEST
                header = response_header(request, received_us, now_us, code, problem)
                return time_sync_pb2.TimeSyncUpdateResponse(header=header)
            estimate = estimated(request.previous_round_trip)
        known = self._known(identifier or f"asimov-{next(self._numbers)}")
        identifier = next(reversed(self._clients))
        if estimate is not None:
            known.samples += 1
            if known.best is None or estimate.round_trip_us <= known.best.round_trip_us:
                known.best, known.measured_us = estimate, received_us
        state = time_sync_pb2.TimeSyncState(status=time_sync_pb2.TimeSyncState.STATUS_MORE_SAMPLES_NEEDED)
        if known.best is not None:
            state.best_estimate.CopyFrom(known.best.message())
            state.measurement_time.CopyFrom(stamp(known.measured_us))
            if known.samples >= SAMPLES_NEEDED:
                state.status = time_sync_pb2.TimeSyncState.STATUS_OK
        return time_sync_pb2.TimeSyncUpdateResponse(
            header=response_header(request, received_us, now_us),
            previous_estimate=None if estimate is None else estimate.message(),
            state=state,
            clock_identifier=identifier,
        )

    def _known(self, identifier: str) -> _Known:
        known = self._clients.setdefault(identifier, _Known())
        self._clients.move_to_end(identifier)
        if len(self._clients) > MAX_CLIENTS:
            self._clients.popitem(last=False)
        return known


def estimated(trip: Any) -> Estimate | None:
    """What a `TimeSyncRoundTrip` says; None where the client did not stamp its request, or time ran backwards."""
    client_tx, server_rx = microseconds(trip.client_tx), microseconds(trip.server_rx)
    server_tx, client_rx = microseconds(trip.server_tx), microseconds(trip.client_rx)
    round_trip = (client_rx - client_tx) - (server_tx - server_rx)
    if client_tx == 0 or round_trip < 0:
        return None
    return Estimate(round_trip, ((server_rx - client_tx) + (server_tx - client_rx)) // 2)


def _duration(microseconds: int) -> Duration:
    """A duration; seconds and nanoseconds have one sign."""
    seconds, rest = divmod(abs(microseconds), 1_000_000)
    sign = -1 if microseconds < 0 else 1
    return Duration(seconds=sign * seconds, nanos=sign * 1000 * rest)
