"""The notebooks run and say what is so, and what is committed of them is of one whole run and fit for the public.

`make test` runs the first three on the suite `quick` and the fourth with the preset `smoke`; `make test-slow` also the
second with all its repeats and the fourth with the preset `laptop`, which takes as long as a training.
"""

from __future__ import annotations

import ast
import base64
import re
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import pytest

from asimov_gym.assets import asset_path
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.policy import load_policy
from asimov_gym.recording.summary import summarize

nbformat = pytest.importorskip("nbformat", reason="needs the extra `notebook`")
pytest.importorskip("nbclient", reason="needs the extra `notebook`")
from notebooks import run as runner  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FIGURES = {"evaluate_a_policy": 5, "compare_two_policies": 1, "inside_a_rollout": 4, "train_your_own": 2}
MAX_BYTES = 600_000
PRIVATE = re.compile(
    r"/(?:home|root|Users|work|tmp|mnt|opt|var|usr)/|[A-Z]:\\\\|-----BEGIN|\b(?:ghp|hf|sk|AKIA)[_-]?[A-Za-z0-9]{16,}"
    r"|eyJ[A-Za-z0-9_-]{10,}\.eyJ"
)
"""Paths of a machine, keys and tokens."""
NUMBER = r"([+-]?\d+(?:\.\d+)?)"


def load(name: str) -> Any:
    return nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def run(name: str, folder: Path, timeout_s: float = 300.0, before: str = "", **parameters: object) -> Any:
    """A notebook after its run in a folder, with other values in its first code cell.

    Args:
        name: of the file.
        folder: where it runs.
        timeout_s: of each cell.
        before: heading of the section before which it ends; it runs to its end without one.
        parameters: values in place of those in the cell.
    """
    notebook = load(name)
    if before:
        (end,) = [place for place, cell in enumerate(notebook.cells) if cell.source.startswith(f"## {before}\n")]
        notebook.cells = notebook.cells[:end]
    cell = code_cells(notebook)[0]
    known = {target.id for node in ast.parse(cell.source).body for target in node.targets}  # type: ignore[attr-defined]
    assert set(parameters) <= known, f"{name} has the parameters {sorted(known)}"
    cell.source += "".join(f"\n{key} = {value!r}" for key, value in parameters.items())
    runner.execute(notebook, folder, timeout_s)
    return notebook


def text(notebook: Any) -> str:
    """Everything that is printed or shown as text."""
    parts: list[str] = []
    for cell in code_cells(notebook):
        for output in cell.outputs:
            if output.output_type == "stream":
                parts.append(output.text)
            elif "data" in output:
                parts.append(output.data.get("text/markdown") or output.data.get("text/plain", ""))
    return "\n".join(parts)


def figures(notebook: Any) -> list[Any]:
    """The pictures, as arrays of pixels."""
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs if "data" in output]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.data]
    return [imageio.imread(base64.b64decode(picture)) for picture in pictures]


def found(pattern: str, printed: str) -> tuple[str, ...]:
    match = re.search(pattern, printed)
    assert match is not None, f"{pattern!r} is not in:\n{printed}"
    return match.groups()


def check_figures(notebook: Any, name: str) -> None:
    pictures = figures(notebook)
    assert len(pictures) >= FIGURES[name]
    for picture in pictures:
        assert min(picture.shape[:2]) > 200 and picture[..., :3].std() > 10.0, "a picture is blank"


def only(paths: Any) -> Path:
    (path,) = paths
    return path


# -- what is committed -----------------------------------------------------------------------------


def test_all_notebooks_are_known() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(FIGURES)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_outputs_are_of_one_run_without_an_error(path: Path) -> None:
    notebook = load(path.stem)
    nbformat.validate(notebook)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not [output for cell in cells for output in cell.outputs if output.output_type == "error"]
    assert cells[0].metadata.get("tags") == ["parameters"] and not cells[0].outputs
    assert notebook.metadata.kernelspec.name == "python3"
    check_figures(notebook, path.stem)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_notebooks_are_small_and_name_no_machine(path: Path) -> None:
    assert path.stat().st_size < MAX_BYTES
    notebook = load(path.stem)
    everything = "\n".join([text(notebook), *(cell.source for cell in notebook.cells)])
    assert not PRIVATE.findall(everything)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_lead_somewhere(path: Path) -> None:
    prose = "\n".join(cell.source for cell in load(path.stem).cells if cell.cell_type == "markdown")
    for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", prose):
        assert (path.parent / target).exists(), target


