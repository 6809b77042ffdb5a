"""Writing a trained actor as a policy file: one network, normaliser inside, with its contract and a proof of parity.

The file is checked before it takes its place: the trained actor and the file, run as the robot will run it, answer the
same observations, and a difference beyond the tolerance is an error. What was there before stays until then.
"""

from __future__ import annotations

import copy
import logging
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from asimov_gym.policy.contract import PolicyContract
from asimov_gym.policy.runner import INPUT, OUTPUT, load_policy
from asimov_gym.policy.vendor_metadata import file_metadata
from asimov_gym.policy.verification import verify_contract
from asimov_gym.robot import gait_clock
from asimov_gym.robot.joints import RANGE, VELOCITY_LIMIT
from asimov_gym.robot.observation import observation_layout

OPSET = 20
"""ONNX operator set, the newest that current onnxruntime releases have long supported."""


class ExportParityError(RuntimeError):
    """The exported network does not compute what the trained one does.

    Attributes:
        difference: largest difference between the two outputs, as `export_onnx` measures it.
        rejected: the faulty file, kept for inspection.
    """

    def __init__(self, difference: float, tolerance: float, place: str, rejected: Path) -> None:
        super().__init__(
            f"the exported network differs from the trained one by {difference:.3g} ({place}), more than the "
            f"{tolerance:g} allowed. Nothing was replaced; the faulty file is {rejected}."
        )
        self.difference = difference
        self.rejected = rejected


@dataclass(frozen=True)
class ExportReport:
    """What an export measured."""

    path: Path
    samples: int
    difference: float
    """Largest difference between the trained actor's and the file's outputs, as a share of those greater than one."""


def export_onnx(
    actor: torch.nn.Module | Callable[[torch.Tensor], torch.Tensor],
    contract: PolicyContract,
    path: str | Path,
    *,
    normaliser: torch.nn.Module | None = None,
    trained: Callable[[np.ndarray], np.ndarray] | None = None,
    samples: int = 1000,
    tolerance: float = 1e-5,
    seed: int = 0,
) -> ExportReport:
    """Write `actor` to `path` with its contract, after checking that the file computes the same.

    The file maps `obs` (batch, width) to `actions` (batch, 23): the policy's mean, which the runner clips.

    Args:
        actor: maps observations (n, width) to mean actions (n, 23), both float32. A feed-forward actor of rsl-rl (with
            `as_onnx`) brings its normaliser; any other module or function is taken as it is.
        contract: what the policy was trained with.
        path: file to write; replaced in one step.
        normaliser: module applied to observations before `actor`, where the actor has none inside.
        trained: the network that was trained, where `actor` is only its image in torch; the file is compared with it.
        samples: number of observations compared.
        tolerance: largest difference allowed between the two outputs; of outputs beyond plus and minus one, as a share
            of them: float32 itself is that coarse.
        seed: seed of those observations.

    Raises:
        ContractError: this robot could not honour the contract.
        ExportParityError: the file and the actor differ.
        ValueError: `samples` or `tolerance` is not positive, or the actor is recurrent or reads several observation
            groups.
    """
    if samples < 1 or not tolerance > 0.0:
        raise ValueError(f"samples and tolerance must be positive, got {samples!r} and {tolerance!r}")
    verify_contract(contract)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    reference, network = trained or _reference(actor, normaliser), _network(actor, normaliser)
    observations = realistic_observations(contract, samples, seed)
    expected = reference(observations)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as folder:
        draft = Path(folder) / path.name
        onnx.save(_graph(network, contract), draft)
        answered = load_policy(draft, verify=False).infer(observations)
        difference, place = _largest_difference(expected, answered, contract)
        if not difference <= tolerance:  # not `>`: a NaN must fail too
            rejected = path.with_suffix(".rejected.onnx")
            os.replace(draft, rejected)
            raise ExportParityError(difference, tolerance, place, rejected)
        os.replace(draft, path)
    return ExportReport(path, samples, difference)


def realistic_observations(contract: PolicyContract, samples: int, seed: int) -> np.ndarray:
    """Observations such as a walking, stumbling or standing robot makes, float32, (samples, width).

    The first is the standing robot at rest; the others are drawn evenly from what its sensors can report: tilts to 60
    degrees, joints within their ranges, commands within the trained ones, one in eight of them a command to stand.
    """
    rng = np.random.default_rng(seed)
    layout = observation_layout(contract.observation.layout)
    tilt, azimuth = rng.uniform(0.0, np.pi / 3, samples), rng.uniform(0.0, 2.0 * np.pi, samples)
    gravity = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)], axis=-1)
    ranges = np.array(contract.command_ranges)
    command = rng.uniform(ranges[:, 0], ranges[:, 1], (samples, 3)) * (rng.random((samples, 1)) > 0.125)
    bound = 3.0 if contract.action_clip is None else min(3.0, contract.action_clip)
    senses = {
        "gyro": rng.uniform(-4.0, 4.0, (samples, 3)),
        "gravity": gravity,
        "command": command,
        "joint_position": rng.uniform(RANGE[:, 0], RANGE[:, 1], (samples, len(RANGE))),
        "joint_velocity": rng.uniform(-1.0, 1.0, (samples, len(RANGE))) * VELOCITY_LIMIT,
        "action": rng.uniform(-bound, bound, (samples, len(contract.joint_names))),
    }
    moving = gait_clock.is_moving(command, contract.standing_threshold)
    senses["clock"] = gait_clock.signal(rng.uniform(0.0, 2.0 * np.pi, samples), moving)
    observations = layout.observe(**senses)
    observations[0] = 0.0
    observations[0, layout.slices["gravity"]] = (0.0, 0.0, -1.0)
    return observations


