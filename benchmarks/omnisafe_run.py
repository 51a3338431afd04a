r"""Train with OmniSafe 0.5, and record the cost and the reward of every step for EMCC.

Writes steps.npz: reward, cost and end of every step. Epochs have ten episodes. Features that only
one side has are off: normalised observations, early stopping by KL divergence, learning-rate decay,
the critics' weight decay, and mean costs over 50 episodes instead of the epoch's ten. A plain sky
replaces 191 MB of pictures that every reset reads and nothing draws. Commands with equal settings:

python omnisafe_run.py PPOLag --seed 0 --steps 500000 --out omnisafe/ppo-lag-0   # and 1, 2
python omnisafe_run.py CPO --seed 0 --steps 500000 --out omnisafe/cpo-0
circle2d train ppo-lag --task SafetyPointGoal1-v0 --seeds 0 1 2 3 4 5 6 7 8 9 --steps 500000 \
    --max-gradient-norm 40 --out ours/ppo-lag
circle2d train cpo --task SafetyPointGoal1-v0 --seeds 0 1 2 3 4 5 6 7 8 9 --steps 500000 \
    --batch-size 128 --learning-rate 1e-3 --line-search-steps 20 --target-kl 0.02 \
    --cg-damping 0.2 --out ours/cpo   # and, seeds 0 to 4, cpo-omnisafe --import omnisafe_cpo

OmniSafe's KL divergence is a mean over the components of the action, here two, so its target and
damping are half of ours.

OmniSafe runs on Python 3.11 in a separate environment, without this package:

- pip install --no-deps omnisafe==0.5.0 safety-gymnasium==1.0.0 mujoco==2.3.3 numpy==1.23.5 \
      gymnasium==0.28.1 gymnasium-robotics==1.2.2 pandas==1.5.3 scipy==1.10.1 matplotlib==3.7.5 \
      seaborn==0.12.2 moviepy==1.0.3 tensorboard==2.14.1 setuptools==65.5.0 torch
  and what these import, without their pins; empty modules wandb and gdown suffice.
- In Safety-Gymnasium's classes of geoms, fields as `color: np.array = COLOR[...]` become
  `field(default_factory=lambda: COLOR[...])`: Python 3.11 refuses an array as default.
"""

import argparse
import re
from pathlib import Path

import mujoco
import numpy as np
import omnisafe
from omnisafe.common.logger import Logger
from omnisafe.envs.safety_gymnasium_env import SafetyGymnasiumEnv

EPOCH, EPISODES = 10_000, 10
SKY = re.compile(r'<texture type="skybox"[^>]*>')


def record_steps(out: Path) -> None:
    """Patch the environment to write rewards, costs and episode ends after each epoch."""
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


def see_the_epoch_alone() -> None:
    """Patch the logger to average costs over the episodes of the epoch only."""
    register = Logger.register_key

    def registered(self, key, *args, window_length=None, **kwargs):
        register(self, key, *args, window_length=window_length and EPISODES, **kwargs)

    Logger.register_key = registered


def leave_the_sky_out() -> None:
    """Patch MuJoCo to build models without the pictures of the sky."""
    build = mujoco.MjModel.from_xml_string
    plain = '<texture type="skybox" builtin="flat" width="1" height="1">'
    mujoco.MjModel.from_xml_string = lambda xml: build(SKY.sub(plain, xml))


def main() -> None:
    """Train with the settings of the command line."""
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
    see_the_epoch_alone()
    leave_the_sky_out()
    learning = {"obs_normalize": False, "kl_early_stop": False, "use_critic_norm": False}
    learning |= {"steps_per_epoch": EPOCH, "update_iters": 10}
    config = {
        "seed": given.seed,
        "train_cfgs": {"total_steps": given.steps, "torch_threads": 1},
        "algo_cfgs": learning,
        "model_cfgs": {"linear_lr_decay": False},
        "logger_cfgs": {"log_dir": str(given.out), "use_tensorboard": False},
    }
    omnisafe.Agent(given.algorithm, given.task, custom_cfgs=config).learn()


if __name__ == "__main__":
    main()
