r"""Theory of a filter in a scenario: its bound, and the reference filter's error.

And what a filter's rows stand on: the noise drawn, and its covariance without noise.

A filter is linear in small noise. All of it is told and drawn a thousand times smaller
than usual, and a trial is drawn for each of its numbers, which has that one alone: each
axis of each reading, each step of the gyroscope's bias and the walk within it, the
start's attitude and bias. The sum of the squares of the errors of attitude and bias at
the end is their covariance; it shares no line with the covariance that the filter
states, nor with the bound.

What the coning of eq. (F9) of `mekf` leaves out of a turn is of third order in
the step; without it, or with a wrong factor, it is of second. Rates alone show which.
It is the motion's, the same in every trial and unknown to the filter: theory carries
it as a known error of the rates (`missed`).
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any, Final

import numpy as np

from simval import statistics as stat
from simval.arrays import Array, Places
from simval.geometry import attitude_matrix, compose, conjugate, rotation_vector
from simval.imu.filters.signals import FilterInput, Told
from simval.imu.recorded import Alignment
from simval.imu.recorded.evaluation import resting
from simval.imu.recorded.settings import Signals, Start
from simval.moments import deviations
from simval.plugins import Filter
from simval.plugins.runs import run_filter
from simval.results import MAX_REMAINDER, Rows, beyond, exact
from simval.shapes import Float
from simval.studies.filter_scenarios import Course, Imperfect, Simulated, course, drawn
from simval.studies.response import apart
from simval.studies.trials import Drawn, drawn_rows
from simval.theory import (
    CalibrationError,
    FilterModel,
    FilterPath,
    FilterPrediction,
    RowError,
    VectorSensor,
    filter_bound,
    filter_prediction,
)
from simval.theory.filter_model import Error

GYROSCOPE, ACCELEROMETER, MAGNETOMETER = "gyroscope", "accelerometer", "magnetometer"
UP = np.array([0.0, 0.0, 1.0])


def prediction(
    way: Course,
    sensors: Imperfect,
    told: Told,
    instants: Places,
    magnetometer: bool = True,
    left: Sequence[Error] = (),
) -> FilterPrediction:
    """Predict the reference filter's error at some rows, by source.

    With what is `left` of calibrations beside the gyroscope's own.
    """
    truth = model_of(sensors.told(way), magnetometer)
    path = way.path
    calibration = CalibrationError(
        of=GYROSCOPE,
        value=(sensors.M - np.eye(3)).ravel(),
        covariance=sensors.calibration_std**2 * np.eye(9),
    )
    return filter_prediction(
        path,
        truth,
        told=model_of(told, magnetometer),
        errors=(
            calibration,
            *left,
            RowError(of=GYROSCOPE, rows=missed(way)),
            RowError(of=ACCELEROMETER, rows=way.acceleration),
            *([RowError(of=MAGNETOMETER, rows=way.iron)] if magnetometer else ()),
        ),
        keep=instants,
    )


def missed(way: Course) -> Float[Array, "T 3"]:
    """Rate error of eq. (F9) over a step, with true averages, rad/s."""
    S, q = way.rate * way.dt[:, None], way.attitude
    phi = S + np.cross(np.concatenate([np.zeros((1, 3)), S[:-1]]), S) / 12.0
    turn = rotation_vector(compose(conjugate(q[:-1]), q[1:]))
    return (phi - turn) / way.dt[:, None]


def second_order(
    way: Course, sensors: Imperfect, theory: FilterPrediction, magnetometer: bool = True
) -> Float[Array, " k"]:
    """Squared ratio of the second order to the stated deviation, eq. (F15)."""
    first = FilterPath(dt=way.dt[:1], attitude=way.attitude[:2])
    model = model_of(sensors.told(way), magnetometer)
    (start,) = filter_prediction(first, model, told=model).second_order
    return theory.second_order**2 + start**2 / (1.0 + theory.kept)


def model_of(told: Told, magnetometer: bool) -> FilterModel:
    """Filter model for theory, from a filter's settings."""
    up: Array = told.gravity * UP
    sensors = {ACCELEROMETER: (up, told.accelerometer_noise)}
    if magnetometer:
        sensors[MAGNETOMETER] = told.field, told.magnetometer_noise
    start = np.repeat([told.start_std**2, told.bias_std**2], 3)
    return FilterModel(
        gyroscope_noise=told.gyroscope_noise,
        gyroscope_walk=told.gyroscope_walk,
        sensors=tuple(
            VectorSensor(name=name, reference=vector, std=std)
            for name, (vector, std) in sensors.items()
        ),
        start=np.diag(start),
    )


