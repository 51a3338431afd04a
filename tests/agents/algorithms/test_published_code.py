"""One update of each algorithm against public code, from equal weights and an equal batch.

The expected numbers were computed by OmniSafe 0.5 (its classes' own updates, with stubs of buffer
and logger), for C-TRPO by the part "update policy" of the authors' script, and for CAL by the
authors' agent, with silu in all networks. The batch has 96 rows i with observations
`sin(.9 i + 2.1 j)`, action `.8 sin(1.3 i + .5)`, and advantages `cos .7 i` of the reward and
`½ sin(1.1 i + 1)` of the cost. Parameters are counted over the layers, in each the weight [in, out]
before the bias; the k-th is `.15 sin(1.7 k + .3)`; log σ is -½. First-order algorithms make three
passes of one minibatch at 3e-3, with gradient norms of at most 40. Where public code differs:

- OmniSafe's FOCOPS divides the advantage by 1 + ν, the authors' code does not: its advantage was
  replaced. OmniSafe's P3O does not clip the cost and weights the excess by 1 instead of 1 - γ; that
  has no effect in the first step, where every ratio is 1. Its IPO uses the undiscounted J_C.
- CPPO-PID: OmniSafe's settings were changed to no smoothing of the proportional term (default 0.95)
  and a derivative over one epoch (default ten).
- PCPO as published uses `H x`, about g, in place of the reward's step `x = H⁻¹ g`; that was
  corrected. It also leaves out the episode's length, here 1, and has no line search of the
  objective.
- C-TRPO has 1 / (1 - γ) in place of the episode's length: both are 100 here.
- OmniSafe's conjugate gradients add ε = 1e-6 to divisors, which is the size of the residuals here
  and changes the step by 0.4 %: it was set to 1e-12.
- OmniSafe's KL divergences are means over the action's components, of which there is one here.
- OmniSafe's SAC-PID has one cost critic, and its loss is divided by 1 + λ.
"""

import numpy as np
import pytest
import torch

from agents.algorithms import algorithm, learner
from agents.lockstep import lagrange
from agents.lockstep.nets import adam
from agents.on_policy.epoch import BLOCK, EpochData
from agents.sac import update as sac
from agents.sac.replay import Batch

ROWS = 96
i = np.arange(ROWS)
OBSERVATION = np.sin(0.9 * i[:, None] + 2.1 * np.arange(3)).astype(np.float32)
ACTION = (0.8 * np.sin(1.3 * i + 0.5))[:, None].astype(np.float32)
COST = np.sin(1.1 * i + 1)


def filled(net, scale=0.15, shift=0.3):
    """Return the parameters [size] of a network by the formula."""
    params, count = np.zeros(net.size, np.float32), 0
    for layer in net.layers(params[None]):
        layer[0] = scale * np.sin(1.7 * (count + np.arange(layer.size)) + shift).reshape(
            layer.shape[1:]
        )
        count += layer.size
    return params


def packed(values):
    """Return the rows as [1, BLOCK, ...], 0 beyond the batch."""
    values = np.asarray(values, np.float32)
    rest = np.zeros((BLOCK - ROWS, *values.shape[1:]), np.float32)
    return torch.from_numpy(np.concatenate([values, rest])[None])


def improved(name, cost, length=1.0, before=0.0, **changes):
    """Return the mean actions at the first four observations, and log σ, after an update."""
    config = algorithm(name).config(hidden=(32,), cost_limit=25.0, **changes)
    it = learner(name, config, [0], 3, 1)
    net, actor = it.nets.actor.net, it._state.actor
    actor[0, : net.size] = torch.from_numpy(filled(net))
    actor[0, net.size] = -0.5
    epoch = EpochData(
        observation=packed(OBSERVATION),
        action=packed(ACTION),
        weight=packed(np.full(ROWS, 1 / ROWS)),
        reward_advantage=packed(np.cos(0.7 * i)),
        cost_advantage=packed(0.5 * COST)[:, None],
        value_targets=torch.zeros(1, 2, BLOCK),
        length=torch.full((1,), length),
        cost=torch.full((1, 1), cost, dtype=torch.float64),
        discounted_cost=torch.full((1, 1), cost, dtype=torch.float64),
    )
    states = [state._replace(parameter=state.parameter + np.float32(before)) if before else state
              for state in it._state.multipliers]  # fmt: skip
    it._state = it._followed(it._state._replace(multipliers=tuple(states)), epoch, ahead=True)
    state, _ = it.improve(epoch, np.array([ROWS]), [np.random.default_rng(0)])
    mean = net.forward(state.actor[:, : net.size], packed(OBSERVATION))[0, :4, 0]
    return [*mean.tolist(), state.actor[0, net.size].item()]


