r"""Judging rows: pass, fail or inconclusive, at a stated false-alarm rate.

Sampling rows are tested against an interval, not a point, because a truncated
formula is allowed its remainder :math:`\delta`. With :math:`d` the difference and
:math:`s` its standard error,

.. math:: p = F(-(|d| - \delta)/s) + F(-(|d| + \delta)/s)  \tag{V1}

is the greatest probability, over all expectations within the interval, of a
difference at least this large. F is Student's t with one degree of freedom for every
`SAMPLES_PER_FREEDOM` samples and not the normal law: variances, squares and fractions
are skewed, and their standard error, itself estimated, moves with them, so the tails
are heavier by a term of order 1/n. The p-values of a family (plain, control, nees)
share the family's part of the false-alarm rate by Holm's rule, which holds under any
dependence; the parts are weighted Bonferroni: 1/4, 1/2, 1/4, divided over the
families that are present.

A pass also says that a discrepancy would have been seen. With :math:`z` the quantile of
F at the family's Bonferroni limit, a discrepancy beyond the remainder of

.. math:: \Delta = (z + \Phi^{-1}(0.99))\, s  \tag{V2}

is detected with probability 0.99. A sampling row passes only if :math:`\Delta` is at
most the practical margin, the fraction `PRACTICAL` of the predicted value or of one
sample's own spread :math:`s \sqrt n`, whichever is greater; else it is inconclusive.
That depends on the number of samples and hardly on the measured values: the standard
error decides only if a cell has just about as many samples as are needed.

The normalised squared errors of the cells of one study are also pooled, weighted by
their samples, into one more row: it shows a common error in scale first.

Deterministic rows (exact, limit) are compared with their bound and cost no false
alarms. A row that was not measured, or not measured well enough, is
inconclusive; it never passes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Literal

import numpy as np
import scipy

from simval import vocabulary
from simval.change import holm
from simval.results import CellName, Row, nees
from simval.statistics import POOLED_NEES

Answer = Literal["pass", "fail", "inconclusive"]
WORST_FIRST: tuple[Answer, ...] = ("fail", "inconclusive", "pass")

WEIGHTS = {"plain": 0.25, "control": 0.5, "nees": 0.25}
"""Share of the false-alarm rate of each family of sampling checks. Chosen: half for the
sharpest; any shares that sum to 1 keep the rate."""

ALPHA = vocabulary.ALPHA
"""Default false-alarm rate of a whole run: one clean run in a thousand
does not pass (measured: `simval selftest --rates`, docs/gate.md)."""

SAMPLES_PER_FREEDOM = 10.0
"""Samples for each degree of freedom of F in eq. (V1). The standard deviation of a
Gaussian error is the most skewed of the usual rows: beside its own standard error its
exact two-sided tail at the normal's 1e-5 is 2.4e-5 with 1024 samples, and Student's t
with 102 degrees of freedom has 2.5e-5 there."""

MIN_SAMPLES = 256
"""Below this the tails are not known well enough for eq. (V1). Measured at a rate of
0.1 %: 64 batch means gave 0.19 % false alarms, 256 give 0.07 % (docs/gate.md)."""

MAX_REMAINDER = 0.5
"""Greatest remainder beside the predicted value or one sample's own spread, whichever
is greater: a prediction that may be off by more predicts nothing."""

PRACTICAL = 0.25
"""Discrepancy that must not go unseen, see eq. (V2). A bias of a quarter of the error's
own standard deviation adds 3 % to its RMS."""

POWER = 0.99
"""Probability of finding a discrepancy of the practical margin, eq. (V2). Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One judged row."""

    cell: CellName  # the cell, or all cells of a study for what is pooled over them
    row: Row
    answer: Answer  # ``pass``, ``fail`` or ``inconclusive``
    p_value: float | None = None  # eq. (V1); None where the row is deterministic
    # for a sampling row the p-value below which it fails (Holm's, in its family); else
    # the greatest difference allowed
    limit: float = float("nan")
    reason: str = ""  # why it is not a pass
    # of a sampling row: what would be seen beyond the remainder, eq. (V2), and the
    # practical margin that it must not exceed
    detectable: float = float("nan")
    margin: float = float("nan")

    @property
    def samples_needed(self) -> float:
        """Samples for which what would be seen is just the margin; NaN if not sampled.

        As if Student's t kept its degrees of freedom, so somewhat few far below `n`.
        """
        return self.row.n * (self.detectable / self.margin) ** 2

    @property
    def sigmas(self) -> float:
        """Distance from the prediction in standard errors, sign included."""
        row = self.row
        if row.prediction is None or not row.standard_error > 0.0:
            return float("nan")
        return (row.value - row.prediction) / row.standard_error


def p_value(row: Row) -> float:
    """Probability of eq. (V1) for a sampling row."""
    assert row.prediction is not None
    distance = abs(row.value - row.prediction)
    low = (distance - row.remainder) / row.standard_error
    high = (distance + row.remainder) / row.standard_error
    freedom = row.n / SAMPLES_PER_FREEDOM
    return float(
        scipy.special.stdtr(freedom, -low) + scipy.special.stdtr(freedom, -high)
    )


def judge(
    rows: Iterable[tuple[CellName, Row]], alpha: float = ALPHA
) -> tuple[Verdict, ...]:
    """Judge the rows of a run together."""
    judged = [(cell, row) for cell, row in rows if row.check != "record"]
    judged += _pooled(judged)
    answers: dict[int, Verdict] = {}
    sampled: dict[str, list[int]] = {}
    for i, (cell, row) in enumerate(judged):
        obstacle = _obstacle(row)
        if obstacle:
            answers[i] = Verdict(
                cell=cell, row=row, answer="inconclusive", reason=obstacle
            )
        elif row.check in WEIGHTS:
            sampled.setdefault(row.check, []).append(i)
        else:
            answers[i] = _deterministic(cell, row)
    whole = sum(WEIGHTS[family] for family in sampled)
    for family, members in sampled.items():
        share = alpha * WEIGHTS[family] / whole
        values = np.array([p_value(judged[i][1]) for i in members])
        tail = share / len(members) / 2.0
        limits = holm(values, share)
        for i, p, limit in zip(members, values, limits, strict=True):
            answers[i] = _sampled(*judged[i], float(p), float(limit), tail)
    return tuple(answers[i] for i in range(len(judged)))


def _pooled(judged: Sequence[tuple[CellName, Row]]) -> list[tuple[CellName, Row]]:
    """Mean of each study's normalised squared errors, relative to the prediction."""
    # weighted by the numbers of samples, which do not depend on the values
    groups: dict[tuple[str, str], list[Row]] = {}
    for cell, row in judged:
        if row.check == "nees" and not _obstacle(row) and row.prediction:
            groups.setdefault((cell.study, row.predictor), []).append(row)
    pooled: list[tuple[CellName, Row]] = []
    for (study, predictor), rows in groups.items():
        if len(rows) < 2:
            continue
        n = np.array([row.n for row in rows], dtype=float)
        weights = n / n.sum() / [row.prediction for row in rows]
        errors = [row.standard_error for row in rows]
        (row,) = nees(
            POOLED_NEES(),
            float(weights @ [row.value for row in rows]),
            float(np.linalg.norm(weights * errors)),
            int(n.sum()),
            1.0,
            predictor,
            float(np.abs(weights) @ [row.remainder for row in rows]),
        )
        pooled.append((CellName(study), row))
    return pooled


