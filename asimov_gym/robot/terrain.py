"""The ground: flat, rough, sloped, stepped, and the courses of the vendor's benchmark.

A terrain is the highest of three surfaces: the floor, which may be tilted; blocks; and a height field. The physics gets
them as a plane, boxes and a height field; `Terrain.height` is the same ground as a function, for rewards, falls and
clearances. All engines can simulate each of them, as far as the number of possible contacts allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from asimov_gym.presets import check_range
from asimov_gym.robot.array_library import namespace
from asimov_gym.robot.height_field import HeightField

Interval = tuple[float, float]

COURSE_START = 1.5
"""Where a course begins, ahead of the world's origin along x, m."""
COURSE_WIDTH = 6.0
"""Width of a course, m; its middle is the x axis."""
_ACROSS = (-0.5 * COURSE_WIDTH, 0.5 * COURSE_WIDTH)
_ROOT = 0.1
"""Blocks reach this far below the floor, m: nothing can get under them."""
_FOOTPRINT = 0.2
"""A standing robot's soles lie within this distance of the point below its pelvis, along each axis, m."""
_FOOTPRINT_POINTS = 5


@dataclass(frozen=True)
class Block:
    """A solid with a flat top: level, or a ramp that rises or falls along x.

    Raises:
        ValueError: an interval is empty or unordered, or a top is below the floor.
    """

    name: str
    x: Interval
    """From and to, m."""
    y: Interval
    top: Interval
    """Height of the top at the two ends in x, m."""

    def __post_init__(self) -> None:
        for axis, (low, high) in (("x", self.x), ("y", self.y)):
            if not low < high:
                raise ValueError(f"block {self.name!r}: {axis} must be an interval (low, high), got {(low, high)}")
        for height in self.top:
            check_range(f"block {self.name!r}: top", height, 0.0, 2.0)

    @property
    def is_level(self) -> bool:
        return self.top[0] == self.top[1]

    def write(self, geom: mujoco.MjsGeom) -> None:
        """Give a geom this block's box."""
        geom.name, geom.type = self.name, mujoco.mjtGeom.mjGEOM_BOX
        (x0, x1), (y0, y1), (z0, z1) = self.x, self.y, self.top
        middle, half_width = 0.5 * (y0 + y1), 0.5 * (y1 - y0)
        if self.is_level:
            geom.pos = [0.5 * (x0 + x1), middle, 0.5 * (z0 - _ROOT)]
            geom.size = [0.5 * (x1 - x0), half_width, 0.5 * (z0 + _ROOT)]
            return
        angle = math.atan2(z1 - z0, x1 - x0)
        down = 0.5 * (max(self.top) + _ROOT)
        geom.pos = [0.5 * (x0 + x1) + down * math.sin(angle), middle, 0.5 * (z0 + z1) - down * math.cos(angle)]
        geom.quat = _pitched_up(angle)
        geom.size = [0.5 * math.hypot(x1 - x0, z1 - z0), half_width, down]


