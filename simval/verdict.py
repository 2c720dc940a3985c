r"""Judge rows as pass, fail or inconclusive, at a stated false-alarm rate.

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

Beyond its remainder :math:`\delta` a row sees :math:`\Delta`, so the smallest relative
change of its prediction P that it fails, its **power**, is

.. math:: (\Delta + \delta)/|P|,  \tag{V3}

with probability 0.99 where P is right now; :math:`\Delta = 0` without chance. What
predicts nothing has no relative change: a prediction of 0 (or of rounding, `NOTHING`)
is taken by one sample's own spread, and without chance, as a limit, by 1 in the unit of
the row. A row of a power above 1 would pass a prediction of twice the size or of none.
It is **wide**: judged, since what is far off is seen, but no check, unless a control
row of the same statistic and theory stands beside it that sees more.

The normalised squared errors of the cells of one study are also pooled, weighted by
their samples, into one more row: it shows a common error in scale first. Those of one
cell are of the same samples, and may move as one: their standard errors add up.

Deterministic rows (exact, limit) are compared with their bound and cost no false
alarms. A row that was not measured, or not measured well enough, is
inconclusive; it never passes.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, isnan, sqrt
from typing import Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from simval import vocabulary
from simval.arrays import Array
from simval.change import holm
from simval.results import MAX_REMAINDER, CellName, Row, nees
from simval.shapes import Bool, Float, Int, Shaped
from simval.spelling import chance
from simval.statistics import POOLED_NEES, Statistic

Answer = Literal["pass", "fail", "inconclusive"]
WORST_FIRST: tuple[Answer, ...] = ("fail", "inconclusive", "pass")
ENDINGS = ("crashed", "fail", "refused", "inconclusive", "pending", "pass")
"""From worst to best: of cells without a result, and of what was judged in others."""

WEIGHTS = {"plain": 0.25, "control": 0.5, "nees": 0.25}
"""Share of the false-alarm rate of each family of sampling checks. Chosen: half for the
sharpest; any shares that sum to 1 keep the rate."""

ALPHA = vocabulary.ALPHA
"""Default false-alarm rate of a whole run: one clean run in a thousand
does not pass (measured: `make power` with `--rates`, docs/gate.md)."""

SAMPLES_PER_FREEDOM = 10.0
"""Samples for each degree of freedom of F in eq. (V1). The standard deviation of a
Gaussian error is the most skewed of the usual rows: over its own standard error its
exact two-sided tail at the normal's 1e-5 is 2.4e-5 with 1024 samples, and Student's t
with 102 degrees of freedom has 2.5e-5 there."""

SAMPLES_PER_BATCH = 256
"""Most samples in one of the batch means that a standard error rests on."""

MIN_SAMPLES = 256
"""Below this the tails are not known well enough for eq. (V1). Measured at a rate of
0.1 %: 64 batch means gave 0.19 % false alarms, 256 give 0.07 % (docs/gate.md)."""


def freedom(n: ArrayLike) -> Float[Array, "..."]:
    """Degrees of freedom of F in eq. (V1).

    A standard error rests on the samples themselves, or on means of batches of at most
    `SAMPLES_PER_BATCH`, of which each study takes at least `MIN_SAMPLES`.
    """
    n = np.asarray(n, dtype=float)
    has = np.maximum(n / SAMPLES_PER_BATCH, MIN_SAMPLES) - 1.0
    return np.asarray(np.minimum(n / SAMPLES_PER_FREEDOM, has), dtype=float)


PRACTICAL = 0.25
"""Discrepancy that must not go unseen, see eq. (V2). A bias of a quarter of the error's
own standard deviation adds 3 % to its RMS."""

POWER = 0.99
"""Probability of finding a discrepancy of the practical margin, eq. (V2). Chosen."""

NOTHING = 1e-9
"""Of one sample's own spread: a smaller prediction is 0. To see it takes 1e18 samples,
and rounding, 1e-12 of the spread at most, must not decide what counts as a check."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict on one row."""

    cell: CellName  # the cell, or all cells of a study for what is pooled over them
    row: Row
    answer: Answer  # ``pass``, ``fail`` or ``inconclusive``
    p_value: float | None = None  # eq. (V1); None where the row is deterministic
    # for a sampling row the p-value below which it fails (Holm's, in its family); else
    # the greatest difference allowed
    limit: float = np.nan
    reason: str = ""  # why it is not a pass
    # of a sampling row: what would be seen beyond the remainder, eq. (V2), and the
    # practical margin that it must not exceed
    detectable: float = np.nan
    margin: float = np.nan
    # smallest relative change of the prediction that it fails, eq. (V3); NaN if unsound
    power: float = np.nan
    wide: bool = False  # it passes, but allows more than it predicts: no check

    @property
    def samples_needed(self) -> float:
        """Samples with which the smallest visible error is the margin; NaN if none.

        As if Student's t kept its degrees of freedom, so somewhat few far below `n`.
        """
        return self.row.n * (self.detectable / self.margin) ** 2

    @property
    def more(self) -> float:
        """Factor by which more samples would suffice; NaN if they suffice already."""
        if self.answer != "inconclusive" or isnan(self.detectable):
            return np.nan
        row, seen = self.row, float(scipy.special.ndtri(POWER))
        far, needed = self.detectable / row.standard_error, self.samples_needed
        tail = scipy.special.stdtr(freedom(row.n), seen - far)
        for _ in range(ROUNDS):  # with more samples Student's t is narrower
            needed = max(needed, MIN_SAMPLES)
            narrower = seen - scipy.special.stdtrit(freedom(needed), tail)
            needed = float(self.samples_needed * (narrower / far) ** 2)
        return max(needed, MIN_SAMPLES) / row.n

    @property
    def sigmas(self) -> float:
        """Distance from the prediction in standard errors, sign included."""
        row = self.row
        if row.prediction is None or not row.standard_error > 0.0:
            return np.nan
        return (row.value - row.prediction) / row.standard_error


