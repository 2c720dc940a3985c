r"""A user's calibrator: its errors compared with the Cramér-Rao bound.

The plug-in's conventions are probed without noise first. Then each trial reads a known
sensor in poses spread over the sphere, or in the six faces of a cube, with noise on
each mean, and calibrates; the error is estimate minus truth in the nine parameters of
the triangular form, to which every answer is brought: norms fix no more. What the
calibration leaves of the specific force, over all directions, is set against the least
that an unbiased one leaves (`left`).

A calibrator may estimate fewer parameters and is then measured by them. Of its own
class the sensor has no other errors, and all is as with nine. Of the full sensor, whose
misalignment (and scale) is outside the class, the truth is what the class converges to
without noise. `simval.theory.calibration_classes` knows it for each of the criteria by
which one may fit, and the noise-free answer may be in the middle of these or off it by
their range (`settled`); the mean of the trials must be the noise-free answer. Its
covariance is not judged, for it says nothing of what is left out. What it leaves stands
against the least that its class can leave, and the bound of nine parameters.

The plug-in's bias is not predicted. Every residual of the theory is biased by at most
3.5 :math:`\sigma^2/g^2` in scale, so a scale and a misalignment are each allowed
`BIAS_ALLOWED` :math:`\sigma^2/g^2`, and a bias `BIAS_ALLOWED` :math:`\sigma^2/g` of raw
units; a greater one fails. Where it gives a covariance, the mean normalised square must
be 9, up to the square of that bias and the remainder that theory states for a variance.
A covariance of ``type A``, from residuals with :math:`\nu` degrees of freedom (`dof`),
makes it :math:`9 F(9, \nu)` instead of chi-square, with the mean
:math:`9\nu/(\nu - 2)`; it is multiplied by :math:`(\nu - 2)/\nu` before it is judged,
and `FREEDOM` more is allowed. The spread is set against the bound and kept for the
baseline.

A command is a process for each trial, so its time limit is for every `CALLS` of them;
in a batch the limit is for all trials.
"""

from functools import cached_property
from itertools import permutations
from math import ceil
from typing import Literal, Self

import numpy as np
import scipy
from pydantic import model_validator

from simval import statistics as stat
from simval.arrays import Array, Places
from simval.errors import PluginError
from simval.imu.sensor import forms
from simval.imu.sensor.models import ALL, mean_square_left, own_sensor, places_of
from simval.moments import Moments, deviations
from simval.montecarlo import Sums, mean_square, moments_of, simulate
from simval.plugins import Calibrator, probe_calibrator
from simval.plugins.answers import Calibration, calibration_of, calibrations_of
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.plugins.names import COMMAND
from simval.plugins.probe import TOLERANCE
from simval.plugins.programs import in_batch
from simval.plugins.protocol import BatchCalibrator
from simval.poses import cube_faces, fibonacci_sphere
from simval.results import Rows, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.coverage import FREEDOM
from simval.studies.plugin import (
    Again,
    AlgorithmParameters,
    Call,
    PluginName,
    Problem,
    Seconds,
    compute,
    outcome,
    run,
)
from simval.studies.study import LEAST_NOISE, described, ranged
from simval.studies.trials import root
from simval.theory.calibration import (
    VARIANCE_NEXT,
    CalibrationMoments,
    calibration_moments,
)
from simval.theory.calibration_classes import (
    bound_left,
    class_bound,
    least_left,
    pseudo_true,
)

__all__ = ["SECTION", "TITLE", "Parameters", "compute", "outcome", "run"]

TITLE = "User-supplied calibrator: bias, spread and stated covariance"
SECTION = "algorithms"

FACES = 6
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

Trials = tuple[Sums, Float[Array, "n q"], Float[Array, " p"]]
"""Sums of the errors, the errors of all trials, and the error without noise."""


