r"""True geometry and noise of the two-vector problem, as its error theory needs them.

Everything is written for the formula :math:`\bar q = [d_1 \times d_2; s_1^T d_2]`.
A frame other than ``plain`` turns the reference vectors by a half turn about an
axis, :math:`r \to R_k r`, estimates there, and maps back by the orthogonal matrix of
:math:`q = [1_k; 0] * q'`; so its theory is that of ``plain`` for turned vectors and
turned reference noise, mapped back.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, finite_array, frozen
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix, compose, normalize
from simval.shapes import Float, Int
from simval.theory.samples import refuse_samples

# rounding enters a prediction as eps / |qbar|^k, k up to 4
MIN_NORM: Final = 1e-3
_TURNS: Final = {
    "x": np.array([1.0, -1.0, -1.0]),
    "y": np.array([-1.0, 1.0, -1.0]),
    "z": np.array([-1.0, -1.0, 1.0]),
    "plain": np.ones(3),
}
FRAMES: Final = tuple(_TURNS)
Columns = NDArray[np.integer]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoVectorGeometry:
    """Noise-free vectors of one frame and the way back to the original frame.

    Attributes
    ----------
    q : Array
        True quaternion in the turned frame with the sign of the noise-free
        estimate.
    d1, s1, d2 : Array
        Half differences and half sum of the true vectors in that frame.
    norm : Array
        Length of the noise-free qbar, 0 to 1.
    back : Array
        Orthogonal matrix that takes a quaternion of the turned frame to the
        original one.
    turn : Array
        Signs of the half turn of the reference vectors.
    column : Array
        Place of the frame in `FRAMES`.
    """

    q: Float[Array, "... 4"]
    d1: Float[Array, "... 3"]
    s1: Float[Array, "... 3"]
    d2: Float[Array, "... 3"]
    norm: Float[Array, "..."]
    back: Float[Array, "... 4 4"]
    turn: Float[Array, "... 3"]
    column: Int[Columns, "..."]

    def __post_init__(self) -> None:
        for name in ("q", "d1", "s1", "d2", "back", "turn"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def frame(self) -> str:
        """Name of the frame, of one geometry."""
        return FRAMES[int(self.column)]

    @property
    def q_true(self) -> Float[Array, "... 4"]:
        """True quaternion in the original frame, sign of the noise-free estimate."""
        return np.matvec(self.back, self.q)


def column_maps() -> list[tuple[Float[Array, "3"], Float[Array, "4 4"]]]:
    """The half turns of the reference frame and the ways back, in the order of M."""
    return [(turn, _way_back(frame)) for frame, turn in _TURNS.items()]


def _way_back(frame: str) -> Float[Array, "4 4"]:
    # matrix of q' -> [1_k; 0] * q', the identity for plain
    half_turn = np.append((_TURNS[frame] + 1.0) / 2.0, 0.0)
    if frame == "plain":
        half_turn = np.array([0.0, 0.0, 0.0, 1.0])
    return compose(half_turn, np.eye(4)).T


_SIGNS: Final = np.stack([turn for turn, _ in column_maps()])
_BACKS: Final = np.stack([back for _, back in column_maps()])


def column_norms(
    q: Float[Array, "... 4"], r1: Float[Array, "... 3"], r2: Float[Array, "... 3"]
) -> Float[Array, "... 4"]:
    r"""Signed lengths of the four noise-free columns x, y, z, plain."""
    n = np.cross(r1, r2)
    e, s = q[..., :3], q[..., 3:]
    plain = np.sum(e * n, axis=-1, keepdims=True)
    return np.concatenate([np.cross(e, n) - s * n, plain], axis=-1)


def two_vector_geometry(
    q: Any, r1: Any, r2: Any, frame: str | None = None
) -> TwoVectorGeometry:
    """Geometry of attitudes in one frame, or in the greatest of each.

    Raises
    ------
    InputError
        If a value is not finite or zero, a shape is wrong, or the frame unknown.
    GeometryError
        If the vectors are parallel, or the frame is singular at an attitude.
    """
    unit = unit_arguments(q, r1, r2)
    return turned_geometry(chosen_columns(*unit, frame), *unit)


def chosen_columns(
    q: Float[Array, "... 4"],
    r1: Float[Array, "... 3"],
    r2: Float[Array, "... 3"],
    frame: str | None,
) -> Int[Columns, "..."]:
    """Place in `FRAMES` of the frame of each sample, the greatest where it is None.

    Raises
    ------
    InputError
        If the frame is unknown.
    GeometryError
        If the vectors are parallel, or the frame is singular at an attitude.
    """
    norms = np.abs(column_norms(q, r1, r2))
    if frame is None:
        columns: Columns = np.asarray(np.argmax(norms, axis=-1))
    elif frame in FRAMES:
        columns = np.full(norms.shape[:-1], FRAMES.index(frame))
    else:
        msg = (
            f"`frame` is {frame!r}; it must be None (the greatest column of the "
            f"truth), combined, or one of {', '.join(FRAMES)}"
        )
        raise InputError(msg)
    norm = np.take_along_axis(norms, columns[..., None], axis=-1)[..., 0]
    refuse_samples(
        norm >= MIN_NORM,
        lambda i: (
            f"|qbar| is {norm[i]:.2e} in frame {FRAMES[columns[i]]!r}; theory needs "
            f"{MIN_NORM:g} or more, so choose frame=None, or vectors that are farther "
            "apart"
        ),
        GeometryError,
    )
    return columns


def true_vectors(
    q: Any, r1: Any, r2: Any
) -> tuple[Float[Array, "... 4"], Float[Array, "... 4 3"], Float[Array, "... 3 3"]]:
    """Unit quaternions, noise-free vectors and matrices of attitudes.

    Raises
    ------
    InputError
        If a value is not finite or zero, or a shape is wrong.
    GeometryError
        If the vectors are parallel.
    """
    unit = unit_arguments(q, r1, r2)
    require_apart(*unit[1:])
    return unit[0], vectors_of(*unit), attitude_matrix(unit[0])


def require_apart(r1: Float[Array, "... 3"], r2: Float[Array, "... 3"]) -> None:
    """Require unit vectors that are not parallel.

    Raises
    ------
    GeometryError
        If they are.
    """
    sine = np.linalg.norm(np.cross(r1, r2), axis=-1)
    refuse_samples(
        sine >= MIN_NORM,
        lambda i: (
            f"the sine of the angle between `r1` and `r2` is {sine[i]:.2e}; theory "
            f"needs {MIN_NORM:g} or more, so choose vectors that are farther apart"
        ),
        GeometryError,
    )


def vectors_of(
    q: Float[Array, "... 4"], r1: Float[Array, "... 3"], r2: Float[Array, "... 3"]
) -> Float[Array, "... 4 3"]:
    """b1, b2, r1, r2 without noise, of unit quaternions and vectors."""
    A = attitude_matrix(q)
    return np.stack([np.matvec(A, r1), np.matvec(A, r2), r1, r2], axis=-2)


def unit_arguments(
    q: Any, r1: Any, r2: Any, batch: tuple[int, ...] = ()
) -> tuple[Float[Array, "... 4"], Float[Array, "... 3"], Float[Array, "... 3"]]:
    """Unit quaternions and vectors, their leading axes broadcast, with `batch` too.

    Raises
    ------
    InputError
        If a value is not finite or zero, or a shape is wrong.
    """
    given = ("q", q, 4), ("r1", r1, 3), ("r2", r2, 3)
    arrays = [finite_array(name, value, (size,)) for name, value, size in given]
    try:
        shape = np.broadcast_shapes(batch, *(array.shape[:-1] for array in arrays))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        noise = f", and the noise the leading axes {batch}" if batch else ""
        msg = (
            f"`q`, `r1`, `r2` have shapes {shapes}{noise}, whose leading axes do not "
            "match; give one for each sample, or one for all"
        )
        raise InputError(msg) from None
    unit = (normalize(array) for array in arrays)
    e, first, second = (np.broadcast_to(u, (*shape, u.shape[-1])) for u in unit)
    return e, first, second


def require_one(q: Any, r1: Any, r2: Any) -> None:
    """Require a single geometry.

    Raises
    ------
    InputError
        If there is a batch, or a value is not finite.
    """
    for name, value, size in (("q", q, 4), ("r1", r1, 3), ("r2", r2, 3)):
        array = finite_array(name, value, (size,))
        if array.ndim != 1:
            msg = f"`{name}` has shape {array.shape}; give one, of shape ({size},)"
            raise InputError(msg)


def turned_geometry(
    columns: Int[Columns, "..."],
    q: Float[Array, "... 4"],
    r1: Float[Array, "... 3"],
    r2: Float[Array, "... 3"],
) -> TwoVectorGeometry:
    """Geometry of unit quaternions and vectors in given frames."""
    turn, back = _SIGNS[columns], _BACKS[columns]
    matrix = attitude_matrix(q)
    b1, b2 = np.matvec(matrix, r1), np.matvec(matrix, r2)
    d1, s1, d2 = (b1 - turn * r1) / 2, (b1 + turn * r1) / 2, (b2 - turn * r2) / 2
    q_turned = np.vecmat(q, back)  # orthogonal: the inverse is the transpose
    scalar = np.vecdot(s1, d2)[..., None]
    qbar = np.concatenate([np.cross(d1, d2), scalar], axis=-1)
    return TwoVectorGeometry(
        q=q_turned * np.sign(np.vecdot(q_turned, qbar))[..., None],
        d1=d1,
        s1=s1,
        d2=d2,
        norm=np.asarray(np.linalg.norm(qbar, axis=-1)),
        back=back,
        turn=turn,
        column=columns,
    )