def worst(answers: Iterable[Answer]) -> Answer:
    """The worst of some answers; a pass if there are none."""
    found = set(answers)
    return next((answer for answer in WORST_FIRST if answer in found), "pass")


def overall(verdicts: Iterable[Verdict]) -> Answer:
    """The worst answer of all; inconclusive if there is no check at all."""
    answers = {verdict.answer for verdict in verdicts if not verdict.wide}
    if "fail" in answers:
        return "fail"
    return "pass" if answers == {"pass"} else "inconclusive"


def powers_by_study(verdicts: Iterable[Verdict]) -> dict[str, float]:
    """Median power of each study's checks, by the best row of each quantity.

    Without those whose power is in a unit of their own: limits, differences.
    """
    sharpest: dict[tuple[CellName, Statistic, str], float] = {}
    for each in verdicts:
        row = each.row
        relative = row.check in WEIGHTS or (row.check == "exact" and row.prediction)
        if relative and each.power == each.power and not each.wide:
            key = _quantity(each.cell, row)
            sharpest[key] = min(each.power, sharpest.get(key, inf))
    studies: dict[str, list[float]] = {}
    for (cell, *_), power in sharpest.items():
        studies.setdefault(cell.study, []).append(power)
    return {study: float(np.median(found)) for study, found in studies.items()}


