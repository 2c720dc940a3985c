r"""The one comparison: whether something is wrong with a log, and which it is.

Nothing is asked unless the plain ellipsoid misfits by its measured noise, with a chance
below `CHANCE`. Then every explanation j is held against it by its marginal likelihood
(J2), all together by their weighted mean

.. math:: O = \sum_j p_j\, \frac{m_j}{m_0}, \quad \sum_j p_j \le 1.  \tag{J3}

Where the plain one is right, the mean of each ratio is 1, so that of O is at most 1,
and O exceeds R with a chance of at most 1/R (Markov), however many explanations there
are and however alike: `REFUSED` and `REMARKED` are such R. The weights are equal among
the kinds and, within a kind, among its explanations. Where the likeliest leaves more
than the noise, and is likelier than what was there before, a second thing is tried
beside each of the best `LEADS`, up to `MOST` at once, at a prior share of `MORE` for
each further one.

The posterior share of an explanation is its term of O. It is named alone at `NAMED`;
otherwise those that make it up cannot be told apart.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import comb
from typing import Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.explain.catalogue import effects, explanations, off, plain
from simval.imu.explain.explanation import Explanation, RestMeans
from simval.imu.explain.likelihood import Fit, along, farthest, fits, zero_of
from simval.shapes import Float
from simval.text import chance_words

CHANCE = 1e-3  # of a misfit, by chance: what is asked at all
REFUSED, REMARKED = 1000.0, 100.0  # odds
NAMED = 0.9  # of the posterior
LEADS, MOST, MORE = 3, 3, 0.25
LISTED = 4  # of what was tried, the likeliest
INNOCENT = frozenset({"rest off", "noise"})
"""Kinds that accuse no sensor."""

Answer = Literal["sound", "unknown", "remark", "refusal"]


class Finding(NamedTuple):
    """One cause, with all that is alike it: the same kinds on the same axes.

    Attributes
    ----------
    explanation : Explanation
        The likeliest of them.
    share : float
        Posterior share of all of them.
    fit : Fit
        Fit of the likeliest.
    """

    explanation: Explanation
    share: float
    fit: Fit


class Judgement(NamedTuple):
    """What is wrong with the rests of a sensor.

    Attributes
    ----------
    chance : float
        Chance of residuals as great, by the measured noise.
    misfit : float
        Times the measured noise that the plain ellipsoid needs.
    odds : float
        Odds (J3) of all explanations together against none, natural logarithm.
    findings : tuple of Finding
        Causes, best first.
    """

    chance: float
    misfit: float
    odds: float = -np.inf
    findings: tuple[Finding, ...] = ()

    @property
    def answer(self) -> Answer:
        """Sound; beyond the noise, cause unknown; a remark; or a refusal."""
        if self.chance >= CHANCE:
            return "sound"
        if self.odds < np.log(REMARKED):
            return "unknown"
        return "remark" if self.odds < np.log(REFUSED) else "refusal"

    @property
    def names(self) -> bool:
        """True if a cause is named, as a remark or a refusal."""
        return self.answer in ("remark", "refusal")

    @property
    def accuses(self) -> bool:
        """True if the sensor or its readings are refused, and no rest may be why."""
        innocent = any(f.explanation.kinds <= INNOCENT for f in self.candidates)
        return self.answer == "refusal" and not innocent

    @property
    def candidates(self) -> tuple[Finding, ...]:
        """Fewest causes that make up the posterior share to be named."""
        covered = np.cumsum([finding.share for finding in self.findings])
        return self.findings[: int(np.searchsorted(covered, NAMED)) + 1]

    @property
    def off(self) -> tuple[int, ...]:
        """Rests that the likeliest cause leaves out, of a remark or a refusal."""
        if not self.names:
            return ()
        parts = self.findings[0].explanation.parts
        return tuple(
            sorted({k for p in parts if p.kind == "rest off" for k in p.rests})
        )

    def sentence(self, time: Float[Array, " n"] | None) -> str:
        """Say what is wrong and what to do.

        Parameters
        ----------
        time : (n,) array or None
            Time of each rest, s; None names them by their place, as poses.

        Returns
        -------
        str
            A sentence or two; empty where the rests are sound.
        """
        cause, do = self.cause(time), self.advice
        return f"{cause}: {do}" if do else cause

    @property
    def advice(self) -> str:
        """Say what to do; nothing where no cause is named."""
        if not self.names:
            return ""
        each = (found.explanation.advice for found in self.candidates)
        return "; or ".join(dict.fromkeys(each))

    def cause(self, time: Float[Array, " n"] | None) -> str:
        """Say what is wrong.

        Parameters
        ----------
        time : (n,) array or None
            As for `sentence`.

        Returns
        -------
        str
            A sentence; empty where the rests are sound.
        """
        if self.answer == "sound":
            return ""
        if self.answer == "unknown":
            return (
                f"the rests scatter {self.misfit:.2g} times their noise, and nothing "
                "that was tried explains it: the cause is not known"
            )
        named = self.candidates
        so = " or ".join(f.explanation.sentence(time) for f in named)
        apart = " (these cannot be told apart)" if len(named) > 1 else ""
        return f"{so}{apart}"

    def runners_up(self, time: Float[Array, " n"] | None) -> list[str]:
        """List what was tried, the likeliest first, with its odds against nothing.

        Parameters
        ----------
        time : (n,) array or None
            Time of each rest, s; None names them by their place, as poses.

        Returns
        -------
        list of str
            Lines: one of the misfit, and one of each cause.
        """
        misfit = (
            f"the rests scatter {self.misfit:.2g} times their noise (chance "
            f"{chance_words(self.chance)})"
        )
        if not self.findings:
            return [f"{misfit}: nothing was tried"]
        lines = [f"{misfit}; odds of what was tried against nothing, and its share:"]
        for found in self.findings[:LISTED]:
            odds = self.odds + np.log(max(found.share, np.finfo(float).tiny))
            tens = f"10^{odds / np.log(10.0):.1f}"
            so = found.explanation.sentence(time)
            lines.append(f"  {tens:>9s}  {100.0 * found.share:5.1f} %  {so}")
        return lines


def judge(rests: RestMeans, extra: Sequence[Explanation] = ()) -> Judgement:
    """Judge the rests of a sensor that reads a vector of constant length.

    Parameters
    ----------
    rests : RestMeans
        Mean readings, their covariances and times.
    extra : sequence of Explanation, optional
        Explanations to try beside those of the catalogue, as of readings unwrapped by
        the motion between the rests.

    Returns
    -------
    Judgement
        Sound, or what is wrong.
    """
    rests = replace(rests, zero=zero_of(rests, rests.readings))
    first = fits([plain(rests)], rests, along(rests))[0]
    noise = along(rests, first)
    null = fits([plain(rests)], rests, noise)[0]
    judgement = Judgement(null.chance(rests.freedom), null.misfit)
    if judgement.answer == "sound":
        return judgement
    sets = [k for k in farthest(rests, noise, null) if len(k) > 1]
    tried = [*explanations(rests), *(off(rests, k) for k in sets), *extra]
    entries = _entries(tried, rests, noise, null)
    last, best = entries, 0.0
    for _ in range(1, MOST):
        lead = max(last, key=_weight)
        if lead.weight <= best or lead.fit.chance(rests.freedom) >= CHANCE:
            break
        best = lead.weight
        last = [
            entry
            for leader in _leaders(last)
            for entry in _beside(leader, rests, noise, null)
        ]
        entries = entries + last
    weight = np.array([entry.weight for entry in entries]) + np.log(1.0 - MORE)
    odds = float(scipy.special.logsumexp(weight))
    return judgement._replace(
        odds=odds, findings=_findings(entries, np.exp(weight - odds))
    )


class _Entry(NamedTuple):
    explanation: Explanation
    fit: Fit
    prior: float  # logarithm of p_j
    weight: float  # and of its term of (J3)


def _entries(
    tried: Sequence[Explanation],
    rests: RestMeans,
    noise: Array,
    null: Fit,
    lead: _Entry | None = None,
) -> list[_Entry]:
    # a lead's columns stand before those of what is tried in its readings; sets of
    # rests count all that could be drawn, those not fitted with nothing
    families = [(e.kind, len(e.rests) * (e.kind == "rest off")) for e in tried]
    count = Counter(families)
    for kind, several in count:
        if several:
            count[kind, several] = comb(len(noise), several)
    prior = -np.log(len(count))
    joint, start = list(tried), null
    if lead is not None:
        prior += lead.prior + np.log(MORE)
        joint, start = [lead.explanation.also(e) for e in tried], lead.fit
    every = fits(joint, rests, noise, start)
    priors = [float(prior - np.log(count[family])) for family in families]
    return [
        _Entry(e, fit, p, p + fit.log - null.log)
        for e, fit, p in zip(joint, every, priors, strict=True)
    ]


def _weight(entry: _Entry) -> float:
    return entry.weight


def _leaders(entries: Sequence[_Entry]) -> list[_Entry]:
    # the best of each kind and axes; more noise beside another thing explains anything
    best: dict[object, _Entry] = {}
    for entry in sorted(entries, key=_weight):
        cause = _cause(entry.explanation)
        if not any(kind == "noise" for kind, _ in cause):
            best[cause] = entry
    return sorted(best.values(), key=_weight, reverse=True)[:LEADS]


def _beside(lead: _Entry, rests: RestMeans, noise: Array, null: Fit) -> list[_Entry]:
    undone = replace(rests, readings=lead.explanation.readings)
    tried = [e for e in effects(undone) if e.kind != "noise"]
    return _entries(tried, undone, noise, null, lead)


def _cause(explanation: Explanation) -> frozenset[tuple[str, str]]:
    # whatever the place in time
    return frozenset((part.kind, part.axes) for part in explanation.parts)


def _findings(entries: Sequence[_Entry], share: Array) -> tuple[Finding, ...]:
    alike: dict[object, list[tuple[float, _Entry]]] = {}
    for entry, part in zip(entries, share, strict=True):
        cause = _cause(entry.explanation)
        alike.setdefault(cause, []).append((float(part), entry))
    found = []
    for each in alike.values():
        _, best = max(each, key=lambda pair: pair[0])
        found.append(Finding(best.explanation, sum(p for p, _ in each), best.fit))
    return tuple(sorted(found, key=lambda finding: -finding.share))
