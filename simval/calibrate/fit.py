r"""Calibrate an accelerometer from the norms of its readings at rest.

The readings are moved to their mean and scaled to unit size, gravity becomes 1, the
closed-form ellipsoid (`start`) gives the start and the solver the answer, which is
scaled back. Trials are worked in blocks that fit the cache; a trial's numbers do not
depend on its block.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import checks
from simval.calibrate.arguments import (
    CONDITION_LIMIT,
    Options,
    checked_noise,
    checked_readings,
)
from simval.calibrate.evidence import weigh
from simval.calibrate.frame import direction_condition, normalized
from simval.calibrate.leverage import Leverage, minimize_leverage
from simval.calibrate.moments import in_lanes, moment_matrix, unbiased_moment_matrix
from simval.calibrate.objective import pose_objective
from simval.calibrate.outliers import find_outliers
from simval.calibrate.residuals import SLOPES, noise_shares
from simval.calibrate.result import FitResult
from simval.calibrate.reweight import minimize_reweighted
from simval.calibrate.solver import Code, Solution, minimize
from simval.calibrate.start import fit_ellipsoid
from simval.calibrate.uncertainty import summarize
from simval.poses import PARAMETERS
from simval.sensor import forms
from simval.shapes import Float

_EXPLAINED = 4.0  # standard deviations; of 100 clean poses one in 160 sets has more
_BLOCK = 1 << 16  # poses worked at once: 5 MB of monomials
# By how much rounding may raise a cost, in eps by pose. Measured on 2700 fits of every
# solver and four residuals: statuses and number of steps are the same from 16 to 4096;
# with 0 there are twice the steps.
_SLACK = 64.0


_Block = dict[str, Any]  # physical results of a block of trials; NaN where refused


def calibrate(
    poses: Any,
    g: float = 9.80665,
    model: str = "triangular",
    method: str = "lm",
    residual: str = "squared",
    noise_std: Any = None,
    *,
    step: float = 1.0,
    loss: str = "linear",
    tolerance: float = 1e-12,
    max_iterations: int = 200,
    full_scale: float | None = None,
    repeats: bool = False,
    condition_limit: float = CONDITION_LIMIT,
    covariance: bool = True,
) -> FitResult:
    """Fit scale, misalignment and bias to readings at rest, one set or a batch.

    Parameters
    ----------
    poses : array_like
        Mean reading of each pose, raw units, sensor axes, (n, 3), or (trials, n, 3).
    g : float, default 9.80665
        Local gravity, m/s^2.
    model : {"triangular", "upper", "symmetric"}
        Form of the parameters, see `simval.sensor.forms`.
    method : {"lm", "gauss-newton", "newton"}
        Solver, see `simval.calibrate.solver`.
    residual : {"squared", "norm", "weighted", "sampson", "adjusted"}
        Residual, see `simval.calibrate.residuals`; adjusted needs `noise_std`.
    noise_std : float or array_like, optional
        Standard deviation of each axis of a pose mean, raw units, one number or one
        for each pose (n,). With it the covariance is that of a known sigma;
        without, Type A, from the residuals.
    step : float, default 1.0
        Fraction of each step taken, above 0 and up to 1 (damped Gauss-Newton).
    loss : {"linear", "huber", "soft_l1", "cauchy"}
        Robust loss, for the squared and weighted residuals.
    tolerance : float, default 1e-12
        Relative stop rule, eq. (L1) of the solver.
    max_iterations : int, default 200
        Most steps for a trial.
    full_scale : float, optional
        Greatest reading of the sensor, raw units; poses at or beyond are refused.
    repeats : bool, default False
        Accept readings that repeat in every bit, as single quantised samples do.
    condition_limit : float, default 1e3
        Greatest condition number of the poses that is accepted.
    covariance : bool, default True
        Work out the covariance; False leaves it NaN, for a simulation that needs the
        parameters only.

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
    The squared residual is that of the three source derivations. Norms say nothing
    of a rotation of the axes or of the sign of an axis, and a wrong `g` is a wrong
    scale: K is proportional to `g`, T and B do not depend on it.
    """
    options = Options(
        model=model, method=method, residual=residual, loss=loss, g=g, step=step,
        tolerance=tolerance, max_iterations=max_iterations, full_scale=full_scale,
        repeats=repeats, condition_limit=condition_limit, covariance=covariance,
    )  # fmt: skip
    readings = checked_readings(poses)
    count = readings.shape[-2]
    sigma = checked_noise(noise_std, count, options.residual)
    batch = readings.reshape(-1, count, 3)
    size = max(1, _BLOCK // count)
    parts = [
        _fit_block(batch[i : i + size], sigma, options)
        for i in range(0, len(batch), size)
    ]
    numbers = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
    code, half_width = numbers.pop("code"), numbers.pop("half_width")
    single = readings.ndim == 2
    if single and code[0] >= Code.NON_FINITE:
        checks.refuse(
            int(code[0]), batch[0],
            full_scale=options.full_scale, limit=options.condition_limit,
            condition=float(numbers["condition"][0]), half_width=float(half_width[0]),
            suspects=_suspects(batch[0], sigma, options),
        )  # fmt: skip
    numbers["status"] = checks.status_text(code)
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
    )


def _suspects(
    poses: Float[Array, "n 3"], sigma: Float[Array, " n"] | None, options: Options
) -> list[tuple[int, float]]:
    # outliers without which the set would not be refused, and how far off they are
    if len(poses) <= PARAMETERS or not np.isfinite(poses).all():
        return []
    outliers = find_outliers(poses, sigma)
    off = np.abs(outliers.standardized)
    keep = ~outliers.flagged
    # what the stated noise explains is no outlier, however well the others agree
    explained = sigma is not None and np.any(off[~keep] < _EXPLAINED)
    if keep.all() or explained:
        return []
    std = None if sigma is None else sigma[keep]
    rest = _fit_block(poses[None, keep], std, options)
    if rest["code"][0] >= Code.NON_FINITE:
        return []
    return [(int(k), float(off[k])) for k in np.flatnonzero(outliers.flagged)]


def _fit_block(
    poses: Float[Array, "t n 3"], sigma: Float[Array, " n"] | None, options: Options
) -> _Block:
    # Fit a block of trials, refused ones set aside.
    code = checks.screen(poses, full_scale=options.full_scale, repeats=options.repeats)
    block = _empty(code, len(poses))
    rows = in_lanes(poses)
    block["raw_range"] = np.stack([rows.min(axis=0), rows.max(axis=0)]).T
    # repeated poses are looked at as well: what they leave open says more
    keep = np.flatnonzero((code == Code.CONVERGED) | (code == Code.DUPLICATES))
    if keep.size == 0:
        return block
    z, centre, scale = normalized(poses if keep.size == len(poses) else poses[keep])
    moments = moment_matrix(z)
    ellipsoid = fit_ellipsoid(moments)
    theta = forms.from_gram(options.model, ellipsoid.gram, ellipsoid.bias)
    usable = np.isfinite(theta).all(axis=-1) & np.asarray(ellipsoid.proper, dtype=bool)
    condition, stretch = direction_condition(options.model, theta, moments, usable)
    block["condition"][keep] = condition
    checked = code[keep]
    checked[~(condition <= options.condition_limit)] = int(Code.CONDITION)
    checked[~usable] = int(Code.NOT_ELLIPSOID)
    checked[~np.asarray(ellipsoid.determined, dtype=bool)] = int(Code.RANK)
    block["code"][keep] = checked
    good = checked == Code.CONVERGED
    if not good.any():
        return block
    data = _Data(
        z=z, moments=moments, leverage=ellipsoid.leverage,
        noise=None if sigma is None else sigma / scale[:, None],
        shares=noise_shares(options.residual, sigma), theta=theta, centre=centre,
        scale=scale, condition=condition, stretch=stretch,
    )  # fmt: skip
    if not good.all():
        keep, data = keep[good], data.take(good)
    _solve(block, keep, data, options)
    return block


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Data:
    # the trials that are fitted, one row each, in the scaled units of the fit
    z: Float[Array, "t n 3"]  # (t, n, 3)
    moments: Float[Array, "t 10 10"]  # (t, 10, 10)
    leverage: Leverage
    noise: Float[Array, "t n"] | None  # (t, n)
    shares: Float[Array, " n"] | None  # (n,), as of `noise_shares`
    theta: Float[Array, "t 9"]  # starts
    centre: Float[Array, "t 3"]  # raw units
    scale: Float[Array, " t"]  # raw units
    condition: Float[Array, " t"]
    stretch: Float[Array, " t"]  # as of `direction_condition`

    def take(self, rows: Any) -> "_Data":
        every: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(_Data)}
        del every["shares"]
        leverage = every.pop("leverage").take(rows)
        taken = {k: v[rows] for k, v in every.items() if v is not None}
        return replace(self, leverage=leverage, **taken)


def _solve(block: _Block, keep: Any, data: _Data, options: Options) -> None:
    # iterate, summarise, judge, and write the physical results into the block
    solution, ratio = _iterate(data, options)
    summary = summarize(
        options.model, options.residual, solution.theta, data.z, sigma=data.noise,
        loss=options.loss, ratio=ratio, shares=data.shares,
        covariance=options.covariance,
    )  # fmt: skip
    sizes = np.ones((len(keep), 9))
    first = 0 if options.model == "symmetric" else 3
    sizes[:, first:6] = (options.g / data.scale)[:, None]
    sizes[:, 6:] = data.scale[:, None]
    evidence = weigh(
        data.z, data.moments, data.noise, summary, data.shares,
        condition=data.condition, stretch=data.stretch,
    )  # fmt: skip
    block["code"][keep] = evidence.judge(solution.code)
    block["half_width"][keep] = evidence.half_width
    block["iterations"][keep] = solution.iterations
    block["parameters"][keep] = solution.theta * sizes
    block["parameters"][keep, 6:] += data.centre
    if options.covariance:
        units = sizes[:, :, None] * sizes[:, None, :]
        block["covariance"][keep] = summary.covariance * units
    unit = {"squared": options.g**4, "adjusted": options.g**4, "norm": options.g**2}
    block["cost"][keep] = summary.cost * unit.get(options.residual, data.scale**2)
    block["rms"][keep] = summary.rms * options.g
    block["chi2_per_dof"][keep] = summary.chi2_per_dof
    block["gradient_norm"][keep] = solution.gradient_norm
    refused = keep[block["code"][keep] >= Code.NON_FINITE]
    for field in ("parameters", "covariance", "cost", "rms", "chi2_per_dof"):
        block[field][refused] = np.nan


def _iterate(
    data: _Data, options: Options
) -> tuple[Solution, Float[Array, "t n"] | None]:
    # Run the solver that the residual and the loss call for.
    model, residual, rules = options.model, options.residual, options.rules
    z, noise, theta, shares = data.z, data.noise, data.theta, data.shares
    if noise is not None and shares is not None:
        noise = noise * np.sqrt(shares)
    slack = _SLACK * float(np.finfo(float).eps) * z.shape[1]
    if options.loss != "linear" or residual == "weighted":
        return minimize_reweighted(
            model, residual, options.loss, z, theta, noise, rules, slack, shares
        )
    if residual in SLOPES:
        newton = rules.method == "newton"
        goal = pose_objective(model, residual, z, shares, newton=newton)
        return minimize(goal, theta, rules, slack), None
    leverage = data.leverage
    if residual == "adjusted" and noise is not None:
        leverage = Leverage.of(unbiased_moment_matrix(z, noise))
    return minimize_leverage(model, leverage, theta, rules, slack), None


def _empty(code: Any, count: int) -> _Block:
    shapes: dict[str, tuple[int, ...]] = {"parameters": (9,), "covariance": (9, 9)}
    shapes |= dict.fromkeys(("cost", "half_width", "rms", "chi2_per_dof"), ())
    shapes["gradient_norm"] = ()
    block: _Block = {k: np.full((count, *v), np.nan) for k, v in shapes.items()}
    block |= {"iterations": np.zeros(count, int), "condition": np.full(count, np.inf)}
    return {"code": code, **block}
