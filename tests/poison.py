"""Child processes that misbehave, for the tests of the executors.

A worker imports the package afresh, so a patched parent does not reach it. Where this
module is imported at the start of every Python (by ``sitecustomize``), it patches
`simval.sweep.executors` at the moment that module has been imported.
"""

import os
import signal
import time

from hooks import after_import

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


def install():
    """Watch for the module."""
    after_import(MODULE.__eq__, spoil)
