"""The report of a suite: bars first, then plots, tables, failed rows, conditions, versions and how to get it again.

`write_report` leaves in a folder `result.json` (everything), `report.html` (one page that needs no other file),
`report.md` and the plots as PNG. `summary` is the short form for a terminal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from asimov_gym.evaluation.aggregate import (
    Group,
    PushRow,
    by_config,
    by_scenario,
    failures,
    push_rows,
    push_tallies,
    vendor_figures,
    worst_joint,
)
from asimov_gym.evaluation.bars import BarResult, bars_table, judge
from asimov_gym.evaluation.document import Block, Code, Facts, Folded, Heading, Picture, Text, to_markdown
from asimov_gym.evaluation.html import to_html
from asimov_gym.evaluation.metrics import METRICS
from asimov_gym.evaluation.plot_style import Plot
from asimov_gym.evaluation.plots import draw_plots
from asimov_gym.evaluation.results import ScenarioInfo, SuiteResult
from asimov_gym.evaluation.table import MISSING, Table, between, counted, figure, number, percent, vector

HTML_FILE, MARKDOWN_FILE = "report.html", "report.md"
REACHED = ("mean_vx_m_s", "mean_vy_m_s", "mean_yaw_rate_rad_s")
"""Figures that mean something beside their command alone."""
FOLDED_ROWS = 30
"""A longer table is folded on the page."""


def write_report(result: SuiteResult, folder: Path) -> Path:
    """Write `result.json`, the plots, `report.md` and `report.html`.

    Args:
        result: of a suite; one that is not complete is reported as far as it goes, and says so.
        folder: its run folder, with the traces that the result names; made when missing.

    Returns:
        The page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    result.save(folder)
    title, blocks = _title(result), _blocks(result, draw_plots(result, folder))
    (folder / MARKDOWN_FILE).write_text(to_markdown(title, blocks), encoding="utf-8")
    page = folder / HTML_FILE
    page.write_text(to_html(title, blocks), encoding="utf-8")
    return page


def summary(result: SuiteResult) -> str:
    """The bars and the counts as plain text, for a terminal."""
    bars = [bar for bar in judge(result) if bar.verdict != "not measured"]
    lines = [_title(result), _counts(result), ""]
    width = max((len(bar.name) for bar in bars), default=0)
    for bar in bars:
        mark = {"met": "✓", "missed": "·" if bar.aim else "✗"}[bar.verdict]
        lines.append(f"{mark} {bar.name:<{width}}  {bar.shown:>11}  {bar.asked:<12}  {bar.detail}".rstrip())
    for group in by_config(result):
        lines += _config_line(group)
    lines += [f"not complete: {_missing(result)}"] if not result.complete else []
    return "\n".join(lines)


def markdown(result: SuiteResult) -> str:
    """The tables without plots, for a policy's card."""
    return "\n\n".join(table.markdown() for table in (bars_table(judge(result)), *tables(result)))


def tables(result: SuiteResult) -> list[Table]:
    """Survival and tracking by category, pushes, push limits and figures; tables without rows are left out."""
    rows = push_rows(result)
    found = [
        _config_table(result),
        *[_figures_table(group) for group in by_config(result) if group.name in ("grid", "standing", "hand_over")],
        _tally_table(rows),
        _push_table(result, rows),
        _limit_table(result),
        _vendor_table(result),
    ]
    return [table for table in found if table.rows]


# -- the document ----------------------------------------------------------------------------------


def _title(result: SuiteResult) -> str:
    return f"{result.policy_name}: suite {result.suite}"


def _blocks(result: SuiteResult, plots: Sequence[Plot]) -> list[Block]:
    bars = judge(result)
    blocks: list[Block] = [Text(f"{_counts(result)} {_bar_counts(bars)}")]
    if not result.complete:
        blocks.append(Text(f"This run is not complete: {_missing(result)}.", warning=True))
    blocks += [Heading("Bars"), Text("What a policy worth shipping must reach."), _untitled(bars_table(bars))]
    blocks.append(Heading("Plots"))
    for plot in plots:
        blocks.append(
            Text(f"{plot.title}: left out, {plot.missing}.")
            if plot.path is None
            else Picture(plot.path, plot.title, plot.caption)
        )
    blocks += [Heading("Tables"), *map(_fold, tables(result)), _fold(_scenario_table(result))]
    blocks += [Heading("Failed rows"), *_failed(result)]
    blocks += [Heading("Conditions"), *conditions(result.scenarios)]
    blocks += [Heading("Policy, machine, versions"), _facts(result)]
    blocks += [Heading("How to get it again"), Code(command(result)), Text(_same(result))]
    return blocks


def command(result: SuiteResult) -> str:
    """What to type to measure this again."""
    return f"asimov eval {result.policy_name} --suite {result.suite} --out RUN_FOLDER"


