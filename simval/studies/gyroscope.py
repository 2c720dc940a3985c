r"""Gyroscope: error bars of a calibration between rests, beside the bound on them.

The gimbal visits poses; every sample of the gyroscope and every pose mean is drawn. The
accelerometer is calibrated alone, then the gyroscope from the moves between the rests,
by itself (generalised, or IMU-TK's unweighted way) or with the accelerometer (joint).
Judged are the normalised squared error under the reported covariance, the coverage of
the reported intervals, the mean square error over the Cramer-Rao bound with every
attitude unknown, which the joint and the generalised fit must reach, and the recovery
without noise.

The laws are of first order. The next one is of the size of the second-order bias, below
a hundredth of a standard deviation (`simval.theory.joint_bias`), and of what the
bound's moves of 40 segments leave out (`simval.studies.gyroscope_tumble.PIECES`).
"""

from math import sqrt
from typing import Annotated, Any

import numpy as np
import scipy
from pydantic import Field

from simval.arrays import Array
from simval.calibrate import GyroscopeFit
from simval.figures import Figure, Headline, Quote
from simval.results import Outcome, Row, exact, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.statistics import (
    BIAS,
    CHI_SQUARE,
    COVARIANCE_OFF,
    COVERAGE,
    CRAMER_RAO,
    NEES,
    NO_BIAS,
    NORMAL,
    RECOVERY,
    REST_FORCE,
    ROUNDING,
    SCENE_BOUND,
    SD,
    SQUARED_ERROR,
)
from simval.streams import Streams
from simval.studies.drawn import drawn_rows
from simval.studies.gyroscope_tumble import ROWS, Estimator, Tumble
from simval.studies.refusing import refusing
from simval.studies.response import apart
from simval.studies.study import Cost, StudyParameters
from simval.units import PPM

TITLE = "Gyroscope: do the error bars of a calibration between rests hold?"
SECTION = "gyroscope"

BLOCK = 8  # trials; part of the promise of equal bits
FINE = 100
"""Segments of a move beside which a stated covariance is held, extrapolated with half
as many."""
LEFT_OUT = 2e-5
"""Of a covariance in deviations, by the square of the rows to a reading: 7e-6, 1.3e-4
and 7.8e-4 were seen with 1, 5 and 10 (`tests/studies/test_foundations.py`)."""
RELATIVE = 5e-3
"""Of a variance or a NEES: the bound's segments, and the covariance that is taken at a
noisy estimate, which moves it by some 1e-3."""
SMALL_BIAS = 0.01
"""Standard deviations: 0.0017 of second order at 40 poses, 0.003 of the fourth order of
a step at 100 Hz."""
ENOUGH = 1024  # trials, from which a bias of a fifth of a standard deviation is seen
LEVEL = 0.95
THINNED = {f"{ROWS / k:g} Hz": k for k in (1, 2, 5, 10)}
"""Rows of 500 Hz to a reading, for the order of an integrator, by the rate's name."""
AVERAGES, STRAIGHT = "averages", "straight lines"
NAMES = (*(f"M_{a}{b}" for a in "xyz" for b in "xyz"), "B_x", "B_y", "B_z")
UNITS = ("1",) * 9 + ("rad/s",) * 3


class Parameters(StudyParameters):
    """One cell: an estimator, poses, moves, rate of the rows and noise."""

    estimator: Estimator = Field(
        default="joint", description="Both sensors together, one by one, or IMU-TK's."
    )
    poses: Annotated[int, Field(ge=12, le=100)] = Field(
        default=40, description="Poses, spread evenly over the sphere."
    )
    move_time: Annotated[float, Field(ge=1.5, le=10.0)] = Field(
        default=2.0, description="Time of a move, s."
    )
    every: Annotated[int, Field(ge=1, le=10)] = Field(
        default=5, description="Rows of 500 Hz that one reading averages."
    )
    angle_random_walk: Annotated[float, Field(ge=1e-6, le=0.3)] = Field(
        default=0.01, description="White noise, degrees/s per root hertz."
    )
    trials: Annotated[int, Field(ge=256)] = Field(
        default=1024, description="Trials; rounded up to whole blocks of 8."
    )

    def cost(self) -> Cost:
        """Cost of a cell: the scene, and a fit for each trial."""
        rows = self.poses * (self.move_time + 1.6) * 5.0 / self.every
        return Cost(1.0 + 7e-5 * rows * self.trials, 20)


