r"""The first screen's answers on accuracy and speed, as data.

**As theory says**: how far the measured sizes of errors are from the predicted ones.
A size is a standard deviation or an RMS error, and a variance or a normalised squared
error by half of its relative deviation. Of a study, with values :math:`v_i`, standard
errors :math:`s_i` and predictions :math:`p_i` of its sizes, each judged and sampled
without control variates, and k = 1 or 1/2,

.. math:: \bar d = \frac{\sum n_i k_i (v_i/p_i - 1)}{\sum n_i}  \tag{T1}

is the mean deviation, weighted by the numbers of samples because these do not depend on
the values. Its standard error takes the sizes of one cell as one and the same chance,
and those of two cells as independent, as their streams are; cells of studies that set
algorithms side by side share their chance too. A statistic that is compared with
several theories counts once, with the exact one if it is among them.

**Worse than before**: what changed from the baseline, or from another run. The gate and
the comparison say what changed beyond its uncertainty; here it is counted by direction
(`simval.statistics.Family.better`), and the greatest change comes first.
"""

import shlex
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from simval.change import question
from simval.judge import Comparison, Step
from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.judge.findings import rounded_up
from simval.judge.gate import outcome
from simval.report.curves import simultaneous
from simval.report.findings import percent
from simval.report.formatting import begun, spelled
from simval.report.section import Against, Context, home
from simval.results import CellName
from simval.spelling import measured, rounded
from simval.statistics import (
    ALLAN_ERROR,
    BUDGET,
    COVARIANCE,
    EXACT,
    NEES,
    NIS,
    RMS,
    RMS_OVER_BOUND,
    SD,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    Statistic,
)
from simval.sweep import Run
from simval.text import ROUNDING
from simval.verdict import (
    WORST_FIRST,
    Answer,
    Verdict,
    overall,
    powers_by_study,
    worst,
)

# ---- lines and blocks

SHOWN = 3
"""Lines of an answer that stand outside its fold."""

IMPORTANCE = (
    "calibration",
    "attitude",
    "filter",
    "estimator",
    "calibrator",
    "magnetometer",
    "gyroscope",
    "end_to_end",
    "detector",
    "diagnosis",
    "coverage",
    "noise_model",
    "attitude_vectors",
    "ladder",
)
"""Studies in the order in which a reader asks for them; the others follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One thing that is answered."""

    what: str  # what it is about; the link, if there is one, is on it
    said: str
    where: str = ""  # in which cell
    link: str = ""  # anchor of the section that shows it
    answer: Answer = "pass"  # of its checks
    command: str = ""  # what computes the cell again


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """The answer to one question, the most important first."""

    title: str
    answer: Answer
    headline: str  # the answer in a few words; may be empty
    lines: Sequence[Line]
    note: str  # how the numbers were chosen
    fold: str = ""  # words of the fold behind which the other lines are

    @property
    def first(self) -> Sequence[Line]:
        """Lines that stand on the page at once."""
        return self.lines[:SHOWN]

    @property
    def rest(self) -> Sequence[Line]:
        """Lines behind the fold."""
        return self.lines[SHOWN:]


def linked(block: Block, anchors: Container[str]) -> Block:
    """The block, its links only to what the page has."""
    lines = [
        line if line.link in anchors else replace(line, link="") for line in block.lines
    ]
    return replace(block, lines=lines)


def in_order(studies: Sequence[str]) -> list[str]:
    """Studies, the most important first."""
    known = {name: place for place, name in enumerate(IMPORTANCE)}
    unique = list(dict.fromkeys(studies))
    return sorted(unique, key=lambda name: known.get(name, len(known)))


# ---- as theory says

SIZES = {RMS: 1.0, SD: 1.0, RMS_OVER_BOUND: 1.0, BUDGET: 1.0} | dict.fromkeys(
    (COVARIANCE, NEES, NIS, SQUARED_ERROR, VARIANCE_OVER_BOUND, ALLAN_ERROR), 0.5
)
"""Families that are sizes of errors, and k of eq. (T1)."""

NOTE_ON_THEORY = (
    "“On average”: mean deviation of measured from predicted sizes of errors (standard "
    "deviations; half of that of a variance), weighted by the number of trials, and "
    "its standard error; one value may be farther off. “See”: the smallest relative "
    "change of its prediction that a check fails. Each check by itself is in the table "
    "of checks."
)


class Deviation(NamedTuple):
    """Mean relative deviation of the sizes of a study, eq. (T1), and its error."""

    value: float
    error: float

    @property
    def said(self) -> str:
        """It in percent, in words."""
        return f"on average {measured(100.0 * self.value, 100.0 * self.error)} % off"


