r"""Magnetometer: its calibration against the bound, and coverage of its error bars.

A set of random attitudes is drawn once for each number of poses, so that predictions
involve no chance. Each trial adds fresh noise to the pose means of both sensors and
calibrates twice: by the weighted fit of all 22 parameters, and in two steps, an
ellipsoid for each sensor and then the turn between them. Errors are estimate minus
truth, against the bound, the second-order bias, and the two steps' own covariance
(`simval.theory.magnetometer`).

Coverage and normalised square are those of errors about the bias
(`simval.theory.coverage`). Where the noisier sensor bends a combination of parameters
that the other one fixes, theory's law of all of them ends (`magnetometer.RANGE`).

The same trials are averaged once more with the linear part c of the errors as a control
variate (`simval.studies.response`): its square under its own inverse covariance is
chi-square, the events that it lies within its intervals and its ellipsoid have the
stated rate. The sum of squares of the residuals is, to first order, that of the white
equations less that of the parameters,

.. math:: \chi^2 \approx |Ex|^2 - c^T (JJ^T)^{-1} c,

whose mean is 3 n - 22, whatever J is. One noise-free set in each cell must recover the
truth to `RECOVERED`; the bound (M2) and the bias, (E2) of `estimating`, must meet how
the estimate answers its readings (R2), and the covariance that the fit states must
meet the bound.
"""

from collections.abc import Iterator
from math import radians
from typing import Any

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Headline, Quote
from simval.geometry import attitude_matrix, random_quaternions
from simval.imu.calibrate import (
    MagnetometerFit,
    Recording,
    ellipsoid_then_rotation,
    fit,
)
from simval.imu.sensor import MagnetometerModel
from simval.moments import deviations
from simval.results import (
    Outcome,
    Row,
    Rows,
    beyond,
    exact,
    limit,
    nees,
    plain,
    unjudged,
)
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import G, true_sensor
from simval.studies.response import (
    MET,
    STEP,
    Expanded,
    Reduced,
    apart,
    beside,
    linearized,
    reduced_mean,
    reduced_share,
    response,
)
from simval.studies.study import Cost, StudyParameters, ranged, refusing
from simval.studies.trials import (
    Block,
    Trials,
    correlation_row,
    mean_of,
    noise_row,
    root,
    share_error,
    stated_of,
    trials_of,
)
from simval.theory.coverage import bias_square, ellipsoid_coverage, interval_coverage
from simval.theory.magnetometer import (
    RANGE,
    SQUARE_NEXT,
    MagnetometerMoments,
    magnetometer_moments,
)
from simval.units import PERCENT

TITLE = "Magnetometer: all 22 parameters at the bound, and the two-step calibration"
SECTION = "magnetometer"

BLOCK = 128  # trials; part of the promise of equal bits
LEVEL = 0.95
ALL = 22
RECOVERED = 1e-9
"""Relative; of 1000 random sensors the worst was off by 3e-15."""
MOST_POSES = 20
"""Poses: more tell nothing new of a formula."""
UNLIKE = 100.0
"""Ratio of the sensors' noise up to which differences are taken: beyond, a step of the
noisy one is thousands of deviations of the other."""
MET_COVARIANCE = 100.0 * MET
"""Up to a dip of 85 degrees 6e-7 was the worst seen."""
LOUD = 3e-4
"""Relative noise that the fit is told of the noisier sensor: only the ratio of both
weighs a reading, and of a smaller one a step would be hundreds of deviations."""
MET_BIAS = MET
"""In deviations of `LOUD`: 5e-9 was the worst seen."""
PARTS = {
    "accelerometer": slice(0, 9),
    "M": slice(9, 18),
    "b": slice(18, 21),
    "dip": slice(21, 22),
}
NOISES = ("accelerometer_std", "magnetometer_std")
UNITS = ("1",) * 6 + ("m/s²",) * 3 + ("1",) * 12 + ("rad",)


