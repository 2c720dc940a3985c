r"""Geometry and noise of the two-vector problem, for its error theory.

Everything is written for the formula :math:`\bar q = [d_1 \times d_2; s_1^T d_2]`.
A frame other than ``plain`` turns the reference vectors by a half turn about an
axis, :math:`r \to R_k r`, estimates there, and maps back by the orthogonal matrix of
:math:`q = [1_k; 0] * q'`; so its theory is that of ``plain`` for turned vectors and
turned reference noise, mapped back.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simval.arrays import (
    GREATEST,
    LEAST,
    Array,
    ReadOnly,
    finite_array,
    outer,
    physical_array,
)
from simval.errors import GeometryError, InputError, SimvalError
from simval.geometry import attitude_matrix, compose, cross, normalize
from simval.shapes import Float, Int
from simval.spelling import counted
from simval.text import shown

Index = tuple[int, ...]
Noise = Float[Array, "... 4 3 3"] | Float[Array, "... 12 12"]
"""Covariances of b1, b2, r1, r2 of each sample, or of all four together."""


def refuse_samples(
    good: Any, message: Callable[[Index], str], kind: type[SimvalError]
) -> None:
    """Raise an error about the first sample that is not good, if any.

    Raises
    ------
    SimvalError
        Of the `kind`, with the `message` of that sample's index.
    """
    bad = np.flatnonzero(~np.asarray(good))
    if not len(bad):
        return
    shape = np.shape(good)
    msg = message(tuple(np.unravel_index(bad[0], shape)))
    if shape:
        msg = (
            f"{len(bad)} of {counted(np.size(good), 'sample')} cannot be used; "
            f"the first is {place(bad[0], shape)}: {msg}"
        )
    raise kind(msg)


def place(number: int, batch: Index) -> str:
    """Name of a sample in a batch."""
    index = tuple(int(i) for i in np.unravel_index(number, batch))
    return f"sample {index}"


@contextmanager
def naming(sample: Index) -> Iterator[None]:
    """Add the index of a sample to errors about it.

    Raises
    ------
    SimvalError
        The refusal.
    """
    try:
        yield
    except SimvalError as error:
        if not sample:
            raise
        msg = f"sample {tuple(map(int, sample))}: {error}"
        raise type(error)(msg) from error


MAX_NOISE: Final = 1e6
"""Of unit vectors; fourth powers of it neither overflow nor mean anything."""


def noise_covariances(noise_std: Any, count: int = 4) -> Float[Array, "count 3 3"]:
    """Noise covariances of b1, b2, r1, r2, or of `count` vectors.

    Raises
    ------
    InputError
        If the value has another shape, is negative, not finite, not symmetric or
        not positive semidefinite.
    """
    return _of_shape(noise_std, count, "")


def _of_shape(noise_std: Any, count: int, more: str) -> Float[Array, "count 3 3"]:
    # `more`: what else the caller takes
    value = _plausible(noise_std)
    if value.shape not in ((), (count,), (count, 3, 3)):
        msg = (
            f"`noise_std` has shape {value.shape}; give one number, {count} numbers "
            f"or ({count}, 3, 3) covariances, in the order b1, b2, ..., r1, r2, ..."
            f"{more}"
        )
        raise InputError(msg)
    return _covariances(noise_std, value, count, value.ndim == 3)


def noise_of_vectors(
    noise_std: Any, count: int = 4
) -> Float[Array, "count 3 3"] | Float[Array, "m m"]:
    """Noise covariance of each vector, or of all stacked vectors together.

    Raises
    ------
    InputError
        As `noise_covariances`.
    """
    value = _plausible(noise_std)
    if value.shape == (3 * count, 3 * count):
        return _checked("noise_std", value[None])[0]
    size = 3 * count
    more = f", or one ({size}, {size}) covariance of all of them together"
    return _of_shape(noise_std, count, more)


def noise_of_samples(
    noise_std: Any,
) -> Noise:
    """Noise covariances of b1, b2, r1, r2 for each sample.

    The form is told by the last axes alone: no axis is one number for everything, a
    last axis of 1 is one for all four vectors, of 4 is one for each, (4, 3, 3) are
    covariances, and (12, 12) is that of the stacked vectors, which are then correlated.
    Axes before these are of the batch.

    Raises
    ------
    InputError
        As `noise_covariances`.
    """
    value = _plausible(noise_std)
    if value.shape[-2:] == (12, 12):
        return _checked("noise_std", value[..., None, :, :])[..., 0, :, :]
    full = value.shape[-3:] == (4, 3, 3)
    if not (full or value.ndim == 0 or value.shape[-1] in (1, 4)):
        msg = (
            f"`noise_std` has shape {value.shape}; give one number, (..., 1) for one "
            "of each sample, (..., 4) for one of b1, b2, r1, r2 each, (..., 4, 3, 3) "
            "covariances in that order, or (..., 12, 12) of all of them together"
        )
        raise InputError(msg)
    return _covariances(noise_std, value, 4, full)


def own_axes(noise: Array) -> Index:
    """Shape of one sample's covariances."""
    return noise.shape[-2:] if noise.shape[-1] == 12 else noise.shape[-3:]