@refusing("lower `angle_random_walk` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    data = Tumble(parameters)
    blocks = -(-parameters.trials // BLOCK)
    found, noise = [], []
    for i in range(blocks):
        readings = data.readings(streams.block(i), BLOCK)
        found.append(data.fitted(*readings))
        noise.append(data.drawn(*readings))
    error = np.concatenate([fit.parameters for fit in found]) - data.truth
    C = np.concatenate([fit.own_covariance for fit in found])
    free = 9 if parameters.estimator == "unweighted" else 12
    error, C = error[:, :free], C[:, :free, :free]
    bound = np.diagonal(data.bound())[:free]
    rows = _judged(error, C, bound, parameters.estimator != "unweighted")
    clean = data.trial(np.random.default_rng(0), 1, noise=0.0)
    off = float(np.abs(clean.M[0] - data.gyroscope.M).max())
    # of fourth order in the step; chunks of two leave another 1e-8
    most = 1e-8 + 1e-9 * parameters.every**4
    return Outcome(
        rows=(
            *rows,
            *limit(RECOVERY("M"), off, most, ROUNDING),
            *limit(REST_FORCE(), data.off, data.rest_force, SCENE_BOUND),
            *drawn_rows(noise),
            *_stated_row(clean, data, free),
            *_integrators(parameters),
            *unjudged(SD("M", "bound"), sqrt(bound[:9].mean())),
        )
    )


def _stated_row(clean: GyroscopeFit, data: Tumble, free: int) -> tuple[Row, ...]:
    """The covariance that is stated at the truth, beside the bound of short pieces."""
    if free < 12:  # the unweighted way does not reach the bound
        return ()
    coarse, fine = (data.bound(pieces) for pieces in (FINE // 2, FINE))
    bound = (4.0 * fine - coarse) / 3.0  # of the second order of a piece
    off = apart(clean.own_covariance[0], bound)
    left = LEFT_OUT * data.parameters.every**2
    return exact(COVARIANCE_OFF("stated"), off, 0.0, CRAMER_RAO, left)


def _integrators(parameters: Parameters) -> tuple[Row, ...]:
    """Error of M without noise, by rate of the rows and what is between them."""
    rows: list[Row] = []
    for rate, every in THINNED.items():
        data = Tumble(parameters.model_copy(update={"every": every}))
        clean = data.trial(np.random.default_rng(0), 1, noise=0.0)
        averages = float(np.abs(clean.M[0] - data.gyroscope.M).max())
        rows += unjudged(
            (RECOVERY("M", AVERAGES, rate), RECOVERY("M", STRAIGHT, rate)),
            (averages, data.straight_lines()),
        )
    return tuple(rows)


def _judged(
    error: Float[Array, "t p"],
    C: Float[Array, "t p p"],
    bound: Float[Array, " p"],
    efficient: bool,
) -> tuple[Row, ...]:
    n, p = error.shape
    sd = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    squares = np.vecdot(error, np.linalg.solve(C, error[..., None])[..., 0])
    z = -scipy.special.ndtri((1.0 - LEVEL) / 2.0)
    covered = (np.abs(error) < z * sd).mean(axis=1)
    over = (error**2 / bound).mean(axis=1)

    def mean(values: Array) -> tuple[float, float, int]:
        return float(values.mean()), float(values.std(ddof=1)) / sqrt(n), n

    several = tuple(error.mean(axis=0)), tuple(error.std(axis=0, ddof=1) / sqrt(n)), n
    small = tuple(SMALL_BIAS * sd.mean(axis=0))
    judge: Any = plain if efficient else unjudged
    shift: Any = plain if n >= ENOUGH else unjudged
    return (
        *nees(NEES(), *mean(squares), float(p), CHI_SQUARE, RELATIVE * p),
        *plain(COVERAGE("mean"), *mean(covered), LEVEL, NORMAL, 0.23 * RELATIVE / 2.0),
        *judge(SQUARED_ERROR("mean"), *mean(over), 1.0, CRAMER_RAO, RELATIVE),
        *shift(BIAS.each(NAMES[:p], UNITS[:p]), *several, 0.0, NO_BIAS, small),
    )


KINDS = {
    STRAIGHT: "straight lines between samples",
    AVERAGES: "averages with their coning",
    "bound": "noise alone",
}
THINNED_ROWS = [RECOVERY("M", kind, rate) for kind in KINDS for rate in THINNED]


def _kind(row: Row) -> str:
    return KINDS[row.statistic.entries[1]]


FIGURES = (
    Figure(
        name="gyroscope",
        asked="How fast must a gyroscope be read for its calibration?",
        says="Error of M over these rates: {each}.",
        about=[*THINNED_ROWS, SD("M", "bound")],
        rows=THINNED_ROWS,
        along=lambda row: ROWS / THINNED[row.statistic.entries[2]],
        axis="rows per second, Hz",
        lines=_kind,
        value="error of M",
        unit=PPM,
        compared=False,
        floor=SD("M", "bound"),
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
        "over": Quote(of=SQUARED_ERROR("mean"), by=CRAMER_RAO, root=True),
        "M": Quote(of=SD("M", "bound"), unit=PPM),
    },
)
