"""`asimov doctor`: what is installed, what of it works, and the line that installs the rest."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from pathlib import Path

from asimov_gym.versions import installed_versions

BASE_PACKAGES = (
    "array-api-compat",
    "gymnasium",
    "imageio",
    "imageio-ffmpeg",
    "matplotlib",
    "mcap",
    "mujoco",
    "numpy",
    "onnxruntime",
    "protobuf",
    "pyyaml",
    "rich",
    "tyro",
)
"""Distributions that the base install consists of."""


class Verdict(Enum):
    """How a finding is shown."""

    WORKS = "[green]works[/green]"
    ABSENT = "[yellow]absent[/yellow]"
    BROKEN = "[red]broken[/red]"


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    verdict: Verdict
    detail: str = ""
    cure: str = ""
    """Command or condition that mends it; empty if nothing needs mending."""
    required: bool = False
    """Whether the base install needs it."""


@dataclass(frozen=True)
class Doctor:
    """Say what is installed, which engines, renderers, learners and lanes work, and how to get the rest.

    Exit code 0 if the base install works, 1 if something it needs is missing.
    """

    seconds: float = 1.0
    """How long to measure the speed of the C physics."""

    def __post_init__(self) -> None:
        if not 0.0 < self.seconds <= 60.0:
            raise ValueError(f"seconds is {self.seconds}; allowed: above 0, at most 60")

    def run(self) -> int:
        """Print the report."""
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        console = Console()
        sections: dict[str, Callable[[], list[Finding]]] = {
            "Base": base_findings,
            "Engines": lambda: engine_findings(self.seconds),
            "Renderers": renderer_findings,
            "Learners": learner_findings,
            "Lanes": lane_findings,
            "Policies": policy_findings,
        }
        table = Table(box=None, pad_edge=False)
        for column in ("", "what", "state", "detail"):
            table.add_column(column)
        findings: list[Finding] = []
        for section, examine in sections.items():
            with console.status(f"Looking at: {section.lower()}"):
                found = examine()
            findings += found
            for row, finding in enumerate(found):
                title = section if row == 0 else ""
                table.add_row(title, finding.name, finding.verdict.value, escape(finding.detail))
            table.add_section()
        console.print(table)
        cures = [(finding.name, finding.cure) for finding in findings if finding.cure]
        if cures:
            console.print("\nTo get the rest:")
            for name, cure in cures:
                # No wrapping and no markup: the line is there to be copied.
                console.print(f"  {name + ':':<12}{cure}", markup=False, highlight=False, soft_wrap=True)
            console.print()
        missing = [finding for finding in findings if finding.required and finding.verdict is not Verdict.WORKS]
        if missing:
            console.print(f"[red]The base install does not work:[/red] {', '.join(f.name for f in missing)}.")
            return 1
        console.print("The base install works.")
        return 0


def extra_line(extra: str) -> str:
    """Command that installs the extra of that name, for a source checkout or an installed package."""
    from asimov_gym import assets

    checkout = (Path(assets.__file__).resolve().parents[1] / "pyproject.toml").is_file()
    return f"pip install -e '.[{extra}]'" if checkout else f"pip install 'asimov-gym[{extra}]'"


def base_findings() -> list[Finding]:
    """The interpreter, the packages of the base install, and the robot's model."""
    found = [
        Finding(
            "Python",
            Verdict.WORKS if sys.version_info >= (3, 11) else Verdict.BROKEN,
            f"{platform.python_version()} on {platform.system()} {platform.machine()}, {os.cpu_count()} cores",
            "" if sys.version_info >= (3, 11) else "Python >= 3.11",
            required=True,
        )
    ]
    versions = installed_versions(BASE_PACKAGES)
    missing = [name for name in BASE_PACKAGES if name not in versions]
    if versions:
        shown = ", ".join(f"{name} {version}" for name, version in versions.items())
        found.append(Finding("packages", Verdict.WORKS, shown, required=True))
    if missing:
        cure = "pip install " + " ".join(missing)
        found.append(Finding("packages", Verdict.ABSENT, ", ".join(missing), cure, required=True))
    try:
        from asimov_gym.assets import asset_path

        found.append(Finding("robot model", Verdict.WORKS, str(asset_path("asimov1.xml")), required=True))
    except FileNotFoundError as error:
        found.append(Finding("robot model", Verdict.ABSENT, str(error), "reinstall asimov-gym", required=True))
    return found


def engine_findings(seconds: float) -> list[Finding]:
    """C physics, with its speed measured for `seconds`, and MJX."""
    try:
        speed = physics_speed(seconds)
        detail = f"{os.cpu_count()} threads, {speed:,.0f} env-steps/s (4 × 5 ms, feet-only contacts)"
        found = [Finding("C physics", Verdict.WORKS, detail, required=True)]
    except Exception as error:  # whatever is wrong is what the report is for
        found = [Finding("C physics", Verdict.BROKEN, f"{type(error).__name__}: {error}", required=True)]
    found.append(
        _imported(
            "MJX (JAX)",
            ("jax", "mujoco.mjx"),
            "import jax, asimov_gym.physics.functional.quiet_mjx; "
            "print('jax', jax.__version__, 'on', jax.default_backend())",
            extra_line("mjx"),
        )
    )
    return found


