r"""What is measured of a filter's answers: rows of errors, consistency and time.

What is measured of a filter's answers: rows of errors, consistency and time.

Noise, start and bias are drawn anew for each trial, so the mean over trials of a sound
filter's error is 0 to first order. What is left of a mean :math:`m_k` at the instants k
is the filter's own, and each cause has a form, with the rate :math:`\omega_k` and the
attitude :math:`A_k`, world to body:

.. math:: m_k = A_k (c_w, c_n, 0)' \;\text{(tilt)}, \quad A_k (0, 0, c)' \;\text{
   (heading)}, \quad c \;\text{(mounting)}, \quad -\omega_k \tau \;\text{(delay)}.
   \tag{F14}

Each is fitted alone. What none of them explains is of the motion: coning, a scale.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.consistency import (
    diverged,
    heading_and_inclination,
    instant_scores,
    mean_of_trials,
    normalised_squares,
    pairs_of,
    rotation_error,
    settled_at,
)
from simval.filters.signals import FilterOutput
from simval.geometry import attitude_matrix, compose
from simval.results import Row, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.statistics import (
    BOUND_AT,
    CARRIED,
    CHI_SQUARE,
    CONSTANT,
    CRAMER_RAO,
    DIVERGED,
    INNOVATION_PAIRS,
    NEES,
    NEES_AT,
    NIS,
    NORMAL,
    PART_OF_INNOVATION,
    PART_OVER_STATED,
    RMS,
    RMS_AT,
    RMS_BELOW_BOUND,
    RMS_OVER_BOUND,
    RMS_OVER_BOUND_AT,
    SETTLING,
    SETTLING_TRIALS,
    STATED_OVER_BOUND,
    SYSTEMATIC,
    WHITE,
    WORST_INSTANT,
    Family,
    Statistic,
)
from simval.theory import FilterPrediction

ATTITUDE, BOTH = "attitude", "attitude and bias"
HEADING, INCLINATION = "heading", "inclination"

SHOWN = 25
"""Instants in the table and the figure."""
SETTLED = 3.0
"""Root mean squares of the bound below which an error has settled."""
ENOUGH = np.radians(1.0)
"""An error that has settled whatever the bound, rad."""
WORST = 6.5
"""Standard deviations of a normal law that the worst instant may reach: of a hundred,
once in 10^8 cells."""
OVER = 0.02
"""Of a root mean square over what theory says."""
RELATIVE = 0.01
"""Of a NEES or NIS: what is of second order in the errors, see docs/filters.md."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answers:
    """Answers of a filter at some instants, each with the row before, and the truth."""

    found: FilterOutput
    truth: Float[Array, "k 4"]  # at the rows that were kept
    bias: Float[Array, "n k 3"]
    time: Float[Array, " k"]  # s
    late: NDArray[np.intp]  # places of the instants among the rows kept
    shifted: bool = False  # whether its headings count from its own first one

    @property
    def error(self) -> Float[Array, "n i 3"]:
        """Attitude errors at the instants, rad."""
        estimate = self.found.attitude[:, self.late]
        return rotation_error(estimate, self.truth[self.late])

    def from_its_own_heading(self) -> "Answers":
        """The same, each trial turned about the vertical so that it starts right."""
        q, first = self.found.attitude, self.late[0]
        heading, _ = heading_and_inclination(q[:, first], self.truth[first])
        back = np.zeros((len(q), 1, 4))
        back[..., 2], back[..., 3] = (
            f(-heading[:, None] / 2.0) for f in (np.sin, np.cos)
        )
        turned = compose(np.broadcast_to(back, q.shape), q)
        return replace(self, found=replace(self.found, attitude=turned), shifted=True)

    def squares(self) -> dict[str, tuple[int, Float[Array, "n i"]]]:
        """NEES of the attitude, and with the bias, by name with its dimension."""
        P = self.found.covariance
        if P is None:
            return {}
        P, e = P[:, self.late], self.error
        squares = {ATTITUDE: (3, normalised_squares(e, P[..., :3, :3]))}
        if P.shape[-1] >= 6 and self.found.bias is not None:
            off = self.found.bias[:, self.late] - self.bias[:, self.late]
            both = np.concatenate([e, off], axis=-1)
            squares[BOTH] = 6, normalised_squares(both, P[..., :6, :6])
        return squares


