r"""Gyroscope: error bars of a calibration between rests, against the bound.

The gimbal visits poses; every sample of the gyroscope and every pose mean is drawn. The
accelerometer is calibrated alone, then the gyroscope from the moves between the rests,
by itself (generalised, or IMU-TK's unweighted way) or with the accelerometer (joint).
Judged are the normalised squared error under the reported covariance, the coverage of
the reported intervals, the mean square error over the Cramer-Rao bound with every
attitude unknown, which the joint and the generalised fit must reach, and the recovery
without noise.

The laws are of first order. The next one is of the size of the second-order bias, below
a hundredth of a standard deviation at the default noise and in proportion to it
(`simval.theory.gyroscope`), and of what the bound's moves of 40 segments leave out
(`PIECES`). Beside little noise stands what the rotations leave out by themselves: the
scheme of means, written out once more here, against the true turn of each chunk. The
error of M that this makes is the one that is expected without noise, and it is allowed
as a bias. The generalised fit takes nothing of the gyroscope
for the accelerometer: it misses the bound by a part (`ONE_BY_ONE`) of what that would
take off the accelerometer's variances.
"""

from collections.abc import Iterator
from math import sqrt
from typing import Any

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import Array
from simval.consistency import normalised_squares
from simval.figures import Figure, Headline, Quote
from simval.imu.calibrate import (
    FitResult,
    GyroscopeFit,
    InterRestRotations,
    Recording,
    calibrate,
    fit,
    inter_rest_rotations,
)
from simval.imu.calibrate.gyroscope.noise import Weighting
from simval.imu.calibrate.recording import Bias
from simval.imu.sensor import GyroscopeModel
from simval.moments import deviations
from simval.results import Outcome, Row, Rows, exact, limit, nees, plain, unjudged
from simval.scene import Trajectory, average_rates, simulate_cached
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.response import apart
from simval.studies.study import Cost, StudyParameters, described, ranged, refusing
from simval.studies.trials import Block, Trials, drawn_rows, mean_of, trials_of
from simval.theory.calibration import calibration_moments
from simval.theory.coverage import bias_square, interval_coverage
from simval.theory.gyroscope import GYROSCOPE, MovePath, gyroscope_moments
from simval.units import PPM

TITLE = "Gyroscope: do the error bars of a calibration between rests hold?"
SECTION = "gyroscope"

BLOCK = 8  # trials; part of the promise of equal bits
FINE = 100
"""Segments of a move beside which a stated covariance is held, extrapolated with half
as many."""
SECOND, SEGMENTS = 0.14, 3e-5
"""Of the turn in a reading, which the greatest rate makes: its square times the first
is what a stated covariance leaves out, in deviations: the factor was 0.025 to 0.07 of
poses from 12 to 40, moves of 1.5 to 10 s and 1 to 10 rows to a reading; and what the
segments leave out of it."""
ROUNDED = 1e-11
"""Of a rotation: thousands of rows of 1e-16 each, by the condition of the poses."""
RELATIVE = 5e-3
"""Of a variance or a NEES: the bound's segments, and the covariance that is taken at a
noisy estimate, which moves it by some 1e-3."""
SMALL_BIAS, USUAL = 0.01, 0.01
"""Standard deviations at the usual noise, in degrees/s per root hertz: 0.0017 of second
order at 40 poses, 0.003 of the fourth order of a step at 100 Hz."""
ONE_BY_ONE = 5e-3
"""Of that share: 3.1e-3 of two thirds was missed with hardly any noise, in settings of
14 to 40 poses, and less than a thousandth of a quarter with the usual noise."""
ENOUGH = 1024  # trials, from which a bias of a fifth of a standard deviation is seen
LEVEL = 0.95
ROWS = 500.0  # Hz, of the gimbal
FORCE = 0.01  # m/s^2, of an accelerometer's sample at 100 Hz
CHUNK = 2
PIECES = 40
"""Segments of a move in the bound. Beside the limit of ever shorter ones, a variance is
off by up to 4e-3 of itself with 14 poses, 3e-3 with 40 and 12e-3 with 12, and the mean
of all twelve, which is judged, by 1e-4, 4e-4 and 8e-4
(`tests/studies/test_calibration_studies.py`)."""
THINNED = {f"{ROWS / k:g} Hz": k for k in (1, 2, 5, 10)}
"""Rows of 500 Hz to a reading, for the order of an integrator, by the rate's name."""
AVERAGES, STRAIGHT = "averages", "straight lines"
UNITS = ("1",) * 9 + ("rad/s",) * 3


