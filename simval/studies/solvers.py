"""Solvers: how each method of the calibration comes to the same answer.

One noisy pose set, far enough from the closed-form start that there is a way to go.
Each method is stopped after every number of steps, and its distance from where it ends
is kept for the report. All must end at the same parameters.
"""

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.figures import Listing, Strip, Trace, entries
from simval.imu.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row, limit, unjudged
from simval.statistics import APART, FIRST_SOLVER, STEPS
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.refusing import LEAST_NOISE, refusing
from simval.studies.study import Cost, StudyParameters

TITLE = "Solvers: how each method of the calibration comes to the same answer"
SECTION = "convergence"

G = 9.80665  # m/s^2, standard gravity
METHODS = (FIRST_SOLVER, "gauss-newton", "newton")
SHOWN = 30  # steps that the report draws
AGREEMENT = 1e-9
"""Relative; each method stops at 1e-12 of its own step, some digits are the data's."""


class Parameters(StudyParameters):
    """One cell: a pose set and its noise."""

    noise_std: Annotated[float, Field(ge=LEAST_NOISE, le=3.0)] = Field(
        default=0.3, description="Noise of each axis of a pose mean, m/s^2."
    )
    poses: Annotated[int, Field(ge=10, le=400)] = Field(
        default=40, description="Poses, spread evenly over the sphere."
    )

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1, 6)


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Follow each method step by step."""
    sensor = true_sensor(parameters.noise_std)
    force = G * fibonacci_sphere(parameters.poses)
    raw = sensor.distort(force, streams.block(0))
    ends = {method: calibrate(raw, g=G, method=method) for method in METHODS}
    first = ends[FIRST_SOLVER].parameters
    ways: dict[str, Array] = {}
    rows: list[Row] = []
    for method, fit in ends.items():
        size = np.abs(first).max()
        apart = float(np.abs(fit.parameters - first).max() / size)
        rows += unjudged(STEPS(method), int(fit.iterations))
        rows += limit(APART(method), apart, AGREEMENT, FIRST_SOLVER)
        way = [
            calibrate(raw, g=G, method=method, max_iterations=k).parameters
            for k in range(1, min(SHOWN, int(fit.iterations)) + 1)
        ]
        distance = np.abs(np.array(way) - fit.parameters).max(axis=1) / size
        ways[method] = distance[(distance > 0.0) | (np.arange(len(way)) == 0)]
    return Outcome(
        rows=tuple(rows), artifacts={artifact_of(parameters.model_dump()): ways}
    )


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the ways of the solvers in a cell with these parameters."""
    return f"convergence-{named['poses']}-{named['noise_std']:g}.npz"


FIGURES = (
    Trace(
        name="convergence",
        asked="How fast does each solver come to the answer?",
        file=artifact_of,
        axis="iteration",
        strips=[Strip(value="distance to the solution")],
        says="Steps to the answer: {each}.",
        about=[STEPS],
        caption=(
            "Each point is one iteration. A straight line means linear convergence, a "
            "line that bends down faster convergence; solvers that take the same steps "
            "are on one line. The last points are rounding."
        ),
    ),
    Listing(
        name="study-solvers",
        caption="Steps of each solver, and how far apart the answers are",
        rows=[STEPS, APART],
        keys={"solver": entries},
        column=lambda row: row.statistic.family.words,
    ),
)
