"""`simval compare`."""

from pathlib import Path

import click
from rich.console import Console

from simval.cli.options import PATH, alpha_option, write
from simval.compare import Difference, RunComparison, compare_runs
from simval.sweep import load_run

SHOWN = 40
"""Changes printed one by one; the others are counted."""


@click.command(name="compare")
@click.argument("run_a")
@click.argument("run_b")
@click.option(
    "--out",
    type=PATH,
    help="Write an HTML page, with both curves of each change in one figure.",
)
@alpha_option
def command(run_a: str, run_b: str, out: Path | None, alpha: float) -> int:
    """Show what changed from RUN_A to RUN_B beyond its uncertainty, largest first.

    Each is a folder, or `latest`. Exit code 0, or 3 if the runs have nothing in
    common. To fail on a change, use `simval gate` with a baseline.
    """
    a, b = load_run(run_a), load_run(run_b)
    comparison = compare_runs(a, b, alpha)
    show(comparison)
    if out is not None:
        from simval.report import render_comparison  # drawing takes a second to load

        write(out, render_comparison(a, b, comparison))
        click.echo(str(out))
    return 0 if comparison.differences else 3


def show(comparison: RunComparison) -> None:
    """Print the changes, then other differences."""
    console = Console(highlight=False, soft_wrap=True)
    changed = comparison.of("changed")
    for difference in changed[:SHOWN]:
        console.print(_line(difference), markup=False)
    if len(changed) > SHOWN:
        console.print(f"... and {len(changed) - SHOWN} more; --out writes them")
    for line in comparison.environment:
        console.print(f"environment: {line}", markup=False)
    for name, missing in (("A", comparison.only_a), ("B", comparison.only_b)):
        if missing:
            console.print(f"{len(missing)} only in {name}: {missing[0]}", markup=False)
    predictions = sum(d.prediction_changed for d in comparison.differences)
    if predictions:
        console.print(f"{predictions} predictions of theory changed")
    if not comparison.differences:
        console.print("the runs have nothing in common")
        return
    console.print(
        f"{len(changed)} of {len(comparison.differences)} common statistics changed "
        f"beyond their uncertainty, {len(comparison.of('moved'))} moved within it on "
        f"the same noise; false-alarm rate {comparison.alpha:g} for all together"
    )


def _line(difference: Difference) -> str:
    a, b, sigmas = difference.a, difference.b, difference.sigmas
    size = "deterministic" if sigmas is None else f"{sigmas:+.1f} standard errors"
    unit = "" if a.unit == "1" else f" {a.unit}"
    relative = difference.relative
    share = "" if relative is None else f", {100.0 * relative:+.3g} %"
    return (
        f"changed: {difference.cells[1]} {difference.name}: "
        f"{a.value:.6g} -> {b.value:.6g}{unit}, {size}{share}"
    )
