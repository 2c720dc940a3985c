r"""Pose sets: directions of gravity in the axes of the sensor.

A direction is the unit vector of the specific force in sensor coordinates; a body
at rest in a pose reads ``g`` times it.

What a pose set can tell is judged on the Jacobian of :math:`|M(y-B)|^2/g^2` of an
ideal sensor by its nine parameters, misalignments, relative scales and biases in
units of g; one row for each direction u,

.. math:: j(u) = 2\,[u_x u_y,\ u_x u_z,\ u_y u_z,\ u_x^2,\ u_y^2,\ u_z^2,\
   -u_x,\ -u_y,\ -u_z].  \tag{P1}

Its condition is the one of the Frobenius norm, by the number of parameters,

.. math:: \kappa = \|J\|_F \|J^+\|_F / 9 \ge 1,  \tag{P2}

which is 1 where all nine combinations are seen equally well and otherwise grows as the
root of the total variance; it lies between a ninth of the greatest singular value over
the least, and that ratio.

Against as many poses spread evenly over the sphere, :math:`N_0 = n E[jj^T]`, u uniform
on it, the worst parameter's error bar loses by the choice of poses the factor

.. math:: \ell = \max_i \sqrt{(N^{-1})_{ii} / (N_0^{-1})_{ii}}, \qquad
   N = \sum j j^T.  \tag{P3}
"""

from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np

from simval.arguments import instance, whole_number
from simval.arrays import Array, ReadOnly, finite_array, outer, physical_array
from simval.errors import InputError
from simval.files import MOST_DOCUMENT, read_text
from simval.geometry import normalize
from simval.shapes import Float
from simval.spelling import counted
from simval.text import read_whole

PARAMETERS = 9
MOST = 10_000_000  # directions at once: a quarter of a gigabyte
# Of 1000 sets of 20 random directions all over the sphere 99 % lose at most 4.1, of
# 24 3.1; of poses in one half of the sphere the best of 200 sets lost 7.3.
GEOMETRY_LIMIT = 5.0
_RANK_TOLERANCE = 1e-8  # relative; rounding leaves 1e-15, a pose 1 arcsecond off 5e-6
_SAME_DIRECTION = np.radians(5.0)  # decides the words of a message only
# 7 to 8 degrees apart. Twice as many, or half, change the variance that the next pose
# leaves by 0.2 % at most (mean of 200 sets of 12 random poses).
_CANDIDATES = 600
# Of the average information of a candidate, and of a whole parameter: negligible.
_UNTOLD, _NEVER_TOLD = 1e-6, 1e-12
_ALIKE = 1e-6  # relative: rounding of a total variance leaves 1e-8 at most


def fibonacci_sphere(count: int) -> Float[Array, "count 3"]:
    r"""Directions spread evenly over the sphere, along a golden spiral.

    Parameters
    ----------
    count : int
        Number of directions, 1 or more.

    Returns
    -------
    Array
        Unit vectors, (count, 3), from near +z to near -z.

    Raises
    ------
    InputError
        If `count` is no whole number, or out of range.

    Notes
    -----
    Direction k has :math:`z = 1 - (2k + 1)/n` and the azimuth
    :math:`\pi (1 + \sqrt 5)(k + 1/2)`, the lattice of Gonzalez, "Measurement of areas
    on a sphere using Fibonacci and latitude-longitude lattices" (2010): each stands for
    an equal area, and none has a neighbour at its own height.
    """
    count = whole_number("count", count, 1, MOST)
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def random_directions(
    count: int, rng: "np.random.Generator"
) -> Float[Array, "count 3"]:
    """Directions drawn uniformly from the sphere."""
    count = whole_number("count", count, 0, MOST)
    instance("rng", rng, np.random.Generator)
    return normalize(rng.standard_normal((count, 3)))


def cube_faces() -> Float[Array, "6 3"]:
    """Six directions along the axes: the classical six-position set."""
    return np.concatenate([np.eye(3), -np.eye(3)])


def axis_orders() -> Float[Array, "48 3 3"]:
    """Matrices that exchange axes and change their signs, all 48 of them."""
    signs = np.array(list(product((1.0, -1.0), repeat=3)))
    orders = np.eye(3)[list(permutations(range(3)))]
    return (orders[:, None] * signs[:, :, None]).reshape(48, 3, 3)


