r"""A run beside the baseline: paired where the noise is the same, else equivalence.

Cells of the same name and seed draw the same noise, so a stored and a new value differ
by rounding only, unless the algorithm changed: up to `PAIRED_BOUND` standard errors
(for a value without chance `EXACT_BOUND` of its size) is accepted, more is a change.
No chance is involved, so no false alarm is spent.

A cell that differs from the stored one in its seed or number of samples only has other
noise. Then the question is not whether the values differ, for they do, but whether
they are equivalent: with :math:`d` the difference, :math:`s` its standard error and
:math:`m` the margin of the statistic,

.. math:: |d| + z_{0.95}\, s \le m  \tag{B1}

shows it by two one-sided tests of size 0.05; :math:`|d| - z\, s > m`, with z from the
comparisons' share of the false-alarm rate by Bonferroni's rule, shows a change; and
anything between is not resolved by so many samples. Other noise cannot give the same
numbers: where every sampled statistic of a cell, three at least, is equal to the bit,
the noise was not drawn anew.

The margins are 2 % of a covariance (off the diagonal, of the root of the product of the
two variances) or of a normalised square, 1 % of an RMS, a standard deviation or any
other size, and for a bias 2 % of the standard deviation of one sample.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Literal

from scipy.special import ndtri

from simval.gate.baseline import Entry, Stored, entries
from simval.sweep.run import Run
from simval.verdict import Answer

PAIRED_BOUND = 1e-3
"""Standard errors that a value drawn from the same noise may move."""

EXACT_BOUND = 1e-6
"""Relative change that a value without chance may show (rounding, amplified)."""

COVARIANCE_MARGIN = 0.02
RMSE_MARGIN = 0.01
BIAS_MARGIN = 0.02
TOST_QUANTILE = float(ndtri(0.95))

MIN_COPIED = 3
"""Sampled statistics that must be equal to the bit before a cell counts as copied: a
single one, a fraction of some hundred trials, can be equal by chance."""

Change = Literal[
    "same",
    "close",
    "equivalent",
    "changed",
    "unresolved",
    "copied",
    "missing",
    "unjudged",
    "new",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One statistic of a cell, now and in the baseline.

    Attributes
    ----------
    cell, statistic : str
        What is compared; the cell as the run names it, or the baseline where missing.
    change : str
        ``same`` to the bit, ``close`` within the paired bound, ``equivalent`` by eq.
        (B1), ``changed`` beyond either, ``unresolved`` between, ``copied`` equal to
        the bit though the noise should be another, ``missing`` from the run,
        ``unjudged`` by a check that the baseline names, ``new`` in the run.
    stored, value : float or None
        In the baseline and in the run.
    standard_error : float
        Of the stored value; of the difference where the noise is another.
    margin : float
        What is allowed; 0 where nothing is compared.
    """

    cell: str
    statistic: str
    change: Change
    stored: float | None
    value: float | None
    standard_error: float
    margin: float = 0.0

    @property
    def answer(self) -> Answer:
        """Pass, fail or inconclusive."""
        if self.change in ("changed", "copied", "missing", "unjudged"):
            return "fail"
        return "inconclusive" if self.change == "unresolved" else "pass"

    @property
    def sigmas(self) -> float:
        """Change in standard errors; NaN where there is none."""
        if self.stored is None or self.value is None or not self.standard_error > 0:
            return float("nan")
        return (self.value - self.stored) / self.standard_error

    @property
    def reason(self) -> str:
        """Why this is no pass, in words; empty where it is."""
        if self.change == "missing":
            return "in the baseline, but no longer measured"
        if self.change == "unjudged":
            return "no longer judged as the baseline says"
        if self.change == "copied":
            return (
                "equal to the bit, as all of its cell, though its noise should be "
                "another: the seed is not used, or the baseline names a wrong one"
            )
        if self.answer == "pass" or self.stored is None or self.value is None:
            return ""
        step = self.value - self.stored
        size = (
            f"{self.sigmas:+.3g} standard errors"
            if self.standard_error > 0
            else f"{step / abs(self.stored):+.3g} of its size"
            if self.stored
            else f"{step:+.3g}"
        )
        words = f"{self.stored:.9g} in the baseline, now {self.value:.9g}: {size}"
        if self.change == "unresolved":
            words += (
                f"; more samples are needed to tell whether within {self.margin:.3g}"
            )
        return words


