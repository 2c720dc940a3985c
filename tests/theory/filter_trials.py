"""Trials of the reference filter on the gimbal, and the table of what breaks it.

``PYTHONPATH=tests python tests/theory/filter_trials.py`` prints the table of
docs/filters.md: as simulated, and as theory has it. Every number that a sensor reads is
drawn: the start, the gyroscope's noise and walk over each step, and the noise of the
vector sensors at its end."""

import sys
import time
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from filter_paths import FIELD, UP, G

from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    from_rotation_vector,
    rotation_vector,
)
from simval.imu.filters import Mekf
from simval.scene import average_rates, simulate_cached
from simval.theory import (
    CalibrationError,
    FilterModel,
    FilterPath,
    RowError,
    VectorSensor,
    filter_bound,
    filter_prediction,
    first_update,
)

NOISE = {
    "gyroscope_noise": 1.75e-4, "gyroscope_walk": 2e-5,
    "accelerometer_noise": 2e-3 * G,
    "magnetometer_noise": 5e-3 * float(np.linalg.norm(FIELD)),
    "start_std": 0.05, "bias_std": 5e-3,
}  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """A motion in steps, and what ideal sensors read of it."""

    path: FilterPath
    rate: np.ndarray  # average over each step
    force: np.ndarray  # at its end, without the acceleration of the body
    field: np.ndarray
    felt: np.ndarray  # specific force where the sensor is, 27 mm off the axes

    def part(self, rows):
        """Some first rows."""
        q, dt = self.path.attitude[: rows + 1], self.path.dt[:rows]
        some = (each[:rows] for each in (self.rate, self.force, self.field, self.felt))
        return Truth(FilterPath(dt=dt, attitude=q), *some)


@cache
def gimbal(every=5, timestep=0.002):
    """Twelve poses, moves of 2 s."""
    run = simulate_cached("gimbal", poses=12, move_time=2.0, timestep=timestep)
    q = run.attitude[::every]
    A = attitude_matrix(q[1:])
    path = FilterPath(dt=np.diff(run.time[::every]), attitude=q)
    felt = run.specific_force[::every][1:]
    return Truth(path, average_rates(run, every)[1:], A @ UP, A @ FIELD, felt)


def model_of(noise=NOISE):
    """The same as theory takes it."""
    up, magnetic = noise["accelerometer_noise"], noise["magnetometer_noise"]
    std = np.repeat([noise["start_std"], noise["bias_std"]], 3)
    return FilterModel(
        gyroscope_noise=noise["gyroscope_noise"],
        gyroscope_walk=noise["gyroscope_walk"],
        sensors=(VectorSensor(name="accelerometer", reference=UP, std=up),
                 VectorSensor(name="magnetometer", reference=FIELD, std=magnetic)),
        start=np.diag(std**2),
    )  # fmt: skip


@dataclass(frozen=True)
class Trials:
    """Squares of errors and innovations, (T, n); mean square error by row, (T,)."""

    attitude: np.ndarray
    whole: np.ndarray
    nis: np.ndarray
    square: np.ndarray
    seconds: float  # of the filter, for a trial and a row

    def mean(self, name, skip=0):
        """Mean over trials of the means over time, and its standard error."""
        each = getattr(self, name)[skip:].mean(axis=0)
        return each.mean(), each.std(ddof=1) / np.sqrt(len(each))


def normalised(e, P):
    return np.vecdot(e, np.linalg.solve(P, e[..., None])[..., 0])


