"""A report's numbers, from the steps of episodes.

Knows the paper's definitions and no code of the package: lists, loops and fractions instead of its
arrays.
"""

import math
import re
from collections import Counter
from statistics import fmean, stdev

TIME_LIMIT = 50  # kept by gymnasium's wrapper, above what is written down
T_OF_4 = 2.7764451  # Student's t of 4 degrees of freedom, of five runs, 97.5 %


class Episode:
    """From a reset to the first step that ends it; what an environment gives later is nobody's."""

    def __init__(self):
        self.rewards, self.costs, self.last, self.over = [], [], None, False

    def add(self, observation, reward, terminated, truncated, info):
        if not self.over:
            self.rewards.append(float(reward))
            self.costs.append(float(info["cost"]))
            self.last = [float(x) for x in observation]
            self.over = terminated or truncated or len(self.costs) == TIME_LIMIT


def of_training(epochs, in_all):
    """Epochs count until the steps in all are reached."""
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
    """The mean of exactly the highest of so many equal parts of the values: of every value as many
    copies, of which as many count as there are values."""
    copies = sorted(value for value in values for _ in range(parts))
    return fmean(copies[-len(values) :])


def streaks(costs):
    """Lengths of all chains of cost steps in an episode."""
    return [len(chain) for chain in "".join("x" if c > 0 else " " for c in costs).split()]


def highest(values, alpha):
    """The mean of the values at or above the smallest x with P(value <= x) >= 1 - alpha."""
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
    """On level 3: a disc of radius 10; cut-outs by direction, depth and width."""
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
    """Between which a mean can be: EMCC is a share, costs and streaks are not below 0."""
    if measure == "J_R":
        return -math.inf, math.inf
    return 0.0, 1.0 if measure.startswith(("EMCC", "all")) else math.inf


def interval(measure, values, runs):
    """Student's t interval where all runs end in one place; otherwise the lowest and highest."""
    if len({run["ends"].partition(" (")[0] for run in runs}) > 1:
        return "range {} to {}", min(values), max(values)
    half, (low, high) = T_OF_4 * stdev(values) / math.sqrt(len(values)), bounds(measure)
    return "[{}, {}]", max(fmean(values) - half, low), min(fmean(values) + half, high)


def is_mean(text, measure, values, runs):
    """Whether "1.23 [0.45, 6.78]" is the mean of some values of runs with its interval."""
    form, *ends = interval(measure, values, runs)
    pattern = re.escape(form).replace(r"\{\}", r"(\S+)")
    mean, low, high = re.fullmatch(rf"(\S+) {pattern}", text).groups()
    return near(mean, fmean(values)) and near(low, ends[0]) and near(high, ends[1])


def near(printed, value, digits=2):
    """So many digits are printed, of sums that float32 may have rounded."""
    return abs(float(printed) - value) <= 0.501 * 10**-digits


def tail(count, n, p):
    """P(at least so many of n)."""
    return sum(math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(count, n + 1))


def clopper_pearson(count, n):
    """The shares of which so many of n, or more, and or fewer, are seen in 2.5 % of cases."""

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
