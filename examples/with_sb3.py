"""Stable-Baselines3: a callback records costs, logs emcc/* to SB3's logger, and makes the panel.

The logger writes to TensorBoard with `PPO(..., tensorboard_log=FOLDER)`, and from there to W&B with
`wandb.init(sync_tensorboard=True)`.
"""

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import circle2d_mj  # noqa: F401  # registers the task
import emcc

envs = make_vec_env("Circle2D-1-v0", n_envs=4, seed=0)
callback = emcc.sb3.EMCCCallback(limit=5.0)
PPO("MlpPolicy", envs, n_steps=250, batch_size=250, seed=0, device="cpu").learn(6000, callback)
print(callback.panel().to_latex())
