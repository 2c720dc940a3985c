"""Why a run fails: as `simval check` says for a user's filter, else by its checks.

The check that goes farthest beyond what it is allowed stands for the others.
"""

import shlex
from collections.abc import Callable
from typing import Any, NamedTuple

from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.judge.algorithms import algorithm_of
from simval.judge.causes import advice, sound, why
from simval.judge.findings import reproduce
from simval.report.algorithms import own
from simval.report.answers import beyond, farthest, size_of
from simval.report.findings import places
from simval.report.formatting import begun, spelled
from simval.report.section import Context
from simval.report.table import Column, Table, tabulated
from simval.spelling import counted, whole
from simval.text import one_line
from simval.verdict import Verdict

FAILING = 8
"""Checks of the first screen's table of those that fail."""


class Reason(NamedTuple):
    """A reason why a run does not pass."""

    said: str  # sentence with a number
    more: str = ""  # what it rests on, and what is not wrong
    look: str = ""
    command: str = ""
    for_what: str = "Compute again"  # what the command is for


def reason(context: Context) -> Reason | None:
    """Reason of a run that fails its checks against theory."""
    far = farthest(context.verdicts)
    if far is None:
        return None
    failed = {v.cell for v in context.verdicts if v.answer == "fail"}
    filters = [cell for cell in context.run.of("filter") if cell.named in failed]
    for name in dict.fromkeys(map(algorithm_of, filters)):
        found = _of_filter(context, name)
        if found is not None:
            return found
    cell = next((c for c in context.run.cells if c.named == far.cell), None)
    who = begun(spelled(far.cell.study))
    if cell is not None and cell.study in OF_ALGORITHMS:
        who = one_line(algorithm_of(cell))
    look = advice(far.cell.study, far.row.statistic.family.name)
    return Reason(
        f"{who}: {size_of(far.row)}.",
        look=f"{begun(look)}." if look else "",
        command=reproduce(far.cell, context.folder),
    )


def _of_filter(context: Context, name: str) -> Reason | None:
    """Reason why a filter fails, and what is right with it."""
    cells = [c for c in context.run.of("filter") if algorithm_of(c) == name]
    causes = why(cells)
    if not causes:
        return None
    more = [cause.rests for cause in causes]
    more += [f"{begun(each)}." for each in sound(cells)]
    command, for_what = reproduce(cells[0].named, context.folder), "Compute again"
    if own(name):  # in other cells, so of other numbers than these
        command, for_what = shlex.join(["simval", "check", name]), "After a change"
    return Reason(
        f"{one_line(name)}: {'; '.join(cause.reason for cause in causes)}.",
        " ".join(filter(None, more)),
        " ".join(filter(None, (cause.look for cause in causes))),
        command,
        for_what,
    )


def failing_table(context: Context) -> Table | None:
    """Table of failing checks by kind, found against expected; None without any."""
    kinds: dict[tuple[object, ...], list[Verdict]] = {}
    for v in context.verdicts:
        if v.answer == "fail":
            key = v.cell.study, v.row.statistic, v.row.predictor
            kinds.setdefault(key, []).append(v)
    if not kinds:
        return None
    cells = {cell.named: cell.name for cell in context.run.cells}
    words = places(context.run.cells)
    fields: dict[Column, Callable[[Verdict], Any]] = {
        Column("check"): lambda v: v.row.statistic.words,
        Column("against"): lambda v: v.row.predictor,
        Column("where"): lambda v: words.get(cells.get(v.cell, ""), "all cells"),
        Column("found", "measured", 3): lambda v: v.row,
        Column("due", "number", 3, shown="expected"): lambda v: v.row.prediction,
        Column("unit", "unit"): lambda v: v.row.unit,
        Column("beyond what is allowed"): beyond,
        Column("cells", "number"): lambda v: len(
            kinds[v.cell.study, v.row.statistic, v.row.predictor]
        ),
        Column("command", "command"): lambda v: reproduce(v.cell, context.folder),
    }
    failing = sum(map(len, kinds.values()))
    total = sum(not v.wide for v in context.judged.verdicts)
    verb = "fails" if failing == 1 else "fail"
    return tabulated(
        filter(None, map(farthest, kinds.values())),
        fields,
        name="failing",
        caption=f"{whole(failing)} of {counted(total, 'check')} {verb}: "
        "of each kind the one that is farthest off",
        shown=FAILING,
    )
