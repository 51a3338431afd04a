"""from_tensordict: records of TorchRL's batches against a log that the environments keep."""

import warnings

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # torchrl's own FutureWarnings
    pytest.importorskip("torchrl.collectors")
    import torch
    from tensordict import TensorDict
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper, SerialEnv

from scripted import Noisy, trajectories

import emcc

LOG = []


def made(number):
    env = GymWrapper(Noisy(LOG, number, longest=12))
    env.auto_register_info_dict()
    return env


def costs_of(log):
    ended, running = trajectories(log)
    return [costs for costs, _ in ended + running]


def batches(count, rollout, total):
    """Yield the batches of a collector; LOG holds their steps."""
    envs = SerialEnv(count, [lambda k=k: made(k) for k in range(count)])
    collector = Collector(envs, None, frames_per_batch=count * rollout, total_frames=total)
    LOG.clear()  # making the environments took steps
    yield from collector
    collector.shutdown()


@pytest.mark.filterwarnings("ignore")  # torchrl's own
def test_each_batch_of_a_collector_is_a_rollout():
    count = 2
    found = emcc.from_tensordict(batches(count, 20, 100 * count))
    assert found.cost.sum() == sum(cost for _, cost, *_ in LOG)
    size = 20 * count
    expected = [emcc.mcc(costs_of(LOG[i : i + size])) for i in range(0, 5 * size, size)]
    mcc, starts = found.mcc_per_rollout()
    assert mcc.tolist() == expected
    assert starts.tolist() == list(range(0, 5 * size, size))


@pytest.mark.filterwarnings("ignore")
def test_episodes_may_go_on_in_the_next_batch():
    found = emcc.from_tensordict(batches(2, 20, 200), rollout="episode")
    expected = [emcc.mcc([costs]) for costs in costs_of(LOG)]
    assert sorted(found.mcc_per_rollout()[0]) == sorted(expected)
    assert found.reward.sum() == sum(reward for _, _, reward, _ in LOG)


def by_hand(**changes):
    steps = {"cost": [0, 1, 1], "reward": [1, 1, 1], "done": [False, False, True], **changes}
    values = {name: torch.tensor(value, dtype=torch.float32)[:, None] for name, value in
        steps.items() if value is not None}  # fmt: skip
    return TensorDict({"next": TensorDict(values, [3])}, [3])


def test_the_time_dimension_is_the_last_or_the_named_one():
    late = torch.stack([by_hand(), by_hand(cost=[1, 0, 1])])  # [environments, time]
    early = late.transpose(0, 1).contiguous()
    early.names = ["time", None]
    for batch in (late, early):
        found = emcc.from_tensordict(batch)
        assert found.longest_streak.tolist() == [2, 1]
        assert found.rollout.tolist() == [0, 0]


def test_bad_input_is_named():
    with pytest.raises(KeyError, match=r"no \('next', 'cost'\)"):
        emcc.from_tensordict(by_hand(cost=None))
    with pytest.raises(ValueError, match='rollout must be "batch" or "episode", got'):
        emcc.from_tensordict(by_hand(), rollout="update")
    with pytest.raises(ValueError, match="there is no batch"):
        emcc.from_tensordict([])
    padded = by_hand()
    padded["collector", "mask"] = torch.tensor([True, True, False])
    with pytest.raises(ValueError, match="use split_trajs=False"):
        emcc.from_tensordict(padded)
    with pytest.raises(TypeError, match="not iterable"):
        emcc.from_tensordict(3)
    with pytest.raises(ValueError, match="must have a time dimension"):
        emcc.from_tensordict(by_hand()[0])
    with pytest.raises(ValueError, match="a batch has 2 environments, the first 1"):
        emcc.from_tensordict([by_hand(), torch.stack([by_hand(), by_hand()])])
