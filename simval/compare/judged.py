"""The statistics of two runs side by side, judged together by Holm's rule."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot, isfinite
from typing import Literal

import numpy as np
import scipy

from simval.change import EXACT_BOUND, holm, on_same_noise
from simval.compare.matching import Pair, prediction_changed
from simval.compare.moves import Standing, Step, loss, rounding_of, standing
from simval.results import Row

Kind = Literal["changed", "moved", "same"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One statistic in both runs.

    Attributes
    ----------
    cells : tuple of str
        Name of the cell in A and in B.
    a, b : Row
        The statistic in both.
    kind : Kind
        ``changed`` beyond its uncertainty; ``moved`` within it, though the noise was
        the same, so the algorithm is not; ``same``.
    standard_error : float
        Of the difference, eq. (D1).
    p_value : float or None
        None where the statistic is deterministic.
    predictors : tuple of str
        Theories that the same value is compared with; `a` and `b` are the first one's.
    standing : {"better", "worse", "neither"}
        Which way it moved, by the direction of its family.
    study : str
        Name of the study.
    """

    cells: tuple[str, str]
    a: Row
    b: Row
    kind: Kind
    standard_error: float
    p_value: float | None
    predictors: tuple[str, ...]
    standing: Standing = "neither"
    study: str = ""

    @property
    def name(self) -> str:
        """Statistic, and the theories it is compared with."""
        theories = "; ".join(p for p in self.predictors if p)
        return f"{self.a.statistic}{' against ' if theories else ''}{theories}"

    @property
    def difference(self) -> float:
        """Value in B minus value in A."""
        return self.b.value - self.a.value

    @property
    def sigmas(self) -> float | None:
        """Difference in standard errors; None for a deterministic statistic."""
        if not self.standard_error > 0.0:
            return None
        return self.difference / self.standard_error

    @property
    def relative(self) -> float | None:
        """Difference over the size of A's value; None where that is zero."""
        return self.difference / abs(self.a.value) if self.a.value else None

    @property
    def prediction_changed(self) -> bool:
        """Whether the prediction itself changed."""
        return prediction_changed(self.a, self.b)

    @property
    def step(self) -> Step:
        """The same as a step, for `simval.compare.moved`."""
        return Step(
            study=self.study,
            cell=self.cells[1],
            statistic=self.b.statistic,
            before=self.a.value,
            after=self.b.value,
            error=self.standard_error,
            moved=self.kind == "changed",
            standing=self.standing,
            predictions=(self.a.prediction, self.b.prediction),
        )


def judged(pairs: Iterable[Pair], alpha: float) -> list[Difference]:
    """Judge pairs of statistics together."""
    listed = []
    for pair in pairs:
        a, b = pair[2], pair[3]
        error = hypot(a.standard_error, b.standard_error)
        p = two_sided(b.value - a.value, error) if error > 0.0 else None
        listed.append((pair, error, p))
    values = np.array([p for _, _, p in listed if p is not None])
    limits = iter(holm(values, alpha).tolist())
    return [
        _difference(pair, error, p, -np.inf if p is None else next(limits))
        for pair, error, p in listed
    ]


def _difference(pair: Pair, error: float, p: float | None, limit: float) -> Difference:
    old, new, a, b, theories = pair
    kind = _kind_of_pair(pair, error, beyond=p is not None and not p > limit)
    return Difference(
        cells=(old.name, new.name),
        study=new.study,
        a=a,
        b=b,
        kind=kind,
        standing=_standing(a, b, error, limit) if kind == "changed" else "neither",
        standard_error=error,
        p_value=p,
        predictors=theories,
    )


def _kind_of_pair(pair: Pair, error: float, *, beyond: bool) -> Kind:
    old, new, a, b, _ = pair
    paired = old.name == new.name and a.n == b.n
    return _kind(a, b, error, beyond=beyond, paired=paired)


def two_sided(difference: float, error: float) -> float:
    """Probability of so great a difference by chance; 0 of one that is no number."""
    if not (isfinite(difference) and isfinite(error)):
        return 0.0  # a value that became NaN or infinite has changed
    return float(2.0 * scipy.special.ndtr(-abs(difference) / error))


def _kind(a: Row, b: Row, error: float, *, beyond: bool, paired: bool) -> Kind:
    if a.check == b.check == "limit" and a.prediction is not None:
        crossed = (a.value <= a.prediction) != (b.value <= (b.prediction or 0.0))
        return "changed" if crossed else "same"
    sampled = error > 0.0
    if sampled and beyond:
        return "changed"
    bound = rounding_of(a, error)
    if on_same_noise(a.value, b.value, bound) != "changed":
        return "same"
    if not sampled:
        return "changed"
    return "moved" if paired else "same"


def _standing(a: Row, b: Row, error: float, limit: float) -> Standing:
    """Which way a value changed: its loss must have changed as well."""
    change = _loss_change(a, b)
    least = EXACT_BOUND * abs(a.value) if isfinite(a.value) else 0.0
    if error > 0.0:
        least = -float(scipy.special.ndtri(limit / 2.0)) * error
    return standing(change, least)


def _loss_change(a: Row, b: Row) -> float:
    before = loss(a.statistic, a.value, a.prediction)
    return loss(b.statistic, b.value, b.prediction) - before