def _plausible(noise_std: Any) -> Array:
    value = finite_array("noise_std", noise_std, ())
    if not np.all(np.abs(value) <= MAX_NOISE):
        at = np.unravel_index(np.argmax(np.abs(value)), value.shape)
        where = f" at index {tuple(int(i) for i in at)}" if at else ""
        msg = (
            f"`noise_std` reaches {np.abs(value[at]):.2e}{where}; the vectors have "
            f"length 1, and above {MAX_NOISE:g} nothing is left of them, so check its "
            "unit"
        )
        raise InputError(msg)
    return value


def _covariances(
    given: Any, value: Array, count: int, full: bool
) -> Float[Array, "... count 3 3"]:
    # of what are covariances, or of standard deviations of each vector or of all
    if full:
        return _checked("noise_std", value)
    fit = (value == 0.0) | (value >= LEAST)
    refuse_samples(
        np.all(fit, axis=-1) if value.ndim > 1 else fit.all(),
        lambda i: (
            f"`noise_std` is {shown(value[i].tolist() if i else given)}; standard "
            f"deviations must be 0 or more, and where they are not 0 at least {LEAST:g}"
        ),
        InputError,
    )
    each = np.broadcast_to(value, (*value.shape[:-1], count))
    return each[..., None, None] ** 2 * np.eye(3)


def checked_covariances(
    name: str, matrices: Any, size: int = 3
) -> Float[Array, "k size size"]:
    """Check symmetric positive semidefinite matrices.

    Raises
    ------
    InputError
        If a shape is wrong, or a matrix is no covariance.
    """
    value = finite_array(name, matrices, (None, size, size))
    if value.ndim != 3:
        msg = (
            f"`{name}` has shape {value.shape}; give one covariance for each vector, "
            "(k, 3, 3)"
        )
        raise InputError(msg)
    return _checked(name, value)


def _checked(name: str, value: Array) -> Float[Array, "... k n n"]:
    # the vectors of a sample share one scale
    entries = (-3, -2, -1)
    scale = np.max(np.abs(value), axis=entries, initial=0.0)
    refuse_samples(
        (scale == 0.0) | ((scale >= LEAST**2) & (scale <= GREATEST**2)),
        lambda i: (
            f"`{name}` has shape {value.shape} and a greatest entry of {scale[i]:g}; "
            f"give 0 or from {LEAST**2:g} to {GREATEST**2:g}"
        ),
        InputError,
    )
    skew = np.max(np.abs(value - value.mT), axis=entries, initial=0.0)
    lowest = np.min(np.linalg.eigvalsh(value), axis=(-2, -1), initial=0.0)
    # a product F F' is rounded to 1e-16 of its greatest entry, an inverse to more
    refuse_samples(
        (skew <= 1e-12 * scale) & (lowest >= -1e-12 * scale),
        lambda i: (
            f"`{name}` holds a matrix that is not a covariance (asymmetry "
            f"{skew[i]:.2e}, lowest eigenvalue {lowest[i]:.2e}); it must be symmetric "
            "and positive semidefinite"
        ),
        InputError,
    )
    return value


