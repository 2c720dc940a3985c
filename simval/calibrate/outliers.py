r"""Poses that do not lie on the ellipsoid of the others, one or several at once.

An ellipsoid is linear in nine coefficients (E1), so with the rows divided by the
length of :math:`\partial c/\partial y` at the ellipsoid of the poses that belong,
the residuals are distances and the deletion of poses is exact linear algebra. Least
squares itself cannot be asked: three outliers bend the ellipsoid until it hides them.
For each number k the k poses are sought whose removal lowers the sum of squares most
(all pairs and triples are tried, up to 64 poses), and tested together,

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
from scipy import special

from simval.arrays import Array
from simval.calibrate.moments import PAIRS, monomials

FALSE_ALARM = 0.01  # chance that any pose of a clean set is called an outlier
BELIEVED = 0.01  # of the chi-square, beyond which a sigma is not believed
_MOST = 8  # outliers sought; (O1) holds for any choice
_ALL_TRIPLES = 64  # poses; 42 000 triples, some 10 ms
_ROUNDS = 4  # of the weights: they settle within the noise after two
_NO_ROOM = 1e-9  # a pose that the parameters follow leaves no residual
_LEFT = 2  # degrees of freedom that outliers must leave: with one, any pose will do
_ROUNDING = 64.0 * np.finfo(float).eps  # of a distance, readings of unit size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outliers:
    """Poses that do not belong, and how far each pose is from the rest.

    Attributes
    ----------
    flagged : Array of bool
        Which poses are outliers, (n,).
    distance : Array
        Signed distance to the ellipsoid of the others, raw units, (n,).
    standardized : Array
        Deletion residual of each pose in standard deviations, (n,); NaN where the
        poses that belong leave no freedom.
    chi2 : float
        Chi-square of the poses that belong; NaN without sigma.
    dof : int
        Degrees of freedom of the poses that belong.
    """

    flagged: Any
    distance: Array
    standardized: Array
    chi2: float
    dof: int


def find_outliers(poses: Array, sigma: Array | None = None) -> Outliers:
    """Name the poses that do not lie on the ellipsoid of the others.

    Parameters
    ----------
    poses : Array
        Readings, raw units, (n, 3).
    sigma : Array or None
        Noise of each pose, raw units, (n,).

    Returns
    -------
    Outliers
        None flagged where there are fewer than two degrees of freedom, or the poses
        do not fix nine coefficients.
    """
    count = len(poses)
    z, scale, floor = _scaled(poses)
    unit = np.ones(count) if sigma is None else sigma / scale
    known = None if sigma is None else float(np.sqrt(np.mean(unit * unit)))
    relative = unit / (1.0 if known is None else known)
    design = monomials(z)[:, :9]
    deletion = _deletion(design, 2.0 * relative, [], floor)
    chosen: list[int] = []
    for _ in range(_ROUNDS):
        deletion = _deletion(design, _slope(deletion.p, z) * relative, chosen, floor)
        before, chosen = chosen, _choose(deletion, known)
        if chosen == before:
            break
    deletion = _deletion(design, _slope(deletion.p, z) * relative, chosen, floor)
    return _result(deletion, chosen, known, relative * scale)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Break:
    """Where a series of poses leaves the ellipsoid it was on.

    Attributes
    ----------
    index : int
        First pose of the later part.
    later : bool
        Whether the later part is the shorter one, which is left out.
    chance : float
        Chance that the best such cut of a clean series is as good.
    drop : float
        Scatter of all poses over that of the longer part.
    scatter : float
        Scatter of the longer part, raw units.
    """

    index: int
    later: bool
    chance: float
    drop: float
    scatter: float


def find_break(poses: Array) -> Break | None:
    """Look for the cut that best parts a series of poses in two.

    The longer part fits an ellipsoid and the shorter one, taken as outliers all
    together, does not: (O1) with the number of cuts for the binomial.

    Parameters
    ----------
    poses : Array
        Readings in order of time, raw units, (n, 3).

    Returns
    -------
    Break or None
        The best cut; None where no part is long enough to tell.
    """
    z, scale, floor = _scaled(poses)
    count, dof = len(poses), len(poses) - 9
    design = monomials(z)[:, :9]
    deletion = _deletion(design, np.full(count, 2.0), [], floor)
    cuts = [(k, True) for k in range(count - dof + _LEFT, count)]
    cuts += [(k, False) for k in range(1, dof - _LEFT + 1)]
    if not cuts or deletion.rank < 9:
        return None
    best: Break | None = None
    for _ in range(2):
        total = deletion.squares([])
        for index, later in cuts:
            out = list(range(index, count) if later else range(index))
            rest, left = deletion.squares(out), dof - len(out)
            chance = special.betainc(left / 2, len(out) / 2, min(rest / total, 1.0))
            found = Break(
                index=index,
                later=later,
                chance=float(min(1.0, len(cuts) * chance)),
                drop=float(np.sqrt(total / dof / (rest / left))),
                scatter=float(np.sqrt(rest / left)) * scale,
            )
            if best is None or (found.chance, -found.drop) < (best.chance, -best.drop):
                best, shorter = found, out
        slope = _slope(_deletion(design, np.full(count, 2.0), shorter, floor).p, z)
        deletion = _deletion(design, slope, [], floor)
    return best


def _scaled(poses: Array) -> tuple[Array, float, float]:
    # readings of unit size about their mean, the unit, and the square of a distance
    # in it that is rounding only
    offset = poses - poses.mean(axis=0)
    greatest = float(np.abs(offset).max()) or 1.0  # squares of it may be out of range
    offset = offset / greatest
    own = float(np.sqrt(np.mean(np.sum(offset**2, axis=-1)))) or 1.0
    scale = own * greatest
    floor = (_ROUNDING * max(1.0, float(np.abs(poses).max() / scale))) ** 2
    return offset / own, scale, floor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Deletion:
    # least squares over all poses of the rows D/s p = 1/s of eq. (E1), weighted to
    # distances, and what is left when some are taken out: with P = I - QQ' the
    # residuals without K are r - P_K (P_KK)^-1 r_K
    p: Array  # coefficients without the poses chosen so far, (9,)
    q: Array  # orthonormal columns of D/s, (n, 9)
    residual: Array  # (n,), as P times the right side
    floor: float  # square of a distance that is rounding only
    rank: int

    def without(self, subset: list[int]) -> tuple[Array, Array]:
        # residuals of the poses kept, and the room each has left; both 0 in `subset`
        room = 1.0 - np.sum(self.q**2, axis=1)
        if not subset:
            return self.residual, room
        columns = -self.q @ self.q[subset].T
        columns[subset, range(len(subset))] += 1.0
        values, vectors = np.linalg.eigh(columns[subset])
        good = values > _NO_ROOM
        half = columns @ (vectors[:, good] / np.sqrt(values[good]))
        back = (vectors[:, good] / np.sqrt(values[good])).T @ self.residual[subset]
        residual, room = self.residual - half @ back, room - np.sum(half**2, axis=1)
        residual[subset] = room[subset] = 0.0
        return residual, room

    def squares(self, subset: list[int]) -> float:
        # sum of squares of the poses kept
        residual = self.without(subset)[0]
        return max(float(residual @ residual), len(residual) * self.floor)

    def greatest_drop(self, subset: list[int]) -> int:
        # the pose whose removal, after those, lowers the sum of squares most
        residual, room = self.without(subset)
        return int(np.argmax(_drop(residual, room)))


def _deletion(design: Array, slope: Array, left_out: list[int], floor: float) -> Any:
    rows, target = design / slope[:, None], 1.0 / slope
    sizes = np.linalg.norm(rows, axis=0)
    sizes[sizes == 0.0] = 1.0
    q, r = np.linalg.qr(rows / sizes)
    kept = np.delete(np.arange(len(rows)), left_out)
    p = np.linalg.lstsq(rows[kept] / sizes, target[kept], rcond=None)[0] / sizes
    pivots = np.abs(np.diagonal(r))
    residual = target - q @ (q.T @ target)
    return _Deletion(
        p=p,
        q=q,
        residual=residual - q @ (q.T @ residual),
        floor=floor,
        rank=int(np.count_nonzero(pivots > _NO_ROOM)),
    )


def _slope(p: Array, z: Array) -> Array:
    # length of the derivative of eq. (E1) by the reading; not of a pose in the
    # middle of the ellipsoid, where it vanishes
    matrix = np.diag(p[:3])
    for index, (i, j) in enumerate(PAIRS):
        matrix[i, j] = matrix[j, i] = p[3 + index] / 2.0
    length = np.linalg.norm(2.0 * z @ matrix + p[6:], axis=-1)
    return np.asarray(np.maximum(length, 0.2 * np.median(length)))


def _choose(deletion: _Deletion, known: float | None) -> list[int]:
    # greatest set of poses that passes (O1) together and one by one
    count = len(deletion.residual)
    dof = count - 9
    most = min(_MOST, dof - _LEFT, max(3, count // 5))
    if most < 1 or deletion.rank < 9:
        return []
    chosen: list[int] = []
    subset: list[int] = []
    for k in range(1, most + 1):
        subset = _worst(deletion, subset, k)
        test = _Test(rest=deletion.squares(subset), dof=dof - k, known=known)
        more, left = k - len(chosen), count - len(chosen)
        together = test.chance(deletion.squares(chosen), more)
        together *= special.binom(left, more)
        if not together <= FALSE_ALARM / most:
            continue
        alone = [deletion.squares([j for j in subset if j != i]) for i in subset]
        if (count - k + 1) * max(test.chance(s, 1) for s in alone) <= FALSE_ALARM:
            chosen = subset
    return sorted(chosen)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Test:
    # chance of a drop in the sum of squares down to `rest`, at `dof`
    rest: float
    dof: int
    known: float | None

    def chance(self, before: float, k: int) -> float:
        ratio = min(self.rest / before, 1.0)
        by_scatter = float(special.betainc(self.dof / 2.0, k / 2.0, ratio))
        if self.known is None:
            return by_scatter
        left = self.rest / self.known**2
        by_sigma = 1.0
        if special.gammaincc(self.dof / 2.0, left / 2.0) >= BELIEVED:
            drop = before / self.known**2 - left
            by_sigma = float(special.gammaincc(k / 2.0, max(drop, 0.0) / 2.0))
        return min(1.0, 2.0 * min(by_scatter, by_sigma))


def _worst(deletion: _Deletion, before: list[int], k: int) -> list[int]:
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
        if value < best * (1.0 - 1e-9):
            subset, best, idle = trial, value, 0
        turn = (turn + 1) % k
    return subset


def _exhaustive(deletion: _Deletion, k: int) -> list[int]:
    # every set of one, two or three poses
    residual = deletion.residual
    annihilator = np.eye(len(residual)) - deletion.q @ deletion.q.T
    if k == 1:
        return [deletion.greatest_drop([])]
    if k == 2:
        return list(_best_pair(annihilator, residual)[1])
    best, found = -np.inf, (0, 1, 2)
    for first in range(len(residual) - 2):
        room = annihilator[first, first]
        column = annihilator[first + 1 :, first]
        if room <= _NO_ROOM:
            continue
        rest = annihilator[first + 1 :, first + 1 :] - np.outer(column, column) / room
        moved = residual[first + 1 :] - column * residual[first] / room
        value, pair = _best_pair(rest, moved)
        value += residual[first] ** 2 / room
        if value > best:
            best, found = value, (first, pair[0] + first + 1, pair[1] + first + 1)
    return list(found)


def _best_pair(annihilator: Array, residual: Array) -> tuple[float, tuple[int, int]]:
    # greatest drop r_K' (P_KK)^-1 r_K over all pairs K
    room, square = np.diagonal(annihilator), residual**2
    determinant = np.outer(room, room) - annihilator**2
    value: Array = np.outer(square, room)
    value = value + value.T - 2.0 * np.outer(residual, residual) * annihilator
    good = np.triu(determinant > _NO_ROOM, 1)
    value = np.where(good, value / np.where(good, determinant, 1.0), -np.inf)
    i, j = divmod(int(np.argmax(value)), len(room))
    return float(value[i, j]), (i, j)


def _drop(residual: Array, room: Array) -> Array:
    good = room > _NO_ROOM
    return np.where(good, residual**2 / np.where(good, room, 1.0), -np.inf)


def _result(
    deletion: _Deletion, chosen: list[int], known: float | None, scale: Array
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
    usable = room > _NO_ROOM
    ratio = np.where(usable, residual / np.sqrt(np.where(usable, room, 1.0)), np.nan)
    chi2 = np.nan if known is None else total / known**2
    variance: Any = np.nan
    if dof > 0 and known and special.gammaincc(dof / 2.0, chi2 / 2.0) >= BELIEVED:
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
