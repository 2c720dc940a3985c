"""The account of filters on a log: how wrong they are, and if they state it right.

An `Evaluation` states it of one filter, a `FilteredLog` of all that ran over a log.
What a filter states is held against its errors (NEES), or against its innovations (NIS)
where there is no truth, which is a self-check only: a scale error of the gyroscope, or
noise that is set wrongly, leaves innovations as they should be.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Values
from simval.imu.recorded.errors import ALPHA, NormalisedSquare, Rms, differ
from simval.imu.recorded.rows import RowEvidence
from simval.ranking import Ranking, ranked
from simval.spelling import measured, rounded, series
from simval.text import interval_words

PARTS: Final = {"all": "", "rest": " at rest", "moving": " moving"}
"""Parts of a log, as they follow the name of a filter."""
ERRORS: Final = ("total", "heading", "inclination")
SELF_CHECK = (
    "Without truth this is a self-check only: a wrong scale or noise setting can pass "
    "it."
)
FREE: Final = (
    "Without a magnetometer heading is free: its error is the drift "
    "since the first row with truth. The bound (Cramér-Rao) is the "
    "least possible of six axes with these settings, if the specific "
    "force were gravity alone."
)
LOOSE: Final = 2.0
"""Times what is stated from which an interval that holds it is too wide to say so."""
PUBLISHED: Final = "BROAD: Laidig, Caruso, Cereatti, Seel, Data 6(7), 2021"


# ---- judgements


class Stated(NamedTuple):
    """What a filter states of its errors, compared with what is seen.

    Attributes
    ----------
    name : str
        Of the filter.
    of : {"error", "drift", "innovations"}
        What is held against it.
    square : NormalisedSquare
        The mean normalised square, with its verdict.
    motion : float
        Real acceleration while moving that the noise used leaves out, m/s^2.
    rows : RowEvidence or None
        What the gyroscope's rows were taken as.
    fits : bool
        Whether its innovations are no larger than it states.
    cautious : bool
        Whether they are as it states, but the walk of the bias that it was given is an
        upper limit, so that it may state more than its error.
    """

    name: str
    of: str
    square: NormalisedSquare
    motion: float
    rows: RowEvidence | None
    fits: bool = False
    cautious: bool = False

    @property
    def times(self) -> float:
        """Ratio of the error seen to the error stated."""
        return float(np.sqrt(self.square.mean / self.square.expected))

    @property
    def loose(self) -> bool:
        """True if both agree only because few stretches make up the mean."""
        return self.square.verdict == "consistent" and self.times >= LOOSE

    @property
    def holds(self) -> bool | None:
        """True if both agree; None if the log cannot show it."""
        if self.loose or self.square.verdict.startswith("not") or self.by_limit:
            return None
        return self.square.verdict == "consistent"

    @property
    def by_limit(self) -> bool:
        """Whether it states too much where what it was given is a limit."""
        return self.cautious and self.square.verdict == "underconfident"

    @property
    def words(self) -> str:
        """The verdict in words."""
        name, times = self.name, self.times
        if self.square.verdict == "not judged: rows":
            return "the gyroscope's rows are not what they are taken as"
        if self.holds is None and not (self.loose or self.by_limit):
            if self.square.blocks:
                return f"north is too uncertain to judge {name}"
            return f"too few rows have truth to judge {name}"
        before, after = {
            "error": (f"{name} is", "wrong as it states"),
            "drift": (f"the heading of {name} drifts", "far as it states"),
            "innovations": (f"the innovations of {name} are", "large as it states"),
        }[self.of]
        if self.holds or times >= 1.0:
            size = "" if self.holds else f"{rounded(times)} times "
            few = ", but only in some stretches of the log" if self.loose else ""
            return f"{before} {size}as {after}{few}"
        own = {"error": "error", "drift": "drift of heading"}.get(self.of, self.of)
        given = ", and the walk K that it was given is an upper limit" * self.by_limit
        return f"{name} states {rounded(1.0 / times)} times its {own}{given}"

    @property
    def do(self) -> str:
        """What to do about it, with {} for the filter's name; empty if nothing."""
        if self.square.verdict == "not judged: rows":
            remedy = None if self.rows is None else self.rows.remedy
            options = "--gyro-rows, --gyro-delay"
            return f"State them: {' '.join(remedy.options) if remedy else options}."
        if self.by_limit:
            return "Measure K in a longer rest (simval noise), and give it (--noise)."
        if self.holds is None and self.square.blocks and not self.loose:
            return "State the truth's world (--truth-world)."
        if self.holds is None and not self.loose:
            return "Record for longer."
        if self.holds:
            return ""
        if self.times < 1.0:
            return "Give {} less noise."
        if self.fits:
            return (
                "The innovations of {} fit, so more noise is no cure: look at the "
                "covariance it returns, the calibration (--calibration) and the field."
            )
        how = f" (--accelerometer-noise {self.motion:.2g})" if self.motion else ""
        return f"Give {{}} more noise{how}, or calibrate the log first (--calibration)."

    @property
    def sentence(self) -> str:
        """The numbers behind the verdict."""
        square = self.square
        what = {"error": "NEES", "drift": "NEES of the drift of heading"}.get(
            self.of, "NIS"
        )
        if np.isnan(square.mean):
            return f"{self.name}: {what}: {square.verdict}, too little is seen."
        ends = f", {interval_words(square.low, square.high, 3)}"
        known = f"; the noise is known to {50.0 * square.told:.2g} %"
        return (
            f"{self.name}: {what} {rounded(square.mean, 3)} of {square.expected:g}"
            f"{ends if np.isfinite(square.low) else ''}: {square.verdict}"
            f"{known if square.told else ''}."
        )


