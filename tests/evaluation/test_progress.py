"""Progress of a suite in lines."""

from __future__ import annotations

import pytest

from asimov_gym.evaluation.progress import PrintedProgress


def test_a_line_for_each_part_of_a_stage() -> None:
    lines: list[str] = []
    progress = PrintedProgress(4, lines.append)
    for done in (0.0, 10.0, 24.9, 25.0, 26.0, 80.0, 100.0, 100.0):
        progress("scenarios", done, 100.0)
    progress("push limits", 60.0, 60.0)
    assert lines == ["scenarios: 25 %", "scenarios: 75 %", "scenarios: 100 %", "push limits: 100 %"]


def test_a_stage_without_work_is_done() -> None:
    lines: list[str] = []
    PrintedProgress(10, lines.append)("scenarios", 0.0, 0.0)
    assert lines == ["scenarios: 100 %"]


@pytest.mark.parametrize("parts", [0, 101])
def test_senseless_numbers_of_parts_are_refused(parts: int) -> None:
    with pytest.raises(ValueError, match=rf"parts must lie in \[1, 100\], got {parts}"):
        PrintedProgress(parts)
