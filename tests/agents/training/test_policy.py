"""Trained policies outside of training: actions, PyTorch modules, snapshots, evaluations."""

import pickle
import shutil

import gymnasium as gym
import numpy as np
import pytest
import torch
import toy_family
from small_runs import SAC, TRPO, results

import agents
from agents.algorithms import Algorithm
from agents.errors import TaskFailure
from agents.training import policy as policies_of
from agents.training.config import TrainConfig
from agents.training.environments import make_envs
from agents.training.trainer import Trainer

SMALL = {"sac-lb": SAC, "sac-lag": SAC, "trpo-lag": TRPO, "cpo": TRPO}


def trained(out, algorithm, task="Walk-v0", seeds=(0, 1), steps=200, **more):
    more = SMALL[algorithm] | more
    return agents.train(algorithm, task, seeds=seeds, steps=steps, out=out, **more).folder


@pytest.fixture(scope="module", params=["sac-lb", "trpo-lag"])
def folder(request, tmp_path_factory):
    """Runs on a task with actions in [-2, 2] and an input scale for each observed number."""
    more = {"input_scale": (7.0, 0.3)}
    return trained(tmp_path_factory.mktemp("policy") / "x", request.param, **more)


OBSERVATIONS = np.random.default_rng(0).normal(0, 3, (50, 2))


def test_actions_are_those_of_training_in_the_tasks_own_space(folder):
    """The learner's actions, in [-1, 1], are rescaled as the training environments do."""
    policy = agents.load_policy(folder, seed=1)
    it = Trainer(folder, TrainConfig.read(folder))
    it.load()
    learned = it.learner.policy()
    both = np.stack([OBSERVATIONS] * 2).astype(np.float32)
    unit = np.clip(learned(both, None)[1], -1, 1)
    envs = make_envs("Walk-v0", len(unit), {})
    expected = envs.actions(unit)
    np.testing.assert_array_equal(policy(OBSERVATIONS), expected)
    noise = np.random.default_rng(5).standard_normal((2, 50, 1), dtype=np.float32)
    unit = np.clip(learned(both, np.stack([noise[0]] * 2))[1], -1, 1)
    drawn = policy(OBSERVATIONS, deterministic=False, rng=np.random.default_rng(5))
    np.testing.assert_array_equal(drawn, envs.actions(unit))
    assert drawn.dtype == np.float32
    assert np.abs(drawn).max() <= 2
    assert np.abs(drawn).max() > 1
    assert len(np.unique(policy(np.zeros((9, 2)), deterministic=False))) > 2


def test_one_observation_or_a_batch(folder):
    policy = agents.load_policy(folder, seed=0)
    batch = policy(OBSERVATIONS)
    assert batch.shape == (50, 1)
    np.testing.assert_allclose(policy(OBSERVATIONS[7]), batch[7], rtol=1e-5, atol=1e-6)
    assert policy(OBSERVATIONS[7].tolist()).shape == (1,)
    with pytest.raises(TypeError, match="no memory"):
        policy.predict(OBSERVATIONS[7], state=(1,))
    action, state = policy.predict(OBSERVATIONS[7], state=None, episode_start=np.ones(1, bool))
    assert state is None
    np.testing.assert_array_equal(action, policy(OBSERVATIONS[7]))
    assert policy(np.zeros((0, 2))).shape == (0, 1)


@pytest.mark.parametrize(
    ("observation", "error", "message"),
    [
        (np.zeros(3), ValueError, r"must be \[2\], or \[N, 2\] for a batch, got shape \[3\]"),
        (np.zeros((4, 5, 2)), ValueError, r"got shape \[4, 5, 2\]"),
        (["a", "b"], TypeError, "real numbers"),
        (np.zeros(2, complex), TypeError, "real numbers"),
    ],
)
def test_observations_of_another_shape_or_type_are_refused(folder, observation, error, message):
    with pytest.raises(error, match=message):
        agents.load_policy(folder, seed=0)(observation)


