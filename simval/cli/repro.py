"""`simval repro`."""

import click

from simval.errors import InputError
from simval.sweep.provenance import differences, versions
from simval.sweep.repro import find_cell, repeat
from simval.sweep.run import load_run


@click.command(name="repro")
@click.argument("cell")
@click.option(
    "--run", "folder", default="latest", show_default=True, help="Run to compare with."
)
def command(cell: str, folder: str) -> int:
    """Compute one CELL again, by the name that a table or a report gives it.

    Says whether it is equal to the bit to what the run holds. Exit code 0 if so, 1 if
    not, 3 where the run does not hold it.
    """
    try:
        run = load_run(folder)
    except InputError:
        if folder != "latest":
            raise
        run = None  # no run at all: only the numbers are shown
    found = repeat(find_cell(cell, run), run)
    for row in found.outcome.rows:
        error = f" +- {row.standard_error!r}" if row.standard_error else ""
        against = f"  {row.predictor}: {row.prediction!r}" if row.predictor else ""
        click.echo(f"{row.statistic} = {row.value!r}{error} {row.unit}{against}")
    if run is None or found.stored is None:
        where = "there is no run" if run is None else f"{run.folder} has no such cell"
        click.echo(f"{where}, so there is nothing to compare with")
        return 3
    if found.equal:
        click.echo(f"equal to the bit to {run.folder}: {len(found.stored.rows)} rows")
        return 0
    for old, new in found.different:
        now = "not measured" if new is None else repr(new.value)
        click.echo(
            f"different: {old.statistic} {old.predictor}: {old.value!r} -> {now}"
        )
    changed = differences(run.manifest["versions"], versions())
    reason = f"; other versions: {'; '.join(changed)}" if changed else ""
    click.echo(f"not equal to {run.folder}{reason}")
    return 1
