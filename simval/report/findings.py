"""The sentence above a figure, made from its numbers.

The bands of a figure hold together with 95 %, so in one figure of twenty a point is
outside its band by chance; the sentence says how often chance does it. A point is off
theory where chance does it to fewer than one figure in ten thousand. What a prediction
itself states that it leaves out is not held against it, as in the gate.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from simval.arrays import Array
from simval.report.curves import Curve
from simval.report.panels import Drawing
from simval.report.ratio import SEEN, ratio
from simval.report.slope import Z95, Slope, simultaneous
from simval.shapes import Float
from simval.sweep.run import CellResult

SURE = 0.9999
"""Confidence with which a point outside its band is off theory."""
EXACTLY = 1e-12
"""Relative distance that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How far measured points are from what was predicted of them."""

    points: int  # measured
    compared: int  # that have a prediction
    unseen: int  # of these, so noisy that a ratio of 0 and one of 2 agree as well
    allowed: int  # outside their bands, but not of what the prediction leaves out
    outside: int  # outside bands that hold together with 95 %
    off: int  # outside bands that hold together with 99.99 %
    within: float  # greatest relative distance of the others that are seen
    most: float  # and of those that are allowed
    farthest: float  # in standard errors; 0 where nothing is sampled
    where: float  # place of the farthest along the axis


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def agreement(curves: Sequence[Curve]) -> Agreement:
    """Compare the points of some curves with their predictions, all together."""
    ratios = [ratio(c) for c in curves]
    x, value, error = (_joined(ratios, name) for name in ("x", "value", "error"))
    rest = np.concatenate([_remainder(c) for c in ratios] or [np.empty(0)])
    distance = np.abs(value - 1.0)
    sampled = error > 0.0
    size = np.where(sampled, error, 1.0)
    sigmas = np.where(sampled, np.maximum(distance - rest, 0.0) / size, 0.0)
    band, sure = simultaneous(len(x)), simultaneous(len(x), SURE)
    seen = band * error <= SEEN
    allowed = seen & sampled & (sigmas <= band) & (distance > band * error)
    last = int(np.argmax(sigmas)) if len(x) else 0
    return Agreement(
        points=sum(len(c.x) for c in curves),
        compared=len(x),
        unseen=int(np.sum(~seen)),
        allowed=int(np.sum(allowed)),
        outside=int(np.sum(sigmas > band)),
        off=int(np.sum(sigmas > sure)),
        within=float(np.max(distance[seen & ~allowed], initial=0.0)),
        most=float(np.max(distance[allowed], initial=0.0)),
        farthest=float(sigmas[last]) if len(x) else 0.0,
        where=float(x[last]) if len(x) else 0.0,
    )


def _joined(curves: Sequence[Curve], name: str) -> Float[Array, " n"]:
    return np.concatenate([getattr(c, name) for c in curves] or [np.empty(0)])


def _remainder(c: Curve) -> Float[Array, " n"]:
    return np.zeros(len(c.x)) if c.remainder is None else c.remainder


def agrees(
    subject: str, curves: Sequence[Curve], *, at: str = "", theory: str = "theory"
) -> str:
    """Say whether points are at what was predicted of them; `at` spells the axis."""
    found = agreement(curves)
    if not found.compared:
        count = _count(found.points, "point")
        return f"{subject}: {count}, and no prediction to compare with."
    if found.off:
        return _off(subject, found, at, theory)
    if found.unseen == found.compared:
        return (
            f"{subject} cannot be told from zero, nor from {theory}, in these trials."
        )
    if found.compared == 1 and not found.allowed:
        sigmas = f", {found.farthest:.1f} standard errors" if found.farthest else ""
        off = percent(found.within)
        return f"{subject} is at {theory}: one point, {off} off{sigmas}."
    return f"{subject} is at {theory}{_where(found)}{_chance(found)}."


def behind(
    drawing: Drawing, said: str, curves: Sequence[Curve], asked: str = ""
) -> Drawing:
    """Fold a figure behind its own answer, but for one with points off theory."""
    if agreement(curves).off:
        return replace(drawing, asked=asked, finding=said, fold="")
    return replace(drawing, asked="", finding="", fold=said)


def _off(subject: str, found: Agreement, at: str, theory: str) -> str:
    place = f" at {at} {found.where:g}" if at and np.isfinite(found.where) else ""
    verb = "is" if found.off == 1 else "are"
    return (
        f"{subject}: {found.off} of {_count(found.compared, 'point')} {verb} off "
        f"{theory}, the farthest{place} by {found.farthest:.1f} standard errors."
    )


def _where(found: Agreement) -> str:
    """How near how many points are, and what is to be said of the others."""
    plain = found.compared - found.unseen - found.allowed
    every = plain == found.compared
    words = [] if not plain else [
        f" within {percent(found.within)} in "
        f"{f'all {plain}' if every else f'{plain} of {found.compared}'} points"
    ]  # fmt: skip
    if found.allowed:
        words.append(
            f"{', ' if plain else ' in '}{found.allowed} as far off as theory's own "
            f"remainder allows, up to {percent(found.most)}"
        )
    if found.unseen:
        words.append(f", {found.unseen} cannot be told from zero")
    return "".join(words)


def _chance(found: Agreement) -> str:
    """How often chance puts a point so far out, where one is outside its band."""
    if not found.outside:
        return ""
    alone = 2.0 * float(scipy.special.ndtr(-found.farthest))
    rate = -np.expm1(found.compared * np.log1p(-alone))
    return (
        f"; {_count(found.outside, 'point')} outside the band, by up to "
        f"{found.farthest:.1f} standard errors, which chance does to one figure in "
        f"{1.0 / rate:,.0f}"
    )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not compared
def limited(
    subject: str, curves: Sequence[Curve], scales: Sequence[Curve], whole: str, n: int
) -> str:
    """Say how great a bias may be that cannot be seen, as a share of something.

    `scales` are the curves of which it is a share, such as the scatter, place by place.
    """
    z = simultaneous(sum(len(c.x) for c in curves))
    limits, predicted = [], []
    for c, scale in zip(curves, scales, strict=True):
        size = np.interp(c.x, scale.x, scale.prediction)
        limits += list((np.abs(c.value) + z * c.error) / size)
        predicted += list(np.abs(c.prediction) / size)
    if not limits:
        return f"{subject} was not measured."
    most = percent(float(np.nanmax(limits)))
    trials = f"what {n:,} trials can see" if n else "what these trials can see"
    told = [p for p in predicted if np.isfinite(p)]
    theory = f"; theory puts it at {percent(max(told))} at most" if told else ""
    return f"{subject} is below {trials}: less than {most} of {whole}{theory}."


def unseen(curves: Sequence[Curve]) -> bool:
    """Whether no point of some curves can be told from its prediction's double."""
    found = agreement(curves)
    return found.compared > 0 and found.unseen == found.compared


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


def order_words(found: Iterable[tuple[str, float | None, float]]) -> str:
    """Slopes of what each formula leaves out beside its stated order, in words."""
    slopes: dict[tuple[str, float], list[float]] = {}
    for formula, slope, stated in found:
        if slope is not None:
            slopes.setdefault((formula, stated), []).append(slope)
    told = []
    for (formula, stated), values in slopes.items():
        ends = dict.fromkeys(f"{value:.2f}" for value in (min(values), max(values)))
        told.append(f"{' to '.join(ends)} for {formula} (stated {stated:g})")
    return f"What is left out has the slope {'; '.join(told)}" if told else ""


def percent(share: float) -> str:
    """Spell a share in percent, two digits."""
    if share <= EXACTLY:
        return "rounding"
    if share < 1e-5:
        return "0.001 %"
    return f"{float(f'{100.0 * share:.2g}'):g} %"


def trials(cells: Sequence[CellResult]) -> int:
    """The most samples that a row of some cells rests on."""
    return max((row.n for cell in cells for row in cell.rows), default=0)


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