def test_what_is_private_is_seen() -> None:
    assert PRIVATE.search("saved in /home/somebody/runs") and PRIVATE.search("ghp_" + "a1B2" * 9)
    assert not PRIVATE.search("runs/2026-01-01_00-00-00_quick/report.html, friction 0.6 N/m")


def test_a_notebook_that_fails_stays_as_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "broken.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("print(1)\n1 / 0")]), path)
    before = path.read_bytes()
    assert runner.main([str(path)]) == 1
    assert path.read_bytes() == before and [one.name for one in tmp_path.iterdir()] == ["broken.ipynb"]
    printed = capsys.readouterr()
    assert "broken: cell 1 of 1" in printed.out and "ZeroDivisionError" in printed.err
    assert runner.main([str(tmp_path / "none.ipynb")]) == 2


# -- runs ------------------------------------------------------------------------------------------


def test_evaluate_a_policy(tmp_path: Path) -> None:
    notebook = run("evaluate_a_policy", tmp_path, SUITE="quick")
    printed = text(notebook)
    check_figures(notebook, "evaluate_a_policy")
    result = SuiteResult.load(only(tmp_path.glob("runs/*_quick")))
    assert result.complete and (only(tmp_path.glob("runs/*_quick")) / "report.html").is_file()
    survived = sum(trial.survived for trial in result.trials)
    assert f"{len(result.trials)} of {len(result.trials)} trials" in printed and f"{survived} without a fall" in printed
    grid = [trial for trial in result.trials if trial.config == "grid"]
    up = sum(trial.survived for trial in grid)
    assert f"| grid | {up} of {len(grid)} |" in printed
    assert up >= 0.95 * len(grid), "the shipped policy walks its command range"
    (worst,) = found(rf"worst command: \S+, {NUMBER} m/s", printed)
    errors = [trial.metrics["velocity_error_m_s"] for trial in grid if trial.survived]
    assert 0.0 < float(worst) <= max(errors) + 0.001  # a mean over repeats, printed to a millimetre per second
    assert "payload/forward_payload_kg_3 " in printed


def compared(notebook: Any) -> tuple[float, float, float]:
    """Difference and interval of the velocity error, after a look at all that the comparison says."""
    printed = text(notebook)
    check_figures(notebook, "compare_two_policies")
    assert re.search(r"\| survival \| all \| \d+ of \d+ .* \d+ gained, \d+ lost, p = ", printed)
    value, low, high = map(float, found(rf"paired: +{NUMBER}, from {NUMBER} to {NUMBER}", printed))
    same, wide_low, wide_high = map(float, found(rf"unpaired: +{NUMBER}, from {NUMBER} to {NUMBER}", printed))
    assert low <= value <= high and same == value
    # Pairs make the interval narrower where both walk alike, and hardly wider where they do not.
    assert wide_high - wide_low >= 0.8 * (high - low), "pairs make no interval much wider"
    return value, low, high


def test_compare_two_policies(tmp_path: Path) -> None:
    notebook = run("compare_two_policies", tmp_path, SUITE="quick", REPEATS=2)
    compared(notebook)
    rows, flags = found(r"(\d+) figures compared: \{(.*)\}", text(notebook))
    counts = [int(count) for count in re.findall(r": (\d+)", flags)]
    assert sum(counts) == int(rows) > 50
    assert "'better'" in flags or "'worse'" in flags, "15 % softer joints change the walk"