def stated(each: Any, *, innovations: bool = False) -> list[Stated]:
    """Judge what a filter states of its errors, or else of its innovations."""
    truth = each.truth
    squares = {} if truth is None else {"error": truth.nees, "drift": truth.drift}
    if truth is None or innovations:
        squares["innovations"] = each.nis
    own, nis = each.run.name, each.nis
    fits = nis is not None and nis.verdict in ("consistent", "underconfident")
    if fits and nis.mean >= LOOSE**2 * nis.expected:
        fits = False
    cautious = each.run.cautious and nis is not None and nis.verdict == "consistent"
    return [
        Stated(own, of, square, each.run.motion, each.rows, fits, cautious)
        for of, square in squares.items()
        if square is not None
    ]


class North(NamedTuple):
    """Effect that another north would have on a comparison of filters.

    Attributes
    ----------
    estimated : bool
        Whether north is that of the log's own magnetometer.
    turn : float
        Half of its 95 % interval, or how far off it is from the one taken, rad.
    totals : mapping of str to sequence of float
        RMS of the total errors at other norths, rad, by filter.
    exchanged : tuple of str
        Pairs of filters that it exchanges, or leaves undecided.
    """

    estimated: bool
    turn: float
    totals: Mapping[str, Sequence[float]]
    exchanged: tuple[str, ...]

    @property
    def words(self) -> str:
        """Say what another north would change; empty for nothing."""
        angle = np.degrees(self.turn)
        pairs = "; ".join(self.exchanged)
        if self.estimated:
            return (
                f"North is the log's own magnetometer's, to {angle:.2g}° (95 %): a "
                "filter that follows it looks better."
            )
        return (
            f"By the log's own north, {angle:.2f}° off, {pairs} change places "
            "(--truth-world estimated)."
            if pairs
            else ""
        )

    @property
    def sentence(self) -> str:
        """Say the total errors with that north."""
        ends = [
            f"{name} {' and '.join(f'{np.degrees(v):.2f}°' for v in totals)}"
            for name, totals in self.totals.items()
        ]
        turned = "either end of that" if self.estimated else "it"
        return f"With north turned to {turned}, the totals are: {', '.join(ends)}."


