r"""Attitude filter: its errors over many trials against its covariance and the bound.

A scenario is recorded once (`simval.studies.filter_scenarios`); over it each trial
draws the noise of all sensors, a bias of the gyroscope that walks, and the attitude
that the filter is told to start from. The filter, anybody's, is stepped through the
rows.

Where the filter is told the truth and nothing disturbs it, its normalised squared error
(NEES) must have the mean that chi-square gives, 3 for the attitude and 6 with the bias,
its normalised squared innovations (NIS) the number of them, and its innovations must
not correlate; both sides are judged. Judged are means of whole trials with their own
standard error, and the worst instant by the exact law over trials: rows of one trial
are correlated and are never counted as samples (`simval.consistency`).

The root mean square error is set against the posterior Cramer-Rao bound
(`simval.theory.filter_recursion`). Where the filter is told otherwise, or a calibration
left an error, or a sensor reads what it should not, theory predicts what the reference
filter then does; another filter is only shown.

Noise, start and bias are drawn anew for each trial, so the mean over trials of a sound
filter's error is 0 to first order. What is left of a mean :math:`m_k` at the instants k
is the filter's own, and each cause has a form, with the rate :math:`\omega_k` and the
attitude :math:`A_k`, world to body:

.. math:: m_k = A_k (c_w, c_n, 0)' \;\text{(tilt)}, \quad A_k (0, 0, c)' \;\text{
   (heading)}, \quad c \;\text{(mounting)}, \quad -\omega_k \tau \;\text{(delay)}.
   \tag{F14}

Each is fitted alone. What none of them explains is of the motion: coning, a scale.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from typing import Annotated, Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from simval import statistics as stat
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
from simval.errors import InputError, UnmeasurableError
from simval.figures import Figure, Headline, Listing, Quote, along_entry, entry, words
from simval.geometry import attitude_matrix, compose
from simval.imu.filters.signals import FilterInput, FilterOutput, Told
from simval.plugins import Filter
from simval.plugins.runs import run_filter, run_once
from simval.plugins.worlds import find_world, path
from simval.results import Row, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.filter_prediction import (
    drawn_filter_rows,
    prediction,
    response_rows,
    stated_row,
    undisturbed,
)
from simval.studies.filter_scenarios import (
    ANYWHERE,
    ROWS,
    UNKNOWN,
    Course,
    Imperfect,
    Wrong,
    course,
    drawn,
    scenario_of,
    spelled,
    steps_of,
)
from simval.studies.plugin import (
    AlgorithmParameters,
    Call,
    PluginName,
    Problem,
    Seconds,
    compute,
    outcome,
    run,
)
from simval.studies.study import LEAST_NOISE, Cost, ranged
from simval.theory import FilterPrediction
from simval.units import COUNT, DEGREE

__all__ = ["FIGURES", "HEADLINE", "SECTION", "TITLE", "Parameters", "compute"]
__all__ += ["outcome", "run"]

TITLE = "Attitude filter: errors, stated covariance, and the bound"
SECTION = "filters"

REFERENCE = "simval:mekf"
BLOCK = 8  # trials; part of the promise of equal bits
SMALL = 0.02
"""Rad: a start beyond it is not forgotten before it bends what a filter says of itself,
beside sensors of 2 and 5 mrad (docs/filters.md)."""
INSTANTS = 100
"""At which errors are kept, evenly in time, each with the row before."""
SHOWN = 25
"""Instants in the table and the figure."""
LEAST_READ = 1e-6
"""Of a reading: its square is then 4e-12 of the greatest variance of the start, which a
filter adds to it; less than 1e-15 of that is lost in rounding, and singular."""
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

    @property
    def angle(self) -> Float[Array, "n i"]:
        """Their sizes."""
        return np.asarray(np.linalg.norm(self.error, axis=-1))

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

    def squares(self) -> Iterator[tuple[stat.Statistic, int, Float[Array, "n i"]]]:
        """NEES of the attitude, and with the bias, and NIS, each with its dimension."""
        found, late, e = self.found, self.late, self.error
        if found.covariance is not None:
            P = found.covariance[:, late]
            yield stat.NEES(), 3, normalised_squares(e, P[..., :3, :3])
            if P.shape[-1] >= 6 and found.bias is not None:
                off = found.bias[:, late] - self.bias[:, late]
                both = np.concatenate([e, off], axis=-1)
                yield stat.NEES(BOTH), 6, normalised_squares(both, P[..., :6, :6])
        nu, S = found.innovation, found.innovation_covariance
        if nu is not None and S is not None:
            yield stat.NIS(), nu.shape[-1], normalised_squares(nu, S)[:, late]

    def shown(self) -> tuple[NDArray[np.intp], list[str]]:
        """Places of the instants that are shown, among them the last, and times."""
        time = self.time[self.late]
        places = np.unique(np.linspace(0, len(time) - 1, SHOWN).astype(np.intp))
        return places, [f"{t:.6g}" for t in time[places]]


class Filtering(Problem[Filter, str, Answers]):
    """Attitudes of a body over time, from noisy readings of a scenario."""

    kind = Filter

    def __init__(
        self, plugin: Filter, parameters: "Parameters", streams: Streams
    ) -> None:
        super().__init__(plugin, parameters, streams)
        try:
            self.way = parameters.course
        except InputError as error:  # how long it lasts is known when it is simulated
            raise UnmeasurableError(str(error)) from None
        self.sensors = sensors_of(parameters, self.way)
        self.told = told_of(parameters, self.way)

    @cached_property
    def draws(self) -> list[tuple[FilterInput, Float[Array, "n T 3"]]]:
        """Readings and biases of each block of trials."""
        given = self.way, self.sensors, self.told, BLOCK
        return [
            drawn(*given, self.streams.block(i), self.parameters.anywhere)
            for i in range(-(-self.parameters.trials // BLOCK))
        ]

    def probe(self) -> str:
        """World of the filter, as it is found without noise."""
        # of our own a test knows it; it takes as long as the trials do
        own = self.parameters.reference and self.plugin.world
        return own or find_world(self.plugin, self.told, self.parameters.rate).world

    def trials(self, probed: str) -> Answers:
        """Answers for all trials at the instants; some are repeated as they run."""
        kept, late = instants(len(self.way.dt))
        given = joined([readings for readings, _ in self.draws])
        answers = Answers(
            found=run_filter(self.plugin, given, kept, probed),
            truth=self.way.attitude[kept + 1],
            bias=np.concatenate([bias[:, kept] for _, bias in self.draws]),
            time=self.way.time[kept],
            late=late,
        )
        if self.plugin.magnetometer or "start" in self.plugin.reads:
            return answers
        return answers.from_its_own_heading()

    def rows(self, probed: str, answers: Answers) -> tuple[Row, ...]:
        """Its errors and what it states of them, and what they stand on."""
        parameters, plugin, way = self.parameters, self.plugin, self.way
        kept, late = instants(len(way.dt))
        exact = replace(self.sensors, M=np.eye(3), calibration_std=0.0)
        at = kept[late], plugin.magnetometer
        least = prediction(undisturbed(way), exact, exact.told(way), *at)
        theory = prediction(way, self.sensors, self.told, *at)
        rows = measured_rows(parameters, way, answers, (least, theory), way.rate[kept])
        rows += drawn_filter_rows(way, self.sensors, self.draws)
        if parameters.reference and not parameters.anywhere and not way.disturbed:
            scenario = parameters.named_scenario
            rows += stated_row(plugin, self.told, probed, (scenario, parameters.rate))
            if parameters.wrong == Wrong():  # as they do not depend on what it is told
                rows += response_rows(plugin.make, scenario)
        return rows

    def artifacts(self, answers: Answers) -> Mapping[str, Mapping[str, Array]]:
        """Truth and estimate of one trial, for the page."""
        late = answers.late
        content = {
            "time": answers.time[late],
            "truth": answers.truth[late],
            "estimate": answers.found.attitude[0, late],
        }
        return {artifact_of(self.parameters.named()): content}

    def call(self) -> Call:
        """A rest of a second and a turn of another."""
        given = path(self.told, self.parameters.rate, 1.0, 1.0).given
        return run_once, (given,), len(given.dt)


class Parameters(AlgorithmParameters):
    """One cell: a filter, a scenario, its sensors, and the filter's settings."""

    problem = Filtering
    no_noise = ("algorithm", "scenario", "time_limit")

    algorithm: PluginName = Field(
        default=REFERENCE, description="FILE.py, FILE.py:NAME or an entry point."
    )
    scenario: Annotated[str, AfterValidator(spelled)] = Field(
        default="gimbal slow",
        description="What happens (docs/filters.md), then after commas what is wrong: "
        '"gimbal slow, scale 1e-3".',
    )
    rate: float = ranged(
        100.0, "Rows per second: 500 Hz over a whole number.", 25.0, 500.0
    )
    seconds: float = ranged(20.0, "Length of a trial, s.", 4.0, 100.0)
    accelerometer_noise: float = ranged(
        2e-3, "Noise per axis and row, as a share of gravity.", LEAST_READ, 0.1
    )
    magnetometer_noise: float = ranged(
        5e-3, "Noise per axis and row, as a share of the field.", LEAST_READ, 0.1
    )
    angle_random_walk: float = ranged(
        0.01, "White noise, degrees/s per root hertz.", LEAST_NOISE, 1.0
    )
    rate_random_walk: float = ranged(
        2e-5, "Random walk of the gyroscope's bias, rad/s^2 per root hertz.", 0.0, 0.01
    )
    bias_std: float = ranged(
        1e-3, "Standard deviation of the first bias, rad/s per axis.", LEAST_NOISE, 0.1
    )
    start_std: float = ranged(
        5e-3, "Standard deviation of the start told, rad per axis.", LEAST_NOISE, 0.5
    )
    trials: int = ranged(256, "Trials; rounded up to whole blocks of 8.", BLOCK)
    time_limit: Seconds = Field(
        default=600.0, description="Wall time after which the cell fails, s."
    )

    def cost(self) -> Cost:
        """Cost of a cell: a filter of many trials at once, or one by one."""
        steps = self.rate * self.seconds * self.trials
        own = self.algorithm.startswith("simval:")
        return Cost(2.0 + steps * (1.2e-5 if own else 1e-4), 150)

    @model_validator(mode="after")
    def _require_scenario(self) -> Self:
        """Check that there is such a scenario, at a rate that it can have."""
        scenario_of(self.scenario)
        steps_of(ROWS, self.rate, self.seconds)
        return self

    @property
    def named_scenario(self) -> str:
        """Name of the scenario alone."""
        return scenario_of(self.scenario)[0]

    @property
    def course(self) -> Course:
        """Readings of ideal sensors in the scenario."""
        return course(self.named_scenario, self.rate, self.seconds)

    @property
    def wrong(self) -> Wrong:
        """Wrong settings of the filter, or errors that a calibration left."""
        return scenario_of(self.scenario)[1]

    @property
    def anywhere(self) -> bool:
        """True if the start is unknown."""
        return self.named_scenario == ANYWHERE

    @property
    def reference(self) -> bool:
        """True for the package's own filter, whose errors theory predicts."""
        return self.algorithm == REFERENCE


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the attitudes of a cell with these parameters."""
    words = repr(sorted(named.items())).encode()
    return f"filter-{sha256(words).hexdigest()[:16]}.npz"


def sensors_of(parameters: Parameters, way: Course) -> Imperfect:
    """The sensors as they are."""
    wrong = parameters.wrong
    return Imperfect(
        gyroscope_noise=float(np.radians(parameters.angle_random_walk)),
        gyroscope_walk=parameters.rate_random_walk,
        accelerometer_noise=parameters.accelerometer_noise * way.g,
        magnetometer_noise=parameters.magnetometer_noise
        * float(np.linalg.norm(way.magnetic)),
        start_std=UNKNOWN if parameters.anywhere else parameters.start_std,
        bias_std=parameters.bias_std,
        M=wrong.M,
        calibration_std=wrong.calibration,
    )


def told_of(parameters: Parameters, way: Course) -> Told:
    """Settings given to the filter."""
    return parameters.wrong.told(sensors_of(parameters, way).told(way))


def joined(parts: list[FilterInput]) -> FilterInput:
    """Trials of several blocks together."""
    several = ("gyroscope", "accelerometer", "magnetometer", "start")
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in several
    }
    return replace(parts[0], **whole)


def instants(steps: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows that are kept, the instants and the row before each, and places of them."""
    late = np.unique(np.linspace(0, steps - 1, INSTANTS + 1).astype(np.intp)[1:])
    late = late[late > 0]
    kept = np.unique(np.concatenate([late - 1, late]))
    return kept, np.searchsorted(kept, late)


