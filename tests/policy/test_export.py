"""An exported file computes what was trained, normaliser included; one that does not is rejected loudly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from asimov_gym.policy import ContractError, default_contract, load_policy
from asimov_gym.robot.observation import LAYOUTS

pytest.importorskip("torch", reason="export needs torch, the train extra")
pytest.importorskip("onnx", reason="export needs the onnx package")
pytest.importorskip("onnxscript", reason="export needs onnxscript, the train extra")
import onnx
import torch
from onnx import numpy_helper

from train import export


class Normaliser(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return (x - 0.3) / 1.7


def actor(width: int = 80) -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(width, 32), torch.nn.ELU(), torch.nn.Linear(32, 23))


@pytest.mark.parametrize("layout", ["asimov-80", "asimov-78"])
def test_export_keeps_contract_normaliser_and_answers(tmp_path: Path, layout: str) -> None:
    contract = default_contract(layout, trained_commit="0123abc")
    network, path = actor(contract.observation.width), tmp_path / "runs" / "policy.onnx"
    report = export.export_onnx(network, contract, path, normaliser=Normaliser())
    assert report.samples == 1000 and report.difference <= 1e-5
    policy = load_policy(path, strict=True)
    assert policy.contract == contract
    observations = export.realistic_observations(contract, 7, seed=9)
    with torch.no_grad():
        expected = network(Normaliser()(torch.from_numpy(observations))).numpy()
    np.testing.assert_allclose(policy.infer(observations), expected, atol=1e-5)
    assert network.training, "the actor's mode is restored"
    assert [entry.name for entry in path.parent.iterdir()] == ["policy.onnx"], "one file, weights inside"


def test_a_78_export_carries_the_makers_keys(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    export.export_onnx(actor(78), default_contract("asimov-78"), path, samples=10)
    metadata = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert metadata["deploy_metadata_version"] == "1" and metadata["obs_dim"] == "78"
    assert json.loads(metadata["observation_names"])[3] == "joint_pos_slot01"


def test_export_of_an_rsl_rl_actor_takes_its_normaliser(tmp_path: Path, contract) -> None:
    models = pytest.importorskip("rsl_rl.models.mlp_model", reason="needs rsl-rl-lib, the train extra")
    from tensordict import TensorDict

    def batch(rows: int) -> TensorDict:
        return TensorDict({"actor": 2.0 * torch.randn(rows, 80) + 1.0}, batch_size=[rows])

    torch.manual_seed(1)
    noise = {"class_name": "rsl_rl.modules.distribution.GaussianDistribution", "init_std": 1.0}
    model = models.MLPModel(batch(2), {"actor": ["actor"]}, "actor", 23, (32, 32), "elu", True, noise)
    for _ in range(3):
        model.update_normalization(batch(64))
    model(batch(4), stochastic_output=True)  # as after a rollout: the distribution holds tensors with gradients
    export.export_onnx(model, contract, tmp_path / "policy.onnx")
    observations = export.realistic_observations(contract, 5, seed=2)
    with torch.no_grad():
        expected = model.eval()(TensorDict({"actor": torch.from_numpy(observations)}, batch_size=[5])).numpy()
    np.testing.assert_allclose(load_policy(tmp_path / "policy.onnx").infer(observations), expected, atol=1e-5)


def test_exported_files_tell_nothing_of_the_machine(tmp_path: Path, contract) -> None:
    path = tmp_path / "policy.onnx"
    export.export_onnx(actor(), contract, path, samples=10)
    content = path.read_bytes()
    for trace in (b"stack_trace", b".py", str(tmp_path).encode()):
        assert trace not in content
    model = onnx.load(path)
    assert [entry.name for entry in model.graph.input] == ["obs"]
    assert model.graph.input[0].type.tensor_type.shape.dim[0].dim_param


def corrupt(monkeypatch: pytest.MonkeyPatch, value: float) -> None:
    """Make the exporter write a graph with one weight changed."""
    original = export._graph

    def damaged(network: torch.nn.Module, contract):
        model = original(network, contract)
        weights = model.graph.initializer[0]
        array = numpy_helper.to_array(weights).copy()
        array.flat[0] += value
        weights.CopyFrom(numpy_helper.from_array(array, weights.name))
        return model

    monkeypatch.setattr(export, "_graph", damaged)


def test_a_corrupted_graph_fails_loudly_and_replaces_nothing(tmp_path: Path, contract, monkeypatch) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(b"the previous export")
    corrupt(monkeypatch, 0.01)
    with pytest.raises(
        export.ExportParityError, match=r"differs .* by .*observation \d+, \w+_joint.*policy\.rejected\.onnx"
    ) as caught:
        export.export_onnx(actor(), contract, path)
    assert path.read_bytes() == b"the previous export"
    assert caught.value.difference > 1e-5
    assert load_policy(caught.value.rejected).contract == contract, "the faulty file is there to be looked at"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["policy.onnx", "policy.rejected.onnx"]


def test_a_lost_normaliser_fails_loudly(tmp_path: Path, contract, monkeypatch) -> None:
    monkeypatch.setattr(export, "_network", lambda actor, normaliser: export._Network(actor).eval())
    with pytest.raises(export.ExportParityError):
        export.export_onnx(actor(), contract, tmp_path / "policy.onnx", normaliser=Normaliser())
    assert not (tmp_path / "policy.onnx").exists()


def test_great_outputs_are_compared_as_shares_and_small_ones_as_they_are() -> None:
    contract = default_contract()
    expected = np.full((2, 23), 0.5)
    expected[1] = 20.0
    answered = expected.copy()
    answered[1, 3] += 1e-4  # float32 steps there are 2e-6, and a layer sums a hundred of them
    difference, place = export._largest_difference(expected, answered, contract)
    assert difference == pytest.approx(5e-6) and place == f"observation 1, {contract.joint_names[3]}"
    answered[0, 5] -= 2e-5
    assert export._largest_difference(expected, answered, contract)[0] == pytest.approx(2e-5)
    for wrong in (np.nan, np.inf):
        answered[1, 7] = wrong
        assert export._largest_difference(expected, answered, contract)[0] == np.inf


def test_what_cannot_be_exported_is_refused_before_writing(tmp_path: Path, contract) -> None:
    from dataclasses import replace

    path = tmp_path / "policy.onnx"
    with pytest.raises(ContractError, match="joint_damping"):
        export.export_onnx(actor(), replace(contract, joint_damping=(9.0,) * 23), path)
    with pytest.raises(ValueError, match="samples"):
        export.export_onnx(actor(), contract, path, samples=0)
    assert not list(tmp_path.iterdir())


def test_compared_observations_are_within_the_layouts_bounds(contract) -> None:
    observations = export.realistic_observations(contract, 500, seed=0)
    layout = LAYOUTS["asimov-80"]
    assert observations.shape == (500, 80) and observations.dtype == np.float32
    assert (np.abs(observations) < layout.bounds + 1e-6).all()
    assert (observations[:, layout.slices["clock"]] == 0.0).all(axis=1).sum() > 20, "some stand"
    standing = np.zeros(80)
    standing[layout.slices["gravity"]] = (0.0, 0.0, -1.0)
    np.testing.assert_array_equal(observations[0], standing)
