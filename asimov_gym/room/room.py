"""A room: who is in it, and who gets what the others send."""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Iterator, Sequence

from google.protobuf.message import DecodeError
from livekit.protocol import models, rtc

from asimov_gym.room.data_tracks import DataTrack
from asimov_gym.room.limits import RoomLimits
from asimov_gym.room.media import MediaTrack
from asimov_gym.room.participant import Participant

_log = logging.getLogger(__name__)
SERVER_VERSION = "1.9.0"
"""Version of LiveKit's server whose signalling this room speaks, as far as it goes."""
PROTOCOL_VERSION = 16
_State = models.ParticipantInfo.State
_CODECS = ("audio/opus", "video/H264", "video/VP8")


class Room:
    """Participants under one name.

    Args:
        name: from their tokens.
        limits: of the server.
    """

    def __init__(self, name: str, limits: RoomLimits) -> None:
        self.name, self.sid = name, f"RM_{secrets.token_hex(6)}"
        self.participants: dict[str, Participant] = {}
        """By identity."""
        self._limits, self._created = limits, time.time()

    @property
    def full(self) -> bool:
        """Whether nobody new may join."""
        return len(self.participants) >= self._limits.participants

    # Coming and going

    async def admit(self, participant: Participant) -> None:
        """Let a participant in, in place of an earlier one of the same identity, and tell it what is here."""
        earlier = self.participants.get(participant.identity)
        if earlier is not None:
            reason = "another participant joined with its identity"
            earlier.send_away(reason, models.DisconnectReason.DUPLICATE_IDENTITY)
            self.remove(earlier, reason)
        others = [other.info for other in self.participants.values() if other.active]
        self.participants[participant.identity] = participant
        _log.info("%s joins %s", participant.identity, self.name)
        participant.send(
            rtc.SignalResponse(
                join=rtc.JoinResponse(
                    room=models.Room(
                        sid=self.sid,
                        name=self.name,
                        max_participants=self._limits.participants,
                        num_participants=len(self.participants),
                        creation_time=int(self._created),
                        enabled_codecs=[models.Codec(mime=mime) for mime in _CODECS],
                    ),
                    participant=participant.info,
                    other_participants=others,
                    server_version=SERVER_VERSION,
                    server_info=models.ServerInfo(version=SERVER_VERSION, protocol=PROTOCOL_VERSION, region="local"),
                    subscriber_primary=True,
                    ping_interval=self._limits.ping_interval_s,
                    ping_timeout=self._limits.ping_timeout_s,
                    enabled_publish_codecs=[models.Codec(mime=mime) for mime in _CODECS],
                )
            )
        )
        for track in self.media_tracks():
            if participant.wants(track):
                participant.subscriber.add(track)
        await participant.subscriber.open()

    def activate(self, participant: Participant) -> None:
        """A participant can be reached: the others are told of it."""
        if self.participants.get(participant.identity) is not participant:
            return
        participant.active = True
        participant.info.state = _State.ACTIVE
        self.announce(participant)

    def remove(self, participant: Participant, reason: str) -> None:
        """Take a participant out and tell the others. Doing it twice does nothing."""
        if self.participants.get(participant.identity) is not participant:
            return
        del self.participants[participant.identity]
        _log.info("%s leaves %s: %s", participant.identity, self.name, reason)
        for track in participant.data_tracks.published.values():
            for subscriber in list(track.handles):
                subscriber.data_tracks.stop_receiving(track, subscriber)
        for track in list(participant.data_tracks.received.values()):
            participant.data_tracks.stop_receiving(track, participant)
        participant.subscriber.clear()
        participant.info.state = _State.DISCONNECTED
        if participant.active:
            self.announce(participant)
        tracks = list(participant.publisher.tracks.values())
        for other in self.participants.values():
            for track in tracks:
                other.subscriber.remove(track)
            other.subscriber.negotiate()

    def announce(self, participant: Participant) -> None:
        """Tell everyone, itself included, what a participant is now."""
        info = participant.info
        info.version += 1
        del info.tracks[:]
        del info.data_tracks[:]
        info.tracks.extend(t.info for t in participant.publisher.tracks.values() if t.mid is not None)
        info.data_tracks.extend(track.info for track in participant.data_tracks.published.values())
        if participant.active:
            update = rtc.SignalResponse(update=rtc.ParticipantUpdate(participants=[info]))
            for other in list(self.participants.values()):
                other.send(update)

    # Tracks and packets

    def media_tracks(self) -> Iterator[MediaTrack]:
        """Audio and video tracks that can be received."""
        for participant in self.participants.values():
            yield from (track for track in participant.publisher.tracks.values() if track.mid is not None)

    def data_track(self, sid: str) -> DataTrack | None:
        """A data track by its sid."""
        tracks = (t for p in self.participants.values() for t in p.data_tracks.published.values())
        return next((track for track in tracks if track.info.sid == sid), None)

    def change_tracks(
        self, participant: Participant, added: Sequence[MediaTrack], removed: Sequence[MediaTrack]
    ) -> None:
        """A participant's audio and video tracks came and went: the others are told and offered them."""
        self.announce(participant)
        for other in list(self.participants.values()):
            for track in removed:
                other.subscriber.remove(track)
            for track in added:
                if other.wants(track):
                    other.subscriber.add(track)
            other.subscriber.negotiate()

    def route(self, sender: Participant, label: str, message: bytes) -> None:
        """Pass a data packet on, stamped with its sender, to all others or to those it names."""
        packet = models.DataPacket()
        try:
            packet.ParseFromString(message)
        except DecodeError:
            return
        packet.participant_identity, packet.participant_sid = sender.identity, sender.sid
        if packet.WhichOneof("value") == "user":
            packet.user.participant_identity, packet.user.participant_sid = sender.identity, sender.sid
        named = {*packet.destination_identities, *packet.user.destination_identities}
        stamped = packet.SerializeToString()
        for other in list(self.participants.values()):
            if other is not sender and (not named or other.identity in named):
                other.send_data(label, stamped)

    async def report(self) -> None:
        """Tell publishers of media what arrived; due once a second."""
        for participant in list(self.participants.values()):
            await participant.publisher.report()
