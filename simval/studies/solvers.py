"""Solvers: comparison of the methods of the calibration, which must agree.

One noisy pose set, far enough from the closed-form start that there is a way to go.
Each method is stopped after every number of steps, and its distance from where it ends
is kept for the report. All must end at the same parameters.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Listing, Strip, Trace, entries
from simval.imu.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row, limit, unjudged
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.study import LEAST_NOISE, Cost, StudyParameters, ranged, refusing

TITLE = "Solvers: do all methods of the calibration reach the same answer?"
SECTION = "convergence"

G = 9.80665  # m/s^2, standard gravity
METHODS = (stat.FIRST_SOLVER, "gauss-newton", "newton")
SHOWN = 30  # steps that the report draws
AGREEMENT = 1e-9
"""Relative; each method stops at 1e-12 of its own step, some digits are the data's."""


class Parameters(StudyParameters):
    """One cell: a pose set and its noise."""

    noise_std: float = ranged(
        0.3, "Noise of each axis of a pose mean, m/s^2.", LEAST_NOISE, 3.0
    )
    poses: int = ranged(40, "Poses, spread evenly over the sphere.", 10, 400)

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
    first = ends[stat.FIRST_SOLVER].parameters
    ways: dict[str, Array] = {}
    rows: list[Row] = []
    for method, fit in ends.items():
        size = np.abs(first).max()
        apart = float(np.abs(fit.parameters - first).max() / size)
        rows += unjudged(stat.STEPS(method), int(fit.iterations))
        rows += limit(stat.APART(method), apart, AGREEMENT, stat.FIRST_SOLVER)
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
        asked="How fast does each solver converge?",
        file=artifact_of,
        axis="iteration",
        strips=[Strip(value="distance to the solution")],
        says="Steps to convergence: {each}.",
        about=[stat.STEPS],
        caption=(
            "Each point is one iteration. A straight line means linear convergence, a "
            "line that bends down faster convergence; solvers that take the same steps "
            "are on one line. The last points are rounding."
        ),
    ),
    Listing(
        name="study-solvers",
        caption="Steps of each solver, and how far apart the answers are",
        rows=[stat.STEPS, stat.APART],
        keys={"solver": entries},
        column=lambda row: row.statistic.family.words,
    ),
)