def trials(truth, n, seed, *, told=None, matrix=None, start=None, **options):
    """Run n trials; `matrix` is the gyroscope's error, `start` known turns, (n, 3)."""
    rng, noise = np.random.default_rng(seed), NOISE
    q, dt = truth.path.attitude, truth.path.dt
    off = noise["start_std"] * rng.standard_normal((n, 3)) if start is None else start
    b = noise["bias_std"] * rng.standard_normal((n, 3))
    ours = Mekf(
        start=compose(q[0], from_rotation_vector(-off)), gravity=G, field=FIELD,
        **{**noise, **(told or {})}, **options,
    )  # fmt: skip
    rate = truth.rate if matrix is None else truth.rate @ (np.eye(3) + matrix).T
    N, K = noise["gyroscope_noise"], noise["gyroscope_walk"]
    sums, spent = np.zeros((4, len(dt), n)), 0.0
    for k, h in enumerate(dt):
        # a walk over the step: its end, and its mean, a half of that and a bridge
        white, end, bridge, f, m = rng.standard_normal((5, n, 3))
        end *= K * np.sqrt(h)
        bias = b + end / 2.0 + K * np.sqrt(h / 12.0) * bridge
        b = b + end
        w = rate[k] + bias + N / np.sqrt(h) * white
        f = truth.force[k] + noise["accelerometer_noise"] * f
        m = truth.field[k] + noise["magnetometer_noise"] * m
        begun = time.process_time()
        answer = ours.update(h, w, f, m)
        spent += time.process_time() - begun
        turn = rotation_vector(compose(conjugate(answer["attitude"]), q[k + 1][None]))
        e, P = np.concatenate([turn, b - answer["bias"]], 1), answer["covariance"]
        sums[:, k] = (
            normalised(turn, P[:, :3, :3]), normalised(e, P),
            normalised(answer["innovation"], answer["innovation_covariance"]),
            np.vecdot(turn, turn) / 3.0,
        )  # fmt: skip
    return Trials(*sums[:3], sums[3].mean(axis=1), spent / n / len(dt))


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong: how it is simulated, and what theory makes of it."""

    name: str
    trial: dict = field(default_factory=dict)
    told: dict = field(default_factory=dict)
    matrix: np.ndarray | None = None
    lever: bool = False

    def run(self, truth, n, seed):
        if self.lever:
            truth = replace(truth, force=truth.felt)
        return trials(truth, n, seed, told=self.told, matrix=self.matrix, **self.trial)

    def predicted(self, truth):
        told, errors = model_of({**NOISE, **self.told}), []
        if self.matrix is not None:
            value = np.ravel(self.matrix)
            errors.append(CalibrationError(of="gyroscope", value=value))
        if self.trial.get("coning") is False:
            errors.append(RowError(of="gyroscope", rows=coning_error(truth)))
        if self.lever:
            rows = truth.felt - truth.force
            errors.append(RowError(of="accelerometer", rows=rows))
        return filter_prediction(truth.path, model_of(), told=told, errors=errors)


def coning_error(truth):
    """Average rate less the rotation vector by the time: what averages leave out."""
    q = truth.path.attitude
    turn = rotation_vector(compose(conjugate(q[:-1]), q[1:]))
    return truth.rate - turn / truth.path.dt[:, None]


def _told(name, key, times):
    return Fault(name, told={key: times * NOISE[key]})


FAULTS = (
    Fault("nothing"),
    Fault("no coning term", trial={"coning": False}),
    _told("told N/3", "gyroscope_noise", 1 / 3),
    _told("told 3 N", "gyroscope_noise", 3.0),
    _told("told twice the accelerometer's noise", "accelerometer_noise", 2.0),
    *(Fault(f"scale wrong by {s:g}", matrix=s * np.eye(3))
      for s in (1e-4, 3e-4, 1e-3, 5e-3)),
    *(Fault(f"axes turned by 1 mrad about {axis}", matrix=cross_matrix(1e-3 * e))
      for axis, e in zip("xyz", np.eye(3), strict=True)),
    Fault("lever arm of 27 mm", lever=True),
)  # fmt: skip

SKIP = 10
"""Rows after which the start's second order is forgotten."""


def directions(n, seed):
    """Turns of 17 degrees about axes drawn from the sphere."""
    axes = np.random.default_rng(seed).standard_normal((n, 3))
    return np.radians(17.0) * axes / np.linalg.norm(axes, axis=1, keepdims=True)


def far_start(truth, turns, start_std):
    """Mean over turns of the start of what theory predicts from the second row on."""
    told = model_of({**NOISE, "start_std": start_std})
    sure = model_of({**NOISE, "start_std": 0.0})
    found = []
    for turn in turns:
        first = first_update(truth.path, sure, turn, told=told)
        found.append(filter_prediction(
            first.path, first.truth, told=first.told, start_error=first.error
        ))  # fmt: skip
    return found


def expected(wanted):
    """Theory's NEES and NIS by row, by the names of `Trials`."""
    return {"attitude": wanted.nees(3), "whole": wanted.nees(), "nis": wanted.nis}


def line(name, found, wanted, bound):
    """One row of the table: simulated, standard error, (predicted, of the second half).

    The last cell is the root mean square error over the bound.
    """
    cells = [f"{name:36s}"]
    for each, theory in expected(wanted).items():
        mean, se = found.mean(each, SKIP)
        late = theory[len(theory) // 2 :].mean()
        cells.append(
            f"{mean:7.2f} +- {se:4.2f} ({theory[SKIP:].mean():6.2f},{late:7.2f})"
        )
    square = (bound.attitude_sd[SKIP:] ** 2).sum()
    rms = np.sqrt(found.square[SKIP:].sum() / square)
    theory = np.sqrt((wanted.rms()[SKIP:] ** 2).sum() / square)
    cells.append(f"{rms:6.3f} ({theory:6.3f})")
    return "  ".join(cells)


def table(n, seed=1):
    """Every fault, simulated and predicted."""
    truth = gimbal()
    bound = filter_bound(truth.path, model_of())
    for fault in FAULTS:
        found = fault.run(truth, n, seed)
        yield line(fault.name, found, fault.predicted(truth), bound)
    apart = np.radians(17.0) * np.random.default_rng(seed).standard_normal((n, 3))
    for name, turns, std in (
        ("start 17 deg off", directions(n, seed), np.radians(17.0) / np.sqrt(3.0)),
        ("start 17 deg off in each axis", apart, np.radians(17.0)),
    ):
        std = float(std)
        found = trials(truth, n, seed, told={"start_std": std}, start=turns)
        yield far_line(name, found, far_start(truth, turns[:24], std))


def far_line(name, found, wanted):
    """Mean and median trial of the whole run, and theory over some of the starts."""
    cells = [f"{name:36s}"]
    theory = [expected(each) for each in wanted]
    for each in theory[0]:
        mean, se = found.mean(each, 1)
        middle = np.median(getattr(found, each)[1:].mean(axis=0))
        own = np.mean([rows[each].mean() for rows in theory])
        cells.append(f"{mean:7.2f} +- {se:4.2f}, median {middle:6.2f} ({own:6.2f})")
    return "  ".join(cells)


if __name__ == "__main__":
    for text in table(int(sys.argv[1]) if len(sys.argv) > 1 else 60):
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()
