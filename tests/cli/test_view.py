"""`asimov view` without a display: what it says, and the picture it draws instead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.cli import main
from asimov_gym.cli.view import changed_command, policy_file
from asimov_gym.rendering.backends import headless_backend, install_line

UP, LEFT, PAGE_DOWN, END, SPACE = 265, 263, 267, 269, 32


def test_without_a_display_it_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("DISPLAY decides on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view"]) == 2
    message = capsys.readouterr().err
    assert "no display" in message and "--frame" in message
    assert message.count("\n") == 1


def test_a_display_that_is_not_there_is_noticed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("DISPLAY decides on Linux only")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":93")
    assert main(["view"]) == 2
    assert "cannot be drawn on" in capsys.readouterr().err


def test_missing_policy_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "no/such/policy.onnx"]) == 1
    assert "no/such/policy.onnx" in capsys.readouterr().err


def test_run_without_a_policy_names_the_export(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="python -m train export"):
        policy_file(tmp_path)


def test_run_folder_stands_for_its_policy(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").touch()
    assert policy_file(tmp_path) == tmp_path / "policy.onnx"


def test_keys_change_the_command() -> None:
    command = (0.0, 0.0, 0.0)
    for key in (UP, UP, LEFT, PAGE_DOWN, SPACE):
        command = changed_command(command, key)
    assert command == (0.2, -0.1, 0.2)
    assert changed_command(command, END) == (0.0, 0.0, 0.0)


def test_frame_shows_the_robot(tmp_path: Path) -> None:
    """The picture is drawn in a process of its own, as a person would have it drawn."""
    if headless_backend() is None:
        pytest.skip(install_line())
    import imageio.v3 as imageio

    file = tmp_path / "pictures" / "robot.png"
    command = [sys.executable, "-m", "asimov_gym.cli", "view", "--frame", str(file)]
    env = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    picture = np.asarray(imageio.imread(file))
    assert picture.shape[:2] == (960, 720)
    # A black or empty picture has one colour; the robot before the floor has many.
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 500
