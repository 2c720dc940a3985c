r"""Judging rows: pass, fail or inconclusive, at a stated false-alarm rate.

Sampling rows are tested against an interval, not a point, because a truncated
formula is allowed its remainder :math:`\delta`. With :math:`d` the difference and
:math:`s` its standard error,

.. math:: p = F(-(|d| - \delta)/s) + F(-(|d| + \delta)/s)  \tag{V1}

is the greatest probability, over all expectations within the interval, of a
difference at least this large. F is Student's t with one degree of freedom for every
`SAMPLES_PER_FREEDOM` samples and not the normal law: variances, squares and fractions
are skewed, and their standard error, itself estimated, moves with them, so the tails
are heavier by a term of order 1/n. It never has more degrees of freedom than the
standard error (`freedom`). The p-values of a family (plain, control, nees)
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

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from simval import vocabulary
from simval.arrays import Array
from simval.results import CellName, Row
from simval.shapes import Float

Answer = Literal["pass", "fail", "inconclusive"]
WORST_FIRST: tuple[Answer, ...] = ("fail", "inconclusive", "pass")

WEIGHTS = {"plain": 0.25, "control": 0.5, "nees": 0.25}
"""Share of the false-alarm rate of each family of sampling checks. Chosen: half for the
sharpest; any shares that sum to 1 keep the rate."""

ALPHA = vocabulary.ALPHA
"""Default false-alarm rate of a whole run: one clean run in a thousand
does not pass (measured: `make power` with `--rates`, docs/gate.md)."""

SAMPLES_PER_FREEDOM = 10.0
"""Samples for each degree of freedom of F in eq. (V1). The standard deviation of a
Gaussian error is the most skewed of the usual rows: beside its own standard error its
exact two-sided tail at the normal's 1e-5 is 2.4e-5 with 1024 samples, and Student's t
with 102 degrees of freedom has 2.5e-5 there."""

SAMPLES_PER_BATCH = 256
"""Most samples in one of the batch means that a standard error rests on."""

MIN_SAMPLES = 256
"""Below this the tails are not known well enough for eq. (V1). Measured at a rate of
0.1 %: 64 batch means gave 0.19 % false alarms, 256 give 0.07 % (docs/gate.md)."""


def freedom(n: ArrayLike) -> Float[Array, " rows"]:
    """Degrees of freedom of F in eq. (V1).

    A standard error rests on the samples themselves, or on means of batches of at most
    `SAMPLES_PER_BATCH`, of which each study takes at least `MIN_SAMPLES`.

    Parameters
    ----------
    n : array_like
        Number of samples of each row.

    Returns
    -------
    Array
        Not more than the standard error has.
    """
    n = np.asarray(n, dtype=float)
    has = np.maximum(n / SAMPLES_PER_BATCH, MIN_SAMPLES) - 1.0
    return np.asarray(np.minimum(n / SAMPLES_PER_FREEDOM, has), dtype=float)


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


def overall(verdicts: Iterable[Verdict]) -> Answer:
    """One answer for all: the worst of them.

    Parameters
    ----------
    verdicts : iterable of Verdict
        All that was judged.

    Returns
    -------
    Answer
        Nothing judged is inconclusive.
    """
    return overall_of({verdict.answer for verdict in verdicts})


def overall_of(answers: set[Answer]) -> Answer:
    """One answer for all: the worst of those that were given.

    Parameters
    ----------
    answers : set of Answer
        The different answers.

    Returns
    -------
    Answer
        The worst; of none, inconclusive.
    """
    if "fail" in answers:
        return "fail"
    return "pass" if answers == {"pass"} else "inconclusive"


OBSTACLES: tuple[Callable[[Row], str], ...] = (
    lambda _: "the value, its error, its prediction or its remainder is not finite",
    lambda row: f"a remainder of {row.remainder:.3g} is negative; it must be 0 or more",
    lambda _: "a sampled value without a standard error cannot be judged",
    lambda row: f"{row.n} samples; at least {MIN_SAMPLES} are needed to judge",
    lambda row: (
        f"a remainder of {row.remainder:.3g} allows too much: it is above half of both "
        "the prediction and the spread of a sample"
    ),
)
"""Why a row cannot be judged; the first that holds is said."""


def deterministic_reason(row: Row) -> str:
    """Why a row without chance fails."""
    assert row.prediction is not None
    if row.check == "limit":
        return f"{row.value:.6g} is above the limit {row.prediction:.6g}"
    difference = abs(row.value - row.prediction)
    return (
        f"{row.value:.6g} is {difference:.3g} from {row.prediction:.6g}; "
        f"{row.remainder:.3g} is allowed"
    )


def margin(row: Row) -> float:
    """Discrepancy of a sampling row that must not go unseen, see eq. (V2)."""
    assert row.prediction is not None
    return PRACTICAL * max(abs(row.prediction), row.standard_error * sqrt(row.n))


def sampled_reason(
    row: Row, answer: Answer, p: float, limit: float, detectable: float
) -> str:
    """Why a sampling row is no pass."""
    assert row.prediction is not None
    if answer == "fail":
        beyond = abs(row.value - row.prediction) - row.remainder
        return (
            f"{row.value:.6g} against {row.prediction:.6g}: "
            f"{beyond / row.standard_error:.1f} standard errors beyond the allowed "
            f"remainder, p = {p:.2g}, limit {limit:.2g}"
        )
    least = margin(row)
    return (
        f"{row.n} samples would show no discrepancy below {detectable:.3g}, and "
        f"{least:.3g} must not go unseen; about "
        f"{int(np.ceil(row.n * (detectable / least) ** 2))} samples are needed"
    )
