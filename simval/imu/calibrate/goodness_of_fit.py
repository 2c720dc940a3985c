r"""Goodness of fit: one chi-square test for the residuals of every linearised fit.

A fit leaves rows :math:`r = J\,\mathrm{d}\theta + \sum_s n_s`, each n_s the noise of
one sensor, its source, of covariance :math:`V_s`; they are whitened by
:math:`V = \sum_s V_s`. With Q an orthonormal basis of the columns of J,
:math:`P = I - QQ^T` takes away what the parameters explain.

**Rank, and the least determined combination.** Of J with columns of unit length the
parameters are in units of the error bars that each would have if all others were known;
its least singular value s belongs to that combination, 1/s times as wide.

**Chi-square by sensor.** :math:`r^T P V_s P r` has the mean :math:`\mathrm{tr}\,P V_s`
and the variance :math:`2\,\mathrm{tr}\,P V_s P V_s`. Over the sensors these add up to
chi-square of all rows and to rows less parameters, exactly.

**Leaving out.** An error of a pose or a move (an *item*) moves the rows by the columns
:math:`U_i`. What all others say of it is off by :math:`S^{-1} U_i^T P r,
S = U_i^T P U_i`, its square in standard deviations is what leaving the item out takes
off chi-square, and :math:`1 - S/U_i^T U_i` is its leverage. Without several items K the
residuals are :math:`r - P U_K (U_K^T P U_K)^{-1} U_K^T P r`.  (O2)

**Outliers, one or several at once.** Least squares alone does not show them: three
outliers bend the fit until it hides them. For each number k, the k items whose removal
lowers the sum of squares most are sought (where an item is a row of its own all pairs
and triples are tried, up to 64) and tested together,

.. math:: \binom{n}{k}\, P\{F_{q,\,\nu-q} > F_K\} \le \alpha/m, \quad k \le m, \tag{O1}

of q unknowns, one for each item that is a row, and :math:`\nu` rows less parameters;
each member is tested once more by itself, the others removed, at :math:`\alpha`. The
greatest k whose members all pass is taken; where fewer passed before, only what is
new is tested against them, so that a gross outlier does not pull clean items along.
(O1) bounds over all sets of items that could be chosen, so a clean set has an outlier
with a chance of at most :math:`\alpha`, whatever the geometry. With a noise that
explains the items that are left, the chi-square of the drop is asked too, and the two
share :math:`\alpha`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import scipy

from simval.account import Remark
from simval.arrays import Array, ReadOnly
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.spelling import chance as p_words

FALSE_ALARM: Final = 0.01
"""Chance that any item of a clean set is called an outlier."""
BELIEVED: Final = 0.01
"""Of the chi-square, beyond which a noise is not believed."""
BEYOND: Final = 1e-3
"""Of a chi-square, below which residuals are beyond the stated noise."""
NO_ROOM: Final = 1e-9  # an item that the parameters follow leaves no residual
LEFT: Final = 2
"""Degrees of freedom that outliers must leave: with one, any item will do."""
_MOST = 8  # outliers sought; (O1) holds for any choice
_ALL_TRIPLES = 64  # items; 42 000 triples, some 10 ms
# Share of the items that may be outliers, three at least. Measured at 24 poses, four of
# them off by half of gravity: named exactly in 93 % of sets with a fifth or more, never
# with a tenth; of eight that are off, two fifths name the right ones in 57 % only.
_SHARE = 5
_NAMED = 0.3  # of the greatest part of a combination: what is named of it
_MOST_NAMED = 4
_RANK = 1e-7  # of the greatest singular value
LEAST_FREEDOM: Final = 1e-2
"""Of a source; below it its chi-square says nothing."""


ErrorKind = Literal["noise", "rotations", "matrix"]
"""Of an error beside the noise that is stated: as much more of that noise, rad that
each rotation is off, or a matrix that changes in the course of the log, relative."""


class NoiseSource(NamedTuple):
    """A sensor whose noise the rows of a fit contain."""

    name: str
    covariance: Float[Array, "r r"]  # that its noise gives the rows
    items: Float[Array, "i r m"]  # what an error of each rest or move does to the rows
    item: str  # rest or move
    parameters: slice  # its own


class Beside(NamedTuple):
    """A possible error in the rows, in addition to the stated noise."""

    cause: str  # sensor, or what else may be to blame
    kind: ErrorKind
    covariance: Float[Array, "r r"]  # of one of variance 1
    size: float = 1.0  # of that, in the unit of its kind


class Residuals(NamedTuple):
    """Residuals of one fit where it ended, and the sensors whose noise they contain."""

    r: Float[Array, " r"]
    J: Float[Array, "r p"]
    sources: tuple[NoiseSource, ...]
    beside: tuple[Beside, ...] = ()
    names: tuple[str, ...] = ()  # of the parameters


class Combination(NamedTuple):
    """The combination of parameters that a fit determines worst."""

    rank: int  # of the rows
    parameters: int
    widening: float  # its error bar, over that of parameters known one by one
    words: str  # such as 0.71 K_z -0.70 B_z

    @property
    def sentence(self) -> str:
        """Say the combination, and how much its error bar exceeds that of one alone."""
        if self.rank < self.parameters:
            return (
                f"rank {self.rank} of {self.parameters}: {self.words} is undetermined"
            )
        return (
            f"{self.words}: {self.widening:.3g} times as wide as with the other "
            "parameters known"
        )


def least_determined_of(J: Float[Array, "r p"], names: tuple[str, ...]) -> Combination:
    """The combination that whitened rows determine worst, and the rows' rank."""
    size = np.linalg.norm(J, axis=0)
    _, s, v = np.linalg.svd(J / np.where(size > 0.0, size, 1.0))
    s = np.pad(s, (0, len(v) - len(s)))
    part = v[-1] * np.sign(v[-1][np.argmax(np.abs(v[-1]))])
    order = np.argsort(-np.abs(part))[:_MOST_NAMED]
    named = [k for k in order if abs(part[k]) >= _NAMED * part[order[0]]]
    said = []
    for k in named:
        entry, sign = forms.ENTRIES.get(names[k], (names[k], 1.0))
        said.append(f"{sign * part[k]:+.2f} {entry}")
    return Combination(
        rank=int(np.count_nonzero(s > _RANK * s[0])),
        parameters=len(names),
        widening=float(1.0 / s[-1]) if s[-1] > 0.0 else np.inf,
        words=" ".join(said).removeprefix("+"),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deletion:
    """Residuals of a least-squares fit, with and without some of its items."""

    q: Float[Array, "r p"]  # orthonormal columns of the rows' derivatives
    residual: Float[Array, " r"]
    items: Float[Array, "i r m"] | None = None  # None: each row is an item
    floor: float = 0.0  # square of a row that is rounding only
    rank: int = 0  # of the derivatives

    @classmethod
    def of(
        cls, J: Float[Array, "r p"], r: Array, items: Any = None, floor: float = 0.0
    ) -> "Deletion":
        """Prepare the deletion of items from a fit with Jacobian J and residuals r."""
        size = np.linalg.norm(J, axis=0)
        q, upper = np.linalg.qr(J / np.where(size > 0.0, size, 1.0))
        residual = r - q @ (q.T @ r)
        return cls(
            q=q,
            residual=residual - q @ (q.T @ residual),
            items=items,
            floor=floor,
            rank=int(np.count_nonzero(np.abs(np.diagonal(upper)) > NO_ROOM)),
        )

    @property
    def count(self) -> int:
        """Number of items."""
        return len(self.residual if self.items is None else self.items)

    @property
    def dof(self) -> int:
        """Degrees of freedom: rows minus parameters."""
        return int(np.subtract(*self.q.shape))

    def without(
        self, subset: list[int]
    ) -> tuple[Float[Array, " r"], Float[Array, "r q"]]:
        """Residuals (O2) without a subset, and a basis of all that was fitted."""
        if not subset:
            return self.residual, self.q
        if self.items is None:
            columns = -self.q @ self.q[subset].T
            columns[subset, range(len(subset))] += 1.0
            inner = columns[subset]
        else:
            U = np.moveaxis(self.items[subset], 0, 1).reshape(len(self.q), -1)
            columns = U - self.q @ (self.q.T @ U)
            inner = columns.T @ columns
        values, vectors = np.linalg.eigh(inner)
        good = values > NO_ROOM * max(1.0, values[-1])
        half = columns @ (vectors[:, good] / np.sqrt(values[good]))
        residual = self.residual - half @ (half.T @ self.residual)
        if self.items is None:
            residual[subset] = 0.0
        return residual, np.concatenate([self.q, half], axis=1)

    def squares(self, subset: list[int]) -> float:
        """Sum of squares of the items that are kept."""
        residual = self.without(subset)[0]
        return max(float(residual @ residual), len(residual) * self.floor)

    def unknowns(self, subset: list[int]) -> int:
        """Degrees of freedom that leaving a subset out costs."""
        if self.items is None:
            return len(subset)
        return self.without(subset)[1].shape[1] - self.q.shape[1]

    def room(
        self, subset: list[int]
    ) -> tuple[Float[Array, "i m"], Float[Array, "i m m"]]:
        """U'r and S of each item, with a subset left out."""
        residual, along = self.without(subset)
        if self.items is None:
            room = 1.0 - np.sum(along**2, axis=1)
            room[subset] = 0.0
            return residual[:, None], room[:, None, None]
        own = self.items.mT
        seen = own @ along
        return own @ residual, own @ self.items - seen @ seen.mT

    def drops(self, subset: list[int]) -> Float[Array, " i"]:
        """Drop of the sum of squares if one more item is left out; NaN for none."""
        along, room = self.room(subset)
        if self.items is None:
            good = room[:, 0, 0] > NO_ROOM
            found = along[:, 0] ** 2 / np.where(good, room[:, 0, 0], 1.0)
            return np.where(good, found, np.nan)
        values, vectors = np.linalg.eigh(room)
        # effect of an error of the item that no parameter can take up
        good = values > 1e-6 * np.maximum(values[:, -1:], NO_ROOM)
        parts = np.vecmat(along, vectors) ** 2 / np.where(good, values, 1.0)
        found = np.where(good, parts, 0.0).sum(axis=1)
        found[subset] = np.nan
        return np.where(good.any(axis=1), found, np.nan)

    def greatest_drop(self, subset: list[int]) -> int:
        """The further item whose removal lowers the sum of squares most."""
        return int(np.argmax(np.nan_to_num(self.drops(subset), nan=-np.inf)))

    def leverage(self) -> Float[Array, " i"]:
        """Leverage of each item, 0 to 1."""
        assert self.items is not None
        _, room = self.room([])
        left = np.linalg.trace(room)
        return 1.0 - left / np.sum(self.items**2, axis=(1, 2))

    def outliers(self, known: float | None) -> list[int]:
        """Largest set of items that passes test (O1), together and one by one.

        `known` is the standard deviation of a row, where it is known.
        """
        count, size = self.count, 1
        if self.items is not None:
            size = max(1, self.unknowns([self.greatest_drop([])]))
        most = min(_MOST, (self.dof - LEFT) // size, max(3, count // _SHARE))
        if most < 1 or self.rank < self.q.shape[1]:
            return []
        chosen: list[int] = []
        subset: list[int] = []
        for k in range(1, most + 1):
            subset = self._worst(subset, k)
            taken = self.unknowns(subset)
            test = Drop(rest=self.squares(subset), dof=self.dof - taken, known=known)
            if test.dof < LEFT:
                break
            more, left = k - len(chosen), count - len(chosen)
            new = taken - self.unknowns(chosen)
            together = test.chance(self.squares(chosen), new)
            together *= scipy.special.binom(left, more)
            if not together <= FALSE_ALARM / most:
                continue
            alone = 0.0
            for i in subset:
                others = [j for j in subset if j != i]
                own = taken - self.unknowns(others)
                alone = max(alone, test.chance(self.squares(others), own))
            if (count - k + 1) * alone <= FALSE_ALARM:
                chosen = subset
        return sorted(chosen)

    def _worst(self, before: list[int], k: int) -> list[int]:
        # the k items whose removal lowers the sum of squares most: exactly up to three
        # rows, else one more, and exchanges until none helps
        if self.items is None and k <= 3 and self.count <= _ALL_TRIPLES:
            return _exhaustive(self, k)
        subset = [*before, self.greatest_drop(before)]
        best, turn, idle = self.squares(subset), 0, 0
        while idle < k:
            others = subset[:turn] + subset[turn + 1 :]
            trial = [*others, self.greatest_drop(others)]
            value = self.squares(trial)
            idle += 1
            if value < best * (1.0 - 1e-9):  # more than rounding, so no circle
                subset, best, idle = trial, value, 0
            turn = (turn + 1) % k
        return subset


def _exhaustive(deletion: Deletion, k: int) -> list[int]:
    # every set K of so many rows: greatest drop r_K' (P_KK)^-1 r_K, by elimination
    residual = deletion.residual
    sets = np.array(list(combinations(range(len(residual)), k)))
    P = np.eye(len(residual)) - deletion.q @ deletion.q.T
    own, r, drop = (
        P[sets[:, :, None], sets[:, None]],
        residual[sets],
        np.zeros(len(sets)),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        for j in range(k):
            pivot = own[:, j, j]
            drop += np.where(pivot > NO_ROOM, r[:, j] ** 2 / pivot, -np.inf)
            column = own[:, :, j] / pivot[:, None]
            r = r - column * r[:, j, None]
            own = own - column[:, :, None] * own[:, j, None]
    return sets[np.argmax(np.nan_to_num(drop, nan=-np.inf))].tolist()


def chi_square_chance(chi_square: float, dof: float) -> float:
    """Chance of a chi-square at least so large; NaN without degrees of freedom."""
    if not dof > 0:
        return np.nan
    return float(scipy.special.gammaincc(dof / 2.0, chi_square / 2.0))


def believed_range(dof: float) -> Float[Array, "2"]:
    """Range of chi-square within which a stated noise is believed."""
    return 2.0 * scipy.special.gammaincinv(dof / 2, [BELIEVED, 1.0 - BELIEVED])


class Drop(NamedTuple):
    """A drop of the sum of squares to `rest`, with `dof` degrees of freedom."""

    rest: float
    dof: int
    known: float | None  # standard deviation of a residual, where it is known

    def chance(self, before: float, k: int) -> float:
        """Chance that k more unknowns lower the sum of squares as far from `before`."""
        ratio = min(self.rest / before, 1.0)
        by_scatter = scipy.special.betainc(self.dof / 2.0, k / 2.0, ratio)
        if self.known is None:
            return by_scatter
        left = self.rest / self.known**2
        by_sigma = 1.0
        if chi_square_chance(left, self.dof) >= BELIEVED:
            drop = before / self.known**2 - left
            by_sigma = chi_square_chance(max(drop, 0.0), k)
        return min(1.0, 2.0 * min(by_scatter, by_sigma))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorResiduals(ReadOnly):
    """What the residuals of a fit say of one sensor."""

    name: str
    item: str  # what it was read in, rest or move
    chi_square: float  # its part, by the noise of the fit
    dof: float  # the mean of that, if the noise is as it was taken
    p_value: float  # of as much; NaN where too few degrees of freedom are left
    leverage: Float[Array, " n"]  # share of each rest or move in its own fit, 0 to 1
    # of each from what all others say, in standard deviations of the noise of the fit
    deviations: Float[Array, " n"]
    # rests or moves that do not belong; any of a clean log with a chance of 1 %
    outliers: tuple[int, ...]

    @property
    def worst(self) -> int:
        """The rest or move with the largest residual."""
        return int(np.argmax(np.nan_to_num(self.deviations)))

    @property
    def remark(self) -> Remark:
        """A remark on the sensor's residuals."""
        off = self.deviations[self.worst]
        words = (
            f"{self.name}: chi-square {self.chi_square:.3g} with "
            f"{self.dof:.3g} degrees of freedom ({p_words(self.p_value)}); "
            f"farthest off: {self.item} {self.worst}, by {off:.3g} standard deviations"
        )
        kind, do = "residuals", ""
        if self.outliers:
            named = " and ".join(f"{self.item} {k}" for k in self.outliers)
            kind, words = "outliers", f"{words}; does not belong: {named}"
            do = "Look at it and leave it out."
        numbers = {"worst": self.worst, "standard_deviations": off}
        return Remark(kind, words, do, numbers)

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        known = np.isfinite(self.p_value)
        return {
            "chi_square": self.chi_square,
            "dof": self.dof,
            "p_value": self.p_value if known else None,
            "in": self.item,
            "leverage": self.leverage.tolist(),
            "deviations": np.nan_to_num(self.deviations).tolist(),
            "outliers": list(self.outliers),
        }


class Left:
    """Residuals outside the range of the parameters, in units of the fit's noise.

    That is the stated one of each source, and errors beside it of such variances.
    """

    def __init__(self, rows: Residuals, variances: Array | None = None) -> None:
        self.rows, self.sources = rows, rows.sources
        count = len(rows.beside)
        self.variances = np.zeros(count) if variances is None else variances
        stated = sum(s.covariance for s in rows.sources)
        more = [each.covariance for each in rows.beside]
        S = stated + sum(v * U for v, U in zip(self.variances, more, strict=True))
        self.white = np.linalg.inv(np.linalg.cholesky(S))
        self.base = self.white @ stated @ self.white.T
        J = self.white @ rows.J
        self.J = J / np.linalg.norm(J, axis=0)
        self.Z = np.linalg.qr(self.J, mode="complete")[0][:, J.shape[1] :]
        self.y = self.Z.T @ (self.white @ rows.r)
        seen = self.Z.T @ self.white
        self.V = [seen @ s.covariance @ seen.T for s in rows.sources]
        self.U = [seen @ U @ seen.T for U in more]
        none = np.zeros(count)
        self.stated = self.moments(none, self.V)
        self.asked = self.moments(none, self.U)

    def covariance(self, variances: Float[Array, " e"]) -> Float[Array, "d d"]:
        """Covariance of the residuals, with errors of such variances added."""
        more = (v * U for v, U in zip(variances, self.U, strict=True))
        return sum(self.V) + sum(more)

    def moments(
        self, variances: Float[Array, " e"], parts: Sequence[Array]
    ) -> Float[Array, "s 3"]:
        """Each part's share of chi-square, with the mean and variance of that share."""
        weight = np.linalg.inv(self.covariance(variances))
        q, values = weight @ self.y, []
        for V in parts:
            A = weight @ V
            values.append((q @ V @ q, np.trace(A), 2.0 * np.sum(A * A.T)))
        return np.array(values).reshape(-1, 3)

    def p_value(self) -> float:
        """Chance of residuals as large with noise as stated, in all or by one error."""
        rows = self.y.size
        every = [(self.stated[:, 0].sum(), rows, 2.0 * rows), *self.asked]
        chances = [sum_chance(each) for each in every if freedom(each) > LEAST_FREEDOM]
        return min(1.0, len(chances) * min(chances))

    def combination(self) -> Combination:
        """The combination of parameters that the rows determine worst."""
        return least_determined_of(self.J, self.rows.names)

    def sensors(self) -> tuple[SensorResiduals, ...]:
        """Judge each sensor, rest and move, by the noise that the fit used."""
        wide = max(each.items.shape[2] for each in self.sources)
        items = [
            np.pad(
                self.white @ each.items,
                ((0, 0), (0, 0), (0, wide - each.items.shape[2])),
            )
            for each in self.sources
        ]
        deletion = Deletion.of(self.J, self.white @ self.rows.r, np.concatenate(items))
        drops, leverage = deletion.drops([]), deletion.leverage()
        worst = deletion.greatest_drop([])
        chance = chi_square_chance(drops[worst], deletion.unknowns([worst]))
        seen = deletion.count * chance < FALSE_ALARM or self.p_value() < BELIEVED
        outliers = np.array(deletion.outliers(1.0) if seen else [], dtype=int)
        ends = np.cumsum([0, *(len(each) for each in items)])
        errors = list(zip(self.rows.beside, self.variances, self.U, strict=True))
        taken = [
            V + sum(v * U for error, v, U in errors if error.cause == each.name)
            for each, V in zip(self.sources, self.V, strict=True)
        ]
        values = self.moments(self.variances, taken)
        return tuple(
            SensorResiduals(
                name=each.name,
                item=each.item,
                chi_square=float(value[0]),
                dof=float(value[1]),
                p_value=sum_chance(value) if value[1] > LEAST_FREEDOM else np.nan,
                leverage=leverage[a:b],
                deviations=np.sqrt(drops[a:b]),
                outliers=tuple(int(k - a) for k in outliers if a <= k < b),
            )
            for each, value, a, b in zip(
                self.sources, values, ends[:-1], ends[1:], strict=True
            )
        )


def freedom(value: Any) -> float:
    """Degrees of freedom of a sum of squares with this mean and variance."""
    _, mean, variance = value
    return float(2.0 * mean**2 / variance) if variance > 0.0 else 0.0


def sum_chance(value: Any) -> float:
    """Chance of a sum of squares as large, from its mean and variance."""
    seen, mean, variance = value
    return float(scipy.special.gammaincc(mean**2 / variance, seen * mean / variance))
