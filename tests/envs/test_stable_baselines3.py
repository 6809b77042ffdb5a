"""Stable-Baselines3's PPO runs on each environment."""

import gymnasium as gym
import pytest

sb3 = pytest.importorskip("stable_baselines3", reason="needs stable-baselines3: pip install 'asimov-gym[test]'")


@pytest.mark.parametrize("steps", [256, pytest.param(2000, marks=pytest.mark.slow)])
def test_ppo_learns_from_it(env_id, arguments, steps):
    env = gym.make(env_id, **arguments)
    kind = "MultiInputPolicy" if isinstance(env.observation_space, gym.spaces.Dict) else "MlpPolicy"
    learner = sb3.PPO(kind, env, n_steps=128, batch_size=64, n_epochs=2, device="cpu", seed=0)
    before = [p.detach().clone() for p in learner.policy.parameters()]
    learner.learn(steps)
    after = list(learner.policy.parameters())
    assert all(p.isfinite().all() for p in after)
    assert any((a != b).any() for a, b in zip(before, after, strict=True))
    assert learner.num_timesteps >= steps