def six_axis_bound(
    found: Signals, start: Start, alignment: Alignment
) -> dict[str, dict[str, float]] | None:
    """Least RMS errors without a magnetometer, rad, by part.

    The posterior Cramer-Rao bound of the filter's settings along the truth, by eq. (F2)
    of `simval.theory.filter_recursion`: the heading at the start is exact, as headings
    are counted from it, and drifts by the gyroscope's noise and bias. Where the truth
    is missing the path turns evenly between its ends. None where the rests show no
    noise of the accelerometer, as counts that do not change: any bound is then 0.
    """
    from scipy.spatial.transform import Rotation, Slerp

    if not start.told.accelerometer_noise > 0.0:
        return None
    time, q = found.time[start.row :], alignment.attitude[start.row :]
    there = np.asarray(np.isfinite(q).all(axis=1))
    known = time[there]
    between = Slerp(known, Rotation.from_quat(q[there]))
    q = between(np.clip(time, known[0], known[-1])).as_quat()
    model = model_of(start.told, magnetometer=False)
    A, first = attitude_matrix(q[1:]), model.start.copy()
    # of no heading: by two axes normal to the vertical, as a difference is rounded
    level = np.linalg.svd(attitude_matrix(q[0])[:, 2:])[0][:, 1:]
    first[:3, :3] = start.told.start_std**2 * level @ level.T
    path = FilterPath(dt=np.diff(time), attitude=q)
    body = filter_bound(path, replace(model, start=first)).covariance[:, :3, :3]
    square = np.linalg.diagonal(A.mT @ body @ A)[there[1:]]
    rest = resting(found)[start.row + 1 :][there[1:]]
    parts = {"all": np.ones_like(rest), "rest": rest, "moving": ~rest}
    return {
        part: {
            "total": float(np.sqrt(square[rows].sum(axis=1).mean())),
            "heading": float(np.sqrt(square[rows, 2].mean())),
            "inclination": float(np.sqrt(square[rows, :2].sum(axis=1).mean())),
        }
        for part, rows in parts.items()
        if rows.any()
    }


def undisturbed(way: Course) -> Course:
    """The same motion without disturbances, for the bound."""
    nothing = np.zeros_like(way.iron)
    return replace(way, acceleration=nothing, iron=nothing)


SECONDS = 2.0
"""Of the run without noise: by then the covariance is no longer the start's."""
EVERY = 20
"""Rows between those that are compared."""
LEFT_OUT = 0.5
"""Of a covariance in deviations, by the square of a step, s, and by how unlike the axes
are: the filter turns by the rates of a step, theory by the attitudes, and a turn puts
into an axis what another is unsure of. The worst of five scenarios from 25 to 500 Hz
was 0.08, and 0.4 with readings of 1e-6 beside 0.1 (`tests/studies/test_filter.py`)."""


def drawn_filter_rows(
    way: Course,
    sensors: Imperfect,
    parts: Sequence[Simulated],
) -> Rows:
    """Noise of each sensor as drawn, relative to the parameters."""
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
) -> Rows:
    """Covariance stated without noise, against the bound's recursion."""
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
    path = way.path
    model = model_of(told, plugin.magnetometer)
    known = filter_prediction(path, model, told=model, keep=kept).told
    off = max(apart(a, b) for a, b in zip(stated[0], known, strict=True))
    h, turn = way.dt.max(), np.linalg.norm(way.rate, axis=1).max()
    # the filter's turn and bias of a step share K^2 h^2/2, theory's J(-phi) of it
    walked = turn * h / 2.0 * told.gyroscope_walk**2 * h * SECONDS / 2.0
    left = max(_turned_by(own, h) + _shared_by(own, walked, turn * h) for own in known)
    row = exact(stat.COVARIANCE_OFF("stated"), off, 0.0, stat.CRAMER_RAO, left)
    why = f"the covariances may be {left:.2g} deviations apart by the turns of a step"
    return beyond(row, f"{why}, of 0.5 at most" if left > MAX_REMAINDER else "")


def _shared_by(P: Float[Array, "6 6"], walked: float, turn: float) -> float:
    # of a covariance of turn and bias, which is at most the deviations' product
    sd = deviations(P)
    return min(walked / (sd[:3].min() * sd[3:].min()), turn / 2.0)


