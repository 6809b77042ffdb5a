"""Learning on oneDNN is the same as learning without, to rounding."""

from __future__ import annotations

import copy

import pytest

torch = pytest.importorskip("torch", reason="the training extra is not installed: pip install 'asimov-gym[train]'")
pytest.importorskip("rsl_rl", reason="the training extra is not installed: pip install 'asimov-gym[train]'")

from rsl_rl.storage import RolloutStorage  # noqa: E402
from tensordict import TensorDict  # noqa: E402
from torch import nn  # noqa: E402

from train.learner import KeptMinibatches  # noqa: E402
from train.linear import ROWS, OneDnnMlp, available, use_onednn  # noqa: E402

needs_onednn = pytest.mark.skipif(not available(), reason="this torch has no oneDNN, or the processor is no x86")


@needs_onednn
@pytest.mark.parametrize("rows", [1, 7, ROWS, 2 * ROWS + 300])
def test_answers_and_gradients_are_those_of_plain_layers(rows: int) -> None:
    torch.manual_seed(0)
    plain = nn.Sequential(nn.Sequential(nn.Linear(80, 96), nn.ELU(), nn.Linear(96, 64), nn.ELU(), nn.Linear(64, 23)))
    faster = copy.deepcopy(plain)
    before = list(faster.parameters())
    use_onednn(faster)
    assert type(faster[0]) is OneDnnMlp
    assert all(a is b for a, b in zip(before, faster.parameters(), strict=True))  # an optimiser still knows them
    assert list(faster.state_dict()) == list(plain.state_dict())
    x = torch.randn(rows, 80, requires_grad=True)
    results = []
    for network in (plain, faster):
        answer = network(x)
        gradients = torch.autograd.grad(answer.square().mean(), [x, *network.parameters()])
        with torch.inference_mode():
            results.append([answer, network(x), *gradients])
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(theirs, ours, rtol=1e-4, atol=1e-6)  # sums over rows in another order


@needs_onednn
def test_the_number_of_threads_changes_nothing() -> None:
    network = OneDnnMlp(nn.Linear(80, 96), nn.ELU(), nn.Linear(96, 23))
    x, threads, results = torch.randn(3 * ROWS, 80), torch.get_num_threads(), []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            answer = network(x)
            results.append([answer, *torch.autograd.grad(answer.square().mean(), list(network.parameters()))])
            assert torch.get_num_threads() == count
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(one, two) for one, two in zip(*results, strict=True))


@needs_onednn
def test_evaluating_networks_are_plain_bit_for_bit() -> None:
    plain = nn.Sequential(nn.Linear(80, 64), nn.ELU(), nn.Linear(64, 23))
    x = torch.randn(50, 80)
    assert torch.equal(OneDnnMlp(*plain).eval()(x), plain(x))


@needs_onednn
@pytest.mark.parametrize(
    "other",
    [
        nn.Sequential(nn.Linear(8, 8), nn.Tanh(), nn.Linear(8, 2)),
        nn.Sequential(nn.Linear(8, 8, bias=False), nn.ELU(), nn.Linear(8, 2)),
        nn.Sequential(nn.Linear(8, 8), nn.ELU(0.5), nn.Linear(8, 2)),
        nn.Sequential(nn.Linear(8, 8), nn.ELU()),
    ],
)
def test_other_networks_stay_as_they_are(other: nn.Sequential) -> None:
    network = nn.Sequential(other)
    use_onednn(network)
    assert network[0] is other


def test_kept_minibatches_are_those_of_rsl_rl() -> None:
    views = TensorDict({"actor": torch.zeros(6, 4)}, batch_size=[6])
    batches = []
    for kind in (RolloutStorage, KeptMinibatches):
        torch.manual_seed(1)
        storage = kind("rl", 6, 5, views, [2])
        storage.actions[:] = torch.arange(60.0).view(5, 6, 2)
        storage.distribution_params = (storage.actions.clone(),)
        batches.append([(b.actions.clone(), b.observations.shape) for b in storage.mini_batch_generator(3, 4)])
        assert len(batches[-1]) == 12
    for (ours, shape), (theirs, other) in zip(*batches, strict=True):
        assert torch.equal(ours, theirs) and shape == other == torch.Size([10])
