r"""Diagnosis: sound logs must pass, and faults must be named.

Each trial draws the rests of a sensor (`simval.studies.rest_sets`), as their rows would
be recorded, and asks `simval.imu.explain.judge` of them: of sound logs of many kinds,
and of logs with a fault of each kind at three sizes, two at once, or one that is in no
catalogue. Sizes are in units of the noise of a mean, which itself differs by ten from
log to log, and so does how good the part is: no prior of the engine was set on these.

A **sound** log is accused in at most one of 1000, by Markov's bound, and its odds
exceed 10 in at most one of ten; that it is asked about at all has a chance
of 0.001, where its noise is measured rightly. Of means whose noise is known, and is
greater across gravity than along it, the chance of the residuals is uniform: its mean
is 1/2.

A **fault** is *named* if all that makes up nine tenths of the posterior is of its kind,
*partly* if some of it is, *misnamed* if none is, each at the odds of a refusal; else it
is unnamed. *Missed* is what is not named; of a fault in no catalogue, what looks sound.
No theory says how often that is. So each share is held to what was counted once,
`MISSED`, with an independent seed: where k of N were, the chance of j of n is

.. math:: \binom nj \frac{B(k + j + \frac12, N - k + n - j + \frac12)}
   {B(k + \frac12, N - k + \frac12)},  \tag{DG1}

the binomial law with the rate unknown by Jeffreys' prior, B the beta function. Each row
is held to a limit that it exceeds in `SELDOM` of the runs; where so few logs may all be
missed, it is reported only. To count again: ``simval sweep FILE`` with ``seed = 4810``
and the section ``[diagnosis]`` of ``trials = 20`` and all ``logs``, of sound ones 25.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Final, Literal, get_args

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import outer
from simval.figures import Figure, Listing, along_entry, entry, family_words
from simval.geometry import normalize
from simval.imu.explain import Judgement, RestMeans, judge
from simval.imu.explain.explanation import Kind
from simval.imu.explain.judgement import REFUSED
from simval.results import Outcome, Row, Rows, limit, plain, unjudged
from simval.statistics import Family, Statistic
from simval.streams import Streams
from simval.studies.rest_sets import (
    BIASES,
    HOLDS,
    LYING,
    PAIRS,
    READINGS,
    SCALES,
    SCATTERED,
    SOUND,
    UNLISTED,
    Fault,
    G,
    Random,
    directions,
    faulty,
    unharmed,
)
from simval.studies.study import Cost, StudyParameters, described, ranged
from simval.studies.trials import share_error
from simval.units import PERCENT

TITLE = "Diagnosis: are sound logs left alone, and faults named?"
SECTION = "diagnosis"

SIZES: Final = (12.0, 50.0, 250.0)  # of a fault, times the noise of a mean
GROUPS: Final[Mapping[str, Mapping[str, Fault]]] = MappingProxyType({
    "changed readings": READINGS,
    "biases": BIASES,
    "scales": SCALES,
    "holds": HOLDS,
    "two at once": PAIRS,
    "in half a sphere": LYING,
    "in no catalogue": UNLISTED,
})  # fmt: skip
SOUND_LOGS: Final = 16  # of each kind to one with a fault, which takes 100 times longer
UNIFORM: Final = 512  # logs of known noise: enough to know their mean chance to 0.013
ACROSS: Final = 5.0  # times the noise along gravity, of means of known noise
ODDS: Final = 10.0  # at which Markov's bound is asked where it counts
SELDOM: Final = 1e-5
"""Chance that a row exceeds its limit where nothing is wrong: all rows of a suite,
fewer than a hundred, fail one clean run in a thousand at most."""
SAID: Final = ("sound", "no cause", *get_args(Kind), "several")
"""Answers to a log: its likeliest cause, if it is refused."""


class Parameters(StudyParameters):
    """One cell: what the logs have, and how many there are."""

    logs: Literal[
        "sound", "of known noise", "changed readings", "biases", "scales", "holds",
        "two at once", "in half a sphere", "in no catalogue",
    ] = described(
        "sound", "Logs without a fault, or with which."
    )  # fmt: skip
    trials: int = ranged(
        1,
        "Logs of each fault at each size; of sound ones 16 times as many of each kind, "
        "where these do not scatter, and of known noise 512 times.",
        1,
        10_000,
    )

    def cost(self) -> Cost:
        """Cost of a cell: 2 ms for a sound log, 0.18 s for one that misfits."""
        if self.logs == "sound":
            sound, scattered = len(SOUND) * SOUND_LOGS, 0.2 * len(SCATTERED)
            each = 2e-3 * sound + scattered
            return Cost(each * self.trials, 2 * len(SOUND) + 4)
        if self.logs == "of known noise":
            return Cost(2e-3 * UNIFORM * self.trials, 1)
        faults = len(GROUPS[self.logs])
        each = 0.3 if self.logs == "two at once" else 0.18
        rows = faults * (5 * len(SIZES) + 2 + len(SAID)) + len(SIZES)
        return Cost(each * faults * len(SIZES) * self.trials, rows)


COUNTED: Final = 20
"""Logs of each fault and size behind `MISSED`."""
MISSED: Final[Mapping[str, tuple[int, int, int, int]]] = MappingProxyType({
    "sign": (1, 1, 0, 0),
    "exchange": (0, 0, 1, 0),
    "factor": (2, 0, 0, 0),
    "wrap": (1, 0, 1, 0),
    "bias step": (20, 7, 2, 0),
    "bias steps": (20, 14, 3, 0),
    "bias drift": (20, 18, 2, 0),
    "warming": (20, 13, 6, 0),
    "bias in temperature": (20, 10, 0, 0),
    "scale step": (20, 14, 3, 0),
    "gain drift": (20, 1, 2, 0),
    "scale in temperature": (20, 9, 3, 0),
    "bend": (20, 12, 3, 0),
    "rest off": (20, 3, 3, 0),
    "two rests off": (20, 11, 3, 0),
    "noisy axis": (20, 19, 19, 0),
    "bias drift and sign": (20, 9, 8, 1),
    "bias step and rest off": (20, 20, 18, 0),
    "scale in temperature and exchange": (20, 14, 10, 0),
    "sign in half a sphere": (1, 2, 1, 0),
    "exchange in half a sphere": (2, 1, 0, 1),
    "factor in half a sphere": (3, 1, 1, 0),
    "wrap in half a sphere": (7, 8, 7, 0),
    "bias step in half a sphere": (20, 10, 1, 0),
    "bias steps in half a sphere": (20, 18, 7, 1),
    "bias drift in half a sphere": (20, 15, 3, 0),
    "warming in half a sphere": (20, 13, 5, 0),
    "bias in temperature in half a sphere": (20, 16, 1, 1),
    "scale step in half a sphere": (20, 13, 6, 1),
    "gain drift in half a sphere": (18, 5, 2, 0),
    "scale in temperature in half a sphere": (20, 12, 7, 0),
    "bend in half a sphere": (20, 17, 13, 0),
    "rest off in half a sphere": (20, 8, 0, 0),
    "two rests off in half a sphere": (20, 11, 0, 0),
    "noisy axis in half a sphere": (20, 19, 19, 0),
    "clipping": (11, 4, 0, 0),
    "hysteresis": (12, 2, 0, 0),
    "walking bias": (4, 0, 0, 0),
})  # fmt: skip
"""Missed of `COUNTED` at each size, and misnamed of all, by the fault."""
ASKED: Final = (6, 5200)
"""Sound logs of all kinds together that misfit, of so many: 1.2 +- 0.5 of 1000."""


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Judge the logs of one cell."""
    if parameters.logs == "sound":
        return Outcome(rows=(*_sound_rows(parameters.trials, streams),))
    if parameters.logs == "of known noise":
        return Outcome(rows=_known_rows(UNIFORM * parameters.trials, streams.block(0)))
    return Outcome(rows=(*_fault_rows(parameters, streams),))


