"""PPO-Lag and CPO on SafetyPointGoal1 beside OmniSafe on the original: environment steps a second.

    python benchmarks/safety_training_speed.py --omnisafe PYTHON [--runs 1 12] [--turns 3]

PYTHON: an interpreter where omnisafe 0.5.0 and safety-gymnasium 1.0.0 are installed. Both sides:
10,000 steps an epoch, 10 passes, networks of 64 and 64, equal minibatches; what only one side has
is off. Speeds are of CPU time, one thread, rollout, updates and records included, of the second
epoch; the first one compiles. Each measurement has a process of its own; all take turns, and
medians are printed.
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
BATCH = {"ppo-lag": 64, "cpo": 128}
THEIRS = {"ppo-lag": "PPOLag", "cpo": "CPO"}
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
    """Speed of all runs together."""
    from agents.algorithms import algorithm
    from agents.lockstep import backend
    from agents.training.config import TrainConfig
    from agents.training.trainer import Trainer

    backend.configure()
    config = algorithm(name).config(episodes=EPOCH // 1000, critic_iterations=10)
    if hasattr(config, "batch_size"):
        config = algorithm(name).config(**vars(config) | {"batch_size": BATCH[name]})
    task = "circle2d_mj/SafetyPointGoal1-v0"
    training = TrainConfig(name, (task,), tuple(range(runs)), EPOCHS * EPOCH, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            trainer.run_epoch()
            before, start = trainer.steps.sum(), time.process_time()
            while not trainer.done:
                trainer.run_epoch()
            return (trainer.steps.sum() - before) / (time.process_time() - start)


def speed(command):
    """The last line that a process prints."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout.split()[-1])


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
        print(ours(options.one[0], int(options.one[1])))
        return
    heads = [f"{n} run{'s' * (n > 1)} | over it" for n in options.runs]
    print(f"| algorithm | OmniSafe, 1 run | {' | '.join(heads)} |")
    print(f"| {' | '.join(['---'] * (2 + 2 * len(heads)))} |")
    for name in options.algorithms:
        sizes = [str(BATCH[name]), str(EPOCH), str(EPOCHS)]
        commands = [[options.omnisafe, "-c", OMNISAFE, THEIRS[name], *sizes]]
        commands += [[sys.executable, __file__, "--one", name, str(n)] for n in options.runs]
        turns = [[speed(command) for command in commands] for _ in range(options.turns)]
        cells = [f"{statistics.median(turn[0] for turn in turns):,.0f}"]
        for k in range(1, len(commands)):
            cells.append(f"{statistics.median(turn[k] for turn in turns):,.0f}")
            cells.append(f"{statistics.median(turn[k] / turn[0] for turn in turns):.1f}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
