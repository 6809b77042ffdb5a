"""The robot at a glance, for people at its console: what telemetry does not carry, too."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from asimov_gym.edge.events import describe
from asimov_gym.edge.robot import SimulatedRobot
from asimov_gym.firmware import MICROSECONDS, StepClock

RECENT_STEPS = 2000
"""Control steps over which the lateness is taken: ten seconds."""


def robot_status(robot: SimulatedRobot) -> dict[str, Any]:
    """What the robot is doing, as it goes into JSON. Call with the edge's lock held, or live with a torn picture.

    Keys: `state` (DAMP, STAND, MOVE/POLICY, MOVE/TRAJECTORY), `running_s` (the robot's clock), `uptime_s` (the
    firmware's, which a restart resets), `boot`, `controller` (null for none), `alerts` (in words), `error_flags`,
    `latched`, `e_stop`, `injected` (faults that last), `gantry` (`setting`, `force_n`), `lanes`, `commands` (`taken` by
    kind, `dropped` by reason), `realtime_factor` and `lateness_ms` (null in lockstep).
    """
    state, edge = robot.firmware.snapshot, robot.edge
    holder = edge.control.holder
    lockstep = isinstance(robot.clock, StepClock)
    return {
        "state": state.state.value,
        "running_s": robot.clock.now_us() / MICROSECONDS,
        "uptime_s": state.timestamp_us / MICROSECONDS,
        "boot": state.boot,
        "controller": None if holder is None else holder.name,
        "alerts": [describe(alert) for alert in state.alerts],
        "error_flags": state.error_flags,
        "latched": state.latched,
        "e_stop": state.e_stop,
        "injected": list(robot.firmware.faults.ongoing),
        "gantry": {"setting": robot.firmware.gantry.setting, "force_n": round(state.gantry_force, 1)},
        "lanes": dict(vars(edge.lanes)),
        "commands": {
            "taken": dict(edge.tally.accepted),
            "dropped": {reason.name: count for reason, count in edge.tally.dropped.items()},
        },
        "realtime_factor": None if lockstep else round(robot.realtime_factor, 3),
        "lateness_ms": None if lockstep else lateness_ms(robot),
    }


def lateness_ms(robot: SimulatedRobot, steps: int = RECENT_STEPS) -> dict[str, float]:
    """How late the latest control steps began: `p50`, `p99` and `max`, ms; zeros before the first."""
    recent = np.array(list(islice(reversed(robot.lateness_us), steps)) or [0]) / 1000.0
    p50, p99 = np.percentile(recent, (50, 99))
    return {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "max": round(float(recent.max()), 3)}
