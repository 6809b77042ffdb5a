"""When which body of which robot is pushed, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from asimov_gym.evaluation.results import Outcome, PushOutcome
from asimov_gym.evaluation.rows import Push
from asimov_gym.evaluation.scenario import Trial
from asimov_gym.robot.observation import POLICY_RATE_HZ


class PushSchedule:
    """The pushes of a rollout, one robot for each trial.

    Forces are held for a policy step of 20 ms. A push that begins or ends within one acts through it with a part of its
    force, so that its impulse is force times duration.
    """

    def __init__(self, trials: Sequence[Trial]) -> None:
        self._robots = len(trials)
        self._by_step: dict[int, list[tuple[int, str, np.ndarray]]] = {}
        for robot, trial in enumerate(trials):
            for push in trial.scenario.pushes:
                for step, share in _shares(push):
                    force = share * np.array([*(push.force * np.array(push.direction)), *push.torque])
                    self._by_step.setdefault(step, []).append((robot, push.body, force))

    def wrench(self, step: int, robots: np.ndarray) -> Mapping[str, np.ndarray] | None:
        """Force (N) and torque (N·m) in a policy step, world frame, (k, 6) by body name; None where there is none.

        Args:
            step: policy step.
            robots: the robots that are asked for, ascending, (k,) int.
        """
        wrench: dict[str, np.ndarray] = {}
        for robot, body, force in self._by_step.get(step, ()):
            row = int(np.searchsorted(robots, robot))
            if row < len(robots) and robots[row] == robot:
                wrench.setdefault(body, np.zeros((len(robots), 6)))[row] += force
        return wrench or None


def _shares(push: Push) -> list[tuple[int, float]]:
    """Policy steps in which a push acts, and the share of each that it fills."""
    begin, end = push.t * POLICY_RATE_HZ, (push.t + push.duration) * POLICY_RATE_HZ
    steps = range(int(begin + 1e-9), int(np.ceil(end - 1e-9)))
    return [(step, min(end, step + 1.0) - max(begin, float(step))) for step in steps]


def push_outcomes(pushes: Sequence[Push], end_s: float | None) -> tuple[PushOutcome, ...]:
    """What came of each push of a trial.

    Args:
        pushes: in order of time.
        end_s: when the robot fell, or its trial ended early; None where it came through.
    """
    outcomes = []
    for i, push in enumerate(pushes):
        later = [other.t for other in pushes[i + 1 :] if other.t > push.t]
        outcome: Outcome = "passed"
        if end_s is not None and end_s <= push.t:
            outcome = "skipped"
        elif end_s is not None and (not later or end_s <= later[0]):
            outcome = "failed"
        outcomes.append(
            PushOutcome(
                label=push.label or f"{push.body} {push.force:g} N",
                body=push.body,
                direction=push.direction,
                force=push.force,
                at_s=push.t,
                tier=push.tier,
                outcome=outcome,
            )
        )
    return tuple(outcomes)
