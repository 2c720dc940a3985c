r"""A user-supplied calibrator: its errors, set beside the Cramer-Rao bound.

The plug-in's conventions are probed without noise first. Then each trial reads a known
sensor in poses spread over the sphere, or in the six faces of a cube, with noise on
each mean, and calibrates; the error is estimate minus truth in the nine parameters of
the triangular form, to which every answer is brought: norms fix no more. What the
calibration leaves of the specific force, over all directions, is set beside the least
that an unbiased one leaves (`left`).

A calibrator may estimate fewer parameters and is then measured by them. Of its own
class the sensor has no other errors, and all is as with nine. Of the full sensor, whose
misalignment (and scale) is outside the class, the truth is what the class converges to
without noise. `simval.theory.calibration_classes` knows it for each of the criteria by
which one may fit, and the noise-free answer may be in the middle of these or off it by
their range (`settled`); the mean of the trials must be the noise-free answer. Its
covariance is not judged, for it says nothing of what is left out. What it leaves stands
beside the least that its class can leave, and beside the bound of nine parameters.

The plug-in's bias is not predicted. Every residual of the theory is biased by at most
3.5 :math:`\sigma^2/g^2` in scale, so a scale and a misalignment are each allowed
`BIAS_ALLOWED` :math:`\sigma^2/g^2`, and a bias `BIAS_ALLOWED` :math:`\sigma^2/g` of raw
units; a greater one fails. Where it gives a covariance, the mean normalised square must
be 9, up to the square of that bias and the remainder that theory states for a variance.
A covariance of ``type A``, from residuals with :math:`\nu` degrees of freedom (`dof`),
makes it :math:`9 F(9, \nu)` instead of chi-square, with the mean
:math:`9\nu/(\nu - 2)`; it is multiplied by :math:`(\nu - 2)/\nu` before it is judged,
and `FREEDOM` more is allowed. The spread is set beside the bound and kept for the
baseline.

A command is a process for each trial, so its time limit is for every `CALLS` of them;
in a batch the limit is for all trials.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from math import ceil
from typing import Annotated, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from simval.arrays import Array
from simval.errors import PluginError
from simval.moments import Moments
from simval.montecarlo import Sums, mean_square, moments_of, simulate
from simval.plugins import Calibrator, find_plugin, probe_calibrator
from simval.plugins.answers import Calibration, calibration_of, calibrations_of
from simval.plugins.names import COMMAND
from simval.plugins.probe import TOLERANCE, G, probe_sensor
from simval.plugins.programs import in_batch
from simval.plugins.runs import Places, require_no_memory
from simval.poses import cube_faces, fibonacci_sphere
from simval.results import Outcome, Row, limit, nees, plain, unjudged
from simval.sensor import AccelerometerModel, forms
from simval.sensor.models import ALL, mean_square_left, own_sensor, places_of
from simval.shapes import Float
from simval.statistics import (
    BELOW_BOUND,
    BEST_OF_CLASS,
    BIAS,
    CLAIM,
    CRAMER_RAO,
    EFFICIENCY,
    GREATEST_ERROR,
    LEFT,
    NEES,
    NINE_PARAMETERS,
    NO_BIAS,
    NOISE_FREE,
    NORMAL,
    PROBE,
    PSEUDO_TRUE,
    SD,
    SETTLED,
    TRUTH,
)
from simval.streams import Streams
from simval.studies.coverage import FREEDOM
from simval.studies.plugin import PluginName, PluginParameters, isolated
from simval.studies.refusing import LEAST_NOISE
from simval.theory.calibration import VARIANCE_NEXT, calibration_moments
from simval.theory.calibration_classes import (
    bound_left,
    class_bound,
    least_left,
    pseudo_true,
)

FACES = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """Theory of one cell."""

    places: tuple[int, ...]  # of what is estimated among the nine parameters
    own: bool  # whether the sensor has these errors alone
    # error of what it converges to: the middle of all criteria; 0 in its own class
    bias: Float[Array, " p"]
    spread: Float[Array, " p"]  # range of the criteria
    bound: Float[Array, "p p"]  # Cramer-Rao, in its own class
    bound_left: float  # RMS left at that bound, m/s^2
    all_left: float | None  # RMS left at the bound of all nine, where poses show them
    least: float  # RMS left by the best of the class without noise, m/s^2
    variance_off: float  # remainder of a variance, relative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """What is the same in every trial of a cell."""

    plugin: Calibrator
    sensor: AccelerometerModel
    directions: Float[Array, "n 3"]
    faces: bool  # whether they are those of a cube, and so known
    noise: float  # of an axis of a pose mean, raw units
    theory: Expected

    @property
    def own(self) -> bool:
        """Whether the sensor has no errors but those that are estimated."""
        return self.theory.own

    @property
    def named(self) -> tuple[list[str], list[str]]:
        """Names and units of what is estimated."""
        places, names = self.theory.places, forms.names("triangular")
        return [names[k] for k in places], [("1", "raw")[k >= 6] for k in places]

    @property
    def sizes(self) -> Float[Array, " p"]:
        """Natural sizes of what is estimated."""
        sizes = np.abs(self.sensor.parameters)
        sizes[:3] = 1.0
        sizes[6:] = G / np.abs(self.sensor.K).min()
        return sizes[list(self.theory.places)]


def setting_of(
    plugin: Calibrator, *, faces: bool, poses: int, own_class: bool, noise_std: float
) -> Setting:
    """Sensor, poses and theory of a cell."""
    directions = fibonacci_sphere(poses)
    if faces:
        directions = np.tile(cube_faces(), (poses // FACES, 1))
    if faces and plugin.estimates == ALL:
        msg = (
            f"{plugin.name} estimates nine parameters, of which six faces of a cube "
            'show six; use pose_set = "sphere", or declare in `estimates` what it '
            "estimates"
        )
        raise PluginError(msg)
    sensor = probe_sensor(plugin.estimates)
    if own_class:
        sensor = own_sensor(sensor, plugin.estimates)
    scale = float(np.abs(np.linalg.inv(sensor.matrix)).max())
    noise = noise_std * scale
    return Setting(
        plugin=plugin,
        sensor=sensor,
        directions=directions,
        faces=faces,
        noise=noise,
        theory=expected(
            sensor, directions, plugin.estimates, g=G, noise_std=noise, known=faces
        ),
    )


def expected(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    estimates: tuple[str, ...],
    *,
    g: float,
    noise_std: float,
    known: bool,
) -> Expected:
    """Work out the theory of one cell."""
    places, poses = places_of(estimates), (sensor, directions)
    inside = own_sensor(sensor, estimates)
    own = estimates == ALL or np.array_equal(inside.parameters, sensor.parameters)
    bias = spread = np.zeros(len(places))
    if not own:
        found = pseudo_true(*poses, places, g=g, known=known)
        off = (found - sensor.parameters)[:, list(places)]
        bias = (off.max(axis=0) + off.min(axis=0)) / 2.0
        spread = np.ptp(off, axis=0)
    if estimates == ALL:
        moments = calibration_moments(*poses, g=g, noise_std=noise_std)
        bound, remainder = moments.cramer_rao, moments.variance_remainder
    else:
        bound = class_bound(
            inside, directions, places, g=g, noise_std=noise_std, known=known
        )
        remainder = VARIANCE_NEXT * _relative(inside, g, noise_std)
    return Expected(
        places=places,
        own=own,
        bias=bias,
        spread=spread,
        bound=bound,
        bound_left=bound_left(inside, bound, places, g),
        all_left=None if known else _all_left(*poses, g, noise_std),
        least=least_left(sensor, places, g),
        variance_off=remainder + FREEDOM,
    )


def _relative(sensor: AccelerometerModel, g: float, noise_std: float) -> float:
    """Squared relative noise of the worst axis, as in eq. (K4)."""
    scale = np.linalg.norm(sensor.matrix, axis=1).max()
    return float((noise_std * scale / g) ** 2)


def _all_left(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    noise_std: float,
) -> float:
    """RMS left at the bound of nine parameters."""
    bound = calibration_moments(sensor, directions, g=g, noise_std=noise_std).cramer_rao
    return bound_left(sensor, bound, places_of(ALL), g)


TITLE = "User-supplied calibrator: bias, spread and stated covariance"
SECTION = "algorithms"

BLOCK = 16  # trials; part of the promise of equal bits
BIAS_ALLOWED = 7.0
"""Twice the greatest bias of the ladder's residuals, 3.5."""
CALLS = 64
"""Trials of a command for which the time limit is."""
AGAIN = 4
"""Blocks whose trials are asked again in another order."""
SQUARE_APART = 0.01
"""By which a normalised square may then differ, relative to it and 1: an error of a
thousandth of its deviation and the tolerance of the probe are no more."""
ALIKE = 3.0
"""By how much less far from the proportions of the bound a covariance must be in
another order: one that is efficient is 5 to 40 times farther off in a wrong one."""
RARE = 1e-6
"""Of cells with normal errors so many have one beyond the limit."""
STILL = 1e-6
"""Spread of a parameter over that of the readings, relative to its size, below which it
is not estimated: a mean of as many readings as there are in a cell has 1e-3."""
AROUND = 120.0
"""Seconds for what is around a batch: loading, one probe, files."""
AT_ONCE = 1 << 20
"""Readings of an axis that are handed over at once: files of 20 MB, 14 000 trials of 24
poses."""


