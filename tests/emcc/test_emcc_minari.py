"""from_minari: records of a Minari data set are those of the episodes it was written from."""

import pytest

pytest.importorskip("minari")

import minari
from gymnasium.envs.registration import EnvSpec
from scripted import Scripted

import emcc

EPISODES = [[0.0, 1.0, 1.0], [2.0], [1.0, 1.0, 0.0, 1.0]]


@pytest.fixture
def dataset(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))

    def write(record_infos=True, **options):
        played = Scripted(EPISODES, **options)
        played.spec = EnvSpec("Scripted-v0")
        env = minari.DataCollector(played, record_infos=record_infos)
        for _ in EPISODES:
            env.reset(seed=0)
            done = False
            while not done:
                _, _, terminated, truncated, _ = env.step(0)
                done = terminated or truncated
        env.create_dataset("tests/scripted-v0", requirements=[], algorithm_name="none",
            author="none", author_email="none", code_permalink="none",
            description="none")  # fmt: skip
        env._tmp_dir.cleanup()
        return minari.load_dataset("tests/scripted-v0")

    return write


@pytest.mark.filterwarnings("ignore")  # Minari asks for more metadata
def test_records_of_a_data_set(dataset):
    found = emcc.from_minari(dataset())
    assert found.length.tolist() == [3, 1, 4]
    assert found.cost.tolist() == [2.0, 2.0, 3.0]
    assert found.reward.tolist() == [1.5, 0.5, 2.0]
    assert found.longest_streak.tolist() == [2, 1, 2]
    mcc, starts = found.mcc_per_rollout()
    assert mcc.tolist() == [emcc.mcc([costs]) for costs in EPISODES]
    assert starts.tolist() == [0, 3, 4]
    assert emcc.from_minari(minari.load_dataset("tests/scripted-v0"), 1.0).cost_steps is not None


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "options", [{"step_cost": False, "reset_cost": False}, {"record_infos": False}]
)
def test_a_data_set_without_costs_is_an_error(dataset, options):
    with pytest.raises(ValueError, match="episode 0 has no 'cost'"):
        emcc.from_minari(dataset(**options))
