"""Worse than before: what changed from the baseline, or from another run.

The gate and the comparison say what changed beyond its uncertainty; here it is counted
by direction (`simval.statistics.Family.better`), and the change of the greatest size
comes first.
"""

import shlex
from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import Any, NamedTuple

from simval.change import question
from simval.judge import Comparison, Step
from simval.report.answers import Block, Line, percent, rounded
from simval.report.section import Against, Context
from simval.sweep import Run
from simval.verdict import WORST_FIRST, Answer

NOTE = (
    "A change counts beyond its uncertainty: on the same noise beyond rounding, on "
    "other noise at the stated false-alarm rate for all together. Errors are better "
    "small, stated covariances better true."
)
KINDS = {"better": "better", "worse": "worse", "neither": "changed"}
ORDER = ("worse", "better", "changed", "lost")
WORDS = {"lost": "no longer measured", "changed": "changed otherwise"}


HEADS = {
    "worse": "Worse than",
    "better": "Better than",
    "changed": "Different from",
    "lost": "Less is measured than in",
}


class Change(NamedTuple):
    """One statistic that changed."""

    kind: str  # one of `ORDER`
    what: str
    where: str  # name of the cell
    size: float  # in standard errors, or relative where it is without chance
    said: str  # by how much


def comparable(run: Run, baseline: Mapping[str, Any] | None) -> bool:
    """Whether a baseline is of the run's suite, or the run holds all of its cells.

    Cells are the same whatever their seed and effort. Of the same suite one is enough.
    """
    if baseline is None:
        return False
    stored = {_key(cell.study, cell.parameters) for cell in baseline["cells"].values()}
    common = stored & {_key(cell.study, cell.parameters) for cell in run.cells}
    same_suite = baseline["environment"].get("suite") == run.manifest["suite"]
    return bool(common) and (same_suite or common == stored)


def _key(study: str, parameters: Mapping[str, Any]) -> tuple[str, str]:
    return study, str(question(parameters))


def worse_than_before(context: Context) -> Block:
    """Answer what changed from what the page is to be compared with."""
    lines: list[Line] = []
    headlines = []
    if context.baseline is not None:
        headline, own = _from_baseline(context)
        headlines.append(headline)
        lines += own
    if context.against is not None:
        headline, own = _from_run(context, context.against)
        headlines.append(headline)
        lines += own
    if not headlines:
        run = shlex.quote(context.folder)
        headlines.append("Not compared")
        lines += [
            Line(
                what="Ask",
                said="with the stored baseline:",
                command=f"simval report {run} --baseline",
            ),
            Line(
                what="or",
                said="with another run:",
                command=f"simval report {run} --against RUN",
            ),
        ]
    answers = {line.answer for line in lines}
    worst: Answer = next((a for a in WORST_FIRST if a in answers), "pass")
    asked = context.baseline is not None or context.against is not None
    return Block(
        title="Worse than before",
        answer=worst,
        headline="; ".join(headlines),
        lines=lines,
        note=NOTE if asked else "",
        fold="more",
    )


def _from_baseline(context: Context) -> tuple[str, list[Line]]:
    """What the gate found beside the baseline, by direction."""
    assert context.baseline is not None
    if not comparable(context.run, context.baseline):
        stored = str(context.baseline["environment"].get("suite"))
        own = context.run.manifest["suite"]
        said = (
            f"it is of the suite {stored}, this run of {own}"
            if stored != own
            else "no cell of it has the study and the parameters of one of this run"
        )
        line = Line(what="Baseline", said=said, answer="inconclusive")
        return "Cannot be compared with the baseline", [line]
    compared = context.judged.comparisons
    changes = [_change(c, c.step) for c in compared if c.answer == "fail"]
    kinds = context.judged.changes
    unresolved, new = kinds["unresolved"], kinds["new"]
    same = kinds.total() - len(changes) - unresolved - new
    notes = [f"{kinds['same']:,} of them to the bit"] if same else []
    notes += [f"{unresolved:,} not resolved by so many trials"] if unresolved else []
    notes += [f"{new:,} are new"] if new else []
    notes += ["another environment"] if context.judged.environment else []
    return _told("the baseline", changes, same, unresolved, notes)


