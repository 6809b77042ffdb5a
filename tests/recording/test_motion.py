"""Recorded movement: leg odometry, and reference motions for the trajectory environment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from asimov_gym.assets import asset_path
from asimov_gym.edge import EdgeListener, SimulatedRobot, connect
from asimov_gym.recording import STATE, Recorder, read_recording
from asimov_gym.recording import motion as motions
from asimov_gym.recording.motion import reference_motion
from asimov_gym.recording.odometry import estimate_motion
from asimov_gym.recording.series import read_telemetry, read_velocity_commands
from asimov_gym.robot.frames import heading, to_heading, yaw_rate
from asimov_gym.robot.joints import MOTOR_NAMES, RANGE, VELOCITY_LIMIT
from asimov_gym.tasks.trajectory import MotionError, load_motion, save_motion

DT = 0.02


class Truth(EdgeListener):
    """Height, velocity and joints of the robot as the physics has them, whenever it reports."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self.height: list[float] = []
        self.velocity: list[np.ndarray] = []
        self.joints: list[np.ndarray] = []

    def on_robot_state(self, timestamp_us: int, packet: bytes, report: bool) -> None:
        reading = self._robot.physics.read()
        level = to_heading(heading(reading.base_quat[0]), reading.base_velocity[0])
        self.height.append(float(reading.base_position[0, 2]))
        self.velocity.append(np.array([level[0], level[1], yaw_rate(reading.gravity[0], reading.gyro[0])]))
        self.joints.append(reading.joint_position[0].copy())


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """Stand for 2.5 s, walk forward until 5.5 s, turn until 7.5 s."""
    path = tmp_path_factory.mktemp("walk") / "walk.mcap"
    robot = SimulatedRobot(asset_path("policies", "asimov_walk.onnx"))
    truth = Truth(robot)
    robot.edge.attach(truth)
    session = connect(robot, "tester")
    with Recorder(path, robot.edge, robot_state=True):
        session.stand()
        robot.advance(2.5)
        session.velocity(0.3)
        robot.advance(3.0)
        session.velocity(0.0, 0.0, 0.5)
        robot.advance(2.0)
    return path, truth


def test_both_topics_give_the_same_series(walk: tuple[Path, Truth], tmp_path: Path) -> None:
    """Dialect io exchanges the neck motors: the series must not."""
    robot = SimulatedRobot()
    path = tmp_path / "run.mcap"
    with Recorder(path, robot.edge, robot_state=True), connect(robot, "tester") as session:
        pose = np.array(session.state.get().joint_pos)
        pose[[MOTOR_NAMES.index("Neck_Pitch"), MOTOR_NAMES.index("Neck_Yaw")]] = 0.2, -0.4
        for _ in range(10):
            session.trajectory(pose)
            robot.advance(0.1)
    frames = [entry.message for entry in read_recording(path, [STATE])]
    series = read_telemetry(path)
    assert series.motor_position.shape == (200, 25)
    every = series.motor_position[19::20]
    assert np.allclose(every, [frame.joint_pos for frame in frames])  # type: ignore[attr-defined]
    assert every[-1, MOTOR_NAMES.index("Neck_Yaw")] == pytest.approx(-0.4, abs=0.05)


def test_odometry_tells_velocity_and_height(walk: tuple[Path, Truth]) -> None:
    path, truth = walk
    motion = estimate_motion(read_telemetry(path))
    true = np.array(truth.velocity)
    for start, stop in ((900, 1100), (1300, 1500)):  # a second of each: two of the robot's steps
        error = motion.velocity[start:stop].mean(axis=0) - true[start:stop].mean(axis=0)
        assert np.abs(error[:2]).max() < 0.03 and abs(error[2]) < 0.02
    assert np.abs(motion.qpos[500:, 2] - np.array(truth.height)[500:]).max() < 0.02
    assert motion.qpos[1099, 0] - motion.qpos[499, 0] == pytest.approx(float(true[499:1099, 0].sum() * 0.005), abs=0.1)
    poses = motion.poses(0.04)
    assert len(poses) == 188 and np.allclose(np.linalg.norm(poses[:, 3:7], axis=1), 1.0)
    assert np.abs(poses[10] - motion.qpos[80]).max() < 1e-6


