"""Race of attitude filters, and of the bound on them, by rows of a trial."""

from functools import cache, partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.race import Answers, Contender, race
from simval.arrays import Array
from simval.geometry import attitude_matrix, compose, from_rotation_vector
from simval.imu.filters import Mekf
from simval.plugins import Filter
from simval.plugins.runs import Readings, run_of
from simval.shapes import Float
from simval.streams import cell_key, stream
from simval.theory import (
    CalibrationError,
    FilterModel,
    FilterPath,
    VectorSensor,
    filter_bound,
    filter_prediction,
)

STEP, ROWS, TRIALS = 0.01, 400, 100  # s; the bound goes over ten times the rows
UP = np.array([0.0, 0.0, 9.80665])
FIELD = np.array([2e-5, 0.0, -4e-5])
NOISE: dict[str, Any] = {
    "gyroscope_noise": 1.75e-4,
    "gyroscope_walk": 2e-5,
    "accelerometer_noise": 0.02,
    "magnetometer_noise": 2e-7,
}
START_STD, BIAS_STD = 0.01, 5e-3
EARLY = 100  # row whose variances are compared, where the start still counts
AGREEMENT = 0.02
"""Of the filter's mean variance by the bound: H moves with a start of 0.01 rad."""
ROUNDING = 1e-9
"""Of what must be the same: an answer alone and in a batch, through a plug-in or not.
Chosen: 400 rows lose some 1e-13."""


@race("filter", "Attitude filters, and the bound on them, at 100 Hz", "rows of a trial")
def contenders() -> list[Contender]:
    """List filters and the bound; the reference is a filter in NumPy, in a bare loop.

    The filters of ahrs, and the prediction, answer other questions.
    """
    long = _path(10 * ROWS)
    error = CalibrationError(of="gyroscope", covariance=1e-8 * np.eye(9))
    bound = partial(filter_bound, long, _model(), keep=_kept())
    predict = partial(filter_prediction, long, _model(), errors=[error], keep=_kept())
    mekf = {
        f"mekf{form}, {trials}": partial(_followed, n, plain)
        for form, plain in (("", False), (" in NumPy", True))
        for trials, n in ((f"{TRIALS} trials", TRIALS), ("one trial", 1))
    }

    def pulled(matrix: Float[Array, "3 3"]) -> Answers:
        return {"attitude of the filter in NumPy": (matrix, ROUNDING)}

    def seen(answers: tuple[dict[str, Array], dict[str, Array]]) -> Answers:
        # variances of all trials at the early row, attitudes at the last
        q, P = answers[1]["attitude"], answers[0]["covariance"]
        found = {"attitudes": (q[:, :, None] * q[:, None, :], ROUNDING)}
        if len(q) > 1:  # of one the variance is not the mean
            variances = np.diagonal(P.mean(axis=0))
            found["variances"] = (variances, AGREEMENT * variances)
        return found

    def bounded(found: Any) -> Answers:
        # as good as exact: all of the difference is the filter's
        return {"variances": (np.diagonal(found.covariance[0]), 0.0)}

    bare = "a filter in NumPy, bare loop, data unchecked"
    calibrated = "adds a calibration's error"
    peers = ("EKF", "Madgwick", "Mahony") if find_spec("ahrs") is not None else ()
    return [
        Contender(bare, ROWS, _bare, pulled),
        Contender("the same as a plug-in, checked", ROWS, _as_plugin, pulled),
        *(Contender(k, run.args[0] * ROWS, run, seen) for k, run in mekf.items()),
        Contender("filter_bound", 10 * ROWS, bound, bounded),
        Contender("filter_prediction", 10 * ROWS, predict, other=calibrated),
        *(
            Contender(f"ahrs {k}", ROWS, partial(_peer, k), other="another filter")
            for k in peers
        ),
    ]


def _kept() -> list[int]:
    # the early row and every hundredth, as a report keeps them
    return list(range(min(ROWS, EARLY) - 1, 10 * ROWS, 100))


@cache
def _path(rows: int) -> FilterPath:
    time = STEP * np.arange(rows)[:, None]
    turns = STEP * np.sin(time * [0.7, 1.1, 1.3] + [0.0, 1.0, 2.0])
    q = [np.array([0.0, 0.0, 0.0, 1.0])]
    for each in from_rotation_vector(turns):
        q.append(compose(q[-1], each))
    return FilterPath(dt=np.full(rows, STEP), attitude=np.array(q))


