r"""Leaving poses out of an ellipsoid, by linear algebra.

The rows of eq. (E1), :math:`D p = 1` with nine monomials of a reading each, are divided
by the length s of :math:`\partial c/\partial y`, so that residuals are distances. With
Q an orthonormal basis of their columns and :math:`P = I - QQ^T`, the residuals without
the poses K are :math:`r - P_K (P_{KK})^{-1} r_K`.  (O2)
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import quadratic
from simval.shapes import Float

NO_ROOM = 1e-9  # a pose that the parameters follow leaves no residual
LEFT = 2  # degrees of freedom that outliers must leave: with one, any pose will do
LEAST_SLOPE = 0.2  # of the median: a pose near the centre would weigh without bound
_ROUNDING = 64.0 * np.finfo(float).eps  # of a distance, readings of unit size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deletion:
    """Least squares over all poses, and what is left when some are taken out."""

    p: Float[Array, "9"]  # coefficients without the poses that were named at the start
    q: Float[Array, "n 9"]  # orthonormal columns of the weighted rows
    residual: Float[Array, " n"]  # residuals of all poses
    floor: float  # square of a distance that is rounding only
    rank: int  # rank of the rows, 9 where the poses fix the coefficients

    def without(
        self, subset: list[int]
    ) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Residuals (O2) and the room of each, both 0 in the subset."""
        room = 1.0 - np.sum(self.q**2, axis=1)
        if not subset:
            return self.residual, room
        columns = -self.q @ self.q[subset].T
        columns[subset, range(len(subset))] += 1.0
        values, vectors = np.linalg.eigh(columns[subset])
        good = values > NO_ROOM
        half = columns @ (vectors[:, good] / np.sqrt(values[good]))
        back = (vectors[:, good] / np.sqrt(values[good])).T @ self.residual[subset]
        residual, room = self.residual - half @ back, room - np.sum(half**2, axis=1)
        residual[subset] = room[subset] = 0.0
        return residual, room

    def squares(self, subset: list[int]) -> float:
        """Sum of squares of the poses kept."""
        residual = self.without(subset)[0]
        return max(float(residual @ residual), len(residual) * self.floor)

    def greatest_drop(self, subset: list[int]) -> int:
        """Pose whose removal, after those, lowers the sum of squares most."""
        residual, room = self.without(subset)
        return int(np.argmax(_drop(residual, room)))


def deletion_of(
    design: Float[Array, "n 9"],
    slope: Float[Array, " n"],
    left_out: list[int],
    floor: float,
) -> Deletion:
    """Set the algebra up."""
    rows, target = design / slope[:, None], 1.0 / slope
    sizes = np.linalg.norm(rows, axis=0)
    sizes[sizes == 0.0] = 1.0
    q, r = np.linalg.qr(rows / sizes)
    kept = np.delete(np.arange(len(rows)), left_out)
    p = np.linalg.lstsq(rows[kept] / sizes, target[kept], rcond=None)[0] / sizes
    pivots = np.abs(np.diagonal(r))
    residual = target - q @ (q.T @ target)
    return Deletion(
        p=p,
        q=q,
        residual=residual - q @ (q.T @ residual),
        floor=floor,
        rank=int(np.count_nonzero(pivots > NO_ROOM)),
    )


def slope_of(p: Float[Array, "9"], z: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Length of the derivative of eq. (E1) by the reading."""
    length = np.linalg.norm(2.0 * z @ quadratic(p) + p[6:], axis=-1)
    return np.asarray(np.maximum(length, LEAST_SLOPE * np.median(length)))


def scaled(poses: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], float, float]:
    """Readings of unit size about their mean."""
    offset = poses - poses.mean(axis=0)
    greatest = float(np.abs(offset).max()) or 1.0  # squares of it may be out of range
    offset = offset / greatest
    own = float(np.sqrt(np.mean(np.sum(offset**2, axis=-1)))) or 1.0
    scale = own * greatest
    floor = (_ROUNDING * max(1.0, float(np.abs(poses).max() / scale))) ** 2
    return offset / own, scale, floor


def _drop(residual: Float[Array, " n"], room: Float[Array, " n"]) -> Float[Array, " n"]:
    good = room > NO_ROOM
    return np.where(good, residual**2 / np.where(good, room, 1.0), -np.inf)