Mask = Bool[NDArray[np.bool_], " n"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Columns:
    """Rows as arrays, so that many are judged at once."""

    check: Shaped[NDArray[np.str_], " n"]
    value: Float[Array, " n"]
    standard_error: Float[Array, " n"]
    n: Int[NDArray[np.int64], " n"]
    prediction: Float[Array, " n"]  # NaN where there is none
    remainder: Float[Array, " n"]

    @property
    def sampled(self) -> Mask:
        """True for rows in which chance plays a part."""
        return np.isin(self.check, list(WEIGHTS))

    @property
    def spread(self) -> Float[Array, " n"]:
        """Standard deviation of a single sample; 0 without chance."""
        return self.standard_error * np.sqrt(self.n)

    @property
    def sizes(self) -> Float[Array, " n"]:
        """The prediction or the spread of a sample, whichever is larger."""
        return np.maximum(np.abs(self.prediction), self.spread)

    @property
    def predicts(self) -> Mask:
        """True for rows with a prediction that changes can be relative to."""
        some = np.abs(self.prediction) > NOTHING * self.spread
        return (self.check != "limit") & some

    def power(self, detectable: Float[Array, " n"]) -> Float[Array, " n"]:
        """Power by eq. (V3): what would be seen beyond the remainder."""
        allowed = np.where(self.check == "limit", self.prediction, self.remainder)
        unit = np.where(self.sampled, self.spread, 1.0)
        scale = np.where(self.predicts, np.abs(self.prediction), unit)
        return (allowed + np.where(self.sampled, detectable, 0.0)) / scale

    @property
    def p_values(self) -> Float[Array, " n"]:
        """p-value of each row, eq. (V1)."""
        distance = np.abs(self.value - self.prediction)
        low = (distance - self.remainder) / self.standard_error
        high = (distance + self.remainder) / self.standard_error
        law = freedom(self.n)
        left, right = (scipy.special.stdtr(law, -z) for z in (low, high))
        return np.asarray(left + right, dtype=float)

    @property
    def obstacles(self) -> Int[NDArray[np.int64], " n"]:
        """Position of the first of `OBSTACLES`, from 1; 0 if there is none."""
        numbers = (self.value, self.standard_error, self.remainder, self.prediction)
        sampled = self.sampled
        found = [
            ~np.isfinite(numbers).all(axis=0),
            self.remainder < 0.0,
            sampled & ~(self.standard_error > 0.0),
            sampled & ~(self.n >= MIN_SAMPLES),
            sampled & ~(self.remainder <= MAX_REMAINDER * self.sizes),
        ]
        return np.select(found, range(1, len(found) + 1), 0).astype(np.int64)


def _columns(rows: Sequence[Row]) -> _Columns:
    return _Columns(
        check=np.array([row.check for row in rows], dtype=str),
        value=np.array([row.value for row in rows], dtype=float),
        standard_error=np.array([row.standard_error for row in rows], dtype=float),
        n=np.array([row.n for row in rows], dtype=np.int64),
        prediction=np.array([row.prediction for row in rows], dtype=float),
        remainder=np.array([row.remainder for row in rows], dtype=float),
    )


@np.errstate(all="ignore")  # what is no number has an obstacle
def p_values(rows: Iterable[Row]) -> Float[Array, " n"]:
    """p-value of each sampled row, eq. (V1)."""
    return _columns(list(rows)).p_values


@np.errstate(all="ignore")  # what is no number has an obstacle
def shares(verdicts: Sequence[Verdict]) -> Float[Array, " n"]:
    """Distance from theory as a share of what is allowed; a row passes up to 1.

    A sampled row is allowed its remainder and as much chance as eq. (V1) at its limit;
    NaN of a row that cannot be judged.
    """
    columns = _columns([verdict.row for verdict in verdicts])
    limit = np.array([verdict.limit for verdict in verdicts], dtype=float)
    error, law = columns.standard_error, freedom(columns.n)
    # in standard errors, between a whole tail at the limit and half of it
    low, high = (-scipy.special.stdtrit(law, limit / k) for k in (1.0, 2.0))
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        beyond = -middle - 2.0 * columns.remainder / error
        p = scipy.special.stdtr(law, -middle) + scipy.special.stdtr(law, beyond)
        low, high = np.where(p > limit, (middle, high), (low, middle))
    allowed = np.where(columns.sampled, columns.remainder + high * error, limit)
    distance = np.abs(columns.value - columns.prediction)
    distance = np.where(columns.check == "limit", columns.value, distance)
    none = np.where(distance > allowed, np.inf, 0.0)  # nothing is allowed
    share = np.where(allowed > 0.0, distance / allowed, none)
    share[columns.obstacles > 0] = np.nan
    return np.asarray(share, dtype=float)


@np.errstate(all="ignore")  # what is no number has an obstacle
def judge(
    rows: Iterable[tuple[CellName, Row]], alpha: float = ALPHA
) -> tuple[Verdict, ...]:
    """Judge the rows of a run together, at one false-alarm rate for all of them.

    In the order of the rows, without those of check ``record``; last what is pooled
    over a study.
    """
    members = _members(rows)
    columns = _columns([row for _, row in members])
    obstacle, sampled = columns.obstacles, columns.sampled
    sound, limited = obstacle == 0, columns.check == "limit"
    p, limit, detectable = _tested(columns, alpha)
    good = np.where(
        limited,
        columns.value <= columns.prediction,
        np.abs(columns.value - columns.prediction) <= columns.remainder,
    )
    margin = PRACTICAL * columns.sizes
    failed = sound & np.where(sampled, ~(p > limit), ~good)
    unclear = ~sound | (~failed & sampled & ~(detectable <= margin))
    answers = np.select([failed, unclear], WORST_FIRST[:2], WORST_FIRST[2]).tolist()
    margin[np.isnan(detectable)] = np.nan
    power = np.where(sound, columns.power(detectable), np.nan)
    above = sound & columns.predicts & (power > 1.0)
    sharp = sound & (columns.check == "control") & ~above
    beside = {_quantity(*members[i]) for i in np.flatnonzero(sharp)}
    return tuple(
        _counted(Verdict(
            cell=cell,
            row=row,
            answer=answers[i],
            p_value=float(p[i]) if sound[i] and sampled[i] else None,
            limit=float(limit[i]),
            reason=OBSTACLES[obstacle[i] - 1](row)
            if obstacle[i]
            else _reason(row, *(float(each[i]) for each in (p, limit, detectable)))
            if answers[i] != "pass"
            else "",
            detectable=float(detectable[i]),
            margin=float(margin[i]),
            power=float(power[i]),
            wide=bool(above[i])
            and answers[i] == "pass"
            and _quantity(cell, row) not in beside,
        ))
        for i, (cell, row) in enumerate(members)
    )  # fmt: skip


def _counted(verdict: Verdict) -> Verdict:
    # with the samples that would do, if there are too few
    if isnan(more := verdict.more) or verdict.row.n < MIN_SAMPLES:
        return verdict
    needed = f"about {ceil(verdict.row.n * more)} samples are needed"
    return replace(verdict, reason=f"{verdict.reason}; {needed}")


def _quantity(cell: CellName, row: Row) -> tuple[CellName, Statistic, str]:
    """Key of a quantity, the same for its plain and control rows."""
    return cell, row.statistic.control, row.predictor


def _members(rows: Iterable[tuple[CellName, Row]]) -> list[tuple[CellName, Row]]:
    """The rows to judge, followed by those pooled over each study."""
    members = [pair for pair in rows if pair[1].check != "record"]
    return [*members, *_pooled(members)]


def _tested(columns: _Columns, alpha: float) -> tuple[Array, Array, Array]:
    """p-value of each row, its limit, and the smallest error that would be seen."""
    obstacle, sampled = columns.obstacles, columns.sampled
    sound = obstacle == 0
    # with too few samples only the number needed is stated
    counted = sound | (obstacle == TOO_FEW)
    p = np.where(sound & sampled, columns.p_values, np.nan)
    limit = np.where(columns.check == "limit", columns.prediction, columns.remainder)
    limit[~sound | sampled] = np.nan
    detectable = np.full(len(p), np.nan)
    families = [name for name in WEIGHTS if (counted & (columns.check == name)).any()]
    whole = sum(WEIGHTS[name] for name in families)
    for name in families:
        own = counted & (columns.check == name)
        share = alpha * WEIGHTS[name] / whole
        limit[own] = holm(np.where(sound, p, 1.0)[own], share)
        tail = share / int(own.sum()) / 2.0
        quantile = -scipy.special.stdtrit(freedom(columns.n[own]), tail)
        needed = quantile + float(scipy.special.ndtri(POWER))
        detectable[own] = needed * columns.standard_error[own]
    limit[~sound & sampled] = np.nan
    return p, limit, detectable


@np.errstate(all="ignore")  # what is no number has an obstacle
def powers(rows: Iterable[tuple[CellName, Row]]) -> list[float]:
    """Power of each row, eq. (V3), at `ALPHA`; NaN if it is not judged."""
    every = list(rows)
    columns = _columns([row for _, row in _members(every)])
    power = columns.power(_tested(columns, ALPHA)[2])
    found = iter(np.where(columns.obstacles == 0, power, np.nan).tolist())
    return [np.nan if row.check == "record" else next(found) for _, row in every]


def _reason(row: Row, p: float, limit: float, detectable: float) -> str:
    """Say why a row does not pass."""
    assert row.prediction is not None
    off = abs(row.value - row.prediction)
    if row.check == "limit":
        return f"{row.value:.6g} is above the limit {row.prediction:.6g}"
    if row.check not in WEIGHTS:
        return (
            f"{row.value:.6g} is {off:.3g} from {row.prediction:.6g}; "
            f"{row.remainder:.3g} is allowed"
        )
    if not p > limit:
        return (
            f"{row.value:.6g} against {row.prediction:.6g}: "
            f"{(off - row.remainder) / row.standard_error:.1f} standard errors beyond "
            f"the allowed remainder ({chance(p)})"
        )
    least = PRACTICAL * max(abs(row.prediction), row.standard_error * sqrt(row.n))
    return (
        f"{row.n} samples would show no discrepancy below {detectable:.3g}, and "
        f"{least:.3g} must not go unseen"
    )


def _pooled(
    members: Iterable[tuple[CellName, Row]],
) -> Iterator[tuple[CellName, Row]]:
    """Mean normalised squared error of each study, relative to the prediction."""
    pools: dict[tuple[str, str], list[tuple[CellName, Row]]] = {}
    for cell, row in members:
        if row.check == "nees" and row.prediction:
            pools.setdefault((cell.study, row.predictor), []).append((cell, row))
    for (study, predictor), pairs in pools.items():
        every = _columns([row for _, row in pairs])
        sound = [pairs[i] for i in np.flatnonzero(every.obstacles == 0)]
        own = _columns([row for _, row in sound])
        if len(own.value) < 2:
            continue
        # weighted by the numbers of samples, which do not depend on the values
        n = own.n.astype(float)
        weights = n / n.sum() / own.prediction
        errors: dict[CellName, float] = {}
        for (cell, _), error in zip(sound, weights * own.standard_error, strict=True):
            errors[cell] = errors.get(cell, 0.0) + abs(error)
        (row,) = nees(
            POOLED_NEES(),
            float(weights @ own.value),
            float(np.linalg.norm([*errors.values()])),
            int(n.sum()),
            1.0,
            predictor,
            float(np.abs(weights) @ own.remainder),
        )
        yield CellName(study), row


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

HALVINGS = 20  # of an interval of some tenths of a standard error
ROUNDS = 9
"""In which a number of samples and Student's t by it settle to a percent."""
TOO_FEW = 4
"""Place in `OBSTACLES`, and 1, of the number of samples."""