class Parameters(PluginParameters):
    """One cell: a plug-in, poses, a sensor and a noise level."""

    plugin = "algorithm"
    no_noise = ("algorithm", "time_limit")

    algorithm: PluginName = Field(
        default="",
        description="FILE.py, FILE.py:NAME, an entry point, or command: PROGRAM.",
    )
    poses: Annotated[int, Field(ge=FACES, le=400)] = Field(
        default=24, description="Poses of a trial: 9 or more, of faces a multiple of 6."
    )
    pose_set: Literal["sphere", "faces"] = Field(
        default="sphere",
        description="Poses spread evenly over the sphere, or the six faces of a cube "
        "in turn: +x, +y, +z, -x, -y, -z.",
    )
    sensor: Literal["full", "own class"] = Field(
        default="full",
        description="Sensor with all nine errors, or with those alone that the "
        "calibrator estimates.",
    )
    noise_std: Annotated[float, Field(ge=LEAST_NOISE, le=1.0)] = Field(
        default=0.01, description="Noise per axis of a pose mean, m/s^2."
    )
    trials: Annotated[int, Field(ge=2 * BLOCK)] = Field(
        default=1024, description="Trials; rounded up to whole blocks of 16."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        default=300.0,
        description="Wall time after which the cell fails, s; of a command for every "
        "64 trials, of one that takes all trials at once for all.",
    )

    @model_validator(mode="after")
    def _poses_of_the_set(self) -> Self:
        least = 9 if self.pose_set == "sphere" else FACES
        if self.poses < least or (self.pose_set == "faces" and self.poses % FACES):
            msg = (
                f"`poses` is {self.poses}; of the sphere there must be 9 or more, of "
                'pose_set = "faces" a multiple of 6'
            )
            raise ValueError(msg)
        return self


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in a child process."""
    limit = parameters.time_limit
    if in_batch(parameters.algorithm):
        limit += AROUND
    elif _alone(parameters.algorithm):
        limit *= ceil(parameters.trials / CALLS)
    return isolated(outcome, parameters, streams, limit, Calibrator)


def _alone(algorithm: str) -> bool:
    """Whether each trial has a process of its own, which remembers nothing."""
    return algorithm.startswith(COMMAND) and not in_batch(algorithm)


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in this process."""
    return outcome(find_plugin(parameters.algorithm, Calibrator), parameters, streams)


