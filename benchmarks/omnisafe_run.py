r"""A training by OmniSafe 0.5, with the cost and the reward of every step kept for EMCC.

Writes steps.npz: reward, cost and end of every step. Epochs are of ten episodes. What only one side
has is off: normalised observations, the stop at a KL divergence, the decay of the step size, the
critics' weight decay. The multiplier sees the epoch's own episodes. Both sides, equal settings:

python omnisafe_run.py PPOLag --seed 0 --steps 500000 --out omnisafe/ppo-lag-0
python omnisafe_run.py CPO --seed 0 --steps 500000 --out omnisafe/cpo-0
circle2d train ppo-lag --task SafetyPointGoal1-v0 --seeds 0 1 2 --steps 500000 \
    --max-gradient-norm 40 --out ours/ppo-lag
circle2d train cpo --task SafetyPointGoal1-v0 --seeds 0 1 2 --steps 500000 --batch-size 128 \
    --learning-rate 1e-3 --line-search-steps 20 --out ours/cpo

OmniSafe runs on Python 3.11 in an environment of its own, without this package:

- pip install --no-deps omnisafe==0.5.0 safety-gymnasium==1.0.0 mujoco==2.3.3 numpy==1.23.5 \
      gymnasium==0.28.1 gymnasium-robotics==1.2.2 pandas==1.5.3 scipy==1.10.1 matplotlib==3.7.5 \
      seaborn==0.12.2 moviepy==1.0.3 tensorboard==2.14.1 setuptools==65.5.0 torch
  and what these import, without their pins; empty modules wandb and gdown will do.
- In Safety-Gymnasium's classes of geoms, fields as `color: np.array = COLOR[...]` become
  `field(default_factory=lambda: COLOR[...])`: Python 3.11 refuses an array as default.
"""

import argparse
from pathlib import Path

import numpy as np
import omnisafe
from omnisafe.envs.safety_gymnasium_env import SafetyGymnasiumEnv

EPOCH = 10_000


def record_steps(out: Path) -> None:
    """Have the environment write the rewards, costs and episode ends of each epoch's steps."""
    steps: list[tuple[float, float, bool]] = []
    step = SafetyGymnasiumEnv.step

    def recorded(self, action):
        result = step(self, action)
        _, reward, cost, terminated, truncated, _ = result
        steps.append((float(reward), float(cost), bool(terminated) or bool(truncated)))
        if len(steps) % EPOCH == 0:
            reward, cost, end = (np.array(column) for column in zip(*steps, strict=True))
            np.savez_compressed(out / "steps.npz", reward=reward, cost=cost, end=end)
        return result

    SafetyGymnasiumEnv.step = recorded


def main() -> None:
    """Train as the command line says."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("algorithm", choices=("PPOLag", "CPO"))
    parser.add_argument("--task", default="SafetyPointGoal1-v0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True)
    record_steps(given.out)
    learning = {"obs_normalize": False, "kl_early_stop": False, "use_critic_norm": False}
    learning |= {"steps_per_epoch": EPOCH, "update_iters": 10}
    config = {
        "seed": given.seed,
        "train_cfgs": {"total_steps": given.steps, "torch_threads": 1},
        "algo_cfgs": learning,
        "model_cfgs": {"linear_lr_decay": False},
        "logger_cfgs": {"log_dir": str(given.out), "use_tensorboard": False, "window_lens": 10},
    }
    omnisafe.Agent(given.algorithm, given.task, custom_cfgs=config).learn()


if __name__ == "__main__":
    main()
