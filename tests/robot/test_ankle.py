"""The ankle linkage, linear and exact, against figures worked out by hand and against virtual work."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from asimov_gym.robot import ankle
from asimov_gym.robot.ankle import (
    FORMS,
    K_PITCH,
    K_ROLL,
    MOTOR_TRAVEL,
    Form,
    gains_to_joint,
    to_joint_position,
    to_joint_torque,
    to_joint_velocity,
    to_motor_position,
    to_motor_torque,
    to_motor_velocity,
)
from asimov_gym.robot.joints import JOINT_NAMES, MOTOR_NAMES, RANGE

LEFT = (JOINT_NAMES.index("left_ankle_pitch_joint"), JOINT_NAMES.index("left_ankle_roll_joint"))
RIGHT = (JOINT_NAMES.index("right_ankle_pitch_joint"), JOINT_NAMES.index("right_ankle_roll_joint"))
MOTOR_PAIRS = {
    LEFT: (MOTOR_NAMES.index("L_Ankle_A"), MOTOR_NAMES.index("L_Ankle_B")),
    RIGHT: (MOTOR_NAMES.index("R_Ankle_A"), MOTOR_NAMES.index("R_Ankle_B")),
}
both_feet = pytest.mark.parametrize("foot", [LEFT, RIGHT], ids=["left", "right"])
both_forms = pytest.mark.parametrize("form", FORMS)


def _vector(places: tuple[int, int], first: float, second: float) -> np.ndarray:
    vector = np.zeros(25)
    vector[[*places]] = first, second
    return vector


def _random(*shape: int, seed: int = 0) -> np.ndarray:
    """Joint angles in range, ankles within what the motors can reach."""
    angles = np.random.default_rng(seed).uniform(RANGE[:, 0], RANGE[:, 1], (*shape, 25))
    angles[..., [LEFT[1], RIGHT[1]]] *= 0.7  # full pitch and full roll at once lie beyond the motors' travel
    return angles


def test_constants(figures: dict[str, Any]) -> None:
    table = figures["ankle"]
    assert table == {"k_pitch": K_PITCH, "k_roll": K_ROLL, "motor_travel": MOTOR_TRAVEL}


@both_feet
@pytest.mark.parametrize(
    ("form", "pitch", "roll", "a", "b"),
    [
        # A = 2.02 p - 0.8 q, B = -2.02 p - 0.8 q
        ("linear", 0.1, 0.0, 0.202, -0.202),
        ("linear", 0.0, 0.1, -0.08, -0.08),
        ("linear", -0.3, 0.05, -0.646, 0.566),
        # tan 0.1 = 0.1003347, 2.02 of it 0.2026761, whose arc sine is 0.2040895
        ("exact", 0.1, 0.0, 0.2040895, -0.2040895),
        # sin 0.1 = 0.0998334, 0.8 of it 0.0798667, whose arc sine is 0.0799518
        ("exact", 0.0, 0.1, -0.0799518, -0.0799518),
        # tan 0.3 = 0.3093362 and sin 0.05 = 0.0499792: sines -0.6648426 and 0.5848759
        ("exact", -0.3, 0.05, -0.7272830, 0.6247270),
    ],
)
def test_motor_angles_by_hand(foot: tuple[int, int], form: Form, pitch: float, roll: float, a: float, b: float) -> None:
    motor = to_motor_position(_vector(foot, pitch, roll), form)
    np.testing.assert_allclose(motor, _vector(MOTOR_PAIRS[foot], a, b), atol=1e-6)


@pytest.mark.parametrize(("asked", "reached"), [(0.10, 0.099), (0.30, 0.275), (0.35, 0.311)])
def test_linear_command_on_the_exact_mechanism(asked: float, reached: float) -> None:
    """What the foot does when the firmware's linear form drives the real linkage."""
    motor = to_motor_position(_vector(LEFT, asked, 0.0), "linear")
    assert to_joint_position(motor, "exact")[LEFT[0]] == pytest.approx(reached, abs=5e-4)


@both_forms
def test_positions_round_trip(form: Form) -> None:
    joint = _random(4, 50)
    np.testing.assert_allclose(to_joint_position(to_motor_position(joint, form), form), joint, atol=1e-12)


