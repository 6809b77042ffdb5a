"""The gantry: a rope from a trolley overhead to the robot's torso, as on a test bench.

STAND does not balance and a limp robot falls, so the real machine boots hanging. The rope is pure tension: a spring and
a damper that pull straight up at one point of the torso, above the centre of mass of the standing robot, and only while
that point is below the height at which the rope is taut. The trolley follows the robot in x and y; while the rope is
loaded its drag, in proportion to the load, slows sideways motion and turning, so that a hanging robot comes to rest. A
slack rope does nothing at all, exactly.

Figures are ours; the real bench's are not published.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from asimov_gym.firmware.modes import State
from asimov_gym.physics import Reading
from asimov_gym.robot.joints import joint_index

GantryMode = Literal["auto", "hold", "off"]
HandSetting = Literal["hoist", "lower", "slack", "off", "auto"]

_Vector = tuple[float, float, float]


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
        self._torso: _Vector = tuple(body.pos.tolist())
        self._mass_centre: _Vector = tuple(body.ipos.tolist())
        self._waist = joint_index("waist_yaw_joint")
        self._weight = -float(model.opt.gravity[2] * model.body_subtreemass[0])
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        offset = float(data.subtree_com[0][0] - data.body(self.BODY).xpos[0])
        self._point: _Vector = (offset, 0.0, config.height)
        self._stand_height = float(data.body(self.BODY).xpos[2]) + config.height
        self.setting: GantryMode | HandSetting = config.mode
        """What the winch obeys: the configured mode, or the last setting `by_hand`."""
        self._retie = False
        self.taut_height = self._goal(State.DAMP, 0.0)
        """Height of the torso point at which the rope becomes taut, m."""
        self.force = 0.0
        """Tension in the last step, N."""

    @property
    def hang_lift(self) -> float:
        """How much higher than standing the pelvis is when the robot hangs, m; 0 without a rope."""
        return 0.0 if self.config.mode == "off" else self.config.clearance

    def by_hand(self, setting: HandSetting) -> None:
        """Work the winch by hand, in whatever state the robot is; `auto` gives it back to the mode machine.

        `hoist` lifts the robot off its feet, `lower` puts it on its feet with the rope just slack, `slack` gives the
        rope all the slack of MOVE, `off` unties it at once. The winch keeps its speeds.

        Raises:
            ValueError: an unknown setting.
        """
        if setting not in get_args(HandSetting):
            raise ValueError(f"gantry by hand must be one of {', '.join(get_args(HandSetting))}, got {setting!r}")
        self._retie |= self.setting == "off" and setting != "off"
        self.setting = setting

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
        if self.setting == "off":
            self.force = 0.0
            return None
        arm = self._arm(reading)
        height = float(reading.base_position[0, 2]) + arm[2]
        if self._retie:  # a rope that is tied again starts without slack and without pull
            self._retie, self.taut_height = False, height
        self._wind(self._goal(state, ramp), dt)
        stretch = self.taut_height - height
        if stretch <= 0.0:
            self.force = 0.0
            return None
        return self._pull(stretch, arm, reading)

    def _goal(self, state: State, ramp: float) -> float:
        """Taut height that the winch runs to: by hand, or in a state of the machine."""
        hanging = self._stand_height + self.config.clearance + self._weight / max(self.config.stiffness, 1.0)
        lowered = self._stand_height - self.config.stand_slack
        slack = self._stand_height - self.config.move_slack
        match self.setting:
            case "hold" | "hoist":
                return hanging
            case "lower":
                return lowered
            case "slack":
                return slack
        if state is State.DAMP:
            return hanging
        if state is not State.STAND:
            return slack
        return lowered if ramp >= self.config.lower_from else max(lowered, self.taut_height)

    def _wind(self, goal: float, dt: float) -> None:
        """Run the winch towards `goal` for `dt`."""
        reach = dt * (self.config.loaded_speed if self.force > 0.0 else self.config.slack_speed)
        self.taut_height += max(-reach, min(reach, goal - self.taut_height))

    def _pull(self, stretch: float, arm: _Vector, reading: Reading) -> dict[str, np.ndarray] | None:
        """The pull of a rope stretched by so many metres; sets `force`."""
        rotation = _rotation(reading.base_quat[0])
        gyro = reading.gyro[0].tolist()
        spin = _turn(rotation, gyro)
        velocity = [a + b for a, b in zip(reading.base_velocity[0].tolist(), _cross(spin, arm), strict=True)]
        self.force = max(0.0, self.config.stiffness * stretch - self.config.damping * velocity[2])
        if self.force == 0.0:
            return None
        share = min(1.0, self.force / self._weight)
        drag = -share * self.config.trolley_drag
        force = (drag * velocity[0], drag * velocity[1], self.force)
        cos, sin = self._waist_turn(reading)
        x, z = self._point[0] - self._mass_centre[0], self._point[2] - self._mass_centre[2]
        y = self._point[1] - self._mass_centre[1]
        lever = _turn(rotation, (cos * x - sin * y, sin * x + cos * y, z))
        torque = _cross(lever, force)
        turning = spin[2] + float(reading.joint_velocity[0, self._waist])
        yaw = torque[2] - share * self.config.yaw_drag * turning
        return {self.BODY: np.array([[*force, torque[0], torque[1], yaw]])}

    def _waist_turn(self, reading: Reading) -> tuple[float, float]:
        """Cosine and sine of the waist's angle."""
        angle = float(reading.joint_position[0, self._waist])
        return math.cos(angle), math.sin(angle)

    def _arm(self, reading: Reading) -> _Vector:
        """From the pelvis origin to the rope's point, world frame, m. The velocity of that point leaves out the waist's
        own turning, which moves it by millimetres."""
        cos, sin = self._waist_turn(reading)
        x, y, z = self._point
        tx, ty, tz = self._torso
        return _turn(_rotation(reading.base_quat[0]), (tx + cos * x - sin * y, ty + sin * x + cos * y, tz + z))


# Vectors of three are plain floats here: for a handful of numbers, 200 times a second, NumPy's calls cost more than all
# of the gantry's arithmetic.


def _rotation(quat: np.ndarray) -> tuple[_Vector, _Vector, _Vector]:
    """Rotation matrix by rows, body to world, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quat.tolist()
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def _turn(rotation: tuple[_Vector, _Vector, _Vector], v: Sequence[float]) -> _Vector:
    x, y, z = v
    (a, b, c), (d, e, f), (g, h, i) = rotation
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _cross(a: Sequence[float], b: Sequence[float]) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
