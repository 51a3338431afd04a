"""Exceptions for mistakes of users and for errors of their own code, and words for messages."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import pickle
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

OWN_ERRORS = (Exception, SystemExit)
"""Errors of the user's own code. `sys.exit` in it would end the command as if all were done."""


class UserError(ValueError):
    """A mistake of the user. The message names the thing, the value given, and what is allowed.

    The command line prints it as one line and exits with status 2.
    """


class OwnCodeError(UserError):
    """An error of the user's own code: a task, an algorithm, a measure, a study. The original
    error is its `__cause__`. The command line shows its traceback and exits with status 1."""

    def __reduce__(self) -> Any:  # a cause is lost in the pickle of an exception
        cause = self.__cause__
        trace = "" if cause is None else "".join(traceback.format_exception(cause))
        try:
            pickle.loads(pickle.dumps(cause))
        except Exception:  # whatever the user's class of exception raises
            cause = None if cause is None else RuntimeError(described(cause))
        return _with_cause, (type(self), str(self), cause, trace)


class RunsFailed(UserError):
    """Some trainings failed; all others are done. The command line exits with status 1."""


class FailedRunWarning(UserWarning):
    """A run failed; all others are done. The command line names the run at the end instead."""


class HelpShown(SystemExit):
    """Ends a command that was asked for its help."""


@contextlib.contextmanager
def no_exit() -> Iterator[None]:
    """Raise OwnCodeError for `sys.exit` in the user's own code, wherever it is called."""
    try:
        yield
    except HelpShown:
        raise
    except SystemExit as error:
        raise OwnCodeError(f"code of your own ended the program: {described(error)}") from error


class TaskFailure(OwnCodeError):
    """An environment failed while it was made, reset or stepped."""


def traced(error: BaseException | None) -> str:
    """Return the traceback of an error of the user's own code; "" for any other error."""
    if error is None or isinstance(error, UserError):
        return ""
    if isinstance(error, RemoteTraceback):
        return error.args[0]
    return "".join(traceback.format_exception(error))


class RemoteTraceback(Exception):
    """Holds the traceback of an error in another process, which pickles do not keep."""

    def __str__(self) -> str:
        return f'\n"""\n{self.args[0]}"""'


def _with_cause(
    kind: type[OwnCodeError], message: str, cause: BaseException | None, trace: str
) -> OwnCodeError:
    error = kind(message)
    error.__cause__ = cause
    if cause is not None:
        cause.__cause__ = RemoteTraceback(trace)
    return error


OURS = tuple(str(Path(__file__).parents[1] / name) for name in ("agents", "circle2d_mj", "emcc"))
"""Folders of this package, whose frames are not the user's."""
BETWEEN = ("importlib", "concurrent", "contextlib.py", "_ufunc_config.py")
"""Parts of paths in Python, NumPy and PyTorch whose frames lie between a caller and what it calls
or imports, as those of decorators do."""


def described(error: BaseException) -> str:
    """Return the type and message of an error, and the file and line of the user's code."""
    words = f"{type(error).__name__}: {error}".removesuffix(": ")
    frames = traceback.extract_tb(error.__traceback__)
    others = ("gymnasium", *BETWEEN)
    own = [
        frame
        for frame in frames
        if not frame.filename.startswith(OURS) and not any(o in frame.filename for o in others)
    ] or frames
    return f"{words} ({own[-1].filename}, line {own[-1].lineno})" if own else words


def one_line(text: object) -> str:
    """Return text for a terminal: on one line, with control characters as escapes."""
    words = " ".join(str(text).splitlines())
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in words
    )


def is_missing(error: BaseException, module: str) -> bool:
    """Whether an import failed because the module, or a package that contains it, is missing."""
    return isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}.")


def extra(module: str, name: str) -> Any:
    """Import a module of the extra `name`. Raises UserError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise UserError(f"{module} is not installed: {_how_to_install(name)}") from error


EXTRA = (
    *("filelock", "jinja2", "matplotlib", "pandas", "rich", "scipy"),
    *("threadpoolctl", "torch", "tyro"),
)
"""Packages that training and reports need and an installation without [train] lacks."""


def _how_to_install(name: str) -> str:
    """Return how to install an extra: from the code, since no package index has circle2d-mj."""
    return f"in the folder of circle2d-mj's code, pip install -c constraints.txt '.[{name}]'"


def extra_hint(error: ModuleNotFoundError, user: str) -> str:
    """Return how to install the package of [train] that `user` lacks; "" for any other module, and
    for a module that somebody else's code imports."""
    frames = traceback.extract_tb(error.__traceback__)
    files = [f.filename for f in frames if not any(name in f.filename for name in BETWEEN)]
    if (error.name or "").partition(".")[0] not in EXTRA or not files[-1].startswith(OURS):
        return ""
    return f"{user} needs {error.name}, which is not installed: {_how_to_install('train')}"


OTHER_NAMES = {
    "lr": "learning_rate",
    "gamma": "discount",
    "env": "task",
    "env_id": "task",
    "timesteps": "steps",
    "total_timesteps": "steps",
    "output": "out",
    "output_dir": "out",
}
"""Names of options in other libraries, and their names here."""


def nearest(given: str, valid: Iterable[str], otherwise: str = "") -> str:
    """Return "did you mean 'x'?" for the most similar of the valid names.

    otherwise: what to return where none is similar, by default the list of the valid names.
    """
    names = {name.lower(): name for name in valid}  # "SAC-Lag" is near to "sac-lag"
    near = difflib.get_close_matches(given.lower(), names, n=1)
    if near:
        return f"did you mean {names[near[0]]!r}?"
    return otherwise or f"valid are {', '.join(names.values())}"
