"""`Asimov-Velocity-v0`: the policy inside, waypoints, end of an episode."""

import re

import gymnasium as gym
import numpy as np
import pytest

from asimov_gym.envs import velocity_batch
from asimov_gym.policy import default_contract, load_policy

ID = "Asimov-Velocity-v0"
STOP = np.zeros(3, dtype=np.float32)


def test_the_policy_sees_the_clamped_command_at_50_hz(policy):
    seen = []
    infer = policy.infer

    def watched(observation):
        seen.append(observation.copy())
        return infer(observation)

    policy.infer = watched
    env = gym.make(ID, policy=policy)
    env.reset(seed=0)
    observation, *_, info = env.step(np.array([3.0, -0.1, 0.2], dtype=np.float32))
    assert len(seen) == 5
    assert np.allclose(seen[-1][0, 6:9], (0.8, -0.1, 0.2)), "the trained range ends at 0.8 m/s"
    assert np.allclose(info["applied_command"], (0.8, -0.1, 0.2))
    assert np.allclose(observation[58:61], (2.0, -0.1, 0.2)), "the interface's range ends at 2 m/s"
    assert info["clipped"] == 1


def test_waypoints_follow_from_the_seed_and_lie_ahead(policy):
    env = gym.make(ID, policy=policy, waypoints=3)
    for seed in range(20):
        observation, info = env.reset(seed=seed)
        waypoint = observation[56:58]
        distance = float(np.hypot(*waypoint))
        assert 1.0 - 1e-3 <= distance <= 2.5 + 1e-3
        assert distance == pytest.approx(info["distance"], abs=1e-4)
        assert abs(np.arctan2(waypoint[1], waypoint[0])) <= 1.2 + 1e-3


def test_reaching_every_waypoint_ends_the_episode(policy):
    # Waypoints closer together than the reach are reached one a step, by a robot that only stands.
    env = gym.make(ID, policy=policy, waypoints=3, config={"distance": [0.1, 0.2], "reach": 2.0})
    env.reset(seed=0)
    for count in (1, 2, 3):
        _, reward, terminated, truncated, info = env.step(STOP)
        assert reward == pytest.approx(2.0 - 0.01, abs=0.02)
        assert info["waypoints_reached"] == count
        assert terminated == info["success"] == (count == 3)
        assert not truncated


def test_time_runs_out(policy):
    env = gym.make(ID, policy=policy, episode_s=1.0)
    env.reset(seed=0)
    ends = [env.step(STOP)[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(False, True)]


def test_a_fall_ends_the_episode(policy):
    policy.infer = lambda observation: np.full((len(observation), 23), 8.0, dtype=np.float32)
    env = gym.make(ID, policy=policy)
    env.reset(seed=0)
    for _ in range(50):
        _, reward, terminated, _, info = env.step(STOP)
        if terminated:
            break
    assert terminated
    assert not info["success"]
    assert reward < -4.0


def test_gains_of_the_policy_are_used():
    contract = default_contract()
    soft = contract.from_metadata(contract.to_metadata() | {"joint_stiffness": str([1.0] * 23)})

    class Soft:
        contract = soft

        def infer(self, observation):
            return np.zeros((len(observation), 23), dtype=np.float32)

    env = gym.make(ID, policy=Soft())
    env.reset(seed=0)
    assert any(env.step(STOP)[2] for _ in range(30)), "a robot with hardly any stiffness cannot stand"


def test_a_policy_file_and_a_loaded_policy_walk_alike(policy, tmp_path):
    onnx = pytest.importorskip("onnx", reason="writing policy files needs the onnx package")
    h, float32 = onnx.helper, onnx.TensorProto.FLOAT
    weights = np.random.default_rng(0).normal(0.0, 0.02, (80, 23)).astype(np.float32)
    graph = h.make_graph(
        [h.make_node("MatMul", ["obs", "weights"], ["actions"])],
        "linear",
        [h.make_tensor_value_info("obs", float32, ["batch", 80])],
        [h.make_tensor_value_info("actions", float32, ["batch", 23])],
        [onnx.numpy_helper.from_array(weights, "weights")],
    )
    model = h.make_model(graph, opset_imports=[h.make_opsetid("", 20)], ir_version=10)
    h.set_model_props(model, policy.contract.to_metadata())
    file = tmp_path / "policy.onnx"
    onnx.save(model, file)

    by_path = gym.make(ID, policy=str(file))
    assert by_path.spec is not None
    seen = []
    for env in (by_path, gym.make(ID, policy=load_policy(file)), by_path.spec.make()):
        env.reset(seed=0)
        seen.append([env.step(np.array([0.2, 0.0, 0.1]))[0] for _ in range(3)])
    assert np.array_equal(seen[0], seen[1])
    assert np.array_equal(seen[0], seen[2])


def test_missing_policy_says_how_to_get_one(monkeypatch, tmp_path):
    with pytest.raises(FileNotFoundError, match=re.escape("nowhere.onnx")):
        gym.make(ID, policy=tmp_path / "nowhere.onnx")
    monkeypatch.setattr(velocity_batch, "_SHIPPED", ("policies", "none.onnx"))
    with pytest.raises(FileNotFoundError, match=r"policy: none was given.*python -m train ppo"):
        gym.make(ID)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policy": 5}, "policy must be a path to an ONNX file or a loaded policy, got 5"),
        ({"waypoints": 0}, r"waypoints must be a whole number in \[1, 100\], got 0"),
        ({"episode_s": float("nan")}, r"episode_s must lie in \[0.5, 1e\+06\], got nan"),
        ({"config": {"reach": 0.0}}, r"reach must lie in \[0.05, 2\], got 0.0"),
        ({"config": {"range": 1.0}}, r"unknown keys \['range'\] in config; known keys: waypoints"),
        ({"config": {"rewards": {"speed": 1.0}}}, r"unknown terms \['speed'\]; known terms: progress"),
    ],
)
def test_arguments_are_checked(policy, arguments, message):
    with pytest.raises(ValueError, match=message):
        gym.make(ID, **{"policy": policy, **arguments})


def test_nan_action(policy):
    env = gym.make(ID, policy=policy)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action\[1\] must be a finite number, got nan"):
        env.step(np.array([0.0, np.nan, 0.0]))
