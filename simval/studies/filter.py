r"""Attitude filter: its errors over many trials, what it says of them, and the bound.

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

The root mean square error stands beside the posterior Cramer-Rao bound
(`simval.theory.filter_recursion`). Where the filter is told otherwise, or a calibration
left an error (`simval.studies.filter_scenarios`), or a sensor reads what it should not,
theory predicts what the reference filter then does; another filter is only shown.
"""

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from simval.arrays import Array
from simval.errors import InputError, UnmeasurableError
from simval.figures import Figure, Headline, Listing, Quote, along_entry, entry, words
from simval.filters.signals import FilterInput, Told
from simval.plugins import Filter, find_plugin
from simval.plugins.runs import run_filter
from simval.plugins.worlds import find_world
from simval.results import Outcome, Row
from simval.shapes import Float
from simval.statistics import (
    BOUND_AT,
    BUDGET_AT,
    CARRIED,
    CRAMER_RAO,
    DIVERGED,
    NEES,
    NEES_AT,
    NIS,
    RMS,
    RMS_AT,
    RMS_OVER_BOUND,
    RMS_OVER_BOUND_AT,
    SETTLING,
)
from simval.streams import Streams
from simval.studies.filter_prediction import (
    budget_rows,
    drawn_filter_rows,
    prediction,
    response_rows,
    stated_row,
    undisturbed,
)
from simval.studies.filter_rows import (
    Answers,
    carried_over_bound,
    consistency_rows,
    diagnosis_rows,
    error_rows,
    lost_row,
    predicted_rows,
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
    ESTIMATE,
    PluginName,
    PluginParameters,
    isolated,
)
from simval.studies.refusing import LEAST_NOISE
from simval.studies.study import Cost
from simval.theory import FilterPrediction
from simval.units import COUNT, DEGREE

TITLE = "Attitude filter: errors, stated covariance, and the bound"
SECTION = "filters"

REFERENCE = "simval:mekf"
BLOCK = 8  # trials; part of the promise of equal bits
SMALL = 0.02
"""Rad: a start beyond it is not forgotten before it bends what a filter says of itself,
beside sensors of 2 and 5 mrad (docs/filters.md)."""
INSTANTS = 100
"""At which errors are kept, evenly in time, each with the row before."""

LEAST_READ = 1e-6
"""Of a reading: its square is then 4e-12 of the greatest variance of the start, which a
filter adds to it; less than 1e-15 of that is lost in rounding, and singular."""