def measured_rows(
    parameters: Parameters,
    way: Course,
    answers: Answers,
    predictions: tuple[FilterPrediction, FilterPrediction],
    rate: Float[Array, "k 3"],
) -> tuple[Row, ...]:
    """Rows of a filter's answers, against the bound and what theory predicts."""
    least, theory = predictions
    small = parameters.start_std <= SMALL and not parameters.anywhere
    first_order = small and not way.disturbed
    judged = first_order and parameters.wrong == Wrong() and not answers.shifted
    bound = least.told[:, :3, :3]
    rows = [
        *error_rows(answers, bound, judged and parameters.reference),
        *consistency_rows(answers, judged),
        *lost_row(answers, judged),
    ]
    if not parameters.reference:  # whose own tests know it
        rows += diagnosis_rows(answers, rate, bound, judged)
    if parameters.reference and not parameters.anywhere:
        if not judged:  # else it is what is said above
            rows += predicted_rows(answers, theory, first_order)
        rows += budget_rows(answers, theory)
        moment = np.trace(theory.second_moment[:, :3, :3], axis1=1, axis2=2)
        ratio = np.sqrt(moment / np.trace(bound, axis1=-2, axis2=-1))
        rows += over_bound_rows(answers, bound, ratio, stat.CARRIED)
    return tuple(rows)