def test_forms_differ_in_third_order() -> None:
    """A tenth of the angle leaves about a thousandth of the difference."""
    joint = 0.1 * _random(50)

    def difference(angles: np.ndarray) -> np.ndarray:
        return to_motor_position(angles, "exact") - to_motor_position(angles, "linear")

    assert np.abs(difference(joint)).max() < 1e-3
    np.testing.assert_allclose(difference(0.1 * joint), 1e-3 * difference(joint), rtol=0, atol=1e-7)


@both_forms
def test_other_joints_pass_unchanged(form: Form) -> None:
    joint = _random(7)
    others = [i for i in range(25) if i not in (*LEFT, *RIGHT)]
    maps: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
        lambda v: to_motor_position(v, form),
        lambda v: to_joint_position(v, form),
        lambda v: to_motor_velocity(v, joint, form),
        lambda v: to_joint_velocity(v, joint, form),
        lambda v: to_motor_torque(v, joint, form),
        lambda v: to_joint_torque(v, joint, form),
        lambda v: gains_to_joint(v, v)[0],
    )
    for convert in maps:
        np.testing.assert_array_equal(convert(joint)[:, others], joint[:, others])


@both_forms
def test_motor_speeds_are_the_slope_of_motor_angles(form: Form) -> None:
    joint, speed, step = _random(100), np.random.default_rng(1).normal(size=(100, 25)), 1e-6
    ahead = to_motor_position(joint + step * speed, form)
    behind = to_motor_position(joint - step * speed, form)
    np.testing.assert_allclose(to_motor_velocity(speed, joint, form), (ahead - behind) / (2 * step), atol=1e-7)


@both_forms
def test_speeds_and_torques_round_trip(form: Form) -> None:
    joint, vector = _random(100), np.random.default_rng(2).normal(size=(100, 25))
    there = to_motor_velocity(vector, joint, form)
    np.testing.assert_allclose(to_joint_velocity(there, joint, form), vector, atol=1e-12)
    there = to_motor_torque(vector, joint, form)
    np.testing.assert_allclose(to_joint_torque(there, joint, form), vector, atol=1e-12)


@both_forms
def test_power_is_the_same_on_both_sides(form: Form) -> None:
    rng = np.random.default_rng(3)
    joint, speed, torque = _random(100), rng.normal(size=(100, 25)), rng.normal(size=(100, 25))
    motor_power = np.sum(to_motor_torque(torque, joint, form) * to_motor_velocity(speed, joint, form), axis=-1)
    np.testing.assert_allclose(motor_power, np.sum(torque * speed, axis=-1), atol=1e-12)


@both_feet
def test_torques_by_hand(foot: tuple[int, int]) -> None:
    """Two 36 N m motors against each other give 145.4 N m of pitch, together 57.6 N m of roll."""
    motors = MOTOR_PAIRS[foot]
    np.testing.assert_allclose(to_joint_torque(_vector(motors, 36.0, -36.0)), _vector(foot, 145.44, 0.0), atol=1e-9)
    np.testing.assert_allclose(to_joint_torque(_vector(motors, -36.0, -36.0)), _vector(foot, 0.0, 57.6), atol=1e-9)
    # (10 / 2.02 - 4 / 0.8) / 2 and (-10 / 2.02 - 4 / 0.8) / 2
    np.testing.assert_allclose(
        to_motor_torque(_vector(foot, 10.0, 4.0)), _vector(motors, -0.0247525, -4.9752475), atol=1e-7
    )


@both_feet
def test_motor_gains_in_joint_space(foot: tuple[int, int]) -> None:
    kp, kd = gains_to_joint(_vector(MOTOR_PAIRS[foot], 100.0, 100.0), _vector(MOTOR_PAIRS[foot], 5.0, 5.0))
    np.testing.assert_allclose(kp, _vector(foot, 816.08, 128.0))  # 2 x 2.02^2 x 100, 2 x 0.8^2 x 100
    np.testing.assert_allclose(kd, _vector(foot, 40.804, 6.4))


def test_joint_gains_are_what_the_motors_do() -> None:
    """A PD law at the motors, carried to the joints, equals the joint-space law with the converted gains."""
    rng = np.random.default_rng(4)
    error, gain = rng.normal(size=(50, 25)), rng.uniform(10.0, 100.0, (50, 25))
    for a, b in MOTOR_PAIRS.values():
        gain[:, b] = gain[:, a]
    through_motors = to_joint_torque(gain * to_motor_position(error))
    np.testing.assert_allclose(through_motors, gains_to_joint(gain, gain)[0] * error, atol=1e-9)