@dataclass(frozen=True)
class Terrain:
    """Ground that a robot can stand on. The floor around blocks and the height field is flat, or tilted as a whole.

    Raises:
        ValueError: a figure is out of range, or a tilted floor carries anything.
    """

    name: str
    """What `terrain_named` makes it from."""
    tilt_deg: float = 0.0
    """Of the floor, which passes through the origin and rises along x."""
    blocks: tuple[Block, ...] = ()
    field: HeightField | None = None
    start_area: tuple[Interval, Interval] = ((0.0, 0.0), (0.0, 0.0))
    """Where episodes may start: from and to in x and y, m."""

    def __post_init__(self) -> None:
        check_range(f"terrain {self.name!r}: tilt_deg", self.tilt_deg, -30.0, 30.0)
        if self.tilt_deg and (self.blocks or self.field is not None):
            raise ValueError(f"terrain {self.name!r}: a tilted floor can carry neither blocks nor a height field")
        for low, high in self.start_area:
            if low > high:
                raise ValueError(f"terrain {self.name!r}: start_area must be ordered, got {self.start_area}")

    def __str__(self) -> str:
        return self.name

    @property
    def is_flat(self) -> bool:
        """Whether its height is 0 everywhere."""
        return not (self.tilt_deg or self.blocks or self.field is not None)

    # -- the ground as a function --------------------------------------------------------------------------------------

    def height(self, x: Any, y: Any) -> Any:
        """Height of the ground, m, at points of any one shape; arrays of any library that follows the array-API
        standard, floating-point."""
        xp = namespace(x, y)
        ground = math.tan(math.radians(self.tilt_deg)) * x
        if self.blocks:
            ground = xp.maximum(ground, self._blocks_height(x, y))
        if self.field is not None:
            ground = xp.maximum(ground, self.field.height(x, y))
        return ground

    def standing_height(self, x: Any, y: Any) -> Any:
        """Height of the highest ground that a robot standing over a point may have under its soles, m."""
        xp = namespace(x, y)
        offsets = np.linspace(-_FOOTPRINT, _FOOTPRINT, _FOOTPRINT_POINTS)
        dx, dy = (xp.asarray(part.reshape(-1), dtype=x.dtype) for part in np.meshgrid(offsets, offsets))
        return xp.max(self.height(x[..., None] + dx, y[..., None] + dy), axis=-1)

    def start(self, draws: Any) -> Any:
        """Places to start from, drawn over `start_area`: x, y and `standing_height` there, (N, 3), from uniform numbers
        (N, 2)."""
        xp = namespace(draws)
        x, y = (low + (high - low) * draws[:, axis] for axis, (low, high) in enumerate(self.start_area))
        return xp.stack([x, y, self.standing_height(x, y)], axis=-1)

    def _blocks_height(self, x: Any, y: Any) -> Any:
        xp = namespace(x, y)
        x, y = x[..., None], y[..., None]
        x0, x1, y0, y1, z0, z1 = (xp.asarray(part, dtype=x.dtype) for part in self._block_figures)
        top = z0 + (z1 - z0) / (x1 - x0) * (x - x0)
        inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        return xp.max(xp.where(inside, top, xp.zeros_like(top)), axis=-1)

    @cached_property
    def _block_figures(self) -> np.ndarray:
        """Intervals in x and y and heights at both ends, (6, blocks)."""
        return np.array([(*block.x, *block.y, *block.top) for block in self.blocks]).T

    # -- the ground in a model -----------------------------------------------------------------------------------------

    def lay(self, spec: mujoco.MjSpec) -> None:
        """Put this terrain into a specification whose floor is the plane `floor`: tilt it, or add shapes that touch as
        it does, and lift the robot's keyframes onto it."""
        floor = spec.geom("floor")
        if self.tilt_deg:
            floor.quat = _pitched_up(math.radians(self.tilt_deg))
        for block in self.blocks:
            block.write(_like(floor, spec.worldbody.add_geom()))
        if self.field is not None:
            self._add_field(spec, self.field, floor)
        if not self.is_flat:
            origin = np.zeros(1)
            for key in spec.keys:
                qpos = np.array(key.qpos)
                qpos[2] += self.standing_height(origin, origin)[0]
                key.qpos = qpos

    @staticmethod
    def _add_field(spec: mujoco.MjSpec, field: HeightField, floor: mujoco.MjsGeom) -> None:
        asset = spec.add_hfield(name="rough_ground", nrow=field.cells + 1, ncol=field.cells + 1)
        asset.size = [field.half_side, field.half_side, field.amplitude, _ROOT]
        asset.userdata = (field.heights / np.float32(field.amplitude)).reshape(-1)
        geom = _like(floor, spec.worldbody.add_geom())
        geom.name, geom.type, geom.hfieldname = "rough_ground", mujoco.mjtGeom.mjGEOM_HFIELD, "rough_ground"


def _pitched_up(angle: float) -> list[float]:
    """Quaternion that turns the x axis up by an angle, rad."""
    return [math.cos(0.5 * angle), 0.0, -math.sin(0.5 * angle), 0.0]


