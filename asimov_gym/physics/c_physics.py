"""N robots on MuJoCo's C engine, stepped together on a thread pool."""

from __future__ import annotations

import copy
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from asimov_gym.physics.parameters import BodyParameters, ModelFigures
from asimov_gym.physics.places import JointPlaces, SensorPlaces, as_places
from asimov_gym.physics.profile import PhysicsProfile, physics_profile
from asimov_gym.physics.quantities import JointTarget, PhysicsState, Reading, are_sound, is_sound
from asimov_gym.robot.joints import JOINT_NAMES
from asimov_gym.robot.model import robot_spec
from asimov_gym.robot.terrain import Terrain

_log = logging.getLogger(__name__)

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CTRL = mujoco.mjtState.mjSTATE_CTRL
_WRENCH = mujoco.mjtState.mjSTATE_XFRC_APPLIED


class CPhysics:
    """A batch of robots under one physics profile.

    Args:
        copies: number of robots N, at least 1.
        profile: `"evaluation"`, `"training"` or a profile of your own.
        threads: size of the thread pool; the machine's cores by default, never more than N.
        parameters: per-copy body figures at the start; see `set_parameters`.
        model: a compiled model to simulate instead of the shipped one (other revision, terrain). The shipped one comes
            without its visual shapes and textures when N > 1: they weigh megabytes a copy and do nothing for the
            physics.
        dump_dir: folder for the state of diverged copies; nothing is written when None.
        trail: how many earlier moments of the joints `joint_trail` remembers.
        reading_type: floating type of readings. In the engine's own, float64, they look at its state; in another they
            are copies of it.
    """

    def __init__(
        self,
        copies: int = 1,
        profile: str | PhysicsProfile = "evaluation",
        threads: int | None = None,
        parameters: BodyParameters | None = None,
        model: mujoco.MjModel | None = None,
        dump_dir: Path | None = None,
        trail: int = 0,
        reading_type: type[np.floating] = np.float64,
    ) -> None:
        if copies < 1:
            raise ValueError(f"copies must be at least 1, got {copies}")
        if trail < 0:
            raise ValueError(f"trail must be at least 0, got {trail}")
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        self.profile = physics_profile(profile)
        self.copies = copies
        self.model = compile_model(self.profile, visuals=copies == 1) if model is None else model
        self.timestep = float(self.model.opt.timestep)
        self.figures = ModelFigures(self.model)
        self.divergences = 0
        """How often a copy had to be reset because its simulation diverged."""
        self.diverged = np.zeros(copies, dtype=bool)
        """Copies that diverged in the last step."""
        self._dump_dir = dump_dir
        self._models: list[mujoco.MjModel] | None = None
        self._joints, self._sensors = JointPlaces(self.model), SensorPlaces(self.model)
        loads = [self.model.actuator(n.removesuffix("_joint") + "_load").id for n in JOINT_NAMES]
        self._loads = as_places(np.array(loads))
        pool = min(threads or os.cpu_count() or 1, copies)
        self._datas = [mujoco.MjData(self.model) for _ in range(pool)]
        self._rollout = rollout.Rollout(nthread=pool if pool > 1 else 0)
        self._standing_sensors = self._sensors_of(*self.standing())
        n, m = copies, self.model
        # The engine's rows of time, positions and velocities: a step starts from the row in which the last one ended.
        self._rows = np.zeros((n, mujoco.mj_stateSize(m, int(_FULL))))
        self._qpos, self._qvel = slice(1, 1 + m.nq), slice(1 + m.nq, 1 + m.nq + m.nv)
        self._warmstart, self._sensed = np.zeros((n, m.nv)), np.zeros((n, m.nsensordata))
        self._reading: Reading | None = None
        self._reading_type, self._lent = np.dtype(reading_type), False
        """`_lent`: whether a reading looks at the present state."""
        self.trail = trail
        self._past = np.repeat(self._rows[:, None], trail, axis=1)
        """Rows at the `trail` physics steps before, the latest first."""
        self._due = np.zeros(n)
        """Simulated time that a sound copy has passed, s."""
        self._buffers: dict[tuple[int, int, bool], tuple[np.ndarray, ...]] = {}
        """Controls, rows and sensors of `_advance`, by substeps, width, and whether loads are ever written."""
        if parameters is not None:
            self.set_parameters(parameters)
        self.reset(*self.standing())

    def close(self) -> None:
        """Stop the thread pool."""
        self._rollout.close()

    # -- state ---------------------------------------------------------------------------------------------------------

    def standing(self) -> tuple[np.ndarray, np.ndarray]:
        """Keyframe `stand`: generalised positions (nq,) and velocities (nv,)."""
        key = self.model.key("stand")
        return key.qpos.copy(), key.qvel.copy()

    def configuration(self, joint_position: np.ndarray, base_position: np.ndarray, base_quat: np.ndarray) -> np.ndarray:
        """Generalised positions (n, nq) from joint order (n, 25), pelvis position (n, 3) and orientation (n, 4)."""
        qpos = np.broadcast_to(self.standing()[0], (len(joint_position), self.model.nq)).copy()
        qpos[:, 0:3], qpos[:, 3:7], qpos[:, self._joints.position] = base_position, base_quat, joint_position
        return qpos

    def reset(self, qpos: np.ndarray, qvel: np.ndarray, copies: np.ndarray | None = None) -> None:
        """Put copies into a state at time 0, with sensors of a robot at rest in the standing pose.

        Args:
            qpos: generalised positions, (nq,) or (n, nq).
            qvel: generalised velocities, (nv,) or (n, nv).
            copies: indices or mask of the copies; all when None.
        """
        if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
            raise ValueError("reset state must be finite: qpos or qvel holds NaN or infinity")
        where = slice(None) if copies is None else copies
        s = self._writable()
        self._rows[where] = 0.0
        s.qpos[where], s.qvel[where] = qpos, qvel
        s.warmstart[where], s.sensors[where] = 0.0, self._standing_sensors
        self._past[where] = self._rows[where, None]

    def state(self) -> PhysicsState:
        """A copy of the whole state."""
        return PhysicsState(**{name: array.copy() for name, array in vars(self._view()).items()})

    def set_state(self, state: PhysicsState) -> None:
        """Continue from a state taken with `state()` of a batch of the same size and model."""
        needed = (self.copies, self.model.nq)
        if state.qpos.shape != needed:
            raise ValueError(f"state.qpos has shape {state.qpos.shape}, this batch needs {needed}")
        for name, array in vars(self._writable()).items():
            array[...] = getattr(state, name)
        self._past[:] = self._rows[:, None]

    def kick(self, velocity: np.ndarray, copies: np.ndarray | None = None) -> None:
        """Add to the pelvis velocity, (n, 6): linear in the world frame (m/s), angular in the body frame (rad/s)."""
        self._writable().qvel[slice(None) if copies is None else copies, 0:6] += velocity

    def _view(self) -> PhysicsState:
        """The present state, not copied."""
        rows = self._rows
        return PhysicsState(rows[:, 0], rows[:, self._qpos], rows[:, self._qvel], self._warmstart, self._sensed)

    def _writable(self) -> PhysicsState:
        """The present state to be changed in place; in new arrays where a reading looks at the old ones."""
        if self._lent:
            self._rows, self._sensed, self._lent = self._rows.copy(), self._sensed.copy(), False
        self._reading = None
        return self._view()

    def joint_trail(self) -> np.ndarray:
        """Positions and velocities of the joints at the `trail` physics steps before, the latest first,
        (N, trail, 2, 25). What lies before a reset or a given state is as that state."""
        qpos, qvel = self._past[:, :, self._qpos], self._past[:, :, self._qvel]
        return np.stack([qpos[..., self._joints.position], qvel[..., self._joints.velocity]], axis=2)

    def set_timestep(self, seconds: float) -> None:
        """Physics step from now on, s; the state, solver start included, stays.

        Raises:
            ValueError: it is not above 0.
        """
        if not seconds > 0.0:
            raise ValueError(f"timestep must be above 0 s, got {seconds}")
        if seconds == self.timestep:
            return
        self.timestep = seconds
        for model in (self.model, *(self._models or ())):
            model.opt.timestep = seconds

    def specific_force(self) -> np.ndarray:
        """What the accelerometer feels at the start of the last physics step, its site's frame, m/s², (N, 3)."""
        return self._sensed[:, self._sensors.accelerometer]

    def set_parameters(self, parameters: BodyParameters, copies: np.ndarray | None = None) -> None:
        """Give copies their own body figures. The arrays have one row per copy of the whole batch."""
        if self._models is None:
            self._models = [copy.copy(self.model) for _ in range(self.copies)]
        for index in range(self.copies) if copies is None else np.arange(self.copies)[copies]:
            self.figures.write(self._models[index], parameters, int(index))

    # -- stepping ------------------------------------------------------------------------------------------------------

    def step(self, target: JointTarget, substeps: int = 1, wrench: Mapping[str, np.ndarray] | None = None) -> Reading:
        """Advance every copy by `substeps` physics steps.

        Args:
            target: joint command; arrays (N, 25) or (N, substeps, 25).
            substeps: physics steps, at least 1.
            wrench: force and torque on bodies at their centres of mass, world frame, (N, 6) by body name, held for
                the call.

        Raises:
            ValueError: a wrong shape, a value that is not finite, or an unknown body.
        """
        position = self._per_substep("position", target.position, substeps)
        load = None if target.load is None else self._per_substep("load", target.load, substeps)
        velocity = None if target.velocity is None else self._per_substep("velocity", target.velocity, substeps)
        kp = None if target.kp is None else self._per_substep("kp", target.kp, substeps)
        kd = None if target.kd is None else self._per_substep("kd", target.kd, substeps)
        forces = None if wrench is None else self._wrench(wrench)
        before = self.state() if self._dump_dir is not None else None

        if kp is None and kd is None:
            damping = self._damping() if velocity is not None else None
            self._advance(substeps, position, _feed_forward(load, velocity, damping), forces)
        else:
            self._advance_with_gains(substeps, position, velocity, load, kp, kd, forces)
        self._contain_divergence(before, target, substeps)
        return self.read()

    def read(self, copies: np.ndarray | None = None) -> Reading:
        """The present reading. Its arrays are read-only, and the same ones until the state changes.

        Args:
            copies: indices or mask of the copies to read; all when None.
        """
        if copies is not None:
            return self._assemble(self._rows[copies], self._sensed[copies])
        if self._reading is None:
            self._reading = self._assemble(self._rows, self._sensed)
        return self._reading

    def _assemble(self, state: np.ndarray, sensed: np.ndarray) -> Reading:
        rows, sensors = (part.astype(self._reading_type, copy=False) for part in (state, sensed))
        rows.flags.writeable = sensors.flags.writeable = False
        self._lent = self._lent or rows is self._rows
        qpos, qvel, places = rows[:, self._qpos], rows[:, self._qvel], self._sensors
        feet = (len(rows), 2, 3)
        reading = Reading.assemble(
            qpos,
            qvel,
            self._joints,
            joint_torque=sensors[:, places.torque],
            foot_position=sensors[:, places.foot_position].reshape(feet),
            foot_velocity=sensors[:, places.foot_velocity].reshape(feet),
            foot_up=sensors[:, places.foot_up].reshape(feet),
            foot_force=sensors[:, places.foot_force].reshape(feet),
        )
        for gathered in (reading.gravity, reading.joint_position, reading.joint_velocity):
            gathered.flags.writeable = False  # the others are views of what is read-only
        return reading

    def _advance(self, substeps: int, position: np.ndarray, load: np.ndarray | None, forces: np.ndarray | None) -> None:
        """Step with the gains that the models hold. `position`, `load`: (N, S or 1, 25); `forces`: (N, 6 nbody)."""
        n, m, start = self.copies, self.model, self._rows
        width = m.nu + (0 if forces is None else 6 * m.nbody)
        kind = substeps, width, load is not None
        if kind not in self._buffers:
            self._buffers[kind] = tuple(np.zeros((n, substeps, k)) for k in (width, start.shape[1], m.nsensordata))
        control, rows, sensed = self._buffers[kind]
        control[:, :, self.figures.servos] = position
        if load is not None:
            control[:, :, self._loads] = load
        spec = int(_CTRL)
        if forces is not None:
            spec |= int(_WRENCH)
            control[:, :, m.nu :] = forces[:, None, :]
        self._rollout.rollout(
            [self.model] * n if self._models is None else self._models,
            self._datas,
            start,
            control,
            control_spec=spec,
            skip_checks=True,
            nstep=substeps,
            initial_warmstart=self._warmstart,
            state=rows,
            sensordata=sensed,
        )
        before = start if substeps == 1 else rows[:, -2]
        self._rows, self._sensed, self._lent = rows[:, -1].copy(), sensed[:, -1].copy(), False
        if self.trail:
            passed = np.concatenate([self._past[:, ::-1], start[:, None], rows[:, :-1]], axis=1)
            self._past = passed[:, : -self.trail - 1 : -1]
        # The engine does not hand back its solver state; the last acceleration is as good a start for the next step.
        self._warmstart = (self._rows[:, self._qvel] - before[:, self._qvel]) / self.timestep
        self._due = start[:, 0] + (substeps - 0.5) * self.timestep
        self._reading = None

    def _advance_with_gains(
        self,
        substeps: int,
        position: np.ndarray,
        velocity: np.ndarray | None,
        load: np.ndarray | None,
        kp: np.ndarray | None,
        kd: np.ndarray | None,
        forces: np.ndarray | None,
    ) -> None:
        """Step with explicit gains: the models' gains are lent for the call, substep by substep if they change."""
        models = [self.model] if self._models is None and self.copies == 1 else self._own_models()
        own = [self.figures.gains(model) for model in models]
        constant = all(a is None or a.shape[1] == 1 or (a == a[:, :1]).all() for a in (kp, kd))
        runs = [slice(None)] if constant else [slice(k, k + 1) for k in range(substeps)]
        try:
            for run in runs:
                damping = np.empty((self.copies, 1, len(JOINT_NAMES)))
                run_kp, run_kd = _part(kp, run), _part(kd, run)
                for i, model in enumerate(models):
                    row_kp = own[i][0] if run_kp is None else run_kp[i, 0]
                    row_kd = own[i][1] if run_kd is None else run_kd[i, 0]
                    self.figures.write_gains(model, row_kp, row_kd)
                    damping[i, 0] = row_kd
                feed = _feed_forward(_part(load, run), _part(velocity, run), damping)
                run_position = position if position.shape[1] == 1 else position[:, run]
                self._advance(substeps if constant else 1, run_position, feed, forces)
        finally:
            for model, (model_kp, model_kd) in zip(models, own, strict=True):
                self.figures.write_gains(model, model_kp, model_kd)

    def _own_models(self) -> list[mujoco.MjModel]:
        if self._models is None:
            self._models = [copy.copy(self.model) for _ in range(self.copies)]
        return self._models

    def _damping(self) -> np.ndarray:
        """Damping gains of every copy, (N or 1, 1, 25)."""
        models = [self.model] if self._models is None else self._models
        return np.stack([self.figures.gains(model)[1] for model in models])[:, None]

    def _contain_divergence(self, before: PhysicsState | None, target: JointTarget, substeps: int) -> None:
        """Reset copies whose simulation blew up. The engine freezes such a copy, so its clock is behind."""
        rows = self._rows
        in_time = rows[:, 0] > self._due
        if in_time.all() and are_sound(rows[:, self._qpos], rows[:, self._qvel]):  # sooner known of all than of each
            self.diverged = np.zeros(self.copies, dtype=bool)
            return
        self.diverged = ~(is_sound(rows[:, self._qpos], rows[:, self._qvel]) & in_time)
        bad = np.flatnonzero(self.diverged)
        self.divergences += len(bad)
        if before is not None and self._dump_dir is not None:
            self._dump_dir.mkdir(parents=True, exist_ok=True)
            path = self._dump_dir / f"diverged_{self.divergences:06d}.npz"
            arrays: dict[str, Any] = {name: value[bad] for name, value in vars(before).items()}
            arrays |= {name: np.asarray(value)[bad] for name, value in vars(target).items() if value is not None}
            np.savez(path, substeps=substeps, **arrays)
            _log.warning("simulation of %d copies diverged; their state is in %s", len(bad), path)
        else:
            _log.warning("simulation of %d copies diverged and was reset", len(bad))
        self.reset(*self.standing(), copies=bad)

    # -- checks and buffers --------------------------------------------------------------------------------------------

    def _per_substep(self, name: str, value: np.ndarray, substeps: int) -> np.ndarray:
        """Check a target array and give it an axis of substeps, (N, S, 25), or (N, 1, 25) where it holds for all."""
        if substeps < 1:
            raise ValueError(f"substeps must be at least 1, got {substeps}")
        array = np.asarray(value, dtype=np.float64)
        flat, full = (self.copies, len(JOINT_NAMES)), (self.copies, substeps, len(JOINT_NAMES))
        if array.shape == flat:
            array = array[:, None, :]
        elif array.shape != full:
            raise ValueError(f"JointTarget.{name} has shape {array.shape}, allowed are {flat} and {full}")
        if not np.isfinite(array).all():
            copy_, _, joint = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(f"JointTarget.{name} of copy {copy_}, {JOINT_NAMES[joint]}, is not finite")
        return array

    def _wrench(self, wrench: Mapping[str, np.ndarray]) -> np.ndarray:
        forces = np.zeros((self.copies, self.model.nbody, 6))
        for name, value in wrench.items():
            body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
            if body < 0:
                known = [self.model.body(i).name for i in range(1, self.model.nbody)]
                raise ValueError(f"wrench on unknown body {name!r}; the bodies are {', '.join(known)}")
            array = np.asarray(value, dtype=np.float64)
            if array.shape != (self.copies, 6) or not np.isfinite(array).all():
                raise ValueError(f"wrench[{name!r}] must be finite with shape {(self.copies, 6)}, got {array.shape}")
            forces[:, body] = array
        return forces.reshape(self.copies, -1)

    def _sensors_of(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        data = self._datas[0]
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, data)
        return data.sensordata.copy()


def compile_model(
    profile: str | PhysicsProfile = "evaluation", visuals: bool = True, terrain: Terrain | str | None = None
) -> mujoco.MjModel:
    """The shipped robot under a physics profile.

    Args:
        profile: name or profile.
        visuals: keep the shapes and textures that only a renderer needs.
        terrain: the ground, or its name; flat when None.

    Raises:
        ValueError: the profile or the terrain is unknown.
    """
    spec = robot_spec(visuals=visuals, terrain=terrain)
    physics_profile(profile).apply(spec)
    return spec.compile()


def _part(rows: np.ndarray | None, run: slice) -> np.ndarray | None:
    """Rows (N, S or 1, 25) of a run of substeps."""
    return rows if rows is None or rows.shape[1] == 1 else rows[:, run]


def _feed_forward(
    load: np.ndarray | None, velocity: np.ndarray | None, damping: np.ndarray | None
) -> np.ndarray | None:
    """Torque beside the servo's own: `load + kd * velocity`, or None when there is none."""
    if velocity is None:
        return load
    assert damping is not None
    drive = damping * velocity
    return drive if load is None else drive + load
