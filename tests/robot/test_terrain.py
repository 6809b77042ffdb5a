"""The ground as a function is the ground in the model, and names say what they are."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from asimov_gym.robot.height_field import HeightField
from asimov_gym.robot.model import model_sha256, robot_model, robot_spec
from asimov_gym.robot.terrain import FLAT, TERRAINS, Block, Terrain, terrain_named

NAMES = [*TERRAINS, "rough:0.05,7", "slope:-10", "steps:0.1,0.5"]


def seen_from_above(terrain: Terrain, points: np.ndarray) -> np.ndarray:
    """Height of the first shape of the world that a ray from 5 m above each point (M, 2) meets."""
    model = robot_model(visuals=False, terrain=terrain)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != 0:  # a ray sees groups; the robot goes to another one than the ground
            model.geom_group[geom] = 5
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    met, down = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, -1.0])
    far = [mujoco.mj_ray(model, data, np.array([x, y, 5.0]), down, groups, 1, -1, met) for x, y in points]
    return 5.0 - np.array(far)


@pytest.mark.parametrize("name", NAMES)
def test_height_is_what_the_physics_collides_with(name: str) -> None:
    terrain = terrain_named(name)
    points = np.random.default_rng(0).uniform([-4.0, -4.5], [12.0, 4.5], (1500, 2))
    # Both work in float64; only the height field is kept in float32, whose rounding is far below 1e-6.
    np.testing.assert_allclose(terrain.height(*points.T), seen_from_above(terrain, points), atol=1e-6)


def test_the_field_ends_level_with_the_floor() -> None:
    terrain = TERRAINS["rough"]
    assert terrain.field is not None
    half = terrain.field.half_side
    along = np.linspace(-half, half, 101)
    for x, y in ((along, np.full(101, half)), (np.full(101, -half), along), (along, np.full(101, half + 1.0))):
        np.testing.assert_array_equal(terrain.height(x, y), 0.0)


@pytest.mark.parametrize("name", ["rough", "slope:-10", "stairs_5cm"])
def test_height_on_jax_equals_numpy(name: str) -> None:
    jax = pytest.importorskip("jax", reason="needs JAX: pip install 'asimov-gym[mjx]'")
    terrain = terrain_named(name)
    x, y = np.random.default_rng(1).uniform(-3.0, 9.0, (2, 40, 2)).astype(np.float32)
    on_jax = jax.jit(terrain.height)(x, y)
    assert on_jax.shape == (40, 2) and on_jax.dtype == np.float32
    # The same arithmetic in float32, in another order: a few units in the last place of places below 10 m, times the
    # steepest slope between two of the field's corners.
    np.testing.assert_allclose(on_jax, terrain.height(x, y), atol=2e-6)
    draws = np.random.default_rng(2).random((50, 2), dtype=np.float32)
    np.testing.assert_allclose(jax.jit(terrain.start)(draws), terrain.start(draws), atol=2e-6)


def test_courses_are_those_of_the_benchmark() -> None:
    def profile(name: str) -> np.ndarray:
        x = np.linspace(0.0, 12.0, 12001)
        return TERRAINS[name].height(x, np.zeros_like(x))

    x = np.linspace(0.0, 12.0, 12001)
    for name, rise in (("stairs_5cm", 0.05), ("stairs_10cm", 0.10)):
        h = profile(name)
        rises = np.flatnonzero(np.diff(h) > 0.001)
        assert len(rises) == 5 and h.max() == pytest.approx(5 * rise) and h[-1] == 0.0
        np.testing.assert_allclose(np.diff(x[rises]), 0.35, atol=2e-3)
        assert x[h == h.max()].max() - x[h == h.max()].min() == pytest.approx(1.5, abs=3e-3)
    for name, degrees, top in (("slope_10deg", 10.0, 0.3), ("slope_15deg", 15.0, 0.4)):
        h = profile(name)
        assert h.max() == pytest.approx(top)
        assert np.gradient(h, x).max() == pytest.approx(np.tan(np.radians(degrees)), rel=1e-3)
    boxes = TERRAINS["obstacles"].blocks
    assert len(boxes) == 14
    assert min(b.top[0] for b in boxes) == 0.03 and max(b.top[0] for b in boxes) == 0.07
    tiles = TERRAINS["rough_tiles"].blocks
    assert all(t.x[1] - t.x[0] == pytest.approx(0.3) and t.y[1] - t.y[0] == pytest.approx(0.3) for t in tiles)
    assert 0.005 <= min(t.top[0] for t in tiles) < 0.006 and 0.039 < max(t.top[0] for t in tiles) <= 0.04
    for name in ("stairs_5cm", "stairs_10cm", "slope_10deg", "slope_15deg", "obstacles", "rough_tiles"):
        blocks = TERRAINS[name].blocks
        assert min(b.x[0] for b in blocks) == pytest.approx(1.5)
        assert min(b.y[0] for b in blocks) >= -3.0 - 1e-9 and max(b.y[1] for b in blocks) <= 3.0 + 1e-9


def test_obstacles_do_not_lie_in_each_other() -> None:
    blocks = TERRAINS["obstacles"].blocks
    for one, other in itertools.pairwise(blocks):
        assert one.x[1] < other.x[0]


def test_shapes_touch_as_the_floor_does_and_names_are_their_own() -> None:
    figures = ("condim", "friction", "solref", "solimp", "margin", "gap", "priority", "contype", "conaffinity")
    for name, terrain in TERRAINS.items():
        spec = robot_spec(terrain=terrain)
        model = spec.compile()
        floor = model.geom("floor")
        ground = [model.geom(i) for i in range(model.ngeom) if model.geom_bodyid[i] == 0]
        assert len(ground) == 1 + len(terrain.blocks) + (terrain.field is not None)
        for geom in ground:
            assert geom.name and not geom.name.startswith("_"), name
            assert "_foot" not in geom.name and "_toe" not in geom.name  # by which soles are known
            for figure in figures:
                np.testing.assert_array_equal(getattr(geom, figure), getattr(floor, figure), err_msg=geom.name)


def test_keyframes_stand_on_the_ground() -> None:
    flat = robot_model().key("stand").qpos
    for name in NAMES:
        terrain = terrain_named(name)
        raised = robot_model(terrain=terrain).key("stand").qpos - flat
        origin = np.zeros(1)
        assert raised[2] == pytest.approx(terrain.standing_height(origin, origin)[0])
        np.testing.assert_array_equal(np.delete(raised, 2), 0.0)


def test_starts_stay_in_their_area_and_above_the_ground() -> None:
    draws = np.random.default_rng(0).random((500, 2))
    for name in NAMES:
        terrain = terrain_named(name)
        x, y, z = terrain.start(draws).T
        for axis, (low, high) in zip((x, y), terrain.start_area, strict=True):
            assert axis.min() >= low and axis.max() <= high
            assert high - low == 0.0 or np.ptp(axis) > 0.98 * (high - low)
        assert (z >= terrain.height(x, y)).all()
    assert not TERRAINS["flat"].start(draws).any()


def test_the_robot_is_the_same_on_any_ground() -> None:
    """A policy's contract names a hash of the robot, which the ground is no part of."""
    before = model_sha256()
    robot_spec(terrain="obstacles").compile()
    model_sha256.cache_clear()
    assert model_sha256() == before
    on_flat, on_terrain = robot_model(), robot_model(terrain="stairs_5cm")
    np.testing.assert_array_equal(on_flat.body_mass, on_terrain.body_mass)