def test_the_pytorch_module_acts_as_the_policy(folder):
    policy = agents.load_policy(folder, seed=1)
    module = policy.to_torch()
    with torch.no_grad():
        found = module(torch.tensor(OBSERVATIONS, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(found, policy(OBSERVATIONS), atol=1e-6)
    copy = type(module)(module.net, np.zeros(1, np.float32), np.ones(1, np.float32))
    copy.load_state_dict(module.state_dict())  # bounds are part of the state
    torch.testing.assert_close(copy.high, torch.tensor([2.0]))


class Projected(toy_family.Linear):
    """A policy that projects its network's actions onto half of their range."""

    in_module = False

    def policy(self):
        act = super().policy()
        return lambda observation, noise: np.clip(act(observation, noise), -0.5, 0.5)

    def module(self, run):
        net = torch.nn.Linear(2, 1)
        net.load_state_dict({"weight": torch.tensor(self.actor[run]), "bias": torch.zeros(1)})
        return torch.nn.Sequential(net, torch.nn.Hardtanh(-0.5, 0.5)) if self.in_module else net


class Both(Projected):
    """A policy whose module projects the actions, too."""

    in_module = True


@pytest.mark.parametrize("family", [Projected, Both])
def test_a_module_must_act_as_the_policy_does(family, tmp_path, monkeypatch):
    """A projection of actions is not lost: half of the range [-2, 2] is [-1, 1]."""
    algorithm = Algorithm("Toy", toy_family.Numbers, toy_family.Rule(), family)
    with toy_family.known(algorithm=algorithm):
        out = agents.train("toy", "Walk-v0", seeds=0, steps=50, out=tmp_path / "x").folder
        policy = agents.load_policy(out)
        # Large observations, so that the projection has an effect.
        assert np.abs(policy(100 * OBSERVATIONS)).max() == 1
        if family is Projected:
            with pytest.raises(agents.UserError, match=r"Policy.*acts differently from the module"):
                policy.to_torch()
            return
        found = policy.to_torch()(torch.tensor(OBSERVATIONS, dtype=torch.float32))
        np.testing.assert_allclose(found.detach().numpy(), policy(OBSERVATIONS), atol=1e-6)


def test_a_policy_is_loaded_without_replay_and_environment(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "x")
    newest = sorted((copy / "checkpoints").iterdir())[-1]
    with np.load(newest) as state:
        kept = {k: state[k] for k in state if k == "steps" or k.startswith("actor")}
    np.savez(newest, **kept)
    expected = agents.load_policy(folder, seed=0, task="Walk")(OBSERVATIONS)
    spec = gym.registry.pop("Walk-v0")
    try:
        found = agents.load_policy(copy, seed=0)(OBSERVATIONS)
    finally:
        gym.registry["Walk-v0"] = spec
    np.testing.assert_array_equal(found, expected)


def test_a_run_or_a_step_that_does_not_exist_is_named(folder, tmp_path):
    for given, message in (
        ({}, r"several runs: give the seed, one of \(0, 1\)"),
        ({"seed": 7}, r"no run of seed 7: there are \(0, 1\)"),
        ({"seed": 0, "step": 50}, r"no policy of .* at step 50: there are none"),
        ({"seed": "0"}, "no run of seed '0': there are"),
        ({"task": "Target-v0"}, r"no run on task 'Target-v0': its tasks are"),
        ({"folder": tmp_path}, "holds no runs: no config"),
        ({"folder": folder.parent}, r"holds folders of runs: did you mean '.*x'\?"),
        ({"folder": tmp_path / "nothing"}, "nothing is no folder"),
    ):
        with pytest.raises(agents.UserError, match=message):
            agents.load_policy(given.pop("folder", folder), **given)


def test_a_pickled_policy_acts_alike(folder):
    policy = agents.load_policy(folder, seed=1)
    copy = pickle.loads(pickle.dumps(policy))
    for deterministic in (True, False):
        actions = (
            of(OBSERVATIONS, deterministic, np.random.default_rng(3)) for of in (policy, copy)
        )
        np.testing.assert_array_equal(*actions)
    inputs = torch.from_numpy(OBSERVATIONS.astype(np.float32))
    assert torch.equal(policy.to_torch()(inputs), copy.to_torch()(inputs))


def test_a_checkpoint_of_networks_of_other_sizes_is_refused(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "x")
    text = (copy / "config.json").read_text()
    assert "   8\n" in text
    (copy / "config.json").write_text(text.replace("   8\n", "   64\n"))
    with pytest.raises(agents.UserError, match="damaged or of another version"):
        agents.load_policy(copy, seed=0)


def test_a_damaged_or_missing_checkpoint_is_named(tmp_path):
    copy = trained(tmp_path / "x", "trpo-lag")
    newest = sorted((copy / "checkpoints").iterdir())[-1]
    newest.write_bytes(newest.read_bytes()[:-100])
    with pytest.raises(agents.UserError, match=f"{newest.name} is damaged"):
        agents.load_policy(copy, seed=0)
    shutil.rmtree(copy / "checkpoints")
    with pytest.raises(agents.UserError, match="has no checkpoint yet"):
        agents.load_policy(copy, seed=0)


def test_numbers_of_steps_and_episodes_may_be_whole_floats(tmp_path):
    one = trained(tmp_path / "x", "cpo", seeds=0, steps=2e2, evaluate_every=1e2)
    other = trained(tmp_path / "y", "cpo", seeds=0, steps=200, evaluate_every=100)
    assert results(one) == results(other)
    early = agents.load_policy(one, step=1e2)
    assert early.step == 100
    assert len(agents.evaluate(early, episodes=3.0).returns) == 3
    with pytest.raises(agents.UserError, match=r"step must be an integer or None, got 1\.5"):
        agents.load_policy(one, step=1.5)
    with pytest.raises(agents.UserError, match=r"steps must be an integer, got 2\.5"):
        trained(tmp_path / "z", "cpo", steps=2.5)


@pytest.mark.parametrize("algorithm", ["sac-lag", "cpo"])
def test_policies_from_during_training_can_be_loaded(algorithm, tmp_path):
    """Keeping them changes no result. The last one is the policy at the end of training."""
    more = {"seeds": (3, 4), "steps": 300, "evaluate_every": 100}
    folder = trained(tmp_path / "x", algorithm, "Circle2D-1-v0", **more)
    plain = trained(tmp_path / "y", algorithm, "Circle2D-1-v0", **more | {"evaluate_every": None})
    name = "results.npz"
    assert (folder / name).read_bytes() == (plain / name).read_bytes()
    assert not (plain / "policies").exists()
    there = {p.relative_to(folder / "policies").as_posix() for p in folder.rglob("policies/*/*/*")}
    steps = (100, 200, 300)
    assert there == {f"Circle2D-1-v0/{seed}/{k:09d}.npz" for seed in (3, 4) for k in steps}
    early, late = (agents.load_policy(folder, seed=4, step=step) for step in (100, 200))
    assert (early.step, late.step) == (100, 200)
    assert not np.array_equal(early(OBSERVATIONS), late(OBSERVATIONS))
    rows = agents.load_runs(folder).to_pandas("evaluations")
    rows = rows[(rows.seed == 4) & (rows.policy == "deterministic")]
    with np.load(folder / "policies" / "Circle2D-1-v0" / "4" / "000000200.npz") as kept:
        names = {"return": "returns", "cost": "costs", "length": "lengths"}
        own = [kept[f"evaluation/deterministic/{name}"].ravel() for name in names.values()]
    np.testing.assert_array_equal(rows[rows.step == 200][[*names]].T, own)
    (group,) = agents.load_runs(folder).results
    at_end = rows[rows.step == rows.step.max()]["return"]
    np.testing.assert_array_equal(at_end, group.runs[1].evaluation["deterministic"]["returns"])
    assert rows.step.unique().tolist() == [100, 200, 300] and len(rows) == 9
    with pytest.raises(agents.UserError, match="there are 100, 200, 300; training"):
        agents.load_policy(folder, seed=4, step=400)
    last = [agents.load_policy(folder, seed=3, step=step)(OBSERVATIONS) for step in (300, None)]
    np.testing.assert_array_equal(*last)


def test_an_evaluation_by_hand():
    """An episode of `Target` is one step with reward -(a - 0.8)² and cost (1 + a) / 2."""
    seen = []

    def policy(observation):
        seen.append(observation.shape)
        return np.array([0.5], np.float32)

    found = agents.evaluate(policy, "Target", episodes=3)  # the newest version, as in `train`
    np.testing.assert_allclose(found.returns, [-0.09] * 3, rtol=1e-6)
    np.testing.assert_allclose(found.costs, [0.75] * 3)
    assert found.lengths.tolist() == [1] * 3
    assert found.longest_streaks.tolist() == [1] * 3
    assert (found.mean_cost, found.mcc, found.mean_length) == (0.75, 1.0, 1.0)
    assert found.mean_return == pytest.approx(-0.09)
    assert found.cvar() == 0.75
    assert "mean_return=-0.09, mean_cost=0.75, mcc=1.00" in repr(found)
    assert seen == [(1,)] * 3


def test_evaluations_of_policies_and_folders_agree_and_depend_on_the_seed(folder):
    before = results(folder)
    policy = agents.load_policy(folder, seed=1)
    one = agents.evaluate(policy, episodes=4, seed=7)
    both = agents.evaluate(folder, episodes=4, seed=7)
    assert both.returns.shape == (2, 4)
    assert both.seeds == (0, 1)
    assert "runs=2, episodes=4, " in repr(both)
    np.testing.assert_array_equal(both.returns[1], one.returns)
    np.testing.assert_array_equal(agents.evaluate(policy, episodes=4, seed=7).costs, one.costs)
    other = agents.evaluate(policy, episodes=4, seed=8)
    assert not np.array_equal(other.returns, one.returns)
    drawn = [agents.evaluate(policy, episodes=4, seed=7, deterministic=False) for _ in range(2)]
    np.testing.assert_array_equal(drawn[0].returns, drawn[1].returns)
    assert not np.array_equal(drawn[0].returns, one.returns)
    assert results(folder) == before


def test_a_policy_s_task_parameters_hold_for_other_spellings_of_its_task(tmp_path):
    more = {"task_parameters": {"max_episode_steps": 7}, "steps": 20}
    policy = agents.load_policy(trained(tmp_path / "x", "cpo", "Circle2D-1-v0", **more), seed=0)
    for task in (None, "Circle2D-1-v0", "circle2d_mj:Circle2D-1-v0", "Circle2D-1"):
        assert agents.evaluate(policy, task, episodes=1).lengths.tolist() == [7]
    assert agents.evaluate(policy, "Circle2D-2-v0", episodes=1).lengths.tolist() == [50]


@pytest.mark.parametrize(
    ("task", "parameters", "words"),
    [
        ("Walk-v0", {"poison": 1.0}, "'Walk-v0' gives reward nan and cost 0 in step 1 of an ep"),
        ("Broken-v0", {"how": "negative", "at": 4}, "cost -1 in step 4 of an episode"),
    ],
)
def test_an_evaluation_names_numbers_that_cannot_be(task, parameters, words):
    with pytest.raises(TaskFailure, match=words):
        agents.evaluate(lambda _: np.zeros(1, np.float32), task, 1, task_parameters=parameters)


def test_an_evaluation_of_several_tasks_names_them(tmp_path):
    tasks = ["Walk-v0", "TwoCosts-v0"]
    both = agents.evaluate(trained(tmp_path / "x", "cpo", tasks, steps=50), episodes=2)
    assert (both.task, both.seeds, len(both.returns)) == ("Walk-v0 TwoCosts-v0", (0, 1, 0, 1), 4)


def test_evaluations_that_are_not_possible_are_named(folder):
    policy = agents.load_policy(folder, seed=0)
    spaces = r"policy of Walk-v0 has Spaces\(.*2.0.*\), task '{}' has Spaces\(.*{}"
    for given, message in (
        ((policy, "Circle2D-1-v0"), spaces.format("Circle2D-1-v0", r"low=\(-1.0, -1.0\)")),
        ((policy, "Broken-v0"), spaces.format("Broken-v0", r"low=\(-1.0,\)")),
        ((policy, "CartPole-v1"), "action space of task 'CartPole-v1' must be a flat Box"),
        ((lambda observation: observation,), "needs the task"),
        ((policy, None, 0), "episodes must be at least 1, got 0"),
        *(
            ((policy, None, n), f"episodes must be an integer, got {n!r}")
            for n in (2.5, "10", None)
        ),
        ((policy, None, 1, True, "a"), "seed must be an integer, got 'a'"),
        ((policy, "Nowhere-v0"), "unknown task"),
        ((lambda observation: np.array([np.nan]), "Walk-v0"), "not finite"),
        ((lambda _: [0, 0, 0], "Walk-v0"), r"of shape \[3\], the task takes one of \[1\]"),
    ):
        with pytest.raises(agents.UserError, match=message):
            agents.evaluate(*given)
    with pytest.raises(TypeError, match="a policy, a function or a folder, got 3"):
        agents.evaluate(3)
    of_truth = agents.evaluate(lambda observation: observation[:1] > 0, "Walk-v0", 1)
    assert of_truth.lengths.shape == (1,)


TASK = "Circle2D-2-v0"


def test_pretrained_policies_are_found_by_algorithm_and_task(tmp_path, monkeypatch):
    monkeypatch.setattr(policies_of, "FOLDER", tmp_path)
    expected = tmp_path / "sac-lb" / "Circle2D-1-v0"
    trained = agents.train("sac-lb", "Circle2D-1-v0", seeds=3, steps=100, **SAC)
    shutil.copytree(trained.folder, expected)
    assert agents.pretrained("sac-lb", "circle2d_mj:Circle2D-1-v0") == expected
    policies = [agents.load_policy(of) for of in (trained, "pretrained:sac-lb/Circle2D-1-v0")]
    np.testing.assert_array_equal(*(policy(np.ones((3, 2))) for policy in policies))
    for algorithm, task, words in (
        ("sac-lbb", "Circle2D-1-v0", r"no policy of 'sac-lbb'.*did you mean 'sac-lb'"),
        ("sac-lb", "Circle2D-7-v0", r"for 'Circle2D-7-v0'.*did you mean 'Circle2D-1-v0'"),
    ):
        with pytest.raises(agents.UserError, match=words):
            agents.pretrained(algorithm, task)
        with pytest.raises(agents.UserError, match=words):
            agents.load_policy(f"pretrained:{algorithm}/{task}")


def test_pretrained_policies_do_what_the_readme_says():
    """TRPO-Lag goes straight through the cost region; SAC-LB-Streak ends in the corridor, within
    the limit of 5."""
    through = agents.evaluate(f"pretrained:trpo-lag/{TASK}", episodes=30)
    kept = agents.load_policy(f"pretrained:sac-lb-streak/{TASK}")
    kept = agents.evaluate(kept, episodes=30)
    assert (through.costs >= 9).all()
    assert through.mcc >= 0.18
    assert (kept.costs <= 5).all()
    assert kept.mcc <= 0.06
    assert (kept.returns > -10).all()  # higher than a policy that ends in a cut-out can reach


@pytest.mark.parametrize(
    ("name", "returns", "costs"),
    [
        ("cpo/SafetyPointCircle1-v0", (45, 55), (0, 40)),
        ("trpo-lag/SafetyPointCircle1-v0", (48, 60), (100, 200)),
        ("cpo/SafetyHopperVelocity-v1", (1690, 1740), (0, 20)),
        ("sac-lb/circle2d_mj/SafetyHopperVelocity-v1", (380, 450), (25, 60)),
        ("sac-lag/SafetyPointGoal1-v0", (22, 31), (25, 120)),
        ("cpo/SafetyPointGoal1-v0", (21, 31), (15, 110)),
    ],
)
def test_pretrained_policies_of_the_safety_tasks_do_as_their_runs_did(name, returns, costs):
    """The ranges lie around the mean evaluations of the archives in results/safety."""
    found = agents.evaluate(f"pretrained:{name}", episodes=3)
    assert returns[0] <= found.mean_return <= returns[1]
    assert costs[0] <= found.mean_cost <= costs[1]
