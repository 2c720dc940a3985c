"""What did not pass the gate, in lines: each check, or in short by kind."""

from collections.abc import Iterator, Sequence

from simval.judge import GateResult, findings
from simval.judge.findings import Group, details, groups

LINES = 8
"""Lines printed of what did not pass; two more say how many others, and the answer."""

NAMED = 6
"""Kinds of the others that are named."""


def every_line(result: GateResult) -> Iterator[str]:
    """Each finding that did not pass, one by one."""
    for finding in findings(result):
        if finding.answer != "pass":
            yield from _indented(details(finding))


def short_lines(result: GateResult) -> Iterator[str]:
    """What did not pass: one by one if that is short, else by study and kind."""
    lines = list(every_line(result))
    found = groups(result)
    if len(lines) <= LINES:
        yield from lines
        return
    shown: list[str] = []
    hidden = list(found)
    while hidden and (not shown or len(shown) + len(hidden[0].lines) <= LINES):
        shown += _indented(hidden.pop(0).lines)
    yield from shown
    yield _rest(hidden) + _advice(found)


def _rest(hidden: Sequence[Group]) -> str:
    """What is not shown, and how to see it."""
    if not hidden:
        return "--all prints every one"
    count = sum(len(group.findings) for group in hidden)
    names = list(dict.fromkeys(group.what for group in hidden))
    more = "; ..." if len(names) > NAMED else ""
    return (
        f"... and {count} more ({'; '.join(names[:NAMED])}{more}): --all prints every "
        "one, --json FILE writes them"
    )


def _advice(found: Sequence[Group]) -> str:
    """What to do where the only failures are changes from the baseline."""
    failed = [group.worst for group in found if group.worst.answer == "fail"]
    changed = failed and all(f.tier == "baseline" and f.step for f in failed)
    return "; if the change is intended, --update-baseline 'why'" if changed else ""


def _indented(lines: Sequence[str]) -> Iterator[str]:
    first, *rest = lines
    yield first
    yield from (f"    {line}" for line in rest)
