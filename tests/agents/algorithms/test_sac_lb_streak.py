"""SAC-LB-Streak, beside SAC-LB."""

import dataclasses

from agents.algorithms import algorithm
from agents.paper.presets import preset


def test_it_is_sac_lb_but_for_some_values():
    """One set of hyper-parameters for all levels and both modes, whose inputs are in units of
    length."""
    tasks = [f"Circle2D-{level}-v0" for level in range(4)] + ["Circle2DMuJoCo-0-v0"]
    changes = {"random_exponent": 2.0, "streak_weight": 0.25, "input_scale": 15.0}
    changes |= {"learning_rate": 1e-3, "temperature_lr": 1.5e-4}
    changes |= {"batch_size": 128, "gradient_steps": 10}
    changes |= {"time_limit": "terminal_cost", "random_share": 0.25}
    changes |= {"novelty_bonus": 1.0}
    for task in tasks:
        if "MuJoCo" in task:  # the velocity, in multiples of .11 R = 1.1 a step
            changes = changes | {"input_scale": (15.0, 15.0, 1.1, 1.1)}
        found = dataclasses.asdict(preset("sac-lb-streak", task))
        assert found == dataclasses.asdict(preset("sac-lb", task)) | changes
    assert algorithm("sac-lb-streak").rule is algorithm("sac-lb").rule


def test_on_other_tasks_observations_stay_as_they_are():
    for task in ("CartPole-v1", "circle2d_mj/SafetyPointGoal1-v0"):
        assert preset("sac-lb-streak", task).input_scale == 1.0