def error_rows(
    answers: Answers, bound: Float[Array, "i 3 3"], judged: bool
) -> tuple[Row, ...]:
    """Errors against the bound, heading and inclination apart, in all and at instants.

    Judged is that the error reaches the bound.
    """
    late, angle = answers.late, answers.angle
    estimate, truth = answers.found.attitude[:, late], answers.truth[late]
    heading, inclination = heading_and_inclination(estimate, truth)
    square = np.trace(bound, axis1=-2, axis2=-1)
    whole, least = float(np.sqrt(square.mean())), np.sqrt(square)
    check = partial(plain, remainder=OVER * whole) if judged else unjudged
    rms, error, n = root_mean_square(angle)
    rows = [
        *check(stat.RMS(unit="rad"), rms, error, n, whole, stat.CRAMER_RAO),
        *unjudged(stat.RMS_OVER_BOUND(), rms / whole, error / whole, n),
        *unjudged(stat.RMS(HEADING, unit="rad"), *root_mean_square(heading)),
        *unjudged(stat.RMS(INCLINATION, unit="rad"), *root_mean_square(inclination)),
    ]
    most = np.maximum(SETTLED * least, ENOUGH)
    settled = settled_at(angle, answers.time[late], most)
    ended = np.isfinite(settled)
    rows += unjudged(stat.SETTLING_TRIALS(), float(ended.mean()), 0.0, len(settled))
    if ended.any():
        middle = float(np.median(settled[ended]))
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
) -> tuple[Row, ...]:
    """Errors of the instants over the bound, against a prediction of that."""
    shown, _ = answers.shown()
    least = np.sqrt(np.trace(bound, axis1=-2, axis2=-1))[shown]
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


