r"""Plans of a calibration: how precise poses will be, before data is taken.

=============  ===========================  ==========================================
sensors        design                       predicted standard deviations
=============  ===========================  ==========================================
accelerometer  directions                   first-order covariance of the plain fit
                                            (`simval.theory.calibration`)
gyroscope      directions of rests and the  bound of both sensors together
               turns between them           (`simval.theory.gyroscope`), which the
                                            joint fit reaches
magnetometer   attitudes                    bound of both sensors together
                                            (`simval.theory.magnetometer`)
=============  ===========================  ==========================================

What poses of any other sensor will give, and which helps most, is said by `next_best`
of its equations (`simval.theory.estimating`). The next pose or rotation of all of them
is that of `simval.poses.best_addition`; of an accelerometer and a gyroscope, whose
noise is not known where a message names it, by rows that count alike.

Sensors are taken as ideal, but for an accelerometer that is given. A magnetometer's are
in units of gravity and of the field; M, b and the dip then have the error bars of
:math:`dM\,M^{-1}`, M db and the dip of any sensor. Moves are turned by minimum jerk.
The noise of a pose mean follows from a noise density and a hold time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
import scipy

from simval.account import (
    GRAVITY,
    Account,
    Answer,
    Fact,
    Line,
    Note,
    Reply,
    Told,
    Values,
)
from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    ReadOnly,
    finite_array,
    json_values,
    positive_number,
)
from simval.errors import InputError
from simval.geometry import compose, normalize, unit_quaternions
from simval.imu.sensor import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    forms,
)
from simval.imu.sensor.readable import (
    NORMAL_95,
    WIDE,
    accelerometer_values,
    greatest,
    matrix_rows,
    quantities,
    worst_axis,
)
from simval.moments import deviations
from simval.poses import (
    GEOMETRY_LIMIT,
    PARAMETERS,
    best_addition,
    cube_corners,
    cube_edges,
    cube_faces,
    geometry_loss,
    observability,
    one_set,
)
from simval.shapes import Float
from simval.spelling import counted, rounded
from simval.text import columns, number
from simval.theory import magnetometer
from simval.theory.calibration import calibration_moments, in_form
from simval.theory.estimating import Estimating, inverse_of, rank_of
from simval.theory.gyroscope import GYROSCOPE, MovePath, gyroscope_moments
from simval.theory.magnetometer import problem_of
from simval.turns import MATRIX, best_next_turn, judge, turn_rows, turns_of
from simval.units import HOUR, MILLIRADIAN, PPM, RADIANS_PER_DEGREE
from simval.vocabulary import Model

_PIECES: Final = 24  # of a move: a standard deviation is good to a thousandth of itself
_HEADINGS: Final = 6
GOOD: Final = "Is the plan good enough?"
HELPS: Final = "What would help most?"
AXES: Final = "Directions and axes are those of the sensor."
_TIE: Final = 1e-6  # of shares: rounding leaves less


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan(ReadOnly, Told):
    """Predicted precision of a calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the nine parameters.
    sd : Array
        Predicted standard deviation of each, (9,); infinite below rank nine.
    bound : Array
        Cramer-Rao bound on it, (9,); infinite below rank nine.
    bias : Array
        Predicted second-order bias, (9,); NaN below rank nine.
    poses : int
        Number of poses.
    rank : int
        Rank of the pose set, of nine.
    condition : float
        Condition of the pose set, eq. (P2) of `poses`.
    next_direction : Array
        Direction of the next pose that helps most, (3,).
    sd_next : Array
        Standard deviations with that pose added, (9,); infinite below rank nine.
    noise_std : float
        Noise of each axis of a pose mean, raw units.
    model : {"triangular", "upper", "symmetric"}
        Form of the parameters.
    parameters : Array
        Those of the sensor as far as it is known, (9,).
    g : float
        Gravity, m/s^2.
    geometry : float
        Factor that the worst error bar loses to the choice of poses, (P3) of `poses`.
    reading : str
        Unit of a reading, for people.
    """

    names: tuple[str, ...]
    sd: Float[Array, "9"]
    bound: Float[Array, "9"]
    bias: Float[Array, "9"]
    poses: int
    rank: int
    condition: float
    next_direction: Float[Array, "3"]
    sd_next: Float[Array, "9"]
    noise_std: float
    model: Model
    parameters: Float[Array, "9"]
    g: float
    geometry: float
    reading: str

    @property
    def matrix(self) -> Float[Array, "3 3"]:
        """M of the sensor, raw units to m/s^2, (3, 3)."""
        return forms.matrix(self.model, self.parameters)

    @property
    def intervals(self) -> Float[Array, "9 2"]:
        """Where 95 % of calibrations of such a sensor will be, (9, 2)."""
        half = NORMAL_95 * self.sd
        return np.stack([self.parameters - half, self.parameters + half], axis=-1)

    @property
    def account(self) -> Account:
        """Everything that there is to say of the plan."""
        return plan_account(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopePlan(ReadOnly, Told):
    """Predicted precision of a gyroscope's calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the twelve parameters.
    sd : Array
        Predicted standard deviation of each, (12,); infinite below full rank.
    accelerometer_sd : Array
        Of the accelerometer's nine from the same fit, (9,).
    rotations : int
        Number of rotations between rests.
    rank : int
        Rank of the rotations, of nine, eq. (N7) of `simval.turns`.
    condition : float
        Their condition.
    next_axis : Array
        Axis of the turn from the last rest that helps most, sensor axes, (3,).
    next_angle : float
        Its angle, rad.
    sd_next : Array
        Standard deviations with that turn and a rest after it, (12,).
    """

    names: tuple[str, ...]
    sd: Float[Array, "12"]
    accelerometer_sd: Float[Array, "9"]
    rotations: int
    rank: int
    condition: float
    next_axis: Float[Array, "3"]
    next_angle: float
    sd_next: Float[Array, "12"]

    @property
    def account(self) -> Account:
        """Everything that there is to say of the plan."""
        return Account(
            title="Plan of a calibration",
            said=f"{counted(self.rotations, 'rotation')} of a gyroscope",
            replies=(_turns_good(self), _next_turn(self)),
            values=_gyroscope_values(self),
            notes=_after(self),
            facts=(_rank(self),),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerPlan(ReadOnly):
    """Predicted precision of a magnetometer's calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the 22 parameters.
    sd : Array
        Predicted standard deviation of each, relative to gravity or the field, the dip
        in rad, (22,); infinite below rank 22.
    poses : int
        Number of poses.
    rank : int
        Rank of their equations, of 22.
    next_attitude : Array
        Attitude of the next pose that helps most, (4,).
    sd_next : Array
        Standard deviations with that pose added, (22,).
    """

    names: tuple[str, ...]
    sd: Float[Array, "22"]
    poses: int
    rank: int
    next_attitude: Float[Array, "4"]
    sd_next: Float[Array, "22"]


@runtime_checkable
class Informed(Protocol):
    """Anything that gives the information of its poses or moves."""

    @property
    def information(self) -> Float[Array, "b p p"]:
        """Information of each pose or move with independent noise."""


def next_best(
    given: Informed, candidates: Informed, wanted: slice = slice(None)
) -> tuple[Float[Array, "p p"], Float[Array, "p p"], int]:
    """Information before and after adding the best candidate, and its index.

    Parameters
    ----------
    given, candidates : Estimating or Local
        Equations of the poses or moves that there are, and of those that there could
        be, with the same parameters: of `Estimating` one to a row of its block, or
        linearised by the solver, `simval.imu.calibrate.equations.Problem.local`.
    wanted : slice
        Parameters whose total variance is to be least.

    Returns
    -------
    tuple
        Information of those given, the same with the best candidate (`error_bars` of
        each), and the candidate's number.
    """
    whole, parts = given.information.sum(axis=0), candidates.information
    best = best_addition(whole, parts, wanted)
    return whole, whole + parts[best], best


def error_bars(information: Float[Array, "p p"]) -> Float[Array, " p"]:
    """Least standard deviations for an information; infinite without full rank."""
    if rank_of(information) < len(information):
        return np.full(len(information), np.inf)
    return deviations(inverse_of(information))


def plan(
    directions: Any,
    noise_std: float,
    *,
    sensor: AccelerometerModel | None = None,
    g: float = 9.80665,
    form: Model = "triangular",
) -> Plan:
    """Predict the calibration from a set of poses.

    Parameters
    ----------
    directions : array_like
        Directions of the specific force, sensor axes, (n, 3), any length but zero.
    noise_std : float
        Noise of each axis of a pose mean, raw units; see `pose_noise`.
    sensor : AccelerometerModel, optional
        The sensor as far as it is known; ideal, in m/s^2, if not given.
    g : float, default 9.80665
        Gravity, m/s^2.
    form : {"triangular", "upper", "symmetric"}
        Form of the parameters.

    Returns
    -------
    Plan
        Standard deviations, rank, condition, and the next direction that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    noise_std = positive_number("noise_std", noise_std, "raw units")
    g = positive_number("g", g, "m/s^2")
    form = choice("form", form, forms.MODELS)
    u = normalize(one_set("directions", directions))
    body = _ideal_accelerometer() if sensor is None else sensor
    instance("sensor", body, AccelerometerModel)
    seen = observability(u)

    def sd(u: Float[Array, "n 3"]) -> tuple[Array, Array, Array]:
        if observability(u).rank < PARAMETERS:
            untold = np.full(PARAMETERS, np.inf)
            return untold, untold, np.nan * untold
        found = calibration_moments(body, u, g, noise_std, form=form)
        return found.sd, deviations(found.cramer_rao), found.bias

    now, bound, bias = sd(u)
    return Plan(
        names=forms.names(form), sd=now, bound=bound, bias=bias, poses=len(u),
        rank=seen.rank, condition=seen.condition, next_direction=seen.next_direction,
        sd_next=sd(np.vstack([u, seen.next_direction]))[0], noise_std=noise_std,
        model=form, g=g, geometry=geometry_loss(u),
        parameters=in_form(form, body),
        reading="m/s²" if sensor is None else "raw units",
    )  # fmt: skip


