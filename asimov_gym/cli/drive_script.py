"""Scripted moves: what `asimov drive` and `asimov robot --script` are told to do.

    stand for 3; velocity 0.4 0 0 for 5; stop for 1; damp

Steps are separated by `;` or by lines; `#` starts a comment. Each step but `wait` sends one command, and `for SECONDS`
lets time pass after it:

| step | does |
|---|---|
| `stand` | takes the standing pose, over about 2 s |
| `velocity VX VY YAW` | walks at this velocity (m/s, m/s, rad/s) until the next step |
| `stop` | walks on the spot: a velocity of zero |
| `damp` | goes limp |
| `wait SECONDS` | lets time pass |
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import Enum

LONGEST = 3600.0
"""Longest time of a step, s."""


class Verb(Enum):
    """What a step does."""

    STAND = "stand"
    VELOCITY = "velocity"
    STOP = "stop"
    DAMP = "damp"
    WAIT = "wait"


@dataclass(frozen=True)
class Step:
    """One step of a script.

    Raises:
        ValueError: a value is not finite, or the time is out of range.
    """

    verb: Verb
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """vx, vy (m/s) and yaw rate (rad/s) of a `velocity` step."""
    seconds: float = 0.0
    """Time that passes after the command."""

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in self.velocity):
            raise ValueError(f"velocity must be three finite numbers, got {self.velocity}")
        if not 0.0 <= self.seconds <= LONGEST:
            raise ValueError(f"seconds must be between 0 and {LONGEST:g}, got {self.seconds:g}")

    def __str__(self) -> str:
        if self.verb is Verb.WAIT:
            return f"wait {self.seconds:g}"
        words = [self.verb.value]
        if self.verb is Verb.VELOCITY:
            words += [f"{value:g}" for value in self.velocity]
        if self.seconds:
            words += ["for", f"{self.seconds:g}"]
        return " ".join(words)


def parse_script(text: str) -> tuple[Step, ...]:
    """The steps of a script.

    Raises:
        ValueError: the script is empty or a step cannot be read; names the step and what it may be.
    """
    lines = (line.partition("#")[0] for line in text.splitlines())
    written = [step.strip() for step in re.split(r"[;\n]", "\n".join(lines)) if step.strip()]
    if not written:
        raise ValueError('the script has no steps; try "stand for 3; velocity 0.4 0 0 for 5; damp"')
    steps = []
    for number, words in enumerate(written, start=1):
        try:
            steps.append(_parse_step(words.split()))
        except ValueError as error:
            raise ValueError(f"step {number}, {words!r}: {error}") from None
    return tuple(steps)


def _parse_step(words: list[str]) -> Step:
    try:
        verb = Verb(words[0].lower())
    except ValueError:
        raise ValueError(f"a step is one of {', '.join(verb.value for verb in Verb)}") from None
    given = words[1:]
    seconds = 0.0
    if verb is not Verb.WAIT and len(given) >= 2 and given[-2].lower() == "for":
        seconds, given = _number("the time after `for`", given[-1]), given[:-2]
    expected = {Verb.VELOCITY: ("vx", "vy", "yaw rate"), Verb.WAIT: ("seconds",)}.get(verb, ())
    if len(given) != len(expected):
        takes = f"takes {len(expected)} numbers ({', '.join(expected)})" if expected else "takes no numbers"
        raise ValueError(f"{verb.value} {takes}, got {len(given)}")
    values = [_number(name, word) for name, word in zip(expected, given, strict=True)]
    if verb is Verb.VELOCITY:
        return Step(verb, (values[0], values[1], values[2]), seconds)
    return Step(verb, seconds=values[0] if verb is Verb.WAIT else seconds)


def _number(name: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{name} must be a number, got {word!r}") from None
