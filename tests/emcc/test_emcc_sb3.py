"""EMCCCallback in trainings with Stable-Baselines3, against a log that the environments keep."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from scripted import Noisy, Scripted, TwoCosts, trajectories
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

import emcc

LOG = []
"""(environment, cost, reward, whether the episode ended) of every step of every `Noisy`."""


def envs(count, kind=DummyVecEnv):
    LOG.clear()
    return kind([partial(Noisy, LOG, number) for number in range(count)])


def longest(costs):
    text = "".join("1" if cost else "0" for cost in costs)
    return max(map(len, text.split("0")))


def test_off_policy_every_episode_is_a_rollout():
    callback = emcc.sb3.EMCCCallback()
    model = SAC("MlpPolicy", envs(3), learning_starts=10_000, device="cpu")
    model.learn(900, callback=callback)
    ended, running = trajectories(LOG)
    mcc = [longest(costs) / len(costs) for costs, _ in ended + running]
    assert sorted(callback.records.mcc_per_rollout()[0]) == pytest.approx(sorted(mcc))
    assert callback.records.emcc(alpha=1) == pytest.approx(np.mean(mcc))
    assert callback.records.cost.sum() == sum(cost for _, cost, *_ in LOG)
    assert callback.episodes.cost.tolist() == [sum(costs) for costs, _ in ended]
    assert callback.episodes.reward.tolist() == [sum(rewards) for _, rewards in ended]


@pytest.mark.parametrize("algorithm", [PPO, A2C])
def test_on_policy_a_rollout_lies_between_two_updates(algorithm):
    callback = emcc.sb3.EMCCCallback(limit=5.0)
    options = {"n_steps": 50} | ({"batch_size": 50, "n_epochs": 1} if algorithm is PPO else {})
    model = algorithm("MlpPolicy", envs(2), device="cpu", **options)
    model.learn(600, callback=callback)
    expected = []
    for first in range(0, len(LOG), 100):  # 2 environments, 50 steps
        shares, running = [], {0: [], 1: []}
        for number, cost, _, done in LOG[first : first + 100]:
            running[number].append(cost)
            if done:
                shares.append(longest(running[number]) / len(running[number]))
                running[number] = []
        shares += [longest(costs) / len(costs) for costs in running.values() if costs]
        expected.append(max(shares))
    found, starts = callback.records.mcc_per_rollout()
    assert found == pytest.approx(expected)
    assert starts.tolist() == list(range(0, 600, 100))
    panel = callback.panel()
    ended, _ = trajectories(LOG)
    assert panel.violation_rate == np.mean([sum(costs) > 5 for costs, _ in ended])
    assert panel.emcc == emcc.emcc(expected, 0.1)


def test_processes_and_normalised_rewards():
    training = VecNormalize(envs(2, partial(SubprocVecEnv, start_method="fork")))
    callback = emcc.sb3.EMCCCallback()
    PPO("MlpPolicy", training, n_steps=64, batch_size=64, n_epochs=1).learn(256, callback)
    training.close()
    assert callback.records.total_steps == 256
    rewards = callback.records.reward
    assert rewards.tolist() == [round(reward) for reward in rewards]


class Kept(KVWriter):
    def __init__(self):
        self.rows = []

    def write(self, key_values, key_excluded, step=0):
        self.rows.append((step, dict(key_values)))


def test_the_logger_gets_measures_of_the_last_window():
    writer = Kept()
    model = SAC("MlpPolicy", envs(1), learning_starts=10_000, device="cpu")
    model.set_logger(Logger(None, [writer]))
    callback = emcc.sb3.EMCCCallback(window=10, limit=5.0)
    model.learn(500, callback=callback, log_interval=20)
    step, row = writer.rows[0]
    last = callback.episodes.select(np.arange(10, 20))  # the ten before the dump at the 20th
    assert step == callback.episodes.length[:20].sum()
    assert row["emcc/mcc"] == pytest.approx(last.emcc(alpha=1))
    assert row["emcc/emcc"] == pytest.approx(last.emcc())
    assert row["emcc/cost_rate"] == pytest.approx(last.cost.sum() / last.length.sum())
    assert row["emcc/violation_rate"] == (last.cost > 5).mean()
    assert row["emcc/longest_streak"] == last.longest_streak.max()
    thirds = callback.records.emcc_by_part()
    assert {f"emcc/emcc_{part}": value for part, value in thirds.items()}.items() <= (
        writer.rows[-1][1].items()
    )


@pytest.mark.parametrize("algorithm", [A2C, SAC])
def test_each_cost_has_its_records(algorithm):
    """They are those of a task whose only cost it is; the limit concerns the first cost."""
    writer, callback = Kept(), emcc.sb3.EMCCCallback(limit=5.0, costs=("cost", "cost_2"))
    LOG.clear()
    training = DummyVecEnv([lambda: TwoCosts(Noisy(LOG))])
    options = {"learning_starts": 10_000} if algorithm is SAC else {"n_steps": 40}
    model = algorithm("MlpPolicy", training, device="cpu", **options)
    model.set_logger(Logger(None, [writer]))
    model.learn(400, callback=callback, log_interval=2)
    ended, _ = trajectories(LOG)
    first, second = callback.episodes_by_cost.values()
    assert first.to_csv() == callback.episodes.to_csv()
    assert second.cost.tolist() == [sum(1 - cost for cost in costs) for costs, _ in ended]
    first, second = callback.records_by_cost.values()
    assert second.cost_steps.sum() == sum(1 - cost for _, cost, *_ in LOG)
    assert first.length.tolist() == second.length.tolist()
    row = {name: value for _, row in writer.rows for name, value in row.items()}
    for prefix, records in (("emcc/", first), ("emcc/cost_2/", second)):
        for part, value in records.emcc_by_part().items():
            assert row[f"{prefix}emcc_{part}"] == value
    assert "emcc/violation_rate" in row
    assert "emcc/cost_2/violation_rate" not in row
    with pytest.raises(ValueError, match="costs must be different names"):
        emcc.sb3.EMCCCallback(costs="cost")


def test_only_whole_episodes_are_compared_with_the_limit():
    """Updates come every 40 steps; the first episode, of 100 steps, ends in the third rollout."""
    writer, callback = Kept(), emcc.sb3.EMCCCallback(limit=50.0)
    model = A2C(
        "MlpPolicy", DummyVecEnv([lambda: Scripted([[1.0] * 100])]), n_steps=40, device="cpu"
    )
    model.set_logger(Logger(None, [writer]))
    model.learn(80, callback=callback, log_interval=1)
    assert writer.rows[0][1]["emcc/mcc"] == 1.0
    logged = {name for _, row in writer.rows for name in row}
    assert not {"emcc/violation_rate", "emcc/maximum", "emcc/cvar"} & logged
    assert callback.panel().violation_rate is None
    model.learn(40, callback=callback, log_interval=1, reset_num_timesteps=False)
    logged = {name: value for _, row in writer.rows for name, value in row.items()}
    assert (logged["emcc/violation_rate"], logged["emcc/maximum"]) == (1.0, 100.0)


def off_policy(rollout="auto"):
    callback = emcc.sb3.EMCCCallback(rollout)
    return callback, SAC("MlpPolicy", envs(1), learning_starts=10_000, device="cpu")


@pytest.mark.parametrize("rollout", ["auto", 32])
def test_learning_in_parts_gives_the_records_of_learning_at_once(rollout):
    """The end of `learn` does not end the episode, so the record must not be cut there."""
    once, model = off_policy(rollout)
    model.learn(600, callback=once)
    parts, model = off_policy(rollout)
    for part in range(20):
        model.learn(30, callback=parts, reset_num_timesteps=part == 0)
        assert parts.records.total_steps == 30 * (part + 1)
    assert parts.records.to_csv() == once.records.to_csv()
    assert parts.episodes.to_csv() == once.episodes.to_csv()


def test_an_episode_is_cut_where_set_env_replaces_its_environment():
    callback, model = off_policy()
    model.learn(100, callback=callback)
    _, running = trajectories(LOG)
    assert running  # else the next assertion says nothing
    before = callback.records
    model.set_env(envs(1))
    model.learn(100, callback=callback, reset_num_timesteps=False)
    assert callback.records.length[: len(before)].tolist() == before.length.tolist()
    lengths = [len(costs) for of in trajectories(LOG) for costs, _ in of]
    assert callback.records.length[len(before) :].tolist() == lengths


def test_bad_input_is_named():
    for name, value in {"rollout": "never", "alpha": 5, "window": 0, "limit": -1}.items():
        with pytest.raises(ValueError, match=f"{name} must be"):
            emcc.sb3.EMCCCallback(**{name: value})
    with pytest.raises(RuntimeError, match=r"give the callback to model\.learn"):
        _ = emcc.sb3.EMCCCallback().records
    model = PPO("MlpPolicy", "Pendulum-v1", n_steps=32, batch_size=32)
    with pytest.raises(KeyError, match="info has no 'cost'"):
        model.learn(32, callback=emcc.sb3.EMCCCallback())