class Calibrations(Problem[Calibrator, float, Trials]):
    """Calibrations of a known sensor from noisy pose means."""

    kind = Calibrator

    def __init__(
        self, plugin: Calibrator, parameters: "Parameters", streams: Streams
    ) -> None:
        super().__init__(plugin, parameters, streams)
        self.faces = parameters.pose_set == "faces"
        self.directions = fibonacci_sphere(parameters.poses)
        if self.faces:
            self.directions = np.tile(cube_faces(), (parameters.poses // FACES, 1))
        estimates, self.places = plugin.estimates, list(places_of(plugin.estimates))
        if self.faces and estimates == ALL:
            msg = (
                f"{plugin.name} estimates nine parameters, but six faces of a cube "
                'show only six of them; use pose_set = "sphere", or declare in '
                "`estimates` what it estimates"
            )
            raise PluginError(msg)
        full = probe_sensor(estimates)
        inside = own_sensor(full, estimates)
        self.sensor = inside if parameters.sensor == "own class" else full
        # whether the sensor has no errors but those that are estimated
        known = np.array_equal(inside.parameters, self.sensor.parameters)
        self.own = estimates == ALL or known
        scale = float(np.abs(np.linalg.inv(self.sensor.matrix)).max())
        self.noise = parameters.noise_std * scale  # of an axis of a pose mean, raw
        self.clean = self.readings(self.directions)
        # Cramer-Rao of what is estimated, and the remainder of a variance, relative
        if estimates == ALL:
            theory = self.nine_parameters()
            self.bound, remainder = theory.cramer_rao, theory.variance_remainder
        else:
            self.bound = class_bound(
                inside, self.directions, tuple(self.places),
                g=G, noise_std=self.noise, known=self.faces,
            )  # fmt: skip
            # eq. (K4) of the worst axis
            worst = np.linalg.norm(inside.matrix, axis=1).max()
            remainder = VARIANCE_NEXT * (self.noise * worst / G) ** 2
        self.variance_off = remainder + FREEDOM
        self.inside = inside

    def readings(self, directions: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Pose means without noise, raw units."""
        return self.sensor.distort(G * directions, np.random.default_rng(0))

    def nine_parameters(self) -> CalibrationMoments:
        """Theory for all nine parameters."""
        given = self.sensor, self.directions
        return calibration_moments(*given, g=G, noise_std=self.noise)

    @property
    def named(self) -> tuple[list[str], list[str]]:
        """Names and units of the estimated parameters."""
        names = forms.names("triangular")
        units = [("1", "raw")[k >= 6] for k in self.places]
        return [names[k] for k in self.places], units

    @property
    def sizes(self) -> Float[Array, " p"]:
        """Natural sizes of the estimated parameters."""
        sizes = np.abs(self.sensor.parameters)
        sizes[:3] = 1.0
        sizes[6:] = G / np.abs(self.sensor.K).min()
        return sizes[self.places]

    @property
    def relative(self) -> float:
        """Square of the noise relative to g."""
        return (self.parameters.noise_std / G) ** 2

    @cached_property
    def answer(self) -> Calibration:
        """The calibrator's answer without noise."""
        return calibration_of(self.plugin, self.clean, G, self.noise)

    @property
    def size(self) -> tuple[int, str]:
        """Number of trials, in whole blocks."""
        return BLOCK * ceil(self.parameters.trials / BLOCK), "trials"

    @property
    def lives(self) -> bool:
        """False for a command, which starts anew for each batch."""
        return not isinstance(self.plugin, BatchCalibrator)

    def probe(self) -> float:
        """Largest error without noise."""
        return probe_calibrator(self.plugin, self.directions if self.faces else None)

    def trials(self, probed: float) -> Trials:
        """Errors of all trials."""
        p = len(self.places)
        settled = np.zeros(p) if self.own else self.error(self.answer)[:p]
        blocks = list(range(ceil(self.parameters.trials / BLOCK)))
        every = self.errors(blocks)
        if every.shape[1] > p + 1:
            require_order(self)
        parts = iter(every.reshape(len(blocks), BLOCK, -1))
        sums = simulate(
            lambda rng, count: next(parts).T, self.streams,
            samples=self.parameters.trials, block=BLOCK, batch=1,
        )  # fmt: skip
        require_spread(self, moments_of(sums))
        return sums, every, settled

    def errors(
        self, blocks: list[int], order: Places | None = None
    ) -> Float[Array, "n p"]:
        """Errors of all trials in some blocks, computed in any order.

        Readings are handed over many blocks at once.
        """
        found: list[Array] = []
        most = max(1, AT_ONCE // (BLOCK * self.clean.size))
        if order is not None:  # of few
            most = len(blocks)
        for first in range(0, len(blocks), most):
            noise = [
                self.streams.block(k).standard_normal((BLOCK, *self.clean.shape))
                for k in blocks[first : first + most]
            ]
            raw = self.clean + self.noise * np.concatenate(noise)
            raw = raw if order is None else raw[order]
            given = raw, G, self.noise, self.parameters.time_limit
            found += map(self.error, calibrations_of(self.plugin, *given))
        return np.array(found)

    def error(self, answer: Calibration) -> Float[Array, " p"]:
        """Errors of the parameters, the force error left, and the NEES if known."""
        form = self.plugin.form
        error = (answer.parameters("triangular") - self.sensor.parameters)[self.places]
        left = mean_square_left(answer.matrix, answer.bias, self.sensor, G)
        if answer.covariance is None:
            return np.append(error, left)
        own = error
        if form != "triangular":
            M = self.sensor.matrix
            truth = forms.from_gram(form, M.T @ M, self.sensor.B)
            own = answer.parameters(form) - truth
        square = own @ np.linalg.solve(answer.covariance, own)
        # its own mean over the one that a Type A covariance gives it
        factor = 1.0 if answer.dof is None else (answer.dof - 2) / answer.dof
        return np.append(error, [left, square * factor])

    def again(self, answers: Trials) -> Again | None:
        """Blocks to repeat, if one process computes all trials."""
        if self.parameters.alone:
            return None
        _, every, _ = answers
        last, p = len(every) // BLOCK - 1, len(self.places)
        blocks = np.unique(np.linspace(0, last, AGAIN).astype(int)).tolist()
        first = np.concatenate([every[k * BLOCK :][:BLOCK] for k in blocks])
        most = np.full(first.shape, np.inf)
        most[:, :p] = TOLERANCE * self.sizes
        most[:, p + 1 :] = SQUARE_APART * (1.0 + first[:, p + 1 :])
        return first, lambda order: self.errors(blocks, order), most

    def rows(self, probed: float, answers: Trials) -> Rows:
        """All rows of the cell."""
        sums, every, settled = answers
        measured = moments_of(sums)
        return (
            *limit(stat.PROBE(), probed, TOLERANCE, stat.TRUTH, n=1),
            *settled_rows(self, settled),
            *parameter_rows(self, measured, settled),
            *left_rows(self, measured),
            *extreme_rows(self, sums, every),
            *nees_row(self, measured),
        )

    def call(self) -> Call:
        """One calibration that any calibrator can do, to be timed."""
        rng = np.random.default_rng(BLOCK)
        raw = self.readings(fibonacci_sphere(self.parameters.poses))
        noisy = raw + self.noise * rng.standard_normal(raw.shape)
        return calibration_of, (noisy, G, self.noise), 1


class Parameters(AlgorithmParameters):
    """One cell: a plug-in, poses, a sensor and a noise level."""

    problem = Calibrations
    no_noise = ("algorithm", "time_limit")

    algorithm: PluginName = described(
        "",
        "FILE.py, FILE.py:NAME, an entry point, or command: PROGRAM.",
    )
    poses: int = ranged(
        24, "Poses of a trial: 9 or more, of faces a multiple of 6.", FACES, 400
    )
    pose_set: Literal["sphere", "faces"] = described(
        "sphere",
        "Poses spread evenly over the sphere, or the six faces of a cube "
        "in turn: +x, +y, +z, -x, -y, -z.",
    )
    sensor: Literal["full", "own class"] = described(
        "full",
        "Sensor with all nine errors, or with those alone that the "
        "calibrator estimates.",
    )
    noise_std: float = ranged(
        0.01, "Noise per axis of a pose mean, m/s^2.", LEAST_NOISE, 1.0
    )
    trials: int = ranged(1024, "Trials; rounded up to whole blocks of 16.", 2 * BLOCK)
    time_limit: Seconds = described(
        300.0,
        "Wall time after which the cell fails, s; of a command for every "
        "64 trials, of one that takes all trials at once for all.",
    )

    @model_validator(mode="after")
    def _poses_of_the_set(self) -> Self:
        least = 9 if self.pose_set == "sphere" else FACES
        if self.poses < least or (self.pose_set == "faces" and self.poses % FACES):
            msg = (
                f'`poses` is {self.poses}; pose_set = "sphere" needs 9 or more, '
                'pose_set = "faces" a multiple of 6'
            )
            raise ValueError(msg)
        return self

    @property
    def alone(self) -> bool:
        """True if each trial has its own process, which remembers nothing."""
        return self.algorithm.startswith(COMMAND) and not in_batch(self.algorithm)

    @property
    def deadline(self) -> float:
        """Time limit for all trials, s; a command's limit counts `CALLS` times."""
        if in_batch(self.algorithm):
            return self.time_limit + AROUND
        return self.time_limit * (ceil(self.trials / CALLS) if self.alone else 1)


def require_order(problem: Calibrations) -> None:
    """Refuse a covariance whose parameters are in another order.

    Whatever its size, it has the proportions of the bound in another order, and is off
    them `ALIKE` times as far in this one.
    """
    plugin, covariance = problem.plugin, problem.answer.covariance
    assert covariance is not None
    bound, names, p = problem.bound, problem.named[0], len(problem.places)
    if plugin.form != "triangular":
        own, form = problem.sensor.parameters, plugin.form
        there, _ = forms.convert(own, None, source="triangular", target=form)
        J = forms.conversion_jacobian(own, there, source="triangular", target=form)
        bound, names = J @ bound @ J.T, list(forms.names(form))
    spread = {}
    for blocks in permutations(np.arange(p).reshape(-1, 3)):
        order = np.concatenate(blocks)
        back = np.argsort(order)  # where each parameter stands in that order
        ratios = scipy.linalg.eigvalsh(covariance[np.ix_(back, back)], bound)
        spread[tuple(order.tolist())] = ratios[-1] / ratios[0]
    fitting = min(spread, key=lambda order: spread[order])
    if ALIKE * spread[fitting] < spread[tuple(range(p))]:
        msg = (
            f"the covariance of {plugin.name} is in another order than its parameters: "
            f"it fits {', '.join(names[k] for k in fitting)}, and must be of "
            f"{', '.join(names)}"
        )
        raise PluginError(msg)


def require_spread(problem: Calibrations, measured: Moments) -> None:
    """Refuse a calibrator that gives a parameter the same value in every trial."""
    names, least = problem.named[0], STILL * np.sqrt(problem.relative) * problem.sizes
    still = ~(measured.sd[: len(names)] > least)
    if still.any():
        msg = (
            f"{problem.plugin.name} gives the same {names[int(still.argmax())]} in all "
            f"{measured.samples} trials, whatever their noise; it must estimate what "
            "it declares from the readings, or leave it out of `estimates`"
        )
        raise PluginError(msg)


def settled_rows(problem: Calibrations, settled: Float[Array, " p"]) -> Rows:
    """Rows for the noise-free answer about a sensor outside the class.

    It is in the middle of what all criteria converge to, or off it by their range.
    """
    if problem.own:
        return ()
    places, sensor = problem.places, problem.sensor
    found = pseudo_true(
        sensor, problem.directions, tuple(places), g=G, known=problem.faces
    )
    all_off = (found - sensor.parameters)[:, places]
    middle = (all_off.max(axis=0) + all_off.min(axis=0)) / 2.0
    most = np.ptp(all_off, axis=0) + TOLERANCE * problem.sizes
    off = np.abs(settled - middle)
    return limit(stat.SETTLED.each(*problem.named), off, most, stat.PSEUDO_TRUE, n=1)


def parameter_rows(
    problem: Calibrations, measured: Moments, settled: Float[Array, " p"]
) -> Rows:
    """Bias and spread of each parameter, against theory and the bound."""
    n, (names, units) = measured.samples, problem.named
    p = len(names)
    sd = measured.sd[:p]
    variance_error = np.diagonal(measured.covariance_error)[:p]
    allowed = BIAS_ALLOWED * problem.relative * problem.sizes
    rows = plain(
        stat.BIAS.each(names, units), measured.bias[:p], measured.bias_error[:p], n,
        settled, stat.NO_BIAS if problem.own else stat.NOISE_FREE, allowed,
    )  # fmt: skip
    spread = stat.SD.each(names, units), sd, variance_error / (2 * sd), n
    if not problem.own:
        return rows + unjudged(*spread)
    bound = deviations(problem.bound)
    efficiency = (bound / sd) ** 2
    error = efficiency * variance_error / sd**2
    return (
        *rows,
        *unjudged(*spread, bound, stat.CRAMER_RAO),
        *unjudged(stat.EFFICIENCY.each(names), efficiency, error, n),
    )


def left_rows(problem: Calibrations, measured: Moments) -> Rows:
    """RMS force error that a calibration leaves, against the least possible, m/s^2."""
    p, places, sensor = len(problem.places), tuple(problem.places), problem.sensor
    rms, error = root(measured.bias[p], measured.bias_error[p])
    n = measured.samples
    if problem.own:
        least = bound_left(problem.inside, problem.bound, places, G)
        return unjudged(stat.LEFT(), rms, error, n, least, stat.CRAMER_RAO)
    best = least_left(sensor, places, G)
    rows = unjudged(stat.LEFT(), rms, error, n, best, stat.BEST_OF_CLASS)
    if problem.faces:  # which do not show all nine
        return rows
    least = bound_left(sensor, problem.nine_parameters().cramer_rao, places_of(ALL), G)
    return rows + unjudged(stat.LEFT(), rms, error, n, least, stat.NINE_PARAMETERS)


def extreme_rows(problem: Calibrations, sums: Sums, every: Float[Array, "n p"]) -> Rows:
    """Rows that fail if a calibrator beats the bound, or is sometimes far off.

    Normal errors are within the quantile of all of them together; the deviation of
    most, from the median size, is off by five of its standard errors at the most.
    """
    n, p = len(every), len(problem.places)
    size = np.abs(every[:, :p] - np.median(every[:, :p], axis=0))
    deviations = np.median(size, axis=0) / scipy.special.ndtri(0.75)
    greatest = (size.max(axis=0) / deviations).max()
    most = -scipy.special.ndtri(RARE / (2 * n * p)) * (1.0 + 5.0 * 1.17 / np.sqrt(n))
    rows = limit(stat.GREATEST_ERROR(), greatest, most, stat.NORMAL, n=n)
    if not problem.own:
        return rows
    weight = np.zeros((sums.size, sums.size))
    weight[:p, :p] = np.linalg.inv(problem.bound) / p
    ratio, error = mean_square(sums, weight)
    return rows + plain(
        stat.BELOW_BOUND(), max(0.0, 1.0 - ratio), error, n, 0.0, stat.CRAMER_RAO,
        problem.variance_off + 2.0 * BIAS_ALLOWED * problem.relative,
    )  # fmt: skip


def nees_row(problem: Calibrations, measured: Moments) -> Rows:
    """Mean normalised squared error, if a covariance is given."""
    p, n = len(problem.places), measured.samples
    if len(measured.bias) < p + 2:
        return ()
    value, error = measured.bias[p + 1], measured.bias_error[p + 1]
    if not problem.own:
        return unjudged(stat.NEES(), value, error, n, float(p), stat.CLAIM)
    bias = measured.bias[:p]
    left = bias @ np.linalg.inv(problem.bound) @ bias + p * problem.variance_off
    return nees(stat.NEES(), value, error, n, float(p), stat.CLAIM, left)
