"""Exported policies, read by other libraries, against the policies themselves."""

import json
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
import toy_family
from toys import register

import agents
from agents.algorithms import Algorithm
from agents.cli.main import main
from agents.export import export

pytest.importorskip("onnx")
pytest.importorskip("safetensors")
register()
SMALL = {"batch_size": 32, "hidden": (32, 32), "input_scale": 2.0}
OBSERVATIONS = np.random.default_rng(0).normal(0, 3, (1000, 2)).astype(np.float32)


NORMALIZED = {"normalize_observations": True, "input_scale": 1.0}


@pytest.fixture(scope="module", params=["sac-lb", "trpo-lag", "sac-lag", "ppo-lag"])
def folder(request, tmp_path_factory):
    """Runs on a task with actions in [-2, 2]; the last two algorithms normalise observations."""
    out = tmp_path_factory.mktemp("export") / "x"
    more = {"random_steps": 250} if request.param.startswith("sac") else {"evaluate_every": 100}
    more |= NORMALIZED if request.param in ("sac-lag", "ppo-lag") else {}
    more |= {"seeds": (0, 4), "steps": 300, "out": out}
    return agents.train(request.param, "Walk-v0", **(SMALL | more)).folder


def loaded(card, monkeypatch, folder):
    """Return the function `policy` that the code on the card defines."""
    if "onnxruntime" in card:
        pytest.importorskip("onnxruntime")
    code = re.search(r"```python\n(.*?)```", card, re.S)[1]
    names = {}
    with monkeypatch.context() as patch:
        patch.chdir(folder)
        exec(code, names)
    return names["policy"]


@pytest.mark.parametrize("format", ["safetensors", "onnx"])
def test_the_cards_code_gives_our_actions(folder, tmp_path, monkeypatch, format):
    paths = export(folder, format, tmp_path)
    assert [path.name for path in paths] == [f"seed-{k}.{format}" for k in (0, 4)] + ["README.md"]
    policy = loaded(paths[-1].read_text(), monkeypatch, tmp_path)
    found, ours = policy(OBSERVATIONS), agents.load_policy(folder, seed=0)(OBSERVATIONS)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, ours, rtol=0, atol=1e-6)
    assert np.abs(ours).max() > 0.1
    np.testing.assert_allclose(policy(OBSERVATIONS[:1]), ours[:1], rtol=0, atol=1e-6)
    again = export(folder, format, tmp_path / "again")
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in paths]


@pytest.mark.parametrize("format", ["safetensors", "onnx"])
def test_what_an_algorithm_adds_to_observations_is_an_input(tmp_path, monkeypatch, format):
    """A limit of the longest streak adds two numbers after the task's two, and the card says that
    they are not the task's."""
    more = {"seeds": 0, "steps": 300, "streak_limit": 3.0, "out": tmp_path / "x"}
    runs = agents.train("ppo-lag", "Walk-v0", **(SMALL | NORMALIZED | more))
    card = export(runs.folder, format, tmp_path)[-1].read_text()
    (row,) = [line for line in card.splitlines() if line.startswith("| observation |")]
    assert "[N, 4]" in row
    assert "followed by what `agents.load_policy(...).wrap(env)` adds" in row
    ours = agents.load_policy(runs.folder)
    env, policy = ours.wrap(gym.make("Walk-v0")), loaded(card, monkeypatch, tmp_path)
    observation, over, streak, longest = env.reset(seed=0)[0], False, 0, 0
    while not over:
        np.testing.assert_allclose(observation[2:], [streak / 20, longest / 20], rtol=1e-6)
        action = policy(observation[None])[0]
        np.testing.assert_allclose(action, ours(observation), rtol=0, atol=1e-6)
        observation, _, *ends, info = env.step(action)
        streak = streak + 1 if info["cost"] > 0 else 0
        longest, over = max(longest, streak), any(ends)
    assert longest > 0


def test_files_name_their_task_seed_and_step(folder, tmp_path):
    import onnx
    from safetensors import safe_open

    (path, _) = export(folder, "onnx", tmp_path, seeds=[4])
    about = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    (path, _) = export(folder, "safetensors", tmp_path, seeds=[4])
    with safe_open(path, "np") as file:
        assert json.loads(file.metadata()["about"]) == about
    taken = agents.resume(folder).records[folder, 4].total_steps
    assert (about["task"], about["seed"], about["step"]) == ("Walk-v0", "4", str(taken))


def test_a_policy_from_during_training_can_be_exported(tmp_path):
    more = {"seeds": 0, "steps": 800, "evaluate_every": 400}
    runs = agents.train("trpo-lag", "Walk-v0", out=tmp_path, **more, **SMALL)
    path, card = export(runs.folder, "safetensors", step=400)
    assert "| environment steps | 400; planned 800 |" in card.read_text()
    assert path.read_bytes() != export(runs.folder, "safetensors")[0].read_bytes()


def test_policies_of_several_tasks_have_folders_of_their_own(tmp_path):
    tasks = ("Circle2D-1-v0", "Circle2D-2-v0")
    runs = agents.train("trpo-lag", tasks, seeds=0, steps=100, out=tmp_path, **SMALL)
    files = [export(runs.folder, "safetensors", task=task)[0] for task in tasks]
    names = [file.relative_to(runs.folder).as_posix() for file in files]
    assert names == [f"exported/{task}/seed-0.safetensors" for task in tasks]


def test_the_command(folder, tmp_path, capsys):
    """It exports into the folder of runs; policies of the package need a folder for the files."""
    assert main(["export", str(folder), "--format", "safetensors", "--seeds", "4"]) == 0
    assert capsys.readouterr().out.split() == [
        str(folder / "exported" / name) for name in ("seed-4.safetensors", "README.md")
    ]
    named = ["export", "pretrained:trpo-lag/Circle2D-2-v0", "--format", "onnx"]
    assert main(named) == 2
    assert "is in the package: give a folder for the files, --out" in capsys.readouterr().err
    assert main([*named, "--out", str(tmp_path)]) == 0
    written = capsys.readouterr().out.split()
    assert written
    assert all(tmp_path in Path(path).parents for path in written)


class Normed(torch.nn.Module):
    """A linear layer whose input is scaled by a factor that is not part of any layer."""

    def __init__(self, weight, bias):
        super().__init__()
        self.layer = torch.nn.Linear(*weight.shape[::-1], bias=bias)
        zeros = {"bias": torch.zeros(len(weight))} if bias else {}
        self.layer.load_state_dict({"weight": torch.tensor(weight)} | zeros)
        self.factor = 1.0 if not bias else 0.5

    def forward(self, observation):
        return self.layer(self.factor * observation)


def normed(bias):
    class Family(toy_family.Linear):
        def policy(self):
            act, factor = super().policy(), self.module(0).factor
            return lambda observation, noise: act(factor * observation, noise)

        def module(self, run):
            return Normed(self.actor[run], bias)

    return Family


@pytest.mark.parametrize(("bias", "words"), [(True, "differently"), (False, "Linear with bias")])
def test_what_a_file_would_lack_is_refused(bias, words, tmp_path):
    """The module acts as the policy does, but its layers alone do not, or a layer has no bias."""
    rule = Algorithm("Toy", toy_family.Numbers, toy_family.Rule(), normed(bias))
    with toy_family.known(algorithm=rule):
        folder = agents.train("toy", "Walk-v0", seeds=0, steps=50, out=tmp_path / "x").folder
        assert agents.load_policy(folder).to_torch()
        with pytest.raises(agents.UserError, match=words):
            export(folder, "safetensors", tmp_path / "y")
    assert not (tmp_path / "y").exists()
