"""Trained policies as files for other programs, with a model card."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import nn

from agents.algorithms import title
from agents.errors import UserError, extra
from agents.lockstep.normalizer import CLIP, Normalized
from agents.reporting.provenance import command
from agents.reporting.study import ask
from agents.reporting.tables import task_table
from agents.results.reading import read_groups
from agents.studies import used_study
from agents.training.config import CONFIG, TrainConfig, file_name, read_spaces
from agents.training.files import check_folder, read_json, write_whole
from agents.training.policy import Policy, load_policy

Format = Literal["safetensors", "onnx"]
KINDS = {"Tanh": "np.tanh({0})", "ReLU": "np.maximum({0}, 0)", "SiLU": "{0} / (1 + np.exp(-{0}))"}
"""Activation functions, modules of torch.nn, and their NumPy code."""
OPSET, IR_VERSION = 17, 8
"""ONNX versions from 2022, so that older runtimes can read the files."""


class Exported(NamedTuple):
    """A policy's network: linear layers with activations, and the bounds of actions."""

    arrays: Mapping[str, NDArray[np.float32]]
    """By name: "net.0.weight" [out, in], "net.0.bias" [out], ..., "low" and "high" [action]."""
    layers: Sequence[tuple[str, str]]
    """Name of each linear layer, such as "net.0", and its activation, one of `KINDS` or ""."""
    normalized: str = ""
    """Name of the module before the layers that normalises observations, if any; its arrays are
    "NAME.mean" and "NAME.scale", both [observation]."""


def export(
    folder: Path,
    format: Format,
    out: Path | None = None,
    seeds: Sequence[int] | None = None,
    step: int | None = None,
    task: str | None = None,
) -> list[Path]:
    """Write the deterministic policies of a folder of runs, one file each, and a model card.

    The actions of an exported policy equal the original's up to rounding in float32. out: folder to
    write to, by default `exported` in the runs' folder, with a subfolder for each of several tasks.
    seeds: of the runs, by default all. step, task: as in `load_policy`. Returns the files, the card
    last. Raises UserError if there is no policy, if a policy diverged, and if the library for the
    format is missing.
    """
    if format not in _FORMATS:
        raise UserError(f"format must be safetensors or onnx, got {format!r}")
    write = _FORMATS[format]
    config, recorded = TrainConfig.read(folder), read_json(folder / CONFIG)
    policies = {seed: load_policy(folder, seed, step, task) for seed in seeds or config.seeds}
    networks = {seed: _network(policy, seed) for seed, policy in policies.items()}
    first = next(iter(policies))
    task, commit = policies[first].task, _commit(recorded)
    about = {"task": task, "algorithm": config.algorithm, "commit": commit}
    if out is None:
        out = folder / "exported" / (file_name(task) if len(config.tasks) > 1 else "")
    contents = {
        out / f"seed-{seed}.{format}": write(
            networks[seed], about | {"seed": str(seed), "step": _steps([policy])}
        )
        for seed, policy in policies.items()
    }
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    for path, content in contents.items():
        write_whole(path, content)
    layers = "\n".join(_layers(networks[first]))
    code = _LOADING[format].strip().format(file=next(iter(contents)).name, layers=layers)
    write_whole(out / "README.md", _card(folder, config, recorded, policies, code))
    return [*contents, out / "README.md"]


def _network(policy: Policy, seed: int) -> Exported:
    """Return the network of a policy. Raises UserError for unsupported layers, for a policy that is
    not just its layers in sequence, and for weights that are not finite."""
    module = policy.to_torch()
    arrays = {name: value.numpy() for name, value in module.state_dict().items()}
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise UserError(f"the policy of seed {seed} diverged: choose other seeds")
    layers: list[tuple[str, str]] = []
    normalized = ""
    parts = [(name, part) for name, part in module.named_modules() if not list(part.children())]
    for name, part in parts:
        if isinstance(part, Normalized) and not layers:
            normalized = name
        elif isinstance(part, nn.Linear) and part.bias is not None:
            layers.append((name, ""))
        elif type(part).__name__ in KINDS and layers:
            layers[-1] = layers[-1][0], type(part).__name__
        else:
            known = ", ".join(["Linear with bias", *KINDS])
            raise UserError(f"export supports {known} of torch.nn, but the policy has {part}")
    in_a_row = nn.Sequential(*(part for _, part in parts))
    policy.check_same(policy.bounded(in_a_row), "its module's layers in a row, as export writes it")
    return Exported(arrays, layers, normalized)


def _write_safetensors(network: Exported, about: Mapping[str, str]) -> bytes:
    arrays = {name: np.ascontiguousarray(array) for name, array in network.arrays.items()}
    # A single entry: the library writes several in any order, and equal policies must give equal
    # files.
    metadata = {"about": json.dumps(about)}
    return extra("safetensors.numpy", "export").save(arrays, metadata=metadata)


