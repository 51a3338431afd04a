"""Hyper-parameters that the algorithms of the SAC family share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from agents.checks import In, Settings
from agents.errors import UserError
from agents.lockstep.nets import Activation, check_batch

TimeLimit = Literal["bootstrap", "terminal", "terminal_cost"]


@dataclass(frozen=True)
class SACConfig(Settings):
    """Hyper-parameters of the SAC family.

    The defaults are the paper's (table HP_Circle2D) but for the time limit; presets set it for
    Circle2D.
    """

    cost_critics = 2  # of each cost; an algorithm with an ensemble makes it a hyper-parameter

    discount: Annotated[float, In(0, 1)] = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    learning_rate: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size for actor and critics. Paper: 3e-4."""
    temperature_lr: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size for the temperature, which falls from 1 as the policy gets surer. Paper:
    3e-4, as for the networks."""
    batch_size: Annotated[int, In(1)] = 256
    """Transitions a gradient step; a multiple of 32, at most the replay's size. Paper: 256."""
    gradient_steps: Annotated[int, In(1, 100_000)] = 5
    """Gradient steps an epoch, which is one episode. Paper: 5."""
    random_steps: Annotated[int, In(0)] = 5_000
    """Environment steps at the start that take uniformly random actions. Paper: 5000 on Circle2D,
    50000 on Safety-Gymnasium."""
    random_exponent: Annotated[float, In(0, 4)] = 0.0
    """Exponent β of the random actions' power spectrum 1/f^β: 0 white, 1 pink, 2 brown noise, which
    keeps a direction for many steps. Each action is uniform by itself. Paper: white, as usual."""
    replay_size: Annotated[int, In(1)] = 50_000
    """Transitions the replay of a run holds. Paper: 50000 on Circle2D, 500000 on
    Safety-Gymnasium."""
    hidden: Annotated[tuple[int, ...], In(1, 65_536)] = (64, 64)
    """Sizes of the hidden layers of actor and critics. Paper: 64, 64."""
    activation: Activation = "tanh"
    """Function between the layers. Not printed in the paper; tanh."""
    input_scale: Annotated[float | tuple[float, ...], In(1e-6, 1e6)] = 1.0
    """Factor on observations before the networks, or one for each number of an observation. Small
    tanh networks are smooth: observations in [-1, 1] whose details matter want a larger one. Not in
    the paper; 1 leaves them as they are."""
    target_rate: Annotated[float, In(0, 1)] = 0.005
    """Share τ by which the target critics follow. Not printed in the paper; 0.005 as in Haarnoja et
    al."""
    time_limit: TimeLimit = "bootstrap"
    """Whether to bootstrap at the time limit: bootstrap (reward and cost), terminal (neither), or
    terminal_cost (reward only). Not printed in the paper; the presets of Circle2D have
    terminal."""
    reward_scale: Literal["none", "running"] = "none"
    """Scale of the learned reward: none, or running: over the standard deviation of the discounted
    return so far, cut at ±10. Records keep the plain reward. Not in the paper; none."""
    random_share: Annotated[float, In(0, 1)] = 0.0
    """Share of each batch that is drawn from the random actions at the start, in [0, 1]; above 0
    the replay keeps these to the end. Not in the paper; 0: none."""
    novelty_bonus: Annotated[float, In(0, 1e6)] = 0.0
    """Bonus, in units of reward, on the learned reward for reaching states that are new to the run:
    about `novelty_bonus / √(1 + n)` after n visits. Records keep the plain reward. Not in the
    paper; 0: none."""
    novelty_length: Annotated[float, In(1e-6, 1e6)] = 2.0
    """Distance over which states count as the same place for the bonus, in the units of the
    networks' inputs: observations times `input_scale`. Not in the paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check_batch(self.batch_size)
        if self.batch_size > self.replay_size:
            raise UserError(
                f"batch_size must be at most replay_size, {self.replay_size}, got {self.batch_size}"
            )
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
    cost_limit: Annotated[float, In(0, 1e9)] = 25.0
    """Limit d of the discounted cost return Q_c that the cost critics estimate, with the discount γ
    of the rewards; not of an episode's cost. Paper: 5 on Circle2D, 25 on Safety-Gymnasium."""
    streak_weight: Annotated[float, In(0, 1e6)] = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the k-th consecutive cost
    step costs `1 + β (k - 1)` times, and the critics see k. Records keep the plain cost. Not in the
    paper; 0: none."""
