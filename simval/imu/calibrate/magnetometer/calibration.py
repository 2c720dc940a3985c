r"""Calibrate a magnetometer in the axes of the accelerometer mounted with it.

Both sensors' pose means are moved to their middle and scaled to unit size, gravity and
the field become 1, `magnetometer.start` gives the start and the solver the answer,
which is scaled back. Trials are worked in blocks that fit the cache; a trial's numbers
do not depend on its block.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, outer
from simval.errors import GeometryError, InputError, RefusedError
from simval.imu.calibrate.accelerometer import require_noise
from simval.imu.calibrate.covariance import repeated_poses, repeated_words
from simval.imu.calibrate.equations import (
    Accelerometer,
    Magnetometer,
    Prior,
    Problem,
    Variances,
)
from simval.imu.calibrate.factors import NOT_JUDGED, NoiseFactors, judged
from simval.imu.calibrate.gauss_newton import residuals
from simval.imu.calibrate.goodness_of_fit import Residuals
from simval.imu.calibrate.magnetometer.covariance import (
    STATUS_NAMES,
    CompassCode,
    Fitted,
    judge,
    refuse,
    refuse_still,
)
from simval.imu.calibrate.magnetometer.findings import look
from simval.imu.calibrate.magnetometer.result import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    MagnetometerFit,
)
from simval.imu.calibrate.magnetometer.start import solve, twin
from simval.imu.calibrate.minimization import normalized
from simval.imu.calibrate.recording import Hemisphere, Recording, require_same
from simval.imu.calibrate.result import FitResult
from simval.shapes import Float

FEWEST = 8
"""Poses: three equations each for 22 parameters."""
FEWEST_KNOWN = 7
"""Poses with a known accelerometer: two equations each for the other 13 parameters."""


def checked_known(known: Any, recording: Recording) -> FitResult:
    """Check that a known accelerometer's covariance can be inverted."""
    known = instance("known", known, FitResult)
    require_same("known", known, recording)
    known = known.with_gravity(0.0)  # these poses took the same g
    shape = recording.poses.shape
    if known.parameters.shape[:-1] not in ((), shape[:-2]):
        msg = (
            f"`known` holds {known.parameters.shape[0]} calibrations for readings of "
            f"shape {shape}; give one, or one for each trial"
        )
        raise InputError(msg)
    scaled = known.covariance / outer(known.sd, known.sd)
    usable = np.isfinite(scaled).all() and np.isfinite(known.parameters).all()
    if not (usable and np.all(np.linalg.eigvalsh(scaled) > 1e-12)):
        msg = (
            "`known` has no covariance that can be inverted "
            f"(covariance_kind is {known.covariance_kind!r}); calibrate the "
            "accelerometer with `noise_std`, or from ten poses or more, or leave "
            "`known` out and both sensors are fitted together"
        )
        raise InputError(msg)
    return known


def _require_enough(count: int, known: FitResult | None) -> None:
    fewest = FEWEST if known is None else FEWEST_KNOWN
    if count < fewest:
        what = (
            "three equations, and 22 parameters need"
            if known is None
            else "two equations for the magnetometer, and its 13 parameters need"
        )
        msg = (
            f"{count} pose(s) given; each gives {what} {fewest} poses or more, turned "
            "and tilted to all sides"
        )
        raise GeometryError(msg, "add poses", poses=count, fewest=fewest)


class Scaled(NamedTuple):
    """A block of trials in scaled units, with what is needed to scale back."""

    problem: Problem
    finite: Any  # bool, (t,)
    sizes: Float[Array, "t 22"]
    shifts: Float[Array, "t 22"]

    def physical(
        self, theta: Float[Array, "t 22"], covariance: Float[Array, "t 22 22"]
    ) -> tuple[Float[Array, "t 22"], Float[Array, "t 22 22"]]:
        """Scale parameters and covariance back; the sine of the dip becomes the dip."""
        slope = np.array(self.sizes)
        values = theta * self.sizes + self.shifts
        with np.errstate(invalid="ignore"):  # of a trial that will be refused
            values[:, DIP] = np.arcsin(values[:, DIP])
            slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
        return values, covariance * slope[:, :, None] * slope[:, None, :]