def _turned_by(P: Float[Array, "6 6"], h: float) -> float:
    # its greatest change by a turn of the axes: what is unsure comes into an axis, and,
    # squared, into the best known direction, before information adds up
    turn, sd = LEFT_OUT * h**2, np.sqrt(np.diagonal(P)[:3])
    return turn * sd.max() / sd.min() + turn**2 * np.linalg.cond(P[:3, :3])


Make = Callable[..., Any]
RATE: Final = 50.0
RESPONSE_SECONDS: Final = 2.0
SMALL: Final = 1e-3
SENSORS: Final = Imperfect(
    gyroscope_noise=SMALL * float(np.radians(0.05)), gyroscope_walk=SMALL * 3e-3,
    accelerometer_noise=SMALL * 0.02, magnetometer_noise=SMALL * 2e-7,
    start_std=SMALL * 5e-3, bias_std=SMALL * 5e-3, M=np.eye(3), calibration_std=0.0,
)  # fmt: skip
"""Each counts: the bias walks in two seconds nearly as far as it began."""
FEW: Final = 4  # rows in one call, of whose answers the last is kept
CONING_ORDER: Final = 3.0
NEXT: Final = 0.25
"""Of an order between steps of 1/25 and 1/50 s: what the next one changes of it. Seen
were 3.03 and 3.00; of second order, 2.00."""


def response_rows(make: Make, scenario: str) -> Rows:
    """Covariance by the response to noise, against the stated one; order of turns."""
    way = course(scenario, RATE, RESPONSE_SECONDS)
    model = model_of(SENSORS.told(way), True)
    path = way.path
    end = np.array([len(way.dt) - 1])
    bound = filter_prediction(path, model, told=model, keep=end).told[0]
    off = [apart(covariance, bound) for covariance in moved_and_stated(make, way)]
    left = _turned_by(bound, way.dt.max())
    statistics = stat.COVARIANCE_OFF.each(("moved", "stated while the bias walks"))
    rows = exact(statistics, off, 0.0, stat.CRAMER_RAO, left)
    if way.rate.any():
        order = np.log2(lost(make, scenario, RATE / 2.0) / lost(make, scenario, RATE))
        rows += exact(stat.TURN_ORDER(), order, CONING_ORDER, stat.TRUTH, NEXT)
    return rows


def lost(make: Make, scenario: str, rate: float, **more: Any) -> float:
    """Final error if rates alone are integrated over a scenario, rad."""
    way = course(scenario, rate, RESPONSE_SECONDS)
    sure = {"start_std", "bias_std", "gyroscope_noise", "gyroscope_walk"}
    told = asdict(SENSORS.told(way)) | dict.fromkeys(sure, 0.0)
    model = make(start=way.attitude[0], **told, **more)
    attitude = model.update_rows(way.dt, way.rate, None)["attitude"]
    return float(np.linalg.norm(_turn(attitude[-1], way)))


class Units(np.random.Generator):
    """A fake generator: trial k draws 1 for the k-th number, 0 for all others."""

    def __init__(self) -> None:
        super().__init__(np.random.SFC64(0))
        self.given = 0

    def standard_normal(self, shape: tuple[int, ...]) -> Array:  # type: ignore[override]
        """Numbers for many trials; the first trial has no noise."""
        found = np.zeros(shape)
        own = found.reshape(shape[0], -1)
        np.fill_diagonal(own[1 + self.given :], 1.0)
        self.given += own.shape[1]
        return found


def moved_and_stated(
    make: Make, way: Course
) -> tuple[Float[Array, "6 6"], Float[Array, "6 6"]]:
    """Covariance by the response to noise, and as stated."""
    told = SENSORS.told(way)
    # of the start, the first bias, and five of each axis of each row
    given, bias = drawn(way, SENSORS, told, 1 + 6 + 15 * len(way.dt), Units())
    model = make(start=given.start, **asdict(told))
    sensors = given.gyroscope, given.accelerometer, given.magnetometer
    for k in range(0, len(way.dt), FEW):
        rows = slice(k, k + FEW)
        some = (each[:, rows].swapaxes(0, 1) for each in sensors)
        answers = model.update_rows(way.dt[rows], *some)
    attitude, b, P = (answers[word][-1] for word in ("attitude", "bias", "covariance"))
    error = np.concatenate([_turn(attitude, way), bias[:, -1] - b], axis=1)
    by = error[1:] - error[0]
    return by.T @ by, P[0]


def _turn(attitude: Float[Array, "... 4"], way: Course) -> Float[Array, "... 3"]:
    truth = np.broadcast_to(way.attitude[-1], attitude.shape)
    return rotation_vector(compose(conjugate(attitude), truth))