def test_compare_a_policy_with_itself(tmp_path: Path) -> None:
    """The same trials give the same figures, whatever ran before: no difference at all."""
    shipped = str(asset_path("policies", "asimov_walk.onnx"))
    notebook = run(
        "compare_two_policies", tmp_path, before="Who walks better?", FIRST=shipped, SECOND=shipped, SUITE="smoke"
    )
    printed = text(notebook)
    rows = re.findall(r"(\d+) gained, (\d+) lost, p = (\S+) \| (.+) \|", printed)
    assert rows and all(row == ("0", "0", "1", "no difference") for row in rows)


def test_inside_a_rollout(tmp_path: Path) -> None:
    notebook = run("inside_a_rollout", tmp_path)
    printed = text(notebook)
    check_figures(notebook, "inside_a_rollout")
    assert re.search(r"0\.00 s +notebook +velocity +VELOCITY_IN_DAMP", printed), "too early a velocity is dropped"
    vector = rf"{NUMBER}, {NUMBER}, {NUMBER}"
    rows = re.findall(rf"\| \S+ … \S+ \| {vector} \| {vector} \|", printed)
    assert len(rows) == 4
    for *asked, vx, vy, wz in [map(float, row) for row in rows[:3]]:  # the last one holds the push
        assert abs(vx - asked[0]) < 0.1 and abs(vy - asked[1]) < 0.1 and abs(wz - asked[2]) < 0.15
    assert "alert at 23.50 s: MOTOR_TEMP_HIGH" in printed and "warmest at the end: L_Knee" in printed
    walking, pushed, when = map(
        float, found(rf"up to {NUMBER} degrees\nlargest lean of the walk: {NUMBER} degrees at {NUMBER} s", printed)
    )
    assert walking < pushed < 60.0 and 20.5 <= when < 22.0, "the push comes at 20.5 s"
    assert 0.0 <= float(found(rf"acted: median {NUMBER} ms", printed)[0]) < 100.0
    walk = summarize(only(tmp_path.glob("runs/*/walk.mcap")))
    assert walk.complete and [span.state for span in walk.modes] == ["DAMP", "STAND", "MOVE/POLICY", "DAMP"]


def trained(notebook: Any, folder: Path) -> str:
    """What is printed, after a look at what the training left."""
    printed = text(notebook)
    check_figures(notebook, "train_your_own")
    (place,) = folder.glob("runs/*_notebook")
    policy = load_policy(place / "policy.onnx")
    assert f"trained_commit     {policy.contract.trained_commit}" in printed
    assert float(found(r"on 1000 observations: (\S+)", printed)[0]) < 1e-5
    assert re.search(r"\d+ of \d+ trials of \d+ scenarios run, \d+ without a fall", printed)
    drive = summarize(place / "drive.mcap")
    fell = [alert for alert in drive.alerts if "FALL" in alert.text]
    assert ("it did not fall" in printed) == (not fell)
    return printed


def test_train_your_own(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason="needs the extra `train`")
    printed = trained(run("train_your_own", tmp_path, PRESET="smoke", SUITE="smoke"), tmp_path)
    assert float(found(rf"{NUMBER} million samples in", printed)[0]) == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_compare_two_policies_with_all_repeats(tmp_path: Path) -> None:
    value, low, high = compared(run("compare_two_policies", tmp_path, timeout_s=1200.0))
    assert low > 0.0 or high < 0.0, f"15 % softer joints change the velocity error: {value}, {low} to {high}"


@pytest.mark.slow
def test_train_your_own_with_the_laptop_preset(tmp_path: Path) -> None:
    pytest.importorskip("rsl_rl", reason="needs the extra `train`")
    notebook = run("train_your_own", tmp_path, timeout_s=3 * 3600.0, PRESET="laptop", SUITE="quick")
    printed = trained(notebook, tmp_path)
    assert "it did not fall" in printed
    result = SuiteResult.load(only(tmp_path.glob("runs/*_notebook")) / "evaluation")
    grid = [trial for trial in result.trials if trial.config == "grid"]
    assert sum(trial.survived for trial in grid) >= 0.9 * len(grid), "the preset walks the command range"