_CONTACT_FIGURES = (
    *("condim", "friction", "solref", "solimp", "solmix"),
    *("margin", "gap", "priority", "group", "contype", "conaffinity"),
)


def _like(floor: mujoco.MjsGeom, geom: mujoco.MjsGeom) -> mujoco.MjsGeom:
    """The geom with the floor's contact figures, and a colour that sets it off from the floor."""
    for name in _CONTACT_FIGURES:
        setattr(geom, name, getattr(floor, name))
    geom.rgba = [0.80, 0.68, 0.48, 1.0]
    return geom


# -- terrains by name --------------------------------------------------------------------------------------------------


def _flat() -> Terrain:
    return Terrain("flat")


def _rough(amplitude: float = 0.03, seed: float = 0) -> Terrain:
    """A random height field, 24 m wide."""
    check_range("amplitude", amplitude, 0.005, 0.1)
    check_range("seed", seed, 0, 2**31 - 1)
    if seed != int(seed):
        raise ValueError(f"seed must be a whole number, got {seed:g}")
    return Terrain(
        f"rough:{amplitude:g},{seed:g}", field=HeightField(amplitude, int(seed)), start_area=_square(0.0, 6.0)
    )


def _slope(degrees: float = 6.0) -> Terrain:
    """A plane that rises along x, or falls where the angle is negative. It never ends."""
    check_range("degrees", degrees, -20.0, 20.0)
    return Terrain(f"slope:{degrees:g}", tilt_deg=degrees, start_area=_square(0.0, 3.0))


def _steps(height: float = 0.05, tread: float = 0.35) -> Terrain:
    """Four square terraces on top of each other, a metre ahead: steps up and down from every side."""
    check_range("height", height, 0.005, 0.2)
    check_range("tread", tread, 0.2, 2.0)
    top, layers, gap = 0.8, 4, 1.0
    half = top + (layers - 1) * tread
    middle = gap + half
    blocks = tuple(
        Block(f"terrace_{k + 1}", (middle - r, middle + r), (-r, r), _level(height * (k + 1)))
        for k, r in enumerate(half - k * tread for k in range(layers))
    )
    area = ((0.0, 2.0 * middle), (-middle, middle))
    return Terrain(f"steps:{height:g},{tread:g}", blocks=blocks, start_area=area)


def _square(middle: float, half: float) -> tuple[Interval, Interval]:
    side = (middle - half, middle + half)
    return side, side


def _level(height: float) -> Interval:
    return height, height


def _course(name: str, blocks: list[Block]) -> Terrain:
    end = max(block.x[1] for block in blocks)
    return Terrain(name, blocks=tuple(blocks), start_area=((0.0, end), (0.5 * _ACROSS[0], 0.5 * _ACROSS[1])))


def _stairs(name: str, rise: float) -> Terrain:
    """Five steps up, 35 cm deep, a top of 1.5 m, five steps down."""
    count, tread, top = 5, 0.35, 1.5
    end = COURSE_START + 2.0 * (count - 1) * tread + top
    blocks = [
        Block(f"stair_{k + 1}", (COURSE_START + k * tread, end - k * tread), _ACROSS, _level(rise * (k + 1)))
        for k in range(count)
    ]
    return _course(name, blocks)


def _ramps(name: str, degrees: float, height: float) -> Terrain:
    """A ramp up, a top of 1.5 m, a ramp down. (The source does not give the top's length; it is that of the stairs.)"""
    run, top = height / math.tan(math.radians(degrees)), 1.5
    x1 = COURSE_START + run
    x2 = x1 + top
    blocks = [
        Block("ramp_up", (COURSE_START, x1), _ACROSS, (0.0, height)),
        Block("platform", (x1, x2), _ACROSS, (height, height)),
        Block("ramp_down", (x2, x2 + run), _ACROSS, (height, 0.0)),
    ]
    return _course(name, blocks)


