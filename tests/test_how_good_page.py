"""The page "How good is it" follows from the card: every bar shows, and what is behind is named."""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from asimov_gym.evaluation.bars import BARS
from asimov_gym.evaluation.card import CardFigures
from asimov_gym.evaluation.plot_data import ScenarioFigures, Spread
from asimov_gym.evaluation.results import PushLimit
from asimov_gym.evaluation.suite import load_suite
from tests.docs_module import docs_module
from tests.evaluation.made_results import whole_suite


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """`docs/how_good_page.py`."""
    yield from docs_module("how_good_page", monkeypatch)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> CardFigures:
    """A card of the suite `standard`, as far as its name goes, of a policy whose file says `policy`."""
    folder = tmp_path_factory.mktemp("run")
    training = {"samples": 4_000_000, "seconds": 600, "after": [{"samples": 8_000_000, "seconds": 1200}]}
    made = replace(
        whole_suite(folder),
        suite="standard",
        suite_hash=load_suite("standard").hash,
        policy_hash=hashlib.sha256(b"policy").hexdigest(),
        contract={"training": training},
    )
    return CardFigures.of(made, folder)


def table(header: Any, rows: Any) -> str:
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in [header, *rows])


def shipped(generator: ModuleType, folder: Path, card: CardFigures | None) -> Any:
    """A policy with its card as files, read again; one of the earlier form when there is no card."""
    policy = folder / "walker.onnx"
    policy.write_bytes(b"policy")
    if card is None:
        policy.with_suffix(".json").write_text('{"summary": {"walks": 420}}')
    else:
        card.save(policy.with_suffix(".json"))
    return generator.Shipped.load(policy)


def page_of(generator: ModuleType, folder: Path, card: CardFigures | None) -> str:
    return generator.page(shipped(generator, folder, card), table, "")


def section(page: str, title: str) -> str:
    return page.partition(f"## {title}\n")[2].partition("\n## ")[0]


def with_verdict(card: CardFigures, name: str, verdict: str, value: float | None) -> CardFigures:
    bars = tuple(replace(bar, verdict=verdict, value=value) if bar.name == name else bar for bar in card.bars)
    return replace(card, bars=bars)


def test_every_bar_shows_with_its_verdict(generator: ModuleType, measured: CardFigures, tmp_path: Path) -> None:
    page = page_of(generator, tmp_path, measured)
    assert len(measured.bars) == len(BARS)
    bars = section(page, "The bars")
    for bar in measured.bars:
        assert any(
            line.startswith(f"| {bar.name}") and f"| {bar.asked} | {bar.shown} |" in line and bar.verdict in line
            for line in bars.splitlines()
        ), bar.name


@pytest.mark.parametrize("name", ["standing: drift over 10 s", "stretch pushes", "survival, slopes to 6°"])
def test_a_missed_bar_is_where_we_are_worse(
    generator: ModuleType, measured: CardFigures, tmp_path: Path, name: str
) -> None:
    met = page_of(generator, tmp_path, with_verdict(measured, name, "met", 0.123))
    assert name not in section(met, "Where we are worse")
    missed = page_of(generator, tmp_path, with_verdict(measured, name, "missed", 0.123))
    (line,) = [one for one in section(missed, "Where we are worse").splitlines() if one.startswith(f"| {name}")]
    assert "0.123 m" in line or "12.3 %" in line
    unknown = section(
        page_of(generator, tmp_path, with_verdict(measured, name, "not measured", None)), "Where we are worse"
    )
    assert f"| {name}" not in unknown and name in " ".join(unknown.partition("Not measured")[2].split())


def test_a_push_that_fells_ours_earlier_is_where_we_are_worse(
    generator: ModuleType, measured: CardFigures, tmp_path: Path
) -> None:
    def with_limit(survived: float, felled: float) -> str:
        limit = PushLimit("x", "waist_yaw_link", (1.0, 0.0, 0.0), 0.6, survived, felled, 25.0, 3)
        pushes = replace(measured.pushes, standing=(), walking=(), limits=(limit,))
        return page_of(generator, tmp_path, replace(measured, pushes=pushes))

    weak = with_limit(250.0, 275.0)
    assert "| chest to the front | walking, 0.6 m/s | 400 / 375 | 250 | 275 | – | – | **worse** |" in weak
    assert "push, chest to the front, walking, 0.6 m/s" in section(weak, "Where we are worse")
    strong = with_limit(400.0, 425.0)
    assert "| chest to the front | walking, 0.6 m/s | 400 / 375 | 400 | 425 | – | – | better |" in strong
    assert "chest to the front, walking" not in section(strong, "Where we are worse")


def test_numbers_follow_from_the_card(generator: ModuleType, measured: CardFigures, tmp_path: Path) -> None:
    words = " ".join(page_of(generator, tmp_path, measured).split())
    trials, up = sum(one.trials for one in measured.scenarios), sum(one.survived for one in measured.scenarios)
    assert f"{len(measured.scenarios)} scenarios, {trials} trials, {up} of them without a fall" in words
    assert "Training took 30 minutes: 12 million samples in 2 stages." in words
    assert "policy `" + measured.policy_hash[:12] in words
    assert "A robot that walks the circle without any error would score 0.60 m/s" in words


