"""The video process: a file of the right size and length, and an error that is reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from asimov_gym.cli.video import FPS, HEIGHT, WIDTH, VideoWriter
from asimov_gym.physics import CPhysics
from asimov_gym.rendering.backends import headless_backend, install_line


def test_video_holds_every_frame(tmp_path: Path) -> None:
    backend = headless_backend()
    if backend is None:
        pytest.skip(install_line())
    import imageio.v3 as imageio

    qpos, _ = CPhysics(copies=1).standing()
    path = tmp_path / "walk.mp4"
    drawn: list[int] = []
    with VideoWriter(path, backend) as video:
        for frame in range(FPS + 5):
            qpos[0] = 0.02 * frame
            video.write(qpos)
        assert video.finish(drawn.append), video.error
    assert drawn == [FPS, FPS + 5]
    properties = imageio.improps(path, plugin="FFMPEG")
    assert properties.shape[1:3] == (HEIGHT, WIDTH)
    frames = np.stack(list(imageio.imiter(path, plugin="FFMPEG")))
    assert len(frames) == FPS + 5


def test_broken_renderer_is_reported_and_the_caller_goes_on(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "walk.mp4", "no-such-backend") as video:
        for _ in range(3):
            video.write(np.zeros(32))
        assert not video.finish()
    assert "no-such-backend" in video.error


def test_leaving_early_ends_the_process(tmp_path: Path) -> None:
    backend = headless_backend()
    if backend is None:
        pytest.skip(install_line())
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "walk.mp4", backend) as video:
        raise KeyboardInterrupt
    assert video._process.poll() is not None
