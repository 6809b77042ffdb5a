"""The ids are there after `import asimov_gym`, and Gymnasium's own checker accepts each environment."""

import subprocess
import sys
import warnings

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env

import asimov_gym
from asimov_gym.envs.velocity import VelocityEnv
from asimov_gym.envs.walk import WalkEnv
from asimov_gym.robot.observation import observation_layout
from asimov_gym.tasks.velocity.task import OBSERVATION_SLICES


def check(env: gym.Env, allowed: str | None = None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if allowed is not None:
            warnings.filterwarnings("ignore", message=allowed)
        # Rendering is tested by itself: not every machine that runs this has a renderer, few have a display.
        check_env(env.unwrapped, skip_render_check=True)


def test_checker_accepts_each_environment(env_id, arguments):
    # The two command spaces are in the robot's own units; Gymnasium would like them normalised, and that is all.
    advice = None if env_id == "Asimov-Walk-v0" else ".*recommend using a symmetric and normalized space"
    check(gym.make(env_id, **arguments), advice)


@pytest.mark.parametrize("extra", [{"layout": "asimov-78"}, {"randomise": True, "noise": True, "kicks": True}])
def test_checker_accepts_variants_of_walk(extra):
    check(gym.make("Asimov-Walk-v0", **extra))


def test_checker_accepts_trajectory_with_gains():
    env = gym.make("Asimov-Trajectory-v0", gains=True, ankle="exact", motion="arm_wiggle")
    assert env.action_space.shape == (75,)
    check(env, ".*recommend using a symmetric and normalized space")


def test_gymnasium_can_vectorise_the_single_environment(env_id, arguments):
    envs = gym.make_vec(env_id, num_envs=2, vectorization_mode="sync", **arguments)
    observation, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(observation)
    envs.close()


@pytest.mark.parametrize(
    ("env", "slices"),
    [(WalkEnv, observation_layout("asimov-80").slices), (VelocityEnv, OBSERVATION_SLICES)],
)
def test_observation_tables_have_the_right_entries(env, slices):
    for name, place in slices.items():
        assert f"{place.start}-{place.stop - 1}" in env.__doc__, name


def test_import_is_cheap():
    loaded = (
        "import sys, asimov_gym; print(*[m for m in ('mujoco', 'torch', 'jax', 'onnxruntime') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ""


def test_version_is_known():
    assert asimov_gym.__version__
