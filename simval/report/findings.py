"""The sentence above a figure, made from all rows that it is about, drawn or not.

A `Claim` holds which rows these are and what they say as numbers; its words are made
from them. The bands of a figure hold together with 95 %, so in one figure of twenty a
value is outside its band by chance; the sentence says how often chance does it. A value
is off theory where chance does it to fewer than one figure in ten thousand. What a
prediction itself states that it leaves out is not held against it, as in the gate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from simval.arrays import Array
from simval.change import EFFORT
from simval.report.curves import (
    SEEN,
    Z95,
    Curve,
    Slope,
    ratio,
    read,
    simultaneous,
    varying,
)
from simval.report.panels import Drawing
from simval.report.words import setting_words, spelled
from simval.results import Row
from simval.shapes import Bool, Float
from simval.statistics import Family, Statistic
from simval.sweep.run import CellResult

SURE = 0.9999
"""Confidence with which a point outside its band is off theory."""
EXACTLY = 1e-12
"""Relative distance that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How far measured values are from what was predicted of them."""

    points: int  # measured
    compared: int  # that have a prediction
    unseen: int  # of these, so noisy that a ratio of 0 and one of 2 agree as well
    allowed: int  # outside their bands, but not of what the prediction leaves out
    outside: int  # outside bands that hold together with 95 %
    off: int  # outside bands that hold together with 99.99 %
    within: float  # greatest relative distance of the others that are seen
    most: float  # and of those that are allowed
    farthest: float  # in standard errors; 0 where nothing is sampled
    # names of the values with these three distances, where there are several
    names: tuple[str, str, str] = ("", "", "")


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def agreement(curves: Sequence[Curve]) -> Agreement:
    """Compare the points of some curves with their predictions, all together."""
    ratios = [ratio(c) for c in curves]
    value, error = (_joined(ratios, name) for name in ("value", "error"))
    rest = np.concatenate([_remainder(c) for c in ratios] or [np.empty(0)])
    names = [name for c in ratios for name in c.names or [""] * len(c.x)]
    distance = np.abs(value - 1.0)
    sampled = error > 0.0
    size = np.where(sampled, error, 1.0)
    sigmas = np.where(sampled, np.maximum(distance - rest, 0.0) / size, 0.0)
    band, sure = simultaneous(len(value)), simultaneous(len(value), SURE)
    seen = band * error <= SEEN
    allowed = seen & sampled & (sigmas <= band) & (distance > band * error)
    parts = [(distance, seen & ~allowed), (distance, allowed), (sigmas, sigmas > 0.0)]
    ends = [_greatest(size, which, names) for size, which in parts]
    return Agreement(
        points=sum(len(c.x) for c in curves),
        compared=len(value),
        unseen=int(np.sum(~seen)),
        allowed=int(np.sum(allowed)),
        outside=int(np.sum(sigmas > band)),
        off=int(np.sum(sigmas > sure)),
        within=ends[0][0],
        most=ends[1][0],
        farthest=ends[2][0],
        names=(ends[0][1], ends[1][1], ends[2][1]),
    )


def _greatest(
    size: Float[Array, " n"], which: Bool[Array, " n"], names: Sequence[str]
) -> tuple[float, str]:
    """The greatest of some sizes, and its name if it is one of several."""
    if not which.any():
        return 0.0, ""
    place = int(np.argmax(np.where(which, size, -1.0)))
    return float(size[place]), names[place] if which.sum() > 1 else ""


def _joined(curves: Sequence[Curve], name: str) -> Float[Array, " n"]:
    return np.concatenate([getattr(c, name) for c in curves] or [np.empty(0)])


def _remainder(c: Curve) -> Float[Array, " n"]:
    return np.zeros(len(c.x)) if c.remainder is None else c.remainder


@dataclass(frozen=True, kw_only=True, eq=False)
class Claim:
    """That all rows of some cells, statistics and one predictor are at theory."""

    subject: str  # of the sentence
    cells: Sequence[CellResult]
    what: Sequence[Family | Statistic]  # without control variates
    by: str | None = None  # the predictor; None is each
    theory: str = "theory"  # in words

    @cached_property
    def rows(self) -> list[tuple[CellResult, Row]]:
        """Rows that it is about."""
        return [
            (cell, row)
            for cell in self.cells
            for row in cell.rows
            if not row.statistic.controlled
            and (row.statistic in self.what or row.statistic.family in self.what)
            and self.by in (None, row.predictor)
        ]

    @cached_property
    def curve(self) -> Curve:
        """Those rows, each named, one after the other."""
        found, places = self.rows, _places(self.cells)
        numbers = [read(row)[:4] for _, row in found]
        value, error, prediction, rest = np.array(numbers).reshape(-1, 4).T
        return Curve(
            label="",
            x=np.arange(float(len(found))),
            value=value,
            error=error,
            prediction=prediction,
            remainder=rest,
            names=[
                " at ".join(filter(None, (self._called(row), places[cell.name])))
                for cell, row in found
            ],
        )

    def _called(self, row: Row) -> str:
        """What a row is of, beyond what all of them are."""
        one = len({row.statistic.family for _, row in self.rows}) == 1
        words = "" if one else row.statistic.family.words
        return " ".join(filter(None, (words, ", ".join(row.statistic.entries))))

    @cached_property
    def found(self) -> Agreement:
        """What they say."""
        return agreement([self.curve])

    @property
    def said(self) -> str:
        """What they say in words."""
        return agrees(self.subject, [self.curve], theory=self.theory)


def _places(cells: Sequence[CellResult]) -> dict[str, str]:
    """What sets each cell apart from the others, in words."""
    studies: dict[str, list[CellResult]] = {}
    for cell in cells:
        studies.setdefault(cell.study, []).append(cell)
    return {
        cell.name: ", ".join(
            [spelled(study)] * (len(studies) > 1)
            + [setting_words(study, key, cell.parameters.get(key)) for key in keys]
        )
        for study, own in studies.items()
        for keys in [[key for key in varying(own) if key not in EFFORT]]
        for cell in own
    }


def agrees(subject: str, curves: Sequence[Curve], *, theory: str = "theory") -> str:
    """Say whether values are at what was predicted of them."""
    found = agreement(curves)
    if not found.compared:
        count = _count(found.points, "value")
        return f"{subject}: {count}, and no prediction to compare with."
    if found.off:
        return _off(subject, found, theory)
    if found.unseen == found.compared and not found.outside:
        return (
            f"{subject} cannot be told from zero, nor from {theory}, in these trials."
        )
    if found.compared == 1 and not found.allowed:
        sigmas = f", {found.farthest:.1f} standard errors" if found.farthest else ""
        off = percent(found.within)
        return f"{subject} agrees with {theory}: one value, {off} off{sigmas}."
    return f"{_where(subject, found, theory)}{_chance(found)}."


def claiming(drawing: Drawing, *claims: Claim, before: str = "") -> Drawing:
    """A figure with what it claims as its finding."""
    said = " ".join(claim.said for claim in claims)
    return replace(drawing, finding=f"{before}{said}", claims=claims)


def behind(
    drawing: Drawing, *claims: Claim, asked: str = "", before: str = ""
) -> Drawing:
    """Fold a figure behind what it claims, but for one with values off theory."""
    told = claiming(drawing, *claims, before=before)
    if any(claim.found.off for claim in claims):
        return replace(told, asked=asked, fold="")
    return replace(told, asked="", finding="", fold=told.finding)


def _off(subject: str, found: Agreement, theory: str) -> str:
    verb = "is" if found.off == 1 else "are"
    place = f" ({found.names[2]})" if found.names[2] else ""
    return (
        f"{subject}: {found.off} of {_count(found.compared, 'value')} {verb} off "
        f"{theory}, the farthest{place} by {found.farthest:.1f} standard errors."
    )


def _where(subject: str, found: Agreement, theory: str) -> str:
    """How near how many values are, and what is to be said of the others."""
    plain = found.compared - found.unseen - found.allowed
    words = []
    if plain:
        words.append(
            f"{subject} agrees with {theory} within {percent(found.within)} in "
            f"{_share(plain, found.compared)}{_named(found.names[0])}"
        )
    remainder = f"within its stated remainder, {percent(found.most)}"
    if found.allowed and plain:
        verb = "agree" if found.allowed > 1 else "agrees"
        words.append(
            f"{found.allowed} {verb} with {theory} {remainder}{_named(found.names[1])}"
        )
    elif found.allowed:
        words.append(
            f"{subject} agrees with {theory} {remainder}, in "
            f"{_share(found.allowed, found.compared)}{_named(found.names[1])}"
        )
    if found.unseen:
        who = "" if words else f"{subject}: "
        words.append(f"{who}{found.unseen} cannot be told from zero")
    return "; ".join(words)


def _share(count: int, whole: int) -> str:
    return f"{f'all {whole}' if count == whole else f'{count} of {whole}'} values"


def _named(name: str) -> str:
    return f" (most: {name})" if name else ""


def _chance(found: Agreement) -> str:
    """How often chance puts a value so far out, where one is outside its band."""
    if not found.outside:
        return ""
    alone = 2.0 * float(scipy.special.ndtr(-found.farthest))
    rate = -np.expm1(found.compared * np.log1p(-alone))
    verb, most = ("lies", "") if found.outside == 1 else ("lie", "up to ")
    place = f" ({found.names[2]})" if found.names[2] else ""
    return (
        f"; {found.outside} of {_count(found.compared, 'value')} {verb} {most}"
        f"{found.farthest:.1f} standard errors off{place}, outside the band; chance "
        f"does so in one figure of {1.0 / rate:,.0f}"
    )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def limited(subject: str, bias: Claim, scale: Claim, whole: str) -> str:
    """Say how great a bias may be that cannot be seen, as a share of something.

    `scale` has what it is a share of, such as the scatter, entry by entry.
    """
    sizes = {(cell.name, row.statistic.entries): row for cell, row in scale.rows}
    pairs = [(r, sizes.get((cell.name, r.statistic.entries))) for cell, r in bias.rows]
    known = [(b, s.prediction) for b, s in pairs if s is not None and s.prediction]
    if not known:
        return f"{subject} was not measured."
    z = simultaneous(len(known))
    most = max((abs(b.value) + z * b.standard_error) / by for b, by in known)
    told = max(abs(b.prediction or 0.0) / by for b, by in known)
    n = sorted({b.n for b, _ in known})
    trials = " to ".join(f"{count:,}" for count in dict.fromkeys((n[0], n[-1])))
    return (
        f"{subject} is below what {trials} trials can see: less than {percent(most)} "
        f"of {whole} in all {len(known)} values; theory puts it at {percent(told)} at "
        "most."
    )


def slopes_said(pairs: Sequence[tuple[Slope | None, Slope | None]]) -> tuple[str, bool]:
    """Say whether fitted slopes are those of theory's own lines, and if all are."""
    told = [(f, own) for f, own in pairs if f is not None and own is not None]
    rest = len(pairs) - len(told)
    missing = f"; {rest} cannot be told from zero" if rest else ""
    if not told:
        return (
            f"{_count(len(pairs), 'slope')}, none told from zero in these trials",
            True,
        )
    apart = [abs(fitted.value - own.value) for fitted, own in told]
    bands = [fitted.half_width / Z95 for fitted, _ in told]
    z = simultaneous(len(told))
    off = [d / b for d, b in zip(apart, bands, strict=True) if d > z * b]
    if off:
        return (
            f"{len(off)} of {_count(len(told), 'slope')} off theory's own, by up to "
            f"{max(off):.1f} standard errors{missing}"
        ), False
    count = _count(len(told), "slope")
    return f"{count}, theory's own within {max(apart):.3f}{missing}", True


def percent(share: float) -> str:
    """Spell a share in percent, two digits."""
    if share <= EXACTLY:
        return "rounding"
    if share < 1e-5:
        return "0.001 %"
    return f"{float(f'{100.0 * share:.2g}'):g} %"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
