"""Speed of training with this version, an older one, and Stable-Baselines3, on one core.

    git worktree add ../before 81307c5
    python benchmarks/versions.py --before ../before [--turns 3] [--only ppo-lag sac-lag]

Prints the speed of training, in C++ and in NumPy, relative to the older version, for 1 and 12 runs,
and of one run relative to PPO and SAC of Stable-Baselines3. Timed are CPU seconds of rollout,
updates and records, after a warm-up epoch. Each measurement is a separate process; sides take
turns, and medians over turns are printed. A turn takes about a quarter of an hour with --backends
c++, half of it the older version's compilation. 81307c5 is the last version with `torch.compile`,
which it uses here. For a single measurement, such as one of OmniSafe where it is installed, or of
PPO of Stable-Baselines3 with ten environments: --one PPOLag SafetyPointGoal1-v0, --one PPO
SafetyPointGoal1-v0 10, to compare with --one ppo-lag SafetyPointGoal1-v0 1 c++.
"""

import argparse
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

GOAL, CIRCLE = "SafetyPointGoal1-v0", "Circle2D-1-v0"
CASES = [
    ("ppo-lag", GOAL),
    *((name, task) for name in ("cpo", "trpo-lag") for task in (GOAL, CIRCLE)),
]
CASES += [(name, CIRCLE) for name in ("sac-lag", "sac-lb", "wcsac")]
EPOCHS = {GOAL: 1, CIRCLE: 10}
"""Number of timed epochs. Those of the SAC family are one episode, with a gradient step for every
environment step, and a single run has four times as many."""
STABLE_BASELINES3 = {"ppo": "PPO", "ppo-lag": "PPO", "sac": "SAC", "sac-lag": "SAC"}
OMNISAFE = ("PPOLag", "CPO", "TRPOLag")
EPISODE = 50


def ours(algorithm, task, runs, how):
    """Return the steps per CPU second of all runs together; how: a backend, or "before"."""
    from dataclasses import replace

    from agents.lockstep import backend
    from agents.training.config import TrainConfig
    from agents.training.trainer import Trainer

    with contextlib.suppress(ModuleNotFoundError):
        from agents.paper.presets import preset  # its place in older versions
    with contextlib.suppress(ModuleNotFoundError):
        from agents.presets import preset

    backend.configure(True if how == "before" else how)
    config, epochs, warm = preset(algorithm, task), EPOCHS[task], 1
    if hasattr(config, "gradient_steps"):
        config = replace(config, gradient_steps=EPISODE, random_steps=0)
        epochs, warm = 4 * epochs if runs == 1 else epochs, -(-config.batch_size // EPISODE)
    training = TrainConfig(algorithm, (task,), tuple(range(runs)), 10**6, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            for _ in range(warm):
                trainer.run_epoch()
            before, start = trainer.steps.sum(), time.process_time()
            for _ in range(epochs):
                trainer.run_epoch()
            return (trainer.steps.sum() - before) / (time.process_time() - start)


def theirs(name, task, environments=1):
    """Return the steps per CPU second of one run of Stable-Baselines3."""
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.env_util import make_vec_env

    import circle2d_mj  # noqa: F401  (registers the tasks)

    torch.set_num_threads(1)
    if name == "PPO":
        warm, steps = 10_000, 10_000
        how = {"n_steps": warm // environments, "batch_size": 64, "n_epochs": 10}
    else:
        warm, steps = 300, 40 * EPISODE
        how = {"batch_size": 256, "learning_starts": 256, "train_freq": 1, "gradient_steps": 1}
    layers = {"net_arch": [64, 64]}
    env = make_vec_env(task, environments)
    model = getattr(sb3, name)("MlpPolicy", env, policy_kwargs=layers, device="cpu", **how)
    model.learn(warm)
    start = time.process_time()
    model.learn(steps, reset_num_timesteps=False)
    return steps / (time.process_time() - start)


def by_omnisafe(name, task):
    """Return the steps per CPU second of one run of OmniSafe on this package's task, with epochs of
    10,000 steps, the first to warm up. What only OmniSafe has is off: see `omnisafe_run.py`."""
    from circle2d_mj import safety_gymnasium

    safety_gymnasium.install()
    import omnisafe
    from omnisafe.common.logger import Logger

    ends, dump = [], Logger.dump_tabular

    def timed(self):
        dump(self)
        ends.append(time.process_time())

    Logger.dump_tabular = timed
    epoch, epochs = 10_000, 3
    learning = {"steps_per_epoch": epoch, "update_iters": 10, "batch_size": 64}
    learning |= {"obs_normalize": False, "kl_early_stop": False, "use_critic_norm": False}
    with tempfile.TemporaryDirectory() as folder:
        config = {
            "train_cfgs": {"total_steps": epochs * epoch, "torch_threads": 1},
            "algo_cfgs": learning,
            "model_cfgs": {"linear_lr_decay": False},
            "logger_cfgs": {"log_dir": folder, "use_tensorboard": False},
        }
        omnisafe.Agent(name, task, custom_cfgs=config).learn()
    return (epochs - 1) * epoch / (ends[-1] - ends[0])


def speed(*what, checkout=None):
    """Measure in a separate process, with the package of a checkout, by default this one."""
    own = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    own["PYTHONPATH"] = str(Path(checkout or Path(__file__).parent.parent).resolve())
    command = [sys.executable, __file__, "--one", *map(str, what)]
    done = subprocess.run(command, env=own, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout.split()[-1])


def row(algorithm, task, runs, options):
    """Return the cells of a line of the table."""
    turns = []
    for _ in range(options.turns):
        what = (algorithm, task, runs)
        found = {"before": speed(*what, "before", checkout=options.before)}
        found |= {how: speed(*what, how) for how in options.backends}
        if runs == 1 and algorithm in STABLE_BASELINES3:
            found["SB3"] = speed(STABLE_BASELINES3[algorithm], task)
        turns.append(found)
        print(algorithm, task, runs, found, file=sys.stderr)

    def median(kind, over=None):
        if not {kind, over or kind} <= turns[0].keys():
            return ""
        values = [turn[kind] / (turn[over] if over else 1) for turn in turns]
        return f"{statistics.median(values):,.{2 if over else 0}f}"

    pairs = [
        ("before", None),
        ("c++", None),
        ("c++", "before"),
        ("numpy", "before"),
        ("c++", "SB3"),
    ]
    return [algorithm, task, str(runs), *(median(*pair) for pair in pairs)]


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--before", metavar="CHECKOUT", help="of the older version")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=[name for name, _ in CASES])
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 12])
    parser.add_argument("--backends", nargs="+", default=["c++", "numpy"])
    parser.add_argument("--one", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, task, *how = options.one
        if len(how) == 2:
            print(ours(name, task, int(how[0]), how[1]))
        else:
            print((by_omnisafe if name in OMNISAFE else theirs)(name, task, *map(int, how)))
        return
    if not options.before:
        parser.error("--before must be a checkout of the older version")
    head = ["algorithm", "task", "runs", "before", "now", "ratio", "in NumPy", "over SB3"]
    print(f"| {' | '.join(head)} |\n| {' | '.join(['---'] * len(head))} |")
    for algorithm, task in CASES:
        for runs in options.runs if algorithm in options.only else ():
            print(f"| {' | '.join(row(algorithm, task, runs, options))} |", flush=True)


if __name__ == "__main__":
    main()
