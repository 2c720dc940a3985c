r"""Calibrate a magnetometer on the axes of the accelerometer beside it.

Both sensors' pose means are moved to their middle and scaled to unit size, gravity and
the field become 1, the closed form (`start`) gives the start and the solver the answer,
which is scaled back. Trials are worked in blocks that fit the cache; a trial's numbers
do not depend on its block.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.arguments import checked_time
from simval.calibrate.factors import (
    NOT_JUDGED,
    NoiseFactors,
    Residuals,
    judged,
)
from simval.calibrate.magnetometer import refusals
from simval.calibrate.magnetometer.arguments import (
    Options,
    checked_pair,
    checked_std,
    refuse_repeated,
)
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    reach,
)
from simval.calibrate.magnetometer.few import solve
from simval.calibrate.magnetometer.findings import Found, Single, look
from simval.calibrate.magnetometer.result import MagnetometerFit
from simval.calibrate.magnetometer.scaling import Scaled, scale
from simval.calibrate.magnetometer.summary import (
    STATUS_NAMES,
    Code,
    Summary,
    judge,
    seen_over_stated,
    summarize,
)
from simval.shapes import Float

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
    hemisphere: str = "unstated",
    known: Any = None,
    model: str = "triangular",
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
        each pose (n,).
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
    bars are by what they show (`simval.calibrate.factors`), except beside a `known`
    accelerometer; chi-squares and findings are by what is stated.
    """
    options = Options(
        g=g, field=field, model=model, hemisphere=hemisphere,
        max_iterations=max_iterations, known=known,
    )  # fmt: skip
    pair = checked_pair(accelerometer, magnetometer, options.known)
    count, single = pair[0].shape[-2], pair[0].ndim == 2
    noise = (
        checked_std("accelerometer_std", accelerometer_std, count),
        checked_std("magnetometer_std", magnetometer_std, count),
    )
    times = checked_time(time, count)
    batch = tuple(readings.reshape(-1, count, 3) for readings in pair)
    if single:
        named = {"accelerometer": pair[0], "magnetometer": pair[1]}
        refusals.refuse_still(named)
        refuse_repeated(*pair)
    size = max(1, _BLOCK // count)
    parts = [
        _fit_block(scale(batch, noise, slice(i, i + size), options), options)
        for i in range(0, len(batch[0]), size)
    ]
    numbers = {k: np.concatenate([p.numbers[k] for p in parts]) for k in _SHAPES}
    found = Found(
        pose_chi_square=np.zeros(0), disturbed=(), findings=(), steady_p_value=np.nan
    )
    noise_factors = NOT_JUDGED
    if single:
        weighed, noise_factors = _weighed(parts[0], options)
        for name in ("parameters", "covariance", "half_width", "code"):
            numbers[name] = weighed.numbers[name]
        code = int(numbers["code"][0])
        if code > Code.MAX_ITERATIONS:
            _refuse(code, named, parts[0], noise)
        found = look(_single(parts[0], times, options))
        numbers = {name: value[0] for name, value in numbers.items()}
    status = STATUS_NAMES[numbers.pop("code")]
    return MagnetometerFit(
        model=options.model,
        g=options.g,
        field=options.field,
        dof=parts[0].dof,
        status=status,
        pose_chi_square=found.pose_chi_square,
        disturbed=found.disturbed,
        findings=found.findings,
        steady_p_value=found.steady_p_value,
        assumption=ASSUMPTIONS[options.hemisphere],
        noise=noise_factors,
        **numbers,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Block:
    # what came of a block of trials
    numbers: dict[str, Any]
    scaled: Scaled
    theta: Float[Array, "t 22"]
    summary: Summary
    dof: int


_SHAPES: dict[str, tuple[int, ...]] = {
    "parameters": (PARAMETERS,),
    "covariance": (PARAMETERS, PARAMETERS),
    "chi_square": (),
    "half_width": (),
    "iterations": (),
    "code": (),
}


def _fit_block(scaled: Scaled, options: Options) -> _Block:
    readings, prior = scaled.readings, scaled.prior
    solution, sure = solve(options.model, readings, prior, options.max_iterations)
    theta = _twin(solution.theta, options.hemisphere)
    equations = 3 * readings.accelerometer.shape[1] + (0 if prior is None else 9)
    dof = equations - PARAMETERS
    summary = summarize(options.model, theta, readings, prior, dof)
    code = judge(summary, theta, solution.converged, options.hemisphere)
    code = np.where(sure | (code > Code.MAX_ITERATIONS), code, int(Code.AMBIGUOUS))
    code = np.where(scaled.finite, code, int(Code.NON_FINITE))
    bad = code > Code.MAX_ITERATIONS
    parameters, covariance = scaled.physical(theta, summary.covariance)
    numbers = {
        "parameters": parameters,
        "covariance": covariance,
        "chi_square": summary.chi_square.copy(),
        "half_width": summary.half_width.copy(),
    }
    for value in numbers.values():
        value[bad] = np.nan
    numbers |= {"code": code, "iterations": solution.iterations}
    return _Block(numbers=numbers, scaled=scaled, theta=theta, summary=summary, dof=dof)


def _weighed(block: _Block, options: Options) -> tuple[_Block, NoiseFactors]:
    # one set by the noise that its residuals ask for, where it is more than stated
    def fit(_: _Block, factor: Any) -> _Block:
        return _fit_block(block.scaled.noisier(*factor), options)

    if block.numbers["code"][0] != Code.CONVERGED or options.known is not None:
        return block, NOT_JUDGED
    return judged(block, fit, _residuals)


def _residuals(block: _Block) -> Residuals:
    # whitened equations of the first trial, and whose noise is in them
    here, readings = block.summary.here, block.scaled.readings
    own = np.einsum(
        "nij,njsm->nism", here.whiten[0], reach(block.summary.at, readings)[0]
    )
    count, each = len(own), np.arange(len(own))
    spread = np.zeros((count, 3, count, 2, 3))
    spread[each, :, each] = own
    L = spread.reshape(3 * count, count, 2, 3)
    return Residuals.of_rests_and_moves(
        here.rows[0], here.slopes[0], np.eye(3 * count),
        {
            "accelerometer": (L[:, :, 0], ACCELEROMETER),
            "magnetometer": (L[:, :, 1], slice(ACCELEROMETER.stop, PARAMETERS)),
        },
    )  # fmt: skip


def _twin(theta: Float[Array, "t 22"], hemisphere: str) -> Float[Array, "t 22"]:
    # (M, s) and (-M, -s) fit alike: the start took det M > 0
    if hemisphere == "unstated":
        return theta
    down = theta[:, DIP] > 0.0
    turned = np.array(theta)
    turned[:, MATRIX] *= -1.0
    turned[:, DIP] *= -1.0
    return np.where((down == (hemisphere == "north"))[:, None], theta, turned)


def _refuse(
    code: int, named: dict[str, Array], block: _Block, noise: tuple[Array, Array]
) -> None:
    scaled = block.scaled.readings
    refusals.refuse(
        code, named,
        half_width=float(block.summary.half_width[0]),
        widest=int(block.summary.widest[0]),
        sine=float(block.theta[0, DIP]),
        factor=float(seen_over_stated(block.summary.chi_square, block.dof)[0]),
        noise=float(
            max(scaled.accelerometer_std.max(), scaled.magnetometer_std.max())
        ),
    )  # fmt: skip


def _single(block: _Block, time: Float[Array, " n"], options: Options) -> Single:
    matrix = block.numbers["parameters"][0, MATRIX].reshape(3, 3)
    iron = np.linalg.norm(matrix @ block.numbers["parameters"][0, IRON])
    return Single(
        model=options.model,
        theta=block.theta[0],
        readings=block.scaled.readings,
        prior=block.scaled.prior,
        summary=block.summary,
        dof=block.dof,
        time=time,
        converged=bool(block.numbers["code"][0] == Code.CONVERGED),
        iron=float(iron / options.field),
    )