class Parameters(StudyParameters):
    """One cell: poses, place and noise."""

    poses: int = ranged(40, "Random attitudes in which both sensors rest.", 12, 400)
    dip_deg: float = ranged(
        66.0, "Angle of the field below the horizon, degrees.", -85.0, 85.0
    )
    field_noise: float = ranged(
        0.005, "Noise of each axis of a mean, a share of the field.", 1e-5, 0.02
    )
    accelerometer_noise: float = ranged(
        1e-4, "Noise of each axis of a mean, a share of gravity.", 1e-5, 0.02
    )
    trials: int = ranged(4096, "Trials; rounded up to whole blocks of 128.", 8 * BLOCK)

    def cost(self) -> Cost:
        """Cost of a cell: both calibrations for each trial."""
        return Cost(0.2 + self.trials * (8e-5 + 1.2e-5 * self.poses), 102)


def true_magnetometer() -> MagnetometerModel:
    """The magnetometer that is to be recovered: x and y changed, z turned, field 1."""
    matrix = np.array([[0.04, 0.97, 0.05], [1.06, -0.03, 0.02], [-0.04, 0.06, -1.02]])
    return MagnetometerModel(M=matrix, b=np.array([0.25, -0.1, 0.15]))


class Scenario:
    """Both sensors at rest in some attitudes, with clean pose means and their noise."""

    def __init__(
        self, poses: int, dip_deg: float, accelerometer_noise: float, field_noise: float
    ) -> None:
        # always the same attitudes, so that predictions involve no chance
        self.attitudes = random_quaternions(poses, np.random.default_rng(poses))
        dip, turn = radians(dip_deg), attitude_matrix(self.attitudes)
        field = turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
        body, iron = self.sensors = true_sensor(0.0), true_magnetometer()
        quiet = np.random.default_rng(0)  # draws nothing: these sensors have no noise
        self.means = body.distort(G * turn[:, :, 2], quiet), iron.distort(field, quiet)
        self.std = G * accelerometer_noise, field_noise
        self.told: dict[str, Any] = dict(zip(NOISES, self.std, strict=True))
        self.truth = np.concatenate([body.parameters, iron.M.ravel(), iron.b, [dip]])
        self.size = 6 * poses  # numbers of a trial's noise

    def readings(
        self, x: Float[Array, "t d"]
    ) -> tuple[Float[Array, "t n 3"], Float[Array, "t n 3"]]:
        """Pose means with this noise, in standard deviations, pose by pose."""
        noise = x.reshape(len(x), 2, -1, 3)
        (body, iron), (first, second) = self.means, self.std
        return body + first * noise[:, 0], iron + second * noise[:, 1]

    def fitted(self, body: Array, iron: Array) -> MagnetometerFit:
        """Calibrate with the stated noise."""
        found = fit(
            Recording(
                poses=body,
                fields=iron,
                g=G,
                pose_std=self.std[0],
                field_std=self.std[1],
            )
        )
        return found.magnetometer

    def predicted(self) -> MagnetometerMoments:
        """Prediction of theory."""
        return magnetometer_moments(
            *self.sensors, self.attitudes, self.truth[-1], g=G, **self.told
        )

    def equations(self) -> Float[Array, "m d"]:
        """Whitened derivatives of the poses' equations by the noise.

        Those of |u|^2 = 1, |v|^2 = 1 and u'v = -sin(dip), u and v the corrected
        readings over their lengths: differentiated at the truth, and whitened.
        """
        (force, field), n = self.means, len(self.attitudes)
        body, iron = self.sensors[0].matrix / G, self.truth[9:18].reshape(3, 3)
        u = (force - self.truth[6:9]) @ body.T
        v = (field - self.truth[18:21]) @ iron.T
        slope = np.zeros((n, 3, 2, 3))
        slope[:, 0, 0], slope[:, 1, 1] = 2.0 * u @ body, 2.0 * v @ iron
        slope[:, 2, 0], slope[:, 2, 1] = v @ body, u @ iron
        flat = (slope * np.array(self.std)[:, None]).reshape(n, 3, 6)
        factor = np.linalg.cholesky(flat @ flat.mT)
        white = np.linalg.solve(factor, flat).reshape(n, 3, 2, 3)
        each = np.zeros((n, 3, 2, n, 3))
        each[np.arange(n), :, :, np.arange(n)] = white
        return each.reshape(3 * n, -1)


