"""Archives of the old form (index.json, one zip) into the new (a folder of trainings, zipped).
python convert.py OLD.zip NEW.zip    PYTHONPATH: the new code."""
import io, json, sys, zipfile
from pathlib import Path
import numpy as np
from agents.training import derive
from agents.training.config import RunId, file_name
from agents.training.environments import view_of
from agents.training.files import write_arrays

def from_planes(planes):
    bits = np.zeros((planes.shape[1], 4), np.uint8); bits[:, 1:] = planes.T
    return bits.view("<f4").ravel().astype(np.float64)

def convert(old, new):
    file = zipfile.ZipFile(old); index = json.loads(file.read("index.json"))
    there = set(file.namelist())
    with zipfile.ZipFile(new, "w") as out:
        out.comment = index["name"].encode()
        assert not index["problems"], index["problems"]
        for number, entry in enumerate(index["folders"]):
            def get(name):
                full = f"{number}/{name}.npy"
                return np.load(io.BytesIO(file.read(full))) if full in there else None
            config = dict(entry["config"]); task = config.pop("task")
            config["tasks"] = [task]; config["costs"] = ["cost"]
            modules = [config.pop("algorithm_module", None), config.pop("task_module", None)]
            config["modules"] = [m for m in modules if m and not m.startswith("agents.algorithms.")]
            resumed = config.pop("resumed", [])
            config.setdefault("commit", None)
            first = {k: config.get(k) for k in ("versions", "machine")}
            sessions = {}
            for k, (name, seconds) in enumerate(entry["sessions"].items()):
                made = first if k == 0 or not resumed else resumed[min(k - 1, len(resumed) - 1)]
                sessions[name] = {"seconds": seconds, **made}
            config.pop("versions", None) if config.get("versions") is None else None
            order = ["algorithm", "tasks", "seeds", "steps", "hyperparameters", "task_parameters", "costs"]
            config = {**{k: config[k] for k in order}, **{k: v for k, v in config.items() if k not in order}}
            view = view_of(task, config["task_parameters"]); arrays = {"metrics": np.array([], dtype=np.str_)}
            if (visits := get("visits")) is not None:
                arrays[file_name(task) + "/visits"] = visits
                arrays[file_name(task) + "/visited"] = np.array(entry["visits"], dtype=float)
            for seed, why in entry["missing"].items():
                print("MISSING", entry["folder"], seed, why)
                arrays[RunId(task, int(seed)).prefix + "failure"] = np.array(why)
            for seed, about in entry["runs"].items():
                prefix = RunId(task, int(seed)).prefix
                assert "no_costs" not in about, about["no_costs"]
                get_ = lambda name: get(f"{seed}/{name}")
                rollout = np.cumsum(get_("rollout")); length = get_("length")
                assert get_("start_step") is None and get_("cost") is None and get_("longest_streak") is None, (entry["folder"], seed)
                _, counts = np.unique(rollout, return_counts=True)
                arrays[prefix + "rollouts"] = counts.astype(np.uint16)
                arrays[prefix + "length"] = derive.smallest(length.astype(np.int64))
                returns = get_("return")
                arrays[prefix + "return"] = (from_planes(get_("return_bytes")) if returns is None else returns).astype(np.float32)
                arrays[prefix + "costs/cost/unsafe"] = get_("unsafe"); arrays[prefix + "costs/cost/steps"] = get_("steps")
                if (values := get_("unsafe_costs")) is not None: arrays[prefix + "costs/cost/values"] = values
                for policy in ("deterministic", "stochastic"):
                    e = about["evaluation"].get(policy)
                    if not e: continue
                    p = f"{prefix}evaluation/{policy}/"
                    costs = np.array(e["cost_returns"], dtype=np.float64)
                    arrays[p + "returns"] = np.array(e["returns"], dtype=np.float64)
                    arrays[p + "costs"] = costs[:, None]
                    arrays[p + "lengths"] = np.array(e["lengths"], dtype=np.int64)
                    assert e["J_R"] == float(np.mean(arrays[p + "returns"])) and e["J_C"] == float(np.mean(costs))
                    if policy == "deterministic":
                        found = derive.places_of(view, np.array(e["final_observations"], np.float32), costs) if e.get("final_observations") else {}
                        from collections import Counter
                        ends = dict(Counter(found["places"].tolist())) if found else {}
                        assert ends == about["ends"], (entry["folder"], seed, ends, about["ends"])
                        ways = {}
                        for (a, b), n in Counter(zip(found.get("places", np.array([])).tolist(), found.get("ways", np.array([])).tolist())).items():
                            if b: ways.setdefault(a, {})[b] = n
                        assert ways == about.get("ways", {}), (ways, about.get("ways"))
                        arrays |= {p + k: v for k, v in found.items()}
                if (length_ := get_("trained_length")) is not None and len(length_):
                    for name in ("length", "positions", "costs"): arrays[f"{prefix}trained/{name}"] = get_(f"trained_{name}")
                if (points := get_("replay")) is not None:
                    arrays[prefix + "replay/points"] = points; arrays[prefix + "replay/box"] = np.array(about["replay_box"])
            buffer = io.BytesIO(); write_arrays(buffer, arrays, zipfile.ZIP_LZMA)
            folder = entry["folder"]; at = "" if folder == "." else folder + "/"
            out.writestr(zipfile.ZipInfo(at + "config.json"), json.dumps(config, indent=1) + "\n")
            out.writestr(zipfile.ZipInfo(at + "status.json"), json.dumps({"share": 1.0, "steps_per_second": None, "sessions": sessions}, indent=1) + "\n")
            out.writestr(zipfile.ZipInfo(at + "results.npz"), buffer.getvalue())
convert(Path(sys.argv[1]), Path(sys.argv[2]))