Most = Callable[[int], int]  # of so many logs


def by_markov(rate: float, n: int) -> int:
    """Largest plausible count among n logs, each with at most this chance."""
    return int(np.ceil(scipy.special.bdtrik(1.0 - SELDOM, n, rate)))


def as_counted(k: int, of: int, n: int) -> int:
    """Largest plausible count among n logs, where k of others were counted, (DG1)."""
    j = np.arange(n + 1.0)
    a, b = k + 0.5, of - k + 0.5
    ln = scipy.special.betaln(a + j, b + n - j) - scipy.special.betaln(a, b)
    ln -= scipy.special.betaln(j + 1.0, n - j + 1.0) + np.log(n + 1.0)
    beyond = np.cumsum(np.exp(ln[::-1]))[::-1][1:]  # above 0, 1, ...
    return int(np.sum(beyond > SELDOM))


def held(what: Statistic, hits: Sequence[bool], most: Most, predictor: str) -> Rows:
    """Share of trials, judged against the largest plausible one."""
    n, share = len(hits), np.mean(hits)
    if most(n) < n:
        return limit(what, share, most(n) / n, predictor, n)
    return unjudged(what, share, share_error(share, n), n)


def again(what: Statistic, hits: Sequence[bool], k: int, of: int) -> Rows:
    """Share of trials, judged against an earlier count of k."""
    return held(what, hits, partial(as_counted, k, of), stat.COUNTED)