def joint_third(name: str, moments: Any, count: int) -> Float[Array, "m m m"]:
    """Third moments of stacked vectors, given for each or for all.

    Raises
    ------
    InputError
        If the shape is neither (count, 3, 3, 3) nor (3 count, 3 count, 3 count), or
        the order of the three components counts.
    """
    value = physical_array(name, moments, (), MAX_NOISE**3)
    size = 3 * count
    if value.shape == (count, 3, 3, 3):
        S = np.zeros((count, 3, count, 3, count, 3))
        every = np.arange(count)
        S[every, :, every, :, every, :] = value
        value = S.reshape(size, size, size)
    if value.shape != (size, size, size):
        msg = (
            f"`{name}` has shape {value.shape}; give ({count}, 3, 3, 3), one tensor "
            f"for each vector, or ({size}, {size}, {size}) of all together"
        )
        raise InputError(msg)
    scale = float(np.abs(value).max(initial=0.0))
    turned = value.transpose(1, 0, 2), value.mT
    if not max(np.abs(value - other).max() for other in turned) <= 1e-12 * scale:
        msg = (
            f"`{name}` changes if two components are exchanged, which a mean of "
            "products does not; give it symmetric in all three axes"
        )
        raise InputError(msg)
    return value


def tangent_projector(v: Float[Array, "... n"]) -> Float[Array, "... n n"]:
    r"""Projector :math:`\Pi = I - v v^T` onto the plane tangent to the sphere at v."""
    return np.eye(v.shape[-1]) - outer(v, v)


def normalized_noise(
    vectors: Float[Array, "... k 3"], noise: Float[Array, "... k 3 3"]
) -> tuple[Float[Array, "... k 3"], Float[Array, "... k 3 3"]]:
    r"""Mean and covariance of the noise after each vector is normalised.

    For a unit vector v and :math:`\Pi = I - v v^T`, :math:`(v + n)/|v + n| - v` is
    :math:`\Pi n - (v^T n) \Pi n - |\Pi n|^2 v/2` to second order, so its mean is
    :math:`-\Pi\Sigma v - \mathrm{tr}(\Pi\Sigma) v/2` (shortened, and turned if the
    noise along v is correlated with the noise across) and its covariance
    :math:`\Pi\Sigma\Pi`.
    """
    planes = tangent_projector(vectors)
    across = planes @ noise
    shortened = 0.5 * np.linalg.trace(across)[..., None] * vectors
    turned = (across @ vectors[..., None])[..., 0]
    return -turned - shortened, across @ planes


def tangent_covariances(
    vectors: Float[Array, "... 4 3"], std: Any
) -> Float[Array, "... 4 3 3"]:
    r"""Covariances of noise tangent to each unit vector."""
    variances = np.broadcast_to(np.asarray(std), (4,))[:, None, None] ** 2
    return variances * tangent_projector(vectors)