def _same(result: SuiteResult) -> str:
    return (
        f"The policy file has SHA-256 `{result.policy_hash or 'unknown'}`, the suite the hash `{result.suite_hash}`. "
        "Every trial's seed follows from the suite's seed, the scenario and the repeat, so the same versions give the "
        "same figures."
    )


def _counts(result: SuiteResult) -> str:
    ran = [trial for trial in result.trials if trial.was_run]
    up = sum(trial.survived for trial in ran)
    errors = sum(trial.error is not None for trial in ran)
    skipped = len(result.trials) - len(ran)
    planned = sum(info.repeats for info in result.scenarios)
    scenarios = counted(len(result.scenarios), "scenario")
    parts = [f"{len(ran)} of {counted(planned, 'trial')} of {scenarios} run", f"{up} without a fall"]
    parts += [f"{errors} with an error"] if errors else []
    parts += [f"{skipped} not possible on this machine"] if skipped else []
    return ", ".join(parts) + "."


def _bar_counts(bars: Sequence[BarResult]) -> str:
    tally = Counter(bar.verdict for bar in bars)
    return f"Of {len(bars)} bars {tally['met']} met, {tally['missed']} missed, {tally['not measured']} not measured."


def _missing(result: SuiteResult) -> str:
    planned, ran = sum(info.repeats for info in result.scenarios), len(result.trials)
    return "push limits are missing" if ran >= planned else f"{planned - ran} of {planned} trials are missing"


def _untitled(table: Table) -> Table | Folded:
    """The table under a heading that already says what it is."""
    return Table("By measure", table.columns, table.rows, table.note)


def _fold(table: Table) -> Table | Folded:
    return Folded(table) if len(table.rows) > FOLDED_ROWS else table


def _failed(result: SuiteResult) -> list[Block]:
    listed = failures(result)
    if not listed:
        return [Text("None.")]
    rows = tuple(
        (f.scenario, str(f.repeat), MISSING if f.seed is None else str(f.seed), number(f.delay_ms, 0), f.reason)
        for f in listed
    )
    note = "A row that failed a push, fell, or could not be run; none is left out."
    return [
        Text(f"{counted(len(rows), 'trial')} did not pass."),
        _fold(Table("Every trial", ("scenario", "repeat", "seed", "delay, ms", "why"), rows, note)),
    ]


def _facts(result: SuiteResult) -> Facts:
    rows = [
        ("policy", f"{result.policy_name}, `{result.policy_hash[:12]}`"),
        *((key.replace("_", " "), _plain(value)) for key, value in result.contract.items()),
        *((key.replace("_", " "), _plain(value)) for key, value in result.machine.items()),
        ("versions", ", ".join(f"{name} {version}" for name, version in result.versions.items())),
        ("started", result.started),
        ("wall clock", f"{result.wall_clock_s / 60.0:.1f} min"),
    ]
    return Facts(tuple(rows))


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "none"
    return MISSING if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# -- conditions ------------------------------------------------------------------------------------


def conditions(scenarios: Sequence[ScenarioInfo]) -> list[Table]:
    """What holds for most scenarios, and what each category changes."""
    names = list(dict.fromkeys(name for info in scenarios for name in info.conditions))
    usual = {
        name: Counter(_plain(info.conditions.get(name)) for info in scenarios).most_common(1)[0][0] for name in names
    }
    changed: dict[str, dict[str, list[str]]] = {}
    for info in scenarios:
        differing = changed.setdefault(info.config, {})
        for name in names:
            value = _plain(info.conditions.get(name))
            if value != usual[name] and value not in differing.setdefault(name, []):
                differing[name].append(value)
    rows = tuple(
        (config, "; ".join(f"{name.replace('_', ' ')} {', '.join(values)}" for name, values in found.items() if values))
        for config, found in changed.items()
        if any(found.values())
    )
    usually = Table("Usual", ("condition", "value"), tuple((n.replace("_", " "), v) for n, v in usual.items()))
    return [usually, Table("Changed by", ("category", "to"), rows)] if rows else [usually]


# -- tables ----------------------------------------------------------------------------------------


def _config_table(result: SuiteResult) -> Table:
    columns = ("category", "survived", "share", "95 %", "velocity error, m/s", "95 %", "yaw rate error, rad/s", "95 %")
    rows = []
    for group in by_config(result):
        share = group.survival
        cells = [group.name, f"{share.passed} of {share.whole}", percent(share.value)]
        low, high = share.interval
        cells.append(between(100.0 * low, 100.0 * high, 1) if share.whole else MISSING)
        for metric in ("velocity_error_m_s", "yaw_rate_error_rad_s"):
            mean = group.mean(metric)
            cells += [number(mean.value), between(mean.low, mean.high)] if mean is not None else [MISSING, MISSING]
        rows.append(tuple(cells))
    note = (
        "Shares with Wilson's 95 % interval, means with a bootstrap over repeats. Errors are of trials without a fall."
    )
    return Table("By category", columns, tuple(rows), note)


