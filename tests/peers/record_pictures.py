"""Record pictures of safety-gymnasium 1.0.0 together with the states that they show.

PYTHON tests/peers/record_pictures.py FILE.npz     # PYTHON has safety-gymnasium 1.0.0
python tests/circle2d_mj/safety_pictures.py FILE.npz     # compares them with those of this package

For each task and state, the file holds arrays as `circle2d_mj.safety.original.load` takes them, and
pictures "CAMERA/SIZE". Those of the agent's camera show lidar markers, as observations do; those of
other cameras show none.
"""

import os
import sys

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
import safety_gymnasium

TASKS = ("PointGoal1", "CarButton2", "DoggoPush2", "PointCircle2", "CarGoal2")
CAMERAS, SIZES = ("vision", "fixednear", "track"), (64, 256)
EVERY, STATES = 30, 3


def state_of(task, first):
    """Return the state, with the names of `original.load`. first: the entries of the reset."""
    data = task.data
    state = {"qpos": data.qpos, "qvel": data.qvel, "time": data.time, **first}
    for kind in ("hazards", "pillars", "buttons", "goal"):
        if hasattr(task, kind):
            state[f"{kind}_pos"] = getattr(task, kind).pos
    if hasattr(task, "buttons"):
        state["goal_button"], state["timer"] = task.buttons.goal_button, task.buttons.timer
    if task.model.nmocap:
        state["mocap_pos"] = data.mocap_pos
    return {name: np.array(value, dtype=float) for name, value in state.items()}


def put(task, state, body_pos):
    """Put the task back into a state of the same episode."""
    data = task.data
    data.qpos[:], data.qvel[:], data.time = state["qpos"], state["qvel"], float(state["time"])
    if "mocap_pos" in state:
        data.mocap_pos[:] = state["mocap_pos"]
    task.model.body_pos[:] = body_pos
    mujoco.mj_forward(task.model, data)


def record(name):
    """Return states of an episode and pictures of each; one buffer serves each size."""
    env = safety_gymnasium.make(f"Safety{name}-v0")
    env.reset(seed=5)
    task, rng = env.unwrapped.task, np.random.default_rng(0)
    body = task.model.body("agent")
    first = {"qpos0": task.data.qpos, "agent_body_pos0": body.pos, "agent_body_quat0": body.quat}
    first = {key: np.array(value) for key, value in first.items()}
    count, kept, found = env.action_space.shape[0], [], {}
    for step in range(EVERY * (STATES - 1) + 1):
        if step % EVERY == 0:
            kept.append((state_of(task, first), task.model.body_pos.copy()))
        env.step(np.array([0.6, 0.3]) if count == 2 else rng.uniform(-1, 1, count))
    for size in SIZES:
        task._viewers.clear()
        for i, (state, body_pos) in enumerate(kept):
            put(task, state, body_pos)
            found |= {f"{name}/{i}/{key}": value for key, value in state.items()}
            for camera in CAMERAS:
                task.render_conf.lidar_markers = camera == "vision"
                picture = task.render(size, size, "rgb_array", camera_name=camera, cost={})
                found[f"{name}/{i}/{camera}/{size}"] = picture.copy()
    return found


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **{k: v for name in TASKS for k, v in record(name).items()})