def north(done: Sequence[Any]) -> North | None:
    """Find what another north would change; None if the north is not in doubt.

    The difference of two mean squares is linear in a small turn, so an order that both
    ends of an interval have is that of all between.
    """
    judged = [each for each in done if each.truth is not None and not each.truth.free]
    if not judged:
        return None
    judged.sort(key=lambda each: float(each.truth.rms["all"]["total"].value))
    world = judged[0].truth.world
    estimated = world.taken == "estimated"
    return North(
        estimated=estimated,
        turn=world.norths[1],
        totals={
            each.run.name: turned
            for each in judged
            if (turned := each.truth.turned[0 if estimated else 1 :])
        },
        exchanged=tuple(
            f"{one.run.name} and {other.run.name}"
            for one, other in combinations(judged, 2)
            if _open(one, other, estimated=estimated)
        ),
    )


def _open(one: Any, other: Any, *, estimated: bool) -> bool:
    # whether another north swaps two distinct filters, or leaves two undecided
    pairs = zip(one.truth.turned, other.truth.turned, strict=True)
    crossed = any(a > b for a, b in pairs)
    order = ranking([one, other])
    tied = order is None or order.tied
    return crossed or tied if estimated else crossed and not tied


def ranking(done: Iterable[Any]) -> Ranking | None:
    """Rank the filters by the RMS of their total errors; None if none has one."""
    found = {
        each.run.name: each.truth
        for each in done
        if each.truth is not None and np.isfinite(each.truth.rms["all"]["total"].value)
    }
    if not found:
        return None
    alpha = ALPHA / max(1, 2 * len(found) - 3)  # with both ends
    return ranked(
        {name: truth.rms["all"]["total"].value for name, truth in found.items()},
        lambda one, other: differ(found[one].errors, found[other].errors, alpha),
    )


# ---- the account


def filters_account(
    done: Sequence[Any],
    failed: Mapping[str, str] = MappingProxyType({}),
    facts: Iterable[Fact] = (),
    quaternions: Sequence[str] = (),
    *,
    mistaken: bool = False,
) -> Account:
    """State what was measured of filters over a log.

    Parameters
    ----------
    done : sequence of Evaluation
        Filters that were measured.
    failed : mapping of str to str
        Filters that were not, and why.
    facts : iterable of Fact
        On the log, what filters were given, and the truth.
    quaternions : sequence of str
        Names of quaternions in a log without truth, which may be one.
    mistaken : bool, default False
        Whether units or axes of the log are not as they are stated.
    """
    said = "no filter was measured"
    if done:
        against = any(each.truth is not None for each in done)
        how = "against recorded attitudes" if against else "without truth"
        said = f"{series(each.run.name for each in done)} {how}"
    replies = []
    if done:
        replies = [_how_wrong(done, quaternions), _trusted(done, mistaken)]
    if failed:
        were = "was" if len(failed) == 1 else "were"
        replies.append(
            Reply(
                title="Was every filter measured?",
                headline=f"No: {series(failed)} {were} not measured.",
                answer="fail",
                do=" ".join(f"{name}: {why}" for name, why in failed.items()),
            )
        )
    return Account(
        title="Attitude filters over",
        source="a log",
        said=said,
        replies=replies,
        values=tuple(_values(done)),
        facts=(*facts, *(fact for each in done for fact in _own(each))),
    )


def _title(done: Sequence[Any], one: str, several: str) -> str:
    return one.replace("{}", done[0].run.name) if len(done) == 1 else several