def _write_onnx(network: Exported, about: Mapping[str, str]) -> bytes:
    """Return an ONNX graph from "observation" [N, size] to "action" [N, size]."""
    onnx = extra("onnx", "export")
    helper, arrays = onnx.helper, dict(network.arrays)
    arrays |= {"range": arrays["high"] - arrays["low"]}
    arrays |= {f"{v:g}": np.array(v, np.float32) for v in (-1, 1, 2, -CLIP, CLIP)}
    nodes, last = [], "observation"

    def add(kind: str, *inputs: str, output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    if name := network.normalized:
        last = add("Sub", last, f"{name}.mean", output="centred")
        last = add("Mul", last, f"{name}.scale", output="standardised")
        last = add("Clip", last, f"{-CLIP:g}", f"{CLIP:g}", output="normalised")
    for name, kind in network.layers:
        weights = (f"{name}.weight", f"{name}.bias")
        last = add("Gemm", last, *weights, output=f"{name}.linear", transB=1)
        if kind == "SiLU":
            share = add("Sigmoid", last, output=f"{name}.sigmoid")
            last = add("Mul", last, share, output=f"{name}.silu")
        elif kind:
            node = {"Tanh": "Tanh", "ReLU": "Relu"}[kind]
            last = add(node, last, output=f"{name}.{node.lower()}")
    last = add("Clip", last, "-1", "1", output="clipped")
    last = add("Div", add("Add", last, "1", output="above"), "2", output="share")
    last = add("Add", "low", add("Mul", "range", last, output="scaled"), output="rounded")
    # Rounding may exceed the bounds. They are arrays, which ONNX's Clip does not support.
    add("Min", add("Max", last, "low", output="raised"), "high", output="action")
    sizes = {
        "observation": arrays[f"{network.layers[0][0]}.weight"].shape[1],
        "action": len(arrays["low"]),
    }
    ends = [
        helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", size])
        for name, size in sizes.items()
    ]
    used = {name for node in nodes for name in node.input}
    weights = [onnx.numpy_helper.from_array(a, n) for n, a in arrays.items() if n in used]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    opset = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION)
    helper.set_model_props(model, dict(about))
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()


def _steps(policies: Iterable[Policy], format: str = "d") -> str:
    """Return the environment steps of the policies' runs, or "not recorded"."""
    taken = {policy.step for policy in policies if policy.step is not None}
    return " or ".join(f"{step:{format}}" for step in sorted(taken)) or "not recorded"


def _commit(recorded: Mapping[str, Any]) -> str:
    """Return the commit of the code that began the training, or that it is not recorded."""
    version = (recorded.get("versions") or {}).get("circle2d-mj", "unknown")
    return recorded.get("commit") or f"not recorded (version {version})"


def _card(
    folder: Path,
    config: TrainConfig,
    recorded: Mapping[str, Any],
    policies: Mapping[int, Policy],
    code: str,
) -> str:
    """Return the model card.

    recorded: content of `config.json`; policies: by seed; code: Python code that reads a file."""
    task, name = next(iter(policies.values())).task, title(config.algorithm)
    spaces, versions = read_spaces(folder), recorded.get("versions") or {}
    wraps = hasattr(config.hyperparameters, "wrap")  # for a limit of the longest streak, or Sauté
    added = ", followed by what `agents.load_policy(...).wrap(env)` adds, if anything" * wraps
    bounds = ", ".join(f"[{a:g}, {b:g}]" for a, b in zip(spaces.low, spaces.high, strict=True))
    parameters = f" with {config.task_parameters}" if config.task_parameters else ""
    facts = {
        "algorithm": f"{name} (`{config.algorithm}`)",
        "task": f"`{task}`{parameters}",
        "seeds": ", ".join(map(str, policies)),
        "environment steps": f"{_steps(policies.values(), ',')}; planned {config.steps:,}",
        "commit": _commit(recorded),
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "trained by": f"`{command(config, 'runs', recorded)}`",
        "observation": f"float32 [N, {spaces.observation_size}], as the task returns it{added}",
        "action": f"float32 [N, {len(spaces.low)}], in {bounds}; without noise",
    }
    rows = "\n".join(f"| {name} | {text} |" for name, text in facts.items() if text)
    return f"""---
library_name: circle2d-mj
pipeline_tag: reinforcement-learning
---

# {name} on {task}

| | |
| --- | --- |
{rows}

## Results

{_results(folder).strip()}

## Loading

```python
{code}
```
"""


def _layers(network: Exported) -> Iterator[str]:
    """Yield lines of NumPy code for the layers of a network."""
    if name := network.normalized:
        seen = f'(x - net["{name}.mean"]) * net["{name}.scale"]'
        yield f"    x = np.clip({seen}, {-CLIP:g}, {CLIP:g})"
    for name, kind in network.layers:
        yield f'    x = x @ net["{name}.weight"].T + net["{name}.bias"]'
        if kind:
            yield f"    x = {KINDS[kind].format('x')}"


def _results(folder: Path) -> str:
    """Return the table of the folder's runs, or why there is none."""
    notes: list[str] = []
    try:
        groups = read_groups([folder], notes)
    except UserError as error:
        return f"None: {error}"
    words = [f"\nNote: {note}\n" for note in notes]
    printed = [ask(used_study().printed, group) for group in groups]
    return "\n".join([task_table(printed).markdown(), *words])


_FORMATS = {"safetensors": _write_safetensors, "onnx": _write_onnx}
_LOADING = {
    "safetensors": """
import numpy as np
from safetensors.numpy import load_file

net = load_file("{file}")


def policy(observation):
    x = np.asarray(observation, np.float32)
{layers}
    share = (np.clip(x, -1, 1) + 1) / 2
    action = net["low"] + (net["high"] - net["low"]) * share
    return np.clip(action, net["low"], net["high"])
""",
    "onnx": """
import numpy as np
import onnxruntime

session = onnxruntime.InferenceSession("{file}")


def policy(observation):
    inputs = {{"observation": np.asarray(observation, np.float32)}}
    return session.run(None, inputs)[0]
""",
}
"""Code that reads a file and defines `policy(observation)` for observations [N, size]."""
