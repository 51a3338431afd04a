"""Values that no training can take: told with their bound before anything is written."""

import re

import pytest

from agents.cli.main import main
from agents.training import memory

TRAIN = ["train", "--steps", "150", "--seeds", "0", "--backend", "eager"]


@pytest.mark.parametrize(
    ("algorithm", "option", "value", "message"),
    [
        ("wcsac", "initial-multiplier", "1e308", "initial_multiplier must be .*at most 1e.06"),
        ("wcsac", "damping", "1e308", "damping must be .*at most 1e.06"),
        ("trpo-lag", "multiplier-lr", "1e308", "multiplier_lr must be .*at most 1e.06"),
        ("cpo", "cost-limit", "1e308", "cost_limit must be .*at most 1e.09"),
        ("sac-lag", "learning-rate", "1" + "0" * 400, "learning_rate must be a finite number"),
        ("sac-lag", "hidden", "9223372036854775808", "hidden .* needs about [0-9.,]+ GB of memory"),
        ("sac-lag", "hidden", "4294967296", r"hidden \(4294967296,\) needs about 3,09\d\.\d GB"),
        (
            "sac-lag",
            "replay-size",
            "4294967296",
            "replay_size .* needs about 154.6 GB .* for 1 run",
        ),
        ("sac-lag", "gradient-steps", "1000000000", "gradient_steps must be at most 100000"),
        ("ppo", "batch-size", "1073741824", "batch_size 1073741824 needs about"),
        ("cpo", "episodes", "1000000000", "episodes must be at most 10000"),
        ("sac-lag", "device", "cuda", "sees no GPU"),
        ("sac-lag", "backend", "compiled", "TORCH_COMPILE_DISABLE"),
        ("-inf", "seeds", "0", "algorithm"),
        ("sac-lag", "seeds", "٣", "seeds"),
        ("sac-lag", "step-timeout", "0", "step_timeout must be above 0"),
        ("sac-lag", "task", "\x1b[31mred", r"\\x1b\[31mred"),
    ],
)
def test_a_bound_is_told(algorithm, option, value, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(memory, "machine_memory", lambda: 64 * 10**9)
    out = tmp_path / "x"
    options = ["--algorithm", algorithm, f"--{option}", value, "--out", str(out)]
    options += ["--steps", "5000"]  # enough for a table of any algorithm
    assert main([*TRAIN, *options]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "\x1b" not in err
    assert re.search(message, err), err
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--workers", "9223372036854775807"], r"workers must be in \[1, 1024\]"),
        (["--device", "cuda"], "sees no GPU"),
    ],
)
def test_of_reproduce(options, message, tmp_path, capsys):
    out = tmp_path / "x"
    assert main(["reproduce", "--quick", "--out", str(out), *options]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not out.exists()


def test_evaluated_episodes(tmp_path, capsys):
    assert main([*TRAIN, "--algorithm", "sac-lag", "--out", str(tmp_path / "x")]) == 0
    assert main(["evaluate", str(tmp_path / "x"), "--episodes", "1e12"]) == 2
    assert "episodes must be at most 1000000" in capsys.readouterr().err
