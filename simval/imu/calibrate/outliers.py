r"""Poses that do not lie on the ellipsoid of the others.

**Leaving poses out of an ellipsoid, by linear algebra.**

The rows of eq. (E1), :math:`D p = 1` with nine monomials of a reading each, are divided
by the length s of :math:`\partial c/\partial y`, so that residuals are distances. With
Q an orthonormal basis of their columns and :math:`P = I - QQ^T`, the residuals without
the poses K are :math:`r - P_K (P_{KK})^{-1} r_K`.  (O2)

**Poses that do not lie on the ellipsoid of the others, one or several at once.**

An ellipsoid is linear in nine coefficients (E1), so with the rows divided by the
length of :math:`\partial c/\partial y` at the ellipsoid of the poses that belong,
the residuals are distances and the deletion of poses is exact linear algebra. Least
squares alone does not show them: three outliers bend the ellipsoid until it hides them.
For each number k, the k poses whose removal lowers the sum of squares most are sought
(all pairs and triples are tried, up to 64 poses) and tested together,

.. math:: \binom{n}{k}\, P\{F_{k,\,n-9-k} > F_K\} \le \alpha/m, \quad k \le m, \tag{O1}

and each member once more by itself, the others removed, at :math:`\alpha`. The
greatest k whose members all pass is taken; where fewer passed before, only what is
new is tested against them, so that a gross outlier does not pull clean poses along.
(O1) bounds over all sets of poses that could be chosen, so a clean set has an outlier
with a chance of at most :math:`\alpha`, whatever the geometry. With a sigma that
explains the poses that are left, the chi-square of the drop is asked too, and the two
share :math:`\alpha`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.calibrate.residuals import monomials, quadratic
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


FALSE_ALARM = 0.01  # chance that any pose of a clean set is called an outlier
BELIEVED = 0.01  # of the chi-square, beyond which a sigma is not believed
BEYOND = 1e-3  # of a chi-square, below which residuals are beyond the stated noise
_MOST = 8  # outliers sought; (O1) holds for any choice
_ALL_TRIPLES = 64  # poses; 42 000 triples, some 10 ms
_ROUNDS = 4  # of the weights: they settle within the noise after two
# Share of the poses that may be outliers, three at least. Measured at 24 poses, four of
# them off by half of gravity: named exactly in 93 % of sets with a fifth or more, never
# with a tenth; of eight that are off, two fifths name the right ones in 57 % only.
_SHARE = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outliers:
    """Poses that do not belong, and how far each pose is from the rest."""

    flagged: Any  # bool: which poses are outliers, (n,)
    # signed distance to the ellipsoid of the others, raw units
    distance: Float[Array, " n"]
    # deletion residual of each pose in standard deviations; NaN where the poses that
    # belong leave no freedom
    standardized: Float[Array, " n"]
    chi2: float  # chi-square of the poses that belong; NaN without sigma
    dof: int  # degrees of freedom of the poses that belong


def find_outliers(
    poses: Float[Array, "n 3"], sigma: Float[Array, " n"] | None = None
) -> Outliers:
    """Name the poses that do not lie on the ellipsoid of the others."""
    count = len(poses)
    z, scale, floor = scaled(poses)
    unit = np.ones(count) if sigma is None else sigma / scale
    known = None if sigma is None else float(np.sqrt(np.mean(unit * unit)))
    relative = unit / (1.0 if known is None else known)
    design = monomials(z)[:, :9]
    deletion = deletion_of(design, 2.0 * relative, [], floor)
    chosen: list[int] = []
    for _ in range(_ROUNDS):
        deletion = deletion_of(
            design, slope_of(deletion.p, z) * relative, chosen, floor
        )
        before, chosen = chosen, _choose(deletion, known)
        if chosen == before:
            break
    deletion = deletion_of(design, slope_of(deletion.p, z) * relative, chosen, floor)
    return _result(deletion, chosen, known, relative * scale)


def _choose(deletion: Deletion, known: float | None) -> list[int]:
    # greatest set of poses that passes (O1) together and one by one
    count = len(deletion.residual)
    dof = count - 9
    most = min(_MOST, dof - LEFT, max(3, count // _SHARE))
    if most < 1 or deletion.rank < 9:
        return []
    chosen: list[int] = []
    subset: list[int] = []
    for k in range(1, most + 1):
        subset = _worst(deletion, subset, k)
        test = Drop(rest=deletion.squares(subset), dof=dof - k, known=known)
        more, left = k - len(chosen), count - len(chosen)
        together = test.chance(deletion.squares(chosen), more)
        together *= scipy.special.binom(left, more)
        if not together <= FALSE_ALARM / most:
            continue
        alone = [deletion.squares([j for j in subset if j != i]) for i in subset]
        if (count - k + 1) * max(test.chance(s, 1) for s in alone) <= FALSE_ALARM:
            chosen = subset
    return sorted(chosen)


def chi_square_chance(chi_square: float, dof: float) -> float:
    """Chance of at least such a chi-square; NaN without freedom."""
    if not dof > 0:
        return float("nan")
    return float(scipy.special.gammaincc(dof / 2.0, chi_square / 2.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drop:
    """A drop of the sum of squares down to `rest`, which has `dof` freedoms."""

    rest: float
    dof: int
    known: float | None  # standard deviation of a residual, where it is known

    def chance(self, before: float, k: int) -> float:
        """Chance that k unknowns more lower the squares as far from `before`."""
        ratio = min(self.rest / before, 1.0)
        by_scatter = float(scipy.special.betainc(self.dof / 2.0, k / 2.0, ratio))
        if self.known is None:
            return by_scatter
        left = self.rest / self.known**2
        by_sigma = 1.0
        if chi_square_chance(left, self.dof) >= BELIEVED:
            drop = before / self.known**2 - left
            by_sigma = chi_square_chance(max(drop, 0.0), k)
        return min(1.0, 2.0 * min(by_scatter, by_sigma))


def _worst(deletion: Deletion, before: list[int], k: int) -> list[int]:
    # the k poses whose removal lowers the sum of squares most: exactly up to three,
    # then one more, and exchanges until none helps
    if k <= 3 and len(deletion.residual) <= _ALL_TRIPLES:
        return _exhaustive(deletion, k)
    subset = [*before, deletion.greatest_drop(before)]
    best, turn, idle = deletion.squares(subset), 0, 0
    while idle < k:
        others = subset[:turn] + subset[turn + 1 :]
        trial = [*others, deletion.greatest_drop(others)]
        value = deletion.squares(trial)
        idle += 1
        if value < best * (1.0 - 1e-9):  # more than rounding, so no circle
            subset, best, idle = trial, value, 0
        turn = (turn + 1) % k
    return subset


def _exhaustive(deletion: Deletion, k: int) -> list[int]:
    # every set of one, two or three poses
    residual = deletion.residual
    annihilator = np.eye(len(residual)) - deletion.q @ deletion.q.T
    if k == 1:
        return [deletion.greatest_drop([])]
    if k == 2:
        return list(_best_pair(annihilator, residual)[1])
    best, worst = -np.inf, (0, 1, 2)
    for first in range(len(residual) - 2):
        room = annihilator[first, first]
        column = annihilator[first + 1 :, first]
        if room <= NO_ROOM:
            continue
        rest = annihilator[first + 1 :, first + 1 :] - np.outer(column, column) / room
        moved = residual[first + 1 :] - column * residual[first] / room
        value, pair = _best_pair(rest, moved)
        value += residual[first] ** 2 / room
        if value > best:
            best, worst = value, (first, pair[0] + first + 1, pair[1] + first + 1)
    return list(worst)


def _best_pair(
    annihilator: Float[Array, "n n"], residual: Float[Array, " n"]
) -> tuple[float, tuple[int, int]]:
    # greatest drop r_K' (P_KK)^-1 r_K over all pairs K
    room, square = np.diagonal(annihilator), residual**2
    determinant = np.outer(room, room) - annihilator**2
    value: Array = np.outer(square, room)
    value = value + value.T - 2.0 * np.outer(residual, residual) * annihilator
    good = np.triu(determinant > NO_ROOM, 1)
    value = np.where(good, value / np.where(good, determinant, 1.0), -np.inf)
    i, j = divmod(int(np.argmax(value)), len(room))
    return float(value[i, j]), (i, j)


def _result(
    deletion: Deletion, chosen: list[int], known: float | None, scale: Array
) -> Outliers:
    # distances from the ellipsoid of the poses that belong, each standardised by the
    # scatter of the others, or by a sigma that is believed; of a pose left out it is
    # its deletion residual, r / room, once put back
    residual, room = (part.copy() for part in deletion.without(chosen))
    count = len(residual)
    total, dof = float(residual @ residual), count - len(chosen) - 9
    flagged = np.zeros(count, dtype=bool)
    flagged[chosen] = True
    for k in chosen:
        back, own = deletion.without([j for j in chosen if j != k])
        residual[k], room[k] = back[k] / own[k], 1.0 / own[k]
    usable = room > NO_ROOM
    ratio = np.where(usable, residual / np.sqrt(np.where(usable, room, 1.0)), np.nan)
    chi2 = np.nan if known is None else total / known**2
    variance: Any = np.nan
    if known and chi_square_chance(chi2, dof) >= BELIEVED:
        variance = known**2
    elif dof > 1:
        own = np.where(flagged, total / dof, (total - ratio**2) / (dof - 1))
        variance = np.maximum(own, deletion.floor)
    return Outliers(
        flagged=flagged,
        distance=-residual * scale,
        standardized=-ratio / np.sqrt(variance),
        chi2=float(chi2),
        dof=dof,
    )
