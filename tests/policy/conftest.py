"""Policy files made on the spot with the onnx package alone: a small network whose answers are known."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asimov_gym.policy import PolicyContract, default_contract
from asimov_gym.robot.joints import KD, KP, POLICY_JOINT_NAMES, POLICY_TO_JOINT, STAND_POSITION


@dataclass(frozen=True)
class ToyNetwork:
    """actions = 3 tanh(obs @ weights + bias)."""

    weights: np.ndarray
    bias: np.ndarray

    @classmethod
    def of_width(cls, width: int, actions: int = 23) -> ToyNetwork:
        rng = np.random.default_rng(width)
        # Small weights: fed back step after step, the last action must not magnify rounding errors.
        weights = rng.normal(0.0, 0.05, (width, actions)).astype(np.float32)
        return cls(weights, rng.normal(0.0, 0.5, actions).astype(np.float32))

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return np.float32(3.0) * np.tanh(observation.astype(np.float32) @ self.weights + self.bias)

    def save(
        self,
        path: Path,
        metadata: Mapping[str, str],
        *,
        batch: int | str = "batch",
        input_name: str = "obs",
        extra_input: bool = False,
    ) -> Path:
        """Write the network as an ONNX file."""
        onnx = pytest.importorskip("onnx", reason="writing policy files needs the onnx package")
        helper, numpy_helper = onnx.helper, onnx.numpy_helper
        float32 = onnx.TensorProto.FLOAT
        width, actions = self.weights.shape
        inputs = [helper.make_tensor_value_info(input_name, float32, [batch, width])]
        if extra_input:
            inputs.append(helper.make_tensor_value_info("h_in", float32, [1, 1, 64]))
        nodes = [
            helper.make_node("Gemm", [input_name, "weights", "bias"], ["sum"]),
            helper.make_node("Tanh", ["sum"], ["bounded"]),
            helper.make_node("Mul", ["bounded", "three"], ["actions"]),
        ]
        constants = {"weights": self.weights, "bias": self.bias, "three": np.array(3.0, dtype=np.float32)}
        outputs = [helper.make_tensor_value_info("actions", float32, [batch, actions])]
        initial = [numpy_helper.from_array(value, name) for name, value in constants.items()]
        graph = helper.make_graph(nodes, "toy", inputs, outputs, initial)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
        helper.set_model_props(model, dict(metadata))
        onnx.save(model, path)
        return path


@pytest.fixture
def toy() -> Callable[..., ToyNetwork]:
    return ToyNetwork.of_width


@pytest.fixture
def contract() -> PolicyContract:
    """What this project's walking task trains, with the hash of the present model."""
    return default_contract(trained_commit="0123abc", training={"preset": "smoke", "samples": 1000})


@pytest.fixture
def policy_file(tmp_path: Path) -> Callable[..., Path]:
    """`policy_file(contract, **changes)` writes a toy policy with that contract, some fields changed."""

    def write(contract: PolicyContract, **changes: Any) -> Path:
        contract = replace(contract, **changes)
        network = ToyNetwork.of_width(contract.observation.width)
        return network.save(tmp_path / "policy.onnx", contract.to_metadata())

    return write


@pytest.fixture
def vendor_metadata() -> dict[str, str]:
    """Metadata as the robot's maker writes it for the published walking task."""
    scale, offset = [0.25] * 23, list(STAND_POSITION[POLICY_TO_JOINT])
    terms = ["base_ang_vel", "projected_gravity", "command"]
    terms += [f"joint_{kind}_slot{slots}" for kind in ("pos", "vel") for slots in ("01", "23", "45")]
    return {
        "deploy_metadata_version": "1",
        "obs_dim": "78",
        "action_dim": "23",
        "joint_names": json.dumps(list(POLICY_JOINT_NAMES)),
        "action_scale": json.dumps(scale),
        "action_offset": json.dumps(offset),
        "action_clip": "null",
        "joint_stiffness": json.dumps(list(KP[POLICY_TO_JOINT])),
        "joint_damping": json.dumps(list(KD[POLICY_TO_JOINT])),
        "sim_dt": "0.005",
        "decimation": "4",
        "policy_rate_hz": "50.0",
        "observation_names": json.dumps([*terms, "actions"]),
        "trained_commit": "32aef5c5ec11-dirty",
    }
