"""The gantry: a rope from a trolley overhead to the robot's torso, as on a test bench.

STAND does not balance and a limp robot falls, so the real machine boots hanging. The rope is pure tension: a spring and
a damper that pull straight up at one point of the torso, above the centre of mass of the standing robot, and only while
that point is below the height at which the rope is taut. The trolley follows the robot in x and y; while the rope is
loaded its drag, in proportion to the load, slows sideways motion and turning, so that a hanging robot comes to rest. A
slack rope does nothing at all, exactly.

Figures are ours; the real bench's are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from asimov_gym.firmware.modes import State
from asimov_gym.physics import Reading
from asimov_gym.robot.joints import joint_index

GantryMode = Literal["auto", "hold", "off"]


@dataclass(frozen=True)
class GantryConfig:
    """Figures of the gantry. Heights are those of the torso point, relative to the standing robot's."""

    mode: GantryMode = "auto"
    """`auto`: hangs the robot in DAMP, lowers it in STAND, slack in MOVE. `hold`: always hangs it. `off`: no rope."""
    clearance: float = 0.06
    """Height of a hanging robot above the standing one, m: enough for straight, limp legs."""
    stand_slack: float = 0.05
    """Drop until the rope catches in STAND, m."""
    move_slack: float = 0.45
    """Drop until the rope catches in MOVE, m. With this much a topple passes the 60 degrees that the firmware calls a
    fall before the rope holds it. On a shorter rope (0.3 m) the robot comes to hang at 45 to 50 degrees and stays in
    MOVE until it is damped."""
    lower_from: float = 0.65
    """Share of the stand ramp after which the winch lowers a hanging robot: the feet should land in the final pose."""
    loaded_speed: float = 0.15
    """Speed of the winch while the rope is loaded, m/s."""
    slack_speed: float = 1.0
    """Speed of the winch while the rope is slack, m/s."""
    stiffness: float = 10_000.0
    """N/m."""
    damping: float = 800.0
    """N·s/m; acts only while the rope is taut, and never pushes."""
    trolley_drag: float = 100.0
    """Sideways drag at a load of the robot's weight, N·s/m."""
    yaw_drag: float = 4.0
    """Drag against turning at a load of the robot's weight, N·m·s/rad."""
    height: float = 0.3
    """Height of the rope's point above the torso's origin, m: the shoulders."""

    def __post_init__(self) -> None:
        if self.mode not in get_args(GantryMode):
            raise ValueError(f"gantry mode must be one of {', '.join(get_args(GantryMode))}, got {self.mode!r}")
        for name, value in vars(self).items():
            if name != "mode" and not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"gantry {name} must be a finite number >= 0, got {value!r}")


class Gantry:
    """A rope on one robot.

    Args:
        model: the robot's model; gives the torso's place, the robot's weight and its standing pose (keyframe `stand`).
        config: figures.
    """

    BODY = "waist_yaw_link"
    """The body that the rope is tied to: the torso."""

    def __init__(self, model: mujoco.MjModel, config: GantryConfig) -> None:
        self.config = config
        body = model.body(self.BODY)
        self._torso = body.pos.copy()
        self._mass_centre = body.ipos.copy()
        self._waist = joint_index("waist_yaw_joint")
        self._weight = -float(model.opt.gravity[2] * model.body_subtreemass[0])
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        offset = float(data.subtree_com[0][0] - data.body(self.BODY).xpos[0])
        self._point = np.array([offset, 0.0, config.height])
        self._stand_height = float(data.body(self.BODY).xpos[2]) + config.height
        self.taut_height = self._goal(State.DAMP, 0.0)
        """Height of the torso point at which the rope becomes taut, m."""
        self.force = 0.0
        """Tension in the last step, N."""

    @property
    def hang_lift(self) -> float:
        """How much higher than standing the pelvis is when the robot hangs, m; 0 without a rope."""
        return 0.0 if self.config.mode == "off" else self.config.clearance

    def rehang(self) -> None:
        """Wind the rope to hanging height at once."""
        self.taut_height = self._goal(State.DAMP, 0.0)
        self.force = 0.0

    def wrench(self, state: State, ramp: float, reading: Reading, dt: float) -> dict[str, np.ndarray] | None:
        """Move the winch for one step and give the rope's pull.

        Args:
            state: present state of the mode machine.
            ramp: share of the stand ramp that is done, 0 to 1; only read in STAND.
            reading: the robot now, a batch of one.
            dt: step, s.

        Returns:
            Force and torque on the torso at its centre of mass, world frame, (1, 6) by body name; None when slack.
        """
        self.force = 0.0 if self.config.mode == "off" else self._pull(self._goal(state, ramp), reading, dt)
        if self.force == 0.0:
            return None
        rotation = _rotation(reading.base_quat[0]) @ _yaw(reading.joint_position[0, self._waist])
        velocity = self._velocity(reading)
        share = min(1.0, self.force / self._weight)
        drag = -share * self.config.trolley_drag * velocity[:2]
        force = np.array([drag[0], drag[1], self.force])
        torque = np.cross(rotation @ (self._point - self._mass_centre), force)
        torque[2] -= share * self.config.yaw_drag * self._turning(reading)
        return {self.BODY: np.concatenate([force, torque])[None]}

    def _goal(self, state: State, ramp: float) -> float:
        """Taut height that the winch runs to in a state of the machine."""
        if self.config.mode == "hold" or state is State.DAMP:
            return self._stand_height + self.config.clearance + self._weight / max(self.config.stiffness, 1.0)
        if state is not State.STAND:
            return self._stand_height - self.config.move_slack
        lowered = self._stand_height - self.config.stand_slack
        return lowered if ramp >= self.config.lower_from else max(lowered, self.taut_height)

    def _pull(self, goal: float, reading: Reading, dt: float) -> float:
        """Run the winch towards `goal` for `dt` and return the tension, N."""
        speed = self.config.loaded_speed if self.force > 0.0 else self.config.slack_speed
        travel = goal - self.taut_height
        self.taut_height += float(np.clip(travel, -speed * dt, speed * dt))
        stretch = self.taut_height - self._height(reading)
        if stretch <= 0.0:
            return 0.0
        return max(0.0, self.config.stiffness * stretch - self.config.damping * float(self._velocity(reading)[2]))

    def _arm(self, reading: Reading) -> np.ndarray:
        """From the pelvis origin to the rope's point, world frame."""
        local = self._torso + _yaw(reading.joint_position[0, self._waist]) @ self._point
        return _rotation(reading.base_quat[0]) @ local

    def _height(self, reading: Reading) -> float:
        return float(reading.base_position[0, 2] + self._arm(reading)[2])

    def _velocity(self, reading: Reading) -> np.ndarray:
        """Velocity of the rope's point, world frame. The waist's own turning moves it by millimetres and is left
        out."""
        spin = _rotation(reading.base_quat[0]) @ reading.gyro[0]
        return reading.base_velocity[0] + np.cross(spin, self._arm(reading))

    def _turning(self, reading: Reading) -> float:
        """Yaw rate of the torso about the world's z axis, rad/s."""
        return float((_rotation(reading.base_quat[0]) @ reading.gyro[0])[2] + reading.joint_velocity[0, self._waist])


def _rotation(quat: np.ndarray) -> np.ndarray:
    """Rotation matrix, body to world, of a unit quaternion (w, x, y, z)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _yaw(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
