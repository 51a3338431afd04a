"""`python -m agents.cli`: the command `circle2d`."""

import sys

from agents.cli.main import main

sys.exit(main())
