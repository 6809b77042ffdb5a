"""What the robot's hardware and model revisions change, as figures laid over `assets/asimov1.xml`.

Two choices are independent:

* **leg_frames**: where the hip-yaw and knee axes lie. `shifted` is the newest published model file, which every
  official policy uses; `cad` agrees with the bores of the published link meshes and so with the machine: the knee axis
  lies 22 mm higher and the hip-yaw axis 7 mm further in. Length of the leg and standing height are the same.
* **foot**: `rigid` is the newest part; `toe` is the earlier foot with a passive spring toe (two more joints without
  motors).

Figures: asimov.xml and asimov_1.xml of the open-source robot (see NOTICE). m, kg, kg·m², N·m/rad, N·m·s/rad, in body
frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class BodyFigures:
    """Mass properties of a body, and its place where the revision moves it."""

    mass: float
    com: Vector
    """Centre of mass."""
    inertia: tuple[float, float, float, float, float, float]
    """About the centre of mass: xx, yy, zz, xy, xz, yz (MuJoCo's `fullinertia`)."""
    pos: Vector | None = None
    """Origin in the parent's frame; None leaves it."""


@dataclass(frozen=True)
class Capsule:
    """A contact capsule of a foot or toe."""

    name: str
    start: Vector
    end: Vector
    radius: float = 0.01


@dataclass(frozen=True)
class Toe:
    """The passive toe of one foot: a spring hinge that bends upward only."""

    joint: str
    foot: str
    """Body that carries it."""
    body: str
    figures: BodyFigures
    axis: Vector
    range: tuple[float, float]
    capsules: tuple[Capsule, ...]
    stiffness: float = 3.5
    damping: float = 0.5
    armature: float = 0.001
    frictionloss: float = 0.02
    limit_solref: tuple[float, float] = (0.005, 1.0)
    limit_solimp: Vector = (0.99, 0.999, 0.001)
    limit_margin: float = 0.01


@dataclass(frozen=True)
class FootFigures:
    """The rigid part of a foot with a toe."""

    figures: BodyFigures
    capsules: tuple[Capsule, ...]
    site: str
    site_pos: Vector


LEG_FRAMES: MappingProxyType[str, dict[str, BodyFigures]] = MappingProxyType(
    {
        "shifted": {},
        "cad": {
            "left_hip_yaw_link": BodyFigures(
                mass=1.866570164,
                com=(0.001079482, 0.001024901, -0.120338859),
                inertia=(0.0034163281, 0.0035601591, 0.0013752437, 1.1287234e-05, 2.8977905e-05, -0.0001197619),
                pos=(-0.04225, 0.0, -0.052),
            ),
            "left_knee_link": BodyFigures(
                mass=2.39114151,
                com=(-0.000500664, 0.000509289, -0.112692888),
                inertia=(0.0096217206, 0.0097531436, 0.0023309524, 9.8764639e-06, -0.00064514006, -7.9405814e-06),
                pos=(0.0, 0.0, -0.19564),
            ),
            "left_ankle_pitch_link": BodyFigures(
                mass=0.273090119,
                com=(-0.00117927, -3.1e-08, -0.006176192),
                inertia=(6.4266132e-05, 8.0994421e-05, 4.7192784e-05, -2.4057316e-10, -1.0753451e-06, -2.305601e-10),
                pos=(0.0, 0.0, -0.294662336),
            ),
            "right_hip_yaw_link": BodyFigures(
                mass=1.866472204,
                com=(0.001075952, -0.001021765, -0.120345116),
                inertia=(0.0034158873, 0.0035599002, 0.0013752527, -1.1759778e-05, 2.917336e-05, 0.00011971567),
                pos=(-0.04225, 0.0, -0.052),
            ),
            "right_knee_link": BodyFigures(
                mass=2.391101727,
                com=(-0.000497587, -0.000414757, -0.112692694),
                inertia=(0.0096214821, 0.0097528724, 0.0023309036, -9.8752782e-06, -0.00064509472, 7.9843137e-06),
                pos=(0.0, 0.0, -0.19564),
            ),
            "right_ankle_pitch_link": BodyFigures(
                mass=0.273089172,
                com=(-0.001179369, 6.9e-08, -0.006176146),
                inertia=(6.4265945e-05, 8.0994435e-05, 4.7192601e-05, -1.0228135e-10, -1.0755877e-06, 3.5270118e-10),
                pos=(0.0, 0.0001, -0.294662336),
            ),
        },
    }
)
"""Bodies that each choice of leg frames changes, by name."""

TOE_FEET: MappingProxyType[str, FootFigures] = MappingProxyType(
    {
        "left_ankle_roll_link": FootFigures(
            BodyFigures(
                mass=0.405640438,
                com=(0.042749938, 0.001592573, -0.013245066),
                inertia=(0.00017648791, 0.00041332591, 0.00053191303, 1.274621e-05, -1.3232732e-05, 5.5328354e-06),
            ),
            (
                Capsule("left_foot1_collision", (0.06, -0.03, -0.022), (0.09, -0.035, -0.022)),
                Capsule("left_foot2_collision", (-0.035, -0.015, -0.022), (0.09, -0.015, -0.022)),
                Capsule("left_foot3_collision", (-0.035, 0.0, -0.022), (0.09, 0.0, -0.022)),
                Capsule("left_foot4_collision", (-0.035, 0.015, -0.022), (0.09, 0.015, -0.022)),
                Capsule("left_foot6_collision", (0.0, 0.03, -0.022), (0.09, 0.035, -0.022)),
            ),
            site="left_foot",
            site_pos=(0.04, 0.0, -0.025),
        ),
        "right_ankle_roll_link": FootFigures(
            BodyFigures(
                mass=0.405640438,
                com=(0.037604624, -0.001132701, -0.012066752),
                inertia=(0.00018642203, 0.00041615429, 0.00053831652, -1.2682636e-05, -1.3134717e-05, -5.5198476e-06),
            ),
            (
                Capsule("right_foot1_collision", (0.0, -0.03, -0.022), (0.09, -0.035, -0.022)),
                Capsule("right_foot2_collision", (-0.035, -0.015, -0.022), (0.09, -0.015, -0.022)),
                Capsule("right_foot3_collision", (-0.035, 0.0, -0.022), (0.09, 0.0, -0.022)),
                Capsule("right_foot4_collision", (-0.035, 0.015, -0.022), (0.09, 0.015, -0.022)),
                Capsule("right_foot5_collision", (0.06, 0.03, -0.022), (0.09, 0.035, -0.022)),
            ),
            site="right_foot",
            site_pos=(0.04, 0.0, -0.025),
        ),
    }
)
"""Foot bodies of the revision with toes, by name."""

TOES: tuple[Toe, ...] = (
    Toe(
        joint="left_toe_joint",
        foot="left_ankle_roll_link",
        body="left_toe_link",
        figures=BodyFigures(
            mass=0.112221238,
            com=(0.032016777, 0.000718249, -0.014131277),
            inertia=(5.5351925e-05, 3.6513081e-05, 8.5402997e-05, 0.0, 0.0, 0.0),
            pos=(0.10253, -0.0043664, -0.0067324),
        ),
        axis=(0.010532, 0.99994, 0.0),
        range=(-1.047, 0.0),
        capsules=(
            Capsule("left_toe1_collision", (0.01, -0.03, -0.018), (0.04, -0.03, -0.018)),
            Capsule("left_toe2_collision", (0.01, -0.015, -0.018), (0.055, -0.015, -0.018)),
            Capsule("left_toe3_collision", (0.01, 0.0, -0.018), (0.06, 0.0, -0.018)),
            Capsule("left_toe4_collision", (0.01, 0.02, -0.018), (0.055, 0.02, -0.018)),
            Capsule("left_toe5_collision", (0.01, 0.04, -0.018), (0.04, 0.04, -0.018)),
        ),
    ),
    Toe(
        joint="right_toe_joint",
        foot="right_ankle_roll_link",
        body="right_toe_link",
        figures=BodyFigures(
            mass=0.112221754,
            com=(0.032014175, -0.000816708, -0.014130909),
            inertia=(5.5358949e-05, 3.6505277e-05, 8.5401736e-05, 0.0, 0.0, 0.0),
            pos=(0.10247, 0.0042796, -0.0067324),
        ),
        axis=(0.0074685, -0.99997, 0.0),
        range=(0.0, 1.047),
        capsules=(
            Capsule("right_toe1_collision", (0.01, -0.04, -0.018), (0.04, -0.04, -0.018)),
            Capsule("right_toe2_collision", (0.01, -0.02, -0.018), (0.055, -0.02, -0.018)),
            Capsule("right_toe3_collision", (0.01, 0.0, -0.018), (0.06, 0.0, -0.018)),
            Capsule("right_toe4_collision", (0.01, 0.015, -0.018), (0.055, 0.015, -0.018)),
            Capsule("right_toe5_collision", (0.01, 0.03, -0.018), (0.04, 0.03, -0.018)),
        ),
    ),
)

FEET: tuple[str, ...] = ("rigid", "toe")

PELVIS_HEIGHT: MappingProxyType[tuple[str, str], tuple[float, float]] = MappingProxyType(
    {
        ("shifted", "rigid"): (0.6145, 0.6303),
        ("shifted", "toe"): (0.6152, 0.6311),
        ("cad", "rigid"): (0.6144, 0.6303),
        ("cad", "toe"): (0.6151, 0.6311),
    }
)
"""Pelvis height (m) at which the lowest point of the soles touches the floor, in keyframes `stand` and `zero`."""
