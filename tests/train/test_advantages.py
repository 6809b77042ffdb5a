"""Advantages of calm and disturbed episodes are scaled each by themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from asimov_gym.envs.walk_batch import WalkBatch  # noqa: E402
from asimov_gym.tasks.walk.config import KickConfig, ShoveConfig, WalkConfig  # noqa: E402
from train.advantages import scaled  # noqa: E402
from train.config import LearnerConfig, PpoConfig  # noqa: E402
from train.ppo import Trainer  # noqa: E402
from train.run_folder import RunFolder  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_thread")


def test_each_group_has_mean_zero_and_variance_one() -> None:
    rng = np.random.default_rng(0)
    raw = torch.from_numpy(rng.standard_normal((24, 40, 1)))
    calm = torch.from_numpy(rng.random((24, 40, 1)) < 0.3)
    raw[~calm] *= 100.0
    raw[calm] += 7.0
    result = scaled(raw, [calm, ~calm], False)
    for group in (calm, ~calm):
        assert abs(float(result[group].mean())) < 1e-9 and abs(float(result[group].std()) - 1.0) < 1e-6
    order = torch.argsort(raw[calm])
    assert torch.equal(order, torch.argsort(result[calm]))
    nobody = torch.zeros_like(calm)
    assert torch.isfinite(scaled(raw, [nobody, ~nobody], False)).all()
    alone = nobody.clone()
    alone[0, 0] = True
    assert float(scaled(raw, [alone], False).abs().sum()) == 0.0


def test_a_round_knows_its_calm_episodes(tmp_path: Path) -> None:
    walk = WalkConfig(
        calm_share=0.4,
        episode_s=0.4,
        kick=KickConfig(interval_s=(0.04, 0.2)),
        shove=ShoveConfig(interval_s=(0.04, 0.2), horizontal={"pelvis_link": 900.0}, first=1.0),
    )
    learner = LearnerConfig(steps=24, hidden=(16,))
    config = PpoConfig(library="rsl_rl", physics="c", copies=200, threads=1, walk=walk, learner=learner)
    trainer = Trainer(config, RunFolder(tmp_path))
    kicked: list[np.ndarray] = []
    assert isinstance(trainer.batch, WalkBatch)
    kick = trainer.batch.physics.kick
    trainer.batch.physics.kick = lambda change, due: (kicked.append(due), kick(change, due))[1]  # type: ignore
    assert 0.3 < trainer.batch.calm.mean() < 0.5
    calm_before, shoved = [], []
    step = trainer._step

    def watched(action: Any) -> Any:
        calm_before.append(np.array(trainer.batch.calm))
        kicked.clear()
        result = step(action)
        hit = np.concatenate(kicked) if kicked else np.zeros(0, dtype=int)
        assert not calm_before[-1][hit].any()
        shoved.append(len(hit))
        return result

    trainer._step = watched  # type: ignore[method-assign]
    trainer.iterate()
    assert sum(shoved) > 100
    assert trainer.ppo.calm is not None
    np.testing.assert_array_equal(trainer.ppo.calm.numpy(), np.stack(calm_before))
    calm, advantages = trainer.ppo.calm, trainer.ppo.storage.advantages[..., 0]
    for group in (calm, ~calm):
        assert abs(float(advantages[group].mean())) < 1e-4 and abs(float(advantages[group].std()) - 1.0) < 1e-3
    # Shares of calm episodes at both ends.
    assert not _batch_share(0.0, tmp_path).any() and _batch_share(1.0, tmp_path).all()


def _batch_share(share: float, folder: Path) -> np.ndarray:
    config = PpoConfig(library="rsl_rl", physics="c", copies=50, threads=1, walk=WalkConfig(calm_share=share))
    trainer = Trainer(config, RunFolder(folder))
    calm = np.array(trainer.batch.calm)
    trainer.close()
    return calm


def test_episodes_of_all_kinds_are_disturbed_as_before_when_none_is_calm() -> None:
    from asimov_gym.tasks.walk import WalkTask
    from asimov_gym.tasks.walk.draws import NEVER, steps_between

    task, half = WalkTask(WalkConfig()), WalkTask(WalkConfig(calm_share=0.5))
    draws = np.random.default_rng(0).random((400, task.start_draws["state"]), dtype=np.float32)
    state, partly = task.initial_state(draws), half.initial_state(draws)
    interval = task.config.kick.interval_s
    np.testing.assert_array_equal(state.kick_left, steps_between(draws[:, -2], interval))
    calm = half.is_calm(partly)
    np.testing.assert_array_equal(calm, draws[:, -2] < 0.5)
    np.testing.assert_array_equal(partly.kick_left[calm], NEVER)
    np.testing.assert_array_equal(partly.shove_wait[calm], NEVER)
    # The others' first kick comes at any time of the interval.
    times = partly.kick_left[~calm] * 0.02
    assert (
        interval[0] - 0.02 <= times.min() < interval[0] + 0.2 and interval[1] - 0.2 < times.max() <= interval[1] + 0.02
    )
    with pytest.raises(ValueError, match=r"calm_share must lie in \[0, 1\], got 1\.5"):
        WalkConfig(calm_share=1.5)
