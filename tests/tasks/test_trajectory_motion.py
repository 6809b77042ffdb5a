"""Reference motions: the shipped ones, interpolation, and what is refused."""

import numpy as np
import pytest

from asimov_gym.robot.joints import STAND_POSITION, joint_index
from asimov_gym.robot.mirror import mirror_joints
from asimov_gym.tasks.trajectory.motion import MotionError, load_motion, motion_from_keyframes, motion_names

DT = 0.02
KNEE = joint_index("left_knee_joint")


def keyframes(*frames, **extra):
    return {"keyframes": [{"time": time, "joints": joints} for time, joints in frames], **extra}


BEND = keyframes((0.0, {}), (1.0, {"left_knee": 1.0}), (2.0, {}))


def test_shipped_motions():
    assert motion_names() == ("arm_wiggle", "squat")
    for name in motion_names():
        motion = load_motion(name, DT)
        assert motion.duration in (pytest.approx(4.0), pytest.approx(5.0))
        assert np.array_equal(motion.frames[0], STAND_POSITION)
        # Gentle enough for the drives: no jump between frames, the last one and the first included.
        assert np.abs(motion.frames - np.roll(motion.frames, 1, axis=0)).max() < 0.06
    squat = load_motion("squat", DT).frames
    assert np.allclose(mirror_joints(squat), squat)


def test_keyframes_are_met_at_rest():
    motion = motion_from_keyframes("bend", BEND, DT)
    assert motion.frames.shape == (100, 25)
    assert motion.frames[50, KNEE] == pytest.approx(1.0)
    assert motion.frames[25, KNEE] == pytest.approx(0.5 * (0.45 + 1.0)), "minimum jerk is symmetric in time"
    assert np.abs(motion.velocities[[0, 50], KNEE]).max() < 1e-9
    # The peak speed of a minimum-jerk reach is 15/8 of its mean speed.
    assert motion.velocities[:, KNEE].max() == pytest.approx(1.875 * 0.55, rel=0.01)
    others = np.delete(motion.frames, KNEE, axis=1)
    assert np.array_equal(others, np.broadcast_to(np.delete(STAND_POSITION, KNEE), others.shape))


def test_symmetric_motions_name_the_left_side():
    motion = motion_from_keyframes("bend", BEND | {"symmetric": True}, DT)
    assert motion.frames[50, joint_index("right_knee_joint")] == pytest.approx(-1.0)


def test_file_of_ones_own(tmp_path):
    file = tmp_path / "nod.yaml"
    file.write_text(
        "keyframes: [{time: 0.0, joints: {}}, {time: 1, joints: {neck_pitch_joint: 0.3}}, {time: 2, joints: {}}]"
    )
    assert load_motion(str(file), DT).frames[50, joint_index("neck_pitch_joint")] == pytest.approx(0.3)
    file.write_text("keyframes: [")
    with pytest.raises(MotionError, match="is not valid YAML"):
        load_motion(str(file), DT)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (None, "bad must be a mapping with the keys keyframes, symmetric"),
        ({"frames": []}, r"bad has unknown keys \['frames'\]"),
        (keyframes((0.0, {})), "keyframes must be a list of at least two"),
        (
            keyframes((0.0, {}), (1.0, {"left_tail": 0.1}), (2.0, {})),
            r"keyframes\[1\].joints: unknown joint 'left_tail_joint'",
        ),
        (
            keyframes((0.0, {}), (1.0, {"left_knee": 2.0}), (2.0, {})),
            r"left_knee_joint at .* must lie in \[0, 1.5\] rad",
        ),
        (keyframes((0.0, {}), (0.1, {"left_knee": 1.5}), (0.2, {})), r"left_knee_joint at .* \[-12.25, 12.25\] rad/s"),
        (keyframes((0.0, {}), (1.0, {"left_knee": "far"}), (2.0, {})), r"left_knee must be a finite number, got 'far'"),
        (keyframes((0.0, {}), (1.0, {"left_knee": float("nan")}), (2.0, {})), "must be a finite number, got nan"),
        (keyframes((0.5, {}), (1.0, {})), "times must begin at 0"),
        (keyframes((0.0, {}), (1.0, {}), (1.0, {})), "grow by at least 0.02 s"),
        (keyframes((0.0, {}), (1.0, {"left_knee": 1.0})), "the last keyframe must have the pose of the first"),
        (keyframes((0.0, {}), (1.0, {}), symmetric="yes"), "symmetric must be true or false, got 'yes'"),
        (
            keyframes((0.0, {}), (1.0, {"right_knee": -1.0}), (2.0, {}), symmetric=True),
            "a symmetric motion names left joints only, got 'right_knee'",
        ),
    ],
)
def test_malformed_motions_are_refused(data, message):
    with pytest.raises(MotionError, match=message):
        motion_from_keyframes("bad", data, DT)