class Parameters(StudyParameters):
    """One cell: an estimator, poses, rotations, rate of the rows and noise."""

    estimator: Weighting = described(
        "joint", "Both sensors together, one by one, or IMU-TK's."
    )
    poses: int = ranged(40, "Poses, spread evenly over the sphere.", 12, 100)
    move_time: float = ranged(2.0, "Time of a move, s.", 1.5, 10.0)
    every: int = ranged(5, "Rows of 500 Hz that one reading averages.", 1, 10)
    angle_random_walk: float = ranged(
        0.01, "White noise, degrees/s per root hertz.", 1e-6, 0.3
    )
    trials: int = ranged(1024, "Trials; rounded up to whole blocks of 8.", 256)

    def cost(self) -> Cost:
        """Cost of a cell: the scene, and a fit for each trial."""
        rows = self.poses * (self.move_time + 1.6) * 5.0 / self.every
        return Cost(1.0 + 5e-5 * rows * self.trials, 20)


def true_gyroscope(**more: Any) -> GyroscopeModel:
    """The gyroscope that is to be recovered."""
    off = [[0.02, 0.02, -0.01], [0.03, 0.03, 0.02], [-0.02, 0.01, -0.01]]
    bias = np.array([0.02, -0.01, 0.03])
    return GyroscopeModel(M=np.eye(3) + np.array(off), B=bias, **more)


