"""Policy files are opened, refused with the reason, and answered by onnxruntime alone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.policy import ContractError, PolicyContract, PolicyFileError, default_contract, load_policy


@pytest.fixture
def observations() -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, 1.0, (5, 80)).astype(np.float32)


def test_runner_answers_as_the_network_does(contract, policy_file, toy, observations: np.ndarray) -> None:
    policy = load_policy(policy_file(contract))
    assert policy.contract == contract
    expected = toy(80)(observations)
    answer = policy(observations)
    assert answer.shape == (5, 23) and answer.dtype == np.float32
    np.testing.assert_allclose(answer, expected, atol=1e-5)
    np.testing.assert_allclose(policy(observations[2]), expected[2], atol=1e-5)
    assert policy(observations[:0]).shape == (0, 23)


def test_runner_clips_actions_and_infer_does_not(contract, policy_file, observations: np.ndarray) -> None:
    policy = load_policy(policy_file(contract, action_clip=0.5))
    raw = policy.infer(observations)
    assert np.abs(raw).max() > 0.6
    np.testing.assert_array_equal(policy(observations), np.clip(raw, -0.5, 0.5))


def test_a_graph_of_fixed_batch_one_is_fed_row_by_row(contract, tmp_path: Path, toy, observations: np.ndarray) -> None:
    network = toy(80)
    policy = load_policy(network.save(tmp_path / "one.onnx", contract.to_metadata(), batch=1))
    np.testing.assert_allclose(policy(observations), network(observations), atol=1e-5)
    assert policy(observations[0]).shape == (23,)
    assert policy(observations[:0]).shape == (0, 23)


@pytest.mark.parametrize("shape", [(78,), (3, 81), (2, 1, 80), ()])
def test_wrong_observation_shape_is_an_error(contract, policy_file, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"takes \(80,\) or \(n, 80\)"):
        load_policy(policy_file(contract))(np.zeros(shape))


def test_a_bad_row_leaves_the_others_alone(contract, policy_file, observations: np.ndarray) -> None:
    policy = load_policy(policy_file(contract))
    expected = policy(observations)
    observations[1, 4] = np.nan
    answer = policy(observations)
    assert np.isnan(answer[1]).all()
    np.testing.assert_array_equal(np.delete(answer, 1, axis=0), np.delete(expected, 1, axis=0))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nobody\.onnx"):
        load_policy(tmp_path / "nobody.onnx")
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not a network", b"\x08\x07\x12\x00"])
def test_a_file_that_is_not_onnx(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    with pytest.raises(PolicyFileError, match="not an Asimov policy"):
        load_policy(path)


def test_a_network_without_a_contract(tmp_path: Path, toy) -> None:
    path = toy(80).save(tmp_path / "policy.onnx", {"run_path": "runs/7"})
    with pytest.raises(PolicyFileError, match=r"not an Asimov policy.*schema_version.*keys found: run_path"):
        load_policy(path)


def test_a_foreign_contract_is_refused_and_can_still_be_looked_at(contract, policy_file) -> None:
    path = policy_file(contract, joint_damping=(6.0,) * 23)
    with pytest.raises(ContractError, match=r"joint_damping\[0\] is 6.0; allowed: \[0, 5\]"):
        load_policy(path)
    assert load_policy(path, verify=False).contract.joint_damping[0] == 6.0


def test_strict_refuses_another_model(contract, policy_file) -> None:
    path = policy_file(contract, model_sha256="0" * 64)
    with pytest.warns(UserWarning, match="another robot model"):
        load_policy(path)
    with pytest.raises(ContractError, match="model_sha256"):
        load_policy(path, strict=True)


def test_graph_and_contract_must_agree(tmp_path: Path, toy) -> None:
    metadata = default_contract("asimov-80").to_metadata()
    with pytest.raises(ContractError, match="observation is '80 entries'; allowed: 78"):
        load_policy(toy(78).save(tmp_path / "narrow.onnx", metadata))
    with pytest.raises(ContractError, match="joint_names is '23 entries'; allowed: 12"):
        load_policy(toy(80, 12).save(tmp_path / "legs.onnx", metadata))


def test_foreign_graphs_are_refused(contract: PolicyContract, tmp_path: Path, toy) -> None:
    metadata, network = contract.to_metadata(), toy(80)
    with pytest.raises(PolicyFileError, match="recurrent"):
        load_policy(network.save(tmp_path / "recurrent.onnx", metadata, extra_input=True))
    with pytest.raises(PolicyFileError, match=r"\['input'\]"):
        load_policy(network.save(tmp_path / "named.onnx", metadata, input_name="input"))
    with pytest.raises(PolicyFileError, match="batches of exactly 4"):
        load_policy(network.save(tmp_path / "four.onnx", metadata, batch=4))


def test_a_network_with_non_finite_weights_is_refused(contract, tmp_path: Path, toy: Callable) -> None:
    network = toy(80)
    network.bias[5] = np.nan
    with pytest.raises(PolicyFileError, match="non-finite"):
        load_policy(network.save(tmp_path / "policy.onnx", contract.to_metadata()))


def test_running_a_policy_loads_no_learning_library(contract, policy_file) -> None:
    program = (
        "import sys; from asimov_gym.policy import PolicyDriver, load_policy; "
        f"PolicyDriver(load_policy({str(policy_file(contract))!r})); "
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'torch', 'jax', 'onnx', 'rsl_rl'}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
