"""Compare pictures recorded from safety-gymnasium 1.0.0 with this package's, at equal states.

python tests/circle2d_mj/safety_pictures.py FILE.npz     # of tests/peers/record_pictures.py
"""

import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from circle2d_mj.safety import original
from circle2d_mj.safety.envs import SafetyEnv

FILE = Path(__file__).parents[1] / "golden" / "suite" / "pictures.npz"


def similarity(one, other):
    """Return the mean structural similarity (Wang et al. 2004, equation 13, with its constants)."""

    def mean(values):
        return gaussian_filter(values, 1.5, truncate=3.5, axes=(0, 1))

    x, y = np.asarray(one, float), np.asarray(other, float)
    a, b = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    mx, my = mean(x), mean(y)
    vx, vy, both = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    of_light = (2 * mx * my + a) / (mx**2 + my**2 + a)
    return float((of_light * (2 * both + b) / (vx + vy + b)).mean())


def pairs(file=FILE):
    """Yield (task, camera, size), the recorded picture and ours, for each recorded picture."""
    with np.load(file) as raw:
        arrays = dict(raw)
    cases = [name.split("/") for name in arrays if name.count("/") == 3]
    for task, camera, size in sorted({(t, c, s) for t, _, c, s in cases}):
        env = SafetyEnv(
            f"Safety{task}",
            max_episode_steps=None,
            render_mode="rgb_array",
            camera_name=camera,
            width=int(size),
            height=int(size),
        )
        env.reset(seed=0)
        for i in sorted({i for t, i, c, s in cases if (t, c, s) == (task, camera, size)}):
            start = f"{task}/{i}/"
            state = {k[len(start) :]: v for k, v in arrays.items() if k.startswith(start)}
            original.load(env, state)
            yield (task, camera, size), state[f"{camera}/{size}"], env.render()
        env.close()


if __name__ == "__main__":
    table = {}
    for case, theirs, ours in pairs(sys.argv[1]):
        table.setdefault(case, []).append(similarity(theirs, ours))
    for case, values in table.items():
        print(*case, *(f"{value:.3f}" for value in values))
