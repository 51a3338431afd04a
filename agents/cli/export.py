"""`circle2d export`: trained policies as files that other programs read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.options import Imports, parse
from agents.errors import UserError
from agents.export import Format, export
from agents.training.pretrained import folder_of


@dataclass(frozen=True)
class ExportOptions:
    """Write trained policies, without their noise, as files that other programs read, and a model
    card. Needs the extra [export]."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the runs, or pretrained:ALGORITHM/TASK."""
    format: Format
    """safetensors: the network's arrays; onnx: a graph from observations to actions."""
    out: Path | None = None
    """Folder for the files; by default `exported` in the runs' own. Required for a policy that
    comes with the package."""
    seeds: tuple[int, ...] | None = None
    """Seeds of the runs to export; by default all."""
    step: int | None = None
    """Environment steps of the training at which the policy was kept, a multiple of its
    --evaluate-every; by default the last checkpoint's."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d export`; returns the exit status."""
    options = parse(ExportOptions, "export", args)
    folder = folder_of(options.folder)
    if folder != options.folder and options.out is None:
        raise UserError(f"{options.folder} is in the package: give a folder for the files, --out")
    for path in export(folder, options.format, options.out, options.seeds, options.step):
        print(path)
    return 0