def error_rows(
    answers: Answers, bound: Float[Array, "i 3 3"], judged: bool
) -> tuple[Row, ...]:
    """Errors beside the bound, heading and inclination apart, in all and at instants.

    Judged is that the error reaches the bound.
    """
    estimate, truth = answers.found.attitude[:, answers.late], answers.truth
    angle = np.linalg.norm(answers.error, axis=-1)
    heading, inclination = heading_and_inclination(estimate, truth[answers.late])
    time = answers.time[answers.late]
    square = np.trace(bound, axis1=-2, axis2=-1)
    whole, least = float(np.sqrt(square.mean())), np.sqrt(square)
    check = partial(plain, remainder=OVER * whole) if judged else unjudged
    rows = [
        *check(
            RMS(unit="rad"), *root_mean_square(angle),
            prediction=whole, predictor=CRAMER_RAO,
        ),
        *unjudged(RMS_OVER_BOUND(), *_over(root_mean_square(angle), whole)),
        *unjudged(RMS(HEADING, unit="rad"), *root_mean_square(heading)),
        *unjudged(RMS(INCLINATION, unit="rad"), *root_mean_square(inclination)),
    ]  # fmt: skip
    settled = settled_at(angle, time, np.maximum(SETTLED * least, ENOUGH))
    ended = np.isfinite(settled)
    rows += unjudged(SETTLING_TRIALS(), float(ended.mean()), 0.0, len(settled))
    if ended.any():
        middle = float(np.median(settled[ended]))
        rows += unjudged(SETTLING(), middle, 0.0, int(ended.sum()))
    shown = spread(len(time))
    at = [f"{t:.6g}" for t in time[shown]]
    each = _at_each(RMS_AT, ATTITUDE, at, angle[:, shown], root_mean_square)
    bounds = unjudged([BOUND_AT(ATTITUDE, t) for t in at], least[shown])
    return (*rows, *each, *bounds, *_over_each(each, least[shown], 1.0, CRAMER_RAO))


def _over_each(
    rows: Sequence[Row],
    bound: Float[Array, " k"],
    prediction: Array | float,
    predictor: str,
) -> tuple[Row, ...]:
    """Errors of the instants over the bound, beside a prediction of that."""
    value, error = np.array([(row.value, row.standard_error) for row in rows]).T
    return unjudged(
        [RMS_OVER_BOUND_AT(*row.statistic.entries) for row in rows],
        value / bound, error / bound, rows[0].n, prediction, predictor,
    )  # fmt: skip


def _over(measured: tuple[float, float, int], bound: float) -> tuple[float, float, int]:
    value, error, n = measured
    return value / bound, error / bound, n


def carried_over_bound(
    rows: Sequence[Row], theory: FilterPrediction, bound: Float[Array, "i 3 3"]
) -> tuple[Row, ...]:
    """Errors of the instants over the bound, beside theory of the reference filter."""
    moment = np.trace(theory.second_moment[:, :3, :3], axis1=1, axis2=2)
    ratio = np.sqrt(moment / np.trace(bound, axis1=-2, axis2=-1))[spread(len(moment))]
    own = [row for row in rows if row.statistic.family == RMS_OVER_BOUND_AT]
    return tuple(
        replace(row, prediction=float(by), predictor=CARRIED)
        for row, by in zip(own, ratio, strict=True)
    )


def consistency_rows(answers: Answers, judged: bool) -> tuple[Row, ...]:
    """NEES, NIS and the correlation of innovations, judged or only shown."""
    rows: list[Row] = []
    time = answers.time[answers.late]
    shown = spread(len(time))
    at = [f"{t:.6g}" for t in time[shown]]
    for name, (dimension, squares) in answers.squares().items():
        statistic = NEES() if name == ATTITUDE else NEES(name)
        rows += _squares(statistic, squares, dimension, judged)
        if judged:
            worst = float(np.abs(instant_scores(squares, dimension)).max())
            rows += limit(WORST_INSTANT(name), worst, WORST, CHI_SQUARE, len(squares))
        if name == ATTITUDE:
            rows += _at_each(NEES_AT, name, at, squares[:, shown], mean_of_trials)
    return (*rows, *_innovations(answers, judged))