def consistency_rows(answers: Answers, judged: bool) -> tuple[Row, ...]:
    """NEES, NIS and the correlation of innovations, judged or only shown."""
    rows: list[Row] = []
    for statistic, dimension, squares in answers.squares():
        mean, of = mean_of_trials(squares), (float(dimension), stat.CHI_SQUARE)
        check = partial(nees, remainder=RELATIVE * dimension) if judged else unjudged
        rows += check(statistic, *mean, *of)
        if judged and statistic.family == stat.NEES:
            worst = float(np.abs(instant_scores(squares, dimension)).max())
            name = statistic.entries[0] if statistic.entries else ATTITUDE
            rows += limit(
                stat.WORST_INSTANT(name), worst, WORST, stat.CHI_SQUARE, len(squares)
            )
        if statistic == stat.NEES():
            rows += at_each_row(stat.NEES_AT, answers, squares, mean_of_trials)
    nu, S, late = (
        answers.found.innovation,
        answers.found.innovation_covariance,
        answers.late,
    )
    if nu is not None and S is not None:
        early = late - 1
        white = pairs_of(nu[:, late], nu[:, early], S[:, late], S[:, early])
        check = partial(plain, remainder=RELATIVE) if judged else unjudged
        rows += check(stat.INNOVATION_PAIRS(), *mean_of_trials(white), 1.0, stat.WHITE)
    return tuple(rows)


