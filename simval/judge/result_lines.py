"""The gate's answer as an account, its failures and changes between runs as text."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from simval.account import Account, Fact, Reply
from simval.judge import GateResult, Move, RunComparison, Step, findings, headline
from simval.judge.findings import Finding, Group, details, groups, rounded_up
from simval.judge.trend import WAYS
from simval.text import one_line

LINES = 8
"""Lines printed of what did not pass; two more say how many others, and the answer."""

NAMED = 6
"""Kinds of the others that are named."""


def gate_account(result: GateResult) -> Account:
    """State the gate's answer: whether the run passes, why, and what to do.

    What did not pass stands below it, one by one (`short_lines`).
    """
    return Account(
        title="Gate of",
        source=Path(result.folder).name,
        replies=(
            Reply(
                title="Does the run pass?",
                headline=headline(result),
                answer=result.answer,
                do=" ".join(_to_do(result)),
                lines=(f"The false-alarm rate is {result.alpha:g} for all together.",),
            ),
        ),
        facts=[Fact("note", one_line(each), notable=True) for each in result.notes],
    )


def _to_do(result: GateResult) -> Iterator[str]:
    found = groups(result)
    if result.review:
        yield f"{result.review[0].upper()}{result.review[1:]}."
    if result.never_run:
        yield "Resume the sweep with --resume."
    few = [x.more for g in found for x in g.findings if x.more is not None]
    if few:
        yield f"Take {rounded_up(max(few))} times as many trials."
    failed = [group.worst for group in found if group.worst.answer == "fail"]
    if failed and all(f.tier == "baseline" and f.step for f in failed):
        yield "If the change is intended, accept it with --update-baseline 'why'."
    elif any(each.command for each in failed):
        yield "Run a failing cell again by its command below."


def every_line(result: GateResult) -> Iterator[str]:
    """Each finding that did not pass, one by one."""
    for finding in _below(result):
        yield from _indented(details(finding))


def _below(result: GateResult) -> list[Finding]:
    """Findings that did not pass, but for a missing baseline: the answer says that."""
    return [f for f in findings(result, passes=False) if f.check != "first"]


def short_lines(result: GateResult) -> Iterator[str]:
    """Findings that did not pass: one by one if few, else by study and kind.

    All that need more trials are one line.
    """
    found = [group for group in groups(result) if group.worst.check != "first"]
    short = [group.line for group in found if group.worst.more is not None]
    lines = [
        line
        for finding in _below(result)
        if finding.more is None
        for line in _indented(details(finding))
    ]
    if len(lines) + len(short) <= LINES:
        yield from (*lines, *short)
        return
    shown: list[str] = []
    hidden = list(found)
    while hidden and (not shown or len(shown) + len(hidden[0].lines) <= LINES):
        shown += _indented(hidden.pop(0).lines)
    yield from shown
    yield _rest(hidden)


def _rest(hidden: Sequence[Group]) -> str:
    """Findings that are not shown, and how to see them."""
    if not hidden:
        return "--all prints every one"
    count = sum(len(group.findings) for group in hidden)
    names = list(dict.fromkeys(group.what for group in hidden))
    more = "; ..." if len(names) > NAMED else ""
    return (
        f"... and {count} more ({'; '.join(names[:NAMED])}{more}): --all prints every "
        "one, --json FILE writes them"
    )


def _indented(lines: Sequence[str]) -> Iterator[str]:
    first, *rest = lines
    yield first
    yield from (f"    {line}" for line in rest)


SHOWN = 12
"""Kinds of change printed with the value that moved most; the others are counted."""


def changes_headline(found: RunComparison) -> str:
    """Number of values that changed, by direction."""
    changed, within = found.kinds.count("changed"), found.kinds.count("moved")
    ways = [f"{found.count(way):,} {way}" for way in WAYS if found.count(way)]
    return (
        f"{changed:,} of {found.total:,} common statistics changed "
        f"beyond their uncertainty{': ' if ways else ''}{', '.join(ways)}; "
        f"{within:,} moved within it on the same noise; false-alarm rate "
        f"{found.alpha:g} for all together"
    )


def move_lines(moves: Sequence[tuple[str, Move]], every: bool = False) -> Iterator[str]:
    """Moves after their heads, each with the value that moved most, or with all."""
    for head, move in moves if every else moves[:SHOWN]:
        yield f"{head}: {move.sentence}"
        for step in move.steps if every else move.steps[:1]:
            yield f"    {value_line(step)}"
    hidden = () if every else moves[SHOWN:]
    if hidden:
        values = sum(len(move.steps) for _, move in hidden)
        yield f"... and {len(hidden)} more kinds ({values} values); --all shows them"


def other_lines(found: RunComparison) -> Iterator[str]:
    """Differences of environment, cells that only one run has, changed predictions."""
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
