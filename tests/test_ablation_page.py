"""The page of the ablation studies: numbers where there is a result and only there, bold where they differ."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from asimov_gym.presets import to_mapping
from tests.docs_module import docs_module
from tests.train.made_ablation import WHOLE, made_result, training, value
from train.ablation import load_study
from train.ablation_figures import FIGURES, Value
from train.ablation_result import AblationResult


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """`docs/ablation_page.py`."""
    yield from docs_module("ablation_page", monkeypatch)


def table(header, rows) -> str:
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in [header, *rows])


def section(page: str, study: str) -> str:
    return page.partition(f"<!-- {study}: made by docs/generate.py -->\n")[2].partition(f"<!-- end of {study} -->")[0]


def row(page: str, variant: str, place: int) -> str:
    """A variant's row of the section's table at this place: 0 says in words what it is worth."""
    return [line for line in page.splitlines() if line.startswith(f"| `{variant}` |")][place]


def kept(folder: Path, result: AblationResult, name: str = "ingredients") -> Path:
    result.save(folder / f"{name}.json")
    return folder


def page_of(generator: ModuleType, folder: Path, result: AblationResult) -> str:
    """The section of a result that went through its file."""
    return section(generator.page(generator.load_results(kept(folder, result)), table), "ingredients")


def test_every_study_is_on_the_page_and_one_without_a_result_has_no_numbers(generator: ModuleType) -> None:
    page = generator.page({}, table)
    assert generator.shown() == ["ingredients", "recovery"]
    for name in generator.shown():
        text = section(page, name)
        assert text.startswith("**Not measured yet.**")
        assert f"python -m train ablation {name}" in text and f"--keep docs/ablations/{name}.json" in text
        for variant in load_study(name).all_variants:
            assert f"| `{variant.name}` | {variant.about} |" in text
        assert "survival" not in text and "worse" not in text
    assert "--warm-start RUN" in section(page, "recovery") and "--warm-start" not in section(page, "ingredients")
    assert page.count("| not measured yet |") == 2


def test_figures_and_differences_are_those_of_the_result(generator: ModuleType, tmp_path: Path) -> None:
    worse = training(figures={"velocity_error": Value(0.125, WHOLE, WHOLE), "survival_grid": Value(0.5, 10, 20)})
    better = training(figures={"velocity_error": Value(0.08, WHOLE, WHOLE), "largest_push": Value(400.0, 2, 2)})
    same = training(figures={"velocity_error": Value(0.109, WHOLE, WHOLE)})
    page = page_of(
        generator,
        tmp_path,
        made_result({"all": (training(),), "kicks": (worse,), "symmetry": (better,), "torque": (same,)}),
    )
    assert row(page, "all", 0).startswith("| `all` | 90.0 | 0.100 | 0.100 |")
    assert row(page, "kicks", 1).startswith("| `kicks` | **50.0 (−40.0)** worse | **0.125 (+0.025)** worse | 0.100")
    assert row(page, "symmetry", 1).startswith("| `symmetry` | 90.0 (+0.0) | **0.080 (−0.020)** better | 0.100")
    assert "| **400 (+100)** better |" in row(page, "symmetry", 2)
    assert row(page, "torque", 1).startswith("| `torque` | 90.0 (+0.0) | 0.109 (+0.009) |")
    assert row(page, "kicks", 0) == (
        "| `kicks` | nothing disturbs the robot | survival on the grid, velocity error | – |"
    )
    assert row(page, "symmetry", 0).endswith("| – | velocity error, largest push |")
    assert row(page, "torque", 0).endswith("| – | – |")
    assert "There is one training of the base" in " ".join(page.split())


def test_what_the_trainings_of_the_base_differ_by_does_not_count(generator: ModuleType, tmp_path: Path) -> None:
    def with_error(error: float, seed: int = 1):
        return training(seed, figures={"velocity_error": Value(error, WHOLE, WHOLE)})

    base = (with_error(0.08), with_error(0.10, 2), with_error(0.12, 3))
    result = made_result({"all": base, "kicks": (with_error(0.135),), "torque": (with_error(0.15),)})
    assert result.tolerance("velocity_error") == pytest.approx(0.04)
    page = page_of(generator, tmp_path, result)
    assert "| 0.100 [0.080 to 0.120] |" in row(page, "all", 0)
    assert "| 0.135 (+0.035) |" in row(page, "kicks", 1)
    assert "| **0.150 (+0.050)** worse |" in row(page, "torque", 1)
    assert "The base was trained 3 times" in " ".join(page.split())


def test_a_figure_of_those_that_are_left_is_never_better(generator: ModuleType, tmp_path: Path) -> None:
    few = training(figures={"velocity_error": Value(0.02, WHOLE // 2, WHOLE)})
    none = training(figures={"velocity_error": Value(None, 0, WHOLE), "samples_to_follow": Value(None, 0, 1)})
    result = made_result({"all": (training(),), "kicks": (few,), "torque": (none,)})
    page = page_of(generator, tmp_path, result)
    assert "| 0.020 (−0.080)\\* |" in row(page, "kicks", 1).replace("0.020\\* (−0.080)", "0.020 (−0.080)\\*")
    assert "Mean of the robots that have the figure" in page
    assert "| **none** worse |" in row(page, "torque", 1) and "| **never** worse |" in row(page, "torque", 3)
    assert result.judge(result.variants[1], "velocity_error") == "no difference"
    assert result.judge(result.variants[2], "samples_to_follow") == "worse"


def test_shares_differ_by_more_than_two_trials(generator: ModuleType) -> None:
    def passed(count: int):
        return training(figures={"survival_delay": Value(count / 6, count, 6)})

    result = made_result({"all": (passed(6),), "kicks": (passed(4),), "torque": (passed(3),)})
    assert [result.judge(one, "survival_delay") for one in result.variants[1:]] == ["no difference", "worse"]


def test_without_the_base_nothing_is_judged(generator: ModuleType, tmp_path: Path) -> None:
    page = page_of(generator, tmp_path, made_result({"kicks": (training(shift=0.5),)}))
    assert "worse" not in row(page, "kicks", 1) and "(" not in row(page, "kicks", 1)
    assert "**Not complete: 1 of 15 trainings.**" in page


def test_what_a_reader_must_know_first_comes_first(generator: ModuleType, tmp_path: Path) -> None:
    result = made_result()
    cases = {
        "Not complete: 13 of 15 trainings.": result,
        "The training `kicks_seed1` broke: infinite weights": replace(
            result, failures={"kicks_seed1": "infinite weights"}
        ),
        "Measured with other settings than those": replace(result, study={**result.study, "samples": 5}),
        "Trained with 0.5 times the study's samples.": replace(result, scale=0.5),
        "Measured by another form of the suite `quick`": replace(result, suite_hash="0" * 16),
    }
    for words, changed in cases.items():
        assert f"**{words}" in page_of(generator, tmp_path, changed).partition("The base, `all`,")[0]
    whole = replace(result, planned=13)
    assert page_of(generator, tmp_path, whole).startswith("The base, `all`, is the preset `laptop` with 6M")


def test_a_preset_that_changed_since_is_said(generator: ModuleType, tmp_path: Path) -> None:
    result = made_result()
    other = to_mapping(load_study("ingredients").config(load_study("ingredients").variants[0]))
    page = page_of(generator, tmp_path, replace(result, settings=other))
    assert "**Measured with other settings than those of the study that is here now.**" in page


def test_a_result_that_is_no_studys_is_refused(generator: ModuleType, tmp_path: Path) -> None:
    kept(tmp_path, made_result(), "recovery")
    with pytest.raises(ValueError, match=r"recovery\.json is a result of the study 'ingredients': the file must be"):
        generator.load_results(tmp_path)
    (tmp_path / "recovery.json").write_text('{"ablation_version": 7}')
    with pytest.raises(ValueError, match=r"recovery\.json: ablation_version must be 1, got 7"):
        generator.load_results(tmp_path)
    (tmp_path / "recovery.json").write_text('{"ablation_version": 1}')
    with pytest.raises(ValueError, match=r"recovery\.json: AblationResult lacks "):
        generator.load_results(tmp_path)


def test_the_file_holds_the_result(tmp_path: Path) -> None:
    result = made_result({"all": (training(1), training(2, 0.1)), "kicks": (training(),)})
    result.save(tmp_path / "one.json")
    loaded = AblationResult.load(tmp_path / "one.json")
    loaded.save(tmp_path / "two.json")
    assert (tmp_path / "one.json").read_text() == (tmp_path / "two.json").read_text()
    spread = loaded.variants[0].figures["velocity_error"]
    assert (spread.low, spread.high, spread.seeds) == (pytest.approx(0.1), pytest.approx(0.11), 2)
    assert spread.mean == pytest.approx(0.105) and spread.whole == 2 * WHOLE
    assert set(loaded.variants[0].figures) == set(FIGURES) and value("velocity_error").value == 0.1


def test_pictures_are_out_of_date_when_the_curves_change(generator: ModuleType, tmp_path: Path) -> None:
    pictures = importlib.import_module("ablation_pictures").pictures
    result = made_result({"all": (training(), training(2, 0.1)), "kicks": (training(shift=0.5),)})
    assert pictures({}) == []
    (picture,) = pictures({"ingredients": result})
    path = tmp_path / "ingredients.png"
    assert not picture.is_current(path)
    picture.save(path)
    assert picture.is_current(path) and path.read_bytes().startswith(b"\x89PNG")
    assert "(ablations/ingredients.png)" in page_of(generator, tmp_path, result)
    (other,) = pictures({"ingredients": made_result({"all": (training(shift=0.2),)})})
    assert not other.is_current(path)
