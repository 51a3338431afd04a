"""Environment steps per second of training on SafetyPointGoal1: ours, OmniSafe, Stable-Baselines3.

    python benchmarks/safety_training_speed.py --omnisafe PYTHON [--runs 1 12] [--turns 3]

PYTHON: an interpreter where omnisafe 0.5.0 and safety-gymnasium 1.0.0 are installed; OmniSafe uses
the original task. Stable-Baselines3 has no constraints, so only its PPO is measured, on the task of
this package. All sides have epochs of 10,000 steps, 10 passes, networks of 64 and 64, and equal
minibatches; features that only one side has are off. Speeds are steps per CPU second of the second
epoch, on one thread, including rollout, updates and records. Each measurement is a separate
process; sides take turns. Prints medians of speeds and of their ratios to the other two libraries.
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

EPOCH, EPOCHS = 10_000, 2
TASK = "circle2d_mj/SafetyPointGoal1-v0"
BATCH = {"ppo": 64, "ppo-lag": 64, "cpo": 128}
THEIRS = {"ppo": "PPO", "ppo-lag": "PPOLag", "cpo": "CPO"}
# Runs in OmniSafe's Python.
OMNISAFE = """
import contextlib, os, sys, tempfile, time
import omnisafe
name, batch, epoch, epochs = sys.argv[1], *map(int, sys.argv[2:])
learning = {"obs_normalize": False, "kl_early_stop": False, "use_critic_norm": False}
learning |= {"steps_per_epoch": epoch, "update_iters": 10, "batch_size": batch}
times = []
with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
    agent = omnisafe.Agent(name, "SafetyPointGoal1-v0", custom_cfgs={
        "train_cfgs": {"total_steps": epoch * epochs, "torch_threads": 1},
        "algo_cfgs": learning,
        "model_cfgs": {"linear_lr_decay": False},
        "logger_cfgs": {"log_dir": folder, "use_tensorboard": False},
    })
    logger = agent.agent.logger
    dump = logger.dump_tabular
    logger.dump_tabular = lambda: (dump(), times.append(time.process_time()))
    agent.learn()
print((epochs - 1) * epoch / (times[-1] - times[0]))
"""


def ours(name, runs):
    """Return the speed of all our runs together."""
    from agents.algorithms import algorithm
    from agents.lockstep import backend
    from agents.training.config import TrainConfig
    from agents.training.trainer import Trainer

    backend.configure("c++")
    config = algorithm(name).config(episodes=EPOCH // 1000, critic_iterations=10)
    if hasattr(config, "batch_size"):
        config = algorithm(name).config(**vars(config) | {"batch_size": BATCH[name]})
    training = TrainConfig(name, (TASK,), tuple(range(runs)), EPOCHS * EPOCH, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            trainer.run_epoch()
            before, start = trainer.steps.sum(), time.process_time()
            while not trainer.done:
                trainer.run_epoch()
            return (trainer.steps.sum() - before) / (time.process_time() - start)


def stable_baselines3():
    """Return the speed of one run of Stable-Baselines3's PPO."""
    import gymnasium as gym
    import stable_baselines3 as sb3
    import torch

    import circle2d_mj  # noqa: F401  (registers the task)

    torch.set_num_threads(1)
    learning = {"n_steps": EPOCH, "batch_size": BATCH["ppo"], "n_epochs": 10, "device": "cpu"}
    layers = {"net_arch": [64, 64]}
    model = sb3.PPO("MlpPolicy", gym.make(TASK), policy_kwargs=layers, **learning)
    model.learn(EPOCH)
    start = time.process_time()
    model.learn((EPOCHS - 1) * EPOCH, reset_num_timesteps=False)
    return (EPOCHS - 1) * EPOCH / (time.process_time() - start)


def speed(command):
    """Run a command; return the number at the end of its output."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout.split()[-1])


def median(turns, kind, over=None):
    """Return the median speed of one kind, or of its ratio to another; empty if not measured."""
    if not {kind, over} <= {*turns[0], None}:
        return ""
    values = [turn[kind] / (turn[over] if over else 1) for turn in turns]
    return f"{statistics.median(values):,.{1 if over else 0}f}"


def main():
    """Print a row for each algorithm."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--omnisafe", metavar="PYTHON", default=sys.executable)
    parser.add_argument("--runs", type=int, nargs="+", default=[1, 12])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--algorithms", nargs="+", choices=BATCH, default=list(BATCH))
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, runs = options.one
        print(stable_baselines3() if runs == "SB3" else ours(name, int(runs)))
        return
    heads = [f"ours, {n} run{'s' * (n > 1)} | ratios" for n in options.runs]
    print(f"| algorithm | OmniSafe | SB3 | {' | '.join(heads)} |")
    print(f"| {' | '.join(['---'] * (3 + 2 * len(heads)))} |")
    for name in options.algorithms:
        sizes = [str(BATCH[name]), str(EPOCH), str(EPOCHS)]
        commands = {"OmniSafe": [options.omnisafe, "-c", OMNISAFE, THEIRS[name], *sizes]}
        for kind in (*(["SB3"] if name == "ppo" else []), *options.runs):
            commands[kind] = [sys.executable, __file__, "--one", name, str(kind)]
        turns = [{k: speed(line) for k, line in commands.items()} for _ in range(options.turns)]
        cells = [median(turns, "OmniSafe"), median(turns, "SB3")]
        for n in options.runs:
            ratios = [median(turns, n, peer) for peer in ("OmniSafe", "SB3")]
            cells += [median(turns, n), ", ".join(filter(None, ratios))]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
