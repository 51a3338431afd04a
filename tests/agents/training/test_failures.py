"""Failures of tasks, algorithms and callbacks: their place and cause, and which runs they end."""

import contextlib
import multiprocessing
import os
import pickle
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import toy_family
import toys
from small_runs import SAC, TRPO, checkpoints_often, wait_until
from toy_family import Linear, Numbers, Rule, known

import agents
from agents.algorithms import Algorithm
from agents.cli.main import main
from agents.errors import OwnCodeError, RunsFailed, TaskFailure, UserError
from agents.sac import OffPolicy
from agents.training.environments import make_envs

OPTIONS = {"seeds": (0, 1), "steps": 100, "checkpoint_every": 20}
SGD = {"multiplier_optimizer": "sgd", "multiplier_lr": 1.0, "cost_limit": 0.0, "episodes": 2}


@pytest.fixture(autouse=True)
def often():
    with checkpoints_often():
        yield


def line(function, words):
    """Return a pattern for the file and line of some words in a source file."""
    path = Path(function)
    [number] = [k for k, text in enumerate(path.read_text().splitlines(), 1) if words in text]
    return re.escape(f"({path}, line {number})")


RAISES = r"failed in step 10 of an episode: LookupError: .*" + line(toys.__file__, "motor")


RESETS = "failed in a reset: LookupError: .*" + line(toys.__file__, "door")


@pytest.mark.parametrize(
    ("how", "words", "vectorization"),
    [
        ("raise", RAISES, "sync"),
        ("raise", RAISES, "async"),
        ("reset", RESETS, "sync"),
        ("reset", RESETS, "async"),
        ("observation", r"an observation must be \[2\], as its space says, got \[3\]", "sync"),
        ("reward", r"reward = array\(\[0., 0.\]\), which is no number", "sync"),
        ("complex", "reward = 1j, which is no number", "sync"),
        ("cost", r"info\['cost'\] = 'much', which is no number", "async"),
        ("missing", r"gives no info\['cost'\]", "sync"),
        ("negative", " gives a negative cost: -1 in step 10 of an episode", "sync"),
    ],
)
def test_a_task_that_fails_in_every_run_is_named(tmp_path, how, vectorization, words):
    at = 40 if how == "reset" else 50
    parameters = {"how": how, "at": at}
    more = OPTIONS | SAC | {"task_parameters": parameters, "vectorization": vectorization}
    words = "(?s)every run of .*x failed; the first .*task 'Broken-v0'.*" + words
    with pytest.raises(RunsFailed, match=words) as raised:
        agents.train("sac-lag", "Broken-v0", out=tmp_path / "x", **more)
    assert (type(raised.value.__cause__) is LookupError) == (how in ("raise", "reset"))
    assert not multiprocessing.active_children()


UNSTABLE = "FloatingPointError: unstable"
EXITS = "SystemExit: 0"
NEGATIVE = "gives a negative cost: -1 in step"