def test_walks_that_end_in_stand_show_one_by_one(generator: ModuleType, measured: CardFigures, tmp_path: Path) -> None:
    assert "## From a walk to STAND\n\nThe suite did not ask for it." in page_of(generator, tmp_path, measured)
    figures = {"stance_stagger_m": Spread(0.024, 0.01, 0.061), "stand_tilt_max_rad": Spread(0.1, 0.05, 0.25)}
    some = ScenarioFigures("hand_over/fast", "hand_over", (0.0, 0.0, 0.0), 12, 12, 11, figures)
    none = replace(some, id="hand_over/backward", survived=0, figures={})
    text = page_of(generator, tmp_path, replace(measured, scenarios=(*measured.scenarios, some, none)))
    assert "| fast | 11 of 12 | 2.4 | 6.1 | 14° |" in text
    assert "| backward | 0 of 12 | – | – | – |" in text


def test_what_a_reader_must_know_first_comes_first(
    generator: ModuleType, measured: CardFigures, tmp_path: Path
) -> None:
    assert shipped(generator, tmp_path, measured).warnings == []
    changes: dict[str, dict[str, Any]] = {
        "Measured by the suite `quick`": {"suite": "quick"},
        "Measured by another form of the suite `standard`": {"suite_hash": "0" * 16},
        "The run was stopped before its end.": {"complete": False},
        "Measured with another file than the `walker.onnx`": {"policy_hash": "f" * 64},
    }
    for words, change in changes.items():
        card = replace(measured, **change)
        assert f"**{words}" in page_of(generator, tmp_path, card).partition("The shipped policy")[0]
        assert f"**{words}" in generator.readme(shipped(generator, tmp_path, card), table, readme()).partition("|")[0]


def readme(inside: str = "old\n") -> str:
    return f"# A\n\n<!-- how good: made by docs/generate.py -->\n{inside}<!-- end of how good -->\n\nB\n"


def test_the_readme_changes_between_its_comments_only(
    generator: ModuleType, measured: CardFigures, tmp_path: Path
) -> None:
    assert set(generator.README_BARS) <= {bar.name for bar in BARS} and 6 <= len(generator.README_BARS) <= 8
    policy = shipped(generator, tmp_path, measured)
    made = generator.readme(policy, table, readme())
    assert made.startswith("# A\n\n<!--") and made.endswith("-->\n\nB\n") and "old" not in made
    for name in generator.README_BARS:
        assert f"| {name}" in made
    assert generator.readme(policy, table, made) == made
    with pytest.raises(ValueError, match=r"README\.md must have the lines"):
        generator.readme(policy, table, "# A\n")


def test_an_earlier_card_makes_a_page_that_says_so(generator: ModuleType, tmp_path: Path) -> None:
    policy = shipped(generator, tmp_path, None)
    for text in (generator.page(policy, table, ""), generator.readme(policy, table, readme())):
        words = " ".join(text.split())
        assert "has not been measured by the suite `standard` yet (walker.json is a card of version 1" in words
        assert "asimov eval --suite standard" in words
    assert importlib.import_module("how_good_pictures").pictures(policy.card) == []


def test_pictures_are_out_of_date_when_their_data_change(
    generator: ModuleType, measured: CardFigures, tmp_path: Path
) -> None:
    pictures = importlib.import_module("how_good_pictures").pictures
    page = page_of(generator, tmp_path, measured)
    for picture in pictures(measured):
        path = tmp_path / f"{picture.name}.png"
        assert f"(how_good/{picture.name}.png)" in page and not picture.is_current(path)
        picture.save(path)
        assert picture.is_current(path) and path.read_bytes().startswith(b"\x89PNG")
    fewer = replace(measured, scenarios=measured.scenarios[1:])
    stale = [p.name for p in pictures(fewer) if not p.is_current(tmp_path / f"{p.name}.png")]
    assert stale == ["error_grid"]
    bare = replace(measured, gaits=())
    assert "gait.png" not in page_of(generator, tmp_path, bare)
    assert "does not hold what this picture shows" in section(page_of(generator, tmp_path, bare), "Gait")


def test_a_broken_card_is_one_line(
    generator: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    generate = importlib.import_module("generate")
    (tmp_path / "walker.onnx").write_bytes(b"policy")
    (tmp_path / "walker.json").write_text('{"card_version": 2}')
    load = generator.Shipped.load
    monkeypatch.setattr(generator.Shipped, "load", lambda: load(tmp_path / "walker.onnx"))
    monkeypatch.setattr(sys, "argv", ["generate.py", "--check"])
    assert generate.main() == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.startswith("error: ") and "walker.json: CardFigures lacks " in error