# sound logs


def _sound_rows(trials: int, streams: Streams) -> Iterator[Row]:
    found: dict[str, list[Judgement]] = {}
    for number, (name, make) in enumerate({**SOUND, **SCATTERED}.items()):
        n = trials * (SOUND_LOGS if name in SOUND else 1)
        rng = streams.block(number)
        found[name] = [judge(make(rng)) for _ in range(n)]
    every = [j for each in found.values() for j in each]
    bound = partial(by_markov, 1.0 / REFUSED)
    for name, each in {"all": every, **found}.items():
        accused = [j.accuses for j in each]
        yield from held(stat.ACCUSED(name), accused, bound, stat.MARKOV)
    for name in SOUND:
        asked = [j.answer != "sound" for j in found[name]]
        yield from again(stat.ASKED(name), asked, *ASKED)
    odds = [j.odds > np.log(ODDS) for name in SCATTERED for j in found[name]]
    bound = partial(by_markov, 1.0 / ODDS)
    yield from held(stat.ODDS_ABOVE(f"{ODDS:g}"), odds, bound, stat.MARKOV)


def _known_rows(n: int, rng: Random) -> Rows:
    mean = np.mean([judge(_of_known_noise(rng)).chance for _ in range(n)])
    error = (12.0 * n) ** -0.5  # of the uniform law
    return plain(stat.MEAN_CHANCE(), mean, error, n, 0.5, stat.EXACT)


def _of_known_noise(rng: Random) -> RestMeans:
    # known exactly, and of a direction: across gravity it is `ACROSS` times as great
    up = directions(int(rng.integers(16, 31)), rng)
    matrix = np.eye(3) + np.triu(rng.normal(0.0, 0.02, (3, 3)))
    y = G * up @ matrix.T + rng.normal(0.0, 0.3, 3)
    along, std = normalize(y), 10.0 ** rng.uniform(-3.5, -2.0)
    root = std * (ACROSS * np.eye(3) + (1.0 - ACROSS) * outer(along, along))
    y = y + np.einsum("nab,nb->na", root, rng.standard_normal(y.shape))
    return RestMeans.of(y, root @ root, np.arange(float(len(y))))


# faults


STANDINGS: Final[Mapping[str, Family]] = MappingProxyType({
    "named": stat.NAMED_AT,
    "partly named": stat.PARTLY_NAMED_AT,
    "unnamed": stat.UNNAMED_AT,
    "misnamed": stat.MISNAMED_AT,
})  # fmt: skip