@pytest.mark.parametrize(
    ("algorithm", "how", "words", "vectorization"),
    [
        ("cpo", "raise", UNSTABLE, "sync"),
        ("sac-lag", "raise", UNSTABLE, "async"),
        ("cpo", "exit", EXITS, "sync"),
        ("cpo", "exit", EXITS, "async"),
        ("cpo", "negative", NEGATIVE, "sync"),
    ],
)
def test_a_run_whose_task_fails_stops_alone(tmp_path, capsys, algorithm, how, words, vectorization):
    """The other runs do not change. The failed run is named, and `resume` does not restart it."""
    more = OPTIONS | (TRPO if algorithm == "cpo" else SAC) | {"seeds": (0, 1, 2, 3), "steps": 160}
    more["vectorization"] = vectorization
    healthy = agents.train(algorithm, "Walk-v0", **more).results[0]
    parameters = {"poison": 0.002, "poisons": how}
    out = tmp_path / "x"
    with pytest.warns(UserWarning, match=f"seed .: failed .*{words}") as warned:
        runs = agents.train(algorithm, "Walk-v0", task_parameters=parameters, out=out, **more)
    assert not multiprocessing.active_children()
    [group] = runs.results
    assert len(warned) == len(group.missing)
    left = [run.seed for run in group.runs]
    assert 1 <= len(left) < 4
    assert {*left, *group.missing} == {0, 1, 2, 3}
    measured = {run.seed: run.measures for run in healthy.runs}
    assert {run.seed: run.measures for run in group.runs} == {k: measured[k] for k in left}
    for seed, why in group.missing.items():
        assert re.match(rf"failed at step \d+: task 'Walk-v0' .*{words}", why)
        assert agents.load_policy(out, seed).failure == why
    before = [path.read_bytes() for path in sorted(out.glob("*/*.npz"))]
    capsys.readouterr()
    assert main(["resume", str(out)]) == 1
    assert [path.read_bytes() for path in sorted(out.glob("*/*.npz"))] == before
    told = capsys.readouterr().err
    assert len(re.findall(f"(?m)^circle2d: .*seed .*{words}", told)) == len(group.missing)
    raised = {"raise": 'raise FloatingPointError("unstable")', "exit": "sys.exit(0)"}.get(how)
    assert raised is None or told.count(raised) == len(group.missing)
    assert raised is None or all(raised in str(warning.message) for warning in warned)
    assert {warning.filename for warning in warned} == {__file__}
    assert main(["report", str(out)]) == 1
    assert capsys.readouterr().out.count("left out: x, seed ") == len(group.missing)


def test_a_task_that_fails_in_the_evaluation_alone(tmp_path, capsys):
    """The training ends, and each run's failed evaluation is named with its traceback."""

    class Late(toys.Walk):
        late = False

        def step(self, action):
            if Late.late:
                sys.exit(0)
            return super().step(action)

    def end(epoch):
        Late.late = all(numbers["step"] >= epoch.steps for numbers in epoch.runs.values())

    with toys.registered(Late=Late):
        out = tmp_path / "x"
        with pytest.warns(UserWarning, match="its evaluation failed"):
            agents.train("cpo", "Late-v0", out=out, on_epoch=end, **OPTIONS | TRPO)
        assert main(["resume", str(out)]) == 1
    told = capsys.readouterr().err
    assert len(re.findall("seed [01]: its evaluation failed: task 'Late-v0'.*Exit: 0", told)) == 2
    assert told.count("sys.exit(0)") == 2


def exits(*args):
    """Stand in for a user's code that ends the program with status 0."""
    sys.exit(0)


def test_an_exit_in_a_callback_is_an_error_and_its_epoch_is_saved(tmp_path):
    with pytest.raises(OwnCodeError, match=r"SystemExit: 0 .*test_failures\.py, line") as raised:
        agents.train("cpo", "Walk-v0", out=tmp_path / "x", on_epoch=exits, **OPTIONS | TRPO)
    assert type(raised.value.__cause__) is SystemExit
    assert len(list((tmp_path / "x" / "checkpoints").iterdir())) == 1
    assert not (tmp_path / "x" / "results.npz").exists()


