"""`simval gate`."""

from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from simval.gate import BASELINE, GateResult, judge_run, read_baseline, write_baseline
from simval.sweep import load_run
from simval.verdict import Verdict

SHOWN = 40
"""Failures printed one by one; the rest is counted."""


@click.command(name="gate")
@click.argument("run")
@click.option(
    "--baseline",
    type=click.Path(path_type=Path),
    default=BASELINE,
    show_default=True,
    help="Stored statistics to compare with.",
)
@click.option("--update-baseline", metavar="REASON", help="Store this run, and why.")
@click.option(
    "--alpha",
    type=click.FloatRange(0.0, 0.5, min_open=True),
    default=1e-3,
    show_default=True,
    help="False-alarm rate of all checks together.",
)
def command(run: str, baseline: Path, update_baseline: str | None, alpha: float) -> int:
    """Judge RUN (a folder, or `latest`) against theory and the baseline.

    Exit code 0 pass, 1 fail, 3 inconclusive or nothing measured, 4 a cell crashed.
    """
    loaded = load_run(run)
    if update_baseline is not None:
        write_baseline(baseline, loaded, update_baseline)
        click.echo(f"{baseline} written; review and commit it")
    whole = all(cell.status == "done" for cell in loaded.cells)
    first = whole and not baseline.is_file()
    if first:
        write_baseline(baseline, loaded, "first baseline")
    stored = read_baseline(baseline) if whole or baseline.is_file() else None
    result = judge_run(loaded, stored, alpha)
    show(result)
    if first:
        click.echo(
            f"there was no baseline; this run was written to {baseline}: "
            "review it, commit it, and run the gate again",
            err=True,
        )
    return result.exit_code or int(first)


def show(result: GateResult) -> None:
    """Print the verdicts: one table of counts, then every failure in words.

    Parameters
    ----------
    result : GateResult
        What the gate found.
    """
    console = Console(highlight=False, soft_wrap=True)
    console.print(_counts(result))
    bad = [v for v in result.verdicts if v.answer != "pass"]
    lines = [_explained(verdict) for verdict in bad]
    lines += [
        f"changed: {c.cell} {c.statistic}: {c.reason}"
        for c in result.comparisons
        if c.reason
    ]
    lines += [f"{cell.status}: {cell.name}" for cell in result.unfinished]
    for line in lines[:SHOWN]:
        console.print(line, markup=False)
    if len(lines) > SHOWN:
        console.print(f"... and {len(lines) - SHOWN} more; see the report")
    _environment(console, result)
    new = sum(c.change == "new" for c in result.comparisons)
    if new:
        console.print(f"{new} statistics are new; the baseline does not hold them yet")
    console.print(
        f"{result.answer.upper()}: {len(result.verdicts)} checks against theory, "
        f"false-alarm rate {result.alpha:g} for all together; "
        f"{len(result.comparisons)} comparisons with the baseline"
    )


def _counts(result: GateResult) -> Table:
    table = Table(title="verdicts")
    for heading in ("study", "predictor", "check", "pass", "fail", "inconclusive"):
        table.add_column(heading, justify="left" if heading.islower() else "right")
    groups: dict[tuple[str, str, str], list[str]] = {}
    for v in result.verdicts:
        study = v.cell.partition("(")[0]
        key = (study, v.row.predictor, str(v.row.check))
        groups.setdefault(key, []).append(v.answer)
    for key, answers in sorted(groups.items()):
        numbers = (answers.count(a) for a in ("pass", "fail", "inconclusive"))
        table.add_row(*key, *(str(n) for n in numbers))
    changes = [c.change for c in result.comparisons]
    if changes:
        good = changes.count("same") + changes.count("close") + changes.count("new")
        table.add_row(
            "baseline", "", "paired", str(good), str(len(changes) - good), "0"
        )
    return table


def _explained(verdict: Verdict) -> str:
    row = verdict.row
    against = f" against {row.predictor}" if row.predictor else ""
    return (
        f"{verdict.answer}: {verdict.cell} {row.statistic}{against}: {verdict.reason}"
    )


def _environment(console: Console, result: GateResult) -> None:
    changes = [c.change for c in result.comparisons]
    same, close = changes.count("same"), changes.count("close")
    if result.environment:
        console.print(
            "another environment than the baseline's, so compared within the bound "
            f"({same} equal to the bit, {close} close): "
            + "; ".join(result.environment),
            markup=False,
        )
    elif close:
        console.print(
            f"{close} values differ from the baseline in the last bits on the same "
            "versions and processor kernels: the order of some arithmetic changed"
        )
