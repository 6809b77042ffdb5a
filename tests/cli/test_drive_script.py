"""The script of scripted moves: what it may say, and what is told to those who misspell it."""

from __future__ import annotations

import pytest

from asimov_gym.cli.drive_script import Step, Verb, parse_script


def test_steps_by_semicolon_and_by_line() -> None:
    expected = (
        Step(Verb.STAND, seconds=3.0),
        Step(Verb.VELOCITY, (0.4, 0.0, -0.1), 5.0),
        Step(Verb.STOP),
        Step(Verb.WAIT, seconds=1.5),
        Step(Verb.DAMP),
    )
    assert parse_script("stand for 3; velocity 0.4 0 -.1 for 5; stop; wait 1.5; damp") == expected
    lines = """
        # a walk
        stand for 3
        Velocity 0.4 0 -.1 for 5   # forward; and a little to the right
        stop; wait 1.5;
        DAMP
    """
    assert parse_script(lines) == expected


def test_a_step_reads_back() -> None:
    script = "stand for 3; velocity 0.4 0 -0.1 for 5; stop; wait 1.5; damp for 1"
    assert "; ".join(str(step) for step in parse_script(script)) == script


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("", ["no steps", "stand for 3"]),
        (" ; # stand\n", ["no steps"]),
        ("stand; dance", ["step 2", "'dance'", "velocity"]),
        ("velocity 1 2", ["vx, vy, yaw rate", "got 2"]),
        ("velocity 1 2 3 4", ["got 4"]),
        ("velocity 1 fast 0", ["vy", "'fast'"]),
        ("velocity nan 0 0", ["finite"]),
        ("velocity inf 0 0 for 1", ["finite"]),
        ("wait", ["wait takes 1 numbers", "got 0"]),
        ("wait for 3", ["got 2"]),
        ("wait -1", ["between 0 and 3600", "-1"]),
        ("wait nan", ["nan"]),
        ("stand 3", ["stand takes no numbers"]),
        ("stand for", ["stand takes no numbers"]),
        ("stand for ever", ["the time after `for`", "'ever'"]),
        ("stand for 1e9", ["3600"]),
    ],
)
def test_errors_name_the_step_and_what_is_allowed(script: str, words: list[str]) -> None:
    with pytest.raises(ValueError) as error:
        parse_script(script)
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)