@refusing("lower the noise or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and compare it with theory."""
    noises = parameters.accelerometer_noise, parameters.field_noise
    case = Scenario(parameters.poses, parameters.dip_deg, *noises)
    predicted = case.predicted()

    def trial(rng: np.random.Generator) -> Block:
        noise = rng.standard_normal((2, BLOCK, case.size // 2)).transpose(1, 0, 2)
        noise = noise.reshape(BLOCK, -1)
        readings = case.readings(noise)
        fit = case.fitted(*readings).require_converged()
        inside, square = stated_of(fit, case.truth, LEVEL)
        kept = {
            "noise": noise,
            "error": fit.parameters - case.truth,
            "recipe": ellipsoid_then_rotation(*readings) - case.truth[9:],
            "inside": inside.astype(float),
            "square": square,
            "chi_square": fit.chi_square / fit.dof,
        }
        return kept, {}

    def errors(x: Float[Array, "t d"]) -> Float[Array, "t p"]:
        readings = case.readings(x)
        usual = ellipsoid_then_rotation(*readings) - case.truth[9:]
        fit = case.fitted(*readings)
        return np.concatenate([fit.parameters - case.truth, usual], axis=1)

    seen = trials_of(streams, parameters.trials, BLOCK, trial)
    both = linearized(errors, seen["noise"])
    fit, recipe = both.take(slice(0, ALL)), both.take(slice(ALL, None))
    measured = (
        *_moments(seen, fit, predicted),
        *_over_bound(seen, fit, recipe, predicted),
        *_stated(seen, fit, case.equations(), predicted),
    )
    rows = tuple(row for each, _ in measured for row in each)
    # noise of each sensor in each block
    vectors = seen["noise"].reshape(-1, BLOCK, 2, case.size // 2).swapaxes(1, 2)
    return Outcome(
        rows=(
            *_recovery(case),
            *noise_row(seen["noise"]),
            *rows,
            *beside(rows, [sharper for _, sharper in measured]),
            *correlation_row(vectors.reshape(-1, BLOCK * case.size // 2)),
            *stated_row(case, predicted),
            *response_rows(parameters.poses, parameters.dip_deg, *noises),
            *_spread_row(seen["error"], predicted),
        )
    )


Measured = Iterator[tuple[Rows, Reduced]]
"""Rows of some statistics, and the same with control variates."""


def _moments(seen: Trials, fit: Expanded, predicted: MagnetometerMoments) -> Measured:
    error = seen["error"]
    n, mean = len(error), error.mean(axis=0)
    off = error - mean
    sd, spread = root(
        np.sum(off * off, axis=0) / (n - 1), np.std(off * off, axis=0) / np.sqrt(n)
    )
    yield plain(
        stat.BIAS.each(predicted.names, UNITS), mean, sd / np.sqrt(n), n,
        predicted.bias, stat.SECOND_ORDER, predicted.bias_remainder,
    ), fit.mean(error)  # fmt: skip
    yield plain(
        stat.SD.each(predicted.names, UNITS), sd, spread, n,
        predicted.sd, stat.FIRST_ORDER,
        predicted.sd * (predicted.variance_remainder / 2.0),
    ), fit.sd(error)  # fmt: skip


def _over_bound(
    seen: Trials, fit: Expanded, recipe: Expanded, predicted: MagnetometerMoments
) -> Measured:
    """Mean square error over the bound, for the fit and for the two steps."""
    bound, left = np.diagonal(predicted.covariance), predicted.variance_remainder
    squares, square_bias = seen["error"] ** 2 / bound, predicted.bias**2 / bound
    off = predicted.bias_remainder
    of_bias = (2.0 * np.abs(predicted.bias) + off) * off / bound

    def sharper(known: Expanded, error: Array, part: slice, over: Array) -> Reduced:
        weight = np.diag(1.0 / over[part]) / len(over[part])
        return known.take(part).weighted_square(error[:, part], weight)

    for name, part in PARTS.items():
        mean = mean_of(squares[:, part].mean(axis=1))
        expected = 1.0 + square_bias[part].mean()
        rows = plain(
            stat.VARIANCE_OVER_BOUND(name), *mean, expected, stat.CRAMER_RAO,
            left + of_bias[part].mean(),
        )  # fmt: skip
        yield rows, sharper(fit, seen["error"], part, bound)
    # the two steps' bias is of second order as well, and not predicted: its variance is
    usual, bound = seen["recipe"], bound[9:]
    variance = np.diagonal(predicted.recipe)[9:] / bound
    centred = usual - recipe.mean(usual)[0]
    for name, whole in (*PARTS.items(),)[1:]:
        part = slice(whole.start - 9, whole.stop - 9)
        values = usual**2 / bound
        values = values[:, part] - np.mean(usual, axis=0)[part] ** 2 / bound[part]
        expected = variance[part].mean()
        yield plain(
            stat.VARIANCE_OVER_BOUND(name, "two-step"),
            *mean_of(values.mean(axis=1)), expected, stat.FIRST_ORDER,
            expected * predicted.recipe_remainder,
        ), sharper(recipe, centred, part, bound)  # fmt: skip


def _stated(
    seen: Trials, fit: Expanded, equations: Array, predicted: MagnetometerMoments
) -> Measured:
    """Coverage of stated intervals and ellipsoid, and residuals."""
    n, inside, squares = len(seen["square"]), seen["inside"], seen["square"]
    out = (
        f"the second order adds {predicted.bent:.2g} to the normalised square of all "
        f"errors; the laws of all together hold up to {RANGE:g}"
        if predicted.bent > RANGE
        else ""
    )
    quantile = 2.0 * scipy.special.gammaincinv(ALL / 2.0, LEVEL)
    relative, left = predicted.variance_remainder / 2.0, predicted.bias_remainder
    within, may = interval_coverage(
        LEVEL, predicted.bias / predicted.sd, left / predicted.sd, relative
    )
    shift, off = bias_square(predicted.bias, left, predicted.covariance)
    off += SQUARE_NEXT * predicted.bent
    whole, all_may = ellipsoid_coverage(LEVEL, ALL, shift, off, relative)
    # of the linear part: in its deviations, and normalised
    sd = deviations(fit.covariance)
    ratio = fit.first / sd
    unit = fit.covariance / np.outer(sd, sd)
    square = np.vecdot(ratio, np.linalg.solve(unit, ratio.T).T)
    z = -scipy.special.ndtri((1.0 - LEVEL) / 2.0)
    yield plain(
        stat.COVERAGE.each(predicted.names), inside.mean(axis=0),
        share_error(within, n), n, within, stat.NORMAL, may,
    ), reduced_share(inside > 0.5, np.abs(ratio) <= z, LEVEL)  # fmt: skip
    yield beyond(plain(
        stat.COVERAGE("ellipsoid"), np.mean(squares <= quantile),
        share_error(whole, n), n, whole, stat.CHI_SQUARE, all_may,
    ), out), reduced_share(squares <= quantile, square <= quantile, LEVEL)  # fmt: skip
    yield beyond(nees(
        stat.NEES(), squares.mean(), np.std(squares) / np.sqrt(n), n,
        ALL + shift, stat.CHI_SQUARE, (ALL + shift) * 2.0 * relative + off,
    ), out), reduced_mean(squares, square, ALL)  # fmt: skip
    white = np.sum((seen["noise"] @ equations.T) ** 2, axis=1)
    linear = (white - square) / (len(equations) - ALL)
    yield plain(
        stat.CHI_SQUARE_OF_FREEDOM(), *mean_of(seen["chi_square"]),
        1.0, stat.CHI_SQUARE, 2.0 * relative,
    ), reduced_mean(seen["chi_square"], linear, 1.0)  # fmt: skip


def _spread_row(error: Float[Array, "t 22"], predicted: MagnetometerMoments) -> Rows:
    """Standard deviation of M, RMS over its entries."""
    part, n = PARTS["M"], len(error)
    squares = np.mean((error - error.mean(axis=0))[:, part] ** 2, axis=1)
    found = root(n / (n - 1) * squares.mean(), np.std(squares) / np.sqrt(n))
    expected = np.sqrt(np.mean(predicted.sd[part] ** 2))
    left = expected * predicted.variance_remainder / 2.0
    return unjudged(stat.SPREAD("M"), *found, n, expected, stat.FIRST_ORDER, left)


def _recovery(case: Scenario) -> Rows:
    error = np.abs(case.fitted(*case.means).parameters - case.truth)
    sizes = [np.abs(case.truth[PARTS[name]]).max() for name in (*PARTS,)[:-1]]
    relative = [
        error[part].max() / size
        for part, size in zip(PARTS.values(), (*sizes, 1.0), strict=True)  # dip: rad
    ]
    return limit(stat.RECOVERY.each(PARTS), relative, RECOVERED, stat.TRUTH, n=1)


def stated_row(case: Scenario, predicted: MagnetometerMoments) -> Rows:
    """Covariance that the fit states at the truth, against the bound."""
    off = apart(case.fitted(*case.means).covariance, predicted.covariance)
    return exact(stat.COVARIANCE_OFF("stated"), off, 0.0, stat.CRAMER_RAO, MET)


def response_rows(
    poses: int, dip_deg: float, accelerometer_noise: float, field_noise: float
) -> Rows:
    """Rows that test theory against the estimate's response to noise."""
    noise = np.array([accelerometer_noise, field_noise]) / LOUD
    if noise.max() > UNLIKE * noise.min():
        return ()
    case = Scenario(min(poses, MOST_POSES), dip_deg, *(noise / noise.max() * LOUD))
    unit = np.ones(case.size)
    # a step is `STEP` of the size of the noisier sensor's reading
    found = response(
        lambda x: case.fitted(*case.readings(x)).parameters, 0.0 * unit, STEP / LOUD
    )
    predicted = case.predicted()
    off = apart(predicted.covariance, found.covariance(unit))
    bias = np.abs(predicted.bias - found.bias(unit)) / predicted.sd
    return (
        *exact(
            stat.COVARIANCE_OFF("predicted"), off, 0.0, stat.RESPONSE, MET_COVARIANCE
        ),
        *exact(stat.BIAS_OFF("predicted"), bias.max(), 0.0, stat.RESPONSE, MET_BIAS),
    )


WORDS = {"M": "matrix M", "b": "hard iron b", "two-step": "two steps"}


def _called(row: Row) -> str:
    return ", ".join(WORDS.get(each, each) for each in row.statistic.entries)


FIGURES = (
    Figure(
        name="magnetometer",
        asked="Does the weighted fit reach the bound, and what do two steps cost?",
        what="The variance",
        says="The variance is at most {most} times the bound ({most_of}).",
        rows=[stat.VARIANCE_OVER_BOUND],
        lines=_called,
        value="variance over the bound",
        columns=2,
        caption=(
            "Variance over the Cramér-Rao bound, mean over the entries of a matrix or "
            "vector: the weighted fit of all 22 parameters, which reaches 1, and the "
            "usual two steps, an ellipsoid for each sensor and then the rotation "
            "between them."
        ),
    ),
)
HEADLINE = Headline(
    says="M {M}, dip {dip}; {over} × the bound",
    quotes={
        "M": Quote(of=stat.SPREAD("M"), by=stat.FIRST_ORDER, unit=PERCENT),
        "dip": Quote(of=stat.SD("dip"), by=stat.FIRST_ORDER, angle=True),
        "over": Quote(of=stat.VARIANCE_OVER_BOUND("M"), by=stat.CRAMER_RAO, root=True),
    },
)
