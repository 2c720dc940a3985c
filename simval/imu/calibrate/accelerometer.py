r"""Calibrate an accelerometer from the norms of its readings at rest.

The readings are moved to their mean and scaled to unit size, gravity becomes 1, the
closed-form ellipsoid (E1) gives the start and the solver the answer, which is
scaled back. Trials are worked in blocks that fit the cache; a trial's numbers do not
depend on its block.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from simval.arguments import choice, switch, whole_number
from simval.arrays import (
    Array,
    noise_levels,
    nonnegative_number,
    outer,
    physical_array,
    positive_number,
    shaped_array,
)
from simval.errors import GeometryError, InputError
from simval.imu.calibrate.covariance import judge, refuse, screen, summarize
from simval.imu.calibrate.minimization import (
    Leverage,
    direction_condition,
    fit_ellipsoid,
    minimize_leverage,
    minimize_reweighted,
    normalized,
    pose_objective,
)
from simval.imu.calibrate.outliers import judge_poses, standardized
from simval.imu.calibrate.residuals import (
    LOSSES,
    READING,
    RESIDUALS,
    WEIGHTED,
    moment_matrix,
    monomial_rows,
    noise_shares,
    unbiased_moment_matrix,
)
from simval.imu.calibrate.result import FitResult
from simval.imu.calibrate.solver import (
    METHODS,
    STATUS_NAMES,
    Code,
    Rules,
    Solution,
    Trials,
    minimize,
)
from simval.imu.sensor import forms
from simval.poses import PARAMETERS
from simval.shapes import Float
from simval.spelling import counted
from simval.text import shown
from simval.vocabulary import ITERATIONS, Iteration, Loss, Method, Model, Residual

# Above it (singular values 1e4 apart) the moments, whose condition is the square, keep
# under eight digits, and 1 mm/s^2 of noise becomes 0.6 m/s^2 of bias or more.
CONDITION_LIMIT = 1e3
_GREATEST = 1e60  # fourth powers stay finite


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options(Rules):
    """Options of a fit, checked when they are made."""

    model: str  # form
    iteration: str  # unknowns of the squared residual's
    residual: str
    loss: str
    g: float  # gravity, m/s^2
    full_scale: float | None  # greatest reading, raw units
    repeats: bool  # whether readings may repeat exactly
    condition_limit: float  # greatest condition of the poses
    covariance: bool  # whether the covariance is wanted

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            name: choice(name, getattr(self, name), allowed)
            for name, allowed in choices().items()
        }
        if self.loss != "linear" and self.residual not in ("squared", "weighted"):
            msg = (
                f"`loss` is {self.loss!r} with residual {self.residual!r}; a robust "
                "loss goes with the squared or the weighted residual"
            )
            raise InputError(msg)
        if self.iteration == "source" and (self.residual, self.loss) != (
            "squared",
            "linear",
        ):
            msg = (
                f"`iteration` is 'source' with residual {self.residual!r} and loss "
                f"{self.loss!r}; the sources know only the squared residual and the "
                "linear loss, so leave both at their defaults"
            )
            raise InputError(msg)
        units = {"g": "m/s^2", "tolerance": "", "condition_limit": "", "step": ""}
        if self.full_scale is not None:
            units["full_scale"] = "raw units"
        for name, unit in units.items():
            checked[name] = positive_number(name, getattr(self, name), unit)
        if not checked["step"] <= 1.0:
            msg = f"`step` is {shown(self.step)}; it must be above 0 and at most 1"
            raise InputError(msg)
        checked["max_iterations"] = whole_number(
            "max_iterations", self.max_iterations, 1
        )
        for name in ("repeats", "covariance"):
            checked[name] = switch(name, getattr(self, name))
        for name, value in checked.items():
            object.__setattr__(self, name, value)


def choices() -> dict[str, tuple[str, ...]]:
    """The values of each option that is a choice."""
    return {
        "model": forms.MODELS,
        "method": METHODS,
        "iteration": ITERATIONS,
        "residual": RESIDUALS,
        "loss": ("linear", *LOSSES),
    }


def pose_means(name: str, value: Any) -> Float[Array, "... n 3"]:
    """Check the pose means of one set (all finite) or of several sets."""
    readings = shaped_array(name, value, (None, 3))
    if readings.ndim > 3 or readings.size == 0:
        msg = f"`{name}` has shape {readings.shape}; give (n, 3) or (trials, n, 3)"
        raise InputError(msg)
    greatest = max(-readings.min(), readings.max())
    if readings.ndim == 2 and not isfinite(greatest):
        pose, axis = (int(i) for i in np.argwhere(~np.isfinite(readings))[0])
        msg = (
            f"`{name}` has readings that are not finite: "
            f"{np.count_nonzero(~np.isfinite(readings))} in all, the first "
            f"({readings[pose, axis]}) in pose {pose}, axis {'xyz'[axis]}; "
            "remove those poses"
        )
        raise InputError(msg)
    if not isfinite(greatest):  # of a batch, whose other trials are fitted
        finite = readings[np.isfinite(readings)]
        greatest = np.abs(finite).max(initial=0.0)
    if not (greatest == 0.0 or 1.0 / _GREATEST <= greatest <= _GREATEST):
        msg = (
            f"the greatest reading of `{name}` is {greatest:g}, outside "
            f"{1.0 / _GREATEST:g} to {_GREATEST:g}; give raw counts or a usual unit"
        )
        raise InputError(msg)
    return readings


def checked_noise(
    noise_std: Any, poses: Float[Array, "... n 3"], residual: str
) -> Float[Array, "... n"] | None:
    """Noise of each pose, for each trial of a batch."""
    if noise_std is None:
        if residual == "adjusted":
            msg = (
                "`residual` is 'adjusted', which takes the known noise out of the "
                "moments, but `noise_std` is missing; give the standard deviation "
                "of a pose mean in raw units"
            )
            raise InputError(msg)
        return None
    trials = len(poses) if poses.ndim == 3 else None
    sigma = noise_levels("noise_std", noise_std, poses.shape[-2], trials=trials)
    if residual in WEIGHTED and np.any(sigma > 0.0):
        require_noise("noise_std", sigma)
    return np.broadcast_to(sigma, poses.shape[:-1])


def require_noise(name: str, sigma: Float[Array, "... n"]) -> None:
    """Refuse a pose without noise, whose weight would be infinite."""
    if not np.all(sigma > 0.0):
        msg = (
            f"`{name}` is 0 for {np.count_nonzero(sigma == 0.0)} of "
            f"{sigma.size} poses, but each pose is weighted by 1/noise^2; give "
            "every pose the noise that it has"
        )
        raise InputError(msg)


def checked_time(time: Any, count: int) -> Float[Array, " n"]:
    """Time of each pose; 0, 1, 2 and so on if none is given."""
    if time is None:
        return np.arange(float(count))
    values = physical_array("time", time, (count,))
    if values.shape != (count,) or not np.ptp(values) > 0.0:
        msg = (
            f"`time` has shape {values.shape} and spans {shown(float(np.ptp(values)))} "
            f"s; give the time of each of the {count} poses, s"
        )
        raise InputError(msg)
    return values


_BLOCK = 1 << 15  # poses worked at once: 5 MB of monomials
# By how much rounding may raise a cost, in eps by pose. Measured on 2700 fits of every
# solver and four residuals: statuses and number of steps are the same from 16 to 4096;
# with 0 there are twice the steps.
_SLACK = 64.0


_Numbers = dict[str, Any]  # physical results of a block of trials; NaN where refused


def calibrate(
    poses: Any,
    g: float = 9.80665,
    model: Model = "triangular",
    method: Method = "lm",
    residual: Residual = "squared",
    noise_std: Any = None,
    *,
    step: float = 1.0,
    iteration: Iteration = "centre",
    loss: Loss = "linear",
    tolerance: float = 1e-12,
    max_iterations: int = 200,
    full_scale: float | None = None,
    repeats: bool = False,
    condition_limit: float = CONDITION_LIMIT,
    covariance: bool = True,
    g_std: float = 0.0,
) -> FitResult:
    """Fit scale, misalignment and bias to readings at rest, one set or a batch.

    Parameters
    ----------
    poses : array_like
        Mean reading of each pose, raw units, sensor axes, (n, 3), or (trials, n, 3).
    g : float, default 9.80665
        Local gravity, m/s^2.
    model : {"triangular", "upper", "symmetric"}
        Form of the parameters, see `simval.imu.sensor.forms`.
    method : {"lm", "gauss-newton", "newton"}
        Solver, see `simval.imu.calibrate.solver`.
    residual : {"squared", "norm", "weighted", "sampson", "adjusted"}
        Residual, see `simval.imu.calibrate.residuals`; adjusted needs `noise_std`.
    noise_std : float or array_like, optional
        Standard deviation of each axis of a pose mean, raw units: one number, one
        for each pose (n,), or one for each pose of each trial (trials, n). If given,
        the covariance uses it as known; if not, it is estimated from the residuals
        (Type A).
    step : float, default 1.0
        Fraction of each step taken, above 0 and up to 1 (damped Gauss-Newton).
    iteration : {"centre", "source"}
        How the squared residual is minimised: ``centre`` iterates over the ellipsoid's
        centre only; ``source`` over all nine parameters with the stop rule as printed,
        as the sources do. The sources' methods are lm with J'J + mu I for the
        triangular form, and for the symmetric form gauss-newton with a `step` alpha,
        or newton with all second derivatives.
    loss : {"linear", "huber", "soft_l1", "cauchy"}
        Robust loss, for the squared and weighted residuals.
    tolerance : float, default 1e-12
        Relative stop rule, eq. (L1) of the solver.
    max_iterations : int, default 200
        Largest number of steps for a trial.
    full_scale : float, optional
        Greatest reading of the sensor, raw units; poses at or beyond it are refused.
    repeats : bool, default False
        Accept readings that are equal in every bit, as single quantised samples can be.
    condition_limit : float, default 1e3
        Greatest condition number of the poses that is accepted.
    covariance : bool, default True
        Work out the covariance. False leaves it NaN, for a simulation that needs only
        the parameters.
    g_std : float, default 0.0
        Standard deviation of `g`, m/s^2; 0 takes gravity as exact. `local_gravity`
        gives `g` and its standard deviation for a place.

    Returns
    -------
    FitResult
        Parameters, covariance and status.

    Raises
    ------
    InputError
        If an argument is not usable, or the readings of one set are not finite.
    GeometryError
        If the poses of one set leave a parameter unobservable. In a batch such a
        trial has a status that says so, and NaN for its numbers.
    RefusedError
        If one set has duplicate or saturated poses.

    Notes
    -----
    The squared residual is that of the three source derivations. Norms do not show
    a rotation of the axes or the sign of an axis. A wrong `g` makes the scale wrong:
    K is proportional to `g`, but T and B do not depend on it, eq. (GR3) of
    `simval.imu.calibrate.gravity`.
    """
    options = Options(
        model=model, method=method, residual=residual, loss=loss, g=g, step=step,
        iteration=iteration, stop="printed" if iteration == "source" else "bounded",
        tolerance=tolerance, max_iterations=max_iterations, full_scale=full_scale,
        repeats=repeats, condition_limit=condition_limit, covariance=covariance,
    )  # fmt: skip
    g_std = nonnegative_number("g_std", g_std, "m/s^2")
    readings = pose_means("poses", poses)
    count = readings.shape[-2]
    if count < PARAMETERS:
        msg = (
            f"{counted(count, 'pose')} given; nine parameters need {PARAMETERS} "
            "or more in different directions, and error bars need 10 or more: "
            "add poses"
        )
        raise GeometryError(msg)
    sigma = checked_noise(noise_std, readings, options.residual)
    batch = readings.reshape(-1, count, 3)
    sigma = None if sigma is None else sigma.reshape(batch.shape[:2])
    size = max(1, _BLOCK // count)
    blocks = [slice(i, i + size) for i in range(0, len(batch), size)]
    parts = [
        _fit_block(batch[block], None if sigma is None else sigma[block], options)
        for block in blocks
    ]
    numbers = parts[0]
    if len(parts) > 1:
        numbers = {k: np.concatenate([part[k] for part in parts]) for k in numbers}
    code, half_width = numbers.pop("code"), numbers.pop("half_width")
    single = readings.ndim == 2
    if single and code[0] >= Code.NON_FINITE:
        refuse(
            code[0], batch[0],
            full_scale=options.full_scale, limit=options.condition_limit,
            condition=float(numbers["condition"][0]), half_width=float(half_width[0]),
            suspects=_suspects(batch[0], None if sigma is None else sigma[0], options),
        )  # fmt: skip
    numbers["status"] = STATUS_NAMES[code]
    if single:
        numbers = {name: value[0] for name, value in numbers.items()}
    dof = count - PARAMETERS
    known = sigma is not None and loss == "linear"
    kind = "known sigma" if known else "type A"
    if not covariance or (dof == 0 and not known):
        kind = "none"
    return FitResult(
        model=model,
        method=method,
        residual=residual,
        loss=loss,
        g=options.g,
        covariance_kind=kind,
        dof=dof,
        **numbers,
    ).with_gravity(g_std)


def _suspects(
    poses: Float[Array, "n 3"], sigma: Float[Array, " n"] | None, options: Options
) -> list[tuple[int, float]]:
    # outliers without which the set would not be refused, and how far off they are
    if len(poses) <= PARAMETERS or not np.isfinite(poses).all():
        return []
    _, off = judge_poses(poses, sigma, np.arange(float(len(poses))))
    keep = np.delete(np.arange(len(poses)), off)
    if not off or len(keep) < PARAMETERS:
        return []
    std = None if sigma is None else sigma[None, keep]
    rest = _fit_block(poses[None, keep], std, options)
    if rest["code"][0] >= Code.NON_FINITE:
        return []
    far = np.abs(standardized(poses, sigma, off))
    return [(k, float(far[k])) for k in off]


def _fit_block(
    poses: Float[Array, "t n 3"], sigma: Float[Array, "t n"] | None, options: Options
) -> _Numbers:
    # Fit a block of trials, refused ones set aside.
    count = len(poses)
    rows = np.ascontiguousarray(poses.transpose(1, 2, 0))  # trials in lanes
    ends = np.array([rows.min(axis=0), rows.max(axis=0)]).T
    code = screen(poses, ends, full_scale=options.full_scale, repeats=options.repeats)
    condition = np.full(count, np.inf)
    block: _Numbers = {"code": code, "condition": condition, "raw_range": ends}
    # repeated poses are looked at as well: what they leave open says more
    keep = np.flatnonzero((code == Code.CONVERGED) | (code == Code.DUPLICATES))
    if keep.size == 0:
        return block | _spread(_no_results(), keep, count)
    z, centre, scale = normalized(poses if keep.size == count else poses[keep])
    m = monomial_rows(z)
    moments = moment_matrix(m)
    ellipsoid = fit_ellipsoid(moments)
    theta = forms.from_gram(options.model, ellipsoid.gram, ellipsoid.bias)
    usable = np.isfinite(theta).all(axis=-1) & ellipsoid.proper
    own, stretch = direction_condition(options.model, theta, moments, usable)
    condition[keep], checked = own, code[keep]
    checked[~(own <= options.condition_limit)] = Code.CONDITION
    checked[~usable] = Code.NOT_ELLIPSOID
    checked[~ellipsoid.determined] = Code.RANK
    code[keep], good = checked, checked == Code.CONVERGED
    if not good.any():
        return block | _spread(_no_results(), keep[good], count)
    sigma = None if sigma is None else sigma[keep]
    data = _Data(
        m=m, moments=moments, leverage=ellipsoid.leverage,
        noise=None if sigma is None else sigma / scale[:, None],
        shares=noise_shares(options.residual, sigma), theta=theta, centre=centre,
        scale=scale, condition=own, stretch=stretch,
    )  # fmt: skip
    if not good.all():
        keep, data = keep[good], data.take(good)
    code[keep], results = _solve(data, options)
    return block | _spread(results, keep, count)


def _no_results() -> _Numbers:
    shapes = {"parameters": (9,), "covariance": (9, 9), "iterations": ()}
    shapes |= dict.fromkeys(("cost", "half_width", "rms"), ())
    shapes |= dict.fromkeys(("chi2_per_dof", "gradient_norm"), ())
    return {name: np.zeros((0, *tail)) for name, tail in shapes.items()}


def _spread(results: _Numbers, keep: Any, count: int) -> _Numbers:
    # results of the trials that were fitted, among NaN, and steps among none
    if keep.size == count:
        return results
    whole = {}
    for name, values in results.items():
        whole[name] = np.full((count, *values.shape[1:]), np.nan)
        whole[name][keep] = values
    whole["iterations"] = np.nan_to_num(whole["iterations"]).astype(int)
    return whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Data(Trials):
    # the trials that are fitted, one row each, in the scaled units of the fit
    m: Float[Array, "t 10 n"]  # monomials of the readings
    moments: Float[Array, "t 10 10"]
    leverage: Leverage
    noise: Float[Array, "t n"] | None
    shares: Float[Array, "t n"] | None  # as of `noise_shares`
    theta: Float[Array, "t 9"]  # starts
    centre: Float[Array, "t 3"]  # raw units
    scale: Float[Array, " t"]  # raw units
    condition: Float[Array, " t"]
    stretch: Float[Array, " t"]  # as of `direction_condition`


def _solve(data: _Data, options: Options) -> tuple[Any, _Numbers]:
    # iterate, summarise and judge: codes, and results in physical units
    solution, ratio = _iterate(data, options)
    summary = summarize(
        options.model, options.residual, solution.theta, data.m, data.moments,
        sigma=data.noise, loss=options.loss, ratio=ratio, shares=data.shares,
        covariance=options.covariance,
    )  # fmt: skip
    code, half_width = judge(
        solution.code, data.m, data.moments, data.noise, summary, data.shares,
        condition=data.condition, stretch=data.stretch,
    )  # fmt: skip
    sizes = np.ones((len(data.scale), 9))
    first = 0 if options.model == "symmetric" else 3
    sizes[:, first:6] = (options.g / data.scale)[:, None]
    sizes[:, 6:] = data.scale[:, None]
    parameters = solution.theta * sizes
    parameters[:, 6:] += data.centre
    matrix = summary.covariance
    if options.covariance:
        matrix = matrix * outer(sizes, sizes)
    unit = {"squared": options.g**4, "adjusted": options.g**4, "norm": options.g**2}
    results = {
        "parameters": parameters,
        "covariance": matrix,
        "cost": summary.cost * unit.get(options.residual, data.scale**2),
        "rms": summary.rms * options.g,
        "chi2_per_dof": summary.chi2_per_dof,
    }
    refused = code >= Code.NON_FINITE
    if refused.any():
        for values in results.values():
            values[refused] = np.nan
    results["half_width"] = half_width
    results["gradient_norm"] = solution.gradient_norm
    return code, results | {"iterations": solution.iterations}


def _iterate(
    data: _Data, options: Options
) -> tuple[Solution, Float[Array, "t n"] | None]:
    # Run the solver that the residual and the loss call for.
    model, residual = options.model, options.residual
    m, noise, theta, shares = data.m, data.noise, data.theta, data.shares
    if noise is not None and shares is not None:
        noise = noise * np.sqrt(shares)
    slack = _SLACK * np.finfo(float).eps * m.shape[2]
    if options.loss != "linear" or residual == "weighted":
        return minimize_reweighted(
            model, residual, options.loss, m, theta, noise, options, slack, shares
        )
    if residual in ("norm", "sampson") or options.iteration == "source":
        newton = options.method == "newton"
        goal = pose_objective(model, residual, m, shares, newton=newton)
        origin = np.zeros_like(theta)
        if options.iteration == "source":  # its bias is that of readings as they are
            origin[:, 6:] = data.centre / data.scale[:, None]
        return minimize(goal, theta, options, slack, origin), None
    leverage = data.leverage
    if residual == "adjusted" and noise is not None:
        leverage = Leverage.of(unbiased_moment_matrix(m[:, READING].mT, noise))
    return minimize_leverage(model, leverage, theta, options, slack), None
