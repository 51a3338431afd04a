"""Tests of training: its tasks."""

import toys

toys.register()
