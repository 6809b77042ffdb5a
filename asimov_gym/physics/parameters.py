"""Per-copy differences of the robot's body: what domain randomisation may change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from asimov_gym.physics.places import as_places
from asimov_gym.robot.joints import JOINT_NAMES, KD, KP

_TORSO = "waist_yaw_link"


@dataclass(frozen=True)
class BodyParameters:
    """Figures of N robots; None leaves the model's own. The defaults of the model are 1, 1, 1, 0 and 0."""

    foot_friction: Any | None = None
    """Sliding friction of the soles, (N,)."""
    kp_scale: Any | None = None
    """Factor on the position gains, joint order, (N, 25)."""
    kd_scale: Any | None = None
    """Factor on the damping gains, joint order, (N, 25)."""
    torso_mass: Any | None = None
    """Mass added to the torso at its centre of mass, kg, (N,)."""
    torso_com: Any | None = None
    """Shift of the torso's centre of mass, body frame, m, (N, 3)."""

    @classmethod
    def with_gains(cls, kp: np.ndarray, kd: np.ndarray, copies: int) -> BodyParameters | None:
        """The same gains for every copy, joint order, (25,) each; None where they are the robot's own."""
        if np.array_equal(kp, KP) and np.array_equal(kd, KD):
            return None
        return cls(kp_scale=np.tile(kp / KP, (copies, 1)), kd_scale=np.tile(kd / KD, (copies, 1)))


class ModelFigures:
    """Places of the variable figures in a compiled model, and their nominal values.

    Changing mass leaves MuJoCo's precomputed constraint scalings at their nominal values; for payloads of a few
    kilograms that changes the contact softness by a few percent and nothing else.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.feet = np.array(
            [i for i in range(model.ngeom) if "_foot" in model.geom(i).name or "_toe" in model.geom(i).name]
        )
        self.servos = as_places(np.array([model.actuator(n.removesuffix("_joint")).id for n in JOINT_NAMES]))
        self.torso = model.body(_TORSO).id
        self.kp, self.kd = self.gains(model)
        self.torso_mass = float(model.body_mass[self.torso])
        self.torso_inertia = model.body_inertia[self.torso].copy()
        self.torso_com = model.body_ipos[self.torso].copy()

    def gains(self, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
        """Position and damping gains of one model's servos, (25,) each."""
        return model.actuator_gainprm[self.servos, 0].copy(), -model.actuator_biasprm[self.servos, 2]

    def write_gains(self, model: mujoco.MjModel, kp: np.ndarray, kd: np.ndarray) -> None:
        """Set the servo gains of one model, (25,) each."""
        bias = model.actuator_biasprm
        model.actuator_gainprm[self.servos, 0] = kp
        bias[self.servos, 1] = -kp
        bias[self.servos, 2] = -kd

    def write(self, model: mujoco.MjModel, parameters: BodyParameters, index: int) -> None:
        """Set the figures of copy `index` in its model."""
        p = parameters
        if p.foot_friction is not None:
            model.geom_friction[self.feet, 0] = p.foot_friction[index]
        if p.kp_scale is not None or p.kd_scale is not None:
            one = None if p.kp_scale is None else p.kp_scale[index], None if p.kd_scale is None else p.kd_scale[index]
            self.write_gains(model, *self.scaled_gains(*one))
        if p.torso_mass is not None:
            mass, inertia = self.laden_torso(p.torso_mass[index])
            model.body_mass[self.torso] = mass
            model.body_inertia[self.torso] = inertia
        if p.torso_com is not None:
            model.body_ipos[self.torso] = self.torso_com + p.torso_com[index]

    def scaled_gains(self, kp_scale: Any | None, kd_scale: Any | None) -> tuple[Any, Any]:
        """Position and damping gains under factors, (..., 25) each; the model's own where a factor is None."""
        kp = self.kp if kp_scale is None else self.kp * kp_scale
        return kp, self.kd if kd_scale is None else self.kd * kd_scale

    def laden_torso(self, added: Any) -> tuple[Any, Any]:
        """Mass of the torso with a mass added at its centre of mass, kg, and its principal inertias, (3,), kg·m²."""
        mass = self.torso_mass + added
        return mass, self.torso_inertia * (mass / self.torso_mass)
