"""Child processes that misbehave, for the tests of the executors.

A worker imports the package afresh, so a patched parent does not reach it. Where this
module is imported at the start of every Python (by ``sitecustomize``), it patches
`simval.sweep.executors` at the moment that module has been imported.
"""

import importlib.util
import os
import signal
import sys
import time

VARIABLE = "SIMVAL_TEST_POISON"
MODULE = "simval.sweep.executors"


def spoil(module):
    """Make `execute` kill its process for one noise level, or be slow."""
    kind, _, value = os.environ.get(VARIABLE, "").partition(":")
    original = module.execute

    def execute(cell):
        if kind == "kill" and f"noise_std={value}," in cell.name:
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "slow":
            time.sleep(float(value))
        return original(cell)

    module.execute = execute


class Hook:
    """Finds the one module, and spoils it once it has been executed."""

    def find_spec(self, name, path=None, target=None):
        if name != MODULE:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def exec_module(module):
            load(module)
            spoil(module)

        spec.loader.exec_module = exec_module
        return spec


def install():
    """Watch for the module."""
    sys.meta_path.insert(0, Hook())