def as_theory_says(context: Context) -> Block:
    """Answer whether the measured agrees with theory, and how closely."""
    verdicts = context.judged.verdicts
    studies = in_order([v.cell.study for v in verdicts])
    lines = [
        _study_line(s, [v for v in verdicts if v.cell.study == s]) for s in studies
    ]
    missing = _missing(context)
    more = [v.more for v in verdicts if v.more == v.more]
    if more:
        said = f"{rounded_up(max(more))} times as many would do"
        missing.append(Line(what="Too few trials", said=said, answer="inconclusive"))
    return Block(
        title="As theory says",
        answer=overall(verdicts),
        headline=begun(outcome(replace(context.judged, comparisons=(), first=""))),
        lines=missing + sorted(lines, key=lambda line: WORST_FIRST.index(line.answer)),
        note=f"{_farthest(verdicts)}{NOTE_ON_THEORY}",
        fold="more studies",
    )


def _missing(context: Context) -> list[Line]:
    """A line on what should have been measured and was not; none without."""
    judged = context.judged
    counts: dict[str, dict[str, int]] = {}
    for cell in judged.unfinished:
        words = {"pending": "never run"}.get(cell.ending, cell.ending)
        own = counts.setdefault(cell.study, {})
        own[words] = own.get(words, 0) + 1
    said = [
        f"{spelled(study)} ({', '.join(f'{n} {w}' for w, n in own.items())})"
        for study, own in counts.items()
    ]
    if judged.gaps:
        n = len(judged.gaps)
        said.append(f"{n} thing{'s' if n > 1 else ''} not measured as stated")
    if not said:
        return []
    crashed = any(cell.ending == "crashed" for cell in judged.unfinished)
    told = f"cells of {'; '.join(said)}" if counts else said[0]
    answer: Answer = "fail" if crashed else "inconclusive"
    return [Line(what="Not measured", said=told, link="failures", answer=answer)]


def _study_line(study: str, verdicts: Sequence[Verdict]) -> Line:
    failing = [v for v in verdicts if v.answer == "fail"]
    unclear = sum(v.answer == "inconclusive" for v in verdicts)
    counted = sum(not v.wide for v in verdicts)
    checks = f"{counted:,} check{'' if counted == 1 else 's'}"
    said = []
    if failing:  # the one that fails by most, and by how much
        far = max(failing, key=lambda v: abs(v.sigmas) if v.sigmas == v.sigmas else inf)
        by = f", {far.sigmas:+.1f} standard errors" if far.sigmas == far.sigmas else ""
        fail = "fails:" if len(failing) == 1 else "fail, most"
        said.append(f"{len(failing):,} of {checks} {fail} {far.row.statistic}{by}")
    if unclear:
        said.append(f"{unclear:,} of {checks} inconclusive")
    found = deviation(study, verdicts)
    if found is not None and not failing and abs(found.value) + found.error < 1.0:
        said.append(found.said)
    if not failing and not unclear:
        said += [checks, *map(_power_words, powers_by_study(verdicts).values())]
    return Line(
        what=begun(spelled(study)),
        said="; ".join(said),
        link="disagreements" if failing else home(study),
        answer=worst(v.answer for v in verdicts),
    )


def _power_words(median: float) -> str:
    """Median power of a study's checks, in words."""
    change = f"a change of {percent(median)}" if median > ROUNDING else "any change"
    return f"half see {change}"


def deviation(study: str, verdicts: Sequence[Verdict]) -> Deviation | None:
    """Mean relative deviation of a study's sizes from their predictions, eq. (T1)."""
    parts: dict[CellName, list[tuple[float, float, float]]] = {}
    for verdict in _sizes(verdicts):
        row, k = verdict.row, SIZES[verdict.row.statistic.family]
        by = row.prediction or 1.0
        numbers = (row.n, k * (row.value / by - 1.0), k * row.standard_error / by)
        parts.setdefault(verdict.cell, []).append(numbers)
    if not parts:
        return None
    total = sum(n for rows in parts.values() for n, _, _ in rows)
    mean = sum(n * d for rows in parts.values() for n, d, _ in rows) / total
    cells = [sum(n * e for n, _, e in rows) / total for rows in parts.values()]
    error = sum(cells) if study in OF_ALGORITHMS else float(np.linalg.norm(cells))
    return Deviation(mean, error)


def _sizes(verdicts: Sequence[Verdict]) -> Iterable[Verdict]:
    """Judged and sampled sizes, each once."""
    found: dict[tuple[CellName, Statistic], Verdict] = {}
    for verdict in verdicts:
        row = verdict.row
        off_diagonal = (
            row.statistic.family == COVARIANCE and len(set(row.statistic.entries)) > 1
        )
        if (
            verdict.p_value is None
            or row.check == "control"
            or row.statistic.family not in SIZES
            or off_diagonal
            or not (row.prediction or 0.0) > 0.0
            or not verdict.cell.name
        ):
            continue
        key = (verdict.cell, row.statistic)
        if key not in found or row.predictor == EXACT:
            found[key] = verdict
    return found.values()


