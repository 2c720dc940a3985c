r"""Readings of a sensor that is slower than its log, each of which stands in some rows.

Noise that makes its own rounding white repeats a reading with a chance of at most one
half, and two axes do not repeat together, however coarse (V7). Axes that do, or a lone
one that repeats more often, or rows that change too seldom after one that did, are not
the sensor's own readings. Where every reading stands in the same number of rows, to
one, the sensor's own readings and its own rate are known; else they are not.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import RefusedError
from simval.noise.model import AxisNoise
from simval.shapes import Float

_CHANCE: Final = 0.5
"""Greatest share of rows in which an axis repeats by chance: 0.49 of a noise of half a
step (`simval.noise.rounding`), less of any other that is white."""
_OFTEN: Final = 0.4  # share of rows in which a lone axis changes; it is less if coarse
_ALONE: Final = 0.8  # share of rows that change, over that of axes that do so alone
_SD: Final = 5.0  # standard deviations of a correlation of changes: 3e-7 by chance
_SHARE: Final = 0.99  # of readings that stand as long as the others
_LEAST: Final = 3  # readings; fewer tell no step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnReadings:
    """Readings as the sensor made them, and the rows of the log to each."""

    rows: Float[Array, "k axes"]
    each: float  # 1 where every row is a reading


def own_readings(rows: Float[Array, "n axes"]) -> OwnReadings:
    """Take each reading once, where each stands in as many rows as the others.

    Raises
    ------
    RefusedError
        If rows are repeated, and not as often as each other.
    """
    changed = np.diff(rows, axis=0) != 0.0
    if not _held(changed):
        return OwnReadings(rows=rows, each=1.0)
    places = np.flatnonzero(changed.any(axis=1)) + 1
    if len(places) < _LEAST:
        return OwnReadings(rows=rows[places], each=len(rows) / max(len(places), 1))
    steps = np.diff(places)
    usual = float(steps[steps <= 1.5 * np.median(steps) + 0.5].mean())
    count = np.maximum(np.rint(steps / usual), 1.0).astype(np.intp)
    each = float(steps.sum() / count.sum())
    regular = np.abs(steps - count * each) <= max(1.0, each / 4.0)
    # readings that equal the one before; of less than two rows to each, k are no
    # different from k + 1, as their steps are off by up to one row
    again = 1.0 - len(count) / count.sum()
    most = _CHANCE ** changed.any(axis=0).sum() if each >= 2.0 else 0.0
    if not (regular.mean() >= _SHARE and again <= most):
        share = 100.0 * (1.0 - changed.any(axis=1).mean())
        msg = (
            f"{share:.2g} % of its rows repeat the one before, at no regular step: it "
            "is slower than the log, or interpolated, or stands still at times, or its "
            "steps are far above its noise, which cannot be told then; log it at its "
            "own rate, and with a finer resolution"
        )
        raise RefusedError(msg)
    own = np.append(np.repeat(places[:-1], count), places[-1])
    return OwnReadings(rows=rows[own], each=each)


def noise_of_readings(
    rows: Float[Array, "n axes"], rate_hz: float
) -> tuple[AxisNoise, ...]:
    """Measure the noise of a sensor's own readings at rest, at their own rate.

    Raises
    ------
    RefusedError
        If there are too few readings, or rows repeat them irregularly.
    """
    from simval.noise.measure import noise_of

    own = own_readings(rows)
    try:
        axes = noise_of(own.rows, rate_hz / own.each)
    except RefusedError as error:
        if own.each == 1.0:
            raise
        msg = f"each of its readings stands in {own.each:.3g} rows, and {error}"
        raise RefusedError(msg) from None
    if own.each == 1.0:
        return axes
    said = (
        f"each reading stands in {own.each:.3g} rows: what is measured are the "
        f"sensor's own readings, {rate_hz / own.each:.4g} Hz"
    )
    return tuple(replace(a, statements=(said, *a.statements)) for a in axes)


def rows_to_a_reading(rows: Float[Array, "n axes"]) -> float:
    """Mean number of rows that a reading stands in, 1 where each row is a reading."""
    changed = np.diff(rows, axis=0) != 0.0
    return 1.0 / float(changed.any(axis=1).mean()) if _held(changed) else 1.0


def _held(changed: NDArray[np.bool_]) -> bool:
    # whether readings stand longer than a row, from where each axis changes
    some = np.any(changed, axis=1, keepdims=True)[:, 0]
    seen = float(some.mean()) if len(some) else 1.0
    if seen in (0.0, 1.0):
        return False
    alone = 1.0 - float(np.prod(1.0 - changed.mean(axis=0)))
    both = float((some[1:] & some[:-1]).mean()) - seen**2
    # independent readings change in neighbouring rows at least as often as that
    seldom = both / (seen * (1.0 - seen)) < -_SD / np.sqrt(len(some))
    lone = np.count_nonzero(changed.any(axis=0)) == 1
    return bool((lone and seen < _OFTEN) or seen < _ALONE * alone or seldom)
