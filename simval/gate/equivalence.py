"""A cell with other noise than in the baseline: its statistics should be equivalent.

Equivalence is eq. (B1) of `simval.change`. Other noise cannot give the same numbers: if
all sampled statistics of a cell, at least three, are equal to the bit, no new noise was
drawn.

The margin of a statistic is its family's (`simval.statistics`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import hypot, sqrt

from simval.change import on_other_noise, rounding_bound
from simval.gate.baseline import Entry
from simval.gate.comparison import Comparison
from simval.gate.paired import known, paired, predictions
from simval.results import CellName
from simval.statistics import COVARIANCE, SD, Statistic

MIN_COPIED = 3
"""Sampled statistics that must be equal to the bit before a cell counts as copied: a
single one, a fraction of some hundred trials, can be equal by chance."""


def unpaired(
    cell: CellName, old: Mapping[str, Entry], new: Mapping[str, Entry], quantile: float
) -> Iterator[Comparison]:
    """Compare a cell with other noise."""
    copied = _copied(old, new)
    for statistic in sorted({*old, *new}):
        entry, now = old.get(statistic), new.get(statistic)
        if (
            entry is None
            or now is None
            or entry.value is None
            or known(entry, now) is not None
        ):
            yield from paired(
                cell,
                {} if entry is None else {statistic: entry},
                {} if now is None else {statistic: now},
            )
            continue
        assert now.value is not None  # else it would be unjudged
        both = hypot(entry.error, now.error)
        margin = rounding_bound(entry.value, 0.0, 0.0)
        if both > 0:
            margin = _margin(now.statistic, entry, old)
        yield Comparison(
            cell=cell,
            statistic=statistic,
            change="copied"
            if copied and both > 0
            else on_other_noise(abs(now.value - entry.value), both, margin, quantile),
            stored=entry.value,
            value=now.value,
            standard_error=both,
            margin=margin,
            n=min(entry.n, now.n),
            measured=now.statistic,
            predictions=predictions(entry, now),
        )


def _copied(old: Mapping[str, Entry], new: Mapping[str, Entry]) -> bool:
    sampled = {name: entry for name, entry in old.items() if entry.error > 0.0}
    return len(sampled) >= MIN_COPIED and all(
        name in new and new[name].value == entry.value
        for name, entry in sampled.items()
    )


def _margin(
    statistic: Statistic | None, entry: Entry, old: Mapping[str, Entry]
) -> float:
    assert statistic is not None  # it is the run's own
    family, size = statistic.family, abs(entry.value or 0.0)
    if family.scale == "variances":
        own = [replace(statistic, entries=(k, k)) for k in statistic.entries]
        variances = [v for s in own if (v := _value(s, old)) is not None]
        if len(variances) == 2:
            size = sqrt(abs(variances[0] * variances[1]))
    if family.scale == "sample":
        size = _spread(statistic, entry, old)
    return family.margin * size


def _spread(statistic: Statistic, entry: Entry, old: Mapping[str, Entry]) -> float:
    """Standard deviation of one sample: the cell's own, else from the error."""
    sd = _value(SD(*statistic.entries), old)
    if sd is not None:
        return abs(sd)
    variance = _value(COVARIANCE(*statistic.entries, *statistic.entries), old)
    if variance is not None:
        return sqrt(abs(variance))
    return entry.error * sqrt(entry.n)


def _value(statistic: Statistic, old: Mapping[str, Entry]) -> float | None:
    entry = old.get(str(statistic))
    return None if entry is None else entry.value or 0.0
