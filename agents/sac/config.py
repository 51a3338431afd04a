"""Hyper-parameters that the algorithms of the SAC family share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from agents.errors import UserError, check, check_choice, check_integers, check_scale
from agents.lockstep.nets import check_lanes

TimeLimit = Literal["bootstrap", "terminal", "terminal_cost"]


@dataclass(frozen=True)
class SACConfig:
    """Hyper-parameters of the SAC family.

    The defaults are the paper's (table HP_Circle2D) but for the time limit; presets set it for
    Circle2D.
    """

    discount: float = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    learning_rate: float = 3e-4
    """Adam's step size for actor and critics. Paper: 3e-4."""
    temperature_lr: float = 3e-4
    """Adam's step size for the temperature, which falls from 1 as the policy gets surer. Paper:
    3e-4, as for the networks."""
    batch_size: int = 256
    """Transitions a gradient step; a multiple of 32, at most the replay's size. Paper: 256."""
    gradient_steps: int = 5
    """Gradient steps an epoch, which is one episode. Paper: 5."""
    random_steps: int = 5_000
    """Environment steps at the start that take uniformly random actions. Paper: 5000 on Circle2D,
    50000 on Safety-Gymnasium."""
    random_exponent: float = 0.0
    """Exponent β of the random actions' power spectrum 1/f^β: 0 white, 1 pink, 2 brown noise, which
    keeps a direction for many steps. Each action is uniform by itself. Paper: white, as usual."""
    replay_size: int = 50_000
    """Transitions the replay of a run holds. Paper: 50000 on Circle2D, 500000 on
    Safety-Gymnasium."""
    hidden: tuple[int, ...] = (64, 64)
    """Sizes of the hidden layers of actor and critics (tanh); multiples of 32. Paper: 64, 64."""
    input_scale: float | tuple[float, ...] = 1.0
    """Factor on observations before the networks, or one for each number of an observation. Small
    tanh networks are smooth: observations in [-1, 1] whose details matter want a larger one. Not in
    the paper; 1 leaves them as they are."""
    target_rate: float = 0.005
    """Share τ by which the target critics follow. Not printed in the paper; 0.005 as in Haarnoja et
    al."""
    time_limit: TimeLimit = "bootstrap"
    """Whether to bootstrap at the time limit: bootstrap (reward and cost), terminal (neither), or
    terminal_cost (reward only). Not printed in the paper; the presets of Circle2D have
    terminal."""
    random_share: float = 0.0
    """Share of each batch that is drawn from the random actions at the start, in [0, 1]; above 0
    the replay keeps these to the end. Not in the paper; 0: none."""
    novelty_bonus: float = 0.0
    """Bonus, in units of reward, on the learned reward for reaching states that are new to the run:
    about `novelty_bonus / √(1 + n)` after n visits. Records keep the plain reward. Not in the
    paper; 0: none."""
    novelty_length: float = 2.0
    """Distance over which states count as the same place for the bonus, in the units of the
    networks' inputs: observations times `input_scale`. Not in the paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        check_integers(self, "gradient_steps", low=1, high=100_000)
        check_integers(self, "replay_size", low=1)
        check_integers(self, "batch_size", low=1, high=self.replay_size)
        check_integers(self, "random_steps", low=0)
        check(self, "discount", "target_rate", low=0, high=1)
        check(self, "learning_rate", "temperature_lr", above=0, high=1)
        check(self, "random_exponent", low=0, high=4)
        check(self, "random_share", low=0, high=1)
        check(self, "novelty_length", low=1e-6, high=1e6)
        check(self, "novelty_bonus", low=0, high=1e6)
        check_scale(self)
        check_lanes(self)
        check_choice(self, "time_limit", *get_args(TimeLimit))
        if self.random_share and not 0 < self.random_steps < self.replay_size:
            raise UserError(
                "random_share needs random_steps of at least 1 and below replay_size "
                f"{self.replay_size}, got {self.random_steps}"
            )


@dataclass(frozen=True)
class ConstrainedSACConfig(SACConfig):
    """Hyper-parameters of the SAC family's algorithms that limit a cost.

    The default is that of the paper's other tasks; presets set it for Circle2D.
    """

    limited_cost = "discounted cost return Q_c"  # in words, for tables
    cost_limit: float = 25.0
    """Limit d of the discounted cost return Q_c that the cost critics estimate, with the discount γ
    of the rewards; not of an episode's cost. Paper: 5 on Circle2D, 25 on Safety-Gymnasium."""
    streak_weight: float = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the k-th consecutive cost
    step costs `1 + β (k - 1)` times, and the critics see k. Records keep the plain cost. Not in the
    paper; 0: none."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check(self, "cost_limit", low=0, high=1e9)
        check(self, "streak_weight", low=0, high=1e6)
