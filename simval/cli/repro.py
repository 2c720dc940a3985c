"""`simval repro`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Final

import click

from simval.cli.options import declared, runs, suites
from simval.errors import InputError
from simval.text import columns

if TYPE_CHECKING:
    from simval.results import Row
    from simval.sweep.repro import Repetition
    from simval.sweep.run import Run

PLAIN: Final = 6
"""Digits of a number that has no standard error."""
MOST: Final = 15
"""Digits beyond which a float has none."""
HEADS: Final = (
    "statistic",
    "measured",
    "standard error",
    "predicted",
    "apart",
    "theory",
)


@declared("repro")
def command(
    cell: str,
    folder: Annotated[
        str,
        "Run to search and to compare with.",
        dict(name="--run", shell_complete=runs),
    ] = "latest",
    suite: Annotated[
        str | None,
        "Suite to search if the run does not have the cell.  [default: the built-in "
        "ones]",
        dict(shell_complete=suites, metavar="SUITE"),
    ] = None,
    plugins: Annotated[
        tuple[str, ...],
        "Where the cell's plug-in is now, if it was moved; may be repeated.",
        dict(name="--plugin", metavar="PLUGIN"),
    ] = (),
    exact: Annotated[bool, "Print all digits."] = False,
) -> int:
    """Compute one CELL again, by its name in a table or a report.

    Prints what the cell measures and what theory predicts, and compares it with the
    run. Exit code 0 if the numbers are equal to the bit, 1 if not, 3 if the run does
    not have the cell or it is refused, 4 if it crashes.
    """
    from simval.sweep.cells import REFUSED
    from simval.sweep.identity import mixture
    from simval.sweep.provenance import file_hashes
    from simval.sweep.repro import find_cell, repeat
    from simval.sweep.run import load_run

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
        how = "was refused" if refused else "crashed"
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
    from simval.sweep.provenance import differences, versions

    for old, new in again.different:
        now = "not measured" if new is None else repr(new.value)
        click.echo(
            f"different: {old.statistic} {old.predictor}: {old.value!r} -> {now}"
        )
    changed = differences(run.manifest["versions"], versions())
    reason = f"; other versions: {'; '.join(changed)}" if changed else ""
    held = run.manifest["files"]
    others = [name for name in files if held.get(name) not in (None, files[name])]
    if others:
        reason += f"; its plug-in has changed: {', '.join(others)}"
    click.echo(f"not equal to {run.folder}{reason}")


def rounded(value: float, error: float) -> str:
    """Write a value as far as the second digit of its standard error."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value:.{PLAIN}g}"
    last = math.floor(math.log10(error)) - 1  # power of ten of the last digit
    first = math.floor(math.log10(abs(value))) if value else last
    return f"{value:.{min(max(first - last, 0), MOST)}e}"


def apart(row: Row) -> str:
    """Distance of a row from its prediction, in standard errors where it has any."""
    if row.prediction is None or row.check == "limit":
        return ""
    difference = row.value - row.prediction
    if row.standard_error > 0.0:
        return f"{difference / row.standard_error:+.1f} s.e."
    return f"{difference:+.1g}" if difference and row.shown else "0"


def beside_theory(rows: Iterable[Row]) -> list[str]:
    """Lines of a table with measured and predicted values."""
    return columns([HEADS, *map(_entries, rows)], -1, 1, 1, 1, 1, -1)


def _entries(row: Row) -> tuple[str, ...]:
    error = row.standard_error
    predicted = "" if row.prediction is None else rounded(row.prediction, error)
    unit = "" if row.unit == "1" else f", {row.unit}"
    return (
        f"{row.statistic}{unit}",
        rounded(row.shown, error),
        f"{error:.1e}" if error else "",
        f"at most {predicted}" if row.check == "limit" else predicted,
        apart(row),
        row.predictor,
    )