def plan_gyroscope(
    directions: Any,
    *,
    pose_std: float,
    angle_random_walk: float,
    rotation_seconds: float,
    rest_seconds: float,
    turns: tuple[Any, Any] | None = None,
    g: float = 9.80665,
    form: Model = "triangular",
) -> GyroscopePlan:
    """Predict the calibration from rests and rotations, for ideal sensors.

    Parameters
    ----------
    directions : array_like
        Directions of the specific force at the rests, sensor axes, in order, (n, 3).
    pose_std : float
        Noise of each axis of a pose mean, m/s^2; see `pose_noise`.
    angle_random_walk : float
        White noise N of the gyroscope, rad/s per root hertz.
    rotation_seconds : float
        Time of a rotation between two rests, s.
    rest_seconds : float
        Time of a rest, s.
    turns : tuple of array_like, optional
        Axes (n - 1, 3) and angles (n - 1,), rad, of the rotations, which must lead from
        each direction to the next; the shortest if not given.
    g : float, default 9.80665
        Gravity, m/s^2.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters.

    Returns
    -------
    GyroscopePlan
        Standard deviations, rank, condition, and the next rotation that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    u = normalize(one_set("directions", directions))
    unit = "rad/s per root hertz"
    walk = positive_number("angle_random_walk", angle_random_walk, unit)
    std = positive_number("pose_std", pose_std, "m/s^2")
    seconds = positive_number("rotation_seconds", rotation_seconds, "s")
    rest = positive_number("rest_seconds", rest_seconds, "s")
    axis, angle = turns_of(u) if turns is None else _given(u, *turns)
    rows = turn_rows(u[:-1], axis, angle).reshape(-1, MATRIX)
    seen = judge(rows)
    more, by = best_next_turn(rows, u[-1])

    after = _rotation(more[None] * by).inv().apply(u[-1])

    def sd(u: Array, axis: Array, angle: Array) -> Float[Array, "21"]:
        turned = judge(turn_rows(u[:-1], axis, angle).reshape(-1, MATRIX)).rank
        if turned < MATRIX or observability(u).rank < PARAMETERS:
            return np.full(21, np.inf)
        return gyroscope_moments(
            GyroscopeModel(M=np.eye(3), B=np.zeros(3)), _ideal_accelerometer(), u,
            smooth_path(axis, angle, seconds), pose_std=std,
            bias_std=walk / np.sqrt(rest * len(u)), angle_random_walk=walk, g=g,
            form=form,
        ).sd  # fmt: skip

    now = sd(u, axis, angle)
    later = sd(np.vstack([u, after]), np.vstack([axis, more]), np.append(angle, by))
    return GyroscopePlan(
        names=GYROSCOPE, sd=now[9:], accelerometer_sd=now[:9], rotations=len(angle),
        rank=seen.rank, condition=seen.condition, next_axis=more, next_angle=by,
        sd_next=later[9:],
    )  # fmt: skip


def plan_magnetometer(
    attitudes: Any, dip: float, *, accelerometer_noise: float, magnetometer_noise: float
) -> MagnetometerPlan:
    """Predict the calibration from a set of attitudes.

    The next attitude is the one of some hundred candidates that lowers the total
    variance of the magnetometer's thirteen parameters most.

    Parameters
    ----------
    attitudes : array_like
        Attitudes of the poses, world to body, world axes north, west and up, (n, 4).
    dip : float
        Angle of the field below the horizon, rad.
    accelerometer_noise, magnetometer_noise : float
        Noise of each axis of a pose mean, of gravity and of the field.

    Returns
    -------
    MagnetometerPlan
        Standard deviations, rank, and the next attitude that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    noise = (
        positive_number("accelerometer_noise", accelerometer_noise, "of gravity"),
        positive_number("magnetometer_noise", magnetometer_noise, "of the field"),
    )
    iron = MagnetometerModel(M=np.eye(3), b=np.zeros(3))

    def poses(attitudes: Any) -> Estimating:
        sensors = _ideal_accelerometer(), iron
        return magnetometer.equations_of(
            problem_of(
                *sensors, attitudes, dip, *noise, g=1.0, field=1.0, form="triangular"
            )
        )

    given, candidates = poses(attitudes), candidate_attitudes()
    whole, more, best = next_best(given, poses(candidates), slice(9, None))
    dip_last = np.append(np.ones(len(whole) - 1), np.cos(float(dip)))
    return MagnetometerPlan(
        names=(*forms.names("triangular"), *magnetometer.NAMES),
        sd=error_bars(whole) / dip_last, poses=len(given.information),
        rank=rank_of(whole), next_attitude=candidates[best],
        sd_next=error_bars(more) / dip_last,
    )  # fmt: skip


