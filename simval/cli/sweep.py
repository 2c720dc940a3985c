"""What `simval sweep` does."""

import shlex
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from simval.cli.options import refuse_if, stated
from simval.cli.progress import CellBar, Quiet
from simval.errors import LostClusterError
from simval.plugins.loading import beside_builtin, chosen, spelled
from simval.sweep import Suite, load_suite, store
from simval.sweep.cells import REFUSED
from simval.sweep.identity import StrangerError
from simval.sweep.run import RUNS
from simval.sweep.runner import drive

BYTES_PER_ROW = 340
"""In the store and the table together, measured with the accuracy suite."""

GIVEN = ("out", "resume")
"""Options that a continued sweep has in any case."""

SHOWN = 20
"""Failed cells named one by one; the others are counted."""


def run(
    suite: str,
    out: Path | None,
    workers: int,
    scheduler: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
    plugins: tuple[str, ...],
    resume: bool,
    dry_run: bool,
    quiet: bool,
    wait: float,
    mixed_kernels: bool,
) -> int:
    """Do what `simval sweep` is asked."""
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
    added = spelled(beside_builtin(chosen(plugins)))
    loaded = load_suite(suite, (*added, *overrides), seed)
    if dry_run:
        return _plan(loaded, workers)
    folder = out or _fresh(loaded)
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
    code = _tell_failures(folder, len(loaded.cells))
    click.echo(str(folder))
    return code


def _tell_failures(folder: Path, cells: int) -> int:
    """Say which cells failed, and where the table is; give the exit code."""
    with store.opened(folder / "run.sqlite") as database:
        first = store.failures(database, SHOWN)
        failed = store.count(database, "failed")
        refused = store.count(database, "failed", REFUSED)
    for name, error in first:
        known = error.startswith(REFUSED)
        last = error.strip().splitlines()[-1].removeprefix(REFUSED if known else "")
        click.echo(f"{'refused' if known else 'failed'}: {name}: {last}", err=True)
    if failed and failed == refused:
        click.echo(
            f"{failed} of {cells} cells refused their plug-in; the "
            f"reasons are in {folder}/run.sqlite and in the report",
            err=True,
        )
    elif failed:
        click.echo(
            f"{failed} of {cells} cells failed; the tracebacks are in "
            f"{folder}/run.sqlite and in the report",
            err=True,
        )
    return 4 if failed > refused else 3 if failed else 0


def resuming(suite: str, folder: Path) -> str:
    """Command that continues an interrupted sweep, as a shell takes it."""
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
    return RUNS / f"{suite.name}-{datetime.now():%Y%m%d-%H%M%S}"
