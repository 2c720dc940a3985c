"""Run a suite: a file of studies and grids, cell by cell, into a run folder.

`suite` reads and expands the file, `runner` computes the cells, `store` keeps the
results in SQLite, `provenance` notes what the numbers depend on, `run` reads a
finished run back.
"""

from simval.sweep.run import Run, load_run
from simval.sweep.runner import run_suite
from simval.sweep.suite import Suite, load_suite, suite_schema

__all__ = ["Run", "Suite", "load_run", "load_suite", "run_suite", "suite_schema"]
