"""Sweeps over hyper-parameters, on either engine."""

import pytest
import torch

import agents
from agents.sweeps import sweep_configs


def test_every_combination_has_a_name():
    found = sweep_configs({"cost_limit": (1.0, 5.0), "hidden": ((8, 8), (16,))})
    assert list(found) == [
        "cost_limit=1.0,hidden=8x8",
        "cost_limit=1.0,hidden=16",
        "cost_limit=5.0,hidden=8x8",
        "cost_limit=5.0,hidden=16",
    ]
    assert found["cost_limit=5.0,hidden=16"] == {"cost_limit": 5.0, "hidden": (16,)}


BAD = {
    "no values": ({"cost_limit": ()}, r"grid needs several values of cost_limit, got \(\)"),
    "one value": ({"cost_limit": 3.0}, "grid needs several values of cost_limit, got 3.0"),
    "twice": ({"cost_limit": (1.0, 1.0)}, "grid has cost_limit=1.0 twice"),
    "nothing": ({}, "grid is empty"),
    "unknown": ({"cost_limits": (1.0, 2.0)}, r"did you mean 'cost_limit'\?"),
}


@pytest.mark.parametrize(("grid", "message"), BAD.values(), ids=BAD)
def test_mistakes_are_named(tmp_path, grid, message):
    with pytest.raises(agents.UserError, match=message):
        agents.sweep("cpo", grid=grid, steps=1000, out=tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_an_unknown_engine(tmp_path):
    with pytest.raises(agents.UserError, match="engine must be local or ray, got 'cloud'"):
        agents.train("cpo", steps=1000, out=tmp_path / "x", engine="cloud")
    with pytest.raises(agents.UserError, match="on_epoch and progress are of the engine local"):
        agents.train("cpo", steps=1000, out=tmp_path / "x", engine="ray", on_epoch=print)
    assert not (tmp_path / "x").exists()


def test_a_machine_that_cannot_is_found_out_first(tmp_path):
    """The tests switch compiling off."""
    without_gpu = () if torch.cuda.is_available() else ({"device": "cuda"},)
    for options in ({"backend": "compiled"}, *without_gpu):
        with pytest.raises(agents.UserError, match=r"TORCH_COMPILE_DISABLE|'cuda': .* sees no GPU"):
            agents.sweep("cpo", grid={"cost_limit": (1.0,)}, out=tmp_path / "x", **options)
    assert not (tmp_path / "x").exists()


def test_another_algorithm_in_the_folder_of_a_sweep(tmp_path):
    """Settings that only one of the two has are named."""
    agents.sweep("cpo", grid={"cost_limit": (1.0,)}, steps=100, episodes=1, seeds=0, out=tmp_path)
    message = r"other settings: .*algorithm cpo \(now sac-lb\).*episodes 1 \(now absent\)"
    with pytest.raises(agents.UserError, match=message) as raised:
        agents.sweep("sac-lb", grid={"cost_limit": (1.0,)}, steps=100, seeds=0, out=tmp_path)
    assert "replay_size absent (now 50000)" in str(raised.value)


@pytest.mark.slow
def test_a_sweep_is_its_trainings(tmp_path):
    options = {"seeds": (0, 1), "steps": 1500, "backend": "eager"}
    runs = agents.sweep("trpo-lag", grid={"cost_limit": (1.0, 9.0)}, out=tmp_path / "s", **options)
    assert [folder.name for folder in runs.folders] == ["cost_limit=1.0", "cost_limit=9.0"]
    alone = agents.train("trpo-lag", cost_limit=9.0, out=tmp_path / "alone", **options)
    for seed in (0, 1):
        for name in ("episodes.csv", "updates.csv", "evaluation.json"):
            a, b = (of / f"seed-{seed}" / name for of in (runs.folders[1], alone.folder))
            assert a.read_bytes() == b.read_bytes()
    table = agents.report(tmp_path / "s")
    assert "cost_limit 1.0" in table
    assert "cost_limit 9.0" in table
    before = (runs.folders[0] / "checkpoint.npz").stat().st_mtime_ns
    agents.sweep("trpo-lag", grid={"cost_limit": (1.0, 9.0)}, out=tmp_path / "s", **options)
    assert (runs.folders[0] / "checkpoint.npz").stat().st_mtime_ns == before


@pytest.mark.slow
def test_training_on_ray(tmp_path):
    pytest.importorskip("ray")
    options = {"seeds": (0,), "steps": 1500, "backend": "eager"}
    runs = {
        name: agents.train("trpo-lag", out=tmp_path / name, engine=name, **options)
        for name in ("local", "ray")
    }
    for name in ("episodes.csv", "updates.csv", "evaluation.json"):
        a, b = (of.folder / "seed-0" / name for of in runs.values())
        assert a.read_bytes() == b.read_bytes()