def scale(
    recording: Recording, rows: slice = slice(None), known: FitResult | None = None
) -> Scaled:
    """Centre both sensors' readings of some trials and scale them to unit size."""
    count = recording.poses.shape[-2]
    noise = recording.pose_std, recording.field_std
    raw = [each.reshape(-1, count, 3)[rows] for each in means_of(recording)]
    whole = [np.isfinite(x).all(axis=(1, 2)) for x in raw]
    finite = np.asarray(whole[0] & whole[1])
    filler = np.arange(raw[0][0].size, dtype=float).reshape(raw[0][0].shape)
    safe = [np.where(finite[:, None, None], x, filler) for x in raw]
    (za, centre_a, scale_a), (zm, centre_m, scale_m) = map(normalized, safe)
    count = len(za)
    sizes, shifts = np.ones((count, PARAMETERS)), np.zeros((count, PARAMETERS))
    first = 0 if recording.model == "symmetric" else 3
    sizes[:, first:6] = (recording.g / scale_a)[:, None]
    sizes[:, 6:9] = scale_a[:, None]
    sizes[:, MATRIX] = (recording.field / scale_m)[:, None]
    sizes[:, IRON] = scale_m[:, None]
    shifts[:, 6:9], shifts[:, IRON] = centre_a, centre_m
    stds = [
        np.broadcast_to(
            (std[rows] if std.ndim == 3 else std) / unit[:, None, None], za.shape
        )
        for std, unit in zip(noise, (scale_a, scale_m), strict=True)
    ]
    return Scaled(
        problem=Problem(
            sensors=(
                Accelerometer(readings=za, std=stds[0], model=recording.model),
                Magnetometer(readings=zm, std=stds[1]),
            ),
            prior=_prior(known, rows, sizes[:, :9], shifts[:, :9]),
        ),
        finite=finite,
        sizes=sizes,
        shifts=shifts,
    )


def means_of(recording: Recording) -> tuple[Array, Array]:
    """Mean readings of accelerometer and magnetometer."""
    assert recording.fields is not None
    return recording.poses, recording.fields


def _prior(
    known: FitResult | None, rows: slice, sizes: Array, shifts: Array
) -> Prior | None:
    if known is None:
        return None
    parameters, covariance = known.parameters, known.covariance
    if parameters.ndim == 2:
        parameters, covariance = parameters[rows], covariance[rows]
    count = len(sizes)
    scaled = covariance / outer(sizes, sizes)
    theta = np.zeros((count, PARAMETERS))
    theta[:, ACCELEROMETER] = (parameters - shifts) / sizes
    root = np.zeros((count, 9, PARAMETERS))
    root[:, :, ACCELEROMETER] = np.linalg.inv(np.linalg.cholesky(scaled))
    return Prior(theta=theta, root=root)


_BLOCK = 1 << 12  # poses worked at once: 2 MB of derivatives
ASSUMPTIONS = {
    "unstated": "the magnetometer's axes are right-handed (det M > 0)",
    "north": "the field points below the horizon (northern hemisphere)",
    "south": "the field points above the horizon (southern hemisphere)",
}


