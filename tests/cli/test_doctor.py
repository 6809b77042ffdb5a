"""`asimov doctor` and the command line as a whole."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from asimov_gym.cli import doctor, main
from asimov_gym.cli.doctor import BASE_PACKAGES, Doctor, Verdict
from asimov_gym.rendering.backends import headless_backend, install_line, probe

ROOT = Path(__file__).resolve().parents[2]


def test_doctor_lists_what_the_package_requires() -> None:
    with open(ROOT / "pyproject.toml", "rb") as file:
        dependencies = tomllib.load(file)["project"]["dependencies"]
    assert sorted(BASE_PACKAGES) == sorted(line.split(">=")[0] for line in dependencies)


def test_doctor_reports_every_section_and_succeeds(capsys: pytest.CaptureFixture[str]) -> None:
    assert Doctor(seconds=0.1).run() == 0
    report = capsys.readouterr().out
    for word in ("Base", "Engines", "C physics", "Renderers", "Learners", "Policies", "The base install works"):
        assert word in report


def test_doctor_fails_when_a_base_package_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "BASE_PACKAGES", ("numpy", "no-such-package"))
    for section in ("engine_findings", "renderer_findings", "learner_findings", "policy_findings"):
        monkeypatch.setattr(doctor, section, lambda *_: [])
    assert Doctor().run() == 1
    assert "pip install no-such-package" in " ".join(capsys.readouterr().out.split())


def test_doctor_names_the_cure_of_an_absent_learner(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    findings = doctor.learner_findings()
    assert [finding.verdict for finding in findings] == [Verdict.ABSENT, Verdict.ABSENT]
    assert "[train]" in findings[0].cure


def test_doctor_survives_a_damaged_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "runs" / "one").mkdir(parents=True)
    (tmp_path / "runs" / "one" / "policy.onnx").write_bytes(b"not a network")
    monkeypatch.chdir(tmp_path)
    (finding,) = [f for f in doctor.policy_findings() if f.name.startswith("runs")]
    assert finding.verdict is Verdict.BROKEN


@pytest.mark.parametrize("seconds", [0.0, -1.0, 61.0])
def test_measuring_time_is_checked(seconds: float) -> None:
    with pytest.raises(ValueError, match="seconds"):
        Doctor(seconds=seconds)


def test_unknown_backend_is_reported_as_broken() -> None:
    outcome = probe("no-such-backend")
    assert not outcome.works
    assert "no-such-backend" in outcome.detail


def test_headless_backend_is_one_that_draws() -> None:
    backend = headless_backend()
    if backend is None:
        pytest.skip(install_line())
    assert probe(backend).works


def test_help_is_quick_and_names_every_command() -> None:
    """Loading MuJoCo to print a help text would be felt."""
    code = (
        "import sys\n"
        "from asimov_gym.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as exit: assert exit.code == 0\n"
        "print(sorted({'mujoco', 'onnxruntime', 'matplotlib', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    for command in ("demo", "doctor", "view"):
        assert command in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


def test_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        main(["dance"])
    assert exit_info.value.code == 2
    assert "dance" in capsys.readouterr().err
