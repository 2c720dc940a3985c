"""What `simval sweep` does."""

import shlex
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from simval.cli.options import refuse_if, stated
from simval.cli.progress import CellBar, Quiet
from simval.plugins.builtin import beside_builtin
from simval.plugins.loading import chosen, spelled
from simval.sweep import Suite, load_suite, store
from simval.sweep.cells import REFUSED
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
            )
    except KeyboardInterrupt:
        if (folder / "run.sqlite").exists():
            click.echo(f"to continue: {resuming(suite, folder)}", err=True)
        raise
    with store.opened(folder / "run.sqlite") as database:
        failed = store.failures(database)
    refused = [error.startswith(REFUSED) for _, error in failed]
    for (name, error), known in list(zip(failed, refused, strict=True))[:SHOWN]:
        last = error.strip().splitlines()[-1].removeprefix(REFUSED if known else "")
        click.echo(f"{'refused' if known else 'failed'}: {name}: {last}", err=True)
    if failed and all(refused):
        click.echo(
            f"{len(failed)} of {len(loaded.cells)} cells refused their plug-in; the "
            f"reasons are in {folder}/run.sqlite and in the report",
            err=True,
        )
    elif failed:
        click.echo(
            f"{len(failed)} of {len(loaded.cells)} cells failed; the tracebacks are in "
            f"{folder}/run.sqlite and in the report",
            err=True,
        )
    click.echo(str(folder))
    return 4 if not all(refused) else 3 if failed else 0


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