def pose_noise(
    hold: float,
    *,
    noise_density: float | None = None,
    velocity_random_walk: float | None = None,
) -> float:
    r"""Noise of the mean of a hold, from the numbers of a data sheet.

    White noise of one-sided density :math:`D` (per root hertz, as data sheets print
    it) leaves :math:`D/\sqrt{2 t}` in the mean over a time t; a velocity random walk
    :math:`W` (the Allan deviation at one second) leaves :math:`W/\sqrt{t}`, since
    :math:`W = D/\sqrt 2`. Flicker noise and drift are not in it: beyond some tens of
    seconds a longer hold gains less than this says.

    Parameters
    ----------
    hold : float
        Time of the hold that is averaged, s.
    noise_density : float, optional
        One-sided noise density D, raw units per root hertz.
    velocity_random_walk : float, optional
        Allan deviation at one second W, raw units times root second; exactly one of
        the two is needed.

    Returns
    -------
    float
        Standard deviation of each axis of the mean, raw units.

    Raises
    ------
    InputError
        If a number is not above zero, or not exactly one of the two is given.
    """
    hold = positive_number("hold", hold, "s")
    if (noise_density is None) == (velocity_random_walk is None):
        msg = (
            "give exactly one of `noise_density` (data sheet, per root hertz) and "
            "`velocity_random_walk` (Allan deviation at 1 s)"
        )
        raise InputError(msg)
    if noise_density is not None:
        density = positive_number("noise_density", noise_density, "per root hertz")
        return density / float(np.sqrt(2.0 * hold))
    walk = positive_number(
        "velocity_random_walk", velocity_random_walk, "raw unit s^.5"
    )
    return walk / float(np.sqrt(hold))