def test_velocity_commands_over_time(walk: tuple[Path, Truth]) -> None:
    commands = read_velocity_commands(walk[0])
    assert commands.time == pytest.approx([2.5, 5.5])
    assert np.allclose(commands.velocity, [[0.3, 0.0, 0.0], [0.0, 0.0, 0.5]])


@pytest.mark.parametrize("narrower", [1.0, 0.3])
def test_a_motion_follows_the_recorded_joints(
    walk: tuple[Path, Truth], narrower: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within the joints' ranges: with narrower ones the walk leans on them."""
    path, truth = walk
    limits = RANGE.mean(axis=1, keepdims=True) + narrower * (RANGE - RANGE.mean(axis=1, keepdims=True))
    monkeypatch.setattr(motions, "RANGE", limits)
    motion = reference_motion(path, 3.0, 5.0)
    assert motion.frames.shape[1] == 25 and motion.dt == DT
    recorded = np.array(truth.joints)[599:1000:4]  # the first message is a command at 0 s, the first sample at 5 ms
    within = np.clip(recorded, limits[:, 0], limits[:, 1])
    assert np.abs(motion.frames[: len(recorded)] - within).max() < 1e-6
    assert narrower == 1.0 or np.abs(within - recorded).max() > 1e-3
    assert motion.duration >= 3.0, "two seconds, and one for the way back"
    assert (np.abs(motion.velocities) <= VELOCITY_LIMIT).all()


def test_a_motion_from_telemetry_at_10_hz_is_close(walk: tuple[Path, Truth], tmp_path: Path) -> None:
    """A stride of the robot lasts 0.7 s: the speeds at the samples make up for their distance."""
    robot = SimulatedRobot(asset_path("policies", "asimov_walk.onnx"))
    session = connect(robot, "tester")
    with Recorder(tmp_path / "sparse.mcap", robot.edge):
        session.stand()
        robot.advance(2.5)
        session.velocity(0.3)
        robot.advance(2.0)
    assert len(read_telemetry(tmp_path / "sparse.mcap").time) == 45
    error = reference_motion(tmp_path / "sparse.mcap", 3.0, 4.0).frames - reference_motion(walk[0], 3.0, 4.0).frames
    assert 1e-5 < np.sqrt((error[:51] ** 2).mean()) < 0.03


def test_the_environment_takes_a_recorded_motion(walk: tuple[Path, Truth], tmp_path: Path) -> None:
    import gymnasium

    motion = reference_motion(walk[0], 0.5, 2.4)
    file = tmp_path / "stand.npz"
    save_motion(file, motion)
    assert np.array_equal(load_motion(str(file), DT).frames, motion.frames)
    env = gymnasium.make("Asimov-Trajectory-v0", motion=str(file))
    observation, _ = env.reset(seed=1)
    for _ in range(25):
        observation, _, terminated, _, _ = env.step(observation["reference"][1])
        assert not terminated
    env.close()


def test_what_cannot_be_a_motion_is_refused(walk: tuple[Path, Truth], tmp_path: Path) -> None:
    path, _ = walk
    for start, stop in ((-1.0, 2.0), (3.0, 3.01), (20.0, None), (1.0, 30.0)):
        with pytest.raises(ValueError, match="there is no part"):
            reference_motion(path, start, stop)
    with pytest.raises(ValueError, match=r"end in \.npz"):
        save_motion(tmp_path / "motion.yaml", reference_motion(path, 1.0, 2.0))
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    with pytest.raises(MotionError, match=r"bad\.npz is no motion"):
        load_motion(str(tmp_path / "bad.npz"), DT)
    with pytest.raises(FileNotFoundError):
        load_motion(str(tmp_path / "none.npz"), DT)
    save_motion(tmp_path / "slow.npz", reference_motion(path, 1.0, 2.0, dt=0.04))
    with pytest.raises(MotionError, match=r"dt must be 0\.02 s here, got 0\.04"):
        load_motion(str(tmp_path / "slow.npz"), DT)
