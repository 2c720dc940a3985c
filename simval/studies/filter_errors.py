r"""Errors of an attitude filter in many trials, and what it states of them.

Where the filter is told the truth and nothing disturbs it, its normalised squared error
(NEES) must have the mean that chi-square gives, 3 for the attitude and 6 with the bias,
its normalised squared innovations (NIS) the number of them, and its innovations must
not correlate; both sides are judged. Beside chance they may be off by the second order
and by what averages leave out of the turns, each as theory has it of the cell. Judged
are means of whole trials with their own standard error, and the worst instant by the
exact law over trials: rows of one trial are correlated and are never counted as samples
(`simval.consistency`).

Noise, start and bias are drawn anew for each trial, so the mean over trials of a sound
filter's error is 0 to first order. What is left of a mean :math:`m_k` at the instants k
is the filter's own, and each cause has a form, with the rate :math:`\omega_k` and the
attitude :math:`A_k`, world to body:

.. math:: m_k = A_k (c_w, c_n, 0)' \;\text{(tilt)}, \quad A_k (0, 0, c)' \;\text{
   (heading)}, \quad c \;\text{(mounting)}, \quad -\omega_k \tau \;\text{(delay)}.
   \tag{F14}

Each is fitted alone. What none of them explains is of the motion: coning, a scale.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from simval import statistics as stat
from simval.arrays import Array, Places
from simval.consistency import (
    diverged,
    heading_and_inclination,
    instant_scores,
    mean_of_trials,
    normalised_squares,
    pairs_of,
    rotation_error,
    settled_at,
    whitened,
)
from simval.geometry import attitude_matrix, compose
from simval.imu.filters.signals import FilterOutput
from simval.results import Row, Rows, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.theory import FilterPrediction

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
"""Of a NEES or NIS: what Q leaves out of the turn of a step, its square over 12, which
is 0.0015 at 25 Hz in the fastest scenario."""
LEAST_SHOWN: Final = 1e-4
"""Of a mean square: a source that never has more, a hundredth of the error, is not
shown in the budget."""
GROWS = 3.0
"""Of a normalised square, by eq. (F15)'s square of the second order."""
MOST: Final = 0.8
"""Of what trials share, from which one form is the cause."""
SHARED: Final = 0.5
"""Of the squared error of a filter without a covariance that one form may be: no motion
and no gain makes a constant."""
FAR: Final = 6.5
"""Standard errors below the bound: by chance once in 10^10 cells."""
SLACK: Final = 0.02
"""Of the bound: what its first order leaves out."""

ATTITUDE, BOTH = "attitude", "attitude and bias"
HEADING, INCLINATION = "heading", "inclination"
FORMS: Final = ("tilt", "heading", "mounting", "delay")
ONE: Final = "one form"


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """Answers of a filter at some instants and the rows before, with the truth."""

    found: FilterOutput
    truth: Float[Array, "k 4"]  # at the rows that were kept
    bias: Float[Array, "n k 3"]
    time: Float[Array, " k"]  # s
    late: Places  # places of the instants among the rows kept
    shifted: bool = False  # whether its headings count from its own first one

    @property
    def rows(self) -> Places:
        """Rows of the readings at the instants."""
        return self.found.kept[self.late]

    @cached_property
    def error(self) -> Float[Array, "n i 3"]:
        """Attitude errors at the instants, rad."""
        return rotation_error(self.found.attitude[:, self.late], self.truth[self.late])

    @cached_property
    def angle(self) -> Float[Array, "n i"]:
        """Sizes of the attitude errors, rad."""
        return np.linalg.norm(self.error, axis=-1)

    def from_its_own_heading(self) -> "Answers":
        """The answers, each trial turned so that its first heading is right."""
        q, first = self.found.attitude, self.late[0]
        heading, _ = heading_and_inclination(q[:, first], self.truth[first])
        back = np.zeros((len(q), 1, 4))
        back[..., 2], back[..., 3] = (
            f(-heading[:, None] / 2.0) for f in (np.sin, np.cos)
        )
        turned = compose(np.broadcast_to(back, q.shape), q)
        return replace(self, found=replace(self.found, attitude=turned), shifted=True)

    def whitened(self, rows: Places) -> Float[Array, "n i m"] | None:
        """Innovations of some rows, whitened by their stated covariance."""
        nu, S = self.found.innovation, self.found.innovation_covariance
        return None if nu is None or S is None else whitened(nu[:, rows], S[:, rows])

    @cached_property
    def innovations(self) -> Float[Array, "n i m"] | None:
        """Whitened innovations at the instants."""
        return self.whitened(self.late)

    @cached_property
    def squares(self) -> list[tuple[stat.Statistic, int, Float[Array, "n i"]]]:
        """NEES of the attitude, NEES with the bias, and NIS, with their dimensions."""
        found, late, e, white = self.found, self.late, self.error, self.innovations
        each = []
        if found.covariance is not None:
            P = found.covariance[:, late]
            each += [(stat.NEES(), 3, normalised_squares(e, P[..., :3, :3]))]
            if P.shape[-1] >= 6 and found.bias is not None:
                off = found.bias[:, late] - self.bias[:, late]
                both = np.concatenate([e, off], axis=-1)
                six = normalised_squares(both, P[..., :6, :6])
                each += [(stat.NEES(BOTH), 6, six)]
        if white is not None:
            each += [(stat.NIS(), white.shape[-1], np.vecdot(white, white))]
        return each

    def shown(self) -> tuple[Places, list[str]]:
        """Indices and times of the instants that are shown, the last included."""
        time = self.time[self.late]
        places = np.unique(np.linspace(0, len(time) - 1, SHOWN).astype(np.intp))
        return places, [f"{t:.6g}" for t in time[places]]