def candidate_attitudes() -> Float[Array, "n 4"]:
    """Attitudes with up along faces, edges and corners of a cube, six headings each."""
    up = np.concatenate([cube_faces(), cube_edges(), cube_corners()])
    # the shortest turn that takes the world's up to u: half way between the two
    vector = np.cross(up, [0.0, 0.0, 1.0])
    q = np.concatenate([vector, 1.0 + up[:, 2:]], axis=1)
    q[up[:, 2] < -0.99] = [1.0, 0.0, 0.0, 0.0]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    half = np.pi * np.arange(_HEADINGS) / _HEADINGS
    level = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
    return unit_quaternions("q", compose(level[None], q[:, None]).reshape(-1, 4))


def smooth_path(
    axis: Float[Array, "k 3"], angle: Float[Array, " k"], seconds: float
) -> MovePath:
    """Turns about fixed axes by minimum jerk."""
    t = np.linspace(0.0, 1.0, _PIECES + 1)
    course = t**3 * (10.0 + t * (6.0 * t - 15.0))
    turned = np.diff(course)[None, :, None] * (axis * angle[:, None])[:, None]
    return MovePath(turns=turned, seconds=np.full(turned.shape[:2], seconds / _PIECES))


def _given(
    u: Float[Array, "n 3"], axis: Any, angle: Any
) -> tuple[Float[Array, "k 3"], Float[Array, " k"]]:
    axes = normalize(finite_array("turns", axis, (len(u) - 1, 3)))
    angles = finite_array("turns", angle, (len(u) - 1,))
    arrived = _rotation(axes * angles[:, None]).inv().apply(u[:-1])
    off = np.linalg.norm(arrived - u[1:], axis=1)
    if not np.all(off < 1e-3):
        k = int(np.argmax(off >= 1e-3))
        msg = (
            f"`turns` lead {off[k]:.2g} rad away from direction {k + 1}; give "
            "directions and turns that belong together"
        )
        raise InputError(msg)
    return axes, angles


