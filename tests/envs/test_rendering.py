"""Pictures: drawn where a renderer is, and an error with a way out where there is none."""

import subprocess
import sys

import gymnasium as gym
import pytest

from asimov_gym.rendering.backends import environment, headless_backend, install_line
from asimov_gym.rendering.offscreen import RenderError

DRAW = """
import gymnasium as gym, numpy as np, asimov_gym
env = gym.make("Asimov-Walk-v0", render_mode="rgb_array", camera="side")
env.reset(seed=0)
picture = env.render()
assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8, (picture.shape, picture.dtype)
assert picture.std() > 10, "the picture shows nothing"
env.step(np.ones(23, dtype=np.float32))
later = env.render()
assert not np.array_equal(picture, later) and not np.shares_memory(picture, later)
env.close()

envs = gym.make_vec("Asimov-Walk-v0", 2, "vector_entry_point", render_mode="rgb_array", width=160, height=120)
envs.reset(seed=0)
pictures = envs.render()
assert len(pictures) == 2 and pictures[0].shape == (120, 160, 3)
assert not np.array_equal(*pictures)
envs.close()
"""


def test_pictures():
    backend = headless_backend()
    if backend is None:
        pytest.skip(install_line())
    done = subprocess.run([sys.executable, "-c", DRAW], env=environment(backend), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux runs without a display")
def test_errors_without_a_display_say_what_to_do(monkeypatch):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(variable, raising=False)
    env = gym.make("Asimov-Walk-v0", render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(RenderError, match="set the environment variable MUJOCO_GL to egl"):
        env.render()
    window = gym.make("Asimov-Walk-v0", render_mode="human")
    with pytest.raises(RenderError, match=r"no display to open a window on.*render_mode='rgb_array'"):
        window.reset(seed=0)


def test_unknown_mode():
    with (
        pytest.warns(UserWarning, match="not in the possible render_modes"),
        pytest.raises(ValueError, match="render_mode must be None or one of human, rgb_array, got 'ascii'"),
    ):
        gym.make("Asimov-Walk-v0", render_mode="ascii")
