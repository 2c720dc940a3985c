"""The sentence above a figure, made of all its rows, drawn or not.

A `Claim` holds which rows these are and what they say as numbers; its words are made
from them. The bands of a figure hold together with 95 %, so in one figure of twenty a
value is outside its band by chance; the sentence says how often that is expected. A
value differs from theory where chance does that to fewer than one figure in ten
thousand. A prediction's stated remainder is allowed it, as in the gate.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.judge.settings import place_words, settings_of
from simval.report.curves import SEEN, Z95, Curve, Slope, ratio, read, simultaneous
from simval.report.formatting import spelled
from simval.report.panels import Drawing
from simval.results import Row
from simval.shapes import Float
from simval.statistics import Family, Statistic
from simval.sweep.run import CellResult
from simval.text import ROUNDING

SURE = 0.9999
"""Confidence with which a point outside its band differs from theory."""


class Farthest(NamedTuple):
    """The largest of some deviations, with its name."""

    size: float
    name: str  # whose it is, where there are several

    def named(self, which: str = "") -> str:
        """The name in brackets."""
        return f" ({which}{self.name})" if self.name else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How far measured values are from their predictions."""

    points: int  # measured
    compared: int  # that have a prediction
    unseen: int  # of these, so noisy that a ratio of 0 and one of 2 agree as well
    allowed: int  # outside their bands, but not of what the prediction leaves out
    outside: int  # outside bands that hold together with 95 %
    apart: int  # of these, so noisy that their ratio says nothing
    off: int  # outside bands that hold together with 99.99 %
    within: Farthest  # greatest relative distance of the others that are seen
    most: Farthest  # and of those that are allowed
    farthest: Farthest  # in standard errors; 0 where nothing is sampled

    def said(self, subject: str, theory: str = "theory") -> str:
        """Say whether the values agree with their predictions."""
        count = f"{_count(self.compared, 'value')}"
        if not self.compared:
            count = _count(self.points, "value")
            return f"{subject}: {count}, and no prediction to compare with."
        if self.off:
            return (
                f"{subject}: {self.off} of {count} "
                f"{'differs' if self.off == 1 else 'differ'} from {theory}, the "
                f"farthest{self.farthest.named()} by {self.farthest.size:.1f} standard "
                "errors."
            )
        if self.unseen == self.compared and not self.outside:
            return (
                f"{subject} cannot be distinguished from zero, nor from {theory}, in "
                "these trials."
            )
        if self.compared == 1 and not self.allowed + self.apart:
            sigmas = self.farthest.size
            more = f" ({sigmas:.1f} standard errors)" if sigmas else ""
            off = percent(self.within.size)
            return f"{subject} agrees with {theory} within {off}{more}: one value."
        return f"{'; '.join(self._parts(subject, theory))}."

    def _parts(self, subject: str, theory: str) -> Iterator[str]:
        """Parts of that sentence: how near, how many, and what of the others."""

        def share(part: int) -> str:
            whole = part == self.compared
            return f"{f'all {part}' if whole else f'{part} of {self.compared}'} values"

        plain = self.compared - self.unseen - self.allowed - self.apart
        within = percent(self.within.size)
        remainder = f"within its stated remainder of {percent(self.most.size)}"
        if plain:
            where = f"{share(plain)}{self.within.named('most: ')}"
            yield f"{subject} agrees with {theory} within {within} in {where}"
        if self.allowed:
            named = self.most.named("most: ")
            verb = "agree" if self.allowed > 1 else "agrees"
            yield (
                f"{self.allowed} {verb} with {theory} {remainder}{named}"
                if plain
                else f"{subject} agrees with {theory} {remainder}, in "
                f"{share(self.allowed)}{named}"
            )
        if self.unseen:
            who = "" if plain or self.allowed else f"{subject}: "
            yield f"{who}{self.unseen} cannot be distinguished from zero"
        if self.outside:  # how often chance puts a value so far out
            far = self.farthest
            alone = 2.0 * float(scipy.special.ndtr(-far.size))
            rate = -np.expm1(self.compared * np.log1p(-alone))
            lie = "lies" if self.outside == 1 else "lie up to"
            who = "" if self.apart < self.compared else f"{subject}: "
            yield (
                f"{who}{self.outside} of {_count(self.compared, 'value')} {lie} "
                f"{far.size:.1f} standard errors from {theory}{far.named()}, outside "
                f"the band; expected by chance in one figure of {1.0 / rate:,.0f}"
            )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def agreement(c: Curve) -> Agreement:
    """Compare all points of a curve with their predictions."""
    known = ratio(c)
    distance, error = np.abs(known.value - 1.0), known.error
    rest = 0.0 if known.remainder is None else known.remainder
    sampled = error > 0.0
    size = np.where(sampled, error, 1.0)
    sigmas = np.where(sampled, np.maximum(distance - rest, 0.0) / size, 0.0)
    count = len(distance)
    band, sure = simultaneous(count), simultaneous(count, SURE)
    noisy = band * error > SEEN
    apart = noisy & (sigmas > band)
    seen = ~noisy | apart
    allowed = seen & sampled & (sigmas <= band) & (distance > band * error)

    def greatest(size: Float[Array, " n"], which: Any) -> Farthest:
        if not which.any():
            return Farthest(0.0, "")
        place = int(np.argmax(np.where(which, size, -1.0)))
        alone = which.sum() == 1 or not known.names
        return Farthest(float(size[place]), "" if alone else known.names[place])

    return Agreement(
        points=len(c.x),
        compared=count,
        unseen=int(np.sum(~seen)),
        allowed=int(np.sum(allowed)),
        outside=int(np.sum(sigmas > band)),
        apart=int(np.sum(apart)),
        off=int(np.sum(sigmas > sure)),
        within=greatest(distance, seen & ~allowed & ~apart),
        most=greatest(distance, allowed),
        farthest=greatest(sigmas, sigmas > 0.0),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Claim:
    """The claim that some rows agree with theory."""

    subject: str  # of the sentence
    cells: Sequence[CellResult]
    what: Sequence[Family | Statistic]  # without control variates
    by: str | None = None  # the predictor; None is each
    theory: str = "theory"  # in words

    @cached_property
    def rows(self) -> list[tuple[CellResult, Row]]:
        """Rows that the claim is about."""
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
        """These rows as a curve, each with its name."""
        found, where = self.rows, places(self.cells)
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
                " at ".join(filter(None, (self._called(row), where[cell.name])))
                for cell, row in found
            ],
        )

    def _called(self, row: Row) -> str:
        """Name of a row, without what all rows have in common."""
        one = len({row.statistic.family for _, row in self.rows}) == 1
        words = "" if one else row.statistic.family.words
        return " ".join(filter(None, (words, ", ".join(row.statistic.printed))))

    @cached_property
    def found(self) -> Agreement:
        """The comparison that tests the claim."""
        return agreement(self.curve)

    @property
    def said(self) -> str:
        """The result as a sentence."""
        return self.found.said(self.subject, self.theory)