class Parameters(PluginParameters):
    """One cell: a filter, a scenario, its sensors, and what the filter is told."""

    plugin = "algorithm"
    no_noise = ("algorithm", "scenario", "time_limit")

    algorithm: PluginName = Field(
        default="simval:mekf", description="FILE.py, FILE.py:NAME or an entry point."
    )
    scenario: Annotated[str, AfterValidator(spelled)] = Field(
        default="gimbal slow",
        description="What happens (docs/filters.md), then after commas what is wrong: "
        '"gimbal slow, scale 1e-3".',
    )
    rate: Annotated[float, Field(ge=25.0, le=500.0)] = Field(
        default=100.0, description="Rows per second: 500 Hz over a whole number."
    )
    seconds: Annotated[float, Field(ge=4.0, le=100.0)] = Field(
        default=20.0, description="Length of a trial, s."
    )
    accelerometer_noise: Annotated[float, Field(ge=LEAST_READ, le=0.1)] = Field(
        default=2e-3, description="Noise per axis and row, as a share of gravity."
    )
    magnetometer_noise: Annotated[float, Field(ge=LEAST_READ, le=0.1)] = Field(
        default=5e-3, description="Noise per axis and row, as a share of the field."
    )
    angle_random_walk: Annotated[float, Field(ge=LEAST_NOISE, le=1.0)] = Field(
        default=0.01, description="White noise, degrees/s per root hertz."
    )
    rate_random_walk: Annotated[float, Field(ge=0.0, le=0.01)] = Field(
        default=2e-5,
        description="Random walk of the gyroscope's bias, rad/s^2 per root hertz.",
    )
    bias_std: Annotated[float, Field(ge=LEAST_NOISE, le=0.1)] = Field(
        default=1e-3,
        description="Standard deviation of the gyroscope's first bias, rad/s per axis.",
    )
    start_std: Annotated[float, Field(ge=LEAST_NOISE, le=0.5)] = Field(
        default=5e-3,
        description="Standard deviation of the attitude told first, rad per axis.",
    )
    trials: Annotated[int, Field(ge=BLOCK)] = Field(
        default=256, description="Trials; rounded up to whole blocks of 8."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
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
    def wrong(self) -> Wrong:
        """What the filter is told wrongly, or a calibration left."""
        return scenario_of(self.scenario)[1]

    @property
    def anywhere(self) -> bool:
        """Whether the start is not known at all."""
        return self.named_scenario == ANYWHERE

    @property
    def reference(self) -> bool:
        """Whether it is the package's own filter, whose errors theory predicts."""
        return self.algorithm == REFERENCE


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the filter, a user's in a child process."""
    if parameters.reference:
        return animated(parameters, compute(parameters, streams))
    found = isolated(outcome, parameters, streams, parameters.time_limit, Filter)
    return animated(parameters, found)


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the attitudes of a cell with these parameters."""
    words = repr(sorted(named.items())).encode()
    return f"filter-{sha256(words).hexdigest()[:16]}.npz"


def animated(parameters: Parameters, found: Outcome) -> Outcome:
    """The same with an artifact: truth and estimate of one trial, for the page."""
    left: Any = found.artifacts.get(ESTIMATE, {})
    way = course(parameters.named_scenario, parameters.rate, parameters.seconds)
    kept, late = instants(len(way.dt))
    estimate = left.get(ESTIMATE, np.empty(0))
    if estimate.shape != (len(late), 4):
        return replace(found, artifacts={})
    content = {
        "time": way.time[kept[late]],
        "truth": way.attitude[kept[late] + 1],
        "estimate": estimate,
    }
    return replace(found, artifacts={artifact_of(parameters.named()): content})


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the filter in this process."""
    return outcome(find_plugin(parameters.algorithm, Filter), parameters, streams)


def _course(parameters: Parameters) -> Course:
    try:
        return course(parameters.named_scenario, parameters.rate, parameters.seconds)
    except InputError as error:  # how long it lasts is known when it is simulated
        raise UnmeasurableError(str(error)) from None


def outcome(plugin: Filter, parameters: Parameters, streams: Streams) -> Outcome:
    """Measure a filter that this process holds."""
    way = _course(parameters)
    sensors, told = sensors_of(parameters, way), told_of(parameters, way)
    # of our own a test knows it; it takes as long as the trials do
    own = parameters.reference and plugin.world
    world = own or find_world(plugin, told, parameters.rate).world
    blocks = -(-parameters.trials // BLOCK)
    parts = [
        drawn(way, sensors, told, BLOCK, streams.block(i), parameters.anywhere)
        for i in range(blocks)
    ]
    given = joined([part[0] for part in parts])
    kept, late = instants(len(way.dt))
    answers = Answers(
        found=run_filter(plugin, given, kept, world),
        truth=way.attitude[kept + 1],
        bias=np.concatenate([part[1][:, kept] for part in parts]),
        time=way.time[kept],
        late=late,
    )
    if not (plugin.magnetometer or "start" in plugin.reads):
        answers = answers.from_its_own_heading()
    exact = replace(sensors, M=np.eye(3), calibration_std=0.0)
    still, true = undisturbed(way), exact.told(way)
    least = prediction(still, exact, true, kept[late], plugin.magnetometer)
    theory = prediction(way, sensors, told, kept[late], plugin.magnetometer)
    rows = measured_rows(parameters, way, answers, (least, theory), way.rate[kept])
    rows += drawn_filter_rows(way, sensors, parts)
    if parameters.reference and not parameters.anywhere and not way.disturbed:
        rows += stated_row(
            plugin, told, world, (parameters.named_scenario, parameters.rate)
        )
        if parameters.wrong == Wrong():  # as they do not depend on what it is told
            rows += response_rows(plugin.make, parameters.named_scenario)
    return Outcome(
        rows=rows,
        artifacts={ESTIMATE: {ESTIMATE: answers.found.attitude[0, late]}},
    )


def measured_rows(
    parameters: Parameters,
    way: Course,
    answers: Answers,
    predictions: tuple[FilterPrediction, FilterPrediction],
    rate: Float[Array, "k 3"],
) -> tuple[Row, ...]:
    """Rows of a filter's answers, beside the bound and what theory predicts."""
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
        rows += budget_rows(theory, answers.time[answers.late])
        rows += carried_over_bound(rows, theory, bound)
    return tuple(rows)


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
    """What the filter is told."""
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


_OVER_TIME = Figure(
    name="filter-errors",
    asked="How near to the bound is each filter?",
    says=(
        "The RMS error is {least} times the bound ({least_of}) to {most} ({most_of})."
    ),
    about=[RMS_OVER_BOUND],
    rows=[RMS_AT],
    along=along_entry,
    axis="time, s",
    lines="algorithm",
    value="RMS error",
    unit=lambda row: DEGREE if row.unit == "rad" else COUNT,
    compared=False,
    floor=BOUND_AT,
    log_x=False,
    columns=2,
    caption=(
        "Attitude error over time, root mean square of the trials. Dotted: the "
        "posterior Cramér-Rao bound, which no filter is below that knows of the "
        "sensors what they are."
    ),
)
FIGURES = (
    _OVER_TIME,
    replace(
        _OVER_TIME,
        name="filter-ratio",
        fold="The error over the bound, on a linear axis",
        says="",
        rows=[RMS_OVER_BOUND_AT],
        by=CRAMER_RAO,
        theories=(CARRIED,),
        value="RMS error / bound",
        compared=True,
        ratio=False,
        floor=None,
        level=1.0,
        log_y=False,
        caption=(
            "RMS error over the posterior Cramér-Rao bound. Dotted: what theory says "
            "of the reference filter."
        ),
    ),
    replace(
        _OVER_TIME,
        name="filter-nees",
        asked="Is what a filter states of its errors true?",
        says="Normalised squared error, 3 if its covariance is true: {each}.",
        about=[NEES()],
        rows=[NEES_AT],
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
        fold="What each source adds to the predicted error of the reference filter",
        says="",
        rows=[BUDGET_AT],
        lines=entry(0),
        floor=None,
        value="part of the RMS error",
        caption=(
            "What each source adds to the predicted attitude error of the reference "
            "filter over time. The squares of the parts add up to that of the whole."
        ),
    ),
    Listing(
        name="filter-scenarios",
        caption=(
            "Each filter in each scenario: its error, then the squares of errors (of "
            "3) and of innovations by what it states of them, and when it settles"
        ),
        parameters=("algorithm", "scenario"),
        rows=[RMS, RMS_OVER_BOUND, NEES(), NIS, SETTLING, DIVERGED],
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
        "angle": Quote(of=RMS(), by=CRAMER_RAO, angle=True),
        "over": Quote(of=RMS(), by=CRAMER_RAO, over=True),
    },
)
