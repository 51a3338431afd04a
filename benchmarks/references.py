"""SAC and PPO without a constraint, and Stable-Baselines3's: learning curves on Pendulum-v1.

Networks and hyper-parameters are equal, those of RL Baselines3 Zoo for this task as far as both
sides have them. Initial weights, episodes and noise differ. Prints the mean return of episodes in
each quarter of training: mean over seeds and 95 % interval.

python benchmarks/references.py --algorithms sac ppo --seeds 0 1 2
"""

import argparse
import contextlib
import sys
import tempfile
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from torch import nn

from agents.algorithms import algorithm
from agents.lockstep import backend
from agents.training.config import TrainConfig
from agents.training.trainer import Trainer
from emcc import mean_interval

TASK, EPISODE, QUARTERS = "FreePendulum-v0", 200, 4
STEPS = {"sac": 12_000, "ppo": 60_000}
HIDDEN, RATE = (64, 64), 1e-3
SAC = {"batch_size": 256, "gradient_steps": EPISODE, "replay_size": 50_000, "random_steps": 1_000}
SAC |= {"temperature_lr": RATE}
PPO = {"batch_size": 64, "episodes": 10, "discount": 0.9, "critic_iterations": 10}


class Free(gym.Wrapper):
    """Pendulum-v1 with actions in [-1, 1], whose steps cost nothing."""

    def __init__(self):
        super().__init__(gym.wrappers.RescaleAction(gym.make("Pendulum-v1"), -1.0, 1.0))

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward), terminated, truncated, info | {"cost": 0.0}


def ours(name, seeds, steps):
    """Train our algorithm; return the returns of the episodes of each seed."""
    settings = {"hidden": HIDDEN, "learning_rate": RATE} | (SAC if name == "sac" else PPO)
    config = algorithm(name).config(**settings)
    training = TrainConfig(name, (TASK,), tuple(seeds), steps, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            while not trainer.done:
                trainer.run_epoch()
                print(f"{name} {trainer.steps.min()} of {steps}", file=sys.stderr, end="\r")
            recorded = trainer.recorder.take()
    return [recorded[f"{run.prefix}return"] for run in training.runs]


def theirs(name, seeds, steps):
    """Train Stable-Baselines3's, one seed after the other; return the same as `ours`."""
    import stable_baselines3 as sb3
    from stable_baselines3.common.monitor import Monitor

    common = {"learning_rate": RATE, "device": "cpu"}
    layers = {"net_arch": list(HIDDEN), "activation_fn": nn.Tanh}
    found = []
    for seed in seeds:
        env = Monitor(Free())
        if name == "sac":
            model = sb3.SAC(
                "MlpPolicy",
                env,
                buffer_size=SAC["replay_size"],
                learning_starts=SAC["random_steps"],
                batch_size=SAC["batch_size"],
                train_freq=(1, "episode"),
                gradient_steps=SAC["gradient_steps"],
                policy_kwargs=layers,
                seed=seed,
                **common,
            )
        else:
            model = sb3.PPO(
                "MlpPolicy",
                env,
                n_steps=PPO["episodes"] * EPISODE,
                batch_size=PPO["batch_size"],
                gamma=PPO["discount"],
                policy_kwargs=layers,
                seed=seed,
                **common,
            )
        model.learn(steps)
        found.append(np.array(env.get_episode_rewards()))
    return found


def quarters(returns, steps):
    """Return the mean return of the episodes in each quarter of training, [seeds, quarters]."""
    episodes = steps // EPISODE
    parts = [np.array_split(of_seed[:episodes], QUARTERS) for of_seed in returns]
    return np.array([[part.mean() for part in of_seed] for of_seed in parts])


def main():
    """Print a row for each algorithm and implementation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithms", nargs="+", choices=STEPS, default=list(STEPS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=int, help="by default 12000 for SAC, 60000 for PPO")
    options = parser.parse_args()
    warnings.filterwarnings("ignore", module="stable_baselines3")  # of a smaller last minibatch
    gym.register(TASK, entry_point=Free, disable_env_checker=True)
    backend.configure("c++")
    torch.set_num_threads(1)
    print("| algorithm | steps | implementation | seeds |", " | ".join("1234"), "|")
    for name in options.algorithms:
        steps = options.steps or STEPS[name]
        for title, train in (("ours", ours), ("Stable-Baselines3", theirs)):
            curves = quarters(train(name, options.seeds, steps), steps)
            cells = []
            for values in curves.T:
                it = mean_interval(values)
                interval = "" if it.low is None else f" [{it.low:.0f}, {it.high:.0f}]"
                cells.append(f"{it.value:.0f}{interval}")
            row = (name, steps, title, len(curves), *cells)
            print("|", " | ".join(map(str, row)), "|", flush=True)


if __name__ == "__main__":
    main()
