"""Race of attitude filters, and of the bound on them, by rows of a trial."""

from dataclasses import asdict
from functools import cache, partial
from importlib.util import find_spec

import numpy as np

from benchmarks.race import Contender, race
from simval.geometry import attitude_matrix
from simval.imu.filters import Mekf
from simval.plugins import Filter
from simval.plugins.runs import Readings, run_of
from simval.studies import filter as study
from simval.studies.filter_prediction import model_of
from simval.studies.filter_scenarios import drawn
from simval.theory import (
    CalibrationError,
    FilterPath,
    filter_bound,
    filter_prediction,
)

ROWS, TRIALS = 400, 100  # of the study's own scenario, 4 s at 100 Hz
EARLY = 100  # row whose variances are compared, where the start still counts
AGREEMENT = 0.02
"""Of the filter's mean variance by the bound: H moves with a start of 5 mrad."""
ROUNDING = 1e-9
"""Of what must be the same: an answer alone and in a batch, through a plug-in or not.
Chosen: 400 rows lose some 1e-13."""


@race("filter", "Attitude filters, and the bound on them, at 100 Hz", "rows of a trial")
def contenders():
    """List filters and the bound; the reference is a filter in NumPy, in a bare loop.

    The filters of ahrs, and the prediction, answer other questions.
    """
    path, told, *_ = _data()
    kept, model = [min(ROWS, EARLY) - 1], model_of(told, True)
    error = CalibrationError(of="gyroscope", covariance=1e-8 * np.eye(9))
    bound = partial(filter_bound, path, model, keep=kept)
    predict = partial(filter_prediction, path, model, errors=[error], keep=kept)
    mekf = {
        f"mekf{form}, {trials}": (n, partial(_followed, n, way))
        for form, way in (("", Mekf.update_rows), (" in NumPy", _in_numpy))
        for trials, n in ((f"{TRIALS} trials", TRIALS), ("one trial", 1))
    }
    mekf["mekf, one trial, row by row"] = (1, partial(_followed, 1, _by_row))

    def pulled(matrix):
        return {"attitude of the filter in NumPy": (matrix, ROUNDING)}

    def seen(answers):
        # variances of all trials at the early row, attitudes at the last
        q, P = answers["attitude"][-1], answers["covariance"][kept[0]]
        found = {"attitudes": (q[:, :, None] * q[:, None, :], ROUNDING)}
        if len(q) > 1:  # of one the variance is not the mean
            variances = np.diagonal(P.mean(axis=0))
            found["variances"] = (variances, AGREEMENT * variances)
        return found

    def bounded(found):
        # as good as exact: all of the difference is the filter's
        return {"variances": (np.diagonal(found.covariance[0]), 0.0)}

    bare = "a filter in NumPy, bare loop, data unchecked"
    peers = ("EKF", "Madgwick", "Mahony") if find_spec("ahrs") is not None else ()
    return [
        Contender(bare, ROWS, _bare, pulled),
        Contender("the same as a plug-in, checked", ROWS, _as_plugin, pulled),
        *(Contender(name, n * ROWS, run, seen) for name, (n, run) in mekf.items()),
        Contender("filter_bound", ROWS, bound, bounded),
        Contender(
            "filter_prediction", ROWS, predict, other="adds a calibration's error"
        ),
        *(
            Contender(f"ahrs {k}", ROWS, partial(_peer, k), other="another filter")
            for k in peers
        ),
    ]


@cache
def _data():
    parameters = study.Parameters(seconds=4.0)
    way = parameters.course
    told = study.told_of(parameters, way)
    sensors, rng = study.sensors_of(parameters, way), np.random.default_rng(0)
    given, _ = drawn(way, sensors, told, TRIALS, rng)
    path = FilterPath(dt=way.dt[:ROWS], attitude=way.attitude[: ROWS + 1])
    # rate, force and field, by row
    sensors = given.gyroscope, given.accelerometer, given.magnetometer
    rows = [np.ascontiguousarray(y[:, :ROWS].swapaxes(0, 1)) for y in sensors]
    return path, told, given.start, rows


def _followed(n, way):
    path, told, start, rows = _data()
    own, rows = Mekf(start=start[:n], **asdict(told)), [y[:, :n] for y in rows]
    return way(own, path.dt, *rows)


def _in_numpy(own, dt, *rows):
    return own._in_numpy(dt, list(rows))


def _by_row(own, dt, *rows):
    answers = [own.update(*row) for row in zip(dt, *rows, strict=True)]
    return {word: [answer[word] for answer in answers] for word in answers[0]}


class _Pulled:
    """A light filter in NumPy: the rate integrated, a pull towards up and west."""

    def __init__(self, start):
        self.A = start

    def update(self, dt, w, f, m):
        up, field = self.A.T @ f, self.A.T @ m
        pull = self.A @ np.array([up[1], -up[0], 1e5 * field[1]])
        x, y, z = dt * w - 1e-5 * pull
        turn = np.array([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]])
        A = turn @ self.A
        self.A = 1.5 * A - 0.5 * A @ A.T @ A
        return self.A


def _one():
    path, _, start, rows = _data()
    return path.dt, [y[:, 0] for y in rows], attitude_matrix(start[0])


def _bare():
    dt, sensors, start = _one()
    own = _Pulled(start)
    for step, w, f, m in zip(dt, *sensors, strict=True):
        own.update(step, w, f, m)
    return own.A


def _as_plugin():
    dt, sensors, start = _one()
    plugin = Filter(
        name="pulled", make=_Pulled, reads=("start",), world="NWU",
        components="matrix", matrix="active",
    )  # fmt: skip
    readings = Readings(
        where="", lead=(), dt=dt, end=np.cumsum(dt), sensors=tuple(sensors),
        reads={"start": start},
    )  # fmt: skip
    return run_of(plugin, readings, np.array([len(dt) - 1])).words["attitude"][-1]


def _peer(name):
    from ahrs import filters

    dt, sensors, _ = _one()
    own = getattr(filters, name)(frequency=1.0 / dt[0])
    step = own.update if name == "EKF" else own.updateMARG
    own.mag = sensors[-1]  # ahrs: an EKF that is stepped measures it if it has some
    q = np.array([1.0, 0.0, 0.0, 0.0])
    for w, f, m in zip(*sensors, strict=True):
        q = step(q, w, f, m)
    return q
