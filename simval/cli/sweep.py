"""`simval sweep`."""

from __future__ import annotations

import shlex
import time
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from simval.cli.options import (
    PROCESSORS,
    Number,
    OutFolder,
    Whole,
    declared,
    refuse_if,
    stated,
    studies,
    suites,
)
from simval.errors import LostClusterError

if TYPE_CHECKING:
    from simval.sweep import Suite

BYTES_PER_ROW = 340
"""In the store and the table together, measured with the accuracy suite."""
GIVEN = ("out", "resume")
"""Options that a continued sweep has in any case."""
SHOWN = 20
"""Failed cells named one by one; the others are counted."""
JUDGED = 100_000
"""Most rows of a run that is judged at once; `simval gate` judges the others."""


@declared("sweep")
def command(
    suite: Annotated[str, dict(shell_complete=suites)] = "accuracy",
    out: Annotated[
        OutFolder | None,
        "Folder of the run; the command makes it.  [default: one under reports/runs]",
    ] = None,
    workers: Annotated[
        int,
        Whole(min=1),
        "Number of processes that compute cells.",
        dict(show_default="all processors"),
    ] = PROCESSORS,
    seed: Annotated[
        int | None, Whole(min=0), "Seed to use instead of the suite's."
    ] = None,
    overrides: Annotated[
        tuple[str, ...],
        "Replace a value of the suite by one or several; may be repeated.",
        dict(name="--set", shell_complete=studies, metavar="STUDY.KEY=V1[,V2...]"),
    ] = (),
    scheduler: Annotated[
        str | None,
        "Compute on the dask.distributed cluster at this address (extra `cluster`).",
        dict(metavar="ADDRESS"),
    ] = None,
    wait: Annotated[
        float,
        Number(min=0.0),
        "Time to wait for a worker while the scheduler has none.",
        dict(metavar="SECONDS"),
    ] = 60.0,
    mixed_kernels: Annotated[
        bool,
        "Accept workers whose processor kernels, linear algebra or C library differ "
        "from this machine's: the last bits then depend on the worker.",
    ] = False,
    plugins: Annotated[
        tuple[str, ...],
        "Measure this algorithm or scene too, with built-in ones: FILE.py, "
        "FILE.py:NAME, the name of an installed plug-in, or "
        "'command: PROGRAM {poses}'; may be repeated.",
        dict(name="--plugin", metavar="PLUGIN"),
    ] = (),
    own: Annotated[
        tuple[Path, ...],
        "Add the study in a Python file; the suite uses the name of the "
        "file; may be repeated.",
        dict(name="--study", metavar="FILE"),
    ] = (),
    resume: Annotated[bool, "Continue an interrupted run in the folder --out."] = False,
    dry_run: Annotated[
        bool, "List the cells with their estimated times, and stop."
    ] = False,
    quiet: Annotated[bool, "Print only the folder of the run."] = False,
) -> int:
    """Run SUITE: smoke, accuracy, filters, full, or the path of a TOML file.

    The last line printed is the folder of the run. Exit code 0 if every cell was
    computed, 3 if a cell was refused or the cluster was lost, 4 if a cell crashed.
    `simval gate` judges the numbers.
    """
    from simval.cli.progress import CellBar, Quiet
    from simval.plugins.loading import beside_builtin, chosen, spelled
    from simval.studies import bring
    from simval.sweep import load_suite
    from simval.sweep.identity import StrangerError
    from simval.sweep.runner import drive

    refuse_if(
        resume and out is None,
        "`--resume` continues a run; give its folder with `--out`",
    )
    refuse_if(
        scheduler is not None and stated("workers"),
        "`--workers` is for this machine, `--scheduler` has its own; give one",
    )
    for name in ("wait", "mixed_kernels"):
        refuse_if(
            scheduler is None and stated(name),
            f"`--{name.replace('_', '-')}` is for the workers of a cluster; give its "
            "`--scheduler` too, or leave it out",
        )
    refuse_if(
        scheduler is not None and bool(own),
        "`--study` is for the processes of this machine; for the workers of a cluster, "
        "install the study there, as an entry point of the group simval.studies",
    )
    bring(own)
    added = spelled(beside_builtin(chosen(plugins)))
    loaded = load_suite(suite, (*added, *overrides), seed)
    if dry_run:
        return _plan(loaded, workers)
    folder, began = out or _fresh(loaded), time.monotonic()
    try:
        with nullcontext(Quiet()) if quiet else CellBar() as progress:
            drive(
                loaded,
                folder,
                workers=workers,
                scheduler=scheduler,
                resume=resume,
                progress=progress,
                wait=wait,
                mixed_kernels=mixed_kernels,
            )
    except (KeyboardInterrupt, LostClusterError, StrangerError):
        if (folder / "run.sqlite").exists():
            click.echo(f"to continue: {resuming(suite, folder)}", err=True)
        raise
    code = _tell(folder, loaded, time.monotonic() - began, quiet=quiet)
    click.echo(str(folder))
    return code


def _tell(folder: Path, suite: Suite, seconds: float, *, quiet: bool) -> int:
    """Print what became of the cells and what to do next; return the exit code."""
    from simval.cli.terminal import show
    from simval.judge import judge_run
    from simval.judge.result_lines import Failures, run_account
    from simval.sweep import load_run, store
    from simval.sweep.cells import REFUSED

    with store.opened(folder / "run.sqlite") as database:
        failures = Failures(
            first=store.failures(database, SHOWN),
            failed=store.count(database, "failed"),
            refused=store.count(database, "failed", REFUSED),
        )
    few = sum(cell.parameters.cost().rows for cell in suite.cells) <= JUDGED
    if not quiet or failures.failed:
        judged = judge_run(load_run(folder)) if few and not quiet else None
        account = run_account(
            folder, suite.name, len(suite.cells), seconds, failures, judged
        )
        show(account, err=True)
    if failures.failed > failures.refused:
        return 4
    return 3 if failures.failed else 0


def resuming(suite: str, folder: Path) -> str:
    """Command that continues an interrupted sweep, as it is typed in a shell."""
    context = click.get_current_context()
    words = ["simval", "sweep", suite, "--out", str(folder)]
    for parameter in context.command.params:
        name = parameter.name or ""
        if parameter.param_type_name == "option" and name not in GIVEN and stated(name):
            option = max(parameter.opts, key=len)
            value: Any = context.params[name]
            for each in value if parameter.multiple else (value,):
                words += [option] if each is True else [option, str(each)]
    return shlex.join([*words, "--resume"])


def _plan(suite: Suite, workers: int) -> int:
    """List the cells with an estimate of time and space."""
    total_seconds = total_rows = 0.0
    for cell in suite.cells:
        cost = cell.parameters.cost()
        total_seconds += cost.seconds
        total_rows += cost.rows
        click.echo(f"{cell.name}  {cost.seconds:.2g} s")
    click.echo(
        f"{len(suite.cells)} cells, about {total_seconds:.0f} s of processor time, "
        f"{total_seconds / workers:.0f} s on {workers} workers, "
        f"{total_rows * BYTES_PER_ROW / 1e6:.1f} MB (estimates)"
    )
    return 0


def _fresh(suite: Suite) -> Path:
    from simval.vocabulary import RUNS

    return RUNS / f"{suite.name}-{datetime.now():%Y%m%d-%H%M%S}"
