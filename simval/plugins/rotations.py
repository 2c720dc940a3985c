r"""Answers of an estimator as attitudes: quaternions, or rotation matrices.

A matrix is brought to the quaternion of the nearest rotation: the eigenvector of the
greatest eigenvalue of the symmetric matrix N with :math:`q^T N q = \mathrm{tr}(R(q)^T
M)`. It has no branch, and is as smooth as the matrix.
"""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Bool, Float

UNIT = 1e-6
"""How far from 1 the length of a quaternion, and a column of a matrix, may be, and how
far from right the angle of two columns, rad."""

Mask = NDArray[np.bool_]


def tail(components: str) -> tuple[int, ...]:
    """Shape of one answer."""
    return (3, 3) if components == "matrix" else (4,)


def finite_rows(raw: Float[Array, "n ..."]) -> Bool[Mask, " n"]:
    """Which answers are finite."""
    finite: Mask = np.isfinite(raw)
    return np.logical_and.reduce(finite, axis=tuple(range(1, raw.ndim)))


def sound_rows(raw: Float[Array, "n ..."], components: str) -> Bool[Mask, " n"]:
    """Which answers are attitudes: finite, and of unit length or proper rotations."""
    with np.errstate(invalid="ignore", over="ignore"):  # rows that are not finite
        sound: Mask = np.logical_and(finite_rows(raw), defects(raw, components) <= UNIT)
    if components == "matrix":
        finite = np.where(sound[:, None, None], raw, np.eye(3))
        sound = np.logical_and(sound, np.linalg.det(finite) > 0.0)
    return sound


def defects(raw: Float[Array, "n ..."], components: str) -> Float[Array, " n"]:
    """How far answers are from unit length, or from orthogonal columns of length 1."""
    if components != "matrix":
        lengths: Array = np.abs(np.linalg.norm(raw, axis=1) - 1.0)
        return lengths
    # a column that is too long by x has a square that is too great by 2x
    gram = (raw.swapaxes(1, 2) @ raw - np.eye(3)) * (1.0 - np.eye(3) / 2.0)
    worst: Array = np.abs(gram).max(axis=(1, 2))
    return worst


def fault_of(raw: Float[Array, "n ..."], components: str) -> str:
    """Say what is wrong with an answer that is finite and no attitude, in words."""
    row = int(np.argmin(sound_rows(raw, components)))
    if components != "matrix":
        off = np.linalg.norm(raw, axis=1) - 1.0
        worst = float(off[int(np.argmax(np.abs(off)))])
        return (
            f"a quaternion whose length is off by {worst:.2g}; every one must have "
            f"length 1 to {UNIT:g}, so normalise them"
        )
    M = raw[row]
    determinant = float(np.linalg.det(M))
    scale = float(np.cbrt(abs(determinant)))
    if scale > 0.0 and float(defects(M[None] / scale, components)[0]) <= UNIT:
        if abs(scale - 1.0) > UNIT:
            what = f"its columns have the length {scale:.6g} instead of 1"
        else:
            what = f"it is a reflection, its determinant is {determinant:.3g}"
    else:
        apart = float(defects(raw[row : row + 1], components)[0])
        what = f"its columns are not orthonormal, by {apart:.2g}"
    return (
        f"a matrix that is no rotation in row {row}: {what}; every one must be a "
        f"proper rotation to {UNIT:g}"
    )


def package_quaternion(
    raw: Float[Array, "n ..."], components: str, matrix: str
) -> Float[Array, "n 4"]:
    """Bring answers of a declared convention to the package's quaternions."""
    if components == "matrix":
        last = _quaternion_of(raw)
    else:
        last = np.roll(raw, -1, axis=-1) if components == "sxyz" else np.array(raw)
    if matrix == "active":
        last[..., :3] *= -1.0
    return last


def _quaternion_of(M: Float[Array, "n 3 3"]) -> Float[Array, "n 4"]:
    # scalar last, Hamilton's product: R(q) v = q v q*
    trace = np.trace(M, axis1=1, axis2=2)
    N = np.empty((len(M), 4, 4))
    N[:, :3, :3] = M + M.swapaxes(1, 2) - trace[:, None, None] * np.eye(3)
    turn = [M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]]
    N[:, :3, 3] = N[:, 3, :3] = np.stack(turn, axis=1)
    N[:, 3, 3] = trace
    vectors: Array = np.linalg.eigh(N)[1][:, :, -1]
    return vectors