def predicted_rows(
    answers: Answers, theory: FilterPrediction, judged: bool
) -> tuple[Row, ...]:
    """Errors of the reference filter beside what theory says that they are.

    Judged where the whole error stays small enough for the first order.
    """
    angle = np.linalg.norm(answers.error, axis=-1)
    moment = np.trace(theory.second_moment[:, :3, :3], axis1=1, axis2=2)
    root = float(np.sqrt(moment.mean()))
    check = plain if judged else unjudged
    rows = [
        *check(
            RMS(unit="rad"), *root_mean_square(angle),
            prediction=root, predictor=CARRIED, remainder=OVER * root,
        )
    ]  # fmt: skip
    for name, (dimension, squares) in answers.squares().items():
        statistic = NEES() if name == ATTITUDE else NEES(name)
        expected = float(theory.nees(dimension).mean())
        rows += check(
            statistic, *mean_of_trials(squares),
            prediction=expected, predictor=CARRIED, remainder=OVER * expected,
        )  # fmt: skip
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is not None and S is not None:
        squares = normalised_squares(nu, S)[:, answers.late]
        expected = float(theory.nis.mean())
        rows += check(
            NIS(), *mean_of_trials(squares),
            prediction=expected, predictor=CARRIED, remainder=OVER * expected,
        )  # fmt: skip
    return tuple(rows)


def _at_each(
    family: Family,
    name: str,
    at: Sequence[str],
    values: Float[Array, "n k"],
    mean: Callable[[Float[Array, "n 1"]], tuple[float, float, int]],
) -> tuple[Row, ...]:
    """Rows of each instant by itself."""
    each = [mean(values[:, k : k + 1]) for k in range(len(at))]
    value, error, n = zip(*each, strict=True)
    return unjudged([family(name, t) for t in at], value, error, n[0])


def _innovations(answers: Answers, judged: bool) -> tuple[Row, ...]:
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is None or S is None:
        return ()
    late, m = answers.late, nu.shape[-1]
    rows = _squares(NIS(), normalised_squares(nu, S)[:, late], m, judged)
    early = late - 1
    white = pairs_of(nu[:, late], nu[:, early], S[:, late], S[:, early])
    mean = mean_of_trials(white)
    if judged:
        return rows + plain(INNOVATION_PAIRS(), *mean, 1.0, WHITE, RELATIVE)
    return rows + unjudged(INNOVATION_PAIRS(), *mean, 1.0, WHITE)


def _squares(
    statistic: Statistic, squares: Float[Array, "n i"], dimension: int, judged: bool
) -> tuple[Row, ...]:
    mean = mean_of_trials(squares)
    if judged:
        most = RELATIVE * dimension
        return nees(statistic, *mean, float(dimension), CHI_SQUARE, most)
    return unjudged(statistic, *mean, prediction=float(dimension), predictor=CHI_SQUARE)


