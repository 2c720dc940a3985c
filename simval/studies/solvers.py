"""Solvers: how each method of the calibration comes to the same answer.

One noisy pose set, far enough from the closed-form start that there is a way to go.
Each method is stopped after every number of steps, and its distance from where it ends
is kept for the report. All must end at the same parameters.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.calibrate import calibrate
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.study import Cost, StudyParameters

G = 9.80665
METHODS = ("lm", "gauss-newton", "newton")
STEPS = 30
AGREEMENT = 1e-9
"""Relative; each method stops at 1e-12 of its own step, some digits are the data's."""


class Parameters(StudyParameters):
    """One cell: a pose set and its noise."""

    noise_std: Annotated[float, Field(gt=0.0, le=3.0)] = Field(
        default=0.3, description="Noise of each axis of a pose mean, m/s^2."
    )
    poses: Annotated[int, Field(ge=10, le=400)] = Field(
        default=40, description="Poses, spread evenly over the sphere."
    )


def cost(parameters: Parameters) -> Cost:
    """Cost of a cell.

    Parameters
    ----------
    parameters : Parameters
        What it does.

    Returns
    -------
    Cost
        Seconds and rows.
    """
    return Cost(0.1, 6)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Follow each method step by step.

    Parameters
    ----------
    parameters : Parameters
        Noise and number of poses.
    streams : Streams
        Block 0 is the noise.

    Returns
    -------
    Outcome
        Steps of each method, how far apart they end, and the ways there.
    """
    sensor = true_sensor(parameters.noise_std)
    force = G * fibonacci_sphere(parameters.poses)
    raw = sensor.distort(force, streams.block(0))
    ends = {method: calibrate(raw, g=G, method=method) for method in METHODS}
    first = ends["lm"].parameters
    ways: dict[str, Array] = {}
    rows = []
    for method, fit in ends.items():
        size = np.abs(first).max()
        apart = float(np.abs(fit.parameters - first).max() / size)
        rows += [
            Row(statistic=f"steps[{method}]", value=float(fit.iterations), unit="1"),
            Row(
                statistic=f"apart[{method}]",
                value=apart,
                prediction=AGREEMENT,
                predictor="lm",
                unit="1",
                check="limit",
            ),
        ]
        way = [
            calibrate(raw, g=G, method=method, max_iterations=k).parameters
            for k in range(1, min(STEPS, int(fit.iterations)) + 1)
        ]
        distance = np.abs(np.array(way) - fit.parameters).max(axis=1) / size
        ways[method] = distance[distance > 0.0]
    name = f"convergence-{parameters.poses}-{parameters.noise_std:g}.npz"
    return Outcome(rows=tuple(rows), artifacts={name: ways})
