"""Run a suite, a file of studies and grids, cell by cell into a run folder.

`suite` reads and expands the file, `runner` has its `cells` computed by `executors` or
on a `cluster`, `store` keeps the results in SQLite, `provenance` and `identity` say
what the numbers depend on and who may compute, `run` reads a finished run back.
"""

from simval.sweep.run import Run, load_run
from simval.sweep.runner import run_suite
from simval.sweep.suite import Suite, load_suite, suite_schema

__all__ = ["Run", "Suite", "load_run", "load_suite", "run_suite", "suite_schema"]
