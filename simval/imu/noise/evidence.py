r"""Choose the components of a signal's noise, the slow ones by evidence.

White noise, flicker and a random walk are fitted first. Where that shows flicker or a
walk, or does not fit, others may explain the same averages: in place of the walk K,
Markov noise of any correlation time, or a ramp; beside it a ramp, or a sine at the
highest line of the spectrum. Each is one more fit of the same kind, a row of
`simval.imu.noise.components`, and they are weighed by their deviance

.. math:: D = (y - X\theta)^T V(\theta)^{-1} (y - X\theta) + \ln\det V(\theta)
   \tag{V13}

at one length an octave (at three, whose correlations are near one, D is two to three
times too sharp). What is within `LIKELY` of the least is not told apart by the signal:
an interval is then from the least end to the greatest of all of these, and a
coefficient is seen if all of them show it. A walk is Markov noise of a time without
end, so the times that are left are the interval of the correlation time.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import partial
from itertools import groupby, product
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.imu.noise.allan import PER_OCTAVE, Forms
from simval.imu.noise.components import Component
from simval.imu.noise.least_squares import AllanProblem, Squares, Z, ends, fitted
from simval.imu.noise.model import SlowNoise
from simval.shapes import Bool, Float, Int

LIKELY: Final = 6.0
"""Of (V13): what the true component may be above the best; measured, see
`test_true_time_is_likely`: exceeded by 1 to 5 % of signals."""
EVIDENCE: Final = 9.0
"""Of (V13): what a ramp or a sine beside all others must gain."""
SHORTEST: Final = 8.0  # rows to a correlation time; a shorter one is a sensor's filter
CYCLES: Final = 10  # of a sine within the signal; of fewer a drift has as many
_LINE: Final = 1e-4  # chance of a line as high in noise of a smooth spectrum
_BESIDE: Final = 10  # frequencies to either side of a line
_BAND: Final = 3.0  # of the level: their mean, which noise exceeds in one line of 1000
_CLOSE: Final = 2.0  # of (V13): from one correlation time to the next about the best
ROUNDS: Final = 6  # of times between those before
SURE: Final = 16.0
"""Of (V13): what flicker and a walk must gain over white noise for slow noise to be
plain where neither is seen alone, as 9 of 3000 white signals of 2000 rows do."""
NEEDED: Final = Z**2  # of (V13): what each of a walk and Markov noise must gain

WALK: Final = Component("K")
RAMP: Final = Component("R")
Components = tuple[Component, ...]


def kinds_of(components: Components) -> str:
    """Kinds of the components without the sine, to compare axes by."""
    return "".join(c.kind for c in components if c.kind != "A")


class Family:
    """Laws and forms for signals of one length, each computed once."""

    def __init__(
        self, counts: Int[Array, " m"], rows: int, kinds: Sequence[str]
    ) -> None:
        self.counts, self.rows, self._kinds = counts, rows, kinds
        self.fast = tuple(Component(kind) for kind in kinds if kind != "K")
        self._some: dict[tuple[int, ...], Family] = {}
        self._forms = Forms(counts, rows)

    def problem(
        self, variances: Float[Array, "s m"], *sets: Components
    ) -> AllanProblem:
        """Least-squares problem for one set of components, or a set for each signal."""
        law = np.array([[each.law(self.counts) for each in some] for some in sets])
        forms = np.array(
            [[[self._forms[a, b] for b in some] for a in some] for some in sets]
        )
        made = AllanProblem(
            variances, np.moveaxis(law, 1, 2), np.moveaxis(forms, (1, 2), (3, 4))
        )
        if len(sets) == 1:
            return AllanProblem(variances, made.law[0], made.forms[0])
        return made

    def of(self, places: NDArray[np.intp]) -> "Family":
        """The same for some of the averaging lengths."""
        counts = self.counts[places]
        known = tuple(counts.tolist())
        if known not in self._some:
            self._some[known] = Family(counts, self.rows, self._kinds)
        return self._some[known]


class Chosen(NamedTuple):
    """Components chosen for a signal, and the averaging lengths used."""

    used: tuple[int, int]
    found: Squares
    """The fit of the first of `likely`."""
    likely: tuple[Components, ...]
    """Sets of components that the signal does not tell apart, the stated one first."""
    least_time: float = np.inf
    """Rows: shortest correlation time that is left; infinite where none was asked."""
    most_time: float = np.inf
    """Rows: longest; infinite where a walk is likely."""
    frequency_sd: float = 0.0
    """Of a sine, cycles a row."""
    slow: bool = False
    """Whether there may be more than white noise and a sine."""
    sure: bool = False
    """Whether there is."""
    flicker: bool = False
    """Whether nothing without flicker is likely."""
    by_axes: bool = False
    """Whether sets are left out by the axes of the sensor together."""
    tried: Mapping[Components, float] = MappingProxyType({})
    """(V13) of sets before a ramp beside others, where there is no sine."""

    @property
    def components(self) -> Components:
        """The set of components that is stated."""
        return self.likely[0]

    def letter(self, component: Component, components: Components) -> str:
        """Letter of the coefficient of a component in a set.

        Markov noise has q where a walk is beside it, and alone where it is no walk
        itself and one may be beside it; else K, of the walk that it may be.
        """
        walk = any(WALK in each for each in self.likely) and not may_be_walk(
            self.likely
        )
        if component.kind == "M" and (WALK in components or walk):
            return "q"
        return component.process.letter


def may_be_walk(likely: Iterable[Components]) -> bool:
    """True if a walk without Markov noise is among the likely sets."""
    kinds = [{c.kind for c in each} for each in likely]
    return any("K" in each and "M" not in each for each in kinds)


def weighed(
    family: Family,
    variances: Float[Array, "1 m"],
    used: tuple[int, int],
    line: "Line",
    slow: bool | None = None,
    refused: Set[str] = frozenset(),
    both: bool = True,
) -> Chosen | None:
    """Choose components over some averaging lengths; None if no set fits.

    `slow` is what `is_slow` says of these lengths without a sine, where it is known;
    `refused` are kinds of sets that the axes of the sensor leave out; `both` asks for a
    walk beside Markov noise.
    """
    first, last = used
    # one length an octave, where these are enough
    step = PER_OCTAVE if last - first >= 6 * PER_OCTAVE else 1
    octaves = np.arange(first, last)[::step]
    few, some = family.of(octaves), variances[:, octaves]
    plain: Components = (*family.fast, WALK)
    extra: Components = ()
    if line.period:
        sine = (line.component,)
        without, with_it = (_slow(few, some, each, False)[0] for each in ((), sine))
        if min(without.values()) - min(with_it.values()) > EVIDENCE:
            plain, extra = (*plain, *sine), sine
    problem = family.problem(variances, plain).part(*used)
    found = fitted(problem)
    if slow is None:
        slow = bool(is_slow(problem, plain, found)[0])
    white = family.problem(variances, tuple(c for c in plain if c.kind not in "BK"))
    gain = fitted(white.part(*used)).deviance - found.deviance
    sets, bare = _slow(few, some, extra, both) if slow else ({plain: 0.0}, np.inf)
    tried = sets
    sets = {each: D for each, D in sets.items() if kinds_of(each) not in refused}
    # with a walk, a ramp must be visible itself, or be all that is needed
    least = min(sets.values())
    walk = (*plain, RAMP)
    alone = sets.get((*family.fast, RAMP, *extra), np.inf) - least <= LIKELY
    if slow and (alone or least - _deviances(few, some, [walk])[walk] > EVIDENCE):
        sets |= _slow(few, some, (*extra, RAMP), False)[0]
    likely = _likely(sets, plain, walk)
    by_plain = found
    for each in likely:  # the best by few of the lengths may miss the others
        found = by_plain
        if each != plain:
            found = fitted(family.problem(variances, each).part(*used))
        if found.holds[0]:
            break
    else:
        return None
    likely = [each, *(other for other in likely if other != each)]
    least_time, most_time = _times_left(sets, likely)
    return Chosen(
        used,
        found,
        tuple(likely),
        least_time=least_time,
        most_time=most_time,
        frequency_sd=line.frequency_sd,
        slow=slow,
        sure=bool(gain[0] > SURE),
        flicker=bare - min(sets.values()) > LIKELY,
        tried={} if extra else tried,
        by_axes=bool(refused),
    )


def refused_together(axes: Sequence[Chosen]) -> Set[str]:
    """Kinds of sets to exclude so that all axes of a sensor have one kind.

    Those that others, no larger and not more general, exceed by `EVIDENCE` on all axes
    with slow noise together, and by a share of it without the axis that says most. The
    others are likely on each axis; if none is, the axes are not alike.
    """
    slow = [each for each in axes if each.slow and each.tried]
    if len(slow) < 2:
        return frozenset()
    least: list[dict[str, float]] = [{} for _ in slow]
    for axis, D in zip(slow, least, strict=True):
        for components, value in axis.tried.items():
            kinds = kinds_of(components)
            D[kinds] = min(value, D.get(kinds, np.inf))
    every = dict.fromkeys(kinds for D in least for kinds in D)
    alike = [
        kinds
        for kinds in every
        if all(D.get(kinds, np.inf) - min(D.values()) <= LIKELY for D in least)
    ]
    share = EVIDENCE / 3.0
    refused = set()
    for kinds, other in product(every, alike):
        more = [D.get(kinds, np.inf) - D[other] for D in least]
        general = set(kinds) <= {*other, *"K" * ("M" in other)}
        rest = sum(sorted(more)[:-1])
        if (
            not general
            and len(other) <= len(kinds)
            and rest > share
            and rest + max(more) > EVIDENCE
        ):
            refused.add(kinds)
    return frozenset(refused)


def _likely(
    sets: dict[Components, float], plain: Components, walk: Components
) -> list[Components]:
    # those that the signal cannot distinguish, the simplest first
    limit = min(sets.values()) + LIKELY
    likely = [each for each in sorted(sets, key=sets.__getitem__) if sets[each] < limit]
    if any(RAMP in each for each in likely) and walk not in likely:
        likely.append(walk)  # a walk's slope counts for a ramp's, however little it is
    return sorted(likely, key=lambda each: (plain, walk, each).index(each))


def _times_left(
    sets: Iterable[Components], likely: Iterable[Components]
) -> tuple[float, float]:
    # ends of the likely correlation times, to the middle to those that are not; of
    # Markov noise alone where a walk is likely, and that of the longest time is one
    likely = list(likely)
    walk = may_be_walk(likely)
    some = [each for each in likely if not (walk and WALK in each)]
    known, left = (
        np.unique([c.rows for each in every for c in each if c.kind == "M"])
        for every in (sets, some)
    )
    if not len(left):
        return np.inf, np.inf
    middles = np.sqrt(known[1:] * known[:-1])
    wide = np.concatenate([known[:1], middles, known[-1:]])
    first, last = np.searchsorted(known, left[[0, -1]])
    walk |= last + 1 == len(known)
    return float(wide[first]), np.inf if walk else float(wide[last + 1])


def is_slow(
    problem: AllanProblem, components: Components, found: Squares
) -> Bool[Array, " s"]:
    """True for each signal that has flicker or a walk, or needs one to fit."""
    slow = np.array([each.kind in "BK" for each in components])
    (low,) = ends(problem, found, (-Z,))
    law, forms = problem.law[:, ~slow], problem.forms[..., ~slow][..., ~slow, :]
    white = fitted(problem._replace(law=law, forms=forms))
    return np.any(low[:, slow] > 0.0, axis=1) | ~white.holds


def _deviances(
    family: Family, variances: Float[Array, "1 m"], sets: Iterable[Components]
) -> dict[Components, float]:
    # (V13) of each set, those of as many components together
    found: dict[Components, float] = {}
    for many in by_size(sets):
        every = family.problem(np.repeat(variances, len(many), axis=0), *many)
        found |= zip(many, fitted(every).deviance.tolist(), strict=True)
    return found


def by_size(sets: Iterable[Components]) -> list[list[Components]]:
    """Group sets of components by their number, to be fitted together."""
    return [list(some) for _, some in groupby(sorted(sets, key=len), len)]


def _slow(
    family: Family, variances: Float[Array, "1 m"], extra: Components, both: bool
) -> tuple[dict[Components, float], float]:
    # the walk, a ramp in its place, and Markov noise of every time, finer about the
    # likely ones; where it is asked for, a walk beside that in place of flicker. And
    # the least of what has no flicker
    def beside(*slow: Component) -> Components:
        return (*family.fast, *slow, *extra)

    def bare(*slow: Component) -> Components:
        return tuple(each for each in beside(*slow) if each.kind != "B")

    makers: list[Callable[..., Components]] = [beside]
    if both:
        makers += [partial(bare, WALK), bare]
    alone = [WALK] if RAMP in extra else [WALK, RAMP]
    asked = [make(each) for make in makers[::2] for each in alone]
    shortest = SHORTEST * float(family.counts[0])
    octaves = int(np.log2(family.rows / shortest))
    times = shortest * 2.0 ** np.arange(0, octaves + 2, 2)
    D: dict[Components, float] = {}
    known: list[Component] = []
    for _ in range(ROUNDS):
        new = [Component("M", time) for time in times.tolist()]
        asked += [make(each) for make in makers for each in new]
        D |= _deviances(family, variances, asked)
        asked, known = [], sorted([*known, *new], key=lambda each: each.rows)
        curves = [[D[make(each)] for each in known] for make in makers[:2]]
        times = _between(known, np.array(curves)) if known else times
        if not len(times):
            break
    sets = {each: D[each] for each in map(beside, [*alone, *known])}
    if not both:
        return sets, np.inf
    one = min(D[bare(each)] for each in [*alone, *known])
    two = {beside(WALK, each): D[bare(WALK, each)] for each in known}
    least = min(two.values(), default=np.inf)
    if least < one - NEEDED:
        # flicker is beside them, as in all other sets. Markov noise of a long time
        # beside a walk that is likely alone says nothing
        walk = sets[beside(WALK)] - min(least, *sets.values()) <= LIKELY
        most = one - NEEDED if walk else np.inf
        sets |= {each: level for each, level in two.items() if level < most}
    return sets, min(one, least + NEEDED)


def _between(
    known: list[Component], levels: Float[Array, "f t"]
) -> Float[Array, " new"]:
    # times between those known, where a level changes much from one to the next, and
    # one of them is likely
    rows = np.array([each.rows for each in known])
    above = levels - levels.min(axis=1, keepdims=True)
    near = np.minimum(above[:, 1:], above[:, :-1]) <= LIKELY
    near &= np.abs(np.diff(above, axis=1)) > _CLOSE
    return np.sqrt(rows[1:] * rows[:-1])[near.any(axis=0)]


class Line(NamedTuple):
    """A peak of a spectrum."""

    period: float = 0.0
    """Rows; 0 if there is none."""
    frequency_sd: float = 0.0
    """Cycles a row."""

    @property
    def component(self) -> Component:
        """The sine that makes the peak."""
        return Component("A", self.period)


def line_of(signal: Float[Array, " n"]) -> Line:
    """Find the highest peak in a signal's spectrum.

    A line stands above a smooth curve through the logarithms of the periodogram by
    more than noise does in one signal of 10 000, and alone: no band of noise is one.
    """
    n = len(signal)
    k = np.arange(CYCLES, n // 2)
    x = signal - signal.mean()
    window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
    every = np.abs(np.fft.rfft(x * window)) ** 2
    power = every[k]
    if not np.all(power > 0.0):
        return Line()
    curve = np.polynomial.Polynomial.fit(np.log(k), np.log(power), 5, w=k**-0.5)
    above = np.log(power) - curve(np.log(k)) - np.euler_gamma
    top = int(np.argmax(above))
    if not above[top] > np.log(-np.log(_LINE / len(k))):
        return Line()
    # a line under this window has less than that beyond two frequencies; a resonance,
    # or a motor whose speed wanders, is a band of noise
    away = np.abs(np.arange(len(k)) - top)
    near = (away > 2) & (away <= _BESIDE)
    d = away[near] - 0.5
    leak = 2.0 * power[top] / (np.pi * d * (d * d - 1.0)) ** 2
    level = np.exp(curve(np.log(k[near])) + np.euler_gamma)
    if np.mean(power[near] / level) > _BAND + np.mean(leak / level):
        return Line()
    # between two frequencies of the transform, by the squares of three
    below, at, beyond = np.sqrt(every[k[top] - 1 : k[top] + 2])
    whole = below + 2.0 * at + beyond  # exact for this window
    shift = 2.0 * (beyond - below) / whole
    # the bound 24 s^2/(A^2 n^3) on its variance in radians a row, in white noise of the
    # level about it, and 1.8 times its root for three frequencies under this window
    sd = 1.8 / (np.pi * n * np.exp(0.5 * above[top]))
    return Line(float(n / (k[top] + shift)), float(sd))


NAMES: Final = {
    "B": "flicker",
    "K": "a random walk",
    "M": "Markov noise",
    "R": "a ramp",
}


def words_of(
    chosen: Chosen, seen: Set[str], slow: SlowNoise | None, rate_hz: float, unit: float
) -> list[str]:
    """Say what was chosen besides N, B and K, and what cannot be told apart.

    `seen` are the letters of the coefficients that the signal shows.
    """
    said = []
    stated = {c.kind: place for place, c in enumerate(chosen.components)}
    kinds = {c.kind for each in chosen.likely for c in each}
    low = chosen.least_time / rate_hz
    if "M" in stated and seen & {"K", "q"} and "T" in seen:
        tau = chosen.components[stated["M"]].rows
        size = np.sqrt(0.5 * tau * chosen.found.values[0, stated["M"]] * unit)
        walk = "K is its driving noise, and no random walk follows the averages"
        if "q" in seen:
            walk = "q is its driving noise, and K is of the random walk with it"
        said.append(
            f"the bias is Markov noise of {size:.3g} raw units (1 sd), its correlation "
            f"time {tau / rate_hz:.3g} s ({low:.3g} to "
            f"{chosen.most_time / rate_hz:.3g} s): {walk}"
        )
    elif "M" in kinds and "K" in seen:
        said.append(
            "K is of a random walk, or of Markov noise with a correlation time "
            f"above {low:.3g} s: in this signal they look the same"
        )
    if slow is not None and not slow.seen:
        *others, last = (name for kind, name in NAMES.items() if kind in kinds)
        said.append(
            f"there is slow noise, but its kind is unclear: {', '.join(others)} "
            f"or {last}, each below its bound; for a filter there is an "
            "equivalent random walk, and a longer rest shows the kind"
        )
    if slow is not None and slow.by_axes:
        said.append("the axes of the sensor together leave out other kinds of noise")
    if "R" in seen:
        said.append("a ramp: the bias drifts evenly (temperature?)")
    if "A" in seen:
        period = chosen.components[stated["A"]].rows
        said.append(
            f"a sine of {rate_hz / period:.6g} Hz, a line of the spectrum: something "
            "near the sensor, or its own"
        )
    return said