@both_feet
def test_exact_form_stays_finite_beyond_the_mechanism(foot: tuple[int, int]) -> None:
    for pitch in (-0.35, 0.35, -1.5, 1.5):
        for roll in (-0.35, 0.35, -1.5, 1.5):
            joint = _vector(foot, pitch, roll)
            motor = to_motor_position(joint, "exact")
            assert np.abs(motor).max() <= MOTOR_TRAVEL + 1e-12
            for convert in (to_motor_velocity, to_joint_velocity, to_motor_torque, to_joint_torque):
                assert np.isfinite(convert(np.ones(25), joint, "exact")).all()
    for a in (-3.0, 3.0):
        for b in (-3.0, 3.0):
            joint = to_joint_position(_vector(MOTOR_PAIRS[foot], a, b), "exact")
            assert np.isfinite(joint).all()
            assert np.abs(joint).max() <= MOTOR_TRAVEL + 1e-12


def test_whole_firmware_range_is_within_the_motors_travel() -> None:
    """The firmware clamps trajectories to 0.35 rad of pitch and 0.10 rad of roll: no saturation there."""
    joint = _vector(LEFT, 0.35, -0.10)
    motor = to_motor_position(joint, "exact")
    assert motor[LEFT[0]] == pytest.approx(math.asin(2.02 * math.tan(0.35) + 0.8 * math.sin(0.10)))
    np.testing.assert_allclose(to_joint_position(motor, "exact"), joint, atol=1e-12)


@both_forms
def test_leading_axes_broadcast_and_types_stay(form: Form) -> None:
    """One speed vector at many poses, as at each pose alone; single precision stays so; no argument is changed."""
    joint, speed = _random(4, 3), np.random.default_rng(6).normal(size=25)
    before = joint.copy(), speed.copy()
    together = to_motor_velocity(np.broadcast_to(speed, joint.shape), joint, form)
    for place in np.ndindex(4, 3):
        np.testing.assert_array_equal(together[place], to_motor_velocity(speed, joint[place], form))
    if form == "exact":  # its slopes have the poses' axes
        np.testing.assert_array_equal(to_motor_velocity(speed, joint, form), together)
    assert to_motor_position(joint.astype(np.float32), form).dtype == np.float32
    assert to_motor_position(np.zeros(25, dtype=int), form).dtype == np.float64
    np.testing.assert_array_equal(joint, before[0])
    np.testing.assert_array_equal(speed, before[1])


def test_a_bad_entry_stays_where_it_is() -> None:
    joint = _random()
    joint[JOINT_NAMES.index("left_knee_joint")] = np.nan
    joint[LEFT[0]] = np.inf
    broken = ~np.isfinite(to_motor_position(joint))
    assert set(np.flatnonzero(broken)) == {JOINT_NAMES.index("left_knee_joint"), *MOTOR_PAIRS[LEFT]}


def test_torch_float32_follows_numpy() -> None:
    """The same functions serve other array libraries, and keep their dtype."""
    torch = pytest.importorskip("torch", reason="torch comes with the training extra")
    joint, speed = _random(3, 5), np.random.default_rng(5).normal(size=(3, 5, 25))
    joint32, speed32 = torch.tensor(joint, dtype=torch.float32), torch.tensor(speed, dtype=torch.float32)
    for form in FORMS:
        result = to_motor_velocity(speed32, joint32, form)
        assert result.dtype == torch.float32
        np.testing.assert_allclose(result.numpy(), to_motor_velocity(speed, joint, form), atol=1e-4)
        position = to_joint_position(to_motor_position(joint32, form), form)
        assert position.dtype == torch.float32
        np.testing.assert_allclose(position.numpy(), joint, atol=1e-5)


def test_bad_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=r"joint must have shape \(\.\.\., 25\), got \(23,\)"):
        to_motor_position(np.zeros(23))
    with pytest.raises(ValueError, match=r"kd must have shape"):
        gains_to_joint(np.zeros(25), np.zeros(24))
    with pytest.raises(ValueError, match="form must be one of 'linear', 'exact', got 'tendon'"):
        ankle.to_joint_position(np.zeros(25), "tendon")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="joint_position is needed by the exact form"):
        to_motor_torque(np.zeros(25), form="exact")
