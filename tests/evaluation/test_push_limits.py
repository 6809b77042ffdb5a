"""The bisection of push limits, against robots whose limit is known."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from asimov_gym.evaluation.push_limits import PushLimitSearch, find_push_limits


def _search(direction: float, **figures: float) -> PushLimitSearch:
    return PushLimitSearch("pelvis_link", direction, 0.0, **figures)


def test_limits_are_bracketed_to_the_resolution() -> None:
    searches = [_search(direction, max_n=1200.0) for direction in range(8)]
    true = [0.0, 24.0, 25.0, 99.0, 431.0, 1175.0, 1199.0, 5000.0]
    calls: list[int] = []

    def survives(forces: Sequence[tuple[PushLimitSearch, float]]) -> list[bool]:
        calls.append(len(forces))
        return [force <= true[int(search.direction_deg)] for search, force in forces]

    limits = find_push_limits(searches, survives)
    assert [limit.largest_survived_n for limit in limits] == [0, 0, 25, 75, 425, 1175, 1175, 1200]
    assert [limit.smallest_failed_n for limit in limits] == [25, 25, 50, 100, 450, 1200, 1200, None]
    assert len(calls) == 1 + searches[0].rounds == 7


def test_a_robot_that_falls_unpushed_has_no_limit() -> None:
    (limit,) = find_push_limits([_search(0.0)], lambda forces: [False] * len(forces))
    assert (limit.largest_survived_n, limit.smallest_failed_n) == (0.0, 0.0)
    assert find_push_limits([], lambda forces: [True] * len(forces)) == ()


def test_a_search_pushes_where_it_says() -> None:
    search = PushLimitSearch("waist_yaw_link", 90.0, 0.6)
    assert search.direction == (0.0, 1.0, 0.0)
    scenario = search.scenario(300.0)
    (push,) = scenario.pushes
    assert (push.body, push.force, push.duration, push.direction) == ("waist_yaw_link", 300.0, 0.15, (0.0, 1.0, 0.0))
    assert scenario.commands[0].vx == 0.6 and not search.scenario(0.0).pushes
    assert search.scenario(25.0).id == scenario.id  # the seeds are the same at every force


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"body": "hand"}, "unknown body 'hand'; known: pelvis_link"),
        ({"direction_deg": 400.0}, r"directions_deg must lie in \[-360, 360\]"),
        ({"resolution_n": 0.0}, "resolution_n must lie in"),
        ({"max_n": 10.0}, "max_n must lie in"),
        ({"speed": 3.0}, r"vx must lie in \[-2, 2\]"),
        ({"repeats": 0}, "repeats must be a whole number from 1"),
    ],
)
def test_bad_searches_name_the_field(figures: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PushLimitSearch(**{"body": "pelvis_link", "direction_deg": 0.0, "speed": 0.0, **figures})
