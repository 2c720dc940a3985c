r"""Attitude filter: its errors, what it says of them, and the bound, over many trials.

A scenario is recorded once (`simval.studies.filter_scenarios`); over it each trial draws
the noise of all sensors, a bias of the gyroscope that walks, and the attitude that the
filter is told to start from. The filter, anybody's, is stepped through the rows.

Where the filter is told the truth and nothing disturbs it, its normalised squared error
(NEES) must have the mean that chi-square gives, 3 for the attitude and 6 with the bias,
its normalised squared innovations (NIS) the number of them, and its innovations must
not correlate; both sides are judged. Judged are means of whole trials with their own
standard error, and the worst instant by the exact law over trials: rows of one trial
are correlated and are never counted as samples (`simval.consistency`).

The root mean square error stands beside the posterior Cramer-Rao bound
(`simval.theory.filtering`). Where the filter is told otherwise, or a calibration left
an error (`wrong`, see `simval.studies.filter_wrong`), or a sensor reads what it should
not, theory predicts what the reference filter then does; another filter is only shown.
"""

from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from simval.plugins import Filter, find_plugin
from simval.plugins.filter_frames import find_world
from simval.plugins.filter_run import run_filter
from simval.plugins.filter_signals import FilterInput, Told
from simval.results import Outcome, Row
from simval.streams import Streams
from simval.studies.filter_prediction import budget_rows, prediction, undisturbed
from simval.studies.filter_rows import (
    Answers,
    consistency_rows,
    error_rows,
    lost_row,
    predicted_rows,
)
from simval.studies.filter_scenarios import (
    ANYWHERE,
    Course,
    Imperfect,
    Scenario,
    course,
    drawn,
)
from simval.studies.filter_wrong import NOTHING, Wrong, spelled, wrong_of
from simval.studies.plugin import PluginName, PluginParameters, isolated
from simval.studies.study import Cost
from simval.theory import FilterPrediction

TITLE = "Attitude filter: errors, stated covariance, and the bound"
SECTION = "filters"

REFERENCE = "simval:mekf"
BLOCK = 8  # trials; part of the promise of equal bits
INSTANTS = 100
"""At which errors are kept, evenly in time, each with the row before."""


class Parameters(PluginParameters):
    """One cell: a filter, a scenario, its sensors, and what the filter is told."""

    plugin = "algorithm"
    no_noise = ("algorithm", "wrong", "time_limit")

    algorithm: PluginName = Field(
        default="simval:mekf", description="FILE.py, FILE.py:NAME or an entry point."
    )
    scenario: Scenario = Field(
        default="gimbal slow", description="What happens, see docs/filters.md."
    )
    rate: Annotated[float, Field(ge=25.0, le=500.0)] = Field(
        default=100.0, description="Rows per second: 500 Hz over a whole number."
    )
    seconds: Annotated[float, Field(ge=4.0, le=100.0)] = Field(
        default=20.0, description="Length of a trial, s."
    )
    accelerometer_noise: Annotated[float, Field(gt=0.0, le=0.1)] = Field(
        default=2e-3, description="Noise per axis and row, of gravity, 1."
    )
    magnetometer_noise: Annotated[float, Field(gt=0.0, le=0.1)] = Field(
        default=5e-3, description="Noise per axis and row, of the field, 1."
    )
    angle_random_walk: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.01, description="White noise, degrees/s per root hertz."
    )
    rate_random_walk: Annotated[float, Field(ge=0.0, le=0.01)] = Field(
        default=2e-5, description="Of the gyroscope's bias, rad/s^2 per root hertz."
    )
    bias_std: Annotated[float, Field(gt=0.0, le=0.1)] = Field(
        default=1e-3, description="Of the gyroscope's first bias, rad/s per axis."
    )
    start_std: Annotated[float, Field(gt=0.0, le=0.5)] = Field(
        default=5e-3, description="Of the attitude that is told first, rad per axis."
    )
    wrong: Annotated[str, AfterValidator(spelled)] = Field(
        default=NOTHING,
        description="What the filter is told wrongly, or a calibration left: nothing, "
        '"gyroscope noise X", "accelerometer noise X", "magnetometer noise X" (X times '
        'what it is), "scale X", "turned X" or "calibration X", joined by commas.',
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

    @property
    def anywhere(self) -> bool:
        """Whether the start is not known at all."""
        return self.scenario == "unknown start"

    @model_validator(mode="after")
    def _require_words(self) -> Self:
        """Check that it is said what is wrong."""
        wrong_of(self.wrong)
        return self

    @property
    def honest(self) -> bool:
        """Whether the filter is told all of its sensors and its start as they are."""
        return wrong_of(self.wrong) == Wrong() and not self.anywhere

    @property
    def reference(self) -> bool:
        """Whether it is the package's own filter, whose errors theory predicts."""
        return self.algorithm == REFERENCE


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the filter in a child process."""
    return isolated(compute, parameters, streams, parameters.time_limit)


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the filter in this process."""
    return outcome(find_plugin(parameters.algorithm, Filter), parameters, streams)


def outcome(plugin: Filter, parameters: Parameters, streams: Streams) -> Outcome:
    """Measure a filter that this process holds."""
    way = course(parameters.scenario, parameters.rate, parameters.seconds)
    sensors, told = sensors_of(parameters, way), told_of(parameters, way)
    world = find_world(plugin)
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
    theory = prediction(way, sensors, told, kept[late])
    return Outcome(rows=_rows(parameters, way, answers, theory))


def _rows(
    parameters: Parameters, way: Course, answers: Answers, theory: FilterPrediction
) -> tuple[Row, ...]:
    sensors = sensors_of(parameters, way)
    exact = replace(sensors, M=np.eye(3), calibration_std=0.0)
    least = prediction(undisturbed(way), exact, exact.told(way), theory.kept)
    judged = parameters.honest and not way.disturbed
    bound = least.told[:, :3, :3]
    rows = [
        *error_rows(answers, bound, judged and parameters.reference),
        *consistency_rows(answers, judged),
        *lost_row(answers, judged),
    ]
    if parameters.reference and not parameters.anywhere:
        rows += predicted_rows(answers, theory, judged)
        rows += budget_rows(theory, answers.time[answers.late])
    return tuple(rows)


def sensors_of(parameters: Parameters, way: Course) -> Imperfect:
    """The sensors as they are."""
    wrong = wrong_of(parameters.wrong)
    return Imperfect(
        gyroscope_noise=float(np.radians(parameters.angle_random_walk)),
        gyroscope_walk=parameters.rate_random_walk,
        accelerometer_noise=parameters.accelerometer_noise * way.g,
        magnetometer_noise=parameters.magnetometer_noise
        * float(np.linalg.norm(way.magnetic)),
        start_std=ANYWHERE if parameters.anywhere else parameters.start_std,
        bias_std=parameters.bias_std,
        M=wrong.M,
        calibration_std=wrong.calibration,
    )


def told_of(parameters: Parameters, way: Course) -> Told:
    """What the filter is told."""
    return wrong_of(parameters.wrong).told(sensors_of(parameters, way).told(way))


def joined(parts: list[FilterInput]) -> FilterInput:
    """Trials of several blocks together."""
    several = ("gyroscope", "accelerometer", "magnetometer", "start")
    whole = {
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
