"""Run a command in which `import safety_gymnasium` finds this package.

    python -m circle2d_mj.safety_gymnasium omnisafe train --algo CPO --env-id SafetyPointGoal1-v0
    python -m circle2d_mj.safety_gymnasium train.py

This also holds for all processes that the command starts. Python files are run with this Python;
programs that are installed beside it are found first.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

from circle2d_mj.safety_gymnasium.naming import add_to_path


def main(command: list[str]) -> int:
    """Replace this process by the command; return 2, with a line on stderr, if there is none."""
    if not command or command[0] in ("-h", "--help"):
        print(__doc__, file=sys.stdout if command else sys.stderr)
        return 0 if command else 2
    if command[0].endswith(".py"):
        command = [sys.executable, *command]
    beside = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    program = shutil.which(command[0], path=beside)
    if program is None:
        print(f"{command[0]}: no such program", file=sys.stderr)
        return 2
    add_to_path()
    os.environ["PATH"] = beside
    return os.execv(program, command)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
