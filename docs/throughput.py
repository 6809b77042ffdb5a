"""Makes the page of measured speeds from the files in `benchmarks`, and its chart."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from asimov_gym.cli.bench_env import ENVIRONMENTS

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
_WIDTH, _LABEL, _BAR, _ROW = 790, 250, 380, 24
"""Of the chart, its labels, its longest bar, a line of it; px."""
_RAW, _ENV = "#c9d6e2", "#2b5f8a"


def results() -> list[dict[str, Any]]:
    """Committed results, by machine and subject."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in FOLDER.glob("*.json")]
    return sorted(found, key=lambda result: (_machine(result), result["subject"]))


def _machine(result: dict[str, Any]) -> str:
    m = result["machine"]
    return ", ".join([m["cpu"], f"{m['cores']} cores", f"{m['memory_gb']:.0f} GB", *m["gpus"]])


def _rows(result: dict[str, Any]) -> list[tuple[str, float, float, float]]:
    """What was measured, its steps per second, those of the bare physics, and the share."""
    if result["subject"] == "profiles":
        return []
    if result["subject"] == "train":
        t = result["training"]
        label = f"training, preset {result['settings']['preset']}, {t['copies']} copies"
        return [(label, t["samples_per_s"], t["physics_steps_per_s"], t["share"])]
    return [
        (
            f"{ENVIRONMENTS[row['environment']]}, {row['copies']} copies",
            row["steps_per_s"],
            row["physics_steps_per_s"],
            row["share"],
        )
        for row in result["throughput"]
    ]


def svg() -> str:
    """Bars of every committed result, deterministic text."""
    lines, y = [], 30
    everything = [(result, _rows(result)) for result in results()]
    top = max((raw for _, rows in everything for _, _, raw, _ in rows), default=1.0)
    before = None
    for result, rows in everything:
        if _machine(result) != before:
            before = _machine(result)
            y += 10
            lines.append(f'<text x="10" y="{y}" font-weight="bold">{escape(before)}</text>')
            y += 12
        for label, steps, raw, share in rows:
            lines.append(_bar(y, label, steps / top, raw / top, f"{steps:,.0f} of {raw:,.0f}: {share:.0%}"))
            y += _ROW
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {y + 10}" font-family="sans-serif" '
        f'font-size="12">\n<title>Environment steps per second, and those of the bare physics</title>\n'
        f'<rect width="{_WIDTH}" height="{y + 10}" fill="white"/>\n'
        '<text x="10" y="18" fill="#444">steps per second: environment (dark), bare physics (light)</text>'
    )
    return "\n".join([head, *lines, "</svg>"]) + "\n"


def _bar(y: int, label: str, env: float, raw: float, words: str) -> str:
    return (
        f'<text x="{_LABEL - 8}" y="{y + 12}" text-anchor="end">{escape(label)}</text>'
        f'<rect x="{_LABEL}" y="{y}" width="{_BAR * raw:.1f}" height="16" fill="{_RAW}"/>'
        f'<rect x="{_LABEL}" y="{y + 4}" width="{_BAR * env:.1f}" height="8" fill="{_ENV}"/>'
        f'<text x="{_LABEL + _BAR * raw + 6:.1f}" y="{y + 12}" fill="#444">{escape(words)}</text>'
    )


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def _env_part(result: dict[str, Any]) -> str:
    rows = [
        [
            ENVIRONMENTS[row["environment"]],
            row["copies"],
            f"{row['steps_per_s']:,.0f}",
            f"{row['physics_steps_per_s']:,.0f}",
            f"{row['share']:.2f} ± {row['spread'] / 2:.2f}",
            "—" if row["compile_s"] is None else f"{row['compile_s']:.1f} s",
            "—" if row["peak_memory_mb"] is None else f"{row['peak_memory_mb']:,.0f} MB",
        ]
        for row in result["throughput"]
    ]
    header = ["environment", "copies", "steps/s", "bare physics", "share", "compile", "memory"]
    first = [
        f"First step after the import, {ENVIRONMENTS[name]}: {step['step_s']:.2f} s"
        + ("" if step["cached_s"] is None else f", {step['cached_s']:.2f} s the second time")
        + f"; the import {step['import_s']:.2f} s.\n"
        for name, step in result["first_step"].items()
    ]
    return "\n".join([_table(header, rows), *first])


def _train_part(result: dict[str, Any]) -> str:
    t = result["training"]
    rows = [
        ["samples per second, learning included", f"{t['samples_per_s']:,.0f}"],
        ["bare physics, environment steps per second", f"{t['physics_steps_per_s']:,.0f}"],
        ["share", f"{t['share']:.2f} ± {t['spread'] / 2:.2f}"],
        [f"a round of {t['samples']:,} samples: bare physics", f"{t['physics_s']:.2f} s"],
        ["environment around it, and the networks' answers", f"{t['collect_s'] - t['physics_s']:.2f} s"],
        ["learning", f"{t['learn_s']:.2f} s"],
    ]
    return _table([f"training, preset `{result['settings']['preset']}`, {t['copies']} copies", ""], rows)


def _profiles_part(result: dict[str, Any]) -> str:
    rows = [
        [p["profile"], f"{p['steps_per_s']:,.0f}", f"{p['slower']:.2f} ± {p['spread'] / 2:.2f}"]
        for p in result["profiles"]
    ]
    return _table([f"bare physics, {result['settings']['copies']} copies walking", "steps/s", "cost"], rows)


_PARTS = {"train": _train_part, "profiles": _profiles_part}
"""How a subject is shown; any other is an environment."""


def page(header: str) -> str:
    """The page `benchmarks.md`."""
    parts, before = [], None
    for result in results():
        if _machine(result) != before:
            before = _machine(result)
            parts.append(f"## {before}\n")
        m, load = result["machine"], result["load_before"]
        versions = ", ".join(f"{name} {number}" for name, number in m["packages"].items())
        parts.append(_PARTS.get(result["subject"], _env_part)(result))
        busy = "" if load is None else f" Load average before: {load:g}."
        threads = result["settings"]["threads"]
        parts.append(f"{threads} threads. {m['system']}, Python {m['python']}, {versions}.{busy}\n")
    body = "\n".join(parts) or "No results are committed yet.\n"
    return f"""{header}
# How fast it is

Speeds are ratios measured in one run: the environment and the bare engine under it (`mujoco.rollout`, or the compiled
physics step of MJX) do the same physics steps in turn, several times, and medians are shown. The environment is
`Asimov-Walk-v0` with observation, reward, randomised bodies, sensor noise, kicks and restarts, its robots walking with
the shipped policy. A step is 20 ms of one robot.

```sh
asimov bench env --json benchmarks                 # environments, each number of copies
asimov bench train --json benchmarks               # training, learning included
asimov bench profiles --json benchmarks            # what each part of the evaluation physics costs
asimov bench env --environments batch jax-mjx jax-warp --copies 4096 8192 16384 --json benchmarks    # on a GPU
asimov bench robot                                 # the simulated robot: punctuality, speed in lockstep
```

Each command writes a file named after the machine; `python docs/generate.py` makes this page of all of them.

![Environment steps per second, of those of the bare physics](benchmarks.svg)

{body}"""
