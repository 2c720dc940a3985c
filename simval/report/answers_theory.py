r"""As theory says: how far the measured sizes of errors are from the predicted ones.

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
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.report.answers import Block, Line, called, in_order
from simval.report.chapters import home
from simval.report.section import Context
from simval.report.slope import simultaneous
from simval.report.words import measured
from simval.results import CellName
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
from simval.verdict import WORST_FIRST, Answer, Verdict

SIZES = {RMS: 1.0, SD: 1.0, RMS_OVER_BOUND: 1.0, BUDGET: 1.0} | dict.fromkeys(
    (COVARIANCE, NEES, NIS, SQUARED_ERROR, VARIANCE_OVER_BOUND, ALLAN_ERROR), 0.5
)
"""Families that are sizes of errors, and k of eq. (T1)."""

NOTE = (
    "“On average”: mean deviation of measured from predicted sizes of errors (standard "
    "deviations; half of that of a variance), weighted by the number of trials, and "
    "its standard error; one value may be farther off. Each check by itself is in the "
    "table of checks."
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
    parts = {s: [v for v in verdicts if v.cell.study == s] for s in studies}
    worst_first = sorted(studies, key=lambda s: WORST_FIRST.index(_worst(parts[s])))
    missing = list(_missing(context))
    lines = [*missing, *(_line(s, parts[s]) for s in worst_first)]
    return Block(
        title="As theory says",
        answer=_worst(verdicts) if verdicts else "inconclusive",
        headline=_headline(context.judged.counts, whole=not missing),
        lines=lines,
        note=f"{_farthest(verdicts)}{NOTE}",
        fold="more studies",
    )


def _headline(answers: Counter[Answer], *, whole: bool) -> str:
    if not answers:
        return "Nothing was judged"
    failed, unclear = answers["fail"], answers["inconclusive"]
    if not failed and not unclear:
        all_of = "All" if whole else "As far as measured, all"
        return f"{all_of} {answers.total():,} checks agree"
    parts = [f"{failed:,} fail"] if failed else []
    parts += [f"{unclear:,} cannot be judged"] if unclear else []
    return f"Of {answers.total():,} checks {' and '.join(parts)}"


def _missing(context: Context) -> Iterable[Line]:
    """What should have been measured and was not."""
    judged = context.judged
    counts: dict[str, dict[str, int]] = {}
    for cell in judged.unfinished:
        words = {"pending": "never run"}.get(cell.ending, cell.ending)
        own = counts.setdefault(cell.study, {})
        own[words] = own.get(words, 0) + 1
    said = [
        f"{called(study).lower()} ({', '.join(f'{n} {w}' for w, n in own.items())})"
        for study, own in counts.items()
    ]
    if judged.gaps:
        said.append(f"{len(judged.gaps)} things less than stated")
    if said:
        crashed = any(cell.ending == "crashed" for cell in judged.unfinished)
        yield Line(
            what="Not measured",
            said=f"cells of {'; '.join(said)}" if counts else said[0],
            link="failures",
            answer="fail" if crashed else "inconclusive",
        )


def _line(study: str, verdicts: Sequence[Verdict]) -> Line:
    answers = [verdict.answer for verdict in verdicts]
    failed, unclear = answers.count("fail"), answers.count("inconclusive")
    count = len(answers)
    checks = f"{count:,} check{'s' if count > 1 else ''}"
    bad = (
        [f"{failed:,} of {checks} fail{_farthest_failing(verdicts)}"] if failed else []
    )
    bad += [f"{unclear:,} of {checks} inconclusive"] if unclear else []
    found = deviation(study, verdicts)
    told = found is not None and not failed and abs(found.value) + found.error < 1.0
    near = [found.said] if found and told else []
    return Line(
        what=called(study),
        said="; ".join([*bad, *near] if bad else [*near, checks]),
        link="disagreements" if failed else home(study),
        answer=_worst(verdicts),
    )


def _farthest_failing(verdicts: Sequence[Verdict]) -> str:
    """The check that fails by most, and by how much."""
    failing = [verdict for verdict in verdicts if verdict.answer == "fail"]
    most = max(failing, key=lambda v: abs(v.sigmas) if v.sigmas == v.sigmas else np.inf)
    s = "s" if len(failing) == 1 else ""
    far = f", {most.sigmas:+.1f} standard errors" if most.sigmas == most.sigmas else ""
    return f"{s}{', most' if not s else ':'} {most.row.statistic}{far}"


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
        f"Of {len(beyond):,} sampled checks the farthest is {max(*beyond, 0.0):.1f} "
        "standard errors beyond what its theory leaves open; of so many, chance alone "
        f"reaches {simultaneous(len(beyond)):.1f} in one run of twenty. "
    )


def _worst(verdicts: Sequence[Verdict]) -> Answer:
    answers = {verdict.answer for verdict in verdicts}
    return next((answer for answer in WORST_FIRST if answer in answers), "pass")