def cube_edges() -> Float[Array, "12 3"]:
    """Twelve directions to the middles of a cube's edges."""
    signs = [(a, b) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    rows = [[0.0, a, b] for a, b in signs]
    rows += [[a, 0.0, b] for a, b in signs]
    rows += [[a, b, 0.0] for a, b in signs]
    return normalize(np.array(rows))


def cube_corners() -> Float[Array, "8 3"]:
    """Eight directions to the corners of a cube."""
    grid = np.array(np.meshgrid(*[[1.0, -1.0]] * 3)).reshape(3, 8).T
    return normalize(grid)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observability(ReadOnly):
    """Observability of the nine parameters of a calibration in a pose set.

    Attributes
    ----------
    rank : int
        Rank of the Jacobian (P1), 0 to 9; a calibration needs 9.
    condition : float
        Its condition, eq. (P2); infinite below rank nine.
    singular_values : Array
        All nine, greatest first, (9,).
    jacobian : Array
        The Jacobian itself, (n, 9).
    """

    rank: int
    condition: float
    singular_values: Float[Array, "9"]
    jacobian: Float[Array, "n 9"]

    @property
    def next_direction(self) -> Float[Array, "3"]:
        """Direction of a further pose that lowers the total variance most, (3,)."""
        return best_next_direction(self.jacobian)


def direction_jacobian(directions: Float[Array, "... n 3"]) -> Float[Array, "... n 9"]:
    """Derivative of the squared norm by the nine parameters, eq. (P1)."""
    u = physical_array("directions", directions, (None, 3))
    products = u[..., [0, 0, 1]] * u[..., [1, 2, 2]]
    return 2.0 * np.concatenate([products, u * u, -u], axis=-1)


def observability(directions: Float[Array, "n 3"]) -> Observability:
    """Judge a pose set before any data is taken."""
    u = normalize(one_set("directions", directions))
    jacobian = direction_jacobian(u)
    padded = np.concatenate([jacobian, np.zeros((PARAMETERS, PARAMETERS))])
    values = np.linalg.svd(padded, compute_uv=False)
    rank = int(np.count_nonzero(values > _RANK_TOLERANCE * values[0]))
    condition = np.inf
    if rank == PARAMETERS:
        spread = np.linalg.norm(values) * np.linalg.norm(1.0 / values)
        condition = float(spread) / PARAMETERS
    return Observability(
        rank=rank,
        condition=condition,
        singular_values=values,
        jacobian=jacobian,
    )


def geometry_loss(directions: Float[Array, "n 3"]) -> float:
    """Factor by which the worst error bar exceeds that of even poses, eq. (P3)."""
    # moments of a uniform direction: 1/3 of u_i^2, 1/15 of u_i^2 u_j^2, 1/5 of u_i^4
    even = np.zeros((PARAMETERS, PARAMETERS))
    even[:3, :3] = np.eye(3) / 15.0
    even[3:6, 3:6] = (1.0 + 2.0 * np.eye(3)) / 15.0
    even[6:, 6:] = np.eye(3) / 3.0
    best = np.diagonal(np.linalg.inv(4.0 * even)) / len(directions)
    rows = direction_jacobian(directions)
    if np.linalg.matrix_rank(rows) < PARAMETERS:
        return float(np.inf)
    root = np.linalg.pinv(rows)
    return float(np.sqrt(np.max(np.sum(root * root, axis=1) / best)))


def one_set(name: str, directions: Any) -> Float[Array, "n 3"]:
    """Check the directions of one pose set."""
    array = finite_array(name, directions, (None, 3))
    if array.ndim != 2 or len(array) == 0:
        msg = f"`{name}` has shape {array.shape}; give those of one set, (n, 3)"
        raise InputError(msg)
    return array


def best_addition(
    given: Float[Array, "p p"],
    added: Float[Array, "k p p"],
    wanted: slice = slice(None),
) -> int:
    """Index of the candidate that lowers the total variance most.

    The A-optimal choice by the information of what there is and of each candidate, in
    units in which the parameters are of one size. Where no single candidate makes the
    rank full, every total is infinite, and the choice is the D-optimal one: the rank
    and then the determinant of what is told, the limit of a prior (a small part of a
    candidate's average) that goes to zero. Of two as good the first is taken.

    Notes
    -----
    Least totals below full rank (A-optimal on what is told) leave the next additions
    worse off: followed to full rank from three random poses, 1.4 times the variance.
    """
    size = np.sqrt(np.diagonal(given) + np.linalg.diagonal(added).max(axis=0))
    size = np.where(size > 0.0, size, 1.0)
    sizes = np.outer(size, size)
    parts = added / sizes
    later = given / sizes + parts
    values = np.linalg.eigvalsh(later)
    full = values[:, 0] > _RANK_TOLERANCE * values[:, -1]
    score = np.full(len(parts), np.inf)
    if full.any():
        variance = np.linalg.diagonal(np.linalg.inv(later[full])) / size**2
        score[full] = np.log(variance[:, wanted].sum(axis=1))
    else:
        prior = _UNTOLD * parts.mean(axis=0) + _NEVER_TOLD * np.eye(len(size))
        score = -np.linalg.slogdet(later + prior)[1]
    return int(np.flatnonzero(score <= score.min() + _ALIKE)[0])


def best_next_direction(jacobian: Float[Array, "n 9"]) -> Float[Array, "3"]:
    """Direction that lowers the sum of the nine variances most."""
    named = [cube_faces(), cube_edges(), cube_corners()]
    candidates = np.concatenate([*named, fibonacci_sphere(_CANDIDATES)])
    jacobian = physical_array("jacobian", jacobian, (None, PARAMETERS))
    given = jacobian.reshape(-1, PARAMETERS)
    rows = direction_jacobian(candidates)
    return candidates[best_addition(given.T @ given, outer(rows, rows))]


def describe(directions: Float[Array, "n 3"]) -> str:
    """Describe a pose set for a message."""
    distinct: list[Array] = []
    for u in normalize(one_set("directions", directions)):
        if all(float(u @ v) < np.cos(_SAME_DIRECTION) for v in distinct):
            distinct.append(u)
    cosines = np.abs(np.array(distinct) @ np.array(distinct).T)
    facing = np.sum(cosines > np.cos(2.0 * _SAME_DIRECTION), axis=1)
    across = np.sum(cosines < np.sin(2.0 * _SAME_DIRECTION), axis=1)
    if len(distinct) == 6 and np.all(facing == 2) and np.all(across == 4):
        return "the six faces of a cube"
    return counted(len(distinct), "different direction")


def named_poses(text: str) -> Float[Array, "n 3"]:
    """Directions of a pose set by its name, as `simval plan --poses` takes it."""
    sets = {"faces": cube_faces, "edges": cube_edges, "corners": cube_corners}
    parts = []
    for name in text.split("+"):
        kind, _, count = name.strip().partition(":")
        if kind in sets and not count:
            parts.append(sets[kind]())
        elif kind == "fibonacci" and 0 < (number := read_whole(count) or 0) <= 100_000:
            parts.append(fibonacci_sphere(number))
        else:
            msg = (
                f"`--poses` has {name.strip()!r}; it must be fibonacci:N with N from 1 "
                "to 100000, faces, edges or corners, joined by +"
            )
            raise InputError(msg)
    return np.concatenate(parts)


def read_directions(path: Path) -> Float[Array, "n 3"]:
    """Read rows of x, y and z from a text file."""
    try:
        lines = read_text(path, MOST_DOCUMENT).replace(",", " ").splitlines()
        rows = [[float(x) for x in line.split()] for line in lines if line.strip()]
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give a file of rows x y z"
        raise InputError(msg) from None
    except ValueError as error:
        msg = f"{path} has something that is not a number ({error}); rows are x y z"
        raise InputError(msg) from None
    if not rows or any(len(row) != 3 for row in rows):
        msg = f"{path} must have rows of three numbers x y z, and at least one"
        raise InputError(msg)
    if not np.isfinite(rows).all():
        msg = f"{path} has a number that is not finite; rows are x y z"
        raise InputError(msg)
    return np.array(rows)
