"""Learner and engine: chosen by the hardware or as asked, and refused with one line where they cannot run."""

from __future__ import annotations

from pathlib import Path

import pytest

from train import hardware
from train.__main__ import main
from train.config import PpoConfig

NO_GPU = "there is no NVIDIA GPU here"


@pytest.fixture
def everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """All packages are there."""
    monkeypatch.setattr(hardware, "missing", lambda name: None)


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize(
    ("gpu", "asked", "chosen"),
    [
        (None, {}, ("brax", "mjx")),
        (NO_GPU, {}, ("rsl_rl", "c")),
        (None, {"library": "rsl_rl"}, ("rsl_rl", "mjx")),
        (None, {"physics": "warp"}, ("brax", "warp")),
        (NO_GPU, {"library": "brax"}, ("brax", "c")),
        (NO_GPU, {"physics": "mjx"}, ("rsl_rl", "mjx")),
    ],
)
def test_what_is_not_asked_for_follows_the_hardware(
    gpu: str | None, asked: dict[str, str], chosen: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hardware, "why_no_gpu", lambda: gpu)
    config, reason = hardware.settled(PpoConfig(**asked))  # type: ignore[arg-type]
    assert (config.library, config.physics) == chosen
    assert reason == (gpu or "JAX sees an NVIDIA GPU")


@pytest.mark.usefixtures("everything")
def test_what_is_asked_for_is_not_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "why_no_gpu", lambda: pytest.fail("asked JAX, which takes seconds"))
    _, reason = hardware.settled(PpoConfig(library="brax", physics="c"))
    assert reason == "as asked"


def test_a_gpu_without_brax_trains_with_rsl_rl_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "why_no_gpu", lambda: None)
    monkeypatch.setattr(hardware, "missing", lambda name: "brax" if name == "brax" else None)
    config, reason = hardware.settled(PpoConfig())
    assert (config.library, config.physics) == ("rsl_rl", "mjx")
    assert "Brax is not installed (pip install 'asimov-gym[brax]')" in reason


@pytest.mark.parametrize(
    ("absent", "flags", "words"),
    [
        ("brax", ["--learner", "brax"], "learner brax needs brax, which is not installed: pip install"),
        ("mjx", ["--physics", "mjx"], "physics mjx needs mjx, which is not installed: pip install"),
        (None, ["--physics", "warp"], f"physics warp needs an NVIDIA GPU, and {NO_GPU}: use --physics mjx"),
        (
            None,
            ["--learner", "brax", "--device", "cuda"],
            "device cuda needs a GPU that JAX sees for learner brax, and",
        ),
        (None, ["--learner", "sb3"], "learner must be one of brax, rsl_rl, got 'sb3'"),
        (None, ["--physics", "bullet"], "physics must be one of c, mjx, warp, got 'bullet'"),
    ],
)
def test_what_cannot_run_is_one_line_with_the_way_out(
    absent: str | None,
    flags: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
    monkeypatch.setattr(hardware, "why_no_gpu", lambda: NO_GPU)
    monkeypatch.setattr(hardware, "missing", lambda name: name if name == absent else None)
    try:
        code = main(["ppo", "--preset", "smoke", "--runs", str(tmp_path), *flags])
    except SystemExit as left:  # flags are checked by their parser
        code = left.code
    assert code == 2 and words in " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_no_driver_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "has_nvidia", lambda: False)
    monkeypatch.setattr(hardware, "jax_platform", lambda: pytest.fail("started JAX without need"))
    assert hardware.why_no_gpu() == NO_GPU


@pytest.mark.usefixtures("everything")
def test_a_gpu_that_jax_does_not_see_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware, "has_nvidia", lambda: True)
    monkeypatch.setattr(hardware, "jax_platform", lambda: "cpu")
    assert "JAX does not see it (pip install 'jax[cuda12]')" in (hardware.why_no_gpu() or "")
    monkeypatch.setattr(hardware, "jax_platform", lambda: "gpu")
    assert hardware.why_no_gpu() is None
