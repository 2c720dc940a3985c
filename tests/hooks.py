"""Change modules at the moment when they have been imported."""

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder


class Finder(MetaPathFinder):
    """Finds the modules of a choice as ever, and changes each once it is executed."""

    def __init__(self, chosen, change):
        self.chosen, self.change = chosen, change

    def find_spec(self, name, path=None, target=None):
        """Spec of a chosen module with its execution extended."""
        spec = PathFinder.find_spec(name, path, target) if self.chosen(name) else None
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def exec_module(module):
            execute(module)
            self.change(module)

        spec.loader.exec_module = exec_module
        return spec


def after_import(chosen, change):
    """Have a change made to every module whose name is chosen."""
    sys.meta_path.insert(0, Finder(chosen, change))
