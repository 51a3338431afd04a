"""SAC-LB-Streak: SAC-LB whose learned cost grows along a streak of cost steps.

SAC-LB as in the paper's grid mostly stays in the local optima of levels 2 and 3 (12 of 20 runs),
and its EMCC falls late. The streak cost makes EMCC an objective: a long violation costs more than
many short ones, and the critics see how long the current one has lasted. The other changes are for
exploration. A bonus for states that a run has seldom seen (see `agents.sac.replay`) leads the
policy along the rim of the region, where the reward is flat, while the barrier keeps the policy out
of the region. Brown random actions show the critics the region's far side, and a quarter of each
batch is drawn from them throughout (as from prior data in RLPD, Ball et al. 2023). The reward
critics bootstrap at the time limit: the observation does not contain the time, and with a terminal
limit it would pay to wait where episodes end (Pardo et al. 2018). The cost critics do not bootstrap
there, since the cost limit is that of an episode. The networks learn faster, and the temperature
falls more slowly, so that the critics know the way before the policy's entropy is low. On Circle2D
the preset scales positions back to units of length. Source of the barrier: Zhang et al. 2024 (see
`sac_lb`). `results/solve/README.md` has the trials and an ablation of each part: not every part
proves to be needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from agents.algorithms import Algorithm
from agents.algorithms.sac_lb import RULE, SACLBConfig
from agents.checks import In
from agents.sac import OffPolicy
from agents.sac.update import TimeLimit


@dataclass(frozen=True)
class SACLBStreakConfig(SACLBConfig):
    """Hyper-parameters of SAC-LB-Streak: those of SAC-LB, nine of them with other defaults."""

    learning_rate: Annotated[float, In(above=0, high=1)] = 1e-3
    """Adam's step size for actor and critics. The paper's SAC-LB: 3e-4."""
    temperature_lr: Annotated[float, In(0, 1)] = 1.5e-4
    """Adam's step size for the temperature, which falls as the policy becomes less random; with 0
    it stays. The paper's SAC-LB: 3e-4."""
    batch_size: Annotated[int, In(1)] = 128
    """Transitions per gradient step, at most `replay_size`. The paper's SAC-LB: 256."""
    gradient_steps: Annotated[int, In(1, 100_000)] = 10
    """Gradient steps per epoch, which is one episode. The paper's SAC-LB: 5."""
    random_exponent: Annotated[float, In(0, 4)] = 2.0
    """Exponent β of the random actions' power spectrum 1/f^β: 2 is brown noise, which keeps a
    direction for many steps. The paper's SAC-LB: 0."""
    time_limit: TimeLimit = "terminal_cost"
    """Whether to bootstrap at the time limit: bootstrap (reward and cost), terminal (neither), or
    terminal_cost (reward only). Not specified in the paper; the preset of SAC-LB on Circle2D has
    terminal."""
    random_share: Annotated[float, In(0, 1)] = 0.25
    """Share of each batch, in [0, 1], that is drawn from the random actions at the start; above 0
    the replay buffer keeps these to the end. The paper's SAC-LB: 0."""
    novelty_bonus: Annotated[float, In(0, 1e6)] = 1.0
    """Bonus, in units of reward, that the learned reward gets for states that are new to the run:
    about `novelty_bonus / √(1 + n)` after n visits. Records keep the plain reward. The paper's
    SAC-LB: 0."""
    streak_weight: Annotated[float, In(0, 1e6)] = 0.25
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the cost of the k-th
    consecutive cost step is multiplied by `1 + β (k - 1)`, and the critics see k. Records keep the
    plain cost. Must be 0 with a `streak_limit`, which limits the longest streak without a weight.
    The paper's SAC-LB: 0."""


ALGORITHM = Algorithm("SAC-LB-Streak", SACLBStreakConfig, RULE, OffPolicy)