# rounding enters a prediction as eps / |qbar|^k, k up to 4
MIN_NORM: Final = 1e-3
Column = Literal["x", "y", "z", "plain"]
Whole = Literal["combined", "optimal"]
Frame = Column | Whole
_TURNS: Final[dict[Column, Array]] = {
    "x": np.array([1.0, -1.0, -1.0]),
    "y": np.array([-1.0, 1.0, -1.0]),
    "z": np.array([-1.0, -1.0, 1.0]),
    "plain": np.ones(3),
}
FRAMES: Final = tuple(_TURNS)
WHOLE: Final = get_args(Whole)
"""Estimators that are singular nowhere: all columns, and Wahba's optimum."""
Columns = NDArray[np.integer]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwoVectorGeometry(ReadOnly):
    """Noise-free vectors in one frame, and the way back to the original one.

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

    def __getitem__(self, samples: Any) -> "TwoVectorGeometry":
        parts = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return replace(self, **{k: np.asarray(v[samples]) for k, v in parts.items()})

    @property
    def frame(self) -> str:
        """Name of the frame of a single geometry."""
        return FRAMES[int(self.column)]

    @property
    def q_true(self) -> Float[Array, "... 4"]:
        """True quaternion in the original frame, sign of the noise-free estimate."""
        return np.matvec(self.back, self.q)


def column_maps() -> list[tuple[Float[Array, "3"], Float[Array, "4 4"]]]:
    """Half turns of the reference frame with their inverses, in the order of M."""
    return [(turn, _way_back(frame)) for frame, turn in _TURNS.items()]


def _way_back(frame: Column) -> Float[Array, "4 4"]:
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
    n = cross(r1, r2)
    e, s = q[..., :3], q[..., 3:]
    plain = np.sum(e * n, axis=-1, keepdims=True)
    return np.concatenate([cross(e, n) - s * n, plain], axis=-1)


def two_vector_geometry(
    q: Any, r1: Any, r2: Any, frame: str | None = None
) -> TwoVectorGeometry:
    """Geometry of attitudes in one frame, or each in its best frame.

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
    """Index in `FRAMES` of each sample's frame; the longest column if None.

    Raises
    ------
    InputError
        If the frame is unknown.
    GeometryError
        If the vectors are parallel, or the frame is singular at an attitude.
    """
    norms = np.abs(column_norms(q, r1, r2))
    if frame is None:
        columns = np.asarray(np.argmax(norms, axis=-1))
    elif frame in FRAMES:
        columns = np.full(norms.shape[:-1], FRAMES.index(frame))
    else:
        msg = (
            f"`frame` is {frame!r}; it must be None (the greatest column of the "
            f"truth), combined, optimal, or one of {', '.join(FRAMES)}"
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


def true_pairs(
    q: Any, references: Any
) -> tuple[Float[Array, "4"], Float[Array, "m 3"]]:
    """A unit quaternion, then n noise-free body vectors and n references.

    Raises
    ------
    InputError
        If a value is not finite or zero, or a shape is wrong.
    GeometryError
        If the vectors are parallel.
    """
    unit_q = normalize(finite_array("q", q, (4,)))
    r = normalize(finite_array("references", references, (None, 3)))
    if unit_q.ndim != 1 or r.ndim != 2 or len(r) < 2:
        msg = (
            f"`q` has shape {unit_q.shape} and `references` {r.shape}; give one "
            "quaternion (4,) and two or more vectors (n, 3)"
        )
        raise InputError(msg)
    sine = float(np.linalg.norm(cross(r[0], r), axis=1).max())
    if not sine >= MIN_NORM:
        msg = (
            f"the sine of the greatest angle between `references` is {sine:.2e}; it "
            f"must be {MIN_NORM:g} or more, so choose vectors that are farther apart"
        )
        raise GeometryError(msg)
    return unit_q, np.concatenate([r @ attitude_matrix(unit_q).T, r])


def require_apart(r1: Float[Array, "... 3"], r2: Float[Array, "... 3"]) -> None:
    """Check unit vectors that are not parallel.

    Raises
    ------
    GeometryError
        If they are.
    """
    sine = np.linalg.norm(cross(r1, r2), axis=-1)
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
    """Noise-free b1, b2, r1, r2 of attitudes."""
    A = attitude_matrix(q)
    return np.stack([np.matvec(A, r1), np.matvec(A, r2), r1, r2], axis=-2)


def unit_arguments(
    q: Any, r1: Any, r2: Any, batch: Index = ()
) -> tuple[Float[Array, "... 4"], Float[Array, "... 3"], Float[Array, "... 3"]]:
    """Check unit quaternions and vectors, and broadcast them.

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
    """Check that there is only one geometry.

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
    """Geometry in given frames."""
    turn, back = _SIGNS[columns], _BACKS[columns]
    matrix = attitude_matrix(q)
    b1, b2 = np.matvec(matrix, r1), np.matvec(matrix, r2)
    d1, s1, d2 = (b1 - turn * r1) / 2, (b1 + turn * r1) / 2, (b2 - turn * r2) / 2
    q_turned = np.vecmat(q, back)  # orthogonal: the inverse is the transpose
    qbar = np.concatenate([cross(d1, d2), np.vecdot(s1, d2)[..., None]], axis=-1)
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