def _readings(n: int) -> tuple[Array, Array, Array]:
    # rate, force and field of the first n trials, by row
    w, f, m = _all_readings()
    return w[:, :n], f[:, :n], m[:, :n]


@cache
def _all_readings() -> tuple[Array, Array, Array]:
    path, rng = _path(ROWS), stream(0, cell_key("bench filter"), 0)
    A = attitude_matrix(path.attitude[1:])[:, None]
    time = STEP * np.arange(ROWS)[:, None, None]
    rate = np.sin(time * [0.7, 1.1, 1.3] + [0.0, 1.0, 2.0])
    std = (
        NOISE["gyroscope_noise"] / np.sqrt(STEP),
        NOISE["accelerometer_noise"],
        NOISE["magnetometer_noise"],
    )
    w, f, m = (
        mean + each * rng.standard_normal((ROWS, TRIALS, 3))
        for mean, each in zip((rate, A @ UP, A @ FIELD), std, strict=True)
    )
    return w, f, m


def _filter(n: int) -> Mekf:
    q = np.tile(_path(ROWS).attitude[0], (n, 1))
    return Mekf(
        start=q, start_std=START_STD, bias_std=BIAS_STD, gravity=UP[2], field=FIELD,
        **NOISE,
    )  # fmt: skip


def _followed(n: int, plain: bool) -> tuple[dict[str, Array], dict[str, Array]]:
    # the answers at the early row and at the last
    own, given = _filter(n), (np.full(ROWS, STEP), *_readings(n))
    found = own._in_numpy(given[0], given[1:]) if plain else own.update_rows(*given)
    early, last = ({w: a[k] for w, a in found.items()} for k in (_kept()[0], -1))
    return early, last


class _Pulled:
    """A light filter in NumPy: the rate integrated, a pull towards up and west."""

    def __init__(self, start: Array) -> None:
        self.A = start

    def update(self, dt: float, w: Array, f: Array, m: Array) -> Array:
        up, field = self.A.T @ f, self.A.T @ m
        pull = self.A @ np.array([up[1], -up[0], 1e5 * field[1]])
        x, y, z = dt * w - 1e-5 * pull
        turn = np.array([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]])
        A = turn @ self.A
        self.A = 1.5 * A - 0.5 * A @ A.T @ A
        return self.A


def _bare() -> Float[Array, "3 3"]:
    w, f, m = (each[:, 0] for each in _readings(1))
    own = _Pulled(attitude_matrix(_path(ROWS).attitude[0]))
    for k in range(ROWS):
        own.update(STEP, w[k], f[k], m[k])
    return own.A


def _as_plugin() -> Float[Array, "3 3"]:
    declared: dict[str, Any] = {"components": "matrix", "matrix": "active"}
    plugin = Filter(
        name="pulled", make=_Pulled, reads=("start",), world="NWU", **declared
    )
    readings = Readings(
        where="",
        lead=(),
        dt=np.full(ROWS, STEP),
        end=STEP * np.arange(1, ROWS + 1),
        sensors=tuple(each[:, 0] for each in _readings(1)),
        reads={"start": attitude_matrix(_path(ROWS).attitude[0])},
    )
    return run_of(plugin, readings, np.array([ROWS - 1])).words["attitude"][-1]


def _model() -> FilterModel:
    return FilterModel(
        gyroscope_noise=NOISE["gyroscope_noise"],
        gyroscope_walk=NOISE["gyroscope_walk"],
        sensors=(
            VectorSensor(
                name="accelerometer", reference=UP, std=NOISE["accelerometer_noise"]
            ),
            VectorSensor(
                name="magnetometer", reference=FIELD, std=NOISE["magnetometer_noise"]
            ),
        ),
        start=np.diag(np.repeat([START_STD**2, BIAS_STD**2], 3)),
    )


def _peer(name: str) -> Float[Array, "4"]:
    from ahrs import filters

    own: Any = getattr(filters, name)(frequency=1.0 / STEP)
    step = own.update if name == "EKF" else own.updateMARG
    w, f, m = (each[:, 0] for each in _readings(1))
    own.mag = m  # ahrs: an EKF that is stepped measures the field if it has some
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for k in range(ROWS):
        q = step(q, w[k], f[k], m[k])
    return q