def fit_magnetometer(recording: Recording, known: Any) -> MagnetometerFit:
    """Fit a magnetometer, and its accelerometer, to the means of both over poses.

    Raises
    ------
    InputError
        If a value is not usable.
    GeometryError
        If the poses of one recording leave a parameter unobservable. In a batch such a
        trial has a status that says so, and NaN for its numbers.
    RefusedError
        If one recording has duplicate poses, or says too little for what it scatters.
    """
    known = None if known is None else checked_known(known, recording)
    pair, single = means_of(recording), recording.single
    count = pair[0].shape[-2]
    _require_enough(count, known)
    require_noise("pose_std", recording.pose_std)
    require_noise("field_std", recording.field_std)
    if single:
        named = {"accelerometer": pair[0], "magnetometer": pair[1]}
        refuse_still(named)
        both = np.concatenate(pair, axis=1)
        again = repeated_poses(both).size
        if again and again < count - 1:
            raise RefusedError(repeated_words(both, " of both sensors"))
    size, trials = max(1, _BLOCK // count), 1 if single else len(pair[0])
    fitted = partial(_fit, hemisphere=recording.hemisphere)
    parts = [
        fitted(scale(recording, slice(i, i + size), known))
        for i in range(0, trials, size)
    ]
    numbers: dict[str, Any] = {
        k: np.concatenate([p.numbers[k] for p in parts]) for k in parts[0].numbers
    }
    found: dict[str, Any] = {
        "pose_chi_square": np.zeros(0), "disturbed": (), "findings": (),
        "steady_p_value": np.nan,
    }  # fmt: skip
    factors = NOT_JUDGED
    if single:
        stated = parts[0]
        if known is None:
            used, factors = _weighed(stated, fitted)
        else:
            used = stated
        for name in ("parameters", "covariance", "half_width", "code"):
            numbers[name] = used.numbers[name]
        if numbers["code"][0] > CompassCode.MAX_ITERATIONS:
            refuse(numbers["code"][0], named, stated.fitted)
        values = stated.numbers["parameters"][0]
        iron = np.linalg.norm(values[MATRIX].reshape(3, 3) @ values[IRON])
        found = look(stated.fitted, recording.time, float(iron / recording.field))
        numbers = {name: value[0] for name, value in numbers.items()}
    return MagnetometerFit(
        model=recording.model,
        g=recording.g,
        field=recording.field,
        dof=parts[0].fitted.dof,
        status=STATUS_NAMES[numbers.pop("code")],
        assumption=ASSUMPTIONS[recording.hemisphere],
        noise=factors,
        **found,
        **numbers,
    )


class _Block(NamedTuple):
    # trials that are worked at once, and the numbers of their results
    scaled: Scaled
    fitted: Fitted
    numbers: dict[str, Any]


def _fit(scaled: Scaled, hemisphere: Hemisphere) -> _Block:
    solution, sure = solve(scaled.problem)
    theta, stated = solution.theta, hemisphere != "unstated"
    if stated:  # the start took det M > 0
        north = (theta[:, DIP] > 0.0) == (hemisphere == "north")
        theta = np.where(north[:, None], theta, twin(theta))
    here = None if stated else solution.here
    fitted = Fitted.of(scaled.problem, theta, solution.converged, here)
    code = judge(fitted, hemisphere)
    code = np.where(
        sure | (code > CompassCode.MAX_ITERATIONS), code, CompassCode.AMBIGUOUS
    )
    code = np.where(scaled.finite, code, CompassCode.NON_FINITE)
    parameters, covariance = scaled.physical(theta, fitted.covariance)
    numbers = {
        "parameters": parameters,
        "covariance": covariance,
        "chi_square": fitted.chi_square,
        "half_width": fitted.half_width.copy(),
    }
    for value in numbers.values():
        value[code > CompassCode.MAX_ITERATIONS] = np.nan
    numbers |= {"code": code, "iterations": solution.iterations}
    return _Block(scaled=scaled, fitted=fitted, numbers=numbers)


def _weighed(
    block: _Block, fitted: Callable[[Scaled], _Block]
) -> tuple[_Block, NoiseFactors]:
    # one set by the noise that its residuals ask for, where it is more than stated
    problem = block.scaled.problem

    def fit(_: _Block, variances: Variances) -> _Block:
        return fitted(block.scaled._replace(problem=problem.beside(variances)))

    def rows(last: _Block) -> Residuals:
        theta = last.fitted.theta
        here = last.fitted.here if last is block else problem.local(theta)
        return residuals(problem, here, theta)

    if block.numbers["code"][0] != CompassCode.CONVERGED:
        return block, NOT_JUDGED
    return judged(block, fit, rows)
