"""The public LiveKit client library in the room, in a network namespace of its own; video and sound are beside this."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from asimov_gym.room import RoomKeys, RoomLimits, RoomThread
from tests.network_namespace import in_namespace
from tests.room.meeting import RATE, clients, clients_later, collect, until

if TYPE_CHECKING:
    from livekit import rtc


@in_namespace(timeout=30)
async def test_participants_meet_exchange_packets_and_leave() -> None:
    with RoomThread() as server:
        async with clients(server, "robot", "one", "two") as (robot, one, two):
            got = {client: collect(client, "data_received") for client in (robot, one, two)}
            me = robot.local_participant
            await me.publish_data(b"to all", reliable=True, topic="system")
            await me.publish_data(b"to one", reliable=True, topic="system", destination_identities=["one"])
            await me.publish_data(b"lossy", reliable=False, topic="state")
            await one.local_participant.publish_data(bytes(15_000), topic="commands")
            await until(lambda: len(got[one]) == 3 and len(got[two]) == 3 and len(got[robot]) == 1)
            assert {(p.data, p.topic, p.participant.identity) for p in got[one]} == {
                (b"to all", "system", "robot"),
                (b"to one", "system", "robot"),
                (b"lossy", "state", "robot"),
            }
            assert b"to one" not in {p.data for p in got[two]}
            assert (got[robot][0].data, got[robot][0].topic) == (bytes(15_000), "commands")

            for number in range(200):
                await me.publish_data(number.to_bytes(2, "big"), topic="count")
            await until(lambda: len(got[one]) == 203)
            assert [int.from_bytes(p.data, "big") for p in got[one][3:]] == list(range(200))

            left = collect(one, "participant_disconnected")
            await two.disconnect()
            await until(lambda: left)
            assert left[0].identity == "two"
        # Rooms know nothing of each other.
        async with clients(server, "a", room="first") as (a,), clients(server, "a", room="second") as (b,):
            heard = collect(b, "data_received")
            await a.local_participant.publish_data(b"x")
            await asyncio.sleep(0.2)
            assert heard == []
            assert set(server.server.rooms) == {"first", "second"}
        await until(lambda: server.server.rooms == {})


@in_namespace(timeout=30)
async def test_attributes_metadata_and_rpc() -> None:
    from livekit import rtc

    with RoomThread() as server:
        async with clients(server, "robot", "app") as (robot, app):
            changes = collect(app, "participant_attributes_changed")
            await robot.local_participant.set_attributes({"asimov.commands_track": "1", "mode": "DAMP"})
            await robot.local_participant.set_metadata("made of bits")
            await robot.local_participant.set_name("Asimov")
            seen = app.remote_participants["robot"]
            await until(lambda: seen.name == "Asimov")
            assert seen.attributes == {"asimov.commands_track": "1", "mode": "DAMP"}
            assert seen.metadata == "made of bits"
            assert changes[0][0] == {"asimov.commands_track": "1", "mode": "DAMP"}
            await robot.local_participant.set_attributes({"mode": ""})
            await until(lambda: seen.attributes == {"asimov.commands_track": "1"})

            async def facts(call: rtc.RpcInvocationData) -> str:
                if call.payload == "fail":
                    raise rtc.RpcError(1501, "no", call.caller_identity)
                return '{"robot_model": "asimov_1"}' + "x" * 10_000

            robot.local_participant.register_rpc_method("edge.getSystemInfo", facts)
            call = app.local_participant.perform_rpc
            reply = await call(destination_identity="robot", method="edge.getSystemInfo", payload="{}")
            assert reply.startswith('{"robot_model": "asimov_1"}') and len(reply) > 10_000
            with pytest.raises(rtc.RpcError) as caught:
                await call(destination_identity="robot", method="edge.getSystemInfo", payload="fail")
            assert (caught.value.code, caught.value.data) == (1501, "app")
            # Who comes later is told what holds.
            async with clients_later(server, "late") as late:
                assert late.remote_participants["robot"].attributes == {"asimov.commands_track": "1"}

            plain = rtc.Room()
            await plain.connect(server.url, server.token(None, "plain"))
            await plain.local_participant.set_attributes({"a": "b"})
            await asyncio.sleep(0.2)
            assert app.remote_participants["plain"].attributes == {}
            await plain.disconnect()


@in_namespace(timeout=30)
async def test_data_tracks_both_ways() -> None:
    from livekit import rtc

    with RoomThread() as server:
        async with clients(server, "robot", "one", "two") as (robot, one, two):
            found = {client: collect(client, "data_track_published") for client in (robot, one, two)}
            state = await robot.local_participant.publish_data_track(name="state")
            commands = await one.local_participant.publish_data_track(name="commands")
            await until(lambda: len(found[one]) == 1 and len(found[two]) == 2 and len(found[robot]) == 1)
            assert found[one][0].info.name == "state"
            assert found[one][0].publisher_identity == "robot"
            frames: dict[str, list[rtc.DataTrackFrame]] = {"one": [], "two": [], "robot": []}

            async def read(name: str, stream: rtc.DataTrackStream) -> None:
                async for frame in stream:
                    frames[name].append(frame)

            streams = {"one": found[one][0].subscribe(), "robot": found[robot][0].subscribe()}
            streams["two"] = next(track for track in found[two] if track.info.name == "state").subscribe()
            readers = [asyncio.create_task(read(name, stream)) for name, stream in streams.items()]
            await asyncio.sleep(0.3)
            for number in range(20):
                # Every other frame is larger than a packet.
                payload = number.to_bytes(2, "big") + bytes(3000 if number % 2 else 30)
                state.try_push(rtc.DataTrackFrame(payload=payload, user_timestamp=1_000 + number))
                commands.try_push(rtc.DataTrackFrame(payload=b"go"))
                await asyncio.sleep(0.02)
            await until(lambda: all(len(list_) >= 19 for list_ in frames.values()))
            for name in ("one", "two"):
                numbers = [int.from_bytes(frame.payload[:2], "big") for frame in frames[name]]
                assert numbers == sorted(numbers)
                assert [frame.user_timestamp for frame in frames[name]] == [1_000 + number for number in numbers]
            gone = collect(one, "data_track_unpublished")
            await state.unpublish()
            await until(lambda: gone)
            for reader in readers:
                reader.cancel()


@in_namespace(timeout=30)
async def test_grants_are_enforced_and_a_second_join_evicts_the_first() -> None:
    from livekit import rtc

    with RoomThread() as server:
        async with clients(server, "robot", "app") as (robot, app):
            heard = collect(robot, "data_received")
            tracks = collect(robot, "data_track_published")
            eye = rtc.Room()
            token = server.token(None, "eye", can_publish=False, can_publish_data=False)
            await eye.connect(server.url, token)
            seen = collect(eye, "data_received")
            await robot.local_participant.publish_data(b"for all")
            await until(lambda: seen)
            # The library may refuse by itself, or send and be ignored.
            for attempt in (
                lambda: eye.local_participant.publish_data(b"I should be silent"),
                lambda: eye.local_participant.publish_data_track(name="state"),
                lambda: eye.local_participant.publish_track(
                    rtc.LocalAudioTrack.create_audio_track("mic", rtc.AudioSource(RATE, 1))
                ),
            ):
                with suppress(Exception):
                    await asyncio.wait_for(attempt(), 0.5)
            await app.local_participant.publish_data(b"I may speak")
            await until(lambda: heard)
            assert [packet.data for packet in heard] == [b"I may speak"]
            assert tracks == []
            assert robot.remote_participants["eye"].track_publications == {}
            await eye.disconnect()

            gone = collect(app, "disconnected")
            again = rtc.Room()
            await again.connect(server.url, server.token(None, "app"))
            await until(lambda: gone)
            assert gone[0] == rtc.DisconnectReason.DUPLICATE_IDENTITY
            await again.local_participant.publish_data(b"the second app")
            await until(lambda: len(heard) == 2)
            assert list(robot.remote_participants) == ["app"]
            await again.disconnect()


@in_namespace(timeout=40)
async def test_clients_come_back_after_a_restart_with_their_tracks() -> None:
    from livekit import rtc

    with RoomThread() as server:
        async with clients(server, "robot", "app") as (robot, app):
            tracks = collect(app, "data_track_published")
            # Held on to: the library takes a track back whose object is gone.
            state = await robot.local_participant.publish_data_track(name="state")
            microphone = rtc.LocalAudioTrack.create_audio_track("microphone", rtc.AudioSource(RATE, 1))
            await robot.local_participant.publish_track(microphone)
            await until(lambda: tracks and app.remote_participants["robot"].track_publications)
            tracks.clear()
            back = [collect(client, "reconnected") for client in (robot, app)]
            heard = collect(app, "data_received")
            await asyncio.to_thread(server.restart)
            await until(lambda: all(back), 15)
            await until(lambda: tracks and app.remote_participants["robot"].track_publications)
            assert tracks[-1].info.name == "state" and state.is_published()
            await robot.local_participant.publish_data(b"still here")
            await until(lambda: heard)
            assert server.server.participants == 2


@pytest.mark.slow
@in_namespace(timeout=90)
async def test_clients_come_back_after_the_room_was_killed(tmp_path: Path) -> None:
    keys, port = tmp_path / "keys.json", 7880
    command = [
        sys.executable,
        "-c",
        "import sys; from pathlib import Path; from asimov_gym.cli.room import Room;"
        f" sys.exit(Room(port={port}, keys=Path({str(keys)!r})).run())",
    ]

    def spawn() -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL)

    from livekit import rtc

    process = spawn()
    try:
        await until(keys.exists)
        token = RoomKeys.from_file(keys).issue("robot-sim", "robot")
        robot = rtc.Room()
        back = collect(robot, "reconnected")
        for _ in range(100):
            try:
                await robot.connect(f"ws://127.0.0.1:{port}", token)
                break
            except rtc.ConnectError:
                await asyncio.sleep(0.1)
        process.kill()
        process.wait()
        process = spawn()
        await until(lambda: back, 40)
        assert robot.isconnected()
        await robot.disconnect()
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@in_namespace(timeout=90)
async def test_a_client_that_stops_reading_is_dropped_and_slows_nobody() -> None:
    script = """if True:
        import asyncio, sys
        from livekit import rtc
        async def main():
            room = rtc.Room()
            await room.connect(sys.argv[1], sys.argv[2])
            await asyncio.sleep(1000)
        asyncio.run(main())
    """
    limits = RoomLimits(backlog_bytes=1_000_000, ping_timeout_s=60)
    with RoomThread(limits=limits) as server:
        async with clients(server, "robot", "app") as (robot, app):
            heard = collect(app, "data_received")
            process = subprocess.Popen([sys.executable, "-c", script, server.url, server.token(None, "frozen")])
            try:
                await until(lambda: "frozen" in robot.remote_participants, 20)
                process.send_signal(signal.SIGSTOP)
                await asyncio.sleep(0.3)
                for _ in range(200):
                    await robot.local_participant.publish_data(bytes(14_000))
                    await asyncio.sleep(0.02)
                await until(lambda: len(heard) == 200)
                await until(lambda: set(app.remote_participants) == {"robot"})
            finally:
                process.kill()
                process.wait()


@pytest.mark.slow
@in_namespace(timeout=150)
async def test_nothing_grows_while_clients_come_and_go() -> None:
    with RoomThread(limits=RoomLimits(participants=4)) as server:
        async with clients(server, "robot") as (robot,):
            heard = collect(robot, "data_received")
            files: list[int] = []
            threads: list[int] = []
            for number in range(25):
                async with clients_later(server, "guest") as guest:
                    for _ in range(20):
                        await guest.local_participant.publish_data(bytes(1000))
                    await until(lambda number=number: len(heard) == 20 * (number + 1))
                await until(lambda: server.server.participants == 1)
                await asyncio.sleep(0.1)
                files.append(count_sockets())
                threads.append(len(os.listdir("/proc/self/task")))
            assert files[-1] <= files[4] + 2
            assert threads[-1] <= threads[4] + 2


def count_sockets() -> int:
    """Open sockets of this process."""
    names = (os.path.join("/proc/self/fd", name) for name in os.listdir("/proc/self/fd"))
    return sum(os.readlink(name).startswith("socket") for name in names if os.path.islink(name))
