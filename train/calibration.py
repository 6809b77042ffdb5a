"""Command calibration: what is asked of the network so that the robot does what was asked of it.

A trained policy answers each command with a velocity of its own, the same every time: it falls short at full speed and
drifts outwards in curves, by centimetres per second. Rewards that have to weigh exactness against everything else leave
that as it is. It needs no learning: the velocity that follows each command is measured, and a small network learns the
inverse, which command to give for the velocity that is wanted. It becomes the first layer of the policy's file; file,
contract and observation stay as they are.

Measured is what the robot's model does as built, under the evaluation conditions and with every action delay, at
commands drawn at random. Whether it holds for other commands is checked on some that it was not fitted to.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from asimov_gym.envs.walk_batch import WalkBatch
from asimov_gym.evaluation.scenario import DELAYS
from asimov_gym.physics import DECIMATION, TIMESTEP
from asimov_gym.policy.contract import PolicyContract
from asimov_gym.robot import frames
from asimov_gym.robot.mirror import mirror_command
from asimov_gym.robot.observation import observation_layout
from asimov_gym.tasks.walk import WalkConfig

CALIBRATION_LAYERS = "command_layers"
"""In the names of its weights in a policy file."""
LARGEST = 0.2
"""No velocity of a command is changed by more than this, m/s and rad/s."""
_SETTLING_S, _MEASURED_S = 2.0, 8.0
_HIDDEN = 24
_BEYOND = 1.08
"""Commands are measured in so many times the trained ranges, so that none that may be given is at the edge."""
_HELD_BACK = 6
"""Of so many commands one is not fitted to."""


class MustWalk(ValueError):
    """The policy falls too often for its velocities to mean something."""


@dataclass(frozen=True)
class Measurement:
    """What a policy does with constant commands."""

    command: np.ndarray
    """(K, 3): vx and vy, m/s, and yaw rate, rad/s."""
    velocity: np.ndarray
    """Mean velocity that follows, heading frame, (K, 3)."""


@dataclass(frozen=True)
class Calibration:
    """A fitted calibration, with what it is known to be worth."""

    weights: dict[str, Any]
    """Of `CommandCalibration`, as nested lists."""
    samples: int
    """Samples that the run had trained when it was measured; with more it no longer holds."""
    commands: int
    """How many were measured."""
    before: tuple[float, float]
    """Distance of the mean velocity (m/s) and of the mean yaw rate (rad/s) from the command, mean over commands that
    it was not fitted to."""
    after: tuple[float, float]
    """The same, as the fit predicts it with the calibration."""

    def module(self, layout: str, standing_threshold: float) -> CommandCalibration:
        """As the first layer of a policy with this observation layout."""
        calibration = CommandCalibration(layout, standing_threshold)
        calibration.load_state_dict({name: torch.tensor(rows) for name, rows in self.weights.items()})
        return calibration.eval()

    def note(self) -> dict[str, Any]:
        """What a policy file's contract says of it."""
        return {"commands": self.commands, "before": list(self.before), "after": list(self.after)}

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        path.write_text(json.dumps(asdict(self)) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """Read what `save` wrote."""
        data = json.loads(path.read_text(encoding="utf-8"))
        return cls(**{**data, "before": tuple(data["before"]), "after": tuple(data["after"])})


class CommandCalibration(nn.Module):
    """Observations with another command in them: `c + g(c)`, g a small network.

    g is symmetric, so that the policy stays so, is nothing at rest, and is bounded by `LARGEST`.

    Args:
        layout: name of the observation layout.
        standing_threshold: norm of a command from which the robot walks.
    """

    place: torch.Tensor
    mirror: torch.Tensor

    def __init__(self, layout: str, standing_threshold: float) -> None:
        super().__init__()
        rows = observation_layout(layout)
        place = torch.zeros(rows.width, 3)
        place[range(*rows.slices["command"].indices(rows.width)), range(3)] = 1.0
        self.register_buffer("place", place, persistent=False)
        self.register_buffer("mirror", torch.tensor(mirror_command.signs, dtype=torch.float32), persistent=False)
        self._per_square = 1.0 / standing_threshold**2
        self.command_layers = nn.Sequential(nn.Linear(3, _HIDDEN), nn.Tanh(), nn.Linear(_HIDDEN, 3))

    def correction(self, command: torch.Tensor) -> torch.Tensor:
        """What is added to commands (n, 3)."""
        even = 0.5 * (self.command_layers(command) + self.mirror * self.command_layers(self.mirror * command))
        walking = ((command * command) @ torch.ones(3, 1, dtype=command.dtype) * self._per_square).clamp(0.0, 1.0)
        return walking * LARGEST * torch.tanh(even / LARGEST)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Observations (n, width) to observations."""
        return x + self.correction(x @ self.place) @ self.place.T


def measure(
    infer: Callable[[np.ndarray], np.ndarray],
    contract: PolicyContract,
    commands: int = 512,
    profile: str = "evaluation",
    threads: int | None = None,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Measurement:
    """Let the robot as built walk with constant commands, each with two of the action delays, and see how fast it is.

    Args:
        infer: observations (n, width) to actions (n, 23).
        contract: of the policy.
        commands: how many, spread evenly over the trained ranges and a little beyond; evenest for a power of two.
        profile: of the physics.
        threads: of the physics.
        seed: of the commands.
        progress: told how far it is, 0 to 1.

    Raises:
        MustWalk: with a tenth of the commands or more the robot fell.
    """
    low, high = _BEYOND * np.array(contract.command_ranges).T
    spread = torch.quasirandom.SobolEngine(3, scramble=True, seed=seed).draw(commands).numpy()
    drawn = (low + (high - low) * spread).astype(np.float32)
    drawn = drawn[np.linalg.norm(drawn, axis=1) > 2.0 * contract.standing_threshold]
    walk = WalkConfig(
        layout=contract.observation.layout,
        action_scale=contract.action_scale[0],
        gait_frequency_hz=contract.gait_frequency_hz or WalkConfig().gait_frequency_hz,
        standing_threshold=contract.standing_threshold,
        episode_s=1e5,
    )
    # Two of the delays that are judged, 0 to 25 ms in physics steps; on average the middle one.
    first = np.arange(len(drawn)) % DELAYS
    delay = np.concatenate([first, DELAYS - 1 - first])
    command = np.concatenate([drawn, drawn])
    batch = WalkBatch(
        walk, len(command), profile, threads, seed, randomise=False, noise=False, kicks=False, autoreset=False
    )
    try:
        everyone = np.ones(len(command), dtype=bool)
        observation, fallen = batch.restart(everyone, command)[0], ~everyone
        batch.state = replace(batch.state, delay=delay)
        total, dt = np.zeros((len(command), 3)), TIMESTEP * DECIMATION
        steps, counted = round((_SETTLING_S + _MEASURED_S) / dt), round(_MEASURED_S / dt)
        for number in range(steps):
            step = batch.step(infer(observation))
            observation, fallen = step.observation, fallen | step.terminated
            if number >= steps - counted:
                now = step.reading
                total += frames.as_command(now.base_quat, now.base_velocity, now.gravity, now.gyro) / counted
            progress((number + 1) / steps)
    finally:
        batch.close()
    stood = ~(fallen[: len(drawn)] | fallen[len(drawn) :])
    if np.mean(stood) <= 0.9:
        raise MustWalk(
            f"a policy that is calibrated must walk: with {np.sum(~stood)} of {len(drawn)} commands the robot fell"
        )
    return Measurement(drawn[stood], 0.5 * (total[: len(drawn)] + total[len(drawn) :])[stood])


def fit(measured: Measurement, contract: PolicyContract, samples: int, seed: int = 0) -> Calibration:
    """The calibration that undoes what was measured.

    Args:
        measured: with the policy as it was trained.
        contract: of the policy.
        samples: see `Calibration`.
        seed: of the first weights.
    """
    held_back = np.arange(len(measured.command)) % _HELD_BACK == 0
    module = _fitted(measured, ~held_back, contract, seed)
    before = measured.velocity - measured.command
    # Asked for what it did, the calibrated policy is given what it was given then, but for this.
    with torch.inference_mode():
        rows = torch.from_numpy(measured.velocity.astype(np.float32))
        after = measured.velocity + module.correction(rows).numpy() - measured.command
    return Calibration(
        weights={name: rows.tolist() for name, rows in module.state_dict().items()},
        samples=samples,
        commands=len(measured.command),
        before=_errors(before[held_back]),
        after=_errors(after[held_back]),
    )


def _errors(difference: np.ndarray) -> tuple[float, float]:
    planar, turning = np.hypot(difference[:, 0], difference[:, 1]), np.abs(difference[:, 2])
    return round(float(planar.mean()), 5), round(float(turning.mean()), 5)


def _fitted(measured: Measurement, used: np.ndarray, contract: PolicyContract, seed: int) -> CommandCalibration:
    """Trained on pairs of what was reached and what had to be asked for it, with their mirror images."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        module = CommandCalibration(contract.observation.layout, contract.standing_threshold).double()
    reached = torch.from_numpy(measured.velocity[used])
    missing = torch.from_numpy(measured.command[used].astype(np.float64)) - reached
    optimiser = torch.optim.LBFGS(module.parameters(), max_iter=400, history_size=30, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        value = nn.functional.smooth_l1_loss(module.correction(reached), missing, beta=0.03)
        value = value + 1e-6 * sum((p * p).sum() for p in module.parameters())
        value.backward()
        return value

    optimiser.step(loss)
    return module.float().eval()
