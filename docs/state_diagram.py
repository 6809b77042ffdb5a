"""Draws the mode machine as an SVG from its transition table."""

from __future__ import annotations

import math
from collections import defaultdict
from html import escape

from asimov_gym.firmware.modes import TRANSITIONS, State, Trigger

PLACES = {
    State.DAMP: (150.0, 330.0),
    State.STAND: (150.0, 90.0),
    State.POLICY: (640.0, 90.0),
    State.TRAJECTORY: (640.0, 330.0),
}
"""Centre of each state's box, px."""
BOX = (170.0, 56.0)
LABELS = {
    Trigger.DAMP: "DAMP",
    Trigger.STAND: "STAND",
    Trigger.VELOCITY: "velocity",
    Trigger.TRAJECTORY: "trajectory",
    Trigger.SILENCE: "silence",
    Trigger.FAULT: "fault",
    Trigger.E_STOP: "E-stop",
}
_COLOURS = {True: "#b3382c", False: "#2b5f8a"}
"""Colour of an arrow by whether it leads to DAMP."""
_OFFSET = 13.0
"""Distance of the two arrows of a pair from their common line, px."""


def arrows() -> dict[tuple[State, State], list[Trigger]]:
    """Triggers by (from, to), in the table's order; those that change nothing are left out."""
    found: dict[tuple[State, State], list[Trigger]] = defaultdict(list)
    for (state, trigger), goal in TRANSITIONS.items():
        if goal is not None and goal is not state:
            found[state, goal].append(trigger)
    return dict(found)


def svg() -> str:
    """The diagram, deterministic text."""
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 790 420" font-family="sans-serif" font-size="13">',
        "<title>The mode machine of the simulated robot</title>",
        '<rect width="790" height="420" fill="white"/>',
    ]
    parts += [_arrow(start, goal, triggers) for (start, goal), triggers in arrows().items()]
    parts += [_box(state) for state in State]
    parts.append(
        '<text x="20" y="405" fill="#444">boot enters DAMP; while a fault is latched or the E-stop is pressed nothing '
        "leaves DAMP; a velocity in DAMP is dropped</text>"
    )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _box(state: State) -> str:
    (x, y), (width, height) = PLACES[state], BOX
    return (
        f'<rect x="{x - width / 2:g}" y="{y - height / 2:g}" width="{width:g}" height="{height:g}" rx="9" '
        f'fill="#f4f6f8" stroke="#333" stroke-width="1.5"/>'
        f'<text x="{x:g}" y="{y + 5:g}" text-anchor="middle" font-weight="bold">{escape(state.value)}</text>'
    )


def _edge(centre: tuple[float, float], x: float, y: float, dx: float, dy: float) -> tuple[float, float]:
    """Where a ray from (x, y), inside the box of this centre, along (dx, dy) leaves it."""
    right, bottom = BOX[0] / 2, BOX[1] / 2
    across = (math.copysign(right, dx) - (x - centre[0])) / dx if abs(dx) > 1e-9 else math.inf
    down = (math.copysign(bottom, dy) - (y - centre[1])) / dy if abs(dy) > 1e-9 else math.inf
    scale = min(across, down)
    return x + scale * dx, y + scale * dy


def _arrow(start: State, goal: State, triggers: list[Trigger]) -> str:
    (x0, y0), (x1, y1) = PLACES[start], PLACES[goal]
    length = math.hypot(x1 - x0, y1 - y0)
    dx, dy = (x1 - x0) / length, (y1 - y0) / length
    side_x, side_y = -dy * _OFFSET, dx * _OFFSET  # the arrow back runs on the other side
    sx, sy = _edge((x0, y0), x0 + side_x, y0 + side_y, dx, dy)
    ex, ey = _edge((x1, y1), x1 + side_x, y1 + side_y, -dx, -dy)
    bx, by = ex - 9 * dx, ey - 9 * dy
    head = f"{ex:.1f},{ey:.1f} {bx - 4 * dy:.1f},{by + 4 * dx:.1f} {bx + 4 * dy:.1f},{by - 4 * dx:.1f}"
    colour = _COLOURS[goal is State.DAMP]
    return (
        f'<line x1="{sx:.1f}" y1="{sy:.1f}" x2="{bx:.1f}" y2="{by:.1f}" stroke="{colour}" stroke-width="1.6"/>'
        f'<polygon points="{head}" fill="{colour}"/>'
        + _label(", ".join(LABELS[trigger] for trigger in triggers), colour, (sx, sy), (ex, ey), (side_x, side_y))
    )


def _label(
    text: str, colour: str, start: tuple[float, float], end: tuple[float, float], side: tuple[float, float]
) -> str:
    """The triggers beside their arrow: over the middle of a level or upright one, on a slanted one near its start."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    slanted = abs(dx) > 1.0 and abs(dy) > 1.0
    upright = abs(dx) <= 1.0
    share = 0.3 if slanted else 0.5
    away = 0.0 if slanted else (0.6 if upright else 0.9)
    x, y = start[0] + share * dx + away * side[0], start[1] + share * dy + away * side[1] + 4
    anchor = ("start" if side[0] > 0 else "end") if upright else "middle"
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return (
        f'<text {place} fill="white" stroke="white" stroke-width="5">{escape(text)}</text>'
        f'<text {place} fill="{colour}">{escape(text)}</text>'
    )
