"""Race of attitude filters, and of the bound on them, by rows of a trial."""

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.bench.race import Contender
from simval.filters import Mekf
from simval.geometry import attitude_matrix, compose, from_rotation_vector
from simval.plugins import Filter
from simval.plugins.filter_steps import Readings, run_of
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
AGREEMENT = 0.02
"""Of the filter's mean variance by the bound: H moves with a start of 0.01 rad."""


def contenders() -> list[Contender]:
    """List filters and the bound; the reference is our filter, all trials at once."""
    _agree()

    def mekf(n: int) -> Callable[[], int]:
        return lambda: _followed(_filter(n), n, ROWS)[1]

    long = _path(10 * ROWS)
    error = CalibrationError(of="gyroscope", covariance=1e-8 * np.eye(9))

    def bound() -> int:
        filter_bound(long, _model(), keep=100)
        return len(long.dt)

    def prediction() -> int:
        filter_prediction(long, _model(), errors=[error], keep=100)
        return len(long.dt)

    found = [
        Contender(name=f"mekf, {TRIALS} trials", run=mekf(TRIALS)),
        Contender(name="mekf, one trial", run=mekf(1)),
        Contender(name="a filter in Python, in a bare loop", run=_bare),
        Contender(name="the same as a plug-in, checked", run=_as_plugin),
        Contender(name="filter_bound", run=bound),
        Contender(name="filter_prediction", run=prediction),
    ]
    if find_spec("ahrs") is not None:
        found += [
            Contender(name=f"ahrs {name}", run=_peer(name))
            for name in ("EKF", "Madgwick", "Mahony")
        ]
    return found


@cache
def _path(rows: int) -> FilterPath:
    time = STEP * np.arange(rows)[:, None]
    turns = STEP * np.sin(time * [0.7, 1.1, 1.3] + [0.0, 1.0, 2.0])
    q = [np.array([0.0, 0.0, 0.0, 1.0])]
    for each in from_rotation_vector(turns):
        q.append(compose(q[-1], each))
    return FilterPath(dt=np.full(rows, STEP), attitude=np.array(q))


@cache
def _readings(n: int) -> tuple[Array, Array, Array]:
    # rate, force and field of n trials, by row
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
        mean + each * rng.standard_normal((ROWS, n, 3))
        for mean, each in zip((rate, A @ UP, A @ FIELD), std, strict=True)
    )
    return w, f, m


def _filter(n: int) -> Mekf:
    q = np.tile(_path(ROWS).attitude[0], (n, 1))
    return Mekf(
        start=q, start_std=START_STD, bias_std=BIAS_STD, gravity=UP[2], field=FIELD,
        **NOISE,
    )  # fmt: skip


def _followed(own: Mekf, n: int, rows: int) -> tuple[dict[str, Array], int]:
    # the last answer, and how many rows of a trial that were
    answer: dict[str, Array] = {}
    w, f, m = _readings(n)
    for k in range(rows):
        answer = own.update(STEP, w[k], f[k], m[k])
    return answer, n * rows


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


def _bare() -> int:
    w, f, m = (each[:, 0] for each in _readings(1))
    own = _Pulled(attitude_matrix(_path(ROWS).attitude[0]))
    for k in range(ROWS):
        own.update(STEP, w[k], f[k], m[k])
    return ROWS


def _as_plugin() -> int:
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
    run_of(plugin, readings, np.array([ROWS - 1]))
    return ROWS


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


def _agree() -> None:
    rows = min(ROWS, 100)
    answer, _ = _followed(_filter(TRIALS), TRIALS, rows)
    bound = filter_bound(_path(ROWS), _model(), keep=[rows - 1]).covariance[0]
    own = answer["covariance"].mean(axis=0)
    off = float(np.abs(np.diagonal(own) / np.diagonal(bound) - 1.0).max())
    if not off <= AGREEMENT:
        msg = f"the contenders differ by {off:.1e}; {AGREEMENT:g} is allowed"
        raise AssertionError(msg)


def _peer(name: str) -> Callable[[], int]:
    def run() -> int:
        from ahrs import filters

        own: Any = getattr(filters, name)(frequency=1.0 / STEP)
        step = own.update if name == "EKF" else own.updateMARG
        w, f, m = (each[:, 0] for each in _readings(1))
        own.mag = m  # ahrs: an EKF that is stepped measures the field if it has some
        q = np.array([1.0, 0.0, 0.0, 0.0])
        for k in range(ROWS):
            q = step(q, w[k], f[k], m[k])
        return ROWS

    return run
