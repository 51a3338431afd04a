"""Trained policies as files that other programs read, with a model card."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import nn

from agents.algorithms import title
from agents.errors import UserError
from agents.paper.printed import printed
from agents.reporting.provenance import command
from agents.reporting.tables import task_table
from agents.results.reading import read
from agents.training.config import TrainConfig, read_spaces
from agents.training.environments import Spaces
from agents.training.files import read_json, write_whole
from agents.training.policy import Policy, load_policy

Format = Literal["safetensors", "onnx"]
KINDS = {"Tanh": "np.tanh({0})", "ReLU": "np.maximum({0}, 0)", "SiLU": "{0} / (1 + np.exp(-{0}))"}
"""Functions between the layers, modules of torch.nn, in numpy."""
OPSET, IR_VERSION = 17, 8
"""Versions of ONNX files, of 2022, so that older runtimes read them too."""


class Exported(NamedTuple):
    """A policy's network: linear layers with functions between them, then the actions' bounds."""

    arrays: Mapping[str, NDArray[np.float32]]
    """By name: "net.0.weight" [out, in], "net.0.bias" [out], ..., "low" and "high" [action]."""
    layers: Sequence[tuple[str, str]]
    """Name of each linear layer, such as "net.0", and the function behind it, one of `KINDS`."""


def export(
    folder: Path,
    format: Format,
    out: Path | None = None,
    seeds: Sequence[int] | None = None,
    step: int | None = None,
    task: str | None = None,
) -> list[Path]:
    """Write the deterministic policies of a folder of runs, a file each, and a model card.

    The actions of a file equal the policy's up to rounding in float32. out: folder to write to,
    by default `exported` in the runs' own. seeds: of the runs, by default all. step, task: as in
    `load_policy`. Returns the files, the card last. Raises UserError where there is no policy, or
    one that diverged, and where the library of the format is missing.
    """
    write = {"safetensors": _write_safetensors, "onnx": _write_onnx}.get(format)
    if write is None:
        raise UserError(f"format must be safetensors or onnx, got {format!r}")
    config = TrainConfig.read(folder)
    policies = {seed: load_policy(folder, seed, step, task) for seed in seeds or config.seeds}
    task = next(iter(policies.values())).task
    networks = {seed: _network(policy, seed) for seed, policy in policies.items()}
    about = {"task": task, "algorithm": config.algorithm, "commit": _commit(folder)}
    out = folder / "exported" if out is None else out
    files = {seed: out / f"seed-{seed}.{format}" for seed in networks}
    contents = {
        files[seed]: write(networks[seed], about | {"seed": str(seed), "step": _steps([policy])})
        for seed, policy in policies.items()
    }
    out.mkdir(parents=True, exist_ok=True)
    for path, content in contents.items():
        write_whole(path, content)
    network = next(iter(networks.values()))
    loading = _loading(format, next(iter(files.values())).name, network)
    card = _card(folder, config, task, policies, loading)
    write_whole(out / "README.md", card)
    return [*files.values(), out / "README.md"]


def _network(policy: Policy, seed: int) -> Exported:
    """The network of a policy. Raises UserError for other layers, and numbers not finite."""
    module = policy.to_torch()
    arrays = {name: value.numpy() for name, value in module.state_dict().items()}
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise UserError(f"the policy of seed {seed} diverged: choose other seeds")
    layers: list[tuple[str, str]] = []
    parts = [(name, part) for name, part in module.named_modules() if not list(part.children())]
    for name, part in parts:
        if isinstance(part, nn.Linear):
            layers.append((name, ""))
        elif type(part).__name__ in KINDS and layers:
            layers[-1] = layers[-1][0], type(part).__name__
        else:
            known = ", ".join(["Linear", *KINDS])
            raise UserError(f"export knows {known} of torch.nn, and the policy has {part}")
    return Exported(arrays, layers)


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        package = name.partition(".")[0]
        raise UserError(
            f"export needs {package}, which is not installed: pip install 'circle2d-mj[export]'"
        ) from None


def _write_safetensors(network: Exported, about: Mapping[str, str]) -> bytes:
    arrays = {name: np.ascontiguousarray(array) for name, array in network.arrays.items()}
    # One entry: the library writes several in any order, and equal policies give equal files.
    metadata = {"about": json.dumps(about)}
    return _library("safetensors.numpy").save(arrays, metadata=metadata)


def _write_onnx(network: Exported, about: Mapping[str, str]) -> bytes:
    """A graph from "observation" [N, size] to "action" [N, size]."""
    onnx = _library("onnx")
    helper, arrays = onnx.helper, dict(network.arrays)
    arrays |= {"range": arrays["high"] - arrays["low"]}
    arrays |= {name: np.array(v, np.float32) for name, v in (("-1", -1), ("1", 1), ("2", 2))}
    nodes, last = [], "observation"

    def add(kind: str, *inputs: str, output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

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
    add("Add", "low", add("Mul", "range", last, output="scaled"), output="action")
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
    """Environment steps of the policies' runs, or that they are not known."""
    taken = {policy.step for policy in policies if policy.step is not None}
    return " or ".join(f"{step:{format}}" for step in sorted(taken)) or "not recorded"