def _rotation(vectors: Float[Array, "k 3"]) -> Any:
    return scipy.spatial.transform.Rotation.from_rotvec(vectors)


def _ideal_accelerometer() -> AccelerometerModel:
    return AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))


# ---- words and JSON values

PLAN_KEYS: Final = (
    "names", "sd", "bound", "bias", "noise_std", "poses", "rank", "condition",
    "next_direction", "sd_next",
)  # fmt: skip
GYROSCOPE_KEYS: Final = (
    "names", "sd", "accelerometer_sd", "rotations", "rank", "condition",
    "next_axis", "next_angle", "sd_next",
)  # fmt: skip


def as_object(
    result: Plan | GyroscopePlan, keys: Sequence[str] = PLAN_KEYS
) -> dict[str, Any]:
    """The plan as plain JSON values; infinity becomes null."""
    return {key: json_values(getattr(result, key)) for key in keys}


def plan_account(
    result: Plan, turned: GyroscopePlan | None = None, noise: str = "noise"
) -> Account:
    """State a plan, with a gyroscope's if given; `noise` says what the noise is."""
    said = counted(result.poses, "pose")
    said += f", {counted(turned.rotations, 'rotation')}" if turned else ""
    size = f"{rounded(result.noise_std, 4)} {result.reading}"
    replies = [_poses_good(result), _next_pose(result)]
    values, notes = _accelerometer_values(result), _after(result)
    facts = [_rank(result)]
    if turned is not None:
        more = _turns_good(turned), _next_turn(turned)
        replies = [_both(*each) for each in zip(replies, more, strict=True)]
        values, notes = values + _gyroscope_values(turned), notes + _after(turned)
        facts.append(_rank(turned))
    return Account(
        title="Plan of a calibration",
        said=f"{said}, {size} of {noise} in each pose mean",
        replies=replies,
        values=values,
        notes=notes,
        facts=facts,
    )


