"""What a study's file may say; the shipped ones; and that a mistake in one is named before anything is trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from asimov_gym.evaluation.suite import load_suite
from train.__main__ import main
from train.ablation import BASE, Study, changes, load_study, study_names

TRIO = """
about: Three tiny trainings.
preset: smoke
samples: 256
seeds: [1, 2]
base_seeds: [5]
suite: smoke
overrides: {library: rsl_rl, physics: c, copies: 16, threads: 1, learner: {steps: 8, hidden: [32, 16]}}
variants:
  - {name: quiet, about: no noise, overrides: {walk: {noise: {gyro: 0}}}}
  - {name: loose, about: no clip, overrides: {learner: {clip: 0.9}}}
"""


def written(folder: Path, text: str = TRIO) -> str:
    """The study as a file; its path."""
    path = folder / "trio.yaml"
    path.write_text(text)
    return str(path)


def changed(old: str, new: str) -> str:
    """The study with something replaced."""
    assert old in TRIO
    return TRIO.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "Study must be a mapping, got None"),
        ("about: [unclosed", "is not valid YAML"),
        ("about: x\n", "Study lacks preset, samples, variants; known keys: about, preset, samples, variants, name"),
        ("about: x\npreset: smoke\nsamples: 1\nvariants: []", "variants must not be empty"),
        (changed("name: quiet", "name: all"), "variant 'all': name must be of its own, the base is called so"),
        (changed("name: quiet", "name: loose"), "variant 'loose': name must be of its own, two variants are called so"),
        (
            changed("name: quiet", "name: ../up"),
            "variant name must be lower-case letters, digits, - and _, got '../up'",
        ),
        (changed("about: no noise", "about: ''"), "variant 'quiet': about must be one line of text, got ''"),
        (changed("about: no noise, ", ""), "variants[0] lacks about; known keys: name, about, overrides"),
        (changed("{gyro: 0}", "{gyro: 0.05}"), "variant 'quiet': overrides change nothing, got {'walk': {'noise': {'g"),
        (changed(", overrides: {walk: {noise: {gyro: 0}}}", ""), "variant 'quiet': overrides change nothing, got {}"),
        (changed("{gyro: 0}", "{gyro: 99}"), "variant 'quiet': noise.gyro must lie in [0, 10], got 99"),
        (changed("{gyro: 0}", "{giro: 0}"), "variant 'quiet': unknown keys ['giro'] in walk.noise; known keys: gyro"),
        (changed("{clip: 0.9}", "{clip: -1}"), "variant 'loose': learner.clip must lie in (0, 100), got -1"),
        (
            changed("{learner: {clip: 0.9}}", "{samples: 9}"),
            "variant 'loose': overrides must not hold samples, which the",
        ),
        (
            changed("{learner: {clip: 0.9}}", "{seed: 9}"),
            "variant 'loose': overrides must not hold seed, which the stu",
        ),
        (changed("{learner: {clip: 0.9}}", "9"), "variant 'loose': overrides must be a mapping, got 9"),
        (changed("copies: 16", "samples: 16"), "overrides must not hold samples, which the study has, got 16"),
        (changed("copies: 16", "copies: 1"), "copies must be at least learner.minibatches = 4, got 1"),
        (changed("preset: smoke", "preset: huge"), "preset 'huge' is unknown; known presets: brace"),
        (changed("samples: 256", "samples: 0"), "samples must be at least 1, got 0"),
        (changed("samples: 256", "samples: many"), "samples must be a whole number, got 'many'"),
        (changed("[1, 2]", "[]"), "seeds must not be empty"),
        (changed("[1, 2]", "[1, 5]"), "seeds and base_seeds must be different numbers from 0 on, got [1, 5, 5]"),
        (changed("[1, 2]", "[-1]"), "seeds and base_seeds must be different numbers from 0 on, got [-1, 5]"),
        (changed("[1, 2]", "[one]"), "seeds[0] must be a whole number, got 'one'"),
        (changed("suite: smoke", "sweet: smoke"), "unknown keys ['sweet']; known keys: about, preset, samples"),
        (
            changed("{clip: 0.9}", "{symmetry: none}") + "warm_start: true\n",
            "variant 'loose': learner.symmetry must be network or handed as in the base, whose networks it goes on",
        ),
        (TRIO + "name: a/b\n", "name must be lower-case letters, digits, - and _, got 'a/b'"),
    ],
)
def test_a_bad_study_says_what_is_wrong_in_a_line(text: str, words: str, tmp_path: Path, capsys: Any) -> None:
    assert main(["ablation", written(tmp_path, text), "--runs", str(tmp_path / "runs")]) == 2
    said = capsys.readouterr().err
    assert words in said and said.startswith(f"error: {tmp_path}/trio.yaml") and said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_the_base_is_the_first_variant_and_a_whole_comparison_comes_first(tmp_path: Path) -> None:
    study = load_study(written(tmp_path))
    order = [(variant.name, seed) for variant, seed in study.runs]
    once = [(BASE, 1), ("quiet", 1), ("loose", 1)]
    assert order == [*once, *((name, 2) for name, _ in once), (BASE, 5)]
    config = study.config(study.variants[0], 2)
    assert (config.seed, config.samples, config.copies, config.walk.noise.gyro) == (2, 256, 16, 0.0)
    assert changes(study.config(study.variants[1]), study.config(study.base)) == {"learner.clip": (0.2, 0.9)}
    assert study.config(study.base).walk.noise.gyro > 0.0


def test_without_a_name_the_studies_are_listed_with_what_they_vary(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ablation"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines if not line.startswith(" ")] == study_names()
    for name in study_names():
        for variant in load_study(name).variants:
            assert any(line.split()[0] == variant.name and variant.about in line for line in lines)
    (recovery,) = [line for line in lines if line.startswith("recovery:")]
    assert recovery == "recovery: 8 trainings of 3.00M samples, --warm-start RUN"


@pytest.mark.parametrize("name", study_names())
def test_shipped_studies_take_away_what_they_say(name: str) -> None:
    study: Study = load_study(name)
    assert study.name == name and load_suite(study.suite).trials
    base = study.config(study.base)
    for variant in study.variants:
        config = study.config(variant)
        assert changes(config, base)
        for term in set(variant.overrides.get("walk", {}).get("rewards", {})):
            assert base.walk.rewards[term] != 0.0 and config.walk.rewards[term] == 0.0
        assert (config.library, config.physics, config.copies) == (base.library, base.physics, base.copies)


def test_the_base_of_ingredients_is_the_preset_cut_short() -> None:
    from train.config import load_preset

    study, preset = load_study("ingredients"), load_preset("laptop")
    base, cut = study.config(study.base), preset.scaled(study.samples / preset.samples)
    assert base.learner == cut.learner and base.samples == cut.samples
    assert replace(base.walk, curriculum=cut.walk.curriculum) == cut.walk
    for name in ("penalty_growth", "kick_growth"):  # as much over the shorter run; rounded in the file
        whole, short = (getattr(c.walk.curriculum, name) * c.samples for c in (preset, base))
        assert short == pytest.approx(whole, rel=0.02)