def error_rows(
    answers: Answers,
    bound: Float[Array, "i 3 3"],
    judged: bool,
    left: Array | float = 0.0,
) -> Rows:
    """Errors against the bound, also of heading and inclination and over time.

    Judged is that the error reaches the bound.
    """
    late, angle = answers.late, answers.angle
    estimate, truth = answers.found.attitude[:, late], answers.truth[late]
    heading, inclination = heading_and_inclination(estimate, truth)
    square = np.linalg.trace(bound)
    whole, least = np.sqrt(square.mean()), np.sqrt(square)
    over = OVER + np.mean(left)
    check = partial(plain, remainder=over * whole) if judged else unjudged
    rms, error, n = root_mean_square(angle)
    rows = [
        *check(stat.RMS(unit="rad"), rms, error, n, whole, stat.CRAMER_RAO),
        *unjudged(stat.RMS_OVER_BOUND(), rms / whole, error / whole, n),
        *unjudged(stat.RMS(HEADING, unit="rad"), *root_mean_square(heading)),
        *unjudged(stat.RMS(INCLINATION, unit="rad"), *root_mean_square(inclination)),
    ]
    settled = settled_at(angle, answers.time[late], np.maximum(SETTLED * least, ENOUGH))
    ended = np.isfinite(settled)
    rows += unjudged(stat.SETTLING_TRIALS(), ended.mean(), 0.0, len(settled))
    if ended.any():
        middle = np.median(settled[ended])
        rows += unjudged(stat.SETTLING(), middle, 0.0, int(ended.sum()))
    shown, at = answers.shown()
    return (
        *rows,
        *at_each_row(stat.RMS_AT, answers, angle, root_mean_square),
        *unjudged([stat.BOUND_AT(ATTITUDE, t) for t in at], least[shown]),
        *over_bound_rows(answers, bound, np.ones(len(least)), stat.CRAMER_RAO),
    )


def over_bound_rows(
    answers: Answers,
    bound: Float[Array, "i 3 3"],
    prediction: Float[Array, " i"],
    predictor: str,
) -> Rows:
    """Ratio of errors to the bound over time, against its prediction."""
    shown, _ = answers.shown()
    least = np.sqrt(np.linalg.trace(bound))[shown]
    rows = at_each_row(stat.RMS_OVER_BOUND_AT, answers, answers.angle, root_mean_square)
    return tuple(
        replace(
            row,
            value=row.value / float(own),
            standard_error=row.standard_error / float(own),
            prediction=float(by),
            predictor=predictor,
        )
        for row, own, by in zip(rows, least, prediction[shown], strict=True)
    )


