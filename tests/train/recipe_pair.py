"""A recipe of two tiny stages, for tests."""

from __future__ import annotations

from pathlib import Path

ROUND = 16 * 8
"""Samples of a round of the recipe `pair`."""
PAIR = """
about: Two tiny stages.
overrides:
  library: rsl_rl
  physics: c
  copies: 16
  threads: 1
  checkpoint_s: 1.0e-6
  learner: {steps: 8, hidden: [32, 16]}
stages:
  - {name: first, preset: smoke, samples: 256}
  - name: second
    preset: smoke
    samples: 512
    overrides: {seed: 2, learner: {desired_kl: 0.02}}
"""


def written(folder: Path, text: str = PAIR) -> str:
    """The recipe as a file; its path."""
    path = folder / "pair.yaml"
    path.write_text(text)
    return str(path)


def changed(old: str, new: str) -> str:
    """The recipe with something replaced."""
    assert old in PAIR
    return PAIR.replace(old, new)
