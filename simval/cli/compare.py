"""What `simval compare` does."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median

import click
from rich.console import Console

from simval.cli.options import refuse_if, write
from simval.compare import (
    AlgorithmComparison,
    Difference,
    Merit,
    RunComparison,
    compare_algorithms,
    compare_runs,
)
from simval.compare.algorithms import ACCURACY, FAILURES, HONESTY
from simval.errors import InputError
from simval.sweep import load_run

SHOWN = 40
"""Changes printed one by one; the others are counted."""


def run(
    run_a: str,
    run_b: str | None,
    algorithms: tuple[str, str] | None,
    out: Path | None,
    alpha: float,
) -> int:
    """Do what `simval compare` is asked."""
    if algorithms:
        return _algorithms(run_a, run_b, algorithms, out, alpha)
    if run_b is None:
        msg = "give two runs, or one with `--algorithms A B`"
        raise InputError(msg)
    a, b = load_run(run_a), load_run(run_b)
    comparison = compare_runs(a, b, alpha)
    show(comparison)
    if out is not None:
        from simval.report import render_comparison  # drawing takes a second to load

        write(out, render_comparison(a, b, comparison))
        click.echo(str(out))
    return 0 if comparison.differences else 3


def _algorithms(
    run_a: str,
    run_b: str | None,
    names: tuple[str, str],
    out: Path | None,
    alpha: float,
) -> int:
    """Compare two algorithms of one run."""
    refuse_if(run_b is not None, "`--algorithms` compares within one run; give one run")
    refuse_if(
        out is not None,
        "`--out` shows two runs; `simval report` has the table of all algorithms",
    )
    run = load_run(run_a)
    found = compare_algorithms(run, *names, alpha)
    show_algorithms(found)
    calls = run.timing.get("calls", {})
    times = _times_of(found, calls)
    if times is not None:
        click.echo(
            f"a call of {found.names[0]} takes {times:.2g} times that of "
            f"{found.names[1]} (processor time, not judged)"
        )
    return 0 if found.merits else 3


def show_algorithms(found: AlgorithmComparison) -> None:
    """Print in what the first is better or worse, and the bound of the rest."""
    console = Console(highlight=False, soft_wrap=True)
    first, second = found.names
    apart = [m for m in found.merits if m.standing != "same"]
    for merit in apart[:SHOWN]:
        console.print(_merit_line(merit, first, second), markup=False)
    if len(apart) > SHOWN:
        console.print(f"... and {len(apart) - SHOWN} more")
    for line in _same_lines(found):
        console.print(line, markup=False)
    if found.alone:
        one = found.alone[0]
        console.print(f"{len(found.alone)} cells of one alone: {one}", markup=False)
    if not found.merits:
        console.print(f"{first} and {second} have nothing in common", markup=False)
        return
    counts = ", ".join(
        f"{word} in {len(found.of(word))}" for word in ("better", "worse", "same")
    )
    console.print(
        f"{first} beside {second}: {counts} of {len(found.merits)}; false-alarm rate "
        f"{found.alpha:g} for all together",
        markup=False,
    )


def _merit_line(merit: Merit, first: str, second: str) -> str:
    if merit.what == ACCURACY:
        size = f"{100.0 * abs(merit.difference):.3g} %"
        if merit.error > 0.0:
            size += f" ± {100.0 * merit.error:.2g} %"
        return (
            f"{merit.standing}: {first} has an RMS error "
            f"{'smaller' if merit.standing == 'better' else 'greater'} by {size} than "
            f"{second} at {merit.setting} ({merit.a:.5g} and {merit.b:.5g} times the "
            "bound)"
        )
    error = f" ± {merit.error:.2g}" if merit.error > 0.0 else ""
    where = f" at {merit.setting}" if merit.error > 0.0 else ""
    return (
        f"{merit.standing}: {merit.what}{where}: {first} {merit.a:.4g}, {second} "
        f"{merit.b:.4g}, difference {merit.difference:+.3g}{error}"
    )


def _same_lines(found: AlgorithmComparison) -> Iterator[str]:
    """Say of each kind of quality that is the same how great a difference may be."""
    same = found.of("same")
    for what in (ACCURACY, HONESTY):
        own = [merit for merit in same if merit.what == what]
        if own:
            widest = max(merit.within for merit in own)
            bound = f"{100.0 * widest:.2g} %" if what == ACCURACY else f"{widest:.2g}"
            yield (
                f"same: {what}, settings: {len(own)}: no difference beyond chance, and "
                f"none above {bound} (95 % each)"
            )
    classes = sum(merit.what.startswith(FAILURES) for merit in same)
    if classes:
        yield f"same: {FAILURES}, classes: {classes}"


def _times_of(
    found: AlgorithmComparison, calls: Mapping[str, Mapping[str, float]]
) -> float | None:
    """How many times as long a call takes, the median over the cells of both."""
    pairs = {merit.cells for merit in found.merits}
    ratios = sorted(
        calls[a]["ratio"] / calls[b]["ratio"]
        for a, b in pairs
        if a in calls and b in calls
    )
    return median(ratios) if ratios else None


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
