"""The hardware that the firmware drives: physics, motors, pack and rope, and the senses that look at them.

It is driven one physics step at a time. The mode machine asks for a joint target; what the motors can make of it, what
rope and pushes add, and what the firmware then senses of the robot is decided here. Nothing here knows of restarts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from asimov_gym.firmware.battery import Battery
from asimov_gym.firmware.condition import HEALTHY, Condition
from asimov_gym.firmware.config import FirmwareConfig
from asimov_gym.firmware.gantry import Gantry
from asimov_gym.firmware.linkage import Linkage
from asimov_gym.firmware.modes import State
from asimov_gym.firmware.motors import Motors
from asimov_gym.firmware.sensing import Sense, Sensing, silent_joints
from asimov_gym.firmware.torque_limits import TorqueLimits
from asimov_gym.physics import CPhysics, JointTarget, Reading


class Hardware:
    """One simulated robot on its gantry. Starts hanging, in the standing pose.

    Args:
        physics: one robot, at the timestep of the control steps.
        linkage: between ankle joints and motors.
        config: gantry, motor and battery figures, and the age of the readings.
        seed: of the sensor noise.
    """

    reading: Reading
    """The robot as it is, a batch of one."""
    sense: Sense
    """The robot as the firmware senses it."""

    def __init__(self, physics: CPhysics, linkage: Linkage, config: FirmwareConfig, seed: int) -> None:
        self.physics = physics
        self.gantry = Gantry(physics.model, config.gantry)
        self.motors = Motors(config.motors, seed)
        self.battery = Battery(config.battery)
        self._linkage = linkage
        self._sensing = Sensing(linkage, physics.timestep, config.aged_readings)
        self._limits = TorqueLimits(physics.figures.kp, physics.figures.kd, linkage)
        self.diverged = False
        """Whether the simulation has diverged since this was last set to False."""
        self.hang(HEALTHY)

    def hang(self, condition: Condition) -> None:
        """Put the robot where it boots: standing pose, at rest, hanging (on its feet without a gantry)."""
        qpos, qvel = self.physics.standing()
        qpos[2] += self.gantry.hang_lift
        self.physics.reset(qpos, qvel)
        self.gantry.rehang()
        self._sensing.forget()
        self.look(condition)
        self.motor_torque = self._drive_torque()
        """Of the drives in the last step, N·m, (25,), firmware order."""

    def wake(self, condition: Condition) -> None:
        """The firmware boots: sense the robot as it stands, whatever the steps before were like."""
        self.look(condition)
        self.motor_torque = self._drive_torque()
        self.diverged = False

    def look(self, condition: Condition) -> None:
        """Sense the robot anew: it may have been pushed or moved since the last step."""
        self.reading = self.physics.read()
        self._sense(condition)

    def remember(self) -> None:
        """A control step begins: the robot as it is becomes history, which aged readings are made of."""
        self._sensing.remember(self.reading, self.motors.current, self.motors.temperature)

    def step(self, target: JointTarget, condition: Condition, state: State, ramp: float) -> None:
        """Run one physics step and sense the robot after it.

        Args:
            target: what the mode asks of the joints, arrays (1, 25).
            condition: of the hardware.
            state: of the mode machine, which the gantry's winch follows.
            ramp: share of the stand ramp that is done, 0 to 1.
        """
        dt = self.physics.timestep
        wrench = self.gantry.wrench(state, ramp, self.reading, dt)
        target = self._feasible(target, condition)
        self.reading = self.physics.step(target, 1, _sum_wrenches(wrench, condition.wrench))
        self.motor_torque = self._drive_torque()
        self.motors.step(self.motor_torque, dt, condition.leak)
        if self.battery.due(dt):
            speed = self._linkage.motor_velocity(self.reading.joint_velocity[0], self.reading.joint_position[0])
            self.battery.sample(self.motor_torque, speed)
        self._sense(condition)
        self.diverged |= bool(self.physics.diverged[0])

    def _sense(self, condition: Condition) -> None:
        self.sense = self._sensing.look(self.reading, self.motors.current, self.motors.temperature, condition)

    def _drive_torque(self) -> np.ndarray:
        return self._linkage.motor_torque(self.reading.joint_torque[0], self.reading.joint_position[0])

    def _feasible(self, target: JointTarget, condition: Condition) -> JointTarget:
        """What the motors can make of a target, at the torque that their speed leaves and without the silent ones."""
        target = self._limits.apply(target, self.reading.joint_position, self.reading.joint_velocity)
        if condition.silent is None:
            return target
        alive = ~silent_joints(condition.silent)[None]
        figures = self.physics.figures
        kp = figures.kp if target.kp is None else target.kp
        kd = figures.kd if target.kd is None else target.kd
        return replace(target, kp=kp * alive, kd=kd * alive, load=None if target.load is None else target.load * alive)


def _sum_wrenches(
    rope: dict[str, np.ndarray] | None, pushes: Mapping[str, np.ndarray]
) -> Mapping[str, np.ndarray] | None:
    """Force and torque of rope and pushes together, by body."""
    if not pushes:
        return rope
    total = dict(pushes)
    for body, wrench in (rope or {}).items():
        total[body] = total.get(body, 0.0) + wrench
    return total