class _Network(torch.nn.Module):
    """Observation to mean action, as one module."""

    def __init__(self, *stages: Callable[[torch.Tensor], torch.Tensor]) -> None:
        super().__init__()
        # Stages that are modules must be registered, so that their weights travel with this one.
        self._modules_held = torch.nn.ModuleList([s for s in stages if isinstance(s, torch.nn.Module)])
        self._stages = stages

    def forward(self, obs: torch.Tensor) -> torch.Tensor:
        for stage in self._stages:
            obs = stage(obs)
        return obs


def _network(actor: Any, normaliser: torch.nn.Module | None) -> torch.nn.Module:
    """A copy of the actor for export: on the CPU, float32, evaluating."""
    is_rsl_rl = hasattr(actor, "as_onnx")
    stages = [actor.as_onnx(verbose=False) if is_rsl_rl else actor]
    if normaliser is not None:
        stages.insert(0, normaliser)
    return _Network(*(copy.deepcopy(stage) for stage in stages)).cpu().float().eval()


def _reference(actor: Any, normaliser: torch.nn.Module | None) -> Callable[[np.ndarray], np.ndarray]:
    """The trained actor itself, not the copy that is exported: else a fault of the copying would go unseen."""
    modules = [stage for stage in (normaliser, actor) if isinstance(stage, torch.nn.Module)]
    first = next((tensor for module in modules for tensor in module.parameters()), torch.empty(0))
    groups = getattr(actor, "obs_groups", None) if hasattr(actor, "as_onnx") else None
    if getattr(actor, "is_recurrent", False):
        raise ValueError("the actor is recurrent; a policy file holds a network without memory")
    if groups is not None and len(groups) != 1:
        raise ValueError(f"the actor must read one observation group, the layout's vector; it reads {list(groups)}")

    def run(observations: np.ndarray) -> np.ndarray:
        batch = torch.from_numpy(observations).to(first.device)
        with torch.inference_mode(), _evaluating(modules), _full_float32():
            batch = batch if normaliser is None else normaliser(batch)
            if groups is not None:
                from tensordict import TensorDict

                batch = TensorDict({groups[0]: batch}, batch_size=[len(batch)])
            return actor(batch).cpu().numpy()

    return run


@contextmanager
def _evaluating(modules: list[torch.nn.Module]) -> Iterator[None]:
    """Evaluation mode inside, each module's own mode again after."""
    modes = [module.training for module in modules]
    for module in modules:
        module.eval()
    try:
        yield
    finally:
        for module, training in zip(modules, modes, strict=True):
            module.train(training)


@contextmanager
def _full_float32() -> Iterator[None]:
    """Matrix products in full float32: on NVIDIA GPUs the shorter TF32 would differ by more than the tolerance."""
    saved = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(saved)


def _graph(network: torch.nn.Module, contract: PolicyContract) -> onnx.ModelProto:
    """The network as an ONNX model with a free batch size and the contract in its metadata."""
    example = torch.zeros(2, contract.observation.width)  # two rows: one would be taken for a fixed size
    with _quiet_exporter():
        program = torch.onnx.export(
            network,
            (example,),
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None  # with dynamo=True a program is returned
    model = program.model_proto
    _strip(model)
    onnx.helper.set_model_props(model, file_metadata(contract))
    onnx.checker.check_model(model, full_check=True)
    return model


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Without torch's remarks on its own internals and on packages that this network has no use for."""
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            yield
    finally:
        logger.setLevel(level)


def _strip(model: onnx.ModelProto) -> None:
    """Remove the exporter's notes: stack traces with the paths of the machine that ran it."""
    del model.graph.metadata_props[:]
    model.graph.doc_string = ""
    for group in (
        model.graph.node,
        model.graph.input,
        model.graph.output,
        model.graph.value_info,
        model.graph.initializer,
    ):
        for entry in group:
            del entry.metadata_props[:]
            entry.doc_string = ""


def _largest_difference(expected: np.ndarray, answered: np.ndarray, contract: PolicyContract) -> tuple[float, str]:
    """Largest difference of two outputs (n, 23), of great ones as a share of them, and where it is, in words."""
    expected = expected.astype(np.float64)
    difference = np.abs(expected - answered.astype(np.float64)) / np.maximum(1.0, np.abs(expected))
    difference = np.where(np.isnan(difference), np.inf, difference)
    row, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    return float(difference[row, column]), f"observation {row}, {contract.joint_names[column]}"