def predicted_rows(
    answers: Answers, theory: FilterPrediction, judged: bool
) -> tuple[Row, ...]:
    """Errors of the reference filter against what theory says that they are.

    Judged where the whole error stays small enough for the first order.
    """
    moment = np.trace(theory.second_moment[:, :3, :3], axis1=1, axis2=2)
    root = float(np.sqrt(moment.mean()))
    measured = [(stat.RMS(unit="rad"), root_mean_square(answers.angle), root)]
    for statistic, dimension, squares in answers.squares():
        known = theory.nis if statistic == stat.NIS() else theory.nees(dimension)
        measured.append((statistic, mean_of_trials(squares), float(known.mean())))
    check = plain if judged else unjudged
    rows: tuple[Row, ...] = ()
    for statistic, mean, expected in measured:
        rows += check(
            statistic, *mean, expected, stat.CARRIED, remainder=OVER * expected
        )
    return rows


def at_each_row(
    family: stat.Family,
    answers: Answers,
    values: Float[Array, "n k"],
    mean: Callable[[Float[Array, "n 1"]], tuple[float, float, int]],
) -> tuple[Row, ...]:
    """Rows of each instant that is shown by itself."""
    shown, at = answers.shown()
    each = [mean(values[:, k : k + 1]) for k in shown]
    value, error, n = zip(*each, strict=True)
    return unjudged([family(ATTITUDE, t) for t in at], value, error, n[0])


