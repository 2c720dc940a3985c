r"""Accelerometer, gyroscope and magnetometer of the same rests in one fit.

**The rows of three sensors that an unknown attitude leaves, and their noise.**

A pose gives six readings and a move three angles; the attitudes of n rests take 3n of
these 6n + 3(n - 1) away. What is left are the three equations of each pose (M1) and
three of each gap. Two of a gap are those of gravity (N5). The third turns the field
v_k of one pose into the next and looks along the horizontal direction across it,

.. math:: e_{k3} = a_{k+1}^T (C_k^T v_k - v_{k+1}), \qquad
   a = \frac{u \times v}{|u \times v|}, \tag{J1}

so a gyroscope tells the headings of all poses to one, and a magnetometer is compared
with itself. All are functions of the same pose means: with L the map from the unit
noises of six axes a pose to the rows, their covariance is :math:`LL^T` and what the
moves add (`gyroscope.covariance`), so that a pose is counted once.

The readings of both vectors are in the scaled units of the magnetometer's fit; the 34
parameters stand in the order: nine of the accelerometer, the rows of :math:`M_m`,
:math:`b_m`, s, and then the rows of the gyroscope's M, and B.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, physical_array
from simval.calibrate.estimate import Estimate, nine_axis_text
from simval.calibrate.factors import NOT_JUDGED, NoiseFactors, Residuals, judged
from simval.calibrate.gyroscope.covariance import (
    Given,
    Setting,
    checked_pose_std,
    setting_of,
    spread,
)
from simval.calibrate.gyroscope.fit import Gain, assembled, gain
from simval.calibrate.gyroscope.moves import Moves, taken
from simval.calibrate.gyroscope.residuals import (
    Gravity,
    Rows,
    across,
    gravity,
)
from simval.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.calibrate.gyroscope.turn import Turn, turn
from simval.calibrate.magnetometer.calibration import Options, Scaled, scale
from simval.calibrate.magnetometer.equations import (
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    Corrected,
    Readings,
    corrected,
    jacobian,
    reach,
    residual,
)
from simval.calibrate.magnetometer.evidence import natural_sd
from simval.calibrate.magnetometer.result import OWN_NAMES, MagnetometerFit
from simval.errors import InputError, RefusedError
from simval.geometry import normalize
from simval.sensor import forms
from simval.shapes import Float

ACCELEROMETER, GYROSCOPE, MAGNETOMETER = slice(0, 9), slice(9, 21), slice(21, 34)
"""Where the parameters of each sensor stand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisFit(Estimate):
    """Accelerometer, gyroscope and magnetometer in one fit, one recording or a batch.

    The 34 parameters, the dip in rad, have a covariance with the stated noises; see
    `Estimate`.

    Attributes
    ----------
    chi2_per_dof : Array
        Weighted sum of squares of all rows by degree of freedom, (...).
    step : Array
        The last step, over its standard deviation, (...).
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which covariance and chi-square are; empty for a batch.
    gyroscope : GyroscopeFit
        The gyroscope with the numbers of this fit; its `dof` and `chi2_per_dof` are
        those of all rows.
    magnetometer : MagnetometerFit
        The magnetometer with the parameters and the covariance of this fit. What is
        said of single poses, `chi_square`, `dof`, `pose_chi_square`, `disturbed` and
        `findings`, is of the fit beside the accelerometer alone.
    """

    advice: ClassVar[str] = (
        "the fits of two sensors disagree by more than their noise; look for rests "
        "that moved, a disturbed field and the noise that is stated"
    )

    chi2_per_dof: Float[Array, "..."]
    step: Float[Array, "..."]
    noise: NoiseFactors
    gyroscope: GyroscopeFit
    magnetometer: MagnetometerFit

    def __str__(self) -> str:
        return nine_axis_text(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 34: the accelerometer's, then with gyro and mag before them."""
        others = (
            (f"gyro_{name}" for name in NAMES),
            (f"mag_{name}" for name in OWN_NAMES),
        )
        return (*forms.names(self.gyroscope.model), *others[0], *others[1])

    def as_object(self) -> dict[str, Any]:
        """Return what the sensors' own objects do not hold, as JSON can hold it.

        Returns
        -------
        dict
            Names, covariance of all parameters, chi-square and status of one fit.
        """
        return {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "chi2_per_dof": float(self.chi2_per_dof),
            "status": str(self.status),
            "iterations": int(self.iterations),
        }


EACH = 3  # rows of a pose, and of a gap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """What is fitted: moves, both sensors' pose means, and all noises."""

    moves: Moves
    setting: Setting
    readings: Readings
    accelerometer_std: Float[Array, "t n 3"]  # scaled, as the readings
    magnetometer_std: Float[Array, "t n 3"]

    def noisier(
        self, accelerometer: float, magnetometer: float, gyroscope: float
    ) -> "Problem":
        """The same with so many times the noise of each sensor."""
        return replace(
            self,
            setting=self.setting.noisier(accelerometer, gyroscope),
            accelerometer_std=self.accelerometer_std * accelerometer,
            magnetometer_std=self.magnetometer_std * magnetometer,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Parameters of all sensors."""

    poses: Float[Array, "t 22"]  # accelerometer and magnetometer, scaled
    M: Float[Array, "t 3 3"]
    B: Float[Array, "t 3"]  # less the centre of the moves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Rows at a state, and their generalised estimator."""

    r: Float[Array, "t r"]
    gain: Gain
    L: Float[Array, "t r m"]  # unit noises of the poses to the rows, six each
    at: Corrected
    C: Float[Array, "t k 3 3"]  # turns of the moves
    u: Float[Array, "t n 3"]


def linearise(problem: Problem, state: State) -> Linear:
    """Rows, derivative, covariance and estimator at a state."""
    setting, moves = problem.setting, problem.moves
    found = gravity(
        setting.model, state.poses[:, ACCELEROMETER], problem.readings.accelerometer,
        setting.g,
    )  # fmt: skip
    at = corrected(setting.model, state.poses, problem.readings)
    moved = turn(moves.statistics, state.M, state.B)
    rows = gap_rows(problem, found, at, moved)
    noise = spread(rows, moved, moves, setting, state.M, state.B)
    t = len(rows.e)
    slopes = jacobian(setting.model, state.poses, at).reshape(t, -1, PARAMETERS)
    J, V, L = assembled(rows, noise, setting, slopes, pose_noise(problem, at))
    r = [rows.e, residual(at, state.poses[:, DIP]).reshape(t, -1)]
    if setting.free == 12:
        r.append(state.B - setting.bias_value)
    return Linear(
        r=np.concatenate(r, axis=1),
        gain=gain(J, V, weighted=True),
        L=L,
        at=at,
        C=moved.C,
        u=found.u,
    )


def residuals(linear: Linear) -> Residuals:
    """Rows of one fit, and whose noise is in them."""
    L = linear.L[0].reshape(len(linear.L[0]), -1, 2, 3)
    root = np.linalg.inv(linear.gain.white[0])
    return Residuals.of_rests_and_moves(
        linear.r[0], linear.gain.J[0], root @ root.T,
        {
            "accelerometer": (L[:, :, 0], ACCELEROMETER),
            "magnetometer": (L[:, :, 1], slice(ACCELEROMETER.stop, PARAMETERS)),
        },
        (linear.C.shape[1], EACH, slice(PARAMETERS, None)),
    )  # fmt: skip


def gap_rows(problem: Problem, found: Gravity, at: Corrected, moved: Turn) -> Rows:
    """Rows of the gaps, eqs. (N5) and (J1), by all parameters and by the pose means."""
    t, n = found.u.shape[:2]
    # of each rest: the vectors that are compared, and what they depend on
    w = np.stack([found.u, found.u, at.field], axis=2)
    by_theta = np.zeros((t, n, EACH, 3, PARAMETERS))
    by_theta[:, :, :2, :, ACCELEROMETER] = found.u_by_theta[:, :, None]
    matrix = np.einsum("ij,tnk->tnijk", np.eye(3), at.x_m)
    by_theta[:, :, 2, :, MATRIX] = matrix.reshape(t, n, 3, 9)
    by_theta[:, :, 2, :, IRON] = -at.matrix_m[:, None]
    by_pose = np.zeros((t, n, EACH, 3, 6))
    up_noise = found.u_by_reading * problem.accelerometer_std[..., None, :]
    by_pose[:, :, :2, :, :3] = up_noise[:, :, None]
    by_pose[:, :, 2, :, 3:] = (
        at.matrix_m[:, None] * (problem.magnetometer_std[..., None, :])
    )
    sideways = normalize(np.cross(found.u, at.field))[:, 1:]
    E = np.concatenate([across(found.u[:, 1:]), sideways[:, :, None]], axis=2)
    EC = E @ np.swapaxes(moved.C, -1, -2)  # by the vectors at the start
    by_turn = np.cross(EC, w[:, :-1])
    first, last = EC[..., None, :], E[..., None, :]
    theta = (first @ by_theta[:, :-1] - last @ by_theta[:, 1:])[..., 0, :]
    e = np.vecdot(EC, w[:, :-1]) - np.vecdot(E, w[:, 1:])
    k, gap = n - 1, np.arange(n - 1)
    pull = np.zeros((t, k, EACH, n, 6))
    pull[:, gap, :, gap] = np.moveaxis((first @ by_pose[:, :-1])[..., 0, :], 1, 0)
    pull[:, gap, :, gap + 1] = -np.moveaxis((last @ by_pose[:, 1:])[..., 0, :], 1, 0)
    return Rows(
        e=e.reshape(t, -1),
        by_turn=by_turn,
        by_gyroscope=(by_turn @ moved.slopes).reshape(t, EACH * k, 12),
        by_accelerometer=theta.reshape(t, EACH * k, PARAMETERS),
        by_pose=pull.reshape(t, EACH * k, 6 * n),
        E=E,
    )


def pose_noise(problem: Problem, at: Corrected) -> Float[Array, "t r m"]:
    """Map from unit noises to the equations of the poses, eq. (M4)."""
    t, n = at.up.shape[:2]
    whole, each = np.zeros((t, n, EACH, n, 6)), np.arange(n)
    whole[:, each, :, each] = np.moveaxis(
        reach(at, problem).reshape(t, n, EACH, 6), 1, 0
    )
    return whole.reshape(t, EACH * n, 6 * n)


MOST_STEPS: Final = 12
SETTLED: Final = 1e-6
"""Of a standard deviation. A step leaves the relative noise of the readings of what it
was, a percent: four take it there from the fits of two sensors."""
ROUNDED: Final = 1e-13  # of the parameters' own size
FAR: Final = 0.3  # of the parameters' own size: a step that no fit of two sensors needs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """Where the steps ended; a trial that goes astray stays where it was."""

    state: State
    linear: Linear
    chi2: Float[Array, " t"]
    step: Float[Array, " t"]  # the last, over its standard deviation
    converged: Any  # bool, (t,)
    iterations: int


def solve(problem: Problem, state: State) -> Solved:
    """Steps from the fits of two sensors each until none is left."""
    size = _sizes(problem, state)
    settled = np.zeros(len(size), dtype=bool)
    astray = np.zeros(len(size), dtype=bool)
    for count in range(1, MOST_STEPS + 1):
        linear = linearise(problem, state)
        sd = np.sqrt(np.diagonal(linear.gain.covariance, axis1=-2, axis2=-1))
        step = -(linear.gain.K @ linear.r[..., None])[..., 0]
        relative = np.max(np.abs(step) / size, axis=1)
        astray |= ~(relative <= FAR)
        step[astray] = 0.0
        taken = np.max(np.abs(step) / sd, axis=1)
        settled = (taken <= SETTLED) | (relative <= ROUNDED)
        step[settled] = 0.0  # the numbers are those of the linearisation
        if np.all(settled | astray) or count == MOST_STEPS:
            break
        state = _moved(state, step)
    return Solved(
        state=state,
        linear=linear,
        chi2=linear.gain.chi2(linear.r),
        step=np.where(astray, np.nan, taken),
        converged=settled & ~astray,
        iterations=count,
    )


def _moved(state: State, step: Float[Array, "t p"]) -> State:
    matrix = step[:, PARAMETERS : PARAMETERS + 9].reshape(-1, 3, 3)
    rest = step[:, PARAMETERS + 9 :]
    return State(
        poses=state.poses + step[:, :PARAMETERS],
        M=state.M + matrix,
        B=state.B + rest if rest.shape[1] else state.B,
    )


def _sizes(problem: Problem, state: State) -> Float[Array, "t p"]:
    # the readings of the poses are scaled to one; the rates are what the moves need
    t = len(state.M)
    scale = np.linalg.norm(state.M, axis=(1, 2))[:, None]
    S, seconds = problem.moves.statistics[:, :, :3], problem.moves.seconds
    way = np.sqrt((S * S).sum(axis=2)).sum(axis=-1)
    rate = (way / seconds).mean(axis=1)[:, None]
    unit = np.maximum(np.abs(state.poses), 1.0)
    parts: list[Array] = [unit, np.broadcast_to(scale, (t, 9))]
    if problem.setting.free == 12:
        parts.append(np.broadcast_to(rate, (t, 3)))
    return np.concatenate(parts, axis=1)


COUNT: Final = 34
_NORMAL_95: Final = 1.959964
_ORDER = np.r_[0:9, 22:34, 9:22]
"""Accelerometer, gyroscope, magnetometer; the fit has the gyroscope last."""


def empty(
    good: Any, gyroscope: GyroscopeFit, magnetometer: MagnetometerFit
) -> dict[str, Any]:
    """Numbers of trials that are not fitted yet."""
    t = len(good)
    made: dict[str, Any] = {
        "parameters": np.full((t, COUNT), np.nan),
        "covariance": np.full((t, COUNT, COUNT), np.nan),
        "gap_angles": np.full((t, gyroscope.gap_angles.shape[-1]), np.nan),
    }
    made |= {name: np.full(t, np.nan) for name in ("chi2", "half_width", "step")}
    made["iterations"] = np.zeros(t, int)
    said = np.where(
        np.atleast_1d(gyroscope.converged),
        np.atleast_1d(magnetometer.status),
        np.atleast_1d(gyroscope.status),
    )
    made["status"] = said.astype(object)
    return made


def write(
    result: dict[str, Any], good: Any, found: Solved, problem: Problem, scaled: Scaled
) -> None:
    """Write the numbers of fitted trials among them, in their own units."""
    state, linear = found.state, found.linear
    t = len(state.M)
    own = linear.gain.covariance
    whole = np.zeros((t, COUNT, COUNT))
    free = own.shape[1]
    whole[:, :free, :free] = own
    if free < COUNT:
        last = np.arange(free, COUNT)
        whole[:, last, last] = problem.setting.bias_std**2
    inner = whole[:, :PARAMETERS, :PARAMETERS]
    natural = natural_sd(problem.setting.model, state.poses, linear.at, inner)
    values, _ = scaled.physical(state.poses, inner)
    slope = np.ones((t, COUNT))
    slope[:, :PARAMETERS] = scaled.sizes
    slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
    whole *= slope[:, :, None] * slope[:, None, :]
    parameters = np.concatenate(
        [values, state.M.reshape(t, 9), state.B + problem.moves.centre], axis=1
    )
    result["parameters"][good] = parameters[:, _ORDER]
    result["covariance"][good] = whole[:, _ORDER[:, None], _ORDER]
    result["half_width"][good] = _NORMAL_95 * natural.max(axis=1)
    turned = (linear.u[:, :-1, None] @ linear.C)[:, :, 0]
    sine = np.linalg.norm(np.cross(turned, linear.u[:, 1:]), axis=-1)
    result["gap_angles"][good] = np.arcsin(np.minimum(sine, 1.0))
    result["chi2"][good] = found.chi2
    result["step"][good] = found.step
    result["iterations"][good] = found.iterations
    result["status"][good] = np.where(found.converged, "converged", "max iterations")


def result_of(
    result: dict[str, Any],
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    dof: int,
    noise: NoiseFactors,
) -> NineAxisFit:
    """Return all trials, or the one of a recording, with each sensor's own part."""
    if gyroscope.parameters.ndim == 1:
        result = {name: value[0] for name, value in result.items()}
    parameters, covariance = result["parameters"], result["covariance"]
    ratio = result["chi2"] / dof if dof > 0 else result["chi2"] * np.nan
    poses = np.r_[0:9, 21:34]  # accelerometer and magnetometer
    shared = {key: result[key] for key in ("status", "iterations")} | {"noise": noise}
    return NineAxisFit(
        parameters=parameters,
        covariance=covariance,
        dof=dof,
        chi2_per_dof=ratio,
        step=result["step"],
        gyroscope=replace(
            gyroscope,
            parameters=parameters[..., 9:21],
            accelerometer=parameters[..., :9],
            covariance=covariance[..., :21, :21],
            dof=dof,
            chi2_per_dof=ratio,
            gap_angles=result["gap_angles"],
            step=result["step"],
            **shared,
        ),
        magnetometer=replace(
            magnetometer,
            parameters=parameters[..., poses],
            covariance=covariance[..., poses[:, None], poses],
            half_width=result["half_width"],
            **shared,
        ),
        **shared,
    )


_FLOOR: Final = 1e-11  # of the readings' own size, as for the other noises


def calibrate_nine_axis(
    moves: Moves,
    poses: Any,
    fields: Any,
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    *,
    pose_std: Any,
    field_std: Any,
    angle_random_walk: Any = None,
    bias_random_walk: float = 0.0,
    known_bias: Any = None,
    bias_std: Any = None,
) -> NineAxisFit:
    """Fit three sensors to the same rests and the moves between them.

    All 34 parameters in one generalised least-squares fit of three equations a pose and
    three a move, from the fits of two sensors each.

    Parameters
    ----------
    moves : Moves
        Path statistics, see `moves_between`.
    poses, fields : array_like
        Mean reading of the accelerometer and of the magnetometer in each rest, raw
        units, (n, 3) or (trials, n, 3).
    gyroscope : GyroscopeFit
        Of the same moves and poses, ``estimator="joint"``; its model of the bias is
        kept.
    magnetometer : MagnetometerFit
        Of the same poses, in the same form of the accelerometer.
    pose_std, field_std : float or array_like
        Noise of each axis of a pose mean of either sensor, raw units: one number, (n,)
        or (n, 3).
    angle_random_walk : float or array_like, optional
        As in `calibrate_gyroscope`, as are the following.
    bias_random_walk : float, default 0.0
        K, raw units times root hertz.
    known_bias : array_like, optional
        Raw units, (3,): where the gyroscope's bias was kept.
    bias_std : float or array_like, optional
        How well the rests tell the bias, raw units.

    Returns
    -------
    NineAxisFit
        Parameters, covariance and status.

    Raises
    ------
    InputError
        If an argument is not usable, or the fits are not of the same recordings.
    RefusedError
        If the residuals of one recording are far beyond the noise of a sensor.
    """
    instance("moves", moves, Moves)
    instance("gyroscope", gyroscope, GyroscopeFit)
    instance("magnetometer", magnetometer, MagnetometerFit)
    pair = _pair(moves, poses, fields)
    _require_alike(gyroscope, magnetometer, len(pair[0]))
    count = pair[0].shape[1]
    noise = (
        checked_pose_std(pose_std, count),
        checked_pose_std(field_std, count, "field_std"),
    )
    given = Given(
        pose_std=pose_std, angle_random_walk=angle_random_walk,
        bias_random_walk=bias_random_walk, bias=gyroscope.bias,
        known_bias=known_bias, bias_std=bias_std,
    )  # fmt: skip
    setting = setting_of(
        moves, pair[0], given, model=gyroscope.model, residual="weighted", g=1.0,
        estimator="joint",
    )  # fmt: skip
    good = _usable(gyroscope, magnetometer)
    result = empty(good, gyroscope, magnetometer)
    told = NOT_JUDGED
    if good.any():
        part = moves if good.all() else taken(moves, good)
        chosen = replace(setting, bias_value=setting.bias_value[good])
        scaled = _scaled((pair[0][good], pair[1][good]), noise, magnetometer)
        problem = _problem(part, chosen, scaled, noise)
        found = solve(problem, _start(part, scaled, gyroscope, magnetometer, good))
        write(result, good, found, problem, scaled)
        if gyroscope.parameters.ndim == 1 and all(np.all(std > 0.0) for std in noise):
            found, told = _weighed(problem, found)
            write(result, good, found, problem.noisier(*told.factor), scaled)
    dof = 2 * EACH * count - COUNT
    return result_of(result, gyroscope, magnetometer, dof, told)


def _weighed(problem: Problem, stated: Solved) -> tuple[Solved, NoiseFactors]:
    # by the noise that the residuals ask for, where it is more than stated
    found, noise = judged(
        stated,
        lambda last, factor: solve(problem.noisier(*factor), last.state),
        lambda last: residuals(last.linear),
    )
    if not found.converged[0]:  # residuals of no solution
        return stated, NOT_JUDGED
    if noise.refusal:
        raise RefusedError(noise.refusal)
    return found, noise


def _pair(moves: Moves, poses: Any, fields: Any) -> tuple[Array, Array]:
    named = {"poses": poses, "fields": fields}
    pair = [physical_array(name, value, (None, 3)) for name, value in named.items()]
    pair = [each[None] if each.ndim == 2 else each for each in pair]
    shape = moves.rest_rates.shape
    if not pair[0].shape == pair[1].shape == shape:
        msg = (
            f"`moves` has {shape[0]} trial(s) of {shape[1]} rests, `poses` the shape "
            f"{pair[0].shape} and `fields` {pair[1].shape}; give the mean of both "
            "sensors in each rest"
        )
        raise InputError(msg)
    return pair[0], pair[1]


def _require_alike(
    gyroscope: GyroscopeFit, magnetometer: MagnetometerFit, trials: int
) -> None:
    sizes = [
        np.atleast_2d(fit.parameters).shape[0] for fit in (gyroscope, magnetometer)
    ]
    alike = gyroscope.model == magnetometer.model and sizes == [trials, trials]
    if gyroscope.estimator == "joint" and alike:
        return
    msg = (
        f"`gyroscope` holds {sizes[0]} fit(s) ({gyroscope.estimator}, form "
        f"{gyroscope.model}) and `magnetometer` {sizes[1]} (form {magnetometer.model}) "
        f"for {trials} trial(s); give a fit of each for each trial, in the same form, "
        'and the gyroscope\'s with estimator="joint"'
    )
    raise InputError(msg)


def _usable(gyroscope: GyroscopeFit, magnetometer: MagnetometerFit) -> Any:
    parts = [gyroscope.accelerometer, gyroscope.parameters, magnetometer.parameters]
    finite = [np.isfinite(np.atleast_2d(each)).all(axis=1) for each in parts]
    return np.logical_and.reduce(finite)


def _scaled(
    pair: tuple[Array, Array],
    noise: tuple[Array, Array],
    magnetometer: MagnetometerFit,
) -> Scaled:
    options = Options(
        g=magnetometer.g, field=magnetometer.field, model=magnetometer.model,
        hemisphere="unstated", max_iterations=1, known=None,
    )  # fmt: skip
    level = [np.sqrt((std**2).mean(axis=1)) for std in noise]
    return scale(pair, (level[0], level[1]), slice(None), options)


def _problem(
    moves: Moves, setting: Setting, scaled: Scaled, noise: tuple[Array, Array]
) -> Problem:
    units = scaled.sizes[:, 6, None, None], scaled.sizes[:, 18, None, None]
    stds = [
        # the readings are of unit size here
        np.maximum(std / unit, _FLOOR)
        for std, unit in zip(noise, units, strict=True)
    ]
    return Problem(
        moves=moves,
        setting=setting,
        readings=scaled.readings,
        accelerometer_std=stds[0],
        magnetometer_std=stds[1],
    )


def _start(
    moves: Moves,
    scaled: Scaled,
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    good: Any,
) -> State:
    values = np.atleast_2d(magnetometer.parameters)[good]
    values[:, ACCELEROMETER] = np.atleast_2d(gyroscope.accelerometer)[good]
    values[:, DIP] = np.sin(values[:, DIP])
    own = np.atleast_2d(gyroscope.parameters)[good]
    return State(
        poses=(values - scaled.shifts) / scaled.sizes,
        M=own[:, :9].reshape(-1, 3, 3),
        B=own[:, 9:] - moves.centre,
    )