def _how_wrong(done: Sequence[Any], quaternions: Sequence[str]) -> Reply:
    title = _title(done, "How wrong is {}?", "How wrong is each filter?")
    judged = sorted((each for each in done if each.truth is not None), key=_total)
    if not judged:
        do = "Add it (--truth)."
        if quaternions:
            do = f"If {series(quaternions)} of the log is the truth, add --truth "
            do += f"{quaternions[0]}."
        return Reply(
            title=title,
            headline="Cannot tell: there is no truth.",
            answer="inconclusive",
            do=f"{do} {SELF_CHECK}",
        )
    known = {each.run.name: each.truth.rms["all"] for each in judged}
    total, heading, inclination = (
        _angle(next(iter(known.values()))[x]) for x in ERRORS
    )
    own = "drift of heading" if judged[0].truth.free else "heading"
    headline = f"{total} RMS: {own} {heading}, inclination {inclination}."
    answer: Answer = "pass"
    if (order := ranking(done)) is None:
        answer, headline = "inconclusive", "Cannot tell: too few rows have truth."
    elif len(order.order) > 1:
        tie = ", no difference beyond chance" if len(order.best) > 1 else ""
        headline = f"Least: {series(order.best)}{tie}, {total} RMS."
        if not order.tied:
            most = _angle(known[order.worst[0]]["total"])
            headline += f" Most: {series(order.worst)}, {most}."
    other = north(done)
    if other and other.estimated and other.exchanged:
        answer = "inconclusive"
        pairs = "; ".join(other.exchanged)
        headline = f"Cannot rank {pairs}: north is too uncertain."
    lines = [other.sentence] if other and other.words else []
    lines += [FREE] if any(each.truth.free for each in judged) else []
    return Reply(
        title=title,
        headline=headline,
        answer=answer,
        do=other.words if other else "",
        lines=tuple(lines),
    )


def _total(each: Any) -> float:
    value = each.truth.rms["all"]["total"].value
    return value if np.isfinite(value) else np.inf


def _angle(rms: Rms) -> str:
    return f"{measured(np.degrees(rms.value), np.degrees(rms.sd))}°"


def _trusted(done: Sequence[Any], mistaken: bool) -> Reply:
    found = [one for each in done for one in stated(each)]
    # a drift that is too small to judge is no doubt of the others
    found = [one for one in found if one.of != "drift" or one.holds is not None]
    bad = [one for one in found if one.holds is False]
    # nor does it vouch for an error that is not judged
    unjudged = {one.name for one in found if one.of == "error" and one.holds is None}
    good = [
        one
        for one in found
        if one.holds and one.of != "innovations" and one.name not in unjudged
    ]
    open_ = [one for one in found if one.holds is None]
    alone = [one.words for one in found if one.holds and one.of == "innovations"]
    silent = [each.run.name for each in done if not stated(each)]
    answer: Answer = "fail" if bad else "inconclusive"
    if bad or good:
        answer = "fail" if bad else "pass"
        words = "; ".join(one.words for one in bad or [*good, *open_])
        headline = f"{'No' if bad else 'Yes'}: {words}."
    elif open_ or alone:
        words = "; ".join(dict.fromkeys(one.words for one in open_)) or "; ".join(alone)
        more = ", which does not show its error" if alone and not open_ else ""
        headline = f"Cannot tell: {words}{more}."
    else:
        states = "states" if len(silent) == 1 else "state"
        headline = f"Cannot tell: {series(silent)} {states} no covariance."
    advice: dict[str, list[str]] = {}
    for one in (*bad, *open_):
        advice.setdefault(one.do, []).append(one.name)
    do = [what.replace("{}", series(dict.fromkeys(of))) for what, of in advice.items()]
    if do and mistaken:
        do = ["First correct the units and axes of the log that are named above."]
    lines = [one.sentence for each in done for one in stated(each, innovations=True)]
    lines += [_whiteness(each) for each in done if each.white is not None]
    lines += [f"{name} states no covariance." for name in silent]
    lines.append(f"The false-alarm rate of each verdict is {100.0 * ALPHA:g} %.")
    return Reply(
        title=_title(done, "Can its covariance be trusted?",
                     "Can their covariances be trusted?"),
        headline=headline,
        answer=answer,
        do=" ".join(do),
        lines=tuple(lines),
    )  # fmt: skip


def _whiteness(each: Any) -> str:
    size = ", ".join(f"{value:.2f}" for value in each.white)
    return (
        f"{each.run.name}: each innovation correlates with the next by {size} (0 where "
        "a filter is right)."
    )