def lost_row(answers: Answers, judged: bool) -> tuple[Row, ...]:
    """Share of trials that stray beyond thirty degrees in their second half."""
    angle = np.linalg.norm(answers.error, axis=-1)
    share = float(diverged(angle, since=angle.shape[1] // 2).mean())
    if judged:
        return limit(DIVERGED(), share, 0.0, NORMAL, len(angle))
    return unjudged(DIVERGED(), share, 0.0, len(angle))


def root_mean_square(values: Float[Array, "n k"]) -> tuple[float, float, int]:
    """Root mean square over all, its standard error by trials, and their count."""
    square, error, n = mean_of_trials(values**2)
    root = float(np.sqrt(square))
    return root, error / (2.0 * root) if root > 0.0 else 0.0, n


def spread(count: int) -> NDArray[np.intp]:
    """Places of the instants that are shown, the last one among them."""
    return np.unique(np.linspace(0, count - 1, SHOWN).astype(np.intp))


FORMS: Final = ("tilt", "heading", "mounting", "delay")

ONE: Final = "one form"

MOST: Final = 0.8
"""Of what trials share, from which one form is the cause."""

SHARED: Final = 0.5
"""Of the squared error of a filter without a covariance that one form may be: no motion
and no gain makes a constant."""

FAR: Final = 6.5
"""Standard errors below the bound: by chance once in 10^10 cells."""

SLACK: Final = 0.02
"""Of the bound: what its first order leaves out."""


def diagnosis_rows(
    answers: Answers,
    rate: Float[Array, "k 3"],
    bound: Float[Array, "i 3 3"],
    judged: bool,
) -> tuple[Row, ...]:
    """What all trials share of the error, by its form, and what is stated of parts.

    Judged are an error below the bound and, without a covariance, a form that is most
    of the error.
    """
    e, A = answers.error, attitude_matrix(answers.truth[answers.late])
    n = len(e)
    mean, square = e.mean(axis=0), float(np.mean(np.sum(e**2, axis=-1)))
    # the mean of n has a share 1/n of the variance by chance
    chance = np.sum(e.var(axis=0, ddof=1), axis=-1) / n
    shared = max(float(np.mean(np.sum(mean**2, axis=-1) - chance)), 0.0)
    share = shared / square if square > 0.0 else 0.0
    rows = [*unjudged(SYSTEMATIC(), share, 0.0, n)]
    total, most = float(np.sum(mean**2)), 0.0
    for name, X in zip(FORMS, _forms(A, rate[answers.late]), strict=True):
        flat = X.reshape(-1, X.shape[-1])
        inverse = np.linalg.pinv(flat)
        each = e.reshape(n, -1) @ inverse.T
        value, left = each.mean(axis=0), mean.ravel() - flat @ each.mean(axis=0)
        explained = 1.0 - float(left @ left) / total if total > 0.0 else 0.0
        size = float(np.linalg.norm(value))
        signed = float(value[0]) if len(value) == 1 else size
        error = float(np.linalg.norm(each.std(axis=0, ddof=1)) / np.sqrt(n))
        rows += unjudged(SYSTEMATIC(name), share * max(explained, 0.0), 0.0, n)
        most = max(most, explained)
        unit = "s" if name == "delay" else "rad"
        rows += unjudged(CONSTANT(name, unit=unit), signed, error, n)
    whole = float(np.sqrt(np.trace(bound, axis1=1, axis2=2).mean()))
    rms, error, _ = root_mean_square(np.linalg.norm(e, axis=-1))
    if judged and answers.found.covariance is None:
        cause = share * most if most >= MOST else 0.0
        rows += limit(SYSTEMATIC(ONE), cause, SHARED + FAR / n, NORMAL, n)
    if judged:
        below = max(1.0 - (rms + FAR * error) / whole, 0.0)
        rows += limit(RMS_BELOW_BOUND(), below, SLACK, CRAMER_RAO, n)
    return (*rows, *_stated(answers, A, bound))


def _forms(
    A: Float[Array, "i 3 3"], rate: Float[Array, "i 3"]
) -> tuple[Float[Array, "i 3 p"], ...]:
    mounting = np.broadcast_to(np.eye(3), A.shape)
    return A[:, :, :2], A[:, :, 2:], mounting, -rate[:, :, None]


def _stated(
    answers: Answers, A: Float[Array, "i 3 3"], bound: Float[Array, "i 3 3"]
) -> tuple[Row, ...]:
    # heading and inclination apart, in the world, and each reading's innovation
    rows: list[Row] = []
    P = answers.found.covariance
    if P is not None:
        parts = np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
        own, least = (
            np.diagonal(A.swapaxes(-1, -2) @ each @ A, axis1=-2, axis2=-1)
            for each in (P[:, answers.late, :3, :3], bound)
        )
        error = (answers.error[..., None, :] @ A)[..., 0, :] ** 2
        for name, part in zip(("heading", "inclination"), parts, strict=True):
            squares = (error @ part) / (own @ part)
            rows += unjudged(PART_OVER_STATED(name), *mean_of_trials(squares), 1.0)
            ratio = np.sqrt((own @ part).mean() / (least @ part).mean())
            rows += unjudged(STATED_OVER_BOUND(name), float(ratio), 0.0, len(P))
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is not None and S is not None:
        late = answers.late
        ratio = nu[:, late] ** 2 / np.diagonal(S[:, late], axis1=2, axis2=3)
        for j in range(ratio.shape[-1]):
            mean = mean_of_trials(ratio[..., j])
            rows += unjudged(PART_OF_INNOVATION(str(j + 1)), *mean, 1.0)
    return tuple(rows)
