"""What a filter's rows stand on: the noise drawn, and its covariance without noise."""

from collections.abc import Sequence

import numpy as np

from simval.arrays import Array
from simval.plugins import Filter
from simval.plugins.filter_run import run_filter
from simval.plugins.filter_signals import FilterInput, Told
from simval.results import Row, exact
from simval.shapes import Float
from simval.statistics import COVARIANCE_OFF, CRAMER_RAO
from simval.studies.drawn import Drawn, drawn_rows
from simval.studies.filter_prediction import model_of
from simval.studies.filter_scenarios import Course, Imperfect, course
from simval.studies.response import apart
from simval.theory import FilterPath, filter_prediction

SECONDS = 2.0
"""Of the run without noise: by then the covariance is no longer the start's."""
EVERY = 20
"""Rows between those that are compared."""
LEFT_OUT = 2.0
"""Of a covariance in deviations, by the square of a step, s: the filter turns by the
rates of a step, theory by the attitudes. The worst of three scenarios from 25 to 500 Hz
was 0.35, of the fastest at 500 Hz (`tests/test_foundations.py`), and 0.53 with a bias
that walks (`tests/test_filter_response.py`)."""


def drawn_filter_rows(
    way: Course,
    sensors: Imperfect,
    parts: Sequence[tuple[FilterInput, Float[Array, "n T 3"]]],
) -> tuple[Row, ...]:
    """The noise of each sensor, in units of what the parameters say."""
    return drawn_rows([_noise(way, sensors, *part) for part in parts])


def _noise(
    way: Course, sensors: Imperfect, given: FilterInput, bias: Float[Array, "n T 3"]
) -> dict[str, Drawn]:
    force = given.accelerometer - way.up - way.acceleration
    iron = given.magnetometer - way.field - way.iron
    found = {
        "accelerometer": Drawn.of(force / sensors.accelerometer_noise),
        "magnetometer": Drawn.of(iron / sensors.magnetometer_noise),
    }
    if sensors.calibration_std == 0.0:  # else each trial has its own M
        rate = given.gyroscope - way.rate @ sensors.M.T - bias
        # about the bias at a step's end, the walk within it has a third of a step's
        h = way.dt[:, None]
        sd = np.sqrt(sensors.gyroscope_noise**2 / h + sensors.gyroscope_walk**2 * h / 3)
        found["gyroscope"] = Drawn.of(rate / sd)
    return found


def stated_row(
    plugin: Filter, told: Told, world: str, scenario: tuple[str, float]
) -> tuple[Row, ...]:
    """The covariance that is stated without noise, beside the bound's recursion."""
    way = course(*scenario, SECONDS)
    given = FilterInput(
        dt=way.dt,
        gyroscope=way.rate[None],
        accelerometer=way.up[None],
        magnetometer=way.field[None],
        start=way.attitude[:1],
        told=told,
    )
    kept = np.arange(EVERY - 1, len(way.dt), EVERY)
    stated = run_filter(plugin, given, kept, world).covariance
    assert stated is not None  # the reference filter states one
    path = FilterPath(dt=way.dt, attitude=way.attitude)
    model = model_of(told, plugin.magnetometer)
    known = filter_prediction(path, model, told=model, keep=kept).told
    off = max(apart(a, b) for a, b in zip(stated[0], known, strict=True))
    left = LEFT_OUT * float(way.dt.max()) ** 2
    return exact(COVARIANCE_OFF("stated"), off, 0.0, CRAMER_RAO, left)
