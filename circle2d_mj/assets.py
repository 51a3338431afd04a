"""Files that are shipped with the package."""

from __future__ import annotations

from pathlib import Path

# A wheel holds the assets inside the package, a checkout beside the package.
_FOLDERS = (Path(__file__).parent / "assets", Path(__file__).parents[1] / "assets")


def asset(name: str) -> Path:
    """Return the path of a shipped file, as in `asset("xml/circle2d.xml")`.

    Raises FileNotFoundError for any other name, listing the shipped files.
    """
    for folder in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    shipped = sorted(
        path.relative_to(folder).as_posix() for folder in _FOLDERS for path in folder.rglob("*.*")
    )
    raise FileNotFoundError(f"no asset {name!r}; there are {shipped}")
