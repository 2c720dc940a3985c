"""What `simval repro` does."""

from collections.abc import Mapping

import click

from simval.cli.rounding import beside_theory
from simval.errors import InputError
from simval.results import Row
from simval.sweep.cells import REFUSED
from simval.sweep.identity import mixture
from simval.sweep.provenance import differences, file_hashes, versions
from simval.sweep.repro import Repetition, find_cell, repeat
from simval.sweep.run import Run, load_run


def run(
    cell: str, folder: str, suite: str | None, plugins: tuple[str, ...], exact: bool
) -> int:
    """Do what `simval repro` is asked."""
    try:
        run = load_run(folder)
    except InputError:
        if folder != "latest":
            raise
        run = None  # there is no run: only the numbers are shown
    wanted = find_cell(cell.strip(), run, plugins, suite)
    again = repeat(wanted, run)
    if again.error:
        click.echo(again.error.rstrip(), err=True)
        refused = again.error.startswith(REFUSED)
        how = "refused its plug-in" if refused else "crashed"
        click.echo(f"the cell {how}: {wanted.name}", err=True)
        return 3 if refused else 4
    rows = again.outcome.rows
    for line in map(_exactly, rows) if exact else beside_theory(rows):
        click.echo(line)
    if run is None or again.stored is None:
        where = "there is no run" if run is None else f"{run.folder} has no such cell"
        click.echo(f"{where}, so there is nothing to compare with")
        return 3
    if words := mixture(run.manifest):
        click.echo(words)
    if again.equal:
        click.echo(f"equal to the bit to {run.folder}: {len(again.stored.rows)} rows")
        return 0
    grid = {wanted.study: wanted.parameters.model_dump()}
    _show_difference(again, run, file_hashes(grid))
    return 1


def _exactly(row: Row) -> str:
    error = f" +- {row.standard_error!r}" if row.standard_error else ""
    against = f"  {row.predictor}: {row.prediction!r}" if row.predictor else ""
    return f"{row.statistic} = {row.value!r}{error} {row.unit}{against}"


def _show_difference(again: Repetition, run: Run, files: Mapping[str, str]) -> None:
    for old, new in again.different:
        now = "not measured" if new is None else repr(new.value)
        click.echo(
            f"different: {old.statistic} {old.predictor}: {old.value!r} -> {now}"
        )
    changed = differences(run.manifest["versions"], versions())
    reason = f"; other versions: {'; '.join(changed)}" if changed else ""
    held = run.manifest.get("files", {})
    others = [name for name in files if held.get(name) not in (None, files[name])]
    if others:
        reason += f"; its plug-in has changed: {', '.join(others)}"
    click.echo(f"not equal to {run.folder}{reason}")
