"""A video of the robot, drawn and encoded in a process of its own while the simulation goes on in another.

The child reads generalised positions from its standard input, one frame after the other, and prints the number of
frames done. `VideoWriter` is the other end. Software rendering without shadows makes about 30 frames of 640 × 360 a
second, so a demo's video takes as long as the demo lasts, on the core that the simulation leaves free.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from types import TracebackType

import numpy as np

from asimov_gym.rendering.backends import environment

WIDTH, HEIGHT, FPS = 640, 360, 25


class VideoWriter:
    """Sends frames to the drawing process. Use it as a context manager; the file is complete after `finish`.

    Args:
        path: MP4 file to write.
        backend: OpenGL backend that works here, from `rendering.backends.headless_backend()`.
    """

    def __init__(self, path: Path, backend: str) -> None:
        self.path = path
        self.sent = 0
        self.error = ""
        """Last line of what went wrong in the drawing process; empty if nothing did."""
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed in __exit__
        self._process = subprocess.Popen(
            [sys.executable, "-m", "asimov_gym.cli.video", str(path)],
            env=environment(backend),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
        )

    def __enter__(self) -> VideoWriter:
        return self

    def write(self, qpos: np.ndarray) -> None:
        """Add the frame of a configuration, (nq,); waits when the drawing is far behind."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(qpos, dtype=np.float64).tobytes())
            self._process.stdin.flush()
            self.sent += 1
        except BrokenPipeError:
            pass  # the drawing process died; __exit__ says why

    def finish(self, on_frame: Callable[[int], None] = lambda done: None) -> bool:
        """Wait until every frame is drawn and the file is complete.

        Args:
            on_frame: called now and then with the number of frames drawn.

        Returns:
            Whether it worked; if not, `error` says why.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        for line in self._process.stdout:
            on_frame(int(line))
        if self._process.wait() != 0:
            self._log.seek(0)
            lines = [line.strip() for line in self._log if line.strip()]
            self.error = lines[-1] if lines else f"the drawing process ended with {self._process.returncode}"
        return not self.error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._process.poll() is None:  # left before `finish`
            self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(BrokenPipeError):
                pipe.close()
        self._process.wait()
        self._log.close()


def draw(path: Path) -> None:
    """Read configurations from standard input until it ends, and write the video."""
    import imageio.v2 as imageio
    import mujoco

    from asimov_gym.assets import asset_path
    from asimov_gym.rendering.offscreen import FILM, OffscreenRenderer

    model = mujoco.MjModel.from_xml_path(str(asset_path("asimov1.xml")))
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = 2.2, 130.0, -10.0
    frame_size = model.nq * np.dtype(np.float64).itemsize
    # 360 is no multiple of 16, the block size that the writer would otherwise scale the picture to.
    writer = imageio.get_writer(path, fps=FPS, codec="libx264", quality=7, macro_block_size=8)
    done = 0
    renderer = OffscreenRenderer(model, WIDTH, HEIGHT, FILM)
    with writer, closing(renderer):
        lookat = np.zeros(3)
        while len(buffer := sys.stdin.buffer.read(frame_size)) == frame_size:
            qpos = np.frombuffer(buffer)
            here = np.array([qpos[0], qpos[1], 0.6])
            # The camera glides after the robot, so that its bobbing shows.
            lookat = here if done == 0 else lookat + 0.1 * (here - lookat)
            camera.lookat[:] = lookat
            writer.append_data(renderer.draw(qpos, camera))
            done += 1
            if done % FPS == 0:
                print(done, flush=True)
    print(done, flush=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
