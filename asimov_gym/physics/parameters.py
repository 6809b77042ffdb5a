"""Per-copy differences of the robot's body: what domain randomisation may change."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from asimov_gym.robot.joints import JOINT_NAMES, KD, KP

_TORSO = "waist_yaw_link"


@dataclass(frozen=True)
class BodyParameters:
    """Figures of N robots; None leaves the model's own. The defaults of the model are 1, 1, 1, 0 and 0."""

    foot_friction: np.ndarray | None = None
    """Sliding friction of the soles, (N,)."""
    kp_scale: np.ndarray | None = None
    """Factor on the position gains, joint order, (N, 25)."""
    kd_scale: np.ndarray | None = None
    """Factor on the damping gains, joint order, (N, 25)."""
    torso_mass: np.ndarray | None = None
    """Mass added to the torso at its centre of mass, kg, (N,)."""
    torso_com: np.ndarray | None = None
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
        self.servos = np.array([model.actuator(name.removesuffix("_joint")).id for name in JOINT_NAMES])
        self.torso = model.body(_TORSO).id
        self.kp = model.actuator_gainprm[self.servos, 0].copy()
        self.kd = -model.actuator_biasprm[self.servos, 2].copy()
        self.torso_mass = float(model.body_mass[self.torso])
        self.torso_inertia = model.body_inertia[self.torso].copy()
        self.torso_com = model.body_ipos[self.torso].copy()

    def write_gains(self, model: mujoco.MjModel, kp: np.ndarray, kd: np.ndarray) -> None:
        """Set the servo gains of one model, (25,) each."""
        model.actuator_gainprm[self.servos, 0] = kp
        model.actuator_biasprm[self.servos, 1] = -kp
        model.actuator_biasprm[self.servos, 2] = -kd

    def write(self, model: mujoco.MjModel, parameters: BodyParameters, index: int) -> None:
        """Set the figures of copy `index` in its model."""
        p = parameters
        if p.foot_friction is not None:
            model.geom_friction[self.feet, 0] = p.foot_friction[index]
        if p.kp_scale is not None or p.kd_scale is not None:
            kp = self.kp if p.kp_scale is None else self.kp * p.kp_scale[index]
            kd = self.kd if p.kd_scale is None else self.kd * p.kd_scale[index]
            self.write_gains(model, kp, kd)
        if p.torso_mass is not None:
            mass = self.torso_mass + p.torso_mass[index]
            model.body_mass[self.torso] = mass
            model.body_inertia[self.torso] = self.torso_inertia * (mass / self.torso_mass)
        if p.torso_com is not None:
            model.body_ipos[self.torso] = self.torso_com + p.torso_com[index]