def lost_row(answers: Answers, judged: bool) -> tuple[Row, ...]:
    """Share of trials that diverge: beyond thirty degrees in their second half."""
    angle = answers.angle
    share, n = float(diverged(angle, since=angle.shape[1] // 2).mean()), len(angle)
    if judged:
        return limit(stat.DIVERGED(), share, 0.0, stat.NORMAL, n)
    return unjudged(stat.DIVERGED(), share, 0.0, n)


def root_mean_square(values: Float[Array, "n k"]) -> tuple[float, float, int]:
    """Root mean square over all, its standard error by trials, and their count."""
    square, error, n = mean_of_trials(values**2)
    root = float(np.sqrt(square))
    return root, error / (2.0 * root) if root > 0.0 else 0.0, n


def budget_rows(answers: Answers, theory: FilterPrediction) -> tuple[Row, ...]:
    """Contribution of each source to the predicted error, where there is one."""
    rows: list[Row] = []
    shown, at = answers.shown()
    variances = np.trace(theory.parts[:, :, :3, :3], axis1=2, axis2=3)
    known = np.sum(theory.mean[:, :3] ** 2, axis=1)
    several = (*zip(theory.names, variances, strict=True), ("known errors", known))
    for name, square in several:
        if np.any(square > 0.0):
            rows += unjudged(
                [stat.BUDGET_AT(name, t) for t in at], np.sqrt(square[shown])
            )
    return tuple(rows)


def diagnosis_rows(
    answers: Answers,
    rate: Float[Array, "k 3"],
    bound: Float[Array, "i 3 3"],
    judged: bool,
) -> tuple[Row, ...]:
    """Common error of all trials, by its form, and the stated covariance of parts.

    Judged are an error below the bound and, without a covariance, a form that is most
    of the error.
    """
    late, e = answers.late, answers.error
    n, A = len(e), attitude_matrix(answers.truth[late])
    mounting = np.broadcast_to(np.eye(3), A.shape)
    forms = A[:, :, :2], A[:, :, 2:], mounting, -rate[late][:, :, None]
    mean, square = e.mean(axis=0), float(np.mean(np.sum(e**2, axis=-1)))
    # the mean of n has a share 1/n of the variance by chance
    chance = np.sum(e.var(axis=0, ddof=1), axis=-1) / n
    shared = max(float(np.mean(np.sum(mean**2, axis=-1) - chance)), 0.0)
    share = shared / square if square > 0.0 else 0.0
    rows = [*unjudged(stat.SYSTEMATIC(), share, 0.0, n)]
    total, most = float(np.sum(mean**2)), 0.0
    for name, X in zip(FORMS, forms, strict=True):
        flat = X.reshape(-1, X.shape[-1])
        inverse = np.linalg.pinv(flat)
        each = e.reshape(n, -1) @ inverse.T
        value, left = each.mean(axis=0), mean.ravel() - flat @ each.mean(axis=0)
        explained = 1.0 - float(left @ left) / total if total > 0.0 else 0.0
        size = float(np.linalg.norm(value))
        signed = float(value[0]) if len(value) == 1 else size
        error = float(np.linalg.norm(each.std(axis=0, ddof=1)) / np.sqrt(n))
        rows += unjudged(stat.SYSTEMATIC(name), share * max(explained, 0.0), 0.0, n)
        most = max(most, explained)
        unit = "s" if name == "delay" else "rad"
        rows += unjudged(stat.CONSTANT(name, unit=unit), signed, error, n)
    whole = float(np.sqrt(np.trace(bound, axis1=1, axis2=2).mean()))
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
            rows += unjudged(stat.PART_OVER_STATED(name), *mean_of_trials(squares), 1.0)
            ratio = np.sqrt((own @ part).mean() / (least @ part).mean())
            rows += unjudged(stat.STATED_OVER_BOUND(name), float(ratio), 0.0, len(P))
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is not None and S is not None:
        late = answers.late
        ratio = nu[:, late] ** 2 / np.diagonal(S[:, late], axis1=2, axis2=3)
        for j in range(ratio.shape[-1]):
            mean = mean_of_trials(ratio[..., j])
            rows += unjudged(stat.PART_OF_INNOVATION(str(j + 1)), *mean, 1.0)
    return tuple(rows)


_OVER_TIME = Figure(
    name="filter-errors",
    asked="How near to the bound is each filter?",
    says=(
        "The RMS error is {least} times the bound ({least_of}) to {most} ({most_of})."
    ),
    about=[stat.RMS_OVER_BOUND],
    rows=[stat.RMS_AT],
    along=along_entry,
    axis="time, s",
    lines="algorithm",
    value="RMS error",
    unit=lambda row: DEGREE if row.unit == "rad" else COUNT,
    compared=False,
    floor=stat.BOUND_AT,
    log_x=False,
    columns=2,
    caption=(
        "Attitude error over time, root mean square of the trials. Dotted: the "
        "posterior Cramér-Rao bound, the least error of any filter with true settings."
    ),
)
FIGURES = (
    _OVER_TIME,
    replace(
        _OVER_TIME,
        name="filter-ratio",
        fold="The error over the bound, on a linear axis",
        says="",
        rows=[stat.RMS_OVER_BOUND_AT],
        by=stat.CRAMER_RAO,
        theories=(stat.CARRIED,),
        value="RMS error / bound",
        compared=True,
        ratio=False,
        floor=None,
        level=1.0,
        log_y=False,
        caption=(
            "RMS error over the posterior Cramér-Rao bound. Dotted: theory of the "
            "reference filter."
        ),
    ),
    replace(
        _OVER_TIME,
        name="filter-nees",
        asked="Is the covariance that a filter states true?",
        says="Normalised squared error, 3 if its covariance is true: {each}.",
        about=[stat.NEES()],
        rows=[stat.NEES_AT],
        value="NEES (3 is right)",
        floor=None,
        level=3.0,
        caption=(
            "Normalised squared error of the attitude over time, mean over the trials: "
            "3 for an honest covariance. Above, a filter is overconfident; below, its "
            "errors are smaller than it says."
        ),
    ),
    replace(
        _OVER_TIME,
        name="filter-budget",
        fold="Contribution of each source to the error of the reference filter",
        says="",
        rows=[stat.BUDGET_AT],
        lines=entry(0),
        floor=None,
        value="part of the RMS error",
        caption=(
            "Contribution of each source to the predicted attitude error of the "
            "reference filter over time. The squares of the parts add up to that of "
            "the whole."
        ),
    ),
    Listing(
        name="filter-scenarios",
        caption=(
            "Each filter in each scenario: its error, the normalised squares of errors "
            "(3 is right) and of innovations, and the time to settle"
        ),
        parameters=("algorithm", "scenario"),
        rows=[
            stat.RMS,
            stat.RMS_OVER_BOUND,
            stat.NEES(),
            stat.NIS,
            stat.SETTLING,
            stat.DIVERGED,
        ],
        keys={},
        column=words,
        predicted=True,
        unit=lambda row: DEGREE if row.unit == "rad" else None,
        open=True,
    ),
)
HEADLINE = Headline(
    says="{angle} RMS; {over} × the bound",
    quotes={
        "angle": Quote(of=stat.RMS(), by=stat.CRAMER_RAO, angle=True),
        "over": Quote(of=stat.RMS(), by=stat.CRAMER_RAO, over=True),
    },
)
