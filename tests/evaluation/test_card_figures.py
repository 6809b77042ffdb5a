"""The figures of a card: what a result says comes back from its file; other files are refused with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from asimov_gym.evaluation.aggregate import push_rows
from asimov_gym.evaluation.bars import judge
from asimov_gym.evaluation.card import CARD_VERSION, CardFigures, OldCardError
from asimov_gym.evaluation.results import SuiteResult
from tests.evaluation.made_results import result, scenario, trial, walk_trace, whole_suite


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SuiteResult, Path]:
    """A whole result and its folder."""
    folder = tmp_path_factory.mktemp("run")
    return whole_suite(folder), folder


def test_a_card_says_what_the_result_says(made: tuple[SuiteResult, Path]) -> None:
    whole, folder = made
    card = CardFigures.of(whole, folder)
    assert list(card.bars) == judge(whole)
    errors = [t.metrics["velocity_error_m_s"] for t in whole.trials_of("grid/0.8_0.4_0.8") if t.survived]
    corner = card.scenario("grid/0.8_0.4_0.8")
    assert corner is not None and (corner.planned, corner.trials, corner.survived) == (4, 4, 3)
    assert corner.command == (0.8, 0.4, 0.8)
    spread = corner.figures["velocity_error_m_s"]
    assert (spread.low, spread.high) == (min(errors), max(errors))
    assert spread.mean == pytest.approx(sum(errors) / 3)
    assert [*card.pushes.standing, *card.pushes.walking] == push_rows(whole)
    assert card.pushes.limits == whole.push_limits
    trace = walk_trace()
    carries = trace["foot_force"][200:350, :, 2] > 5.0
    (sample,) = card.gaits
    assert [text.count("1") for text in sample.carries] == carries.sum(axis=0).tolist()
    assert sample.start_s == pytest.approx(trace["time"][200])


def test_it_comes_back_from_its_file(made: tuple[SuiteResult, Path], tmp_path: Path) -> None:
    card = CardFigures.of(*made)
    card.save(tmp_path / "card.json")
    assert CardFigures.load(tmp_path / "card.json") == card
    # Numbers that belong together share a line, so that a changed card can be read as a difference.
    assert '"command": [0.8, 0.4, 0.8],' in (tmp_path / "card.json").read_text()


def test_words_in_a_file_stay_as_they_are(tmp_path: Path) -> None:
    info = scenario("standing/still", repeats=1)
    odd = result([info], [trial(info, 0)], machine={"cpu": "a  [b]\n {c}, \\n", "gpus": []})
    card = CardFigures.of(odd)
    card.save(tmp_path / "card.json")
    assert CardFigures.load(tmp_path / "card.json") == card
    assert card.gaits == () and card.torques.joints == ()


def test_an_earlier_card_is_told_from_a_broken_one(made: tuple[SuiteResult, Path], tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    with pytest.raises(FileNotFoundError, match=r"no card at .*card\.json"):
        CardFigures.load(path)
    path.write_text('{"summary": {"walks": 420}, "grid": []}')
    with pytest.raises(OldCardError, match=rf"version 1, {CARD_VERSION} is needed: python -m train card"):
        CardFigures.load(path)
    CardFigures.of(*made).save(path)
    data = json.loads(path.read_text())
    for change, message in (
        ({"card_version": CARD_VERSION + 1}, f"card_version must be {CARD_VERSION}, got {CARD_VERSION + 1}"),
        ({"scenarios": [{"id": "grid/a"}]}, r"scenarios\[0\] lacks command, config"),
        ({"wall_clock_s": "long"}, "wall_clock_s must be a number, got 'long'"),
        ({"smell": 1}, r"unknown keys \['smell'\]"),
    ):
        path.write_text(json.dumps({**data, **change}))
        with pytest.raises(ValueError, match=message) as caught:
            CardFigures.load(path)
        assert "card.json" in str(caught.value) and not isinstance(caught.value, OldCardError)
    for text in ("[1, 2]", "{"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"card\.json"):
            CardFigures.load(path)
