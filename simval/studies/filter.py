r"""Attitude filter: its errors in many trials, against its covariance and the bound.

A scenario is recorded once (`simval.studies.filter_scenarios`); over it each trial
draws the noise of all sensors, a bias of the gyroscope that walks, and the attitude
that the filter is told to start from. The filter, anybody's, is stepped through the
rows.

The root mean square error is set against the posterior Cramer-Rao bound
(`simval.theory.filter_recursion`). Where the filter is told otherwise, or a calibration
left an error, or a sensor reads what it should not, theory predicts what the reference
filter then does; another filter is only shown. `simval.studies.filter_errors` says how
its errors, and what it states of them, are judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, model_validator

from simval import statistics as stat
from simval.arrays import Array, Places
from simval.errors import InputError, UnmeasurableError
from simval.figures import Figure, Headline, Listing, Quote, along_entry, entry, words
from simval.imu.filters.signals import FilterInput, Told
from simval.plugins import Filter
from simval.plugins.runs import run_filter, run_once
from simval.plugins.worlds import find_world, path
from simval.results import Rows, beyond
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.filter_errors import (
    Answers,
    added,
    bends,
    budget_rows,
    consistency_rows,
    diagnosis_rows,
    error_rows,
    lost_row,
    over_bound_rows,
    predicted_rows,
)
from simval.studies.filter_prediction import (
    drawn_filter_rows,
    prediction,
    response_rows,
    second_order,
    stated_row,
    undisturbed,
)
from simval.studies.filter_scenarios import (
    ANYWHERE,
    ROWS,
    UNKNOWN,
    Course,
    Imperfect,
    Simulated,
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
from simval.studies.study import LEAST_NOISE, Cost, described, ranged
from simval.theory import FilterPrediction
from simval.units import COUNT, DEGREE

__all__ = ["FIGURES", "HEADLINE", "SECTION", "TITLE", "Parameters", "compute"]
__all__ += ["outcome", "run"]

TITLE = "Attitude filter: errors, stated covariance, and the bound"
SECTION = "filters"

REFERENCE = "simval:mekf"
BLOCK = 8  # trials; part of the promise of equal bits
MOST_MOVED = 0.7
"""Standard deviations by which the second order, eq. (F15), or what averages leave out
of the turns may move an estimate: half of a normalised square is then of it."""
INSTANTS = 100
"""At which errors are kept, evenly in time, each with the row before."""
LEAST_READ = 1e-6
"""Of a reading: its square is then 4e-12 of the greatest variance of the start, which a
filter adds to it; less than 1e-15 of that is lost in rounding, and singular."""


class Filtering(Problem[Filter, str, Answers]):
    """Attitudes over time from noisy readings of a scenario."""

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
    def draws(self) -> list[Simulated]:
        """Readings and biases of each block of trials."""
        given = self.way, self.sensors, self.told, BLOCK
        return [
            drawn(*given, self.streams.block(i), self.parameters.anywhere)
            for i in range(-(-self.parameters.trials // BLOCK))
        ]

    @property
    def size(self) -> tuple[int, str]:
        """Number of rows of all trials."""
        return len(self.draws) * BLOCK * len(self.way.dt), "rows"

    def probe(self) -> str:
        """World of the filter, found without noise."""
        # of our own a test knows it; it takes as long as the trials do
        own = self.parameters.reference and self.plugin.world
        return own or find_world(self.plugin, self.told, self.parameters.rate).world

    def trials(self, probed: str) -> Answers:
        """Answers for all trials at the instants."""
        answers = answers_of(self.plugin, probed, self.way, self.draws)
        if self.plugin.magnetometer or "start" in self.plugin.reads:
            return answers
        return answers.from_its_own_heading()

    def rows(self, probed: str, answers: Answers) -> Rows:
        """All rows of the cell: errors, what the filter states, and the draws."""
        parameters, plugin, way = self.parameters, self.plugin, self.way
        right = {"scenario": parameters.named_scenario, "algorithm": REFERENCE}
        told = parameters.model_copy(update=right), plugin.magnetometer
        theory = least = least_of(*told)
        if way.disturbed or parameters.wrong != Wrong():
            at = answers.rows, plugin.magnetometer
            theory = prediction(way, self.sensors, self.told, *at)
        known = [
            (each, second_order(way, self.sensors, each, plugin.magnetometer))
            for each in (least, theory)
        ]
        rows = measured_rows(parameters, way, answers, known)
        rows += drawn_filter_rows(way, self.sensors, self.draws)
        if parameters.reference and not parameters.anywhere and not way.disturbed:
            scenario = parameters.named_scenario
            rows += stated_row(plugin, self.told, probed, (scenario, parameters.rate))
            if parameters.wrong == Wrong():  # as they do not depend on its settings
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
        """A rest of one second and a turn of one second, to be timed."""
        given = path(self.told, self.parameters.rate, 1.0, 1.0).given
        return run_once, (given,), len(given.dt)


class Parameters(AlgorithmParameters):
    """One cell: a filter, a scenario, its sensors, and the filter's settings."""

    problem = Filtering
    no_noise = ("algorithm", "scenario", "time_limit")

    algorithm: PluginName = described(
        REFERENCE, "FILE.py, FILE.py:NAME or an entry point."
    )
    scenario: Annotated[str, AfterValidator(spelled)] = described(
        "gimbal slow",
        "What happens (docs/filters.md), then after commas what is wrong: "
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
        5e-3,
        "Standard deviation of the start that the filter gets, rad per axis.",
        LEAST_NOISE,
        0.5,
    )
    trials: int = ranged(256, "Trials; rounded up to whole blocks of 8.", BLOCK)
    time_limit: Seconds = described(600.0, "Wall time after which the cell fails, s.")

    def cost(self) -> Cost:
        """Cost of a cell: a filter of many trials at once, or one by one."""
        steps = self.rate * self.seconds * self.trials
        own = self.algorithm.startswith("simval:")
        return Cost(0.3 + steps * (1e-6 if own else 1e-4), 150)

    @model_validator(mode="after")
    def _require_scenario(self) -> Self:
        """Check that the scenario exists at this rate."""
        scenario_of(self.scenario)
        steps_of(ROWS, self.rate, self.seconds)
        return self

    @property
    def named_scenario(self) -> str:
        """Name of the scenario, without what is wrong in it."""
        return scenario_of(self.scenario)[0]

    @property
    def course(self) -> Course:
        """Motion of the scenario, as ideal sensors read it."""
        return course(self.named_scenario, self.rate, self.seconds)

    @property
    def wrong(self) -> Wrong:
        """Wrong settings of the filter, or errors left by a calibration."""
        return scenario_of(self.scenario)[1]

    @property
    def anywhere(self) -> bool:
        """True if the start is unknown."""
        return self.named_scenario == ANYWHERE

    @property
    def reference(self) -> bool:
        """True for the package's own filter, whose errors are predicted."""
        return self.algorithm == REFERENCE


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the attitudes of a cell."""
    words = repr(sorted(named.items())).encode()
    return f"filter-{sha256(words).hexdigest()[:16]}.npz"


def sensors_of(parameters: Parameters, way: Course) -> Imperfect:
    """The sensors as they really are."""
    wrong = parameters.wrong
    return Imperfect(
        gyroscope_noise=float(np.radians(parameters.angle_random_walk)),
        gyroscope_walk=parameters.rate_random_walk,
        accelerometer_noise=parameters.accelerometer_noise * way.g,
        magnetometer_noise=parameters.magnetometer_noise * way.strength,
        start_std=UNKNOWN if parameters.anywhere else parameters.start_std,
        bias_std=parameters.bias_std,
        M=wrong.M,
        calibration_std=wrong.calibration,
    )


def told_of(parameters: Parameters, way: Course) -> Told:
    """Settings that the filter is given."""
    return parameters.wrong.told(sensors_of(parameters, way).told(way))


@lru_cache(maxsize=16)  # cells differ in what is wrong, and in the filter
def least_of(right: Parameters, magnetometer: bool) -> FilterPrediction:
    """Errors of the reference filter with right settings and no disturbance."""
    way = right.course
    sensors, (kept, late) = sensors_of(right, way), instants(len(way.dt))
    told = sensors.told(way)
    return prediction(undisturbed(way), sensors, told, kept[late], magnetometer)


def answers_of(
    plugin: Filter,
    world: str,
    way: Course,
    draws: Sequence[Simulated],
) -> Answers:
    """Run the filter over the readings of each block."""
    kept, late = instants(len(way.dt))
    given = joined([readings for readings, _ in draws])
    return Answers(
        found=run_filter(plugin, given, kept, world),
        truth=way.attitude[kept + 1],
        bias=np.concatenate([bias[:, kept] for _, bias in draws]),
        time=way.time[kept],
        late=late,
    )


def joined(parts: list[FilterInput]) -> FilterInput:
    """Join the trials of several blocks."""
    several = ("gyroscope", "accelerometer", "magnetometer", "start")
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in several
    }
    return replace(parts[0], **whole)


def instants(steps: int) -> tuple[Places, Places]:
    """Rows to keep (each instant and the row before it), and where instants are."""
    late = np.unique(np.linspace(0, steps - 1, INSTANTS + 1).astype(np.intp)[1:])
    late = late[late > 0]
    kept = np.unique(np.concatenate([late - 1, late]))
    return kept, np.searchsorted(kept, late)


def measured_rows(
    parameters: Parameters,
    way: Course,
    answers: Answers,
    known: list[tuple[FilterPrediction, Float[Array, " i"]]],
) -> Rows:
    """Rows about a filter's answers, against the bound and predictions.

    `known` is that of right settings and of those that are told, with the square of the
    second order of each.
    """
    (least, left), (theory, left_of_told) = known
    first_order = not (parameters.anywhere or way.disturbed)
    judged = first_order and parameters.wrong == Wrong() and not answers.shifted
    bound = least.told[:, :3, :3]
    square = np.linalg.trace(bound) / 3.0
    over = bends(left, added(least, stat.NEES(), 3)) / 3.0  # of the error's square
    over += np.sqrt(np.mean(least.rms() ** 2) / np.mean(square)) - 1.0
    rows = [
        *error_rows(answers, bound, judged and parameters.reference, over),
        *consistency_rows(answers, judged, left, least),
        *lost_row(answers, judged),
    ]
    if not parameters.reference:  # whose own tests know it
        rows += diagnosis_rows(answers, way.rate[answers.found.kept], bound, judged)
    turns = max((least.nees() - 6.0).max(), (least.nis - least.nis_size).max())
    turned = moved("what averages leave out of the turns", turns, "chi-square")
    found = beyond(rows, moved("the second order", left.max()) or turned)
    if not parameters.reference or parameters.anywhere:
        return found
    if turned or not judged:  # else the row above has it
        carried = predicted_rows(answers, theory, first_order, left_of_told)
        # a start's is forgotten slowly; what goes on through a run counts by its mean
        most = max(left.max(), left_of_told.mean())
        found += beyond(carried, moved("the second order", most))
    found += budget_rows(answers, theory)
    ratio = theory.rms() / np.sqrt(square)
    return found + over_bound_rows(answers, bound, ratio, stat.CARRIED)


def moved(cause: str, square: float, law: str = "theory") -> str:
    """Say that a law does not hold as an estimate is moved too far; else empty."""
    by = np.sqrt(max(square, 0.0))
    why = f"{cause} may move an estimate by {by:.2g} standard deviations; {law}"
    return f"{why} holds up to {MOST_MOVED:g}" if by > MOST_MOVED else ""


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
            "Normalised squared error of the attitude over time, mean over the "
            "trials: 3 if the covariance is right. Above, a filter is "
            "overconfident; below, its errors are smaller than it says."
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
