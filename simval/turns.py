r"""Sets of rotations: what they determine of a gyroscope's matrix.

A turn by the angle :math:`\alpha` about a fixed axis a, in body axes, by a gyroscope
whose matrix is off by the relative error :math:`D = \mathrm{d}M\,M^{-1}`, ends off by

.. math:: \theta = S\, D a,\quad
   S = \alpha\, aa^T + \sin\alpha\,(I - aa^T) + (1 - \cos\alpha)\,[a\times], \tag{N7}

of which the direction of gravity u at the start of the turn shows
:math:`u \times \theta`: two equations on the three numbers D a. A bias that is off by b
(rad/s) over T seconds at an even rate adds :math:`-S\,(bT)/\alpha`. Nine combinations
of D are to be told, and three of b where no rest tells them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, ReadOnly, finite_array, outer
from simval.errors import InputError
from simval.geometry import cross_matrix, normalize
from simval.poses import (
    best_addition,
    cube_corners,
    cube_edges,
    cube_faces,
    fibonacci_sphere,
)
from simval.shapes import Float

MATRIX: Final = 9  # parameters of M
_RANK_TOLERANCE: Final = 1e-8  # relative; rounding leaves 1e-15
_ANGLES: Final = np.radians([45.0, 90.0, 135.0, 180.0])  # a hand or a table turns by
_CANDIDATES: Final = 100  # axes, 18 degrees apart
_ALIKE: Final = 0.95  # cosine from which a missing combination is called by a name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnObservability(ReadOnly):
    """What a set of rotations determines of a gyroscope's matrix.

    Attributes
    ----------
    rank : int
        Rank of the rows by D, 0 to 9; or with the bias, 0 to 12.
    condition : float
        Greatest singular value over the least; infinite below full rank.
    singular_values : Array
        All, greatest first, (p,).
    least_seen : Array
        Relative error D that the turns see least, of length 1, (3, 3).
    """

    rank: int
    condition: float
    singular_values: Float[Array, " p"]
    least_seen: Float[Array, "3 3"]


def turn_sensitivity(
    axis: Float[Array, "... 3"], angle: Float[Array, "..."]
) -> Float[Array, "... 3 3"]:
    """Matrix S of eq. (N7)."""
    a = normalize(finite_array("axis", axis, (3,)))
    alpha = finite_array("angle", angle, ())[..., None, None]
    along = outer(a, a)
    side = np.sin(alpha) * (np.eye(3) - along)
    return alpha * along + side + 2.0 * np.sin(alpha / 2.0) ** 2 * cross_matrix(a)


def turn_rows(
    start: Float[Array, "... 3"],
    axis: Float[Array, "... 3"],
    angle: Float[Array, "..."],
    *,
    bias: bool = False,
) -> Float[Array, "... 3 p"]:
    """The two rows that a turn adds for D and b T, u x theta."""
    S = cross_matrix(normalize(start)) @ turn_sensitivity(axis, angle)
    a = normalize(axis)
    by_matrix = S[..., :, :, None] * a[..., None, None, :]
    rows = by_matrix.reshape(*by_matrix.shape[:-2], MATRIX)
    if not bias:
        return rows
    return np.concatenate([rows, -S / np.asarray(angle)[..., None, None]], axis=-1)


def turns_of(
    directions: Float[Array, "n 3"],
) -> tuple[Float[Array, "k 3"], Float[Array, " k"]]:
    """Axes and angles of the shortest turns from each direction to the next.

    Between opposite ones any axis across them is the shortest; one is chosen.

    Raises
    ------
    InputError
        If two neighbours are the same, so that nothing is turned.
    """
    u = normalize(finite_array("directions", directions, (None, 3)))
    # gravity turns from u to v in body axes when the body turns the other way
    axis = np.cross(u[1:], u[:-1])
    sine, cosine = np.linalg.norm(axis, axis=-1), np.vecdot(u[1:], u[:-1])
    same = (sine <= _RANK_TOLERANCE) & (cosine > 0.0)
    if same.any():
        k = int(np.argmax(same))
        msg = (
            f"directions {k} and {k + 1} are the same, so nothing is turned "
            "between them; leave one out, or give axes and angles"
        )
        raise InputError(msg)
    other = np.eye(3)[np.argmin(np.abs(u[1:]), axis=1)]
    opposite = sine <= _RANK_TOLERANCE
    axis = np.where(opposite[:, None], np.cross(u[1:], other), axis)
    return normalize(axis), np.arctan2(sine, cosine)


def judge(rows: Float[Array, "r p"]) -> TurnObservability:
    """Rank, condition and the weakest combination, from rows for D (and b)."""
    p = rows.shape[-1]
    padded = np.concatenate([rows, np.zeros((p, p))])
    _, values, vectors = np.linalg.svd(padded, full_matrices=False)
    rank = int(np.count_nonzero(values > _RANK_TOLERANCE * values[0]))
    last = vectors[-1, :MATRIX]
    size = max(float(np.linalg.norm(last)), np.finfo(float).tiny)
    return TurnObservability(
        rank=rank,
        condition=float(values[0] / values[-1]) if rank == p else np.inf,
        singular_values=values,
        least_seen=(last / size).reshape(3, 3),
    )


def missing(found: TurnObservability) -> str:
    """Name the relative error of the matrix that the rotations show least."""
    D = found.least_seen
    common = abs(float(np.trace(D))) / np.sqrt(3.0)
    twist = np.linalg.norm(D - D.T) / 2.0
    _, values, axes = np.linalg.svd(D)
    if common > _ALIKE:
        return "the common scale of the three axes"
    if twist > _ALIKE:
        return "a rotation of the gyroscope's axes against the accelerometer's"
    if values[0] > _ALIKE:
        named = ", ".join(f"{x:.2f}" for x in axes[0])
        return f"rates about the axis ({named}), which the moves never turn about alone"
    rows = "; ".join(" ".join(f"{x:.2f}" for x in row) for row in D)
    return f"the combination [{rows}] of the entries of dM M^-1"


def best_next_turn(
    rows: Float[Array, "r p"], start: Float[Array, "3"]
) -> tuple[Float[Array, "3"], float]:
    """Axis and angle of a further turn that lowers the variances of D most.

    All rows count alike: of 22 random plans the standard deviation of M after the turn
    is within 1.14 of the best by the whole bound, which takes a thousand times as long.
    """
    rows = rows[:, :MATRIX]
    named = [cube_faces(), cube_edges(), cube_corners()]
    axes = np.concatenate([*named, fibonacci_sphere(_CANDIDATES)])
    axis = np.repeat(axes, len(_ANGLES), axis=0)
    angle = np.tile(_ANGLES, len(axes))
    added = turn_rows(np.broadcast_to(start, axis.shape), axis, angle)
    best = best_addition(rows.T @ rows, added.mT @ added)
    return axis[best], float(angle[best])
