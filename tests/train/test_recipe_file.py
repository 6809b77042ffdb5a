"""What a recipe's file may say; the shipped ones; and that a mistake in one is named before anything is trained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.train.recipe_pair import PAIR, changed, written
from train.__main__ import main
from train.config import load_preset
from train.recipe import load_recipe, recipe_names


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "Recipe must be a mapping, got None"),
        ("[1, 2]", "Recipe must be a mapping, got [1, 2]"),
        ("about: [unclosed", "is not valid YAML"),
        (
            "about: x\n",
            "Recipe lacks stages; known keys: about, stages, name, overrides, averaged_stages, calibrated, gpu",
        ),
        ("about: x\nstages: []", "stages must hold 1 to 99 stages, got 0"),
        ("about: x\nstages: 3", "stages must be a list, got 3"),
        ("about: x\nstages: [walk]", "stages[0] must be a mapping, got 'walk'"),
        (changed("about: Two tiny stages.", "about: ''"), "about must be one line of text, got ''"),
        (changed("about: Two tiny stages.", "abuot: x"), "unknown keys ['abuot']; known keys: about, stages"),
        (changed("preset: smoke, samples: 256", "preset: smoke"), "stages[0] lacks samples; known keys: name, preset"),
        (changed("preset: smoke, samples: 256", "preset: huge, samples: 1"), "stage 'first': preset 'huge' is unknown"),
        (changed("256", "0"), "stage 'first': samples must be at least 1, got 0"),
        (changed("256", "many"), "stages[0].samples must be a whole number, got 'many'"),
        (changed("256", "8.5e6"), "stages[0].samples must be a whole number, got '8.5e6'"),
        (changed("256}", "256, speed: 3}"), "unknown keys ['speed'] in stages[0]; known keys: name, preset, samples"),
        (
            changed("name: first", "name: First one"),
            "stage name must be lower-case letters, digits, - and _, got 'First",
        ),
        (changed("name: first", "name: ../up"), "stage name must be lower-case letters, digits, - and _, got '../up'"),
        (changed("name: first", "name: second"), "stages must have names of their own, got second more than once"),
        (changed("{seed: 2,", "{sead: 2,"), "stage 'second': unknown keys ['sead']; known keys: library, physics"),
        (changed("{seed: 2,", "{samples: 2,"), "stage 'second': overrides must not hold samples"),
        (changed("{seed: 2,", "{walk: 2,"), "stage 'second': walk must be a mapping, got 2"),
        (changed("{seed: 2,", "{physics: d,"), "stage 'second': physics must be one of c, mjx, warp, got 'd'"),
        (changed("desired_kl: 0.02", "clip: -1"), "stage 'second': learner.clip must lie in (0, 100), got -1"),
        (changed("desired_kl: 0.02", "hidden: [8]"), "stage 'second': learner.hidden must be (32, 16) as in the first"),
        (changed("desired_kl: 0.02", "symmetry: none"), "stage 'second': learner.symmetry must be network or handed"),
        (changed("{seed: 2, learner: {desired_kl: 0.02}}", "3"), "stage 'second': overrides must be a mapping, got 3"),
        (PAIR + "gpu: 1\n", "gpu must be true or false, got 1"),
        (PAIR + "name: a/b\n", "name must be lower-case letters, digits, - and _, got 'a/b'"),
    ],
)
def test_a_bad_recipe_says_what_is_wrong_in_a_line(text: str, words: str, tmp_path: Path, capsys: Any) -> None:
    assert main(["recipe", written(tmp_path, text), "--runs", str(tmp_path / "runs")]) == 2
    said = capsys.readouterr().err
    assert words in said and said.startswith(f"error: {tmp_path}/pair.yaml") and said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_scale_stretches_samples_and_the_fall_of_the_entropy_bonus(tmp_path: Path) -> None:
    recipe = load_recipe("walk")
    for plain, double in zip(recipe.configs, recipe.scaled(2.0), strict=True):
        assert double.samples == 2 * plain.samples
        assert double.learner.entropy_at(2_000_000) == plain.learner.entropy_at(1_000_000)
        assert double.walk == plain.walk
    assert min(config.samples for config in recipe.scaled(1e-6)) >= 1


def test_without_a_name_the_recipes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recipe"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == recipe_names()
    for line in lines:
        recipe = load_recipe(line.split()[0])
        assert f"{len(recipe.stages)} stages, {recipe.samples / 1e6:.2f}M samples" in line and recipe.about in line


@pytest.mark.parametrize("name", recipe_names())
def test_shipped_recipes_load_and_their_stages_are_what_they_say(name: str) -> None:
    recipe = load_recipe(name)
    assert recipe.name == name
    for stage, config in zip(recipe.stages, recipe.configs, strict=True):
        preset = load_preset(stage.preset)
        assert config.samples == stage.samples
        assert config.walk == preset.walk  # overrides of shipped recipes are about the machine and the learner


def test_the_gpu_does_the_same_as_the_cores() -> None:
    cores, gpu = load_recipe("walk"), load_recipe("walk_gpu")
    assert [config.walk for config in gpu.configs] == [config.walk for config in cores.configs]
    for ours, theirs in zip(gpu.configs, cores.configs, strict=True):
        calm = ours.walk.calm_share > 0.0  # whose advantages rsl-rl alone scales by themselves
        assert (ours.library, ours.device) == (("rsl_rl", "cuda") if calm else ("brax", "cpu"))
        assert ours.physics == "mjx" and 4096 <= ours.copies <= 8192
        rounds = [config.samples / config.copies / config.learner.steps for config in (ours, theirs)]
        assert rounds[0] == pytest.approx(rounds[1], rel=0.05)
        assert ours.learner.entropy == theirs.learner.entropy