def _values(done: Sequence[Any]) -> Iterator[Values]:
    # filters with a free heading apart: their numbers mean something else
    for free in (False, True):
        own = [x for x in done if x.truth is not None and x.truth.free is free]
        if own:
            yield _errors(own, free=free)
    blind = [each for each in done if each.truth is None]
    seen = [(each.at_rest.inclination, each.nis) for each in blind]
    if any(np.isfinite(up) or nis is not None for up, nis in seen):
        yield Values(
            title="at rest",
            how="drift of the heading, and the filter's up against the specific force",
            lines=[
                Line(each.run.name, "", [
                    _plain(f"{each.run.name} drift", _drift(each)),
                    _plain(f"{each.run.name} up", np.degrees(each.at_rest.inclination)),
                    _square(f"{each.run.name} NIS", each.nis),
                ])
                for each in blind
            ],
            heads=("drift, °/min", "up, °", _of("NIS", [x.nis for x in blind])),
        )  # fmt: skip
    for each in done:
        if each.published:
            yield Values(
                title=f"{each.run.name} by published definitions, °",
                how="changed in turn",
                lines=[
                    Line(step.words, "", [
                        _plain(f"{step.words}, {name}", np.degrees(rms.value))
                        for name, rms in step.rms.items()
                    ])
                    for step in each.published
                ],
                heads=ERRORS,
            )  # fmt: skip


def _errors(own: Sequence[Any], *, free: bool) -> Values:
    squares = {_of("NEES", [x.truth.nees for x in own]): [x.truth.nees for x in own]}
    if free:
        squares["drift of 1"] = [x.truth.drift for x in own]
    squares[_of("NIS", [x.nis for x in own])] = [x.nis for x in own]
    lines = []
    for k, each in enumerate(own):
        name = each.run.name
        for part, known in each.truth.rms.items():
            label = f"{name}{PARTS[part]}"
            cells = [
                Quantity(f"{label} {x}", None)
                if np.isnan(known[x].value)
                else Quantity(
                    f"{label} {x}", *np.degrees((known[x].value, known[x].sd))
                )
                for x in ERRORS
            ]
            if part == "all":
                cells += [_square(f"{name} {x}", of[k]) for x, of in squares.items()]
            lines.append(Line(label, "", cells))
    least: Mapping[str, Any] = next(
        (each.truth.bound for each in own if each.truth.bound), {}
    )
    lines += [
        Line(f"bound{PARTS[part]}", "", [
            _plain(f"bound{PARTS[part]} {x}", np.degrees(values[x]), 3) for x in ERRORS
        ])
        for part, values in least.items()
    ]  # fmt: skip
    return Values(
        title="RMS error, °" if not free else "RMS error without a magnetometer, °",
        how="heading since the first row with truth" if free else "",
        lines=lines,
        heads=(*ERRORS, *squares),
    )


def _of(name: str, squares: Iterable[NormalisedSquare | None]) -> str:
    # a heading, with what is expected where that is the same for all
    expected = {f"{x.expected:g}" for x in squares if x is not None}
    return f"{name} of {expected.pop()}" if len(expected) == 1 else name


def _square(name: str, square: NormalisedSquare | None) -> Quantity:
    return _plain(name, np.nan if square is None else square.mean, 3)


def _plain(name: str, value: float, digits: int = 4) -> Quantity:
    # a number without an error has few digits, for none is sure
    known = float(f"{value:.{digits}g}") if np.isfinite(value) else None
    return Quantity(name, known)


def _drift(each: Any) -> float:
    return float(np.degrees(each.at_rest.drift) * 60.0)


def _own(each: Any) -> Iterator[Fact]:
    # of one filter
    name, rest, truth = each.run.name, each.at_rest, each.truth
    if truth is not None:
        late = bool(np.isnan(truth.settled))
        words = "does not settle within the log"
        words = words if late else f"had settled after {truth.settled:.0f} s"
        yield Fact(name, words, notable=late)
    yield Fact(name, each.run.how)
    if truth is not None and np.isfinite(rest.inclination):
        words = f"at rest its up is {np.degrees(rest.inclination):.2g}° off the force"
        if np.isfinite(rest.drift):
            words += f", and its heading drifts {_drift(each):.2g} °/min"
        yield Fact(name, words)
    yield Fact(name, f"{each.microseconds:.2g} µs a row")
    if each.published:
        yield Fact(name, f"published definitions are those of {PUBLISHED}")