def test_an_exit_in_a_users_module_or_policy_is_an_error(tmp_path, monkeypatch):
    (tmp_path / "exits.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["resume", "--import", "exits", str(tmp_path)]) == 1
    with pytest.raises(OwnCodeError, match="'exits:X-v0': SystemExit"):
        agents.train("cpo", "exits:X-v0", **OPTIONS)
    with pytest.raises(OwnCodeError, match="SystemExit: 0"):
        agents.evaluate(exits, "Walk-v0", episodes=1)
    with pytest.raises(SystemExit) as shown:
        main(["resume", "--help"])
    assert shown.value.code == 0


def test_an_exit_while_options_are_read_is_an_error(monkeypatch, capsys):
    """Reading the options constructs the config of a user-defined algorithm, which may exit."""
    monkeypatch.setattr("tyro.cli", lambda *args, **more: sys.exit("away"))
    assert main(["report", "runs"]) == 1
    assert re.search(r"SystemExit: away .*test_failures\.py, line", capsys.readouterr().err)


def test_ctrl_c_during_a_step_does_not_count_as_the_tasks_failure(tmp_path):
    class Stopped(toys.Walk):
        taken = 0

        def step(self, action):
            Stopped.taken += 1
            if Stopped.taken == 30:
                raise KeyboardInterrupt
            return super().step(action)

    with toys.registered(Stopped=Stopped):
        with pytest.raises(KeyboardInterrupt):
            agents.train("cpo", "Stopped-v0", out=tmp_path / "x", **OPTIONS | TRPO)
        agents.resume(tmp_path / "x")


DIES, HANGS = "a process of its environments ended", "a process did not answer within step_timeout"


@pytest.mark.parametrize(("how", "words"), [("die", DIES), ("hang", f"{HANGS}, 0.5 s")])
def test_an_environments_process_that_dies_or_hangs_ends_the_training(tmp_path, how, words):
    more = OPTIONS | TRPO | {"vectorization": "async", "step_timeout": 0.5}
    with pytest.raises(TaskFailure, match=f"'Broken-v0' failed in step 10 .*{words}"):
        more["task_parameters"] = {"how": how}
        agents.train("cpo", "Broken-v0", out=tmp_path / "x", **more)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("algorithm", ["cpo", "sac-lag", "ppo"])
@pytest.mark.parametrize("name", ["reward", "cost"])
def test_numbers_beyond_float32_end_their_run_alone(algorithm, name):
    """They are infinite in float32, in which networks learn."""

    class Huge(toys.Walk):
        def step(self, action):
            observation, reward, *ends, info = super().step(action)
            if self.np_random.random() < 0.005:
                reward, info = (1e308, info) if name == "reward" else (reward, {"cost": 1e308})
            return observation, reward, *ends, info

    family = SAC if algorithm == "sac-lag" else TRPO
    options = {k: v for k, v in family.items() if k != "critic_iterations"}
    with toys.registered(Huge=Huge):
        more = OPTIONS | options | {"seeds": range(6), "steps": 80}
        with pytest.warns(UserWarning, match="not finite"):
            [group] = agents.train(algorithm, "Huge-v0", **more).results
    assert 1 <= len(group.missing) < 6
    words = (rf"failed at step \d+: its {name} is", "its evaluation met a number that is")
    for why in group.missing.values():
        assert re.match(f"{'|'.join(words)} not finite", why)


def test_a_close_that_hangs_is_ended_after_the_step_timeout():
    here = os.getpid()

    class Hangs(toys.Walk):
        def close(self):
            if os.getpid() != here:
                time.sleep(60)

    with toys.registered(Hangs=Hangs):
        for step in (False, True):
            envs = make_envs("Hangs-v0", 2, {}, "async", step_timeout=0.5)
            envs.reset(seed=[1, 2])
            if step:
                envs.step(np.zeros((2, 1), np.float32))
            began = time.monotonic()
            envs.close()
            assert time.monotonic() - began < 10
            assert not multiprocessing.active_children()


@pytest.mark.parametrize("error", [RuntimeError("stuck"), SystemExit(0)])
def test_an_error_while_closing_is_a_warning(error, tmp_path):
    """Neither the training nor an evaluation is lost."""

    class Stuck(toys.Walk):
        def close(self):
            raise error

    told = re.escape(f"failed while it was closed: {type(error).__name__}: {error} (")
    with toys.registered(Stuck=Stuck):
        with pytest.warns(UserWarning, match=told):
            runs = agents.train("cpo", "Stuck-v0", out=tmp_path / "x", **OPTIONS | TRPO)
        assert len(runs.to_pandas()["seed"].unique()) == len(OPTIONS["seeds"])
        with pytest.warns(UserWarning, match=told):
            assert len(agents.evaluate(agents.load_policy(runs, seed=0), episodes=2).returns) == 2


def test_a_task_that_cannot_be_made_in_its_process():
    """In this process it can. The error names the line of the user's code."""
    here = os.getpid()

    class Apart(toys.Walk):
        def __init__(self):
            if os.getpid() != here:
                raise LookupError("no second one")

    with toys.registered(Apart=Apart):
        words = r"cannot make task 'Apart-v0': LookupError: no second one \(.*failures.py, line \d+"
        with pytest.raises(OwnCodeError, match=words) as raised:
            make_envs("Apart-v0", 2, {}, "async")
    assert type(raised.value.__cause__) is LookupError
    assert not multiprocessing.active_children()


def test_an_exit_in_a_vector_environment_ends_the_training(monkeypatch):
    envs = make_envs("Circle2D-1-v0", 2, {}, alone=True)
    monkeypatch.setattr(type(envs.unwrapped), "step", exits)
    envs.reset(seed=[1, 2])
    with pytest.raises(TaskFailure, match=r"'Circle2D-1-v0' failed in step 1 .*SystemExit: 0"):
        envs.step(np.zeros((2, 2), np.float32))


@pytest.mark.parametrize("vectorization", ["auto", "async"])
def test_a_task_that_cannot_be_made_leaves_nothing(tmp_path, vectorization):
    more = {"task_parameters": {"how": "init"}, "vectorization": vectorization}
    place = line(toys.__file__, "no licence")
    words = f"cannot make task 'Broken-v0': LookupError: no licence {place}"
    with pytest.raises(OwnCodeError, match=words) as raised:
        agents.train("cpo", "Broken-v0", out=tmp_path / "x", **more)
    assert type(raised.value.__cause__) is LookupError
    assert not list(tmp_path.iterdir())


def test_a_task_that_fails_while_a_policy_is_evaluated():
    more = {"episodes": 2, "task_parameters": {"how": "raise", "at": 5}}
    words = r"'Broken-v0' failed in step 5 of an episode: Lookup"
    with pytest.raises(TaskFailure, match=words) as raised:
        agents.evaluate(lambda observation: np.zeros(1, np.float32), "Broken-v0", **more)
    assert type(raised.value.__cause__) is LookupError


class Odd(Exception):
    """An error that cannot be pickled."""

    def __init__(self, a, b):
        super().__init__(a)


def test_a_task_failure_keeps_its_cause_when_it_is_pickled():
    for cause in (LookupError("motor"), Odd("motor", 1)):
        try:
            raise TaskFailure("failed") from cause
        except TaskFailure as error:
            copy = pickle.loads(pickle.dumps(error))
        assert type(copy) is TaskFailure
        assert "motor" in str(copy.__cause__)
        assert (type(copy.__cause__) is LookupError) == isinstance(cause, LookupError)
        assert "motor" in str(copy.__cause__.__cause__)  # the traceback of the other process


def test_a_vector_environments_arrays_of_other_shapes_are_named():
    envs = make_envs("Broken-v0", 3, {})
    step = envs.unwrapped.step
    envs.unwrapped.step = lambda actions: (step(actions)[0], np.zeros(2), *step(actions)[2:])
    envs.reset(seed=[1, 2, 3])
    with pytest.raises(TaskFailure, match=r"'Broken-v0' failed in step 1 .*rewards must be \[3\]"):
        envs.step(np.zeros((3, 1), np.float32))


@pytest.mark.parametrize(
    ("wrong", "does", "words"),
    [
        ("learn", "learns", "nothing to learn from"),
        ("act", "acts", "nothing to act by"),
        ("exit", "learns", "sys.exit"),
    ],
)
def test_an_algorithm_that_raises_or_exits_is_named(tmp_path, wrong, does, words):
    with known():
        source = line(toy_family.__file__, words)
        error = SystemExit if wrong == "exit" else ZeroDivisionError
        words = rf"'toy' failed at step \d+ where it {does}: {error.__name__}: .*{source}"
        with pytest.raises(OwnCodeError, match=words) as raised:
            agents.train("toy", "Walk-v0", wrong=wrong, out=tmp_path / "x", **OPTIONS)
        assert type(raised.value.__cause__) is error
        with pytest.raises(OwnCodeError):
            agents.resume(tmp_path / "x")


def test_an_algorithms_numbers_that_are_not_finite_end_their_run_alone(tmp_path):
    """The failed run is left out, and the other one does not change."""
    more = OPTIONS | {"steps": 300}
    with known():
        runs = {"": agents.train("toy", "Walk-v0", **more)}
        for wrong in ("nan", "action"):
            with pytest.warns(UserWarning, match=r"Walk-v0, seed 0: failed .* is not finite$"):
                runs[wrong] = agents.train("toy", "Walk-v0", wrong=wrong, **more)
        for wrong, words in {"nan": "update", "action": "action"}.items():
            [group] = runs[wrong].results
            assert re.fullmatch(rf"failed at step \d+: its {words} is not finite", group.missing[0])
            [left] = group.runs
            assert left.measures == runs[""].results[0].runs[1].measures
            with pytest.raises(RunsFailed, match=f"every run of .*: its {words}"):
                agents.train("toy", "Walk-v0", wrong=wrong, **(OPTIONS | {"seeds": 0}))


def test_an_evaluation_of_a_folder_leaves_failed_runs_out(tmp_path, capsys):
    with known():
        more = OPTIONS | {"steps": 300, "out": tmp_path / "x"}
        with pytest.warns(UserWarning, match="failed"):
            runs = agents.train("toy", "Walk-v0", wrong="nan", **more)
        [group] = runs.results
        failed, left = (agents.load_policy(runs, seed) for seed in OPTIONS["seeds"])
        assert (failed.failure, left.failure) == (group.missing[failed.seed], "")
        words = f"left out of .*: Walk-v0, seed {failed.seed} failed at step"
        with pytest.warns(UserWarning, match=words):
            found = agents.evaluate(runs, episodes=3)
        assert found.seeds == (left.seed,)
        np.testing.assert_array_equal(found.returns[0], agents.evaluate(left, episodes=3).returns)
        assert main(["evaluate", str(tmp_path / "x"), "--episodes", "1"]) == 1
    assert f"seed {failed.seed}, stochastic policy: failed at step" in capsys.readouterr().out


def test_a_run_that_fails_right_after_a_checkpoint_keeps_its_episodes(tmp_path):
    """The first action after the checkpoint is NaN, so that no step is added to the file's."""
    with known(), pytest.raises(RunsFailed):
        more = OPTIONS | {"seeds": 0, "checkpoint_every": 1, "out": tmp_path / "x"}
        agents.train("toy", "Walk-v0", wrong="action", **more)
    with np.load(tmp_path / "x" / "results.npz") as file:
        words = str(file["Walk-v0/0/failure"])
        assert words == f"failed at step {file['Walk-v0/0/length'].sum()}: its action is not finite"


def test_where_every_run_failed(tmp_path):
    more = OPTIONS | TRPO | {"task_parameters": {"poison": 1.0}, "out": tmp_path / "x"}
    words = "every run of .*x failed; the first failed at step .*: its reward is not finite"
    with pytest.raises(RunsFailed, match=words):
        agents.train("cpo", "Walk-v0", **more)
    with pytest.raises(RunsFailed, match=words):
        agents.resume(more["out"])
    runs = agents.load_runs(tmp_path / "x")
    with pytest.raises(UserError, match=r"holds no complete runs; .*its reward is not finite"):
        _ = runs.results
    # They failed in their first epoch, which leaves no records, and reading these is no error.
    assert {len(records) for records in runs.records.values()} == {0}
    assert [len(runs.to_pandas(rows)) for rows in ("episodes", "updates")] == [0, 0]


def reduced(learner):
    """Return a learner's class whose runs share what they learn."""

    class Reduced(learner):
        def learn(self, *args):
            metrics = super().learn(*args)
            if not np.isnan(metrics).all():
                state = self.state_dict()
                actor = next(name for name in state if name.startswith("actor"))
                state[actor] = state[actor] + 0.1 * np.abs(state[actor]).mean(axis=0)
                self.load_state_dict(state)
            return metrics

    return Reduced


@contextlib.contextmanager
def more_algorithms():
    """Register algorithms that reduce over the runs, and some that do not."""
    from agents.algorithms.ppo_lag import ALGORITHM as ppo
    from agents.algorithms.sac_lag import ALGORITHM as sac
    from agents.algorithms.trpo_lag import ALGORITHM as trpo
    from agents.first_order import clipped, mean

    def family(config, rule, *args):
        return reduced(OffPolicy)(config, rule, *args)

    def averaged(config, policy, ratio, batch):
        gain, outside = clipped(config, policy, ratio, batch)
        paid = mean(batch, ratio * batch.cost_advantage[:, 0])
        return gain - batch.multipliers.mean() * paid, outside

    def averaged_advantage(config, reward, cost, multipliers):
        return reward - multipliers.mean() * cost[:, 0]

    own = {
        "toy": None,
        "sac-reduced": sac._replace(family=family),
        "sac-own": sac,
        "avg": ppo._replace(rule=ppo.rule._replace(surrogates=(averaged,))),
        "avg-own": trpo._replace(rule=trpo.rule._replace(advantage=averaged_advantage)),
    }
    with contextlib.ExitStack() as stack:
        for name, algorithm in own.items():
            stack.enter_context(known(name, algorithm))
        yield


def test_an_error_names_no_decorator_as_its_place():
    """Frames of NumPy's and PyTorch's decorators around the learning are skipped."""
    own = agents.algorithms.algorithm("ppo-lag")
    gain = own._replace(rule=own.rule._replace(surrogates=(lambda c, p, r, b: r.mean(dim=-1),)))
    words = r"a surrogate must return two of .*/agents/first_order\.py, line \d+\)$"
    with known("gain", gain), pytest.raises(UserError, match=words):
        agents.train("gain", "Walk-v0", seeds=(0, 1), steps=50, episodes=2, backend="numpy")


@pytest.mark.parametrize(
    ("algorithm", "options"), [("toy", {"wrong": "reduce"}), ("sac-reduced", SAC), ("avg", SGD)]
)
def test_a_loss_that_reduces_over_the_runs_is_refused(tmp_path, algorithm, options):
    """In a user-defined algorithm, at its first update, which for SAC comes after some epochs, or
    at the second, if runs differ only once their multipliers do."""
    with more_algorithms():
        epochs = []
        more = OPTIONS | options | {"out": tmp_path / "x", "on_epoch": epochs.append}
        with pytest.raises(UserError, match=f"'{algorithm}' trains a run differently beside"):
            agents.train(algorithm, "Walk-v0", **more)
        assert len(epochs) < 4
        agents.train(algorithm, "Walk-v0", **OPTIONS | options | {"seeds": 0})


def test_a_learner_without_metrics_that_reduces_over_the_runs_is_refused():
    class Untold(Linear):
        metrics = ()

        def learn(self, rollout, epoch, active):
            return super().learn(rollout, epoch, active)[:, :0]

    with known("untold", Algorithm("Toy", Numbers, Rule(), Untold)):
        with pytest.raises(UserError, match="'untold' trains a run differently beside"):
            agents.train("untold", "Walk-v0", **OPTIONS | {"wrong": "reduce"})
        agents.train("untold", "Walk-v0", **OPTIONS)


def test_a_state_that_hides_the_trainings_own_is_refused():
    class Counting(Linear):
        def state_dict(self):
            return super().state_dict() | {"steps": np.zeros(len(self.seeds), np.int64)}

    words = pytest.raises(UserError, match="state_dict of algorithm 'counting' has steps")
    with known("counting", Algorithm("Toy", Numbers, Rule(), Counting)), words:
        agents.train("counting", "Walk-v0", **OPTIONS)


def test_user_defined_algorithms_that_do_not_reduce_over_the_runs_train(tmp_path):
    """An advantage may take a mean over the multipliers, since it sees one run at a time."""

    class Unequal(Linear):
        """Runs may differ by their seeds."""

    with more_algorithms(), known("unequal", Algorithm("Toy", Numbers, Rule(), Unequal)):
        for name, options in (("toy", {}), ("sac-own", SAC), ("unequal", {}), ("avg-own", SGD)):
            agents.train(name, "Walk-v0", **OPTIONS | options)


def test_an_environments_process_ends_when_its_pipe_breaks():
    envs = make_envs("Walk-v0", 1, {}, "async")
    envs.reset(seed=[1])
    [process] = envs.unwrapped.processes
    envs.unwrapped.parent_pipes[0].close()
    wait_until(lambda: not process.is_alive(), 60)
    assert process.exitcode == 1
    envs.close()


def test_environments_in_processes_end_with_a_training_that_is_stopped(tmp_path):
    more = OPTIONS | TRPO | {"vectorization": "async", "on_epoch": lambda epoch: False}
    agents.train("cpo", "Walk-v0", out=tmp_path / "x", **more)
    assert not multiprocessing.active_children()