def _change(comparison: Comparison, step: Step | None) -> Change:
    kind, size, said = "lost", inf, comparison.reason
    if comparison.change not in ("missing", "unjudged"):
        kind = "changed"
        if comparison.change == "changed" and step is not None:
            kind = KINDS[step.standing]
            size, said = _size(step.before, step.after, comparison.sigmas)
    where = str(comparison.cell)
    return Change(kind, comparison.statistic, where, size, said)


def _from_run(context: Context, against: Against) -> tuple[str, list[Line]]:
    """What the comparison with another run found, by direction."""
    found, name = against.changes, against.run.folder.name
    if not found.total:
        suites = [run.manifest["suite"] for run in (against.run, context.run)]
        why = (
            f"it is of the suite {suites[0]}, this one of {suites[1]}"
            if suites[0] != suites[1]
            else "no cell of it has the study and the parameters of one of this run"
        )
        line = Line(what=name, said=why, answer="inconclusive")
        return f"Cannot be compared with {name}", [line]
    changes = []
    for d in found.of("changed"):
        kind = KINDS[d.standing]
        sigmas = float("nan") if d.sigmas is None else d.sigmas
        size, said = _size(d.a.value, d.b.value, sigmas)
        changes.append(Change(kind, str(d.a.statistic), d.cells[1], size, said))
    moved, same = len(found.of("moved")), len(found.of("same"))
    notes = [f"{moved:,} moved within their uncertainty"] if moved else []
    alone = len(found.only_a) + len(found.only_b)
    notes += [f"{alone:,} only in one run"] if alone else []
    notes += ["another environment"] if found.environment else []
    return _told(name, changes, same + moved, 0, notes)


def _told(
    name: str,
    changes: Sequence[Change],
    same: int,
    unresolved: int,
    notes: Sequence[str],
) -> tuple[str, list[Line]]:
    """The answer in a few words, and a line for each kind of change."""
    of = {kind: [c for c in changes if c.kind == kind] for kind in ORDER}
    total = len(changes) + same + unresolved
    lines = [_line(kind, own) for kind, own in of.items() if own]
    said = f"{same:,} of {total:,} statistics"
    detail = f": {'; '.join(notes)}" if notes else ""
    unclear: Answer = "inconclusive" if unresolved else "pass"
    lines.append(Line(what="Same", said=f"{said}{detail}", answer=unclear))
    first = next((kind for kind in ORDER if of[kind]), "")
    if first:
        return f"{HEADS[first]} {name}", lines
    return f"{'No worse than' if unresolved else 'Same as'} {name}", lines


def _line(kind: str, changes: Sequence[Change]) -> Line:
    most = max(changes, key=lambda c: c.size)
    which = "first" if kind == "lost" else "most"
    by = f": {most.said}" if most.said and kind != "lost" else ""
    answer: Answer = "pass" if kind == "better" else "fail"
    return Line(
        what=WORDS.get(kind, kind).capitalize(),
        said=f"{len(changes):,}, {which} {most.what}{by}",
        where=most.where,
        answer=answer,
    )


def _size(old: float, new: float, sigmas: float) -> tuple[float, str]:
    """How great a change is: to sort by, and in words."""
    share = (abs(new) - abs(old)) / abs(old) if old else inf
    relative = "" if not isfinite(share) else f"{'+' if share > 0 else '−'}"
    if relative:
        relative += percent(abs(share))
    step = relative or f"from {rounded(old, 3)} to {rounded(new, 3)}"
    if isfinite(sigmas):
        return abs(sigmas), f"{step} ({abs(sigmas):.1f} standard errors)"
    return abs(share), step
