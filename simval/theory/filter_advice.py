"""Advice on a filter's settings: what they achieve, what others cost, what would help.

Error and NEES are predictions (`simval.theory.filter_settings`). What would help is
asked with half of one source at a time, noise or what a calibration left, and settings
found anew. The interval is with the inputs at the ends of their own intervals, all at
once, and the settings as they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Told, Values
from simval.arrays import ReadOnly
from simval.spelling import rounded
from simval.theory.filter_model import GYROSCOPE, CalibrationError
from simval.theory.filter_settings import (
    BAND,
    COARSE,
    MOST,
    NOISE,
    WALK,
    Factors,
    FilterCase,
    FilterEffect,
    FilterSettings,
    budget,
    effect,
    honest_settings,
    name_of,
)
from simval.units import DEGREE, OF_A_DATA_SHEET, Unit

RULES: Final = (2.0, 10.0)
"""Factors of the gyroscope's noise that are passed on as rules of thumb."""
HALF: Final = 0.5
RIGHT: Final = (
    0.055  # logarithm of an error that is stated as right: 5 % of a deviation
)
PARTS: Final = 10  # of each motion, in which the worst is looked for
SETTING_UNITS: Final = {
    NOISE: OF_A_DATA_SHEET["gyro"]["N"],
    WALK: OF_A_DATA_SHEET["gyro"]["K"],
    "accelerometer": Unit("mm/s²", 1e3),
    "magnetometer": Unit("µT", 1e6),
}
SETTING_NAMES: Final = {
    NOISE: "gyroscope noise N", WALK: "gyroscope walk K",
    "accelerometer": "accelerometer noise, a row",
    "magnetometer": "magnetometer noise, a row",
}  # fmt: skip
SHIFTS: Final = {
    GYROSCOPE: ("gyroscope's scale off by", Unit("%", 100.0)),
    "accelerometer": ("accelerometer's offset of", Unit("mm/s²", 1e3)),
    "magnetometer": ("magnetometer's offset of", Unit("µT", 1e6)),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterAdvice(ReadOnly, Told):
    """What a filter should be given, what it then achieves, and what would help.

    Attributes
    ----------
    cases : tuple of FilterCase
        The motions, with their sensors.
    band : (float, float)
        NEES of an honest covariance.
    settings : FilterSettings
        What should be given.
    bound : float
        Error with perfect calibrations and the true noise given, rad per axis.
    others : mapping of str to FilterEffect
        What the true noise and rules of thumb achieve.
    sources : mapping of str to float
        Error with the settings by source, rad per axis; the squares add up.
    parts : FilterEffect
        With the settings, each motion in `PARTS` parts.
    halves : mapping of str to float
        Error over that of now, with half of one source and settings found anew.
    shifts : mapping of str to float
        Constant change of a sensor, SI, that alone makes an error as large.
    ends : tuple of FilterEffect
        With the inputs at both ends of their intervals; empty where they have none.
    """

    cases: tuple[FilterCase, ...]
    band: tuple[float, float]
    settings: FilterSettings
    bound: float
    others: Mapping[str, FilterEffect]
    sources: Mapping[str, float]
    parts: FilterEffect
    halves: Mapping[str, float]
    shifts: Mapping[str, float]
    ends: tuple[FilterEffect, ...]

    @property
    def given(self) -> dict[str, float]:
        """Settings in SI units: N, K and the noise of a row of each sensor.

        The largest of the axes.
        """
        told = self.cases[0].told(self.settings.factors)
        found = {NOISE: told.gyroscope_noise, WALK: told.gyroscope_walk}
        found |= {each.name: each.std for each in told.sensors}
        return {name: float(np.max(value)) for name, value in found.items()}

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values: rad, SI units."""

        def plain(each: FilterEffect) -> dict[str, Any]:
            return {"rms": each.worst, "nees": each.nees.max(axis=1).tolist()}

        return {
            "honest": self.settings.honest,
            "band": list(self.band),
            "factors": self.settings.factors,
            "settings": self.given,
            "achieved": plain(self.settings.effect),
            "interval": [plain(each) for each in self.ends],
            "bound": self.bound,
            "others": {name: plain(each) for name, each in self.others.items()},
            "sources": dict(self.sources),
            "nees_by_part": self.parts.nees.tolist(),
            "with_half": dict(self.halves),
            "as_large_alone": dict(self.shifts),
        }

    @property
    def account(self) -> Account:
        """What there is to say of it."""
        return advice_account(self)


def filter_advice(
    cases: Sequence[FilterCase],
    *,
    band: tuple[float, float] = BAND,
    parts: int = 1,
    ends: Sequence[Factors] = (),
) -> FilterAdvice:
    """Find settings, and what they achieve.

    Parameters
    ----------
    cases : sequence of FilterCase
        The motions, of the same sensors; the worst of them counts.
    band : (float, float)
        NEES of an honest covariance.
    parts : int, default 1
        Parts of each motion in each of which it must be.
    ends : sequence of mapping
        Noise and errors at the ends of their intervals, over what `cases` have.

    Returns
    -------
    FilterAdvice
        The settings, their effect and that of others.

    Raises
    ------
    InputError
        As of `honest_settings`.
    """
    found = honest_settings(cases, band=band, parts=parts)
    x = found.factors
    pure = [replace(case, errors=()) for case in cases]
    others = {"the true noise": effect(cases, {})}
    for times in RULES:
        more = dict.fromkeys((NOISE, WALK), times)
        others[f"{times:g} times the gyroscope's noise"] = effect(cases, more)
    return FilterAdvice(
        cases=tuple(cases),
        band=band,
        settings=found,
        bound=effect(pure, {}).worst,
        others=others,
        sources=budget(cases, x),
        parts=effect(cases, x, PARTS),
        halves=_halves(cases, found, band, parts),
        shifts=_shifts(cases, found),
        ends=tuple(_at(cases, x, end) for end in ends),
    )


def _at(cases: Sequence[FilterCase], x: Factors, end: Factors) -> FilterEffect:
    # as the noise is, with the settings that are given
    own = {name: x.get(name, 1.0) / end.get(name, 1.0) for name in cases[0].factors}
    return effect([case.scaled(end) for case in cases], own)


def _halves(
    cases: Sequence[FilterCase],
    found: FilterSettings,
    band: tuple[float, float],
    parts: int,
) -> dict[str, float]:
    few = [case.coarse(COARSE // len(cases)) for case in cases]

    def least(by: Factors) -> float:
        begin = {
            n: min(f / by.get(n, 1.0), 10.0**MOST) for n, f in found.factors.items()
        }
        other = [case.scaled(by) for case in few]
        again = honest_settings(other, band=band, parts=parts, start=begin)
        return again.effect.worst

    case, now = cases[0], least({})
    halves = {"gyroscope noise": dict.fromkeys((NOISE, WALK), HALF)}
    halves |= {f"{s.name} noise": {s.name: HALF} for s in case.truth.sensors}
    halves |= {name_of(each): {name_of(each): HALF} for each in case.errors}
    return {name: least(by) / now for name, by in halves.items()}


def _shifts(cases: Sequence[FilterCase], found: FilterSettings) -> dict[str, float]:
    # of every axis, its size unknown: one unit, and so much as makes the error of now
    units = {GYROSCOPE: np.eye(3).ravel()}
    units |= {
        each.name: np.repeat([0.0, 1.0], [9, 3]) for each in cases[0].truth.sensors
    }
    errors = tuple(
        CalibrationError(of=name, covariance=np.diag(variances))
        for name, variances in units.items()
    )
    parts = budget([replace(case, errors=errors) for case in cases], found.factors)
    now = found.effect.worst
    return {each.of: now / parts[each.name] for each in errors if parts[each.name]}


# ---- words

GIVE: Final = "What should the filter be given?"
COST: Final = "What do other settings cost?"
LIMIT: Final = "What limits it?"
HELP: Final = "What would help most?"


def _angle(value: float) -> str:
    return f"{rounded(DEGREE.factor * value, 3)}°"


def _stated(nees: float) -> str:
    """What a filter states of its error, by its NEES."""
    ratio = float(np.sqrt(3.0 / nees))
    if abs(np.log(ratio)) < RIGHT:
        return "states its error right"
    if ratio < 1.0:
        return f"states {rounded(1.0 / ratio)} times too small an error"
    return f"states {rounded(ratio, 3)} times its error"


def _words(source: str) -> str:
    return "acceleration" if source.endswith("motion") else source


def _short(value: float) -> float:
    return float(f"{value:.3g}")


def _noises(factors: Factors) -> str:
    known = {NOISE: "the gyroscope's noise", WALK: "the walk of its bias"}
    some = [
        f"{rounded(factor, 2 if factor > 1.995 else 3)} times "
        + known.get(name, f"the {name}'s noise")
        for name, factor in factors.items()
        if factor > 1.005
    ]
    *first, last = some or ["the true noise"]
    return f"{', '.join(first)} and {last}" if first else last


def advice_account(found: FilterAdvice) -> Account:
    """State advice on a filter's settings."""
    case, T = found.cases[0], [len(each.path.dt) for each in found.cases]
    seconds = sum(float(each.path.dt.sum()) for each in found.cases)
    rate = 1.0 / float(np.median(case.path.dt))
    sensors = ", ".join(each.name for each in case.truth.sensors)
    motions = "" if len(T) == 1 else f"{len(T)} motions, the worst counts; "
    return Account(
        title="Settings of a filter",
        said=f"{motions}{seconds:.4g} s of motion at {rate:.4g} Hz; gyroscope, "
        f"{sensors}. Errors are RMS per axis, as predicted.",
        replies=[_give(found), _cost(found), _limit(found), _help(found)],
        values=[_settings_values(found), _source_values(found)],
        facts=_facts(found),
    )


def _give(found: FilterAdvice) -> Reply:
    achieved, noises = found.settings.effect, _noises(found.settings.factors)
    nees, low, high = float(achieved.nees.max()), *found.band
    errs = f"It errs by {_angle(achieved.worst)} and {_stated(nees)}."
    lines: tuple[str, ...] = (
        f"NEES {rounded(nees, 3)}, where 3 is right and {low:g} to {high:g} is asked.",
        f"With perfect calibrations it would err by {_angle(found.bound)}.",
    )
    if found.ends:
        ends = [each.worst for each in found.ends]
        squares = [float(each.nees.max()) for each in found.ends]
        lines += (
            "With the inputs at the ends of their intervals it errs by "
            f"{_angle(min(ends))} to {_angle(max(ends))}, NEES "
            f"{rounded(min(squares), 3)} to {rounded(max(squares), 3)}.",
        )
    if found.settings.honest:
        return Reply(title=GIVE, headline=f"{noises[0].upper()}{noises[1:]}. {errs}",
                     lines=lines)  # fmt: skip
    return Reply(
        title=GIVE,
        headline=f"No setting makes it state its error right. The nearest is {noises}. "
        f"{errs}",
        answer="fail",
        do="Improve the sensor below, or accept more (--band, --parts).",
        lines=lines,
    )


def _cost(found: FilterAdvice) -> Reply:
    now = found.settings.effect.worst
    high = found.band[1]
    said = []
    for name, each in found.others.items():
        nees, ratio = float(each.nees.max()), each.worst / now
        times = f"{rounded(ratio, 3)} times that" if ratio > 1.005 else "as little"
        said.append(f"{name}: {_angle(each.worst)}, {times}; it {_stated(nees)} "
                    f"(NEES {rounded(nees, 3)}).")  # fmt: skip
    truth = found.others["the true noise"]
    worst = float(truth.nees.max())
    answer: Answer = "pass" if worst <= high else "inconclusive"
    return Reply(
        title=COST,
        headline=f"With {said[0].partition(' (')[0].replace(':', '', 1)}.",
        answer=answer,
        lines=tuple(f"{each[0].upper()}{each[1:]}" for each in said),
    )


def _by_sensor(found: FilterAdvice) -> dict[str, dict[str, float]]:
    """Shares of the squared error, by sensor and source."""
    whole = sum(x**2 for x in found.sources.values())
    by: dict[str, dict[str, float]] = {}
    for name, x in found.sources.items():
        sensor = "accelerometer" if name == "motion" else name.split()[0]
        by.setdefault(sensor, {})[name] = x**2 / whole
    return by


def _limit(found: FilterAdvice) -> Reply:
    by = _by_sensor(found)
    sensor = max(by, key=lambda each: sum(by[each].values()))
    source, share = max(by[sensor].items(), key=lambda each: each[1])
    percent = rounded(100.0 * sum(by[sensor].values()))
    most = f"; {_words(source)} alone is {rounded(100.0 * share)} %" * (
        len(by[sensor]) > 1
    )
    who = f"The {sensor}" if sensor != "start" else "The unknown start"
    return Reply(
        title=LIMIT, headline=f"{who}: {percent} % of the squared error{most}."
    )


def _help(found: FilterAdvice) -> Reply:
    best = sorted(found.halves.items(), key=lambda each: each[1])
    name, percent = best[0][0], 100.0 * (1.0 - best[0][1])
    if percent < 1.0:
        words = "Nothing by much: half of any one source lowers the error by under 1 %."
        return Reply(title=HELP, headline=words)
    how = ""
    if name.endswith("calibration"):
        how = "Four times the poses, or a noise of them half as large (simval plan)."
    elif name.endswith("noise"):
        how = "A better part, or one of these averaged over four."
    return Reply(
        title=HELP,
        headline=f"Half the error by {_words(name)}: it lowers the error by "
        f"{rounded(percent)} %, with settings found anew.",
        do=how,
        lines=tuple(
            f"{_words(n)}: {rounded(100 * (1 - r))} % less" for n, r in best[1:]
        ),
    )


def _settings_values(found: FilterAdvice) -> Values:
    true = replace(found, settings=found.settings._replace(factors={})).given
    lines = []
    for name, value in found.given.items():
        unit, words = SETTING_UNITS[name], SETTING_NAMES[name]
        cells = [
            Quantity(f"{words}, {which}", float(f"{each:.4g}"))
            for which, each in (("true", true[name]), ("to give", value))
        ]
        if value > 0.0:
            lines.append(Line(words, unit.name, cells, factor=unit.factor))
    return Values(title="settings", lines=lines, heads=("true", "to give"))  # fmt: skip


def _source_values(found: FilterAdvice) -> Values:
    whole = sum(x**2 for x in found.sources.values())
    lines = [
        Line(_words(name), "", [Quantity(f"{name}, °", _short(DEGREE.factor * x)),
                        Quantity(f"{name}, %", _short(100.0 * x**2 / whole))])
        for name, x in sorted(found.sources.items(), key=lambda each: -each[1])
        if x > 0.0
    ]  # fmt: skip
    return Values(title="error by source", lines=lines,
                  heads=("°", "% of the square"))  # fmt: skip


def _facts(found: FilterAdvice) -> list[Fact]:
    nees = found.parts.nees
    m, p = np.unravel_index(int(np.argmax(nees)), nees.shape)
    case = found.cases[int(m)]
    length = float(case.path.dt.sum()) - case.settle
    begin = case.settle + length * int(p) / PARTS
    worst = float(nees.max())
    facts = [
        Fact(
            "worst part",
            f"{begin:.3g} to {begin + length / PARTS:.3g} s: NEES {rounded(worst, 3)}",
            notable=worst > 2.0 * found.band[1],
        )
    ]
    said = []
    for name, size in found.shifts.items():
        words, unit = SHIFTS[name]
        said.append(f"a {words} {rounded(unit.factor * size)} {unit.name}")
    alone = f"as large an error as now is made alone by {', by '.join(said)}"
    return [*facts, Fact("temperature", f"{alone}; compare what it changes")]
