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

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

import numpy as np

from simval.arguments import instance, whole_number
from simval.arrays import Array, Scalars, finite_array, outer, physical_array
from simval.errors import InputError
from simval.shapes import Float, Shaped

# four single-precision numbers, each rounded by 6e-8, leave a length within 1.2e-7 of
# 1; an angle read from such a quaternion is off by as much
UNIT_TOLERANCE: Final = 1e-6
MOST: Final = 10_000_000  # quaternions at once: a third of a gigabyte

Frame = Literal["NED", "ENU", "NWU"]
"""Reference frames by the directions of their axes."""

FRAME_AXES: Final[Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]]] = (
    MappingProxyType(
        {
            "NED": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
            "ENU": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            "NWU": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        }
    )
)
"""North and up of each frame."""

FRAMES: Final = get_args(Frame)


def normalize(v: Float[Array, "... n"]) -> Float[Array, "... n"]:
    """Vectors scaled to unit length; a zero one is refused."""
    v = finite_array("v", v, (None,))
    if v.shape[-1] == 0:
        msg = (
            f"`v` has shape {v.shape}, so its vectors have no components; give "
            "vectors of one component or more"
        )
        raise InputError(msg)
    largest = np.max(np.abs(v), axis=-1, keepdims=True)  # no overflow, no underflow
    if not np.all(largest > 0.0):
        first = tuple(int(i) for i in np.argwhere(largest[..., 0] == 0.0)[0])
        msg = f"the vector at index {first} is zero and has no direction; remove it"
        raise InputError(msg)
    scaled = v / largest
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


def unit_quaternions(name: str, q: Any) -> Float[Array, "... 4"]:
    """Require quaternions of unit length, to single precision."""
    array = finite_array(name, q, (4,))
    with np.errstate(over="ignore"):
        squared = np.vecdot(array, array)
    off = ~(np.abs(squared - 1.0) <= 2.0 * UNIT_TOLERANCE)
    if off.any():
        first = tuple(int(i) for i in np.argwhere(off)[0])
        msg = (
            f"`{name}` has a quaternion of length {np.sqrt(squared[first]):.6g} (index "
            f"{first}); an attitude is one of length 1, so normalise it"
        )
        raise InputError(msg)
    return array


def matching(name1: str, first: Array, name2: str, second: Array) -> None:
    """Require arrays whose leading axes broadcast."""
    try:
        np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    except ValueError:
        msg = (
            f"`{name1}` has shape {first.shape} and `{name2}` has "
            f"{second.shape}; their leading axes do not match, so give as many "
            "of one as of the other, or one"
        )
        raise InputError(msg) from None


def attitude_matrix(q: Float[Array, "... 4"]) -> Float[Array, "... 3 3"]:
    """Matrix that takes reference coordinates to body coordinates, eq. (G1)."""
    q = unit_quaternions("q", q)
    e, s = q[..., :3], q[..., 3, None, None]
    squared = np.sum(e * e, axis=-1)[..., None, None]
    return (s * s - squared) * np.eye(3) + 2.0 * outer(e, e) - 2.0 * s * cross_matrix(e)


def cross_matrix(v: Float[Array, "... 3"]) -> Float[Array, "... 3 3"]:
    """Matrix of the cross product, ``cross_matrix(v) @ w == cross(v, w)``."""
    v = finite_array("v", v, (3,))
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def axial(D: Shaped[Array, "3 3"]) -> Shaped[Array, "3"]:
    """Vector of the skew part of a matrix, ``cross_matrix(axial(D)) == D - D.T``."""
    return np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])


def cross(
    a: Shaped[Array, "... 3"], b: Shaped[Array, "... 3"]
) -> Shaped[Array, "... 3"]:
    """Cross product: `numpy.cross`, of few vectors in a third of its time."""
    product: Array = np.empty(np.broadcast(a, b).shape, np.result_type(a, b))
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    product[..., 0] = y * w - z * v
    product[..., 1] = z * u - x * w
    product[..., 2] = x * v - y * u
    return product


def compose(
    q1: Float[Array, "... 4"], q2: Float[Array, "... 4"]
) -> Float[Array, "... 4"]:
    """Composition of quaternions, eq. (G2): first `q1`, then `q2`."""
    q1, q2 = finite_array("q1", q1, (4,)), finite_array("q2", q2, (4,))
    matching("q1", q1, "q2", q2)
    e1, s1 = q1[..., :3], q1[..., 3:]
    e2, s2 = q2[..., :3], q2[..., 3:]
    vector = s1 * e2 + s2 * e1 + cross(e1, e2)
    scalar = s1 * s2 - np.sum(e1 * e2, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def conjugate(q: Float[Array, "... 4"]) -> Float[Array, "... 4"]:
    """Inverse of unit quaternions."""
    return finite_array("q", q, (4,)) * np.array([-1.0, -1.0, -1.0, 1.0])


def attitude_error(
    q1: Float[Array, "... 4"], q2: Float[Array, "... 4"]
) -> Float[Scalars, "..."]:
    """Angle of the rotation between two attitudes, blind to the sign of either."""
    q1, q2 = unit_quaternions("q1", q1), unit_quaternions("q2", q2)
    difference = compose(conjugate(q1), q2)
    sine = np.linalg.norm(difference[..., :3], axis=-1)
    return 2.0 * np.arctan2(sine, np.abs(difference[..., 3]))


def rotation_vector(q: Float[Array, "... 4"]) -> Float[Array, "... 3"]:
    """Axis times angle of attitudes, rad, at most pi long; `from_rotation_vector`."""
    q = physical_array("q", q, (4,))
    sine = np.linalg.norm(q[..., :3], axis=-1)
    angle = 2.0 * np.arctan2(sine, np.abs(q[..., 3])) * np.copysign(1.0, q[..., 3])
    return q[..., :3] * (angle / np.maximum(sine, np.finfo(float).tiny))[..., None]


def from_rotation_vector(v: Float[Array, "... 3"]) -> Float[Array, "... 4"]:
    """Attitude after a turn of the body by a rotation vector, rad, from the frame's."""
    v = physical_array("v", v, (3,))
    half = np.linalg.norm(v, axis=-1, keepdims=True) / 2.0
    return np.concatenate([v * np.sinc(half / np.pi) / 2.0, np.cos(half)], axis=-1)


def random_quaternions(
    count: int, rng: "np.random.Generator"
) -> Float[Array, "count 4"]:
    """Attitudes drawn uniformly from the rotation group."""
    count = whole_number("count", count, 0, MOST)
    instance("rng", rng, np.random.Generator)
    return normalize(rng.standard_normal((count, 4)))