def consistency_rows(
    answers: Answers,
    judged: bool,
    left: Array | float = 0.0,
    least: FilterPrediction | None = None,
) -> Rows:
    """NEES, NIS and correlation of innovations.

    A square may have more by the second order, whose own square is `left`, and, as
    theory has it of right settings, `least`, by what averages leave out of the turns.
    """
    rows: list[Row] = []
    pairs_left = RELATIVE + np.mean(bends(left, 0.0))
    for statistic, dimension, squares in answers.squares:
        mean, of = mean_of_trials(squares), (float(dimension), stat.CHI_SQUARE)
        turns = added(least, statistic, dimension) if least else np.zeros(1)
        more = turns + bends(left, turns)
        may = RELATIVE * dimension + more.mean()
        check = partial(nees, remainder=may) if judged else unjudged
        rows += check(statistic, *mean, *of)
        if statistic == stat.NIS():  # the sum of two alike has it twice
            pairs_left += 2.0 * turns.mean() / dimension
        if judged and statistic.family == stat.NEES:
            worst = np.abs(instant_scores(squares, dimension)).max()
            name = statistic.entries[0] if statistic.entries else ATTITUDE
            n = len(squares)
            # about a mean that is not 0 a square spreads more
            most = WORST * np.sqrt(1.0 + 2.0 * turns.max() / dimension)
            most += more.max() * np.sqrt(n / (2.0 * dimension))
            rows += limit(stat.WORST_INSTANT(name), worst, most, stat.CHI_SQUARE, n)
        if statistic == stat.NEES():
            rows += at_each_row(stat.NEES_AT, answers, squares, mean_of_trials)
    white, before = answers.innovations, answers.whitened(answers.late - 1)
    if white is not None and before is not None:
        pairs = mean_of_trials(pairs_of(white, before))
        check = partial(plain, remainder=pairs_left) if judged else unjudged
        rows += check(stat.INNOVATION_PAIRS(), *pairs, 1.0, stat.WHITE)
    return tuple(rows)


def predicted_rows(
    answers: Answers,
    theory: FilterPrediction,
    judged: bool,
    left: Array | float = 0.0,
) -> Rows:
    """Errors of the reference filter, against their prediction.

    Judged where the whole error stays small enough for the first order.
    """
    moment = np.linalg.trace(theory.second_moment[:, :3, :3])
    root = np.sqrt(moment.mean())
    measured = [(stat.RMS(unit="rad"), root_mean_square(answers.angle), root)]
    for statistic, dimension, squares in answers.squares:
        known = dimension + added(theory, statistic, dimension).mean()
        measured.append((statistic, mean_of_trials(squares), known))
    steady = normalised_squares(theory.mean[:, :3], theory.told[:, :3, :3])
    over = OVER + bends(left, steady).mean() / theory.nees(3).mean()
    check = plain if judged else unjudged
    rows: Rows = ()
    for statistic, mean, expected in measured:
        rows += check(
            statistic, *mean, expected, stat.CARRIED, remainder=over * expected
        )
    return rows


def bends(left: Array | float, steady: Array | float) -> Array:
    """Increase of a normalised square by the second order.

    With a steady error, whose own is given, it has a product that does not average out.
    """
    return np.asarray(GROWS * left + 2.0 * np.sqrt(left * np.maximum(steady, 0.0)))


def added(
    theory: FilterPrediction, statistic: stat.Statistic, dimension: int
) -> Float[Array, " i"]:
    """Predicted mean of a normalised square, minus its dimension."""
    if statistic == stat.NIS():  # of all readings, of which a filter may state fewer
        return theory.nis - theory.nis_size
    return theory.nees(dimension) - dimension


def at_each_row(
    family: stat.Family,
    answers: Answers,
    values: Float[Array, "n k"],
    mean: Callable[[Float[Array, "n 1"]], tuple[float, float, int]],
) -> Rows:
    """A row for each instant that is shown."""
    shown, at = answers.shown()
    each = [mean(values[:, k : k + 1]) for k in shown]
    value, error, n = zip(*each, strict=True)
    return unjudged([family(ATTITUDE, t) for t in at], value, error, n[0])


