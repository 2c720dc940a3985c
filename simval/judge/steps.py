r"""Changes between runs, with their direction and size, singly and in groups.

A `Step` is one statistic of one cell, before and after. It is *better* or *worse* by
the direction of its family (`simval.statistics.Family.better`), through the loss

.. math:: L = v, \quad -v, \quad |v| \quad\text{or}\quad |v - p| \tag{D3}

of a value v that should be less, more, zero, or what theory predicts, p. The standard
error of :math:`L_B - L_A` is at most that of the value's difference, so a loss that
moved by more than the difference may move by chance has a direction; one that moved by
less, like a bias that changed its sign, has none.

A `Move` puts together the steps of one study, kind of statistic and direction. Both are
sorted by their weight: standard errors, and for a value without chance the change over
the margin of its family or, where that is more, over what it is judged to.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from simval.arrays import Array
from simval.change import rounding_bound
from simval.results import Row
from simval.shapes import Float
from simval.spelling import standard_errors
from simval.statistics import Statistic
from simval.sweep.cells import CellResult

Standing = Literal["better", "worse", "neither"]

AIMED = ("zero", "prediction")
"""Directions that are towards a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Change of one statistic of one cell."""

    study: str
    cell: str  # as the later run names it
    statistic: Statistic
    before: float
    after: float
    error: float  # standard error of the difference; 0 where there is no chance
    moved: bool  # by more than it may
    standing: Standing = "neither"  # which way, where it moved
    predictions: tuple[float | None, float | None] = (None, None)  # before and after
    left_open: float = 0.0  # what theory leaves open of the value

    @property
    def sigmas(self) -> float | None:
        """Change in standard errors; None if no chance is involved."""
        return (self.after - self.before) / self.error if self.error > 0.0 else None

    @property
    def relative(self) -> float | None:
        """Relative change; None for a value of zero, or one that should be zero."""
        if not self.before or self.statistic.better == "zero":
            return None
        return (self.after - self.before) / abs(self.before)

    @property
    def weight(self) -> float:
        """Size of the change, for sorting."""
        if self.after == self.before:
            return 0.0
        size = self.sigmas
        if size is None:
            # rounding is small compared with the limit or remainder that judges it
            judged = [p for p in self.predictions if p is not None and isfinite(p)]
            room = max(
                self.statistic.family.margin * abs(self.before),
                *(abs(p - self.before) for p in judged),
                self.left_open,
            )
            size = (self.after - self.before) / room if room else inf
        return abs(size) if isfinite(size) else inf

    @property
    def loss_change(self) -> float:
        """Change of the loss, eq. (D3); NaN where no direction is better."""
        values = (self.before, self.after)
        return loss_change(self.statistic, values, self.predictions)


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """Values of one kind that changed in the same direction."""

    study: str
    what: str  # the kind of statistic in words
    standing: Standing
    steps: tuple[Step, ...]  # the values that moved, largest first
    cells: int  # in which one moved
    of: int  # cells that have one of this kind

    @property
    def worst(self) -> Step:
        """The value that changed most."""
        return self.steps[0]

    @property
    def sigmas(self) -> float | None:
        """Largest change in standard errors; None if no chance is involved."""
        sizes = [abs(s.sigmas) for s in self.steps if s.sigmas is not None]
        return max((s for s in sizes if isfinite(s)), default=None)

    @property
    def way(self) -> str:
        """The direction in one word: ``better``, ``worse`` or ``moved``."""
        return "moved" if self.standing == "neither" else self.standing

    @property
    def size(self) -> str:
        """Say by how much the values changed: ``1.7 % larger``."""
        aim = self.worst.statistic.better
        if aim in AIMED:
            return self._distance("0" if aim == "zero" else "its prediction")
        shares = [step.relative for step in self.steps]
        known = [share for share in shares if share is not None and isfinite(share)]
        if len(known) < len(shares):
            step = self.worst
            return f"from {step.before:.4g} to {step.after:.4g}"
        return share_words(known)

    @property
    def sentence(self) -> str:
        """Say what changed, by how much and where."""
        sigmas = self.sigmas
        far = "" if sigmas is None else f", up to {standard_errors(_digits(sigmas))}"
        where = "" if self.of == 1 else f" in {self.cells} of {self.of} cells"
        return f"{self.study}, {self.what}: {self.size}{where}{far}"

    def _distance(self, aim: str) -> str:
        """Say by how much the distance from the aim changed."""
        unit = self.worst.statistic.unit
        suffix = "" if unit == "1" else f" {unit}"
        if self.standing == "neither":
            step = max(abs(step.after - step.before) for step in self.steps)
            return f"by up to {step:.2g}{suffix}"
        step = max(abs(step.loss_change) for step in self.steps)
        way = "nearer to" if self.standing == "better" else "farther from"
        return f"{way} {aim} by up to {step:.2g}{suffix}"


def share_words(
    shares: Sequence[float],
    words: tuple[str, str, str] = ("larger", "smaller", "times as large"),
) -> str:
    """Say a range of relative changes: ``1.5 to 1.8 % larger``."""
    larger, smaller, times = words
    if min(shares) < 0.0 < max(shares):
        return f"by up to {100.0 * max(map(abs, shares)):.2g} % either way"
    word = larger if max(shares) > 0.0 else smaller
    if max(shares) > 1.0:
        return f"{_range([1.0 + share for share in shares])} {times}"
    return f"{_range([100.0 * abs(share) for share in shares])} % {word}"


def _range(values: Sequence[float]) -> str:
    least, most = f"{min(values):.2g}", f"{max(values):.2g}"
    return most if least == most else f"{least} to {most}"


def _digits(sigmas: float) -> str:
    """Standard errors to the digits that matter."""
    return f"{sigmas:,.0f}" if sigmas >= 100.0 else f"{sigmas:.2g}"


def loss(statistic: Statistic, value: float, prediction: float | None) -> float:
    """Loss of a value, eq. (D3); NaN where no direction is better."""
    if statistic.better is None or (
        statistic.better == "prediction" and prediction is None
    ):
        return np.nan
    if not isfinite(value):
        return inf
    return {
        "less": value,
        "more": -value,
        "zero": abs(value),
        "prediction": abs(value - (prediction or 0.0)),
    }[statistic.better]


def loss_change(
    statistic: Statistic,
    values: tuple[float, float],
    predictions: tuple[float | None, float | None],
) -> float:
    """Change of the loss, eq. (D3), of a value before and after."""
    before, after = map(partial(loss, statistic), values, predictions)
    return after - before


def standing(change: float, least: float) -> Standing:
    """Whether a change of the loss is better, worse, or below what counts."""
    if not abs(change) > least:  # nor of NaN
        return "neither"
    return "better" if change < 0.0 else "worse"


def kind_of(statistic: Statistic) -> str:
    """Kind of a statistic in words, without axis, level or quantile."""
    kinds = statistic.kinds
    words = f"{statistic.family.words}{' of ' if kinds else ''}{', '.join(kinds)}"
    return f"{words}, control variates" if statistic.controlled else words


def moved(
    steps: Iterable[Step], others: Iterable[tuple[str, Statistic, str]] = ()
) -> tuple[Move, ...]:
    """Group changes by study, kind of statistic and direction.

    Parameters
    ----------
    steps : iterable of Step
        `RunComparison.differences` of two runs, or `GateResult.steps` of a run
        and its baseline; those that did not move count among all.
    others : iterable of (str, Statistic, str)
        Study, statistic and cell of what counts among all beside the steps.

    Returns
    -------
    tuple of Move
        What moved, largest first; empty if nothing did.
    """
    cells: dict[tuple[str, str], set[str]] = {}
    for study, statistic, cell in others:
        cells.setdefault((study, kind_of(statistic)), set()).add(cell)
    groups: dict[tuple[str, str, Standing], list[Step]] = {}
    for step in steps:
        kind = step.study, kind_of(step.statistic)
        cells.setdefault(kind, set()).add(step.cell)
        if step.moved:
            groups.setdefault((*kind, step.standing), []).append(step)
    moves = [
        Move(
            study=study,
            what=what,
            standing=way,
            # by name where they weigh the same
            steps=tuple(
                sorted(members, key=lambda s: (-s.weight, s.cell, str(s.statistic)))
            ),
            cells=len({step.cell for step in members}),
            of=len(cells[study, what]),
        )
        for (study, what, way), members in groups.items()
    ]
    return tuple(sorted(moves, key=lambda m: (-m.worst.weight, m.study, m.what)))


def short_names(cells: Iterable[CellResult]) -> dict[str, str]:
    """Short name of each cell: what distinguishes it in its study."""
    studies: dict[str, list[CellResult]] = {}
    for cell in cells:
        studies.setdefault(cell.study, []).append(cell)
    found = {}
    for own in studies.values():
        tables = [{**cell.parameters, "seed": cell.seed} for cell in own]
        keys = [key for key in tables[0]
                if len({str(each.get(key)) for each in tables}) > 1]  # fmt: skip
        for cell, each in zip(own, tables, strict=True):
            words = (f"{key} {each[key]}" for key in keys if key in each)
            found[cell.name] = ", ".join(words)
    return found


def rounding_of(rows: Sequence[Row], error: ArrayLike) -> Float[Array, " n"]:
    """Largest change that rounding alone makes in rows with these errors."""
    errors = np.broadcast_to(np.asarray(error, dtype=float), len(rows))
    remainder = np.array([row.remainder for row in rows], dtype=float)
    exact = np.array([row.check == "exact" for row in rows], dtype=bool)
    known = (exact | (errors > 0.0)) & np.isfinite(remainder)
    values = np.array([row.value for row in rows], dtype=float)
    return rounding_bound(values, errors, np.where(known, remainder, 0.0))
