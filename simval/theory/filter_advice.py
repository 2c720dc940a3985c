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

from simval.account import Account, Fact, Line, Quantity, Reply, Told, Values
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
from simval.units import DEGREE, OF_A_DATA_SHEET, PERCENT, Unit

TRUE: Final = "the true noise"
RULES: Final = (2.0, 10.0)
"""Factors of the gyroscope's noise that are passed on as rules of thumb."""
HALF: Final = 0.5
NO_GAIN: Final = 0.99  # of an error over that of now
RIGHT: Final = 0.055  # logarithm of an error that is stated as right: 5 %
UNEVEN: Final = 5.0  # times of an error about one axis, stated, that are said
GIVEN: Final = {
    NOISE: ("gyroscope noise N", OF_A_DATA_SHEET["gyro"]["N"]),
    WALK: ("gyroscope walk K", OF_A_DATA_SHEET["gyro"]["K"]),
    "accelerometer": ("accelerometer noise, a row", Unit("mm/s²", 1e3)),
    "magnetometer": ("magnetometer noise, a row", Unit("µT", 1e6)),
}
"""Words and unit of what a filter is given."""
SHIFTED: Final = {
    GYROSCOPE: ("scale of the gyroscope", PERCENT),
    "accelerometer": ("offset of the accelerometer", Unit("mm/s²", 1e3)),
    "magnetometer": ("offset of the magnetometer", Unit("µT", 1e6)),
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
    halves: Mapping[str, float]
    shifts: Mapping[str, float]
    ends: tuple[FilterEffect, ...]

    def given(self, factors: Factors) -> dict[str, float]:
        """Largest of the axes, SI: N, K and the noise of a row of each sensor."""
        told = self.cases[0].told(factors)
        found = {NOISE: told.gyroscope_noise, WALK: told.gyroscope_walk}
        found |= {each.name: each.std for each in told.sensors}
        return {name: float(np.max(value)) for name, value in found.items()}

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values: rad, SI units."""
        effects = {"achieved": self.settings.effect, **self.others}
        return {
            "honest": self.settings.honest,
            "factors": self.settings.factors,
            "settings": self.given(self.settings.factors),
            "effects": {name: x.as_object() for name, x in effects.items()},
            "interval": [each.as_object() for each in self.ends],
            "bound": self.bound,
            "sources": dict(self.sources),
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
    x, first = found.factors, cases[0]
    others = {TRUE: effect(cases, {})}
    for times in RULES:
        more = dict.fromkeys((NOISE, WALK), times)
        others[f"{times:g} times the gyroscope's noise"] = effect(cases, more)
    few = [case.coarse(COARSE // len(cases)) for case in cases]

    def anew(by: Factors) -> float:
        begin = {n: min(f / by.get(n, 1.0), 10.0**MOST) for n, f in x.items()}
        half = [case.scaled(by) for case in few]
        again = honest_settings(half, band=band, parts=parts, start=begin)
        return again.effect.worst

    now = anew({})
    halves = {"gyroscope noise": anew({NOISE: HALF, WALK: HALF})}
    halves |= {f"{s.name} noise": anew({s.name: HALF}) for s in first.truth.sensors}
    halves |= {name_of(each): anew({name_of(each): HALF}) for each in first.errors}
    # one unit of each axis: of the scales, and of the offsets
    units = {GYROSCOPE: np.eye(3).ravel()}
    units |= {s.name: np.repeat([0.0, 1.0], [9, 3]) for s in first.truth.sensors}
    unit_errors = tuple(
        CalibrationError(of=name, covariance=np.diag(one))
        for name, one in units.items()
    )
    alone = budget([replace(case, errors=unit_errors) for case in cases], x)
    return FilterAdvice(
        cases=tuple(cases),
        band=band,
        settings=found,
        bound=effect([replace(case, errors=()) for case in cases], {}).worst,
        others=others,
        sources=budget(cases, x),
        halves={name: error / now for name, error in halves.items()},
        shifts={e.of: found.effect.worst / alone[e.name] for e in unit_errors},
        ends=tuple(
            effect(
                [case.scaled(end) for case in cases],
                {n: x.get(n, 1.0) / end.get(n, 1.0) for n in first.factors},
            )
            for end in ends
        ),
    )


# ---- words


def _angle(value: float) -> str:
    return f"{rounded(DEGREE.factor * value, 3)}°"


def _stated(found: FilterEffect) -> str:
    """What a filter states of its error, by its NEES."""
    ratio = float(np.sqrt(3.0 / found.nees.max()))
    if abs(np.log(ratio)) < RIGHT:
        return "states its error right"
    if ratio < 1.0:
        return f"states {rounded(1.0 / ratio)} times too small an error"
    return f"states {rounded(ratio, 3)} times its error"


def _noises(factors: Factors) -> str:
    names = {NOISE: "gyroscope noise", WALK: "walk of its bias"}
    some = [
        f"{rounded(factor, 3)} times the {names.get(name, f'{name} noise')}"
        for name, factor in factors.items()
        if factor > 1.005
    ]
    return " and ".join(some) or TRUE


def advice_account(found: FilterAdvice) -> Account:
    """State advice on a filter's settings."""
    case, settings = found.cases[0], found.settings
    seconds = sum(float(each.path.dt.sum()) for each in found.cases)
    motions = f"{len(found.cases)} motions, of which the worst counts, "
    sensors = ", ".join(each.name for each in case.truth.sensors)
    shifts = [
        f"{words} {rounded(unit.factor * found.shifts[name])} {unit.name}"
        for name, (words, unit) in SHIFTED.items()
        if name in found.shifts
    ]
    true = found.given({})
    lines = [
        Line(words, unit.name, [_cell("true", true[name]), _cell("to give", value)],
             factor=unit.factor)
        for name, value in found.given(settings.factors).items()
        for words, unit in [GIVEN[name]]
        if value > 0.0
    ]  # fmt: skip
    shares = _shares(found)
    sources = [
        Line(name, "", [_cell(f"{name}, °", DEGREE.factor * found.sources[name]),
                        _cell(f"{name}, %", 100.0 * share)])
        for name, share in shares.items()
    ]  # fmt: skip
    return Account(
        title="Settings of a filter",
        said=f"{motions * (len(found.cases) > 1)}{seconds:.4g} s at "
        f"{1.0 / float(np.median(case.path.dt)):.4g} Hz; gyroscope, {sensors}. Errors "
        "are predicted, RMS per axis.",
        replies=[_give(found), _cost(found), *_limit(found, shares)],
        values=[
            Values(title="settings", lines=lines, heads=("true", "to give")),
            Values(title="error by source", lines=sources,
                   heads=("°", "% of the square")),
        ],
        facts=[Fact("temperature", "an error as large as now is made alone by a change "
                    f"of {', or '.join(shifts)}; compare what it changes")],
    )  # fmt: skip


def _cell(name: str, value: float) -> Quantity:
    return Quantity(name, float(f"{value:.4g}"))


def _shares(found: FilterAdvice) -> dict[str, float]:
    """Share of the squared error by source, the greatest first."""
    whole = sum(x**2 for x in found.sources.values())
    ordered = sorted(found.sources.items(), key=lambda each: -each[1])
    return {name: x**2 / whole for name, x in ordered if x > 0.0}


def _give(found: FilterAdvice) -> Reply:
    settings, (low, high) = found.settings, found.band
    achieved, noises = settings.effect, _noises(settings.factors)
    lines = [
        f"NEES {rounded(achieved.nees.max(), 3)}, where 3 is right and {low:g} to "
        f"{high:g} is asked.",
        f"With perfect calibrations it would err by {_angle(found.bound)}.",
    ]
    # NEES is a sum over the axes: one that is stated far too wide hides another
    wide = achieved.overstated
    uneven = f", but {rounded(wide)} times about one axis" * (wide > UNEVEN)
    if found.ends:
        errors, squares = zip(
            *((x.worst, x.nees.max()) for x in found.ends), strict=True
        )
        lines.append(
            "With the inputs at the ends of their intervals it errs by "
            f"{_angle(min(errors))} to {_angle(max(errors))}, NEES "
            f"{rounded(min(squares), 3)} to {rounded(max(squares), 3)}."
        )
    none = "No setting makes it state its error right. The nearest is "
    says = f"{none * (not settings.honest)}{noises}. It errs by"
    return Reply(
        title="What should the filter be given?",
        headline=f"{says[0].upper()}{says[1:]} {_angle(achieved.worst)} and "
        f"{_stated(achieved)}{uneven}.",
        answer="fail" if not settings.honest else "inconclusive" if uneven else "pass",
        do=""
        if settings.honest
        else "Improve the sensor below, or accept more (--band, --parts).",
        lines=tuple(lines),
    )


def _times(ratio: float) -> str:
    times = rounded(ratio, 3)
    return "" if times == "1" else f"{times} times "


def _cost(found: FilterAdvice) -> Reply:
    now, true = found.settings.effect.worst, found.others[TRUE]
    said = {
        name: f"With {name} {_angle(x.worst)}, {_times(x.worst / now)}as much; it "
        f"{_stated(x)}"
        for name, x in found.others.items()
    }
    *_, tenfold = said.values()
    return Reply(
        title="What do other settings cost?",
        headline=f"{said[TRUE]}. {tenfold}.",
        answer="pass" if true.nees.max() <= found.band[1] else "inconclusive",
        lines=tuple(
            f"{words} (NEES {rounded(found.others[name].nees.max(), 3)})."
            for name, words in said.items()
        ),
    )


def _gain(ratio: float) -> str:
    if ratio < NO_GAIN:
        return f"{rounded(100.0 * (1.0 - ratio))} % less error"
    return "less than 1 %"


def _limit(found: FilterAdvice, shares: Mapping[str, float]) -> list[Reply]:
    source, share = next(iter(shares.items()))
    best = sorted(found.halves.items(), key=lambda each: each[1])
    gains = [f"{name}: {_gain(x)}" for name, x in best]
    name, least = best[0]
    first = gains[0] if least < NO_GAIN else "none gains 1 %"
    how = "A better part, or several averaged."
    if name.endswith("calibration"):
        how = "Four times the poses halve it, or half of their noise (simval plan)."
    return [
        Reply(
            title="What limits it?",
            headline=f"{source[0].upper()}{source[1:]}: {rounded(100.0 * share)} % of "
            "the squared error.",
        ),
        Reply(
            title="What would help most?",
            headline=f"Half of one source, with settings found anew: {first}.",
            do="" if name.endswith("disturbance") or least >= NO_GAIN else how,
            lines=tuple(gains[least < NO_GAIN :]),
        ),
    ]
