"""Pictures and films as files."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import track

from agents.errors import UserError
from agents.training.files import unfinished, write_whole
from circle2d_mj.core.view import Picture

FRAMES_A_SECOND = 10
"""A step of the task takes 0.1 s."""


def write_picture(path: Path, picture: Picture) -> None:
    """Write an image file, whole or not at all."""
    import imageio.v3 as imageio

    _prepare(path)
    write_whole(path, imageio.imwrite("<bytes>", picture, extension=path.suffix))


def png(picture: Picture) -> bytes:
    """The picture as a PNG, as small as can be without loss."""
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG", optimize=True)
    return file.getvalue()


def write_film(path: Path, frames: Iterable[Picture], total: int) -> None:
    """Write `total` frames into a .gif or .mp4 file, whole or not at all, showing progress."""
    _prepare(path)
    shown = track(frames, "drawing", total, console=Console(stderr=True), transient=True)
    if path.suffix.lower() == ".gif":
        import imageio.v3 as imageio

        pictures = np.array(list(shown))
        timing: dict[str, Any] = {"duration": 1000 // FRAMES_A_SECOND, "loop": 0}
        write_whole(path, imageio.imwrite("<bytes>", pictures, extension=".gif", **timing))
    else:
        _write_stream(path, shown)


def _write_stream(path: Path, frames: Iterable[Picture]) -> None:
    """Write a file frame by frame."""
    import imageio.v2 as imageio

    with unfinished(path) as temporary:
        # Blocks of two pixels: sizes are even, and would be changed to multiples of 16 otherwise.
        writer: Any = imageio.get_writer(temporary, fps=FRAMES_A_SECOND, macro_block_size=2)
        with writer:
            for frame in frames:
                writer.append_data(frame)


def _prepare(path: Path) -> None:
    if path.is_dir():
        raise UserError(f"{path} is a folder; a file is to be written")
    path.parent.mkdir(parents=True, exist_ok=True)
