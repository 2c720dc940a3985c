r"""Plan a gyroscope's calibration: what rests and moves will give.

The predicted standard deviations are the Cramer-Rao bound of both sensors together
(`simval.theory.gyroscope`), which the joint fit reaches. Moves are turned by minimum
jerk, by the shortest way from each direction to the next unless axes are given.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from simval.arrays import Array, finite_array, frozen, positive_number
from simval.errors import InputError
from simval.geometry import normalize
from simval.poses import PARAMETERS, observability, one_set
from simval.sensor import AccelerometerModel, GyroscopeModel
from simval.shapes import Float
from simval.theory.gyroscope import GYROSCOPE, MovePath, gyroscope_moments
from simval.turns import MATRIX, best_next_turn, judge, turn_rows, turns_of

_PIECES: Final = 24  # of a move: a standard deviation is good to a thousandth of itself


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopePlan:
    """Predicted quality of a gyroscope's calibration.

    Attributes
    ----------
    names : tuple of str
        Names of the twelve parameters.
    sd : Array
        Predicted standard deviation of each, (12,); infinite below full rank.
    accelerometer_sd : Array
        Of the accelerometer's nine from the same fit, (9,).
    moves : int
        Number of moves.
    rank : int
        Rank of the moves, of nine, eq. (N7) of `simval.turns`.
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
    moves: int
    rank: int
    condition: float
    next_axis: Float[Array, "3"]
    next_angle: float
    sd_next: Float[Array, "12"]

    def __post_init__(self) -> None:
        for name in ("sd", "accelerometer_sd", "next_axis", "sd_next"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def plan_gyroscope(
    directions: Any,
    *,
    pose_std: float,
    angle_random_walk: float,
    move_seconds: float,
    rest_seconds: float,
    turns: tuple[Any, Any] | None = None,
    g: float = 9.80665,
    form: str = "triangular",
) -> GyroscopePlan:
    """Predict what rests and the moves between them will give, for ideal sensors.

    Parameters
    ----------
    directions : array_like
        Directions of the specific force at the rests, sensor axes, in order, (n, 3).
    pose_std : float
        Noise of each axis of a pose mean, m/s^2; see `pose_noise`.
    angle_random_walk : float
        White noise N of the gyroscope, rad/s per root hertz.
    move_seconds : float
        Time of a move, s.
    rest_seconds : float
        Time of a rest, s.
    turns : tuple of array_like, optional
        Axes (n - 1, 3) and angles (n - 1,), rad, of the moves, which must lead from
        each direction to the next; the shortest if not given.
    g : float, default 9.80665
        Gravity, m/s^2.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters.

    Returns
    -------
    GyroscopePlan
        Standard deviations, rank, condition, and the next turn that helps most.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    u = normalize(one_set("directions", directions))
    unit = "rad/s per root hertz"
    walk = positive_number("angle_random_walk", angle_random_walk, unit)
    std = positive_number("pose_std", pose_std, "m/s^2")
    seconds = positive_number("move_seconds", move_seconds, "s")
    rest = positive_number("rest_seconds", rest_seconds, "s")
    axis, angle = turns_of(u) if turns is None else _given(u, *turns)
    rows = turn_rows(u[:-1], axis, angle).reshape(-1, MATRIX)
    found = judge(rows)
    more, by = best_next_turn(rows, u[-1])
    after = _rotation(more[None] * by).inv().apply(u[-1])

    def predicted(
        u: Float[Array, "n 3"], axis: Float[Array, "k 3"], angle: Float[Array, " k"]
    ) -> Float[Array, "21"]:
        full = judge(turn_rows(u[:-1], axis, angle).reshape(-1, MATRIX)).rank == MATRIX
        if not full or observability(u).rank < PARAMETERS:
            return np.full(21, np.inf)
        sensors = (
            GyroscopeModel(M=np.eye(3), B=np.zeros(3)),
            AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3)),
        )
        return gyroscope_moments(
            *sensors,
            u,
            smooth_path(axis, angle, seconds),
            pose_std=std,
            bias_std=walk / np.sqrt(rest * len(u)),
            angle_random_walk=walk,
            g=g,
            form=form,
        ).sd

    sd = predicted(u, axis, angle)
    extended = np.vstack([axis, more]), np.append(angle, by)
    return GyroscopePlan(
        names=GYROSCOPE,
        sd=sd[9:],
        accelerometer_sd=sd[:9],
        moves=len(angle),
        rank=found.rank,
        condition=found.condition,
        next_axis=more,
        next_angle=by,
        sd_next=predicted(np.vstack([u, after]), *extended)[9:],
    )


def smooth_path(
    axis: Float[Array, "k 3"], angle: Float[Array, " k"], seconds: float
) -> MovePath:
    """Moves by minimum jerk about fixed axes."""
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