def places(cells: Sequence[CellResult]) -> dict[str, str]:
    """Say which parameters distinguish each cell from the others."""
    studies: dict[str, list[CellResult]] = {}
    for cell in cells:
        studies.setdefault(cell.study, []).append(cell)
    return {
        cell.name: ", ".join(
            [spelled(study)] * (len(studies) > 1)
            + [place_words(cell, keys)] * bool(keys)
        )
        for study, own in studies.items()
        for keys in [settings_of(own)]
        for cell in own
    }


def claiming(drawing: Drawing, *claims: Claim, before: str = "") -> Drawing:
    """A figure with its claims as the sentence above it."""
    said = " ".join(claim.said for claim in claims)
    return replace(drawing, finding=f"{before}{said}", claims=claims)


def behind(
    drawing: Drawing, *claims: Claim, asked: str = "", before: str = ""
) -> Drawing:
    """Fold a figure behind its claims, unless one of them fails."""
    told = claiming(drawing, *claims, before=before)
    if any(claim.found.off for claim in claims):
        return replace(told, asked=asked, fold="")
    return replace(told, asked="", finding="", fold=told.finding)


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def limited(subject: str, bias: Claim, scale: Claim, whole: str) -> str:
    """Say how large an unseen bias may be, as a share of something.

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
        f"{subject} is too small for {trials} trials to show: less than "
        f"{percent(most)} of {whole} in all {len(known)} values; theory predicts "
        f"{percent(told)} at most."
    )


def slopes_said(pairs: Sequence[tuple[Slope | None, Slope | None]]) -> tuple[str, bool]:
    """Say whether fitted slopes agree with those of theory, and if all do."""
    told = [(f, own) for f, own in pairs if f is not None and own is not None]
    rest = len(pairs) - len(told)
    missing = f"; {rest} cannot be distinguished from zero" if rest else ""
    if not told:
        count = _count(len(pairs), "slope")
        return f"{count}, none distinguishable from zero in these trials", True
    apart = [abs(fitted.value - own.value) for fitted, own in told]
    bands = [fitted.half_width / Z95 for fitted, _ in told]
    z = simultaneous(len(told))
    off = [d / b for d, b in zip(apart, bands, strict=True) if d > z * b]
    if off:
        return (
            f"{len(off)} of {_count(len(told), 'slope')} "
            f"{'differs' if len(off) == 1 else 'differ'} from theory's, by up to "
            f"{max(off):.1f} standard errors{missing}"
        ), False
    count = _count(len(told), "slope")
    agree = "agrees" if len(told) == 1 else "agree"
    return f"{count} {agree} with theory's within {max(apart):.3f}{missing}", True


def percent(share: float) -> str:
    """Spell a share in percent with two digits."""
    if share <= ROUNDING:
        return "rounding"
    if share < 1e-5:
        return "0.001 %"
    return f"{float(f'{100.0 * share:.2g}'):g} %"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
