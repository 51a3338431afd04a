"""Register the toy tasks for the tests of training."""

import toys

toys.register()
