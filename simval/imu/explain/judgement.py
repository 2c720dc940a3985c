r"""The comparison of all explanations: whether something is wrong, and which it is.

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

**What the temperature does** is asked whatever the misfit, for where it is recorded an
effect is taken into the fit (`temperature_effect`): at odds of `KEPT` alone, and if no
other explanation has a share in it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import comb
from typing import Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.explain.catalogue import (
    AXES,
    effects,
    explanations,
    in_temperature,
    off,
    plain,
)
from simval.imu.explain.explanation import Explanation, Kind, RestMeans
from simval.imu.explain.likelihood import Fit, along, farthest, fits, zero_of
from simval.shapes import Float
from simval.spelling import chance as p_words

CHANCE = 1e-3  # of a misfit, by chance: what is asked at all
REFUSED, REMARKED = 1000.0, 100.0  # odds
NAMED = 0.9  # of the posterior
LEADS, MOST, MORE = 3, 3, 0.25
LISTED = 4  # of what was tried, the likeliest
INNOCENT = frozenset({"rest off", "noise"})
"""Kinds that accuse no sensor."""

KEPT = 2.0
"""Odds at which an effect of temperature is taken into a fit: less than one log of a
hundred without one exceeds them, whatever its noise was said to be. Measured,
`tests/imu/calibrate/test_thermal.py`."""
Effect = tuple[str, int]  # bias or scale, and the power of the temperature

Answer = Literal["sound", "unknown", "remark", "refusal"]


class Finding(NamedTuple):
    """A cause, with the explanations of the same kinds on the same axes.

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
    """Result of the comparison of explanations for the rests of a sensor.

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
        """Sound, unexplained scatter, a remark, or a refusal."""
        if self.chance >= CHANCE:
            return "sound"
        if self.odds < np.log(REMARKED):
            return "unknown"
        return "remark" if self.odds < np.log(REFUSED) else "refusal"

    @property
    def names(self) -> bool:
        """True if a cause is named, in a remark or a refusal."""
        return self.answer in ("remark", "refusal")

    @property
    def accuses(self) -> bool:
        """True if sensor or readings are refused, and no single rest can be why."""
        innocent = any(f.explanation.kinds <= INNOCENT for f in self.candidates)
        return self.answer == "refusal" and not innocent

    @property
    def candidates(self) -> tuple[Finding, ...]:
        """The fewest causes whose posterior shares together suffice to name them."""
        covered = np.cumsum([finding.share for finding in self.findings])
        return self.findings[: int(np.searchsorted(covered, NAMED)) + 1]

    @property
    def off(self) -> tuple[int, ...]:
        """Rests that the likeliest cause leaves out, if a cause is named."""
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
        """Say what to do; nothing if no cause is named."""
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
        """List the explanations tried, the likeliest first, with their odds.

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
            f"the rests scatter {self.misfit:.2g} times their noise "
            f"({p_words(self.chance)})"
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
    rests, noise, null = _null(rests)
    judgement = Judgement(null.chance(rests.freedom), null.misfit)
    if judgement.answer == "sound":
        return judgement
    entries = _every(rests, noise, null, extra)
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


class Temperature(NamedTuple):
    """Dependence of the readings on temperature.

    Attributes
    ----------
    effects : tuple of tuple
        Bias or scale, and the power of the temperature; none where nothing is kept.
    odds : float
        Odds of the last of these, or of any, natural logarithm.
    rival : Explanation or None
        What explains as much without a temperature, so that none is kept.
    """

    effects: tuple[Effect, ...]
    odds: float
    rival: Explanation | None = None


def temperature_effect(
    rests: RestMeans, most: int, besides: frozenset[Kind] = frozenset()
) -> Temperature:
    """Choose the temperature terms by the same odds as every other explanation.

    Bias and scale, each linear before it is square, are added while their odds beside
    those that are there pass `KEPT`.

    Parameters
    ----------
    rests : RestMeans
        Mean readings with the temperature of each rest.
    most : int
        Most effects.
    besides : frozenset of str, optional
        Kinds that nothing tells from an effect of temperature here, as a drift where it
        rises all the time: they are no rivals.

    Returns
    -------
    Temperature
        The effects, or why there are none.
    """
    rests, noise, null = _null(rests)
    found, odds = tuple[Effect, ...](), -np.inf
    lead: _Entry | None = None
    while tried := _following(rests, found, most):
        entries = _entries(tried, rests, noise, null, lead)
        before = 0.0 if lead is None else lead.weight
        more = float(scipy.special.logsumexp([e.weight for e in entries])) - before
        if more <= np.log(KEPT):
            odds = odds if found else more
            break
        groups: dict[tuple[Effect, ...], list[_Entry]] = {}
        for entry in entries:
            groups.setdefault(_effects(entry.explanation), []).append(entry)
        some = max(groups.values(), key=lambda each: max(map(_weight, each)))
        whole = [e for e in some if all(p.axes == AXES for p in e.explanation.parts)]
        lead, odds = max(whole, key=_weight), more
        found = _effects(lead.explanation)
        lead = lead._replace(weight=float(max(map(_weight, some))))
    if lead is None:
        return Temperature((), odds)
    own = _TEMPERATURE | besides
    others = [e for e in _every(rests, noise, null) if not e.explanation.kinds <= own]
    against = float(scipy.special.logsumexp([e.weight for e in others]))
    if lead.weight - np.logaddexp(lead.weight, against) < np.log(NAMED):
        return Temperature((), odds, max(others, key=_weight).explanation)
    return Temperature(found, odds)


_TEMPERATURE: frozenset[Kind] = frozenset(
    {"bias in temperature", "scale in temperature"}
)


def _effects(explanation: Explanation) -> tuple[Effect, ...]:
    parts = {(p.kind.split()[0], round(p.size)) for p in explanation.parts}
    return tuple(sorted(parts, key=lambda effect: (effect[1], effect[0])))


def _following(
    rests: RestMeans, found: tuple[Effect, ...], most: int
) -> list[Explanation]:
    # what may come next: a square only after its linear term; bias and scale together
    # as well, since each hides what the other explains
    free = [
        e for e in in_temperature(rests)
        for what, power in _effects(e)
        if (what, power) not in found and (power == 1 or (what, 1) in found)
    ]  # fmt: skip
    whole = [e for e in free if e.axes == AXES]
    pairs = [
        a.also(b) for a in whole for b in whole
        if (a.size, a.kind, b.kind) == (b.size, *sorted(_TEMPERATURE))
    ]  # fmt: skip
    room = most - len(found)
    return free * (room > 0) + pairs * (room > 1)


def _null(rests: RestMeans) -> tuple[RestMeans, Array, Fit]:
    # the rests about their zero, the noise that lengths feel, and the plain fit
    rests = replace(rests, zero=zero_of(rests, rests.readings))
    first = fits([plain(rests)], rests, along(rests))[0]
    noise = along(rests, first)
    return rests, noise, fits([plain(rests)], rests, noise)[0]


def _every(
    rests: RestMeans, noise: Array, null: Fit, extra: Sequence[Explanation] = ()
) -> "list[_Entry]":
    sets = [k for k in farthest(rests, noise, null) if len(k) > 1]
    tried = [*explanations(rests), *(off(rests, k) for k in sets), *extra]
    return _entries(tried, rests, noise, null)


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
    # the best of each kind and axes; with more noise anything would be explained
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