def physics_speed(seconds: float) -> float:
    """Environment steps (four physics steps of 5 ms each) per second of the C physics, standing robots, all cores."""
    import numpy as np

    from asimov_gym.physics import CPhysics, JointTarget
    from asimov_gym.robot.joints import STAND_POSITION

    copies = 64 * (os.cpu_count() or 1)
    physics = CPhysics(copies=copies, profile="training")
    target = JointTarget(np.tile(STAND_POSITION, (copies, 1)))
    physics.step(target, substeps=4)
    steps, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        physics.step(target, substeps=4)
        steps += copies
    return steps / elapsed


def renderer_findings() -> list[Finding]:
    """Each OpenGL backend, tried in a process of its own. None is required: plots and recordings need none."""
    from asimov_gym.rendering.backends import HEADLESS_BACKENDS, INSTALL_LINES, probe

    found = []
    for backend in (*HEADLESS_BACKENDS, "glfw"):
        outcome = probe(backend)
        use = "window" if backend == "glfw" else "headless"
        if outcome.works:
            found.append(Finding(backend, Verdict.WORKS, use))
        else:
            found.append(Finding(backend, Verdict.ABSENT, f"{use}; {outcome.detail}", INSTALL_LINES.get(backend, "")))
    return found


def learner_findings() -> list[Finding]:
    """The learners and what they stand on."""
    return [
        _imported(
            "rsl-rl",
            ("torch", "rsl_rl"),
            "import torch, rsl_rl.runners; from importlib.metadata import version; "
            "print('rsl-rl-lib', version('rsl-rl-lib'), 'with torch', torch.__version__ + ',', "
            "'CUDA' if torch.cuda.is_available() else 'CPU')",
            extra_line("train"),
        ),
        _imported(
            "brax",
            ("jax", "brax", "flax", "optax"),
            "from importlib.metadata import version; import train.brax_learner, jax; "
            "print('brax', version('brax'), 'with jax', jax.__version__ + ',', jax.default_backend().upper())",
            extra_line("brax"),
        ),
    ]


def lane_findings() -> list[Finding]:
    """What the lanes of the simulated robot stand on. UDP, the facts endpoint and sessions need nothing more."""
    return [
        _imported(
            "LiveKit",
            ("livekit",),
            "import livekit.rtc; from importlib.metadata import version; print('livekit', version('livekit'))",
            extra_line("livekit"),
        ),
        _imported(
            "room",
            ("aiohttp", "aiortc", "jwt"),
            "import asimov_gym.room; from importlib.metadata import version; print('aiortc', version('aiortc'))",
            extra_line("room"),
        ),
        _imported(
            "joint control",
            ("bosdyn", "grpc"),
            "import bosdyn.api, grpc; from importlib.metadata import version; "
            "print('bosdyn-api', version('bosdyn-api') + ', under a licence of its own')",
            extra_line("joint-control"),
        ),
        _imported(
            "ROS 2",
            ("cyclonedds",),
            "import asimov_gym.edge.transports.ros2; from importlib.metadata import version; "
            "print('cyclonedds', version('cyclonedds'))",
            extra_line("ros2"),
        ),
        _imported(
            "rosbridge",
            ("websockets",),
            "import asimov_gym.edge.transports.rosbridge; from importlib.metadata import version; "
            "print('websockets', version('websockets'))",
            extra_line("rosbridge"),
        ),
    ]


def policy_findings() -> list[Finding]:
    """Shipped policies and those of training runs in the working folder, each loaded."""
    from asimov_gym.assets import asset_path

    try:
        files = sorted(asset_path("policies").glob("*.onnx"))
    except FileNotFoundError:
        files = []
    files += sorted(Path("runs").glob("*/policy.onnx"))
    if not files:
        cure = f"{extra_line('train')} and python -m train ppo --preset laptop"
        return [Finding("policies", Verdict.ABSENT, "none shipped, none in runs/", cure)]
    return [_policy(file) for file in files]


def _policy(file: Path) -> Finding:
    name = file.name if file.parent.name == "policies" else str(file)
    try:
        from asimov_gym.policy import load_policy

        contract = load_policy(file).contract
    except Exception as error:  # a foreign or damaged file must not end the report
        return Finding(name, Verdict.BROKEN, f"{type(error).__name__}: {error}")
    return Finding(name, Verdict.WORKS, f"{contract.observation.layout}, {contract.policy_rate_hz:g} Hz")


def _imported(name: str, modules: tuple[str, ...], code: str, cure: str) -> Finding:
    """Finding for a set of modules: absent, or whatever importing them in a process of its own said."""
    for module in modules:
        top, _, _ = module.partition(".")
        if find_spec(top) is None or find_spec(module) is None:
            return Finding(name, Verdict.ABSENT, f"no module {module}", cure)
    # Fewer than four threads let XLA's pool on the CPU wait for itself for ever.
    env = os.environ | ({"NPROC": "4"} if (os.cpu_count() or 1) < 4 else {})
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding(name, Verdict.BROKEN, "importing it took more than 120 s", cure)
    if done.returncode != 0:
        return Finding(name, Verdict.BROKEN, (done.stderr.strip().splitlines() or ["?"])[-1], cure)
    return Finding(name, Verdict.WORKS, done.stdout.strip())