def _obstacles(name: str) -> Terrain:
    """Fourteen boxes, 3 to 7 cm high, one behind the other. (The source gives their number and heights; where they lie
    and how large they are is ours. The x axis crosses most of them.)"""
    rng, count, spacing = np.random.default_rng(14), 14, 0.45
    heights = rng.permutation(np.linspace(0.03, 0.07, count)).round(3)
    blocks = []
    for k, height in enumerate(heights.tolist()):
        depth, half_width = rng.uniform(0.15, 0.3), rng.uniform(0.75, 1.5)
        reach = _ACROSS[1] - half_width
        middle = rng.uniform(-reach, reach) if k % 3 == 2 else rng.uniform(-0.5, 0.5)
        x = COURSE_START + k * spacing
        blocks.append(
            Block(f"obstacle_{k + 1}", (x, x + depth), (middle - half_width, middle + half_width), _level(height))
        )
    return _course(name, blocks)


def _tiles(name: str) -> Terrain:
    """Square tiles of 0.3 m, 0.5 to 4 cm high. (How long the course is, 6 m, and the heights' seed are ours.)"""
    rng, side = np.random.default_rng(20), 0.3
    count = round(COURSE_WIDTH / side)
    blocks = []
    for row in range(count):
        for column in range(count):
            x, y, height = COURSE_START + row * side, _ACROSS[0] + column * side, round(rng.uniform(0.005, 0.04), 4)
            blocks.append(Block(f"tile_{row + 1}_{column + 1}", (x, x + side), (y, y + side), _level(height)))
    return _course(name, blocks)


_KINDS: Mapping[str, Callable[..., Terrain]] = MappingProxyType(
    {
        "flat": _flat,
        "rough": _rough,
        "slope": _slope,
        "steps": _steps,
        "stairs_5cm": lambda: _stairs("stairs_5cm", 0.05),
        "stairs_10cm": lambda: _stairs("stairs_10cm", 0.10),
        "slope_10deg": lambda: _ramps("slope_10deg", 10.0, 0.3),
        "slope_15deg": lambda: _ramps("slope_15deg", 15.0, 0.4),
        "obstacles": lambda: _obstacles("obstacles"),
        "rough_tiles": lambda: _tiles("rough_tiles"),
    }
)
TERRAINS: Mapping[str, Terrain] = MappingProxyType({name: make() for name, make in _KINDS.items()})
"""Every kind of terrain with its usual figures. The ones behind `steps` are the courses of the vendor's benchmark."""
FLAT = TERRAINS["flat"]


def terrain_named(name: str | Terrain) -> Terrain:
    """Terrain by name; a terrain passes unchanged.

    Args:
        name: a kind, or a kind with figures: `rough:AMPLITUDE,SEED` (m), `slope:DEGREES` (above 0 rises along x),
            `steps:HEIGHT,TREAD` (m). Figures left out have their usual values.

    Raises:
        ValueError: the kind is unknown (the message lists the known ones), or a figure is wrong.
    """
    if isinstance(name, Terrain):
        return name
    if not isinstance(name, str):
        raise ValueError(f"terrain must be a name such as 'rough:0.03', got {name!r}")
    kind, _, rest = name.partition(":")
    if kind not in _KINDS:
        raise ValueError(f"terrain {name!r} is unknown; known terrains: {', '.join(_usages())}")
    make = _KINDS[kind]
    given = [part.strip() for part in rest.split(",")] if rest else []
    if len(given) > len(signature(make).parameters) or name.endswith(":"):
        raise ValueError(f"terrain {name!r} has figures that its kind does not take: write {_usage(kind)}")
    try:
        return make(*map(_figure, given))
    except ValueError as error:
        raise ValueError(f"terrain {name!r}: {error}") from error


def _figure(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"figures must be numbers, got {text!r}") from None


def _usage(kind: str) -> str:
    figures = ",".join(name.upper() for name in signature(_KINDS[kind]).parameters)
    return f"{kind}:{figures}" if figures else kind


def _usages() -> list[str]:
    return [_usage(kind) for kind in _KINDS]