def overall(verdicts: Sequence[Verdict]) -> Answer:
    """One answer for all: the worst of them."""
    answers = {verdict.answer for verdict in verdicts}
    if "fail" in answers:
        return "fail"
    return "pass" if answers == {"pass"} else "inconclusive"


def _obstacle(row: Row) -> str:
    numbers = (row.value, row.standard_error, row.remainder)
    if row.prediction is None or not np.isfinite((*numbers, row.prediction)).all():
        return "the value, its error, its prediction or its remainder is not finite"
    if row.remainder < 0.0:
        return f"a remainder of {row.remainder:.3g} is negative; it must be 0 or more"
    if row.check in WEIGHTS and not row.standard_error > 0.0:
        return "a sampled value without a standard error cannot be judged"
    if row.check in WEIGHTS and not row.n >= MIN_SAMPLES:
        return f"{row.n} samples; at least {MIN_SAMPLES} are needed to judge"
    if row.check in WEIGHTS and not row.remainder <= MAX_REMAINDER * _size(row):
        return (
            f"a remainder of {row.remainder:.3g} allows too much: it is above half of "
            "both the prediction and the spread of a sample"
        )
    return ""


def _size(row: Row) -> float:
    """Predicted value or one sample's own spread, whichever is greater."""
    spread = row.standard_error * sqrt(row.n)
    return max(abs(row.prediction or 0.0), spread)


def _deterministic(cell: CellName, row: Row) -> Verdict:
    assert row.prediction is not None
    if row.check == "limit":
        good, limit = row.value <= row.prediction, row.prediction
        reason = f"{row.value:.6g} is above the limit {row.prediction:.6g}"
    else:
        difference = abs(row.value - row.prediction)
        good, limit = difference <= row.remainder, row.remainder
        reason = (
            f"{row.value:.6g} is {difference:.3g} from {row.prediction:.6g}; "
            f"{row.remainder:.3g} is allowed"
        )
    return Verdict(
        cell=cell,
        row=row,
        answer="pass" if good else "fail",
        limit=limit,
        reason="" if good else reason,
    )


def _sampled(cell: CellName, row: Row, p: float, limit: float, tail: float) -> Verdict:
    assert row.prediction is not None
    beyond = abs(row.value - row.prediction) - row.remainder
    quantile = -float(scipy.special.stdtrit(row.n / SAMPLES_PER_FREEDOM, tail))
    detectable = (quantile + float(scipy.special.ndtri(POWER))) * row.standard_error
    margin = PRACTICAL * _size(row)
    answer: Answer = "pass"
    reason = ""
    if not p > limit:
        answer = "fail"
        reason = (
            f"{row.value:.6g} against {row.prediction:.6g}: "
            f"{beyond / row.standard_error:.1f} standard errors beyond the allowed "
            f"remainder, p = {p:.2g}, limit {limit:.2g}"
        )
    elif not detectable <= margin:
        answer = "inconclusive"
        reason = (
            f"{row.n} samples would show no discrepancy below {detectable:.3g}, and "
            f"{margin:.3g} must not go unseen; about "
            f"{int(np.ceil(row.n * (detectable / margin) ** 2))} samples are needed"
        )
    return Verdict(
        cell=cell,
        row=row,
        answer=answer,
        p_value=p,
        limit=limit,
        reason=reason,
        detectable=detectable,
        margin=margin,
    )