def _poses_good(result: Plan) -> Reply:
    answer: Answer = "fail"
    if result.rank < PARAMETERS:
        headline = (
            f"No: {counted(result.poses, 'pose')} determine{'s' * (result.poses == 1)} "
            f"{result.rank} of the nine parameters, whatever the noise."
        )
        more = PARAMETERS - result.rank
        do = f"Add {more} or more, the first as below, and plan again."
        return Reply(title=GOOD, headline=headline, answer=answer, do=do)
    free = counted(result.poses - PARAMETERS, "degree")
    times = f"{np.max(result.sd / result.bound):.2f}"
    lines: tuple[str, ...] = (
        f"The worst error bar is {rounded(result.geometry, 3)} times that of as many "
        "poses spread evenly over the sphere.",
        f"No error bar is more than {times} times the Cramér-Rao bound."
        if times != "1.00"
        else "Every error bar is at the Cramér-Rao bound.",
        f"The poses leave {free} of freedom.",
    )
    percent = 1e-4 * NORMAL_95 * greatest(result)["scale factor"]  # from ppm
    said, do = f"Predicted {worst_axis(result)}.", ""
    if (np.abs(result.bias) > result.sd).any():
        said = (
            f"No: this noise, {rounded(result.noise_std, 3)} {result.reading}, is so "
            f"large against gravity, {rounded(result.g, 3)} m/s², that the prediction "
            "does not hold."
        )
        do = "Check the units of both."
        lines = ("A bias of second order is above the standard deviation.", *lines)
    elif not result.geometry <= GEOMETRY_LIMIT:
        said = (
            f"No: the worst error bar is {rounded(result.geometry)} times that of as "
            f"many poses spread evenly over the sphere. {said}"
        )
        do = "Add poses in directions not yet covered."
    elif not percent <= 100.0 * WIDE:
        said = (
            f"No: a scale will be known to {rounded(percent)} % only, at 95 %. {said}"
        )
        do = "Add poses, or lower their noise."
    else:
        answer = "pass"
        said = f"Yes: the poses determine all nine parameters. {said}"
    return Reply(title=GOOD, headline=said, answer=answer, do=do, lines=lines)


def _next_pose(result: Plan) -> Reply:
    words = f"A pose with the force along {_vector(result.next_direction)}"
    if result.rank < PARAMETERS:
        return Reply(title=HELPS, headline=f"{words}.", lines=(AXES,))
    return Reply(
        title=HELPS,
        headline=f"{words}{_gain(result)}.",
        do="Half the noise of a pose mean, or these poses four times, halves each "
        "error of the accelerometer."
        if _poses_good(result).answer == "pass"
        else "",
        lines=(AXES,),
    )


def _turns_good(result: GyroscopePlan) -> Reply:
    if not np.isfinite(result.sd).all():
        return Reply(
            title=GOOD,
            headline="No: these poses and rotations do not determine the gyroscope's "
            "matrix, whatever the noise.",
            answer="fail",
            do="For the gyroscope add the rotation below, or poses.",
        )
    own = np.eye(3, dtype=bool).ravel()
    M, bias = result.sd[:MATRIX], float(np.max(result.sd[MATRIX:]))
    kinds = (
        f"misalignment {rounded(MILLIRADIAN.factor * float(np.max(M[~own])))} mrad",
        f"scale factor {rounded(PPM.factor * float(np.max(M[own])))} ppm",
        f"bias {rounded(bias / RADIANS_PER_DEGREE * HOUR)} °/h",
    )
    return Reply(
        title=GOOD,
        headline=f"Yes: of the gyroscope (1 sd) {', '.join(kinds)}.",
        lines=("Both sensors are fitted together, and the gyroscope is ideal.",),
    )


