r"""A cell with other noise than in the baseline: its statistics should be equivalent.

The question is not whether the values differ, for they do. With :math:`d` the
difference, :math:`s` its standard error and :math:`m` the margin of the statistic,

.. math:: |d| + z_{0.95}\, s \le m  \tag{B1}

shows equivalence by two one-sided tests of size 0.05; :math:`|d| - z\, s > m`, with z
from the comparisons' share of the false-alarm rate by Bonferroni's rule, shows a
change; and anything between is not resolved by so many samples. Other noise cannot give
the same numbers: where every sampled statistic of a cell, three at least, is equal to
the bit, the noise was not drawn anew.

The margins are 2 % of a covariance (off the diagonal, of the root of the product of the
two variances) or of a normalised square, 1 % of an RMS, a standard deviation or any
other size, and for a bias 2 % of the standard deviation of one sample.
"""

import re
from collections.abc import Iterator, Mapping
from math import hypot, sqrt

from simval.gate.baseline import Entry
from simval.gate.comparison import TOST_QUANTILE, Change, Comparison
from simval.gate.paired import EXACT_BOUND, ROUNDING, known, paired

COVARIANCE_MARGIN = 0.02
RMSE_MARGIN = 0.01
BIAS_MARGIN = 0.02

MIN_COPIED = 3
"""Sampled statistics that must be equal to the bit before a cell counts as copied: a
single one, a fraction of some hundred trials, can be equal by chance."""

_NAME = re.compile(r"(control |)(\w*)\[?([^\]]*)", re.DOTALL)


def unpaired(
    cell: str, old: Mapping[str, Entry], new: Mapping[str, Entry], quantile: float
) -> Iterator[Comparison]:
    """Compare a cell with other noise.

    Parameters
    ----------
    cell : str
        Its name in the run.
    old, new : mapping
        Its statistics in the baseline and in the run.
    quantile : float
        Standard errors beyond the margin that show a change.

    Yields
    ------
    Comparison
        One for each statistic.
    """
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
        margin = max(EXACT_BOUND * abs(entry.value), ROUNDING)
        if both > 0:
            margin = _margin(statistic, entry.value, old)
        yield Comparison(
            cell=cell,
            statistic=statistic,
            change="copied"
            if copied and both > 0
            else _unpaired_change(abs(now.value - entry.value), both, margin, quantile),
            stored=entry.value,
            value=now.value,
            standard_error=both,
            margin=margin,
            n=min(entry.n, now.n),
        )


def _copied(old: Mapping[str, Entry], new: Mapping[str, Entry]) -> bool:
    sampled = {name: entry for name, entry in old.items() if entry.error > 0.0}
    return len(sampled) >= MIN_COPIED and all(
        name in new and new[name].value == entry.value
        for name, entry in sampled.items()
    )


def _unpaired_change(
    distance: float, error: float, margin: float, quantile: float
) -> Change:
    if distance + TOST_QUANTILE * error <= margin:
        return "equivalent"
    if not distance - quantile * error <= margin:  # NaN is a change
        return "changed"
    return "unresolved"


def _margin(statistic: str, value: float, old: Mapping[str, Entry]) -> float:
    found = _NAME.match(statistic)
    control, name, inside = found.groups() if found else ("", "", "")
    if name == "covariance":
        keys = [f"{control}covariance[{k},{k}]" for k in inside.split(",")]
        variances = [old[key].value or 0.0 for key in keys if key in old]
        whole = abs(value)
        if len(variances) == 2:
            whole = sqrt(abs(variances[0] * variances[1]))
        return COVARIANCE_MARGIN * whole
    if name == "bias":
        return BIAS_MARGIN * _spread(statistic, inside, old)
    return (COVARIANCE_MARGIN if name == "nees" else RMSE_MARGIN) * abs(value)


def _spread(statistic: str, inside: str, old: Mapping[str, Entry]) -> float:
    """Standard deviation of one sample: as the cell gives it, else from the error."""
    if f"sd[{inside}]" in old:
        return abs(old[f"sd[{inside}]"].value or 0.0)
    if f"covariance[{inside},{inside}]" in old:
        return sqrt(abs(old[f"covariance[{inside},{inside}]"].value or 0.0))
    return old[statistic].error * sqrt(old[statistic].n)
