"""Lets `gymnasium.make` find Circle2D without an import of this package.

gymnasium 1.0 stopped reading the `gymnasium.envs` entry points. So the wheel installs this file as
a module of its own, which `circle2d_mj.pth` runs when Python starts: it waits for gymnasium to be
imported, and imports `circle2d_mj`, which registers its tasks, right after. A program that never
imports gymnasium pays for one entry in `sys.meta_path`.
"""

import sys


class AfterGymnasium:
    """An import hook that acts when gymnasium has been loaded, and is gone then.

    Being asked where gymnasium is means little: programs ask that to see whether it is installed.
    """

    asking = False

    def find_spec(self, name, path=None, target=None):
        if name != "gymnasium" or self.asking:
            return None
        from importlib.util import find_spec

        self.asking = True
        try:
            spec = find_spec(name)
        finally:
            self.asking = False
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module):
                load(module)
                if self in sys.meta_path:
                    sys.meta_path.remove(self)
                try:
                    import circle2d_mj  # noqa: F401
                except Exception as error:  # gymnasium must work even if this package is broken
                    import warnings

                    warnings.warn(f"circle2d_mj is not registered: {error!r}", stacklevel=2)

            spec.loader.exec_module = load_and_register
        return spec


sys.meta_path.insert(0, AfterGymnasium())