def test_names_and_figures() -> None:
    assert terrain_named("slope") == TERRAINS["slope"] and terrain_named("slope").tilt_deg == 6.0
    assert terrain_named("slope: -4").tilt_deg == -4.0
    assert terrain_named("steps:0.1").blocks[-1].top == (0.4, 0.4)
    rough = terrain_named("rough:0.05,3").field
    assert rough == HeightField(0.05, 3)
    assert rough is not None and rough.heights.max() == pytest.approx(0.05) and rough.heights.min() == 0.0
    other = terrain_named("rough:0.05,4").field
    assert other is not None and not np.array_equal(rough.heights, other.heights)
    for name in NAMES:
        assert terrain_named(terrain_named(name).name) == terrain_named(name)
    assert terrain_named(FLAT) is FLAT and FLAT.is_flat and not TERRAINS["slope"].is_flat


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hills", r"terrain 'hills' is unknown; known terrains: flat, rough:AMPLITUDE,SEED, slope:DEGREES"),
        ("", "terrain '' is unknown"),
        ("slope:45", r"terrain 'slope:45': degrees must lie in \[-20, 20\], got 45"),
        ("slope:steep", "figures must be numbers, got 'steep'"),
        ("slope:nan", "degrees must lie in"),
        ("slope:", "write slope:DEGREES"),
        ("steps:0.5", r"height must lie in \[0.005, 0.2\]"),
        ("steps:0.1,0.3,1", "write steps:HEIGHT,TREAD"),
        ("stairs_5cm:3", "figures that its kind does not take: write stairs_5cm"),
        ("rough:0.03,1.5", "seed must be a whole number, got 1.5"),
    ],
)
def test_bad_names_say_what_is_allowed(name: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        terrain_named(name)


def test_bad_figures_name_the_field() -> None:
    with pytest.raises(ValueError, match="block 'b': x must be an interval"):
        Block("b", (1.0, 1.0), (0.0, 1.0), (0.1, 0.1))
    with pytest.raises(ValueError, match="block 'b': top must lie in"):
        Block("b", (0.0, 1.0), (0.0, 1.0), (0.1, -0.1))
    with pytest.raises(ValueError, match="height field: amplitude must lie in"):
        HeightField(0.0)
    with pytest.raises(ValueError, match="a tilted floor can carry neither blocks nor a height field"):
        Terrain("both", tilt_deg=3.0, blocks=TERRAINS["steps"].blocks)
    with pytest.raises(ValueError, match="start_area must be ordered"):
        Terrain("backwards", start_area=((1.0, 0.0), (0.0, 0.0)))
