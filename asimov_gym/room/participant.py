"""One participant of a room: what it is, what it may do, and what it asks for."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aiortc import RTCCertificate
from livekit.protocol import models, rtc

from asimov_gym.room.data_tracks import DataTracks
from asimov_gym.room.errors import SessionDescriptionError
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.media import MediaTrack
from asimov_gym.room.publishing import Publisher
from asimov_gym.room.signalling import Signalling
from asimov_gym.room.subscribing import Subscriber
from asimov_gym.room.tokens import Admission
from asimov_gym.room.transport import DATA_TRACK

if TYPE_CHECKING:
    from asimov_gym.room.room import Room

_log = logging.getLogger(__name__)
_DISCONNECT = rtc.LeaveRequest.Action.DISCONNECT
RECONNECT = rtc.LeaveRequest.Action.RECONNECT
_Reason = rtc.RequestResponse.Reason


class Participant:
    """A client in a room.

    Args:
        room: it joined.
        admission: from its token.
        signalling: its connection.
        certificate: of the server.
        limits: of the server.
        auto_subscribe: whether it receives every audio and video track unasked.
        client_protocol: what its library understands, told to the others.
    """

    def __init__(
        self,
        room: Room,
        admission: Admission,
        signalling: Signalling,
        certificate: RTCCertificate,
        limits: RoomLimits,
        auto_subscribe: bool,
        client_protocol: int,
    ) -> None:
        self.admission, self.grants, self.limits = admission, admission.grants, limits
        self.room, self._signalling, self._auto_subscribe = room, signalling, auto_subscribe
        self.data_tracks = DataTracks(limits.data_tracks)
        self.active = False
        """Whether its data connection is open: before that, others do not see it."""
        now = time.time()
        self.info = models.ParticipantInfo(
            sid=f"PA_{secrets.token_hex(6)}",
            identity=admission.identity,
            state=models.ParticipantInfo.State.JOINED,
            name=admission.name,
            metadata=admission.metadata,
            attributes=dict(admission.attributes),
            joined_at=int(now),
            joined_at_ms=int(now * 1000),
            is_publisher=self.grants.can_publish,
            client_protocol=client_protocol,
            permission=models.ParticipantPermission(
                can_subscribe=self.grants.can_subscribe,
                can_publish=self.grants.can_publish,
                can_publish_data=self.grants.can_publish_data,
                can_update_metadata=self.grants.can_update_own_metadata,
            ),
        )
        self.publisher = Publisher(
            self.sid, certificate, limits, self._take_message, lambda: self.end("it left, or its connection was lost")
        )
        self.subscriber = Subscriber(
            certificate,
            limits,
            self._take_message,
            lambda: room.activate(self),
            lambda: self.end("it left, or its connection was lost"),
            self._send_offer,
        )
        self._ended = asyncio.Event()
        self._end_reason = "it closed the connection"
        self._handlers: dict[str, Callable[[Any], Any]] = {
            "offer": self._take_offer,
            "answer": self._take_answer,
            "add_track": self._add_track,
            "mute": self._mute,
            "subscription": self._subscribe,
            "update_metadata": self._update_metadata,
            "publish_data_track_request": self._publish_data_track,
            "unpublish_data_track_request": self._unpublish_data_track,
            "update_data_subscription": self._subscribe_data,
            "leave": lambda _: self.end("it left"),
            "ping": lambda stamp: self.send(rtc.SignalResponse(pong=stamp)),
            "ping_req": self._pong,
        }

    @property
    def sid(self) -> str:
        """Its name of this visit."""
        return self.info.sid

    @property
    def identity(self) -> str:
        """Its name in the room."""
        return self.info.identity

    async def run(self) -> None:
        """Serve the client until it leaves, is lost or is sent away."""
        writer = asyncio.create_task(self._signalling.write())
        reader = asyncio.create_task(self._read())
        timer = asyncio.get_running_loop().call_later(self.limits.join_timeout_s, self._check_active)
        try:
            await self._ended.wait()
        finally:
            timer.cancel()
            self.room.remove(self, self._end_reason)
            reader.cancel()
            await asyncio.gather(reader, return_exceptions=True)
            await self._signalling.finish(writer)

    async def close(self) -> None:
        """Close its connections."""
        self.subscriber.clear()
        await self.publisher.transport.close()
        await self.subscriber.transport.close()

    def end(self, reason: str, leave: rtc.LeaveRequest | None = None) -> None:
        """Let `run` come to its end.

        Args:
            reason: for the log.
            leave: what the client is told.
        """
        if self._ended.is_set():
            return
        self._end_reason = reason
        if leave is not None:
            self._signalling.send(rtc.SignalResponse(leave=leave))
        self._ended.set()

    def send_away(self, reason: str, why: models.DisconnectReason, come_back: bool = False) -> None:
        """End the visit and tell the client why, and whether to join again."""
        action = RECONNECT if come_back else _DISCONNECT
        self.end(reason, rtc.LeaveRequest(reason=why, action=action, can_reconnect=come_back))

    def send(self, message: rtc.SignalResponse) -> None:
        """Send a signalling message."""
        if not self._ended.is_set() and not self._signalling.send(message):
            self.end("it does not read its signalling")

    def send_data(self, label: str, message: bytes) -> None:
        """Send a message on a data channel."""
        if self.subscriber.transport.send(label, message) > self.limits.backlog_bytes:
            self.end("it does not read its data")

    async def _read(self) -> None:
        try:
            async for request in self._signalling.requests():
                await self._handle(request)
                if self._ended.is_set():
                    return
            self.end("it closed the connection or fell silent")
        finally:
            self.end("its signalling failed")

    async def _handle(self, request: rtc.SignalRequest) -> None:
        kind = request.WhichOneof("message")
        handler = self._handlers.get(kind or "")
        if handler is None:
            return
        try:
            outcome = handler(getattr(request, kind))
            if outcome is not None:
                await outcome
        except SessionDescriptionError as error:
            _log.warning("%s in %s: %s", self.identity, self.room.name, error)
            self.send_away(str(error), models.DisconnectReason.STATE_MISMATCH, come_back=True)
        except Exception:
            # Whatever one client sends, the others stay.
            _log.exception("%s in %s sent a request `%s` that failed", self.identity, self.room.name, kind)
            self.send_away("a request failed", models.DisconnectReason.JOIN_FAILURE)

    def _check_active(self) -> None:
        if not self.active:
            self.end(f"no data connection within {self.limits.join_timeout_s:g} s")

    def _pong(self, ping: rtc.Ping) -> None:
        stamp = int(time.time() * 1000)
        self.send(rtc.SignalResponse(pong_resp=rtc.Pong(last_ping_timestamp=ping.timestamp, timestamp=stamp)))

    def _refuse(self, reason: _Reason, **request: Any) -> None:
        self.send(rtc.SignalResponse(request_response=rtc.RequestResponse(reason=reason, **request)))

    # Connections

    def _send_offer(self, text: str, version: int) -> None:
        self.send(rtc.SignalResponse(offer=rtc.SessionDescription(type="offer", sdp=text, id=version)))

    async def _take_offer(self, offer: rtc.SessionDescription) -> None:
        text, added, removed = await self.publisher.answer(offer.sdp, self.grants.can_publish)
        self.send(rtc.SignalResponse(answer=rtc.SessionDescription(type="answer", sdp=text, id=offer.id)))
        if added or removed:
            self.room.change_tracks(self, added, removed)

    async def _take_answer(self, answer: rtc.SessionDescription) -> None:
        await self.subscriber.take_answer(answer.sdp)

    def _take_message(self, label: str, message: bytes) -> None:
        if not self.grants.can_publish_data:
            return
        if label == DATA_TRACK:
            for subscriber, packet in self.data_tracks.addressed(message):
                subscriber.send_data(DATA_TRACK, packet)
        else:
            self.room.route(self, label, message)

    # Audio and video

    def _add_track(self, request: rtc.AddTrackRequest) -> None:
        if not self.grants.can_publish:
            return self._refuse(_Reason.NOT_ALLOWED, add_track=request)
        track = self.publisher.add(request)
        if track is None:
            return self._refuse(_Reason.LIMIT_EXCEEDED, add_track=request)
        self.send(rtc.SignalResponse(track_published=rtc.TrackPublishedResponse(cid=request.cid, track=track.info)))

    def _mute(self, request: rtc.MuteTrackRequest) -> None:
        track = self.publisher.tracks.get(request.sid)
        if track is not None and track.info.muted != request.muted:
            track.info.muted = request.muted
            self.room.announce(self)

    def wants(self, track: MediaTrack) -> bool:
        """Whether a new track goes to this participant unasked."""
        return self._auto_subscribe and self.grants.can_subscribe and track.publisher_sid != self.sid

    def _subscribe(self, request: rtc.UpdateSubscription) -> None:
        wanted = {*request.track_sids, *(sid for tracks in request.participant_tracks for sid in tracks.track_sids)}
        for track in self.room.media_tracks():
            if track.info.sid in wanted and track.publisher_sid != self.sid:
                if request.subscribe and self.grants.can_subscribe:
                    self.subscriber.add(track)
                elif not request.subscribe:
                    self.subscriber.remove(track)
        self.subscriber.negotiate()

    # Data tracks

    def _publish_data_track(self, request: rtc.PublishDataTrackRequest) -> None:
        if not self.grants.can_publish_data:
            return self._refuse(_Reason.NOT_ALLOWED, publish_data_track=request)
        track = self.data_tracks.publish(request, self.identity, self.sid)
        if isinstance(track, int):
            return self._refuse(track, publish_data_track=request)
        self.send(rtc.SignalResponse(publish_data_track_response=rtc.PublishDataTrackResponse(info=track.info)))
        self.room.announce(self)

    def _unpublish_data_track(self, request: rtc.UnpublishDataTrackRequest) -> None:
        track = self.data_tracks.published.pop(request.pub_handle, None)
        if track is None:
            return self._refuse(_Reason.INVALID_HANDLE, unpublish_data_track=request)
        for subscriber in list(track.handles):
            subscriber.data_tracks.stop_receiving(track, subscriber)
        self.send(rtc.SignalResponse(unpublish_data_track_response=rtc.UnpublishDataTrackResponse(info=track.info)))
        self.room.announce(self)

    def _subscribe_data(self, request: rtc.UpdateDataSubscription) -> None:
        for update in request.updates:
            track = self.room.data_track(update.track_sid)
            if track is None or track.publisher_sid == self.sid:
                continue
            if not update.subscribe:
                self.data_tracks.stop_receiving(track, self)
            elif self.grants.can_subscribe:
                self.data_tracks.receive(track, self)
        handles = {
            handle: rtc.DataTrackSubscriberHandles.PublishedDataTrack(
                publisher_identity=track.publisher_identity, publisher_sid=track.publisher_sid, track_sid=track.info.sid
            )
            for handle, track in self.data_tracks.received.items()
        }
        self.send(rtc.SignalResponse(data_track_subscriber_handles=rtc.DataTrackSubscriberHandles(sub_handles=handles)))

    # Metadata

    def _update_metadata(self, request: rtc.UpdateParticipantMetadata) -> None:
        # As LiveKit has it: an empty text leaves name and metadata as they are, an empty attribute is taken away.
        attributes = dict(self.info.attributes) | dict(request.attributes)
        attributes = {key: value for key, value in attributes.items() if value}
        sizes = (len(request.metadata), len(request.name), sum(len(k) + len(v) for k, v in attributes.items()))
        reason = _Reason.OK
        if not self.grants.can_update_own_metadata:
            reason = _Reason.NOT_ALLOWED
        elif max(sizes) > self.limits.metadata_bytes:
            reason = _Reason.LIMIT_EXCEEDED
        else:
            self.info.metadata = request.metadata or self.info.metadata
            self.info.name = request.name or self.info.name
            self.info.attributes.clear()
            self.info.attributes.update(attributes)
        if reason == _Reason.OK:
            self.room.announce(self)
        self._refuse(reason, request_id=request.request_id, update_metadata=request)