def _farthest(verdicts: Sequence[Verdict]) -> str:
    """How far beyond its remainder a check goes at most, and how far chance does."""
    beyond = [
        (abs(v.row.value - (v.row.prediction or 0.0)) - v.row.remainder)
        / v.row.standard_error
        for v in verdicts
        if v.p_value is not None
    ]
    if not beyond:
        return ""
    return (
        f"The farthest of {len(beyond):,} sampled checks lies {max(*beyond, 0.0):.1f} "
        "standard errors beyond its theory's stated remainder; chance alone exceeds "
        f"{simultaneous(len(beyond)):.1f} among so many in one run of twenty. "
    )


# ---- worse than before

NOTE_ON_CHANGES = (
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
    """True if a baseline is of the run's suite, or the run holds all of its cells.

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
    told: list[tuple[str, list[Line]]] = []
    if context.baseline is not None:
        told.append(_from_baseline(context, context.baseline))
    if context.against is not None:
        told.append(_from_run(context, context.against))
    note, report = NOTE_ON_CHANGES, f"simval report {shlex.quote(context.folder)}"
    if not told:
        note = ""
        ways = (
            ("Ask", "with the stored baseline:", f"{report} --baseline"),
            ("or", "with another run:", f"{report} --against RUN"),
        )
        lines = [Line(what=what, said=how, command=asked) for what, how, asked in ways]
        told.append(("Not compared", lines))
    lines = [line for _, own in told for line in own]
    return Block(
        title="Worse than before",
        answer=worst(line.answer for line in lines),
        headline="; ".join(headline for headline, _ in told),
        lines=lines,
        note=note,
        fold="more",
    )


def _apart(name: str, what: str, stored: str, own: str) -> tuple[str, list[Line]]:
    """Two runs that have no statistic in common."""
    said = "it has no cell with the study and parameters of a cell of this run"
    if stored != own:
        said = f"it is of the suite {stored}, this run of {own}"
    line = Line(what=what, said=said, answer="inconclusive")
    return f"Cannot be compared with {name}", [line]


def _from_baseline(
    context: Context, baseline: Mapping[str, Any]
) -> tuple[str, list[Line]]:
    """Changes that the gate found against the baseline, by direction."""
    if not comparable(context.run, baseline):
        stored = str(baseline["environment"].get("suite"))
        own = context.run.manifest["suite"]
        return _apart("the baseline", "Baseline", stored, own)
    compared = context.judged.comparisons
    changes = [_change(c) for c in compared if c.answer == "fail"]
    kinds = context.judged.changes
    unresolved, new = kinds["unresolved"], kinds["new"]
    same = kinds.total() - len(changes) - unresolved - new
    notes = [f"{kinds['same']:,} of them to the bit"] if same else []
    notes += [f"{unresolved:,} not resolved by so many trials"] if unresolved else []
    notes += [f"{new:,} are new"] if new else []
    notes += ["another environment"] if context.judged.environment else []
    return _told("the baseline", changes, same, unresolved, notes)


def _change(comparison: Comparison) -> Change:
    if comparison.change == "changed" and comparison.step is not None:
        return _of_step(comparison.step)
    kind = "lost" if comparison.change in ("missing", "unjudged") else "changed"
    where = str(comparison.cell)
    return Change(kind, comparison.statistic, where, inf, comparison.reason)


def _of_step(step: Step) -> Change:
    size, said = _size(step.before, step.after, step.sigmas)
    return Change(KINDS[step.standing], str(step.statistic), step.cell, size, said)


def _from_run(context: Context, against: Against) -> tuple[str, list[Line]]:
    """Changes against another run, by direction."""
    found, name = against.changes, against.run.folder.name
    if not found.total:
        suites = [run.manifest["suite"] for run in (against.run, context.run)]
        return _apart(name, name, *suites)
    changes = [_of_step(step) for step in found.of("changed")]
    same = found.kinds.count("same")
    alone = len(found.only_a) + len(found.only_b)
    notes = [f"{alone:,} only in one run"] if alone else []
    notes += ["another environment"] if found.environment else []
    return _told(name, changes, same, 0, notes)


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
    lines = [_kind_line(kind, own) for kind, own in of.items() if own]
    said = f"{same:,} of {total:,} statistics"
    detail = f": {'; '.join(notes)}" if notes else ""
    unclear: Answer = "inconclusive" if unresolved else "pass"
    lines.append(Line(what="Same", said=f"{said}{detail}", answer=unclear))
    first = next((kind for kind in ORDER if of[kind]), "")
    if first:
        return f"{HEADS[first]} {name}", lines
    return f"{'No worse than' if unresolved else 'Same as'} {name}", lines


def _kind_line(kind: str, changes: Sequence[Change]) -> Line:
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


def _size(old: float, new: float, sigmas: float | None) -> tuple[float, str]:
    """Size of a change: to sort by, and as text."""
    share = (abs(new) - abs(old)) / abs(old) if old else inf
    step = f"from {rounded(old, 3)} to {rounded(new, 3)}"
    if isfinite(share):
        step = f"{'+' if share > 0 else '−'}{rounded(100.0 * abs(share))} %"
    if sigmas is not None and isfinite(sigmas):
        return abs(sigmas), f"{step} ({abs(sigmas):.1f} standard errors)"
    return abs(share), step