ADAM = {"initial_multiplier": 0.001, "multiplier_lr": 0.035, "multiplier_optimizer": "adam"}
FIRST = {"batch_size": ROWS, "learning_rate": 3e-3, "actor_iterations": 3, "kl_stop": 0.0}
FIRST |= {"max_gradient_norm": 40.0}
PUBLISHED = [
    ("focops", {**ADAM, **FIRST}, 30.0,
     (0.3581663, -0.0684984, -0.4845779, -0.5842893, -0.4915339)),
    ("cup", {**ADAM, **FIRST}, 30.0, (0.3315293, -0.0822877, -0.4723939, -0.5517604, -0.4970316)),
    ("p3o", {**FIRST, "actor_iterations": 1}, 30.0,
     (0.3561153, -0.0923575, -0.5235521, -0.6215534, -0.503)),
    ("p3o", {**FIRST, "actor_iterations": 1}, 20.0,
     (0.3626752, -0.0403598, -0.440667, -0.5437593, -0.497)),
    ("ipo", FIRST, 20.0, (0.3395886, -0.0565579, -0.4369548, -0.5215227, -0.4949872)),
    ("ipo", FIRST, 30.0, (0.331035, -0.1001366, -0.4887174, -0.5499377, -0.4950948)),
    ("cppo-pid", FIRST, 30.0, (0.3346745, -0.0911737, -0.4781113, -0.5424049, -0.4948902)),
    ("crpo", {}, 25.4, (0.3156454, -0.0703549, -0.4266804, -0.4910911, -0.4370153)),
    ("crpo", {}, 25.6, (0.3498359, -0.1294458, -0.5741501, -0.6616752, -0.5381987)),
    ("rcpo", {}, 30.0, (0.3148736, -0.071585, -0.4277052, -0.4914379, -0.4371412)),
    ("pcpo", {}, 24.99, (0.3156454, -0.0703549, -0.4266804, -0.4910911, -0.4370153)),
    ("pcpo", {}, 25.0, (0.2955131, -0.1278466, -0.4965993, -0.5419163, -0.4648191)),
    ("pcpo", {}, 25.03, (0.3415881, -0.1493559, -0.5961446, -0.6757193, -0.5448562)),
    ("c-trpo", {}, 20.0, (0.3123212, -0.0769652, -0.4333406, -0.4947679, -0.4388679)),
    ("c-trpo", {}, 24.9, (0.2840569, -0.1325878, -0.4887859, -0.5247996, -0.4535052)),
    ("c-trpo", {}, 26.0, (0.3498359, -0.1294458, -0.5741501, -0.6616752, -0.5381987)),
    ("c-trpo", {"before": 1.0}, 21.0, (0.3498359, -0.1294458, -0.5741501, -0.6616752, -0.5381987)),
    ("c-trpo", {"before": 1.0}, 19.0, (0.3128338, -0.0759468, -0.4323155, -0.494203, -0.438584)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "changes", "cost", "published"), PUBLISHED)
def test_on_policy_updates(name, changes, cost, published):
    length = 100.0 if name == "c-trpo" else 1.0
    assert improved(name, cost, length, **changes) == pytest.approx(published, abs=3e-5)


def test_multipliers_of_the_pid_controller():
    """OmniSafe's multipliers after costs of 30, 10, 40 and 26, from 0.001."""
    config, rule = algorithm("cppo-pid").config(), algorithm("cppo-pid").rule
    states, found = lagrange.initial(rule.multipliers, config, 1), []
    for cost in (30.0, 10.0, 40.0, 26.0):
        states = lagrange.follow(rule.multipliers, config, states, np.array([[cost]]))
        found.append(lagrange.values(rule.multipliers, states, 1).item())
    assert found == pytest.approx([0.566, 0.0, 1.6690375, 0.2710856], abs=1e-6)


