r"""Which sensors of a joint fit bear their stated noise, and what the others need.

The rows of a joint fit are :math:`r = J\,\mathrm{d}\theta + \sum_s n_s`, each n_s the
noise of one sensor, its source, of covariance :math:`\lambda_s V_s`; V_s is what was
stated. With :math:`S = \sum_s \lambda_s V_s` and Z a basis of what J cannot explain,
:math:`P = Z (Z^T S Z)^{-1} Z^T`, true factors give

.. math:: E\,r^T P V_s P r = \mathrm{tr}\,P V_s,\qquad
   \mathrm{var}\,r^T P V_s P r = 2\,\mathrm{tr}\,P V_s P V_s,

and the factors of restricted maximum likelihood are those that make both sides equal
(1 where that would be less): each is multiplied by the ratio until none changes. At the
stated noise the sum over the sources is chi-square of all rows. That and each source's
own part are tested first; where all are what chance leaves, nothing is done. Sources
that chance explains beside the factors of the others go back to 1, one by one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.shapes import Float

F = TypeVar("F")
CHANCE: Final = 1e-3
"""Of a log whose noise is as stated: that any of its sensors is given more."""
MOST_FACTOR: Final = 10.0
"""Of the error bars of a sensor's own parameters. Beyond it the stated noise is less
than a hundredth of the variance that is seen: what governs the result is in no model,
and to the others the sensor tells less than a hundredth of what it was taken for, half
a percent of their error bars. It is left out."""
_STILL: Final = 1e-4  # of a factor, between steps of its search
_MOST_STEPS: Final = 500
_ROUNDS: Final = 8  # of factors and fit; three are usual
_SAME: Final = 1e-2  # of a factor, between rounds: a hundredth of an error bar
_TOLD: Final = 1e-2  # degrees of freedom of a source below which nothing is told of it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Source:
    """A sensor whose noise is in the rows of a fit."""

    name: str
    covariance: Float[Array, "r r"]  # that its noise gives the rows
    items: Float[Array, "i r m"]  # what an error of each rest or move does to the rows
    item: str  # rest or move
    parameters: slice  # its own


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Rows of one fit where it ended, in any units, and whose noise they hold."""

    r: Float[Array, " r"]
    J: Float[Array, "r p"]
    sources: tuple[Source, ...]

    @classmethod
    def of_rests_and_moves(
        cls,
        r: Float[Array, " r"],
        J: Float[Array, "r p"],
        V: Float[Array, "r r"],
        rests: Mapping[str, tuple[Float[Array, "r i 3"], slice]],
        moves: tuple[int, int, slice] | None = None,
    ) -> "Residuals":
        """Rows of which the first are those of moves, so many of so many rows.

        What is not noise of the sensors that are read at rest is the gyroscope's.
        """
        flat = {name: L.reshape(len(r), -1) for name, (L, _) in rests.items()}
        parts: dict[str, Array] = {name: L @ L.T for name, L in flat.items()}
        told = {name: (L, "rest", at) for name, (L, at) in rests.items()}
        if moves is not None:
            count, each, own = moves
            rows = np.eye(len(r), count * each).reshape(len(r), count, each)
            parts["gyroscope"] = V - sum(parts.values())
            told["gyroscope"] = rows, "move", own
        return cls(
            r=r,
            J=J,
            sources=tuple(
                Source(
                    name=name, covariance=parts[name], items=np.moveaxis(L, 1, 0),
                    item=item, parameters=at,
                )
                for name, (L, item, at) in told.items()
            ),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFactors(ReadOnly):
    """What the residuals of one joint fit ask of the noise of each of its sensors.

    A batch of trials is weighed by the noise that is stated: it has no sources.

    Attributes
    ----------
    sources : tuple of str
        Sensors; empty where none was judged.
    factor : Array
        By how much the standard deviations of the sensor's noise exceed those stated;
        1 where they are borne, (s,).
    widening : Array
        By how much the error bars of the sensor's own parameters have grown, at most,
        (s,).
    dof : Array
        Degrees of freedom that the factor was told by, (s,).
    items : tuple of str
        What each sensor was read in, rest or move.
    worst : Array of int
        That rest or move which is farthest off, (s,).
    deviations : Array
        How far, in standard deviations of the stated noise, (s,).
    p_value : float
        Chance that noise as stated leaves as much, in all rows or in those of any
        sensor; below `CHANCE` a factor is asked for. NaN where none was judged.
    """

    sources: tuple[str, ...]
    factor: Float[Array, " s"]
    widening: Float[Array, " s"]
    dof: Float[Array, " s"]
    items: tuple[str, ...]
    worst: Any
    deviations: Float[Array, " s"]
    p_value: float

    @property
    def borne(self) -> bool:
        """Whether no sensor was given more than its stated noise."""
        return not np.any(self.factor > 1.0)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What there is to say of each sensor whose noise is more than was stated."""
        return tuple(
            f"noise of the {name}: taken {self.factor[s]:.3g} times as large as stated "
            f"or measured, as its residuals ask; {self.items[s]} {self.worst[s]} is "
            f"farthest off ({self.deviations[s]:.3g} standard deviations)"
            for s, name in enumerate(self.sources)
            if self.factor[s] > 1.0
        )

    @property
    def refusal(self) -> str:
        """Why the fit is no calibration; empty where it is one."""
        wide = np.flatnonzero((self.factor > 1.0) & ~(self.widening <= MOST_FACTOR))
        if not wide.size:
            return ""
        s = max(wide, key=lambda each: float(self.widening[each]))
        return (
            f"the residuals of the {self.sources[s]} ask for {self.factor[s]:.3g} "
            f"times its noise as stated or measured, and for error bars "
            f"{self.widening[s]:.3g} times as wide, {MOST_FACTOR:g} at most: it does "
            "not follow the model of one calibration; look at "
            f"{self.items[s]} {self.worst[s]}, which is farthest off, at a scale or a "
            "bias that changes with time, at the range and the clock of the sensor, "
            "and at that noise"
        )

    def as_object(self) -> dict[str, Any]:
        """Return what was found of each sensor, as JSON can hold it."""
        return {
            name: {
                "factor": float(self.factor[s]),
                "widening": float(self.widening[s]),
                "dof": float(self.dof[s]),
                "worst": {
                    self.items[s]: int(self.worst[s]),
                    "deviations": float(self.deviations[s]),
                },
            }
            for s, name in enumerate(self.sources)
        }


NOT_JUDGED: Final = NoiseFactors(
    sources=(), factor=np.ones(0), widening=np.ones(0), dof=np.zeros(0), items=(),
    worst=np.zeros(0, int), deviations=np.zeros(0), p_value=float("nan"),
)  # fmt: skip


def judged(
    found: F,
    fit: Callable[[F, Float[Array, " s"]], F],
    residuals: Callable[[F], Residuals],
) -> tuple[F, NoiseFactors]:
    """Fit again with the noise that the residuals ask for, if they ask for more.

    Parameters
    ----------
    found : object
        A fit by the stated noise.
    fit : callable
        From a fit and the factors of its sources' standard deviations to the fit with
        those.
    residuals : callable
        Rows of a fit where it ended, the covariances with the noise it was made with.

    Returns
    -------
    object, NoiseFactors
        The last fit, and what it was made with.
    """
    left = _Left(residuals(found))
    for _ in range(_ROUNDS):
        asked = left.factors()
        if np.all(np.abs(np.log(asked / left.factor)) < _SAME):
            break
        found = fit(found, asked)
        left = _Left(residuals(found), asked)
    return found, left.told()


class _Left:
    # what the parameters cannot explain of the rows, in units of the fit's noise
    def __init__(self, rows: Residuals, factor: Array | None = None) -> None:
        self.sources, count = rows.sources, len(rows.sources)
        self.factor = np.ones(count) if factor is None else factor
        parts = [s.covariance for s in rows.sources]
        self.white = np.linalg.inv(np.linalg.cholesky(sum(parts)))
        J = self.white @ rows.J
        self.J = J / np.linalg.norm(J, axis=0)
        self.parts = [
            self.white @ V @ self.white.T / f**2
            for V, f in zip(parts, self.factor, strict=True)
        ]
        self.Z = np.linalg.qr(self.J, mode="complete")[0][:, J.shape[1] :]
        self.y = self.Z.T @ (self.white @ rows.r)
        self.V = [self.Z.T @ part @ self.Z for part in self.parts]
        self.stated = self.moments(np.ones(count))
        self.free = [s for s, mean in enumerate(self.stated[:, 1]) if mean > _TOLD]

    def weight(self, factor: Float[Array, " s"]) -> Float[Array, "q q"]:
        """Inverse covariance of what is left, with these factors."""
        S = sum(f * f * V for f, V in zip(factor, self.V, strict=True))
        return np.asarray(np.linalg.inv(S))

    def moments(self, factor: Float[Array, " s"]) -> Float[Array, "s 3"]:
        """Of each source: its part of chi-square at these, mean, and variance."""
        weight, values = self.weight(factor), []
        q = weight @ self.y
        for f, V in zip(factor, self.V, strict=True):
            A = weight @ V
            squares = 2.0 * f**4 * np.sum(A * A.T)
            values.append((f * f * (q @ V @ q), f * f * np.trace(A), squares))
        return np.array(values)

    def p_value(self) -> float:
        """Chance that noise as stated leaves as much, in all rows or of any source."""
        value, rows = self.stated, self.y.size
        every = [(value[:, 0].sum(), rows, 2.0 * rows), *value[self.free]]
        return min(1.0, len(every) * min(map(_chance, every)))

    def factors(self) -> Float[Array, " s"]:
        """Of the standard deviations: what the residuals ask for, 1 at the least."""
        free = list(self.free)
        if not free or self.p_value() >= CHANCE:
            return np.ones(len(self.V))
        while True:
            factor = self._balanced(free)
            chances = [self._chance_at_stated(factor, s) for s in free]
            most = int(np.argmax(chances))
            if len(free) == 1 or chances[most] < CHANCE / (len(self.V) + 1):
                return factor
            free.pop(most)

    def _balanced(self, free: list[int]) -> Float[Array, " s"]:
        # factors of these sources by restricted maximum likelihood
        factor = np.ones(len(self.V))
        for _ in range(_MOST_STEPS):
            last, found = factor.copy(), self.moments(factor)
            ratio = np.sqrt(found[free, 0] / found[free, 1])
            factor[free] = np.maximum(1.0, factor[free] * ratio)
            if np.all(np.abs(np.log(factor / last)) < _STILL):
                break
        return factor

    def _chance_at_stated(self, factor: Float[Array, " s"], source: int) -> float:
        # that noise as stated of one leaves as much, the others as they are
        stated = np.where(np.arange(len(factor)) == source, 1.0, factor)
        return _chance(self.moments(stated)[source])

    def told(self) -> NoiseFactors:
        """What the fit tells, with its factors."""
        factor = self.factor
        S = sum(f * f * V for f, V in zip(factor, self.parts, strict=True))
        bars = [
            np.linalg.inv(self.J.T @ np.linalg.solve(V, self.J)).diagonal()
            for V in (S, sum(self.parts))
        ]
        wider = np.sqrt(bars[0] / bars[1])
        far = [self._distances(each) for each in self.sources]
        worst = np.array([int(np.argmax(each)) for each in far])
        return NoiseFactors(
            sources=tuple(each.name for each in self.sources),
            factor=factor,
            widening=np.array([wider[s.parameters].max() for s in self.sources]),
            dof=self.moments(factor)[:, 1],
            items=tuple(each.item for each in self.sources),
            worst=worst,
            p_value=self.p_value(),
            deviations=factor
            * np.array([d[k] for d, k in zip(far, worst, strict=True)]),
        )

    def _distances(self, source: Source) -> Float[Array, " i"]:
        # of each rest or move from what all others say
        items, _, size = source.items.shape
        flat = np.moveaxis(source.items, 0, 1).reshape(len(self.white), -1)
        U = self.Z.T @ (self.white @ flat)
        solved = self.weight(self.factor) @ U
        each = (-1, items, size)
        C = np.einsum("qia,qib->iab", U.reshape(each), solved.reshape(each))
        seen = (self.y @ solved).reshape(items, size)
        best = np.linalg.pinv(C, rcond=1e-6, hermitian=True) @ seen[..., None]
        return np.sqrt((seen[:, None] @ best)[:, 0, 0])


def _chance(value: Any) -> float:
    # of a sum of squares of this mean and variance to be as large
    seen, mean, variance = value
    return float(scipy.special.gammaincc(mean**2 / variance, seen * mean / variance))
