"""Compute a report's numbers from the steps of episodes, independently of the package.

This follows the paper's definitions with lists, loops and fractions and uses none of the package's
code.
"""

import math
import re
from collections import Counter
from statistics import fmean, stdev

TIME_LIMIT = 50  # applied by gymnasium's wrapper, outside of the environment that records steps
T_OF_4 = 2.7764451  # 97.5 % quantile of Student's t with 4 degrees of freedom, for five runs


class Episode:
    """The steps from a reset to the first one that ends the episode; later steps are ignored."""

    def __init__(self):
        self.rewards, self.costs, self.last, self.over = [], [], None, False

    def add(self, observation, reward, terminated, truncated, info):
        if not self.over:
            self.rewards.append(float(reward))
            self.costs.append(float(info["cost"]))
            self.last = [float(x) for x in observation]
            self.over = terminated or truncated or len(self.costs) == TIME_LIMIT


def of_training(epochs, in_all):
    """Return the training's numbers over the epochs until `in_all` environment steps are reached.

    epochs: for each epoch, its episodes.
    """
    parts = {"0.33": [], "0.66": [], "0.99": []}
    rates = {name: [0.0, 0] for name in parts}
    steps, costs, later, chains = 0, 0.0, [], []
    for episodes in epochs:
        if steps >= in_all:
            break
        assert all(episode.over for episode in episodes)
        mcc = max(max(streaks(one.costs), default=0) / len(one.costs) for one in episodes)
        for name, low, high in (("0.33", 0, 33), ("0.66", 33, 66), ("0.99", 66, 99)):
            start = 100 * steps / in_all
            if low <= start < high or start == high == 99:
                parts[name].append(mcc)
                rates[name][0] += sum(sum(episode.costs) for episode in episodes)
                rates[name][1] += sum(len(episode.costs) for episode in episodes)
        for episode in episodes:
            if 3 * steps >= in_all:
                later.append(sum(episode.costs))
            costs += sum(episode.costs)
            steps += len(episode.costs)
            chains += streaks(episode.costs)
    assert steps >= in_all
    found = {f"EMCC_{name}": top(values, 10) for name, values in parts.items()}
    found |= {f"all_{name}": highest(values, 0.1) for name, values in parts.items()}
    found |= {f"rate_{name}": cost / number for name, (cost, number) in rates.items()}
    mean = fmean(chains) if chains else 0.0
    return found | {"cost_rate": costs / steps, "later": fmean(later), "mean_streak": mean}


def top(values, parts):
    """Return the mean of the highest 1 / `parts` of the values, with ties split exactly.

    Each value is copied `parts` times, so that the highest len(values) copies are that share.
    """
    copies = sorted(value for value in values for _ in range(parts))
    return fmean(copies[-len(values) :])


def streaks(costs):
    """Return the lengths of all chains of cost steps in an episode."""
    return [len(chain) for chain in "".join("x" if c > 0 else " " for c in costs).split()]


def highest(values, alpha):
    """Return the mean of the values at or above the smallest x with P(value <= x) >= 1 - alpha."""
    ordered = sorted(values)
    at = next(x for k, x in enumerate(ordered, 1) if k >= (1 - alpha) * len(ordered) - 1e-9)
    return fmean(x for x in ordered if x >= at)


def of_evaluation(episodes):
    costs = [sum(episode.costs) for episode in episodes]
    places = [place(*(15 * x for x in episode.last)) for episode in episodes]
    (most, count), *others = Counter(places).most_common()
    return {
        "J_R": fmean(sum(episode.rewards) for episode in episodes),
        "J_C": fmean(costs),
        "CVaR_0.5": top(costs, 2),
        "ends": f"{most} ({100 * count / len(places):.0f} %)" if others else most,
    }


def place(x, y):
    """Name the place of a point on level 3: a disc of radius 10 with cut-outs.

    A cut-out has a direction in degrees, a depth and a width.
    """
    side = ("right" if x >= 0 else "left") if abs(x) >= abs(y) else "top" if y >= 0 else "bottom"
    if math.hypot(x, y) >= 10:
        return f"{side} rim"
    cutouts = {"corridor": (180, 9.5, 5)}
    cutouts |= {"top cut-out": (90, 5, 5), "bottom cut-out": (-90, 5, 5)}
    cutouts |= {"top diagonal cut-out": (45, 3, 2.5), "bottom diagonal cut-out": (-45, 3, 2.5)}
    for name, (angle, depth, width) in cutouts.items():
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        if x * cos + y * sin >= 10 - depth and abs(y * cos - x * sin) <= width / 2:
            return name
    return "cost region"


def bounds(measure):
    """Return the lowest and highest possible mean: EMCC is a share; costs and streaks are >= 0."""
    if measure == "J_R":
        return -math.inf, math.inf
    return 0.0, 1.0 if measure.startswith(("EMCC", "all")) else math.inf


def interval(measure, values, runs):
    """Return the printed form and both ends of the interval of a mean.

    It is Student's t interval where all runs end in one place, else the lowest and highest run.
    """
    if len({run["ends"].partition(" (")[0] for run in runs}) > 1:
        return "range {} to {}", min(values), max(values)
    half, (low, high) = T_OF_4 * stdev(values) / math.sqrt(len(values)), bounds(measure)
    return "[{}, {}]", max(fmean(values) - half, low), min(fmean(values) + half, high)


def is_mean(text, measure, values, runs):
    """Return whether a text like "1.23 [0.45, 6.78]" is the mean of `values` and its interval."""
    form, *ends = interval(measure, values, runs)
    pattern = re.escape(form).replace(r"\{\}", r"(\S+)")
    mean, low, high = re.fullmatch(rf"(\S+) {pattern}", text).groups()
    return near(mean, fmean(values)) and near(low, ends[0]) and near(high, ends[1])


def near(printed, value, digits=2):
    """Return whether a value was printed correctly to `digits`, up to float32's rounding."""
    return abs(float(printed) - value) <= 0.501 * 10**-digits


def tail(count, n, p):
    """Return P(at least `count` of n) for the binomial distribution."""
    return sum(math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(count, n + 1))


def clopper_pearson(count, n):
    """Return the 95 % Clopper-Pearson interval of a share, by bisection of both tails."""

    def solve(rises, aim):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if rises(middle) < aim else (low, middle)
        return low

    low = solve(lambda p: tail(count, n, p), 0.025) if count else 0.0
    high = solve(lambda p: tail(count + 1, n, p), 0.975) if count < n else 1.0
    return low, high


def share_words(count, n):
    low, high = clopper_pearson(count, n)
    return f"{count} of {n} [{low:.2f}, {high:.2f}]"
