"""What changed between runs, in lines: the counts, what moved, and what else."""

from collections.abc import Iterable, Iterator, Sequence

from simval.cli.terminal import say
from simval.judge import Move, RunComparison, Step
from simval.judge.trend import WAYS
from simval.text import one_line

SHOWN = 12
"""Kinds of change printed with the value that moved most; the others are counted."""


def tell(lines: Iterable[str]) -> None:
    """Print lines that may have names from data in them, with their indent."""
    say(line[: len(line) - len(line.lstrip())] + one_line(line) for line in lines)


def headline(found: RunComparison) -> str:
    """How many values changed, and which way."""
    changed, within = found.number("changed"), found.number("moved")
    ways = [f"{found.count(way):,} {way}" for way in WAYS if found.count(way)]
    return (
        f"{changed:,} of {found.total:,} common statistics changed "
        f"beyond their uncertainty{': ' if ways else ''}{', '.join(ways)}; "
        f"{within:,} moved within it on the same noise; false-alarm rate "
        f"{found.alpha:g} for all together"
    )


def move_lines(moves: Sequence[Move], every: bool = False) -> Iterator[str]:
    """What moved, each with the value that moved most, or with every value."""
    for move in moves if every else moves[:SHOWN]:
        yield f"{move.way}: {move.sentence}"
        for step in move.steps if every else move.steps[:1]:
            yield f"    {value_line(step)}"
    hidden = () if every else moves[SHOWN:]
    if hidden:
        values = sum(len(move.steps) for move in hidden)
        yield f"... and {len(hidden)} more kinds ({values} values); --all shows them"


def other_lines(found: RunComparison) -> Iterator[str]:
    """What the runs depend on, what only one has, and changed predictions."""
    for line in found.environment:
        yield f"environment: {line}"
    for name, missing in (("A", found.only_a), ("B", found.only_b)):
        if missing:
            yield f"{len(missing)} only in {name}: {missing[0]}"
    predictions = found.predictions_changed
    if predictions:
        yield f"{predictions} predictions of theory changed"


def value_line(step: Step) -> str:
    """One value before and after, with its cell."""
    sigmas, relative = step.sigmas, step.relative
    size = "no chance involved" if sigmas is None else f"{sigmas:+.3g} standard errors"
    share = "" if relative is None else f", {100.0 * relative:+.3g} %"
    unit = "" if step.statistic.unit == "1" else f" {step.statistic.unit}"
    return (
        f"{step.cell} {step.statistic}: {step.before:.6g} -> {step.after:.6g}{unit}, "
        f"{size}{share}"
    )
