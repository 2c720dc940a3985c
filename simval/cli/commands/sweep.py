"""`simval sweep`."""

import os
from typing import Any

import click

from simval.cli.completing import studies, suites
from simval.cli.options import Whole
from simval.cli.outputs import OUT, Command


@click.command(name="sweep", cls=Command)
@click.argument("suite", default="accuracy", shell_complete=suites)
@click.option(
    "--out",
    type=OUT,
    help="Folder of the run, new or empty.  [default: one under reports/runs]",
)
@click.option(
    "--workers",
    type=Whole(min=1),
    default=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1,
    show_default="all processors",
    help="Number of processes that compute cells.",
)
@click.option("--seed", type=Whole(min=0), help="Seed to use instead of the suite's.")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    shell_complete=studies,
    metavar="STUDY.KEY=V1[,V2...]",
    help="Replace a value of the suite by one or several; may be repeated.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute on the dask.distributed cluster at this address (extra `cluster`).",
)
@click.option(
    "--wait",
    type=click.FloatRange(min=0.0),
    default=60.0,
    metavar="SECONDS",
    show_default=True,
    help="Wait so long for a worker of the scheduler while there is none.",
)
@click.option(
    "--mixed-kernels",
    is_flag=True,
    help="Let workers compute whose processor kernels, linear algebra or C library are "
    "not this machine's: the last bits then depend on which did.",
)
@click.option(
    "--plugin",
    "plugins",
    multiple=True,
    metavar="PLUGIN",
    help="Measure this algorithm or scene too, beside built-in ones: FILE.py, "
    "FILE.py:NAME, the name of an installed plug-in, or 'command: PROGRAM {poses}'; "
    "may be repeated.",
)
@click.option(
    "--resume", is_flag=True, help="Continue an interrupted run in the folder --out."
)
@click.option(
    "--dry-run",
    is_flag=True,
    help="List the cells with their estimated times, and stop.",
)
@click.option("--quiet", is_flag=True, help="Print only the folder of the run.")
def command(**options: Any) -> int:
    """Run SUITE: smoke, accuracy, filters, full, or the path of a TOML file.

    The last line printed is the folder of the run. Exit code 0 if every cell was
    computed, 3 if a plug-in was refused or the cluster was lost, 4 if a cell crashed.
    `simval gate` judges the numbers.
    """
    from simval.cli.sweep import run

    return run(**options)