def _next_turn(result: GyroscopePlan) -> Reply:
    words = (
        f"A turn by {np.degrees(result.next_angle):.0f}° about "
        f"{_vector(result.next_axis)} from the last pose"
    )
    gain = _gain(result) if np.isfinite(result.sd).all() else ""
    return Reply(title=HELPS, headline=f"{words}{gain}.")


def _both(first: Reply, second: Reply) -> Reply:
    # one answer for two sensors; Yes or No stands twice only if they differ
    more = second.headline
    if first.answer == second.answer:
        bare = more.removeprefix("Yes: ").removeprefix("No: ")
        more = bare[0].upper() + bare[1:]
    return Reply(
        title=first.title,
        headline=f"{first.headline} {more}",
        answer=max(first.answer, second.answer, key=GRAVITY.index),
        do=f"{first.do} {second.do}".strip(),
        lines=first.lines + second.lines,
    )


def _gain(result: Plan | GyroscopePlan) -> str:
    share = 1.0 - result.sd_next / result.sd
    best = int(np.argmax(share > share.max() - _TIE))
    name, _ = forms.ENTRIES.get(result.names[best], (result.names[best], 1.0))
    return f" lowers errors by up to {rounded(100.0 * share[best])} % ({name})"


def _vector(u: Float[Array, "3"]) -> str:
    return f"({', '.join(f'{x:.2f}' for x in u)})"


def _rank(result: Plan | GyroscopePlan) -> Fact:
    words = f"rank {result.rank} of 9"
    if result.rank == PARAMETERS:
        words += f", condition {result.condition:.3g}"
    return Fact("poses" if isinstance(result, Plan) else "rotations", words)


def _accelerometer_values(result: Plan) -> list[Values]:
    known = result.rank == PARAMETERS
    own = accelerometer_values(result, result.bound, reading=result.reading)
    return [own] if known else []


def _gyroscope_values(result: GyroscopePlan) -> list[Values]:
    if not np.isfinite(result.sd).all():
        return []
    names, sd = result.names, result.sd
    bias = quantities(names[MATRIX:], np.zeros(3), sd[MATRIX:])
    rows = matrix_rows("M", "", names[:MATRIX], np.eye(3).ravel(), sd[:MATRIX])
    how = "rate = M (reading - B), rad/s"
    return [
        Values(title="gyroscope", how=how, lines=[*rows, Line("bias B", "rad/s", bias)])
    ]


def _after(result: Plan | GyroscopePlan) -> list[Note]:
    # the errors now and with the pose or rotation that helps most
    if not np.isfinite(result.sd).all():
        return []
    poses = isinstance(result, Plan)
    columns_of = [result.sd, result.sd_next]
    heads = ["", "predicted sd", f"with the next {'pose' if poses else 'rotation'}"]
    rows = [[f"{x:.4g}" for x in row] for row in zip(*columns_of, strict=True)]
    if isinstance(result, Plan):
        heads.append("bias")
        for row, name, bias, sd in zip(
            rows, result.names, result.bias, result.sd, strict=True
        ):
            row.append(number(forms.ENTRIES[name][1] * bias, 2, sd))
    names = [forms.ENTRIES.get(name, (name, 1.0))[0] for name in result.names]
    table = [heads, *([name, *row] for name, row in zip(names, rows, strict=True))]
    what = "accelerometer" if poses else "gyroscope"
    words = f"Predicted errors of the {what}, in the units of its parameters:"
    least = [-2, *[9] * (len(heads) - 1)]
    return [Note(words=words, matrix="\n".join(columns(table, *least)))]
