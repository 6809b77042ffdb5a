"""What is wrong with the simulated hardware at the moment. Faults put it together, the modules of the firmware obey."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np


@dataclass(frozen=True)
class Condition:
    """One instant of the hardware. Motor arrays are (25,), firmware order; None where nothing is wrong.

    Times are those of the robot's clock, not of the firmware's: hardware does not know of restarts.
    """

    silent_since_us: Mapping[int, int] = field(default_factory=lambda: MappingProxyType({}))
    """Motors that do not answer on their bus, with the time of their last answer, microseconds."""
    silent: np.ndarray | None = None
    """The same motors as a mask, bool."""
    encoder_fault: np.ndarray | None = None
    """Motors whose driver reports an encoder error, bool. Their position and speed stand still."""
    leak: np.ndarray | None = None
    """Current that a motor draws beside the one that makes torque, A."""
    imu_since_us: int | None = None
    """Time of the last sample of an IMU that has stopped, microseconds."""
    policy_delay_ms: float = 0.0
    """Time added to every inference, ms."""
    policy_fails: bool = False
    """Inference raises an error."""
    wrench: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    """Pushes: force and torque at the centre of mass by body, world frame, (1, 6)."""


HEALTHY = Condition()
"""Nothing is wrong."""