def _config_line(group: Group) -> list[str]:
    """A category for the terminal, where its survival is not the whole."""
    share = group.survival
    lines = []
    if share.passed < share.whole:
        lines.append(f"  {group.name}: {share.passed} of {counted(share.whole, 'trial')} without a fall")
    if group.skipped:
        lines.append(f"  {group.name}: {counted(len(group.skipped), 'trial')} {group.skipped[0].error}")
    return lines


def _figures_table(group: Group) -> Table:
    rows = []
    for name in group.metrics:
        what, mean = METRICS[name], group.mean(name)
        if mean is None or name in REACHED:
            continue
        worst = group.largest(name)
        joint = worst_joint([trial.metrics for trial in group.trials], name)
        meaning = what.description + (f" ({joint.replace('_', ' ')})" if joint else "")
        interval = MISSING if mean.low is None else f"{figure(mean.low)} … {figure(mean.high)}"
        rows.append((meaning, what.unit or MISSING, figure(mean.value), interval, figure(worst), str(mean.count)))
    columns = ("figure", "unit", "mean", "95 %", "largest", "trials")
    return Table(f"Figures: {group.name}", columns, tuple(rows), "Joints in brackets are those of the largest value.")


def _tally_table(rows: Sequence[PushRow]) -> Table:
    cells = tuple(
        (
            tally.config,
            tally.tier or MISSING,
            f"{tally.rows.passed} of {tally.rows.whole}",
            f"{tally.trials.passed} of {tally.trials.whole}",
            percent(tally.trials.value),
            number(tally.max_force_survived_n, 0),
        )
        for tally in push_tallies(rows)
    )
    columns = ("category", "tier", "rows passed", "single pushes passed", "push pass rate", "largest survived, N")
    return Table("Pushes by tier", columns, cells, "A row passes only if all its repeats do.")


def _push_table(result: SuiteResult, rows: Sequence[PushRow]) -> Table:
    cells = tuple(
        (
            row.scenario,
            row.push.label,
            row.push.body,
            vector(row.push.direction, 0),
            number(row.push.force, 0),
            row.push.tier or MISSING,
            f"{row.outcomes.passed} of {row.outcomes.whole}",
            "passed" if row.passed else "not passed",
        )
        for row in rows
    )
    columns = ("scenario", "push", "body", "direction", "N", "tier", "repeats passed", "row")
    return Table("Pushes", columns, cells)


def _limit_table(result: SuiteResult) -> Table:
    cells = tuple(
        (
            limit.body,
            vector(limit.direction, 2),
            number(limit.speed, 1),
            number(limit.largest_survived_n, 0),
            "nothing tried" if limit.smallest_failed_n is None else number(limit.smallest_failed_n, 0),
            str(limit.repeats),
        )
        for limit in result.push_limits
    )
    columns = ("body", "direction", "walking at, m/s", "largest survived, N", "smallest that felled it, N", "repeats")
    return Table("Push limits", columns, cells, "0.15 s each; the largest force that every repeat survived, bisected.")


def _vendor_table(result: SuiteResult) -> Table:
    cells = tuple(
        (
            figures.config,
            percent(figures.upright_rate),
            percent(figures.push_pass_rate),
            number(figures.max_force_survived_n, 0),
            number(figures.velocity_rmse_m_s),
            number(figures.drift_final_m, 2),
        )
        for figures in vendor_figures(result)
    )
    columns = ("category", "upright rate", "push pass rate", "max force survived, N", "tracking RMSE, m/s", "drift, m")
    note = "The figures of the robot maker's benchmark, over all repeats."
    return Table("In the benchmark's terms", columns, cells, note)


def _scenario_table(result: SuiteResult) -> Table:
    rows = []
    for group in by_scenario(result):
        info, share = group.scenarios[0], group.survival
        reached = [group.mean_value(name) for name in REACHED]
        known = [value for value in reached if value is not None]
        asked = vector(info.commands[0][1:]) if len(info.commands) == 1 else f"{len(info.commands)} commands"
        rows.append(
            (
                info.id,
                f"{share.passed} of {share.whole}" if share.whole else "not run",
                asked,
                vector(known) if len(known) == 3 else MISSING,
                number(group.mean_value("velocity_error_m_s")),
                number(group.mean_value("yaw_rate_error_rad_s")),
                number(group.mean_value("drift_final_m"), 2),
            )
        )
    columns = (
        "scenario",
        "survived",
        "asked vx, vy, wz",
        "reached",
        "velocity error, m/s",
        "yaw rate error, rad/s",
        "drift, m",
    )
    return Table("Every scenario", columns, tuple(rows))