def _commit(folder: Path) -> str:
    """Commit of the code that began the training, or why it is not known."""
    content = read_json(folder / "config.json")
    version = (content.get("versions") or {}).get("circle2d-mj", "unknown")
    return content.get("commit") or f"not recorded (version {version})"


def _card(
    folder: Path, config: TrainConfig, task: str, policies: Mapping[int, Policy], loading: str
) -> str:
    """The model card. policies: by seed. loading: code that reads a file."""
    content = read_json(folder / "config.json")
    versions = content.get("versions") or {}
    parameters = f" with {config.task_parameters}" if config.task_parameters else ""
    facts = {
        "algorithm": f"{title(config.algorithm)} (`{config.algorithm}`)",
        "task": f"`{task}`{parameters}",
        "seeds": ", ".join(map(str, policies)),
        "environment steps": f"{_steps(policies.values(), ',')}; planned {config.steps:,}",
        "commit": _commit(folder),
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "trained by": f"`{command(config, 'runs', content)}`",
        **_spaces(read_spaces(folder)),
    }
    return "\n".join(
        [
            *("---", "library_name: circle2d-mj", "pipeline_tag: reinforcement-learning", "---"),
            *("", f"# {title(config.algorithm)} on {task}", "", "| | |", "| --- | --- |"),
            *(f"| {name} | {text} |" for name, text in facts.items() if text),
            *("", "## Results", "", _results(folder).strip()),
            *("", "## Loading", "", "```python", loading.strip(), "```", ""),
        ]
    )


def _spaces(spaces: Spaces) -> dict[str, str]:
    """The rows on observations and actions."""
    bounds = ", ".join(f"[{a:g}, {b:g}]" for a, b in zip(spaces.low, spaces.high, strict=True))
    return {
        "observation": f"float32 [N, {spaces.observation_size}], as the task gives it",
        "action": f"float32 [N, {len(spaces.low)}], in {bounds}; without noise",
    }


def _results(folder: Path) -> str:
    """The table of the folder's runs, or why there is none."""
    notes: list[str] = []
    try:
        groups = read([folder], notes)
    except UserError as error:
        return f"None: {error}"
    words = [f"\nNote: {note}\n" for note in notes]
    return "\n".join([task_table(groups, printed).markdown(), *words])


def _loading(format: Format, file: str, network: Exported) -> str:
    """Code that reads a file and gives `policy(observation)`, a function of [N, size]."""
    return "\n".join(_LOADING[format](file, network))


def _load_onnx(file: str, network: Exported) -> Iterator[str]:
    yield from ("import numpy as np", "import onnxruntime", "")
    yield f'session = onnxruntime.InferenceSession("{file}")'
    yield from ("", "", "def policy(observation):")
    yield '    inputs = {"observation": np.asarray(observation, np.float32)}'
    yield "    return session.run(None, inputs)[0]"


def _load_safetensors(file: str, network: Exported) -> Iterator[str]:
    yield from ("import numpy as np", "from safetensors.numpy import load_file", "")
    yield f'net = load_file("{file}")'
    yield from ("", "", "def policy(observation):", "    x = np.asarray(observation, np.float32)")
    for name, kind in network.layers:
        yield f'    x = x @ net["{name}.weight"].T + net["{name}.bias"]'
        if kind:
            yield f"    x = {KINDS[kind].format('x')}"
    yield "    share = (np.clip(x, -1, 1) + 1) / 2"
    yield '    return net["low"] + (net["high"] - net["low"]) * share'


_LOADING: dict[Format, Callable[[str, Exported], Iterator[str]]] = {
    "onnx": _load_onnx,
    "safetensors": _load_safetensors,
}