def outcome(plugin: Calibrator, parameters: Parameters, streams: Streams) -> Outcome:
    """Measure a calibrator that this process holds."""
    setting = setting_of(
        plugin,
        faces=parameters.pose_set == "faces",
        poses=parameters.poses,
        own_class=parameters.sensor == "own class",
        noise_std=parameters.noise_std,
    )
    off = probe_calibrator(plugin, setting.directions if setting.faces else None)
    settled = _settled(setting)
    blocks = range(ceil(parameters.trials / BLOCK))
    every = _errors(setting, parameters, streams, blocks)
    if every.shape[1] > len(setting.theory.places) + 1:
        _require_order(setting)
    parts = iter(every.reshape(len(blocks), BLOCK, -1))
    sums = simulate(
        lambda rng, count: next(parts).T, streams,
        samples=parameters.trials, block=BLOCK, batch=1,
    )  # fmt: skip
    measured = moments_of(sums)
    relative = (parameters.noise_std / G) ** 2
    _require_spread(measured, setting, np.sqrt(relative))
    if not _alone(parameters.algorithm):
        _require_no_memory(setting, parameters, streams, every)
    rows = limit(PROBE(), off, TOLERANCE, TRUTH, n=1)
    if not setting.own:
        rows += _settled_rows(settled, setting)
    rows += _parameter_rows(measured, setting, settled, relative)
    rows += _left_rows(measured, setting)
    rows += _extreme_rows(sums, every, setting, relative)
    if sums.size == len(setting.theory.places) + 2:
        rows += _nees_row(measured, setting)
    return Outcome(rows=tuple(rows))


