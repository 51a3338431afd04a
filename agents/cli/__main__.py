"""`python -m agents.cli`: the command `circle2d`."""

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # until `main` handles it: no traceback

from agents.cli.main import main  # noqa: E402

sys.exit(main())
