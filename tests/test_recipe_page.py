"""The page of the recipe shows every setting of every stage, and marks what changes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.docs_module import DOCS, docs_module


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """`docs/recipe_page.py`."""
    yield from docs_module("recipe_page", monkeypatch)


def table(header, rows) -> str:
    return "\n".join(" | ".join(map(str, line)) for line in [header, *rows]) + "\n"


def test_every_setting_is_on_the_page(generator: ModuleType) -> None:
    configs = generator.load_recipe("walk").configs
    rows = [row for block in (*generator.BLOCKS.values(), generator._others(configs)) for row in block]
    paths = [row.path for row in rows]
    assert len(paths) == len(set(paths))
    for config in configs:
        assert set(generator.setting_paths(config)) - set(paths) == generator.ABOUT_THE_RUN
    page = generator.page(table)
    assert all(row.label in page for row in rows)


def test_values_are_those_of_the_presets_and_changes_are_bold(
    generator: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = tmp_path / "two.yaml"
    recipe.write_text(
        "about: x\n"
        "stages:\n"
        "  - {name: one, preset: smoke, samples: 100000}\n"
        "  - {name: two, preset: smoke, samples: 3000000, overrides: {walk: {step_height: 0.05,"
        " shove: {horizontal: {pelvis_link: 70}}}}}\n"
    )
    monkeypatch.setattr(generator, "SHOWN", recipe)
    lines = generator.page(table).splitlines()
    assert "height of a step, m | 0.08 | **0.05**" in lines
    assert "largest horizontal shove by body, N | none | **pelvis 70**" in lines
    assert "`slip`: squared horizontal speed of carrying feet | -0.3 | -0.3" in lines
    assert "foot friction | 0.4 to 1.2" in lines  # alike in both


def test_times_are_those_of_the_shipped_policy_where_the_recipe_made_it(
    generator: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = generator.load_recipe("smoke")
    stages = [{"preset": stage.preset, "samples": stage.samples, "seconds": 600} for stage in recipe.stages]
    training = {**stages[-1], "after": stages[:-1]}
    assert generator.seconds_taken(recipe, training) == [600.0] * len(stages)
    monkeypatch.setattr(generator, "shipped_training", lambda: training)
    assert f"| {len(stages) / 6:.1f} h, measured\n" in generator.page(table)
    for other in ({**training, "samples": stages[-1]["samples"] + 10**6}, {**training, "after": []}, {}):
        assert generator.seconds_taken(recipe, other) is None


def test_a_marker_without_a_table_is_refused(
    generator: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "recipe.md"
    page.write_text((DOCS / "recipe.md").read_text().replace("<!-- torque: made", "<!-- torques: made"))
    monkeypatch.setattr(generator, "PAGE", page)
    with pytest.raises(ValueError, match=r"recipe.md has markers for .*'torques'"):
        generator.page(table)
    page.write_text((DOCS / "recipe.md").read_text().replace("<!-- end of torque -->\n", ""))
    with pytest.raises(ValueError, match=r"recipe\.md lacks the line '<!-- end of torque -->'"):
        generator.page(table)
