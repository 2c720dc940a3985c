"""One statistic of a run compared with the baseline: how it changed, in words."""

from dataclasses import dataclass
from math import isfinite
from typing import Literal

import scipy

from simval.change import TOST_QUANTILE
from simval.results import CellName
from simval.statistics import Statistic
from simval.verdict import POWER, Answer

Change = Literal[
    "same",
    "close",
    "equivalent",
    "changed",
    "unresolved",
    "copied",
    "precision",
    "theory",
    "missing",
    "unjudged",
    "new",
]
FAILED: tuple[Change, ...] = (
    "changed",
    "copied",
    "precision",
    "theory",
    "missing",
    "unjudged",
)


def answer_of(change: Change) -> Answer:
    """Pass, fail or inconclusive."""
    if change in FAILED:
        return "fail"
    return "inconclusive" if change == "unresolved" else "pass"


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One statistic of a cell, now and in the baseline.

    Attributes
    ----------
    cell : CellName
        The cell as the run names it, or the baseline where missing.
    statistic : str
        What is compared.
    change : str
        ``same`` to the bit, ``close`` within the paired bound, ``equivalent`` by eq.
        (B1), ``changed`` beyond either, ``unresolved`` between, ``copied`` equal to
        the bit though the noise should differ, ``precision`` if the standard error or
        the number of samples changed, ``theory`` if a prediction or its remainder
        changed, ``missing`` from the run, ``unjudged`` by a check that the baseline
        names, ``new`` in the run.
    stored, value : float or None
        In the baseline and in the run.
    standard_error : float
        Of the stored value; of the difference where the noise differs.
    margin : float
        What is allowed; 0 where nothing is compared.
    n : int
        Samples behind the stored value.
    detail : str
        What else differs from the baseline.
    measured : Statistic or None
        What it is; None where the run does not have it.
    predictions : tuple of (float or None)
        What theory predicts of it, in the baseline and in the run.
    same_noise : bool
        Whether both have the same seed: then only rounding may differ.
    left_open : float
        The least that a theory leaves open of the value.
    """

    cell: CellName
    statistic: str
    change: Change
    stored: float | None = None
    value: float | None = None
    standard_error: float = 0.0
    margin: float = 0.0
    n: int = 0
    detail: str = ""
    measured: Statistic | None = None
    predictions: tuple[float | None, float | None] = (None, None)
    same_noise: bool = False
    left_open: float = 0.0

    @property
    def answer(self) -> Answer:
        """Pass, fail or inconclusive."""
        return answer_of(self.change)

    @property
    def sigmas(self) -> float:
        """Change in standard errors; NaN where there is none."""
        if self.stored is None or self.value is None or not self.standard_error > 0:
            return float("nan")
        return (self.value - self.stored) / self.standard_error

    @property
    def reason(self) -> str:
        """Why this is not a pass, in words; empty for a pass."""
        if self.change == "missing":
            return "in the baseline, but no longer measured"
        if self.change == "unjudged":
            return "no longer judged as the baseline says"
        if self.change == "copied":
            return (
                "equal to the bit, like all of its cell, though its noise should "
                "differ: the seed is not used, or the baseline names a wrong one"
            )
        if self.change in ("precision", "theory"):
            return self.detail
        if self.answer == "pass" or self.stored is None or self.value is None:
            return ""
        words = f"{self.stored:.9g} in the baseline, now {self.value:.9g}"
        if not isfinite(self.value):
            return words
        return f"{words}: {self._size(self.stored, self.value)}"

    def _size(self, stored: float, value: float) -> str:
        """By how much it changed, and what was allowed."""
        step = value - stored
        size = (
            f"{self.sigmas:+.3g} standard errors"
            if self.standard_error > 0
            else f"{step / abs(stored):+.3g} of its size"
            if stored
            else f"{step:+.3g}"
        )
        if self.change == "unresolved" and self.margin > 0.0:
            need = (
                (TOST_QUANTILE + float(scipy.special.ndtri(POWER)))
                * self.standard_error
                / self.margin
            )
            size += (
                f"; whether that is within {self.margin:.3g} takes about "
                f"{max(self.n * need**2, self.n):.2g} samples, in both runs"
            )
        if self.same_noise and self.change == "changed":
            size += f", but equal seeds must give equal numbers, to {self.margin:.2g}"
        return size