def off_policy(name, shifts, cost_bias=0.0, **changes):
    """Return nets, config and initial state: actor and critics by the formula, with .3 for .15.

    shifts: of the actor, and of each critic, in place of the formula's .3 in the sine.
    """
    config = algorithm(name).config(
        hidden=(32, 32), learning_rate=3e-3, temperature_lr=3e-3, batch_size=ROWS, **changes
    )
    nets = sac.make_nets(config, 3, 1, 1)
    state = sac.initial_state(nets, config, algorithm(name).rule, [0])
    actor, *critics = shifts
    critics = np.stack([filled(nets.critic, 0.3, shift) for shift in critics])
    for critic in critics[2:]:
        nets.critic.layers(critic[None])[-1][...] += cost_bias
    critics, actor = critics[None], filled(nets.actor, 0.3, actor)[None]
    return nets, config, state._replace(actor=actor, critics=critics, targets=critics.copy())


def said(net, params, seen):
    """Return the outputs of networks with params [N, size] for inputs seen [B, in]."""
    seen = torch.from_numpy(np.repeat(seen[None], len(params), axis=0))
    return net.forward(torch.from_numpy(params), seen)


def noise(rate, shift):
    """Return made-up noise, [1, ROWS, 1]."""
    return (1.2 * np.sin(rate * i + shift))[None, :, None].astype(np.float32)


BATCH = Batch(
    observation=OBSERVATION[None],
    action=np.tanh(ACTION)[None],
    reward=np.cos(0.7 * i).astype(np.float32)[None],
    cost=(COST > 0).astype(np.float32)[None, None],
    next_observation=np.sin(0.9 * (i[:, None] + 1) + 2.1 * np.arange(3)).astype(np.float32)[None],
    terminal=(i % 10 == 9).astype(np.float32)[None],
    cost_terminal=(i % 10 == 9).astype(np.float32)[None],
)


@pytest.mark.parametrize(
    ("limit", "actor", "cost_critics", "log_multiplier"),
    [
        (0.5, (-0.121064, -0.06552, -0.054277, -0.061411, -0.057209, -0.039731),
         (0.562154, 0.639835, 0.732955, 0.832857), -0.3732),
        (0.6, (-0.116927, -0.061953, -0.05285, -0.061021, -0.056114, -0.038185),
         (0.562159, 0.63984, 0.732962, 0.832864), -0.3750924),
    ],
)  # fmt: skip
def test_updates_of_cal(limit, actor, cost_critics, log_multiplier):
    """After three gradient steps: means and log σ at three observations, and the ensemble of cost
    critics at one; without and with a rectified multiplier."""
    shifts = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2)
    changes = {"cost_limit": limit, "multiplier_lr": 3e-3, "activation": "silu"}
    nets, config, state = off_policy("cal", shifts, cost_bias=1.0, **changes)
    for step in range(3):
        drawn = sac.UpdateNoise(noise(2.3, step), noise(2.9, step + 1))
        state, _ = sac.update(nets, config, algorithm("cal").rule, state, BATCH, drawn)
    outputs = said(nets.actor, state.actor, OBSERVATION)[0, :3]
    assert outputs.T.flatten().tolist() == pytest.approx(actor, abs=2e-5)
    seen = np.concatenate([OBSERVATION, np.tanh(ACTION)], axis=-1)
    q = said(nets.critic, state.critics[0], seen)[:, 0, 0]
    assert q[2:].tolist() == pytest.approx(cost_critics, abs=1e-5)
    assert state.multipliers[0].parameter[0, 0].item() == pytest.approx(log_multiplier, abs=1e-5)
    assert state.log_temperature[0, 0].item() == pytest.approx(-0.0090014, abs=1e-6)


def test_the_actors_step_of_sac_pid():
    """Its loss, and after the step means and log σ at three observations, at λ = 0.566."""
    nets, config, state = off_policy("sac-pid", (0.1, 0.2, 0.4, 0.6, 0.6))
    what = (state, BATCH.observation, noise(2.9, 1), np.float32([[0.566]]))
    gradient, value, *_ = sac.actor_gradient(nets, config, algorithm("sac-pid").rule, *what)
    assert value.item() == pytest.approx(0.087554953, abs=1e-6)
    moved, _ = adam(state.actor, gradient, state.actor_moments, config.learning_rate)
    outputs = said(nets.actor, moved, OBSERVATION)[0, :3].flatten().tolist()
    published = (-0.160674, -0.086085, -0.058724, -0.064032, -0.014553, -0.017238)
    assert outputs == pytest.approx(published, abs=2e-5)