def compare(run: Run, stored: Stored, alpha: float) -> tuple[Comparison, ...]:
    """Compare the finished cells of a run with a baseline.

    Parameters
    ----------
    run : Run
        The run.
    stored : mapping
        The cells of a baseline.
    alpha : float
        False-alarm rate that the comparisons of other noise share.

    Returns
    -------
    tuple of Comparison
        Sorted by cell and statistic.
    """
    now = {c.name: entries(c.rows) for c in run.cells if c.status == "done"}
    partner = _partners(sorted(stored), sorted(now))
    alone = {*stored, *now} - {*partner.keys(), *partner.values()}
    count = sum(len(stored[old]) for old in partner)
    quantile = float(-ndtri(alpha / max(count, 1) / 2.0))
    found: list[Comparison] = []
    for cell in alone:
        found += _paired(cell, stored.get(cell, {}), now.get(cell, {}))
    for old, new in partner.items():
        found += _unpaired(new, stored[old], now[new], quantile)
    return tuple(sorted(found, key=lambda c: (c.cell, c.statistic)))


def has_partners(run: Run, stored: Stored) -> bool:
    """Whether a cell of the run meets the baseline with other noise.

    Parameters
    ----------
    run : Run
        The run.
    stored : mapping
        The cells of a baseline.

    Returns
    -------
    bool
        True if `compare` will spend false alarms.
    """
    now = sorted(c.name for c in run.cells if c.status == "done")
    return bool(_partners(sorted(stored), now))


def _partners(stored: list[str], now: list[str]) -> dict[str, str]:
    """Stored cells that the run has with another seed or number of samples only."""
    free: dict[str, list[str]] = {}
    for cell in now:
        if cell not in stored:
            free.setdefault(_question(cell), []).append(cell)
    found = {}
    for cell in stored:
        matches = free.get(_question(cell), [])
        if cell not in now and matches:
            found[cell] = matches.pop(0)
    return found


def _question(cell: str) -> str:
    """Name of a cell without its seed and its number of samples."""
    return re.sub(r"\b(samples|trials)=\d+,?", "", cell.rpartition("@")[0])


def _paired(
    cell: str, old: Mapping[str, Entry], new: Mapping[str, Entry]
) -> Iterator[Comparison]:
    for statistic in sorted({*old, *new}):
        entry, now = old.get(statistic), new.get(statistic)
        error = 0.0 if entry is None else entry.error
        value = None if entry is None else entry.value
        bound = PAIRED_BOUND * error if error > 0.0 else EXACT_BOUND * abs(value or 0.0)
        yield Comparison(
            cell=cell,
            statistic=statistic,
            change=_paired_change(entry, now, bound),
            stored=value,
            value=None if now is None else now.value,
            standard_error=error,
            margin=bound,
        )
    if not old and not new:  # in the baseline, though nothing of it was stored
        yield Comparison(
            cell=cell,
            statistic="",
            change="missing",
            stored=None,
            value=None,
            standard_error=0.0,
        )


def _paired_change(old: Entry | None, new: Entry | None, bound: float) -> Change:
    if new is None:
        return "missing"
    if old is None:
        return "new"
    if not set(old.judged) <= set(new.judged) or (old.value is None) != (
        new.value is None
    ):
        return "unjudged"
    if old.value is None or new.value is None or new.value == old.value:
        return "same"
    return "close" if abs(new.value - old.value) <= bound else "changed"


def _unpaired(
    cell: str, old: Mapping[str, Entry], new: Mapping[str, Entry], quantile: float
) -> Iterator[Comparison]:
    copied = _copied(old, new)
    for statistic in sorted({*old, *new}):
        entry, now = old.get(statistic), new.get(statistic)
        unjudged = _paired_change(entry, now, 0.0) == "unjudged"
        if entry is None or now is None or unjudged or entry.value is None:
            yield from _paired(
                cell,
                {} if entry is None else {statistic: entry},
                {} if now is None else {statistic: now},
            )
            continue
        assert now.value is not None  # else it would be unjudged
        both = hypot(entry.error, now.error)
        margin = EXACT_BOUND * abs(entry.value)
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
    _, error, n, _ = old[statistic]
    name, _, inside = statistic.partition("[")
    if name == "covariance":
        variances = [old.get(f"covariance[{k},{k}]") for k in inside[:-1].split(",")]
        sizes = [abs(entry[0] or 0.0) for entry in variances if entry is not None]
        whole = sqrt(sizes[0] * sizes[1]) if len(sizes) == 2 else abs(value)
        return COVARIANCE_MARGIN * whole
    if name == "bias":
        return BIAS_MARGIN * error * sqrt(n)
    return (COVARIANCE_MARGIN if name == "nees" else RMSE_MARGIN) * abs(value)