def standing(judgement: Judgement, kinds: frozenset[Kind]) -> str:
    """Classify a judgement of a log that has faults of these kinds."""
    if judgement.answer != "refusal":
        return "unnamed"
    said = [finding.explanation.kinds for finding in judgement.candidates]
    if all(each == kinds for each in said):
        return "named"
    return "partly named" if any(each & kinds for each in said) else "misnamed"


def _missed(judgement: Judgement, kinds: frozenset[Kind]) -> bool:
    if not kinds:
        return judgement.answer == "sound"
    return standing(judgement, kinds) != "named"


def _said(judgement: Judgement) -> str:
    if judgement.answer != "refusal":
        return "sound" if judgement.answer == "sound" else "no cause"
    kinds = judgement.findings[0].explanation.kinds
    return next(iter(kinds)) if len(kinds) == 1 else "several"


def _fault_rows(parameters: Parameters, streams: Streams) -> Iterator[Row]:
    faults, n, whole = GROUPS[parameters.logs], parameters.trials, COUNTED * len(SIZES)
    at_size: list[list[bool]] = [[] for _ in SIZES]
    for number, (name, (kinds, _)) in enumerate(faults.items()):
        counts, every, missed = MISSED[name], list[Judgement](), list[bool]()
        for place, times in enumerate(SIZES):
            rng, at = streams.block(number * len(SIZES) + place), f"{times:g}"
            found = [
                judge(faulty(faults[name], times, rng, unharmed(rng))) for _ in range(n)
            ]
            stood = Counter(standing(j, kinds) for j in found)
            for what, family in STANDINGS.items():
                share = stood[what] / n
                yield from unjudged(family(name, at), share, share_error(share, n), n)
            here = [_missed(j, kinds) for j in found]
            yield from again(stat.MISSED_AT(name, at), here, counts[place], COUNTED)
            at_size[place] += here
            missed += here
            every += found
        yield from again(stat.MISSED(name), missed, sum(counts[:-1]), whole)
        if kinds:
            wrong = [standing(j, kinds) == "misnamed" for j in every]
            yield from again(stat.MISNAMED(name), wrong, counts[-1], whole)
        said = Counter(map(_said, every))
        shares = np.array([said[what] for what in SAID]) / len(every)
        each = [stat.SAID(name, what) for what in SAID]
        yield from unjudged(each, shares, n=len(every))
    for place, times in enumerate(SIZES):
        k = sum(MISSED[name][place] for name in faults)
        what_missed = stat.MISSED_AT("all", f"{times:g}")
        yield from again(what_missed, at_size[place], k, COUNTED * len(faults))


SIZED: Final = (*GROUPS,)[:-1]  # the others have no name
FIGURES = (
    Figure(
        name="diagnosis-power",
        asked="How great must a fault be to be named?",
        rows=[stat.NAMED_AT],
        along=along_entry,
        axis="size of the fault, times the noise of a mean",
        value="share named",
        where=lambda parameters: parameters["logs"] in SIZED,
        lines=entry(0),
        compared=False,
        log_y=False,
        caption=(
            "Share of the logs in which a fault is named, alone, over its "
            "size; a change of the readings has no size. Other faults are "
            "unnamed, named together with one that looks the same, or, seldom, "
            "misnamed: the table below has each."
        ),
    ),
    Listing(
        name="diagnosis-said",
        caption="What is said of logs with each fault, of all sizes: percent of them",
        rows=[stat.SAID],
        keys={"fault": entry(0)},
        column=entry(1),
        unit=lambda row: PERCENT,
        open=True,
    ),
    Listing(
        name="diagnosis-standings",
        caption="How each fault stands, by its size",
        rows=[*STANDINGS.values(), stat.MISSED_AT],
        keys={"fault": entry(0), "times the noise": entry(1)},
        column=family_words,
    ),
    Listing(
        name="diagnosis-sound",
        caption="Sound logs that are called faulty, and that misfit",
        rows=[stat.ACCUSED, stat.ASKED],
        keys={"logs": entry(0)},
        column=family_words,
    ),
)