class Tumble:
    """Scene and sensors of a cell; draws trials and calibrates from them."""

    def __init__(self, parameters: Parameters, steps: Any = None) -> None:
        self.parameters = parameters
        every = self.every = parameters.every
        run = simulate_cached(
            "gimbal", poses=parameters.poses, move_time=parameters.move_time,
            first_hold=20.0,
        )  # fmt: skip
        self.g = run.g
        self.time, self.attitude = run.time[::every], run.attitude[::every]
        self.rests = _rests(run, every)
        force = run.specific_force[::every]
        still = np.concatenate([force[a:b] for a, b in self.rests])
        self.off = np.abs(np.linalg.norm(still, axis=1) - run.g).max()
        self.rest_force = run.rest_force
        self.force = np.array([force[a:b].mean(axis=0) for a, b in self.rests])
        seconds = np.diff(self.rests)[:, 0] * every / ROWS
        self.pose_std = FORCE / np.sqrt(100.0 * seconds)
        self.walk = np.radians(parameters.angle_random_walk)
        self.gyroscope = true_gyroscope()
        self.accelerometer = true_sensor(0.0)
        rng = np.random.default_rng(0)  # draws nothing
        self.body = average_rates(run, every)
        self.rates = self.gyroscope.distort(self.body, rng)
        self.steps = average_rates(run) if steps is None else steps  # of 500 Hz
        # of a reading at the greatest rate, rad
        self.turn = np.linalg.norm(self.steps, axis=1).max() * every / ROWS
        self.poses = self.accelerometer.distort(self.force, rng)
        self.truth = np.concatenate([self.gyroscope.M.ravel(), self.gyroscope.B])

    def thinned(self, every: int) -> "Tumble":
        """The same scene at another rate."""
        if every == self.every:
            return self
        return Tumble(self.parameters.model_copy(update={"every": every}), self.steps)

    def straight_lines(self) -> float:
        """Error of M without noise, if samples are joined by straight lines.

        An instant is the mean of the two steps of 500 Hz beside it.
        """
        ends = np.concatenate([self.steps[1:], self.steps[-1:]])
        beside = 0.5 * (self.steps + ends)[:: self.every]
        rates = self.gyroscope.distort(beside, np.random.default_rng(0))
        inter_rest = inter_rest_rotations(self.time, rates, self.rests, scheme="linear")
        found = self.gyroscope_of(
            inter_rest, self.poses, calibrate(self.poses, self.g), "unweighted"
        )
        return np.abs(found.M - self.gyroscope.M).max()

    def readings(
        self, rng: np.random.Generator, count: int
    ) -> tuple[Float[Array, "t n 3"], Float[Array, "t r 3"]]:
        """Draw pose means and rates of some trials."""
        std, each = self.pose_std[:, None], self.walk / sqrt(self.every / ROWS)
        poses = self.poses + std * rng.standard_normal((count, *self.poses.shape))
        rows = self.rates + each * rng.standard_normal((count, *self.rates.shape))
        return poses, rows

    def noise(
        self, poses: Float[Array, "t n 3"], rows: Float[Array, "t r 3"]
    ) -> dict[str, Array]:
        """Noise of such readings, relative to the parameters."""
        each = np.radians(self.parameters.angle_random_walk) * sqrt(ROWS / self.every)
        return {
            "pose means": (poses - self.poses) / self.pose_std[:, None],
            "rates": (rows - self.rates) / each,
        }

    def clean(self, rates: Any = None) -> GyroscopeFit:
        """Calibrate from rates without noise."""
        both = self.poses, self.rates if rates is None else rates
        return self.fitted(*(np.ascontiguousarray(x)[None] for x in both))

    def by_scheme(self, clean: GyroscopeFit) -> Float[Array, "3 3"]:
        """Error of M by what the integration leaves out of each chunk.

        Added to the readings that makes the scheme turn as the truth does, up to the
        next order: the square of a reading's turn times as much (0.08 of it was seen).
        """
        h, w = self.every / ROWS, self.body
        rise = 0.5 * (np.roll(w, -1, axis=0) - np.roll(w, 1, axis=0))
        turn, cross = h * w, h * h / 12.0 * np.cross(w, rise)
        lost = np.zeros_like(w)
        for a, b in zip(*self._ends(), strict=True):
            one = np.arange(a, b, CHUNK) + 1  # of two steps, the last perhaps of one
            end = np.minimum(one + 1, b)
            more = (end > one)[:, None]
            second = turn[end] + cross[end] + 0.5 * np.cross(turn[one], turn[end])
            whole = turn[one] + cross[one] + more * second
            left = (self._turns(one - 1, end) - whole) / (1.0 + more)
            lost[end] = left
            lost[one] = left
        rates = self.rates + np.linalg.solve(self.gyroscope.M, lost.T / h).T
        return (clean.M - self.clean(rates).M)[0]

    def fitted(
        self, poses: Float[Array, "t n 3"], rows: Float[Array, "t r 3"]
    ) -> GyroscopeFit:
        """Calibrate from pose means and rates."""
        inter_rest = inter_rest_rotations(self.time, rows, self.rests, chunk=CHUNK)
        known = self.parameters.estimator == "unweighted"
        acc = calibrate(poses, self.g, residual="weighted", noise_std=self.pose_std)
        return self.gyroscope_of(
            inter_rest, poses, acc, self.parameters.estimator,
            bias="first rest" if known else "constant",
        ).require_converged()  # fmt: skip

    def gyroscope_of(
        self, rotations: InterRestRotations, poses: Float[Array, "... n 3"],
        accelerometer: FitResult, estimator: Weighting, bias: Bias = "constant",
    ) -> GyroscopeFit:  # fmt: skip
        """Calibrate from what the rests showed."""
        recording = Recording(
            poses=poses, pose_std=self.pose_std, rotations=rotations, g=self.g,
            angle_random_walk=self.walk, bias=bias, accelerometer=accelerometer,
        )  # fmt: skip
        return fit(recording, estimator=estimator, start=np.eye(3)).gyroscope

    def bound(self, pieces: int = PIECES) -> Float[Array, "12 12"]:
        """Cramér-Rao bound of the gyroscope's twelve parameters."""
        return self.bounds(pieces)[9:, 9:]

    @property
    def missed(self) -> float:
        """Share by which the estimator may exceed the bound."""
        if self.parameters.estimator != "generalised":
            return 0.0
        both = np.diagonal(self.bounds()[:9, :9])
        given = self.accelerometer, self.force, self.g, self.pose_std
        alone = np.diagonal(calibration_moments(*given).cramer_rao)
        return ONE_BY_ONE * np.max(1.0 - both / alone)

    def bounds(self, pieces: int = PIECES) -> Float[Array, "21 21"]:
        """Cramér-Rao bound for both sensors."""
        inter_rest = inter_rest_rotations(
            self.time, self.rates, self.rests, chunk=CHUNK
        )
        moments = gyroscope_moments(
            self.gyroscope, self.accelerometer, self.force, self._path(pieces),
            pose_std=self.pose_std, g=self.g, angle_random_walk=self.walk,
            bias_std=self.walk / np.sqrt(inter_rest.rest_seconds.sum()),
        )  # fmt: skip
        return moments.cramer_rao

    def _path(self, pieces: int) -> MovePath:
        # from the attitudes, from ten rows before the end of a rest to ten of the next
        turns, seconds = [], []
        for a, b in zip(*self._ends(), strict=True):
            nodes = np.round(np.linspace(a, b, pieces + 1)).astype(int)
            turns.append(self._turns(nodes[:-1], nodes[1:]))
            seconds.append(np.diff(self.time[nodes]))
        return MovePath(turns=np.array(turns), seconds=np.array(seconds))

    def _ends(self) -> tuple[Any, Any]:
        inner = np.minimum(10, np.diff(self.rests)[:, 0] // 3)
        return self.rests[:-1, 1] - 1 - inner[:-1], self.rests[1:, 0] + inner[1:]

    def _turns(self, start: Any, end: Any) -> Float[Array, "n 3"]:
        # the package's world to sensor is what SciPy reads as sensor to world
        rotation = scipy.spatial.transform.Rotation
        before, after = (rotation.from_quat(self.attitude[k]) for k in (start, end))
        return (before.inv() * after).as_rotvec()


def _rests(run: Trajectory, every: int) -> Any:
    hold = run.hold[::every]
    rows = [np.flatnonzero(hold == k) for k in run.hold_indices()]
    return np.array([[r[0], r[-1] + 1] for r in rows])


@refusing("lower `angle_random_walk` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    data = Tumble(parameters)
    free = 9 if parameters.estimator == "unweighted" else 12

    def trial(rng: np.random.Generator) -> Block:
        readings = data.readings(rng, BLOCK)
        fit = data.fitted(*readings)
        error = (fit.parameters - data.truth)[:, :free]
        covariance = fit.own_covariance[:, :free, :free]
        return {"error": error, "covariance": covariance}, data.noise(*readings)

    trials = trials_of(streams, parameters.trials, BLOCK, trial)
    bound = np.diagonal(data.bound())[:free]
    clean = data.clean()
    off = np.abs(clean.M[0] - data.gyroscope.M).max()
    scheme = data.by_scheme(clean)
    most = np.abs(scheme).max()
    left = ROUNDED + data.turn**2 * most
    return Outcome(
        rows=(
            *_judged(trials, bound, data, scheme),
            *exact(stat.RECOVERY("M"), off, most, stat.INTEGRATOR, left),
            *limit(stat.REST_FORCE(), data.off, data.rest_force, stat.SCENE_BOUND),
            *drawn_rows(trials.noise),
            *_stated_row(clean, data),
            *_integrators(data),
            *unjudged(stat.SD("M", "bound"), sqrt(bound[:9].mean())),
        )
    )


def _judged(
    trials: Trials,
    bound: Float[Array, " p"],
    data: Tumble,
    scheme: Float[Array, "3 3"],
) -> Rows:
    error, C = trials["error"], trials["covariance"]
    n, p = error.shape
    sd = deviations(C)
    z = -scipy.special.ndtri((1.0 - LEVEL) / 2.0)
    stated = C.mean(axis=0)
    small = SMALL_BIAS * max(1.0, data.parameters.angle_random_walk / USUAL)
    left = small * deviations(stated)
    left[:9] += np.abs(scheme).ravel()  # what the rotations leave out
    within, may = interval_coverage(
        LEVEL, np.zeros(p), left / deviations(stated), RELATIVE / 2.0
    )
    _, off = bias_square(np.zeros(p), left, stated)
    covered = mean_of((np.abs(error) < z * sd).mean(axis=1))
    over = mean_of((error**2 / bound).mean(axis=1))
    # the unweighted way does not reach the bound
    judge = plain if p == 12 else unjudged
    shift = plain if n >= ENOUGH else unjudged
    return (
        *nees(
            stat.NEES(), *mean_of(normalised_squares(error, C)),
            float(p), stat.CHI_SQUARE, RELATIVE * p + off,
        ),
        *plain(
            stat.COVERAGE("mean"), *covered, within.mean(), stat.NORMAL, may.mean()
        ),
        *judge(
            stat.SQUARED_ERROR("mean"), *over, 1.0, stat.CRAMER_RAO,
            RELATIVE + data.missed + np.mean(left**2 / bound),
        ),
        *shift(
            stat.BIAS.each(GYROSCOPE[:p], UNITS[:p]), *mean_of(error),
            0.0, stat.NO_BIAS, left,
        ),
    )  # fmt: skip


def _stated_row(clean: GyroscopeFit, data: Tumble) -> Rows:
    """Covariance stated at the truth, against the bound."""
    if data.parameters.estimator == "unweighted":  # which does not reach the bound
        return ()
    coarse, fine = (data.bound(pieces) for pieces in (FINE // 2, FINE))
    bound = (4.0 * fine - coarse) / 3.0  # of the second order of a piece
    off = apart(clean.own_covariance[0], bound)
    left = SEGMENTS + SECOND * data.turn**2 + data.missed
    return exact(stat.COVARIANCE_OFF("stated"), off, 0.0, stat.CRAMER_RAO, left)


def _integrators(data: Tumble) -> Iterator[Row]:
    """Error of M without noise, by rate and by integration."""
    for rate, every in THINNED.items():
        thinned = data.thinned(every)
        averages = np.abs(thinned.clean().M[0] - data.gyroscope.M).max()
        yield from unjudged(
            (stat.RECOVERY("M", AVERAGES, rate), stat.RECOVERY("M", STRAIGHT, rate)),
            (averages, thinned.straight_lines()),
        )


KINDS = {
    STRAIGHT: "straight lines between samples",
    AVERAGES: "averages with their coning",
    "bound": "noise alone",
}
THINNED_ROWS = [stat.RECOVERY("M", kind, rate) for kind in KINDS for rate in THINNED]


def _kind(row: Row) -> str:
    return KINDS[row.statistic.entries[1]]


FIGURES = (
    Figure(
        name="gyroscope",
        asked="How fast must a gyroscope be read for its calibration?",
        says="Error of M over these rates: {each}.",
        about=[*THINNED_ROWS, stat.SD("M", "bound")],
        rows=THINNED_ROWS,
        along=lambda row: ROWS / THINNED[row.statistic.entries[2]],
        axis="rows per second, Hz",
        lines=_kind,
        value="error of M",
        unit=PPM,
        compared=False,
        floor=stat.SD("M", "bound"),
        columns=2,
        caption=(
            "Greatest error of M in a calibration without noise, by the rate of the "
            "rows. Runge-Kutta on samples integrates straight lines between them and "
            "is of second order; averages over a step with their coning are of the "
            "fourth. Dotted: the least standard deviation that noise allows an entry "
            "of M in this cell (Cramér-Rao), root mean square."
        ),
    ),
)
HEADLINE = Headline(
    says="M {M} by the bound; {over} × the bound",
    quotes={
        "over": Quote(of=stat.SQUARED_ERROR("mean"), by=stat.CRAMER_RAO, root=True),
        "M": Quote(of=stat.SD("M", "bound"), unit=PPM),
    },
)
