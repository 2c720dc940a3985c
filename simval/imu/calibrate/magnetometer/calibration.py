r"""Calibrate a magnetometer in the axes of the accelerometer mounted with it.

Both sensors' pose means are moved to their middle and scaled to unit size, gravity and
the field become 1, `magnetometer.start` gives the start and the solver the answer,
which is scaled back. Trials are worked in blocks that fit the cache; a trial's numbers
do not depend on its block.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from simval.arguments import choice, instance, whole_number
from simval.arrays import Array, noise_levels, positive_number
from simval.errors import GeometryError, InputError, RefusedError
from simval.imu.calibrate.accelerometer import checked_time, require_noise
from simval.imu.calibrate.covariance import repeated_poses, repeated_words
from simval.imu.calibrate.equations import (
    Accelerometer,
    Errors,
    Magnetometer,
    Prior,
    Problem,
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
from simval.imu.calibrate.magnetometer.start import both_means, solve, twin
from simval.imu.calibrate.minimization import normalized
from simval.imu.calibrate.result import FitResult
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.vocabulary import Model

FEWEST = 8
"""Poses: three equations each for 22 parameters."""
FEWEST_KNOWN = 7
"""Poses with a known accelerometer: two equations each for the other 13 parameters."""
Hemisphere = Literal["unstated", "north", "south"]
HEMISPHERES = get_args(Hemisphere)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CompassOptions:
    """Options of the fit; checked when made."""

    g: float  # gravity, m/s^2
    field: float  # strength of the field, in the unit that is wanted
    model: Model  # form of the accelerometer's parameters
    hemisphere: Hemisphere
    max_iterations: int  # most steps for a trial
    known: FitResult | None  # the accelerometer, from poses other than these

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "g": positive_number("g", self.g, "m/s^2"),
            "field": positive_number("field", self.field, ""),
            "model": choice("model", self.model, forms.MODELS),
            "hemisphere": choice("hemisphere", self.hemisphere, HEMISPHERES),
            "max_iterations": whole_number("max_iterations", self.max_iterations, 1),
        }
        if self.known is not None:
            checked["known"] = _known(self.known, checked["g"])
            checked["model"] = checked["known"].model
        for name, value in checked.items():
            object.__setattr__(self, name, value)


def _known(known: Any, g: float) -> FitResult:
    known = instance("known", known, FitResult)
    if known.g != g:
        msg = (
            f"`known` was calibrated with g = {known.g:g} m/s^2 and `g` is {g:g}; the "
            "two must be the same, so pass `g=known.g`"
        )
        raise InputError(msg)
    scaled = known.covariance / (known.sd[..., :, None] * known.sd[..., None, :])
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


def checked_pair(
    accelerometer: Any, magnetometer: Any, known: FitResult | None
) -> tuple[Array, Array]:
    """Return the pose means of both sensors, (n, 3) or (trials, n, 3)."""
    pair = both_means(accelerometer, magnetometer)
    shape = pair[0].shape
    count, fewest = shape[-2], FEWEST if known is None else FEWEST_KNOWN
    if known is not None and known.parameters.shape[:-1] not in ((), shape[:-2]):
        msg = (
            f"`known` holds {known.parameters.shape[0]} calibrations for readings of "
            f"shape {shape}; give one, or one for each trial"
        )
        raise InputError(msg)
    if count < fewest:
        what = (
            "three equations, and 22 parameters need"
            if known is None
            else "two equations for the magnetometer, and its 13 parameters need"
        )
        msg = (
            f"{count} pose(s) given; each gives {what} {fewest} poses or more, turned "
            "and tilted to all sides: add poses"
        )
        raise GeometryError(msg)
    return pair


def checked_std(
    name: str, value: Any, poses: Float[Array, "... n 3"]
) -> Float[Array, "... n"]:
    """Return the noise of each pose mean, which must be above zero."""
    if value is None:
        msg = (
            f"`{name}` is not given; the equations of a pose are weighed by the noise "
            "of both sensors, so give the standard deviation of each axis of a pose "
            "mean in raw units, as a rule that of a rest over the root of its samples"
        )
        raise InputError(msg)
    count, trials = poses.shape[-2], len(poses) if poses.ndim == 3 else None
    sigma = noise_levels(name, value, count, trials=trials)
    require_noise(name, sigma)
    return sigma


class Scaled(NamedTuple):
    """A block of trials in the units of the fit, and the way back."""

    problem: Problem
    finite: Any  # bool, (t,)
    sizes: Float[Array, "t 22"]
    shifts: Float[Array, "t 22"]

    def physical(
        self, theta: Float[Array, "t 22"], covariance: Float[Array, "t 22 22"]
    ) -> tuple[Float[Array, "t 22"], Float[Array, "t 22 22"]]:
        """Parameters and covariance in their own units, the dip for its sine."""
        slope = np.array(self.sizes)
        values = theta * self.sizes + self.shifts
        with np.errstate(invalid="ignore"):  # of a trial that will be refused
            values[:, DIP] = np.arcsin(values[:, DIP])
            slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
        return values, covariance * slope[:, :, None] * slope[:, None, :]


def scale(
    batch: tuple[Array, ...],
    noise: tuple[Array, Array],
    rows: slice,
    options: CompassOptions,
) -> Scaled:
    """Move both sensors' readings to their middle and scale them to unit size.

    The noise is that of each pose, (n, 1), or of each of its axes, (n, 3); of each
    trial, (t, n, 1), where they differ.
    """
    raw = [readings[rows] for readings in batch]
    whole = [np.isfinite(x).all(axis=(1, 2)) for x in raw]
    finite = np.asarray(whole[0] & whole[1])
    filler = np.arange(raw[0][0].size, dtype=float).reshape(raw[0][0].shape)
    safe = [np.where(finite[:, None, None], x, filler) for x in raw]
    (za, centre_a, scale_a), (zm, centre_m, scale_m) = map(normalized, safe)
    count = len(za)
    sizes, shifts = np.ones((count, PARAMETERS)), np.zeros((count, PARAMETERS))
    first = 0 if options.model == "symmetric" else 3
    sizes[:, first:6] = (options.g / scale_a)[:, None]
    sizes[:, 6:9] = scale_a[:, None]
    sizes[:, MATRIX] = (options.field / scale_m)[:, None]
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
                Accelerometer(readings=za, std=stds[0], model=options.model),
                Magnetometer(readings=zm, std=stds[1]),
            ),
            prior=_prior(options, rows, sizes[:, :9], shifts[:, :9]),
        ),
        finite=finite,
        sizes=sizes,
        shifts=shifts,
    )


def _prior(
    options: CompassOptions, rows: slice, sizes: Array, shifts: Array
) -> Prior | None:
    if options.known is None:
        return None
    parameters, covariance = options.known.parameters, options.known.covariance
    if parameters.ndim == 2:
        parameters, covariance = parameters[rows], covariance[rows]
    count = len(sizes)
    scaled = covariance / (sizes[:, :, None] * sizes[:, None, :])
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


def calibrate_magnetometer(
    accelerometer: Any,
    magnetometer: Any,
    g: float = 9.80665,
    field: float = 1.0,
    *,
    accelerometer_std: Any,
    magnetometer_std: Any,
    hemisphere: Hemisphere = "unstated",
    known: Any = None,
    model: Model = "triangular",
    time: Any = None,
    max_iterations: int = 100,
) -> MagnetometerFit:
    """Fit a magnetometer, and its accelerometer, to the means of both over poses.

    Parameters
    ----------
    accelerometer, magnetometer : array_like
        Mean reading of each pose, raw units, own axes, (n, 3), or (trials, n, 3).
    g : float, default 9.80665
        Local gravity, m/s^2.
    field : float, default 1.0
        Strength of the field, in the unit that M is wanted in; it changes nothing else.
    accelerometer_std, magnetometer_std : float or array_like
        Standard deviation of each axis of a pose mean, raw units, one number or one for
        each pose (n,), or for each of each trial (trials, n).
    hemisphere : {"unstated", "north", "south"}
        Where the poses were taken. (M, dip) and (-M, -dip) fit alike; unstated, the one
        with right-handed axes (det M > 0) is taken, and a left-handed order of columns
        cannot be seen.
    known : FitResult, optional
        The accelerometer's own calibration from *other* poses, one or one for each
        trial; with its covariance it joins the fit. Without, both sensors are fitted.
    model : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters, whose axes M refers to; that of `known`
        where that is given.
    time : array_like, optional
        When each pose was taken, s, (n,); their order if not given.
    max_iterations : int, default 100
        Most steps for a trial.

    Returns
    -------
    MagnetometerFit
        Parameters, covariance, chi-square of each pose, and findings in words.

    Raises
    ------
    InputError
        If an argument is not usable, or the readings of one set are not finite.
    GeometryError
        If the poses of one set leave a parameter unobservable. In a batch such a trial
        has a status that says so, and NaN for its numbers.
    RefusedError
        If one set has duplicate poses, or says too little for what it scatters.

    Notes
    -----
    Where the residuals of one set do not bear the stated noise, parameters and error
    bars are by what they show (`simval.imu.calibrate.factors`), except beside a `known`
    accelerometer; chi-squares and findings are by what is stated.
    """
    options = CompassOptions(
        g=g, field=field, model=model, hemisphere=hemisphere,
        max_iterations=max_iterations, known=known,
    )  # fmt: skip
    pair = checked_pair(accelerometer, magnetometer, options.known)
    count, single = pair[0].shape[-2], pair[0].ndim == 2
    noise = (
        checked_std("accelerometer_std", accelerometer_std, pair[0])[..., None],
        checked_std("magnetometer_std", magnetometer_std, pair[1])[..., None],
    )
    times = checked_time(time, count)
    batch = tuple(readings.reshape(-1, count, 3) for readings in pair)
    if single:
        named = {"accelerometer": pair[0], "magnetometer": pair[1]}
        refuse_still(named)
        both = np.concatenate(pair, axis=1)
        again = repeated_poses(both).size
        if again and again < count - 1:
            raise RefusedError(repeated_words(both, " of both sensors"))
    size = max(1, _BLOCK // count)
    parts = [
        _fit(scale(batch, noise, slice(i, i + size), options), options)
        for i in range(0, len(batch[0]), size)
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
        used, factors = _weighed(stated, options)
        for name in ("parameters", "covariance", "half_width", "code"):
            numbers[name] = used.numbers[name]
        if numbers["code"][0] > CompassCode.MAX_ITERATIONS:
            refuse(int(numbers["code"][0]), named, stated.fitted)
        values = stated.numbers["parameters"][0]
        iron = np.linalg.norm(values[MATRIX].reshape(3, 3) @ values[IRON])
        found = look(stated.fitted, times, float(iron / options.field))
        numbers = {name: value[0] for name, value in numbers.items()}
    return MagnetometerFit(
        model=options.model,
        g=options.g,
        field=options.field,
        dof=parts[0].fitted.dof,
        status=STATUS_NAMES[numbers.pop("code")],
        assumption=ASSUMPTIONS[options.hemisphere],
        noise=factors,
        **found,
        **numbers,
    )


class _Block(NamedTuple):
    # trials that are worked at once, and the numbers of their results
    scaled: Scaled
    fitted: Fitted
    numbers: dict[str, Any]


def _fit(scaled: Scaled, options: CompassOptions) -> _Block:
    solution, sure = solve(scaled.problem, options.max_iterations)
    theta, stated = solution.theta, options.hemisphere != "unstated"
    if stated:  # the start took det M > 0
        north = (theta[:, DIP] > 0.0) == (options.hemisphere == "north")
        theta = np.where(north[:, None], theta, twin(theta))
    here = None if stated else solution.here
    fitted = Fitted.of(scaled.problem, theta, solution.converged, here)
    code = judge(fitted, options.hemisphere)
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


def _weighed(block: _Block, options: CompassOptions) -> tuple[_Block, NoiseFactors]:
    # one set by the noise that its residuals ask for, where it is more than stated
    problem = block.scaled.problem

    def fit(_: _Block, variances: Errors) -> _Block:
        return _fit(block.scaled._replace(problem=problem.beside(variances)), options)

    def rows(last: _Block) -> Residuals:
        theta = last.fitted.theta
        here = last.fitted.here if last is block else problem.local(theta)
        return residuals(problem, here, theta)

    if block.numbers["code"][0] != CompassCode.CONVERGED or options.known is not None:
        return block, NOT_JUDGED
    return judged(block, fit, rows)
