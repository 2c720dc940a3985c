"""`simval sweep`."""

import os
from typing import Any

import click

from simval.cli.completing import studies, suites
from simval.cli.options import PATH, Whole


@click.command(name="sweep")
@click.argument("suite", default="accuracy", shell_complete=suites)
@click.option("--out", type=PATH, help="Folder of the run.")
@click.option(
    "--workers",
    type=Whole(min=1),
    default=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1,
    show_default="the processors there are",
    help="Processes that compute cells.",
)
@click.option("--seed", type=Whole(min=0), help="Replace the suite's seed.")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    shell_complete=studies,
    metavar="STUDY.KEY=V1[,V2...]",
    help="Replace a value of the suite; may be repeated.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute on a dask.distributed cluster instead (extra `cluster`).",
)
@click.option(
    "--plugin",
    "plugins",
    multiple=True,
    metavar="PLUGIN",
    help="Add a plug-in, beside built-in ones: FILE.py, FILE.py:NAME, the name of an "
    "installed one, or 'command: PROGRAM {poses}'; may be repeated.",
)
@click.option("--resume", is_flag=True, help="Resume an interrupted run.")
@click.option("--dry-run", is_flag=True, help="List the cells and stop.")
@click.option("--quiet", is_flag=True, help="Print only the folder.")
def command(**options: Any) -> int:
    """Run SUITE: smoke, accuracy, filters, full, or the path of a TOML file.

    The last line printed is the folder of the run. Exit code 0 if every cell was
    computed, 4 if one crashed, 3 if a plug-in was refused; `simval gate` judges the
    numbers.
    """
    from simval.cli.sweep import run

    return run(**options)
