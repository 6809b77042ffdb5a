"""`asimov robot` and `asimov drive` meet in a room; in a network namespace, where nothing leaves this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile

import pytest

from tests.network_namespace import in_namespace

CLI = [sys.executable, "-m", "asimov_gym.cli"]


@pytest.mark.slow
@in_namespace(timeout=120)
def test_drive_a_robot_through_a_room() -> None:
    from asimov_gym.room import RoomThread

    with tempfile.TemporaryDirectory(prefix="ag-") as folder, RoomThread() as room:
        for dialect in ("cloud", "io"):
            environment = {**os.environ, "XDG_RUNTIME_DIR": folder, "LIVEKIT_URL": room.url}
            robot_token = room.token(None, f"robot-{dialect}", can_update_own_metadata=True)
            robot = subprocess.Popen(
                [*CLI, "robot", "--no-udp", "--dialect", dialect],
                env={**environment, "LIVEKIT_TOKEN": robot_token},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            try:
                assert robot.stdout is not None
                lines = [robot.stdout.readline()]
                while lines[-1] and "faults" not in lines[-1]:
                    lines.append(robot.stdout.readline())
                drive = subprocess.run(
                    [*CLI, "drive", "stand for 0.8; velocity 0.2 0 0 for 1; stop; damp", "--livekit", room.url],
                    env={**environment, "LIVEKIT_TOKEN": room.token(None, "driver")},
                    capture_output=True,
                    text=True,
                    timeout=50,
                    check=False,
                )
                robot.send_signal(signal.SIGINT)
                rest, _ = robot.communicate(timeout=30)
            finally:
                robot.kill()
                robot.wait()
            said = "".join(lines) + rest
            assert drive.returncode == 0, drive.stdout + drive.stderr + said
            assert "done: DAMP" in drive.stdout
            assert robot.returncode == 0, said
            assert "STAND -> MOVE/POLICY" in said and f"dialect {dialect}" in said
            assert robot_token not in said