def _errors(
    setting: Setting,
    parameters: Parameters,
    streams: Streams,
    blocks: Sequence[int],
    order: Places | None = None,
) -> Float[Array, "n p"]:
    """Errors of all trials of some blocks, asked in their own or another order.

    Readings are handed over many blocks at once.
    """
    clean = setting.sensor.distort(G * setting.directions, np.random.default_rng(0))
    most, found = max(1, AT_ONCE // (BLOCK * clean.size)), []
    if order is not None:  # of few
        most = len(blocks)
    for first in range(0, len(blocks), most):
        noise = [
            streams.block(k).standard_normal((BLOCK, *clean.shape))
            for k in blocks[first : first + most]
        ]
        raw = clean + setting.noise * np.concatenate(noise)
        answers = calibrations_of(
            setting.plugin,
            raw if order is None else raw[order],
            G,
            setting.noise,
            parameters.time_limit,
        )
        found += [_error(setting, answer) for answer in answers]
    return np.array(found)


def _require_no_memory(
    setting: Setting,
    parameters: Parameters,
    streams: Streams,
    every: Float[Array, "n p"],
) -> None:
    """Check that some trials have the same errors in another order."""
    last = len(every) // BLOCK - 1
    blocks = np.unique(np.linspace(0, last, AGAIN).astype(int)).tolist()
    first = np.concatenate([every[k * BLOCK :][:BLOCK] for k in blocks])
    p = len(setting.theory.places)
    allowed = np.full(first.shape, np.inf)
    allowed[:, :p] = TOLERANCE * setting.sizes
    allowed[:, p + 1 :] = SQUARE_APART * (1.0 + first[:, p + 1 :])
    require_no_memory(
        setting.plugin.name,
        first,
        lambda places: _errors(setting, parameters, streams, blocks, places),
        allowed,
    )


def _settled(setting: Setting) -> Float[Array, " p"]:
    """Error that is left without noise; none in its own class."""
    p = len(setting.theory.places)
    if setting.own:
        return np.zeros(p)
    clean = setting.sensor.distort(G * setting.directions, np.random.default_rng(0))
    answer = calibration_of(setting.plugin, clean, G, setting.noise)
    return _error(setting, answer)[:p]


def _error(setting: Setting, answer: Calibration) -> Float[Array, " p"]:
    """Error of the parameters, what is left and, with a covariance, the square."""
    places, form = list(setting.theory.places), setting.plugin.form
    error = (answer.parameters("triangular") - setting.sensor.parameters)[places]
    left = mean_square_left(answer.matrix, answer.bias, setting.sensor, G)
    if answer.covariance is None:
        return np.append(error, left)
    own = error
    if form != "triangular":
        M = setting.sensor.matrix
        truth = forms.from_gram(form, M.T @ M, setting.sensor.B)
        own = answer.parameters(form) - truth
    square = own @ np.linalg.solve(answer.covariance, own)
    # its own mean over the one that a Type A covariance gives it
    factor = 1.0 if answer.dof is None else (answer.dof - 2) / answer.dof
    return np.append(error, [left, square * factor])


def _require_order(setting: Setting) -> None:
    """Refuse a covariance whose parameters stand in another order than theirs.

    Whatever its size, it has the proportions of the bound in another order, and is off
    them `ALIKE` times as far in this one.
    """
    plugin, theory = setting.plugin, setting.theory
    clean = setting.sensor.distort(G * setting.directions, np.random.default_rng(0))
    covariance = calibration_of(plugin, clean, G, setting.noise).covariance
    assert covariance is not None
    bound, names, p = theory.bound, setting.named[0], len(theory.places)
    if plugin.form != "triangular":
        own, form = setting.sensor.parameters, plugin.form
        there, _ = forms.convert(own, None, source="triangular", target=form)
        J = forms.conversion_jacobian(own, there, source="triangular", target=form)
        bound, names = J @ bound @ J.T, list(forms.names(form))
    root = np.linalg.cholesky(bound)
    spread = {}
    for blocks in permutations(np.arange(p).reshape(-1, 3)):
        order = np.concatenate(blocks)
        back = np.argsort(order)  # where each parameter stands in that order
        half = np.linalg.solve(root, covariance[np.ix_(back, back)])
        ratios = np.linalg.eigvalsh(np.linalg.solve(root, half.T))
        spread[tuple(order.tolist())] = float(ratios[-1] / ratios[0])
    fitting = min(spread, key=lambda order: spread[order])
    if ALIKE * spread[fitting] < spread[tuple(range(p))]:
        msg = (
            f"the covariance of {plugin.name} is in another order than its parameters: "
            f"it fits {', '.join(names[k] for k in fitting)}, and must be of "
            f"{', '.join(names)}"
        )
        raise PluginError(msg)


def _require_spread(measured: Moments, setting: Setting, relative: float) -> None:
    """Refuse what does not estimate a parameter: it never varies as the noise does."""
    names, _ = setting.named
    still = ~(measured.sd[: len(names)] > STILL * relative * setting.sizes)
    if still.any():
        msg = (
            f"{setting.plugin.name} gives the same {names[int(still.argmax())]} in all "
            f"{measured.samples} trials, whatever their noise; it must estimate what "
            "it declares from the readings, or leave it out of `estimates`"
        )
        raise PluginError(msg)


def _settled_rows(settled: Float[Array, " p"], setting: Setting) -> tuple[Row, ...]:
    """Rows of the answer without noise, of a sensor outside the class."""
    theory, (names, units) = setting.theory, setting.named
    most = theory.spread + TOLERANCE * setting.sizes
    off = np.abs(settled - theory.bias)
    return limit(SETTLED.each(names, units), off, most, PSEUDO_TRUE, n=1)


def _parameter_rows(
    measured: Moments, setting: Setting, settled: Float[Array, " p"], relative: float
) -> tuple[Row, ...]:
    theory, n, (names, units) = setting.theory, measured.samples, setting.named
    p = len(names)
    allowed = BIAS_ALLOWED * relative * setting.sizes
    sd = measured.sd[:p]
    variance_error = np.diagonal(measured.covariance_error)[:p]
    rows = plain(
        BIAS.each(names, units), measured.bias[:p], measured.bias_error[:p], n,
        settled, NO_BIAS if setting.own else NOISE_FREE, allowed,
    )  # fmt: skip
    if not setting.own:
        return rows + unjudged(SD.each(names, units), sd, variance_error / (2 * sd), n)
    bound = np.sqrt(np.diagonal(theory.bound))
    efficiency = (bound / sd) ** 2
    return (
        *rows,
        *unjudged(
            SD.each(names, units), sd, variance_error / (2 * sd), n,
            bound, CRAMER_RAO,
        ),
        *unjudged(
            EFFICIENCY.each(names), efficiency,
            efficiency * variance_error / sd**2, n,
        ),
    )  # fmt: skip


def _left_rows(measured: Moments, setting: Setting) -> tuple[Row, ...]:
    p = len(setting.theory.places)
    rms = float(np.sqrt(measured.bias[p]))
    error, n = float(measured.bias_error[p]) / (2.0 * rms), measured.samples
    predictors = [(CRAMER_RAO, setting.theory.bound_left)]
    if not setting.own:
        predictors = [(BEST_OF_CLASS, setting.theory.least)]
        if setting.theory.all_left is not None:
            predictors += [(NINE_PARAMETERS, setting.theory.all_left)]
    rows: tuple[Row, ...] = ()
    for predictor, value in predictors:
        rows += unjudged(LEFT(), rms, error, n, value, predictor)
    return rows


def _extreme_rows(
    sums: Sums, every: Float[Array, "n p"], setting: Setting, relative: float
) -> tuple[Row, ...]:
    """Rows of what no calibrator does: better than the bound, or far off now and then.

    Normal errors are within the quantile of all of them together; the deviation of
    most, from the median size, is off by five of its standard errors at the most.
    """
    theory, n = setting.theory, len(every)
    p = len(theory.places)
    size = np.abs(every[:, :p] - np.median(every[:, :p], axis=0))
    deviations = np.median(size, axis=0) / scipy.special.ndtri(0.75)
    greatest = float((size.max(axis=0) / deviations).max())
    most = -scipy.special.ndtri(RARE / (2 * n * p)) * (1.0 + 5.0 * 1.17 / np.sqrt(n))
    rows = limit(GREATEST_ERROR(), greatest, most, NORMAL, n=n)
    if not setting.own:
        return rows
    weight = np.zeros((sums.size, sums.size))
    weight[:p, :p] = np.linalg.inv(theory.bound) / p
    ratio, error = mean_square(sums, weight)
    return rows + plain(
        BELOW_BOUND(), max(0.0, 1.0 - ratio), error, n, 0.0, CRAMER_RAO,
        theory.variance_off + 2.0 * BIAS_ALLOWED * relative,
    )  # fmt: skip


def _nees_row(measured: Moments, setting: Setting) -> tuple[Row, ...]:
    theory = setting.theory
    p = len(theory.places)
    value, error = measured.bias[p + 1], measured.bias_error[p + 1]
    if not setting.own:
        return unjudged(NEES(), value, error, measured.samples, float(p), CLAIM)
    bias = measured.bias[:p]
    weight = np.linalg.inv(theory.bound)
    left = bias @ weight @ bias + p * theory.variance_off
    return nees(NEES(), value, error, measured.samples, float(p), CLAIM, left)
