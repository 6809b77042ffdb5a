"""Several processes train as one: equal networks, the gradient of the whole batch, exact resume, and a common end."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from tensordict import TensorDict  # noqa: E402

from asimov_gym.envs.walk_batch import WalkBatch  # noqa: E402
from tests.train import rank_work  # noqa: E402
from train.__main__ import main  # noqa: E402
from train.learner import build_ppo  # noqa: E402
from train.ranks import Ranks  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Outcome:
    """What two processes left behind."""

    folder: Path
    seen: list[dict[str, Any]]
    """What each of them learned."""
    codes: list[int]
    printed: list[str]
    """Of each process, both streams."""

    def run(self, name: str) -> RunFolder:
        """The only run of that name."""
        (path,) = self.folder.glob(f"*_{name}")
        return RunFolder.open(path)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Two processes on this machine, set up as `torchrun` does it."""
    folder = tmp_path_factory.mktemp("pair")
    ports = dict(zip(("MASTER_PORT", "SECOND_PORT", "THIRD_PORT"), map(str, free_ports(3)), strict=True))
    common = os.environ | ports | {"MASTER_ADDR": "127.0.0.1", "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
    common |= {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": loopback()}
    command = [sys.executable, "-m", "tests.train.rank_work", str(folder)]
    processes = [
        subprocess.Popen(
            command,
            cwd=REPOSITORY,
            env=common | {"RANK": rank, "LOCAL_RANK": rank},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in ("0", "1")
    ]
    try:
        printed = [process.communicate(timeout=300)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
    files = [folder / f"seen_{rank}.pt" for rank in (0, 1)]
    assert all(file.exists() for file in files), "\n".join(printed)
    seen = [torch.load(file, weights_only=False) for file in files]
    return Outcome(folder, seen, [process.returncode for process in processes], printed)


def free_ports(count: int) -> list[int]:
    """Ports of this machine that nobody listens on."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    return ports


def loopback() -> str:
    """Name of the loopback interface, for gloo."""
    return next(name for _, name in socket.if_nameindex() if name.startswith("lo"))


def test_ranks_have_equal_networks_and_robots_of_their_own(pair: Outcome) -> None:
    first, second = (seen["once"] for seen in pair.seen)
    for model in ("actor_state_dict", "critic_state_dict"):
        for name, value in first["after"][model].items():
            assert torch.equal(value, second["after"][model][name]), name
        assert any(
            not torch.equal(value, first["before"][model][name]) for name, value in first["after"][model].items()
        )
    assert first["rate"] == second["rate"] and first["curriculum"] == second["curriculum"]
    assert first["figures"] == second["figures"]
    assert first["samples"] == 3 * 2 * rank_work.COPIES * 8
    assert not torch.equal(first["storage"]["observations"]["actor"], second["storage"]["observations"]["actor"])
    assert not torch.equal(first["storage"]["actions"], second["storage"]["actions"])


def test_two_ranks_learn_what_one_learns_from_the_whole_batch(pair: Outcome) -> None:
    """The update of two processes, made again by one that holds the samples of both."""
    torch.set_num_threads(1)
    ranks = [seen["once"] for seen in pair.seen]
    config, copies = rank_work.ONE_STEP, 2 * rank_work.COPIES
    last = torch.cat([seen["last"] for seen in ranks])
    batch = WalkBatch(config.walk, copies, threads=1)
    ppo = build_ppo(batch, config.learner, last)
    batch.close()
    ppo.actor.load_state_dict(ranks[0]["before"]["actor_state_dict"])
    ppo.critic.load_state_dict(ranks[0]["before"]["critic_state_dict"])
    ppo.entropy_coef = ranks[0]["entropy"]
    parts = [seen["storage"] for seen in ranks]
    for name in ("actions", "rewards", "dones", "values", "actions_log_prob"):
        setattr(ppo.storage, name, torch.cat([part[name] for part in parts], dim=1))
    views = {name: torch.cat([part["observations"][name] for part in parts], dim=1) for name in ("actor", "critic")}
    ppo.storage.observations = TensorDict(views, batch_size=[8, copies])
    ppo.storage.distribution_params = tuple(
        torch.cat(both, dim=1) for both in zip(*(part["distribution_params"] for part in parts), strict=True)
    )
    with torch.inference_mode():
        ppo.compute_returns(last)
    together = torch.cat([part["advantages"] for part in parts], dim=1)
    torch.testing.assert_close(ppo.storage.advantages, together, rtol=1e-4, atol=1e-5)
    ppo.storage.advantages = ppo.storage.advantages.clone()
    ppo.storage.returns = ppo.storage.returns.clone()
    ppo.update()
    gradients = [p.grad for model in (ppo.actor, ppo.critic) for p in model.parameters()]
    assert len(gradients) == len(ranks[0]["gradients"]) and sum(float(g.abs().sum()) for g in gradients) > 0.1
    for whole, shared in zip(gradients, ranks[0]["gradients"], strict=True):
        torch.testing.assert_close(shared, whole, rtol=1e-3, atol=1e-5)
    for model, state in (("actor_state_dict", ppo.actor.state_dict()), ("critic_state_dict", ppo.critic.state_dict())):
        for name in ("_mean", "_var", "count"):
            ours, theirs = state[f"obs_normalizer.{name}"], ranks[0]["after"][model][f"obs_normalizer.{name}"]
            torch.testing.assert_close(theirs, ours, rtol=1e-4, atol=1e-5)


def test_all_ranks_resume_exactly(pair: Outcome) -> None:
    for seen in pair.seen:
        (weights, views), (again, views_again) = seen["resume"]["whole"], seen["resume"]["parts"]
        for name, value in weights.items():
            assert torch.equal(value, again[name]), name
        assert torch.equal(views, views_again)
    folder = pair.run("parts")
    assert len(folder.load_checkpoint()["ranks"]) == 2


def test_a_run_of_two_is_not_continued_by_one(pair: Outcome, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resume", str(pair.run("parts").path)]) == 2
    assert "was trained by 2 processes and continues with as many, got 1" in capsys.readouterr().err


def test_ctrl_c_on_one_rank_stops_all_with_a_checkpoint(pair: Outcome) -> None:
    """The second rank was interrupted in its second round."""
    assert pair.run("stopped").load_checkpoint()["progress"]["samples"] == 2 * 2 * 16 * 8
    assert "continue with:  torchrun --standalone --nproc_per_node 2 -m train resume" in pair.printed[0]


def test_a_lost_rank_ends_the_others_with_one_line(pair: Outcome) -> None:
    assert pair.codes == [1, rank_work.DIED], pair.printed
    line = pair.printed[0].strip().splitlines()[-1]
    assert line.startswith("error: rank 0 stops: another of the 2 has ended") and "-m train resume RUN" in line
    assert "Traceback" not in "".join(pair.printed)


def test_only_rank_0_speaks(pair: Outcome) -> None:
    assert "Reward terms at the start" in pair.printed[0]
    assert not [line for line in pair.printed[1].splitlines() if "[W" not in line]  # but for torch's own warnings


def test_ranks_share_the_cores_and_draw_numbers_of_their_own() -> None:
    ranks = [Ranks(rank, 4, rank, 4) for rank in range(4)]
    assert [r.threads(3) for r in ranks] == [3] * 4
    assert ranks[0].threads(None) == max(1, (os.cpu_count() or 1) // 4)
    assert ranks[0].seed(5) == 5 == Ranks().seed(5)
    assert len({r.seed(seed) for r in ranks for seed in (5, 6)}) == 8


@pytest.mark.skipif(torch.cuda.is_available(), reason="shows what is said where there is no GPU, and here is one")
def test_a_missing_gpu_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ppo", "--preset", "smoke", "--runs", str(tmp_path), "--device", "cuda"]) == 2
    assert "torch sees no NVIDIA GPU here; use --device cpu" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_torchrun_starts_two_and_ctrl_c_ends_both(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2", "-m", "train"]
    command += [*rank_work.FLAGS, "--runs", str(tmp_path), "--samples", "100000000"]
    process = subprocess.Popen(
        command,
        cwd=REPOSITORY,
        env=os.environ | {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": loopback()},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        deadline = time.monotonic() + 120
        while not list(tmp_path.glob("*/curves/events.*")):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.2)
        time.sleep(2.0)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=120)
    finally:
        process.kill()
    assert "2 processes of 16 copies each" in output and "stopped; continue with:  torchrun" in output
    (path,) = tmp_path.iterdir()
    assert len(RunFolder.open(path).load_checkpoint()["ranks"]) == 2
