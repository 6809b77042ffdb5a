"""The server without the client library: who is let in, what malformed signalling does, and what is left behind."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

import aiohttp
from livekit.protocol import models, rtc

from asimov_gym.room import RoomError, RoomKeys, RoomLimits, RoomServer, RoomThread

OFFER = "v=0\r\nm=audio 9 X 0\r\na=mid:0\r\n"


@asynccontextmanager
async def joined(server: RoomServer, identity: str, **grants: bool) -> AsyncIterator[aiohttp.ClientWebSocketResponse]:
    """The signalling connection of a client that has been let in."""
    token = server.token(None, identity, **grants)
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{server.url}/rtc", headers={"Authorization": f"Bearer {token}"}) as connection,
    ):
        yield connection


async def answer(connection: aiohttp.ClientWebSocketResponse, kind: str) -> rtc.SignalResponse:
    """The next response of a kind."""
    while True:
        message = await connection.receive(timeout=5)
        assert message.type is aiohttp.WSMsgType.BINARY, f"the connection ended before `{kind}` came"
        response = rtc.SignalResponse()
        response.ParseFromString(message.data)
        if response.WhichOneof("message") == kind:
            return response


async def until(condition: object) -> None:
    """Wait up to 3 s until the condition, a function, holds."""
    for _ in range(300):
        if condition():  # type: ignore[operator]
            return
        await asyncio.sleep(0.01)
    raise AssertionError("it did not come about within 3 s")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.2", "::", "example.org", ""])
def test_no_address_but_loopback_is_served(host: str) -> None:
    with pytest.raises(RoomError, match="not a loopback address"):
        RoomServer(host)


@pytest.mark.parametrize("port", [-1, 65_536])
def test_a_port_that_is_none_is_refused(port: int) -> None:
    with pytest.raises(RoomError, match="allowed: 0 to 65535"):
        RoomServer(port=port)


def test_a_busy_port_is_one_clear_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        with pytest.raises(RoomError, match=f"cannot listen on 127.0.0.1 port {port}: the port is in use"):
            RoomThread(port=port).start()
    assert not [thread for thread in threading.enumerate() if thread.name == "room"]


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"participants": 1}, "participants is 1; allowed: whole numbers from 2 to 64"),
        ({"rooms": 2.5}, "rooms is 2.5"),
        ({"join_timeout_s": float("nan")}, "join_timeout_s is nan"),
        ({"ping_interval_s": 15}, "ping_timeout_s is 15; allowed: above ping_interval_s"),
    ],
)
def test_limits_are_checked(limit: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        RoomLimits(**limit)


def test_a_client_without_a_valid_token_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> list[int]:
        async with RoomServer() as server, aiohttp.ClientSession() as session:
            good, other = server.token(None, "x"), RoomKeys.generate().issue("robot-sim", "x")
            refused = []
            for path in (
                "/rtc",
                f"/rtc?access_token={other}",
                "/rtc?access_token=%00",
                f"/rtc/validate?access_token={other}",
            ):
                async with session.get(f"http://127.0.0.1:{server.port}{path}") as reply:
                    refused.append(reply.status)
            for path in (
                f"/rtc/validate?access_token={good}",
                f"/rtc?access_token={good}",
                f"/rtc/v1?access_token={good}",
            ):
                async with session.get(f"http://127.0.0.1:{server.port}{path}") as reply:
                    refused.append(reply.status)
            with caplog.at_level(logging.DEBUG), socket.create_connection(("127.0.0.1", server.port)) as raw:
                raw.sendall(f"GET /rtc?access_token={good} HTTP/9\r\nx\x00\r\n\r\n".encode())
                await asyncio.sleep(0.1)
            assert good not in caplog.text
            assert other not in caplog.text
            return refused

    # The last three: a valid token; no WebSocket; the path of a newer signalling, which sends the client to the older.
    assert asyncio.run(scenario()) == [401, 401, 401, 401, 200, 426, 404]


def test_a_join_is_answered_with_the_room_and_an_offer_on_loopback() -> None:
    async def scenario() -> None:
        async with RoomServer() as server, joined(server, "robot", can_update_own_metadata=True) as connection:
            join = (await answer(connection, "join")).join
            assert (join.room.name, join.participant.identity) == ("robot-sim", "robot")
            assert join.participant.permission.can_update_metadata
            assert join.subscriber_primary
            assert (join.ping_interval, join.ping_timeout) == (5, 15)
            offer = (await answer(connection, "offer")).offer.sdp
            assert {line.split()[4] for line in offer.splitlines() if line.startswith("a=candidate")} == {"127.0.0.1"}
            await connection.send_bytes(rtc.SignalRequest(ping_req=rtc.Ping(timestamp=7)).SerializeToString())
            assert (await answer(connection, "pong_resp")).pong_resp.last_ping_timestamp == 7

    asyncio.run(scenario())


def test_every_socket_is_bound_to_loopback() -> None:
    def addresses() -> dict[str, str]:
        """Local addresses of the open Internet sockets of this process, by inode."""
        found = {}
        for table in ("tcp", "udp", "tcp6", "udp6"):
            with suppress(FileNotFoundError):
                for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
                    found[row.split()[9]] = row.split()[1].split(":")[0]
        mine = {}
        for name in os.listdir("/proc/self/fd"):
            with suppress(FileNotFoundError):
                inode = os.readlink(f"/proc/self/fd/{name}").removeprefix("socket:[").removesuffix("]")
                mine |= {inode: found[inode]} if inode in found else {}
        return mine

    async def scenario() -> set[str]:
        before = addresses()
        async with RoomServer() as server, joined(server, "x") as connection:
            await answer(connection, "offer")
            opened = {inode: address for inode, address in addresses().items() if inode not in before}
            # The listening socket, both ends of the signalling, and the connection that was offered.
            assert len(opened) == 4
            return set(opened.values())

    if not Path("/proc/net/udp").exists():
        pytest.skip("open sockets are read from /proc")
    assert asyncio.run(scenario()) == {"0100007F"}


def test_a_second_join_with_the_same_identity_evicts_the_first() -> None:
    async def scenario() -> None:
        async with RoomServer() as server, joined(server, "x") as first:
            await answer(first, "join")
            async with joined(server, "x") as second:
                await answer(second, "join")
                leave = (await answer(first, "leave")).leave
                assert leave.reason == models.DisconnectReason.DUPLICATE_IDENTITY
                assert leave.action == rtc.LeaveRequest.Action.DISCONNECT
                assert server.participants == 1
            await until(lambda: server.rooms == {})

    asyncio.run(scenario())


def test_a_client_that_wants_its_lost_connection_back_is_told_to_join_anew() -> None:
    async def scenario() -> None:
        async with RoomServer() as server, aiohttp.ClientSession() as session:
            address = f"{server.url}/rtc?reconnect=1&sid=PA_1&access_token={server.token(None, 'x')}"
            async with session.ws_connect(address) as connection:
                leave = (await answer(connection, "leave")).leave
                assert leave.action == rtc.LeaveRequest.Action.RECONNECT
            assert server.rooms == {}

    asyncio.run(scenario())


def test_rooms_and_participants_are_bounded() -> None:
    async def scenario() -> list[int]:
        limits = RoomLimits(rooms=1, participants=2)
        async with RoomServer(limits=limits) as server, joined(server, "a") as a, joined(server, "b") as b:
            await answer(a, "join")
            await answer(b, "join")
            statuses = []
            async with aiohttp.ClientSession() as session:
                for room, identity in (("robot-sim", "c"), ("another", "a")):
                    token = server.token(room, identity)
                    async with session.get(f"http://127.0.0.1:{server.port}/rtc?access_token={token}") as reply:
                        statuses.append(reply.status)
            # Someone who is in may come in again.
            async with joined(server, "b") as again:
                await answer(again, "join")
            return statuses

    assert asyncio.run(scenario()) == [503, 503]


def test_malformed_signalling_harms_nobody(caplog: pytest.LogCaptureFixture) -> None:
    requests = [
        rtc.SignalRequest(),
        rtc.SignalRequest(offer=rtc.SessionDescription(type="offer", sdp=OFFER)),
        rtc.SignalRequest(offer=rtc.SessionDescription(type="offer", sdp="\x00" * 1000)),
        rtc.SignalRequest(answer=rtc.SessionDescription(type="answer", sdp="")),
        rtc.SignalRequest(answer=rtc.SessionDescription(type="offer", sdp=OFFER)),
        rtc.SignalRequest(trickle=rtc.TrickleRequest(candidateInit="{")),
        rtc.SignalRequest(add_track=rtc.AddTrackRequest(type=models.TrackType.DATA)),
        rtc.SignalRequest(mute=rtc.MuteTrackRequest(sid="none", muted=True)),
        rtc.SignalRequest(subscription=rtc.UpdateSubscription(track_sids=["none"], subscribe=True)),
        rtc.SignalRequest(publish_data_track_request=rtc.PublishDataTrackRequest()),
        rtc.SignalRequest(unpublish_data_track_request=rtc.UnpublishDataTrackRequest(pub_handle=9)),
        rtc.SignalRequest(
            update_data_subscription=rtc.UpdateDataSubscription(
                updates=[rtc.UpdateDataSubscription.Update(track_sid="none", subscribe=True)]
            )
        ),
        rtc.SignalRequest(update_metadata=rtc.UpdateParticipantMetadata(metadata="x" * 20_000)),
        rtc.SignalRequest(simulate=rtc.SimulateScenario(node_failure=True)),
        rtc.SignalRequest(sync_state=rtc.SyncState()),
    ]
    messages = [request.SerializeToString() for request in requests] + [os.urandom(200) for _ in range(40)]

    async def scenario() -> None:
        async with RoomServer() as server, joined(server, "bystander") as bystander:
            await answer(bystander, "join")
            for message in messages:
                async with joined(server, "fuzz") as connection:
                    await answer(connection, "join")
                    await connection.send_bytes(message)
                    await connection.send_str("text")
                    await connection.send_bytes(rtc.SignalRequest(ping=1).SerializeToString())
                    while (reply := await connection.receive(timeout=5)).type is aiohttp.WSMsgType.BINARY:
                        response = rtc.SignalResponse()
                        response.ParseFromString(reply.data)
                        if response.WhichOneof("message") in ("pong", "leave"):
                            break
            await bystander.send_bytes(rtc.SignalRequest(ping=3).SerializeToString())
            await answer(bystander, "pong")
            await until(lambda: server.participants == 1)

    asyncio.run(scenario())
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


def test_a_message_that_is_too_large_ends_the_visit() -> None:
    async def scenario() -> None:
        async with RoomServer(limits=RoomLimits(signal_bytes=16_384)) as server, joined(server, "x") as connection:
            await answer(connection, "join")
            await connection.send_bytes(b"x" * 20_000)
            await until(lambda: server.participants == 0)

    asyncio.run(scenario())


def test_silent_and_half_joined_clients_are_removed() -> None:
    async def scenario() -> None:
        limits = RoomLimits(ping_interval_s=1, ping_timeout_s=2, join_timeout_s=2.5)
        async with (
            RoomServer(limits=limits) as server,
            joined(server, "silent") as silent,
            joined(server, "half") as half,
        ):
            await answer(silent, "join")
            await answer(half, "join")
            assert server.participants == 2
            await asyncio.sleep(1.5)
            await half.send_bytes(rtc.SignalRequest(ping=1).SerializeToString())
            await until(lambda: server.participants == 1)
            assert list(server.rooms["robot-sim"].participants) == ["half"]
            await until(lambda: server.participants == 0)

    asyncio.run(scenario())


def test_nothing_is_left_behind_by_restarts_and_clients() -> None:
    async def visit(server: RoomServer) -> None:
        await server.start()
        async with joined(server, "a") as a, joined(server, "b") as b:
            await answer(a, "offer")
            await answer(b, "offer")
            await server.stop()

    async def scenario() -> tuple[list[int], list[int]]:
        server, descriptors, tasks = RoomServer(), [], []
        for _ in range(4):
            await visit(server)
            gc.collect()
            await asyncio.sleep(0.05)
            descriptors.append(len(os.listdir("/proc/self/fd")))
            tasks.append(len(asyncio.all_tasks()))
        return descriptors, tasks

    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("open files are counted in /proc")
    descriptors, tasks = asyncio.run(scenario())
    assert descriptors[-1] == descriptors[1]
    assert tasks[-1] == tasks[0] == 1


def test_a_thread_keeps_port_and_keys_over_a_restart() -> None:
    with RoomThread() as room:
        port, token = room.port, room.token(None, "x")
        room.restart()
        assert room.port == port
        assert room.server.keys.verify(token).identity == "x"
        with socket.create_connection(("127.0.0.1", port), timeout=2):
            pass
    assert not [thread for thread in threading.enumerate() if thread.name == "room"]
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=2)
