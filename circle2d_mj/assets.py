"""Where the package's files that are not code lie."""

from __future__ import annotations

from pathlib import Path


def asset(name: str) -> Path:
    """The path of an asset, such as "xml/circle2d.xml": in an installed package or a checkout.

    Raises FileNotFoundError naming it where there is none.
    """
    here = Path(__file__).parent
    for folder in (here / "assets", here.parent / "assets"):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"no asset {name!r} in the package circle2d_mj")
