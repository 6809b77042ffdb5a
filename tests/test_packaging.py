"""The wheel carries what the package needs at run time, and the base install stays light."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from asimov_gym.assets import asset_path, config_path

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "jax", "rsl-rl-lib", "tensorboard", "stable-baselines3")


def project() -> dict:
    with open(ROOT / "pyproject.toml", "rb") as file:
        return tomllib.load(file)


def test_asset_path_finds_the_model() -> None:
    path = asset_path("asimov1.xml")
    assert path.is_file()
    assert "<mujoco" in path.read_text()


def test_missing_asset_is_named_together_with_what_is_there() -> None:
    with pytest.raises(FileNotFoundError, match=r"'policies/of/nobody\.onnx'.*holds .*asimov(1|_walk)"):
        asset_path("policies", "of", "nobody.onnx")


def test_missing_preset_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"'no-such\.yaml' among the configs"):
        config_path("no-such.yaml")


def test_base_dependencies_hold_no_learner() -> None:
    names = [line.split(">")[0].split("=")[0].split("<")[0] for line in project()["project"]["dependencies"]]
    assert not set(names) & set(HEAVY)


def test_installed_metadata_matches_pyproject() -> None:
    """An environment set up before the last change of pyproject.toml tests something else than what is shipped."""
    try:
        installed = distribution("asimov-gym")
    except PackageNotFoundError:
        pytest.skip("asimov-gym is not installed in this environment; `make test` installs it")
    table = project()["project"]
    assert installed.version == table["version"]
    extras = set(installed.metadata.get_all("Provides-Extra") or [])
    assert extras == set(table["optional-dependencies"])


def test_importing_the_robot_side_loads_neither_torch_nor_jax() -> None:
    modules = [
        name
        for name in ("robot", "physics", "policy", "firmware", "edge", "recording", "envs", "cli")
        if importlib.util.find_spec(f"asimov_gym.{name}") is not None
    ]
    code = (
        "import sys, importlib\n"
        f"for name in {modules!r}: importlib.import_module('asimov_gym.' + name)\n"
        "print(sorted({'torch', 'jax', 'rsl_rl'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_wheel_holds_assets_and_finds_them(tmp_path: Path) -> None:
    """Build the wheel, unpack it by pip somewhere else and load the model from there."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", tmp_path, ROOT], check=True, timeout=300)
    (wheel,) = tmp_path.glob("asimov_gym-*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in (
        "asimov_gym/py.typed",
        "asimov_gym/data/assets/asimov1.xml",
        "asimov_gym/data/configs/",
        "train/__main__.py",
        "dist-info/licenses/NOTICE",
    ):
        assert any(wanted in name for name in names), f"{wanted} is not in {wheel.name}"
    assert not [name for name in names if name.startswith(("tests/", "proto/"))]

    target = tmp_path / "site"
    subprocess.run([*pip, "install", "--no-deps", "--quiet", "--target", target, wheel], check=True, timeout=300)
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import mujoco, asimov_gym\n"
        "from asimov_gym.assets import asset_path, config_path\n"
        "assert asimov_gym.__file__.startswith(sys.argv[1]), asimov_gym.__file__\n"
        "model = mujoco.MjModel.from_xml_path(str(asset_path('asimov1.xml')))\n"
        "assert any(config_path().rglob('*.yaml'))\n"
        "print(model.nu)"
    )
    command = [sys.executable, "-I", "-c", code, str(target)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 25
