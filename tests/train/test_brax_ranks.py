"""Several devices, of one process or of two, learn with Brax what one device learns from all copies."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.train.jax_settings import why_absent

if (absent := why_absent()) is not None:
    pytest.skip(absent, allow_module_level=True)

import torch

from tests.train.brax_work import COPIES, compare
from tests.train.test_ranks import free_ports, loopback
from train.run_folder import RunFolder

pytestmark = pytest.mark.slow
REPOSITORY = Path(__file__).resolve().parents[2]
TWO_DEVICES = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}


@dataclass(frozen=True)
class Outcome:
    """What processes that trained together left behind."""

    folder: Path
    seen: list[dict[str, Any]]
    """By rank: figures, and after both rounds what was learned and this rank's robots."""

    def robots(self, name: str) -> np.ndarray:
        """An array of the robots of all ranks."""
        return np.concatenate([seen["whole"]["own"]["state"][name] for seen in self.seen])


def trained(folder: Path, processes: int, environment: dict[str, str]) -> Outcome:
    """Two rounds with all copies, divided among so many processes of this machine, set up as `torchrun` does it."""
    port = str(free_ports(1)[0])
    common = os.environ | {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": str(processes)}
    common |= {"LOCAL_WORLD_SIZE": str(processes), "OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": loopback()}
    # Little optimisation: the programs are compiled in half the time.
    common |= {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "XDG_CACHE_HOME": str(folder / "cache")} | environment
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.train.brax_work", str(folder)],
            cwd=REPOSITORY,
            env=common | {"RANK": str(rank), "LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(processes)
    ]
    try:
        printed = [process.communicate(timeout=400)[0] for process in started]
    finally:
        for process in started:
            process.kill()
    assert [process.returncode for process in started] == [0] * processes, "\n".join(printed)
    seen = [torch.load(folder / f"seen_{rank}.pt", weights_only=False) for rank in range(processes)]
    return Outcome(folder, seen)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """One process with one device."""
    return trained(tmp_path_factory.mktemp("alone"), 1, {})


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Two processes with one device each."""
    return trained(tmp_path_factory.mktemp("pair"), 2, {})


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """One process with two devices."""
    return trained(tmp_path_factory.mktemp("row"), 1, TWO_DEVICES)


def test_two_processes_hold_equal_networks_and_robots_of_their_own(pair: Outcome) -> None:
    first, second = (seen["whole"] for seen in pair.seen)
    for part in ("networks", "optimiser"):
        assert compare(first["learned"][part], second["learned"][part]) == 0.0
    for seen in (first, second):
        assert len(seen["own"]["state"]["reward"]) == COPIES // 2
    assert not np.array_equal(first["own"]["state"]["obs.state"], second["own"]["state"]["obs.state"])
    assert not np.array_equal(first["own"]["state"]["info.key"], second["own"]["state"]["info.key"])


@pytest.mark.parametrize("several", ["pair", "row"])
def test_several_devices_learn_what_one_learns_from_all_copies(
    several: str, alone: Outcome, request: pytest.FixtureRequest
) -> None:
    """Equal but for the rounding of sums in float32, which Adam's first steps blow up where a gradient is almost zero:
    there a step may have the other sign. So single weights are compared within a few steps and their mean closely."""
    outcome = request.getfixturevalue(several)
    for ours, theirs in zip(alone.seen[0]["figures"], outcome.seen[0]["figures"], strict=True):
        for name, value in ours.items():
            if not name.startswith("speed/"):
                assert theirs[name] == pytest.approx(value, rel=1e-3, abs=1e-4), name
    one, two = alone.seen[0]["whole"]["learned"], outcome.seen[0]["whole"]["learned"]
    for name, value in one["networks"].items():
        if name.startswith("normaliser"):
            np.testing.assert_allclose(two["networks"][name], value, rtol=1e-4, atol=1e-4, err_msg=name)
    off = [np.abs(two["networks"][name] - value) for name, value in one["networks"].items() if "hidden" in name]
    assert max(part.max() for part in off) < 5e-3
    assert float(np.mean(np.concatenate([part.ravel() for part in off]))) < 2e-5
    np.testing.assert_array_equal(alone.robots("info.key"), outcome.robots("info.key"))
    np.testing.assert_allclose(
        alone.robots("pipeline_state.simulation.qpos"), outcome.robots("pipeline_state.simulation.qpos"), atol=1e-4
    )


@pytest.mark.parametrize("setting", ["alone", "pair", "row"])
def test_every_setting_resumes_bit_for_bit(setting: str, request: pytest.FixtureRequest) -> None:
    outcome = request.getfixturevalue(setting)
    for seen in outcome.seen:
        for part in ("networks", "optimiser"):
            assert compare(seen["whole"]["learned"][part], seen["again"]["learned"][part]) == 0.0
        assert compare(seen["whole"]["own"]["state"], seen["again"]["own"]["state"]) == 0.0
    (path,) = outcome.folder.glob("*_pair")
    assert len(RunFolder.open(path).load_checkpoint()["ranks"]) == len(outcome.seen)