def lost_row(answers: Answers, judged: bool) -> Rows:
    """Share of diverging trials, off by over thirty degrees in the second half."""
    angle = answers.angle
    share, n = diverged(angle, since=angle.shape[1] // 2).mean(), len(angle)
    if judged:
        return limit(stat.DIVERGED(), share, 0.0, stat.NORMAL, n)
    return unjudged(stat.DIVERGED(), share, 0.0, n)


def root_mean_square(values: Float[Array, "n k"]) -> tuple[float, float, int]:
    """Root mean square over all, its standard error by trials, and their count."""
    square, error, n = mean_of_trials(values**2)
    root = np.sqrt(square)
    return root, error / (2.0 * root) if root > 0.0 else 0.0, n


def budget_rows(answers: Answers, theory: FilterPrediction) -> Rows:
    """Contribution of each source to the predicted error."""
    rows: list[Row] = []
    shown, at = answers.shown()
    variances = np.linalg.trace(theory.parts[:, :, :3, :3])
    known = np.sum(theory.mean[:, :3] ** 2, axis=1)
    several = (*zip(theory.names, variances, strict=True), ("known errors", known))
    whole = variances.sum(axis=0) + known
    for name, square in several:
        if np.any(square > LEAST_SHOWN * whole):
            rows += unjudged(
                [stat.BUDGET_AT(name, t) for t in at], np.sqrt(square[shown])
            )
    return tuple(rows)


def diagnosis_rows(
    answers: Answers,
    rate: Float[Array, "k 3"],
    bound: Float[Array, "i 3 3"],
    judged: bool,
) -> Rows:
    """Error common to all trials, by form, and stated covariance of parts.

    Judged are an error below the bound and, without a covariance, a form that is most
    of the error.
    """
    late, e = answers.late, answers.error
    n, A = len(e), attitude_matrix(answers.truth[late])
    mounting = np.broadcast_to(np.eye(3), A.shape)
    forms = A[:, :, :2], A[:, :, 2:], mounting, -rate[late][:, :, None]
    mean, square = e.mean(axis=0), np.mean(np.sum(e**2, axis=-1))
    # the mean of n has a share 1/n of the variance by chance
    chance = np.sum(e.var(axis=0, ddof=1), axis=-1) / n
    shared = max(np.mean(np.sum(mean**2, axis=-1) - chance), 0.0)
    share = shared / square if square > 0.0 else 0.0
    rows = [*unjudged(stat.SYSTEMATIC(), share, 0.0, n)]
    total, most = np.sum(mean**2), 0.0
    for name, X in zip(FORMS, forms, strict=True):
        flat = X.reshape(-1, X.shape[-1])
        each = e.reshape(n, -1) @ np.linalg.pinv(flat).T
        value, left = each.mean(axis=0), mean.ravel() - flat @ each.mean(axis=0)
        explained = 1.0 - (left @ left) / total if total > 0.0 else 0.0
        signed = value[0] if len(value) == 1 else np.linalg.norm(value)
        error = np.linalg.norm(each.std(axis=0, ddof=1)) / np.sqrt(n)
        rows += unjudged(stat.SYSTEMATIC(name), share * max(explained, 0.0), 0.0, n)
        most = max(most, explained)
        unit = "s" if name == "delay" else "rad"
        rows += unjudged(stat.CONSTANT(name, unit=unit), signed, error, n)
    whole = np.sqrt(np.linalg.trace(bound).mean())
    rms, error, _ = root_mean_square(answers.angle)
    if judged and answers.found.covariance is None:
        cause = share * most if most >= MOST else 0.0
        rows += limit(stat.SYSTEMATIC(ONE), cause, SHARED + FAR / n, stat.NORMAL, n)
    if judged:
        below = max(1.0 - (rms + FAR * error) / whole, 0.0)
        rows += limit(stat.RMS_BELOW_BOUND(), below, SLACK, stat.CRAMER_RAO, n)
    return (*rows, *_stated(answers, A, bound))


def _stated(
    answers: Answers, A: Float[Array, "i 3 3"], bound: Float[Array, "i 3 3"]
) -> Rows:
    # heading and inclination apart, in the world, and each reading's innovation
    rows: list[Row] = []
    P = answers.found.covariance
    if P is not None:
        parts = np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
        own, least = (
            np.linalg.diagonal(A.mT @ each @ A)
            for each in (P[:, answers.late, :3, :3], bound)
        )
        error = (answers.error[..., None, :] @ A)[..., 0, :] ** 2
        for name, part in zip(("heading", "inclination"), parts, strict=True):
            squares = (error @ part) / (own @ part)
            rows += unjudged(stat.PART_OVER_STATED(name), *mean_of_trials(squares), 1.0)
            ratio = np.sqrt((own @ part).mean() / (least @ part).mean())
            rows += unjudged(stat.STATED_OVER_BOUND(name), float(ratio), 0.0, len(P))
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is not None and S is not None:
        late = answers.late
        ratio = nu[:, late] ** 2 / np.linalg.diagonal(S[:, late])
        for j in range(ratio.shape[-1]):
            mean = mean_of_trials(ratio[..., j])
            rows += unjudged(stat.PART_OF_INNOVATION(str(j + 1)), *mean, 1.0)
    return tuple(rows)
