r"""Unit quaternions, attitude matrices and the attitude error between them.

Convention, fixed here for the whole package: a quaternion is unit, vector part
first, scalar last, :math:`q = [e; s]`. It carries the reference frame to the body
frame,

.. math:: b = A(q) r, \quad
   A(q) = (s^2 - e^T e) I + 2 e e^T - 2 s [e\times]  \tag{G1}

and composition follows the source paper (Peng and Choukroun, eq. 38),

.. math:: q_1 * q_2 = [s_1 e_2 + s_2 e_1 + e_1 \times e_2;\ s_1 s_2 - e_1^T e_2],
   \quad A(q_1 * q_2) = A(q_2) A(q_1).  \tag{G2}

`A(q)` is the transpose of SciPy's ``Rotation.from_quat(q).as_matrix()``. `q` and
`-q` are the same attitude, so compare by `attitude_error`, never by element.
"""

import numpy as np

from simval.arrays import Array, finite_array
from simval.errors import InputError


def normalize(v: Array) -> Array:
    """Vectors scaled to unit length.

    Parameters
    ----------
    v : Array
        Vectors or quaternions, (..., n), none of them zero.

    Returns
    -------
    Array
        Unit vectors, (..., n).

    Raises
    ------
    InputError
        If a vector is zero or not finite.
    """
    v = finite_array("v", v, (None,))
    largest = np.max(np.abs(v), axis=-1, keepdims=True)  # no overflow, no underflow
    if not np.all(largest > 0.0):
        first = tuple(int(i) for i in np.argwhere(largest[..., 0] == 0.0)[0])
        msg = f"the vector at index {first} is zero; it has no direction, so remove it"
        raise InputError(msg)
    scaled = v / largest
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


def attitude_matrix(q: Array) -> Array:
    """Matrix that takes reference coordinates to body coordinates, eq. (G1).

    Parameters
    ----------
    q : Array
        Unit quaternions, vector first, (..., 4).

    Returns
    -------
    Array
        Orthogonal matrices, (..., 3, 3).
    """
    q = np.asarray(q)
    e, s = q[..., :3], q[..., 3, None, None]
    outer = e[..., :, None] * e[..., None, :]
    squared = np.sum(e * e, axis=-1)[..., None, None]
    return (s * s - squared) * np.eye(3) + 2.0 * outer - 2.0 * s * cross_matrix(e)


def cross_matrix(v: Array) -> Array:
    """Matrix of the cross product, ``cross_matrix(v) @ w == cross(v, w)``.

    Parameters
    ----------
    v : Array
        Vectors, (..., 3).

    Returns
    -------
    Array
        Skew-symmetric matrices, (..., 3, 3).
    """
    v = np.asarray(v)
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def compose(q1: Array, q2: Array) -> Array:
    """Composition of quaternions, eq. (G2): first `q1`, then `q2`.

    Parameters
    ----------
    q1, q2 : Array
        Quaternions, vector first, (..., 4).

    Returns
    -------
    Array
        Quaternions, (..., 4).
    """
    q1, q2 = np.asarray(q1), np.asarray(q2)
    e1, s1 = q1[..., :3], q1[..., 3:]
    e2, s2 = q2[..., :3], q2[..., 3:]
    vector = s1 * e2 + s2 * e1 + np.cross(e1, e2)
    scalar = s1 * s2 - np.sum(e1 * e2, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def conjugate(q: Array) -> Array:
    """Inverse of unit quaternions.

    Parameters
    ----------
    q : Array
        Quaternions, vector first, (..., 4).

    Returns
    -------
    Array
        Quaternions with the vector part negated, (..., 4).
    """
    return np.asarray(q) * np.array([-1.0, -1.0, -1.0, 1.0])


def attitude_error(q1: Array, q2: Array) -> Array:
    """Angle of the rotation between two attitudes, blind to the sign of either.

    Parameters
    ----------
    q1, q2 : Array
        Unit quaternions, vector first, (..., 4).

    Returns
    -------
    Array
        Angle in radians, 0 to pi, (...); accurate to rounding at both ends.
    """
    difference = compose(conjugate(q1), q2)
    sine = np.linalg.norm(difference[..., :3], axis=-1)
    return 2.0 * np.arctan2(sine, np.abs(difference[..., 3]))


def random_quaternions(count: int, rng: np.random.Generator) -> Array:
    """Attitudes drawn uniformly from the rotation group.

    Parameters
    ----------
    count : int
        How many.
    rng : numpy.random.Generator
        The stream to draw from.

    Returns
    -------
    Array
        Unit quaternions, vector first, (count, 4).
    """
    return normalize(rng.standard_normal((count, 4)))
