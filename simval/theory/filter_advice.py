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
from simval.theory.filter_model import GYROSCOPE, CalibrationError, RowError
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
    effect,
    honest_settings,
)
from simval.units import DEGREE, OF_A_DATA_SHEET, PERCENT, Unit

TRUE: Final = "the true noise"
OTHERS: Final[Mapping[str, Factors]] = {TRUE: {}} | {
    f"{x:g} times the gyroscope's noise": {NOISE: x, WALK: x} for x in (2.0, 10.0)
}
"""Factors of the true noise, and those that are passed on as rules of thumb."""
HALF: Final = 0.5
NO_GAIN: Final = 0.99  # of an error over that of now
RIGHT: Final = 0.055  # logarithm of an error that is stated as right: 5 %
UNEVEN: Final = 5.0  # times the real error about one axis that is reported
FORCE, FIELD = Unit("mm/s²", 1e3), Unit("µT", 1e6)
GIVEN: Final = {
    NOISE: ("gyroscope white noise N", OF_A_DATA_SHEET["gyro"]["N"]),
    WALK: ("gyroscope random walk K", OF_A_DATA_SHEET["gyro"]["K"]),
    "accelerometer": ("accelerometer noise per reading", FORCE),
    "magnetometer": ("magnetometer noise per reading", FIELD),
}
"""Words and unit of what a filter is given."""
SHIFTED: Final = {
    GYROSCOPE: ("scale of the gyroscope", PERCENT),
    "accelerometer": ("offset of the accelerometer", FORCE),
    "magnetometer": ("offset of the magnetometer", FIELD),
}
EXPLAINED: Final = {
    f"{sensor} disturbance": f"{sensor} disturbance ({words})"
    for sensor, words in (
        ("accelerometer", "acceleration other than gravity"),
        ("magnetometer", "field other than the Earth's"),
    )
}
"""Sources of error whose names alone say too little."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterAdvice(ReadOnly, Told):
    """What noise to give a filter, what it then achieves, and what would help.

    Attributes
    ----------
    cases : tuple of FilterCase
        The motions, with their sensors.
    band : (float, float)
        NEES of an honest covariance.
    settings : FilterSettings
        What should be given; its effect has the error by source.
    bound : float
        Error with perfect calibrations and the true noise given, rad per axis.
    others : mapping of str to FilterEffect
        What the true noise and rules of thumb achieve.
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
    halves: Mapping[str, float]
    shifts: Mapping[str, float]
    ends: tuple[FilterEffect, ...]

    def given(self, factors: Factors) -> dict[str, float]:
        """Largest axis of each noise, SI: N, K, and the noise of each sensor's row."""
        told = self.cases[0].told(factors)
        found = {NOISE: told.gyroscope_noise, WALK: told.gyroscope_walk}
        found |= {each.name: each.std for each in told.sensors}
        return {name: float(np.max(value)) for name, value in found.items()}

    def as_object(self) -> dict[str, Any]:
        """Return the advice as plain JSON values in rad and SI units."""
        effects = {"achieved": self.settings.effect, **self.others}
        return {
            "honest": self.settings.honest,
            "factors": self.settings.factors,
            "settings": self.given(self.settings.factors),
            "effects": {name: x.as_object() for name, x in effects.items()},
            "interval": [each.as_object() for each in self.ends],
            "bound": self.bound,
            "sources": dict(self.settings.effect.sources),
            "with_half": dict(self.halves),
            "as_large_alone": dict(self.shifts),
        }

    @property
    def account(self) -> Account:
        """Everything that there is to say of the advice."""
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
    x, sensors = found.factors, [each.name for each in cases[0].truth.sensors]
    few = [case.coarse(COARSE // len(cases)) for case in cases]

    def anew(*names: str) -> float:
        by = dict.fromkeys(names, HALF)
        begin = {n: min(f / by.get(n, 1.0), 10.0**MOST) for n, f in x.items()}
        half = [case.scaled(by) for case in few]
        again = honest_settings(half, band=band, parts=parts, start=begin)
        return again.effect.worst

    halves = {"gyroscope noise": (NOISE, WALK)} | {f"{s} noise": (s,) for s in sensors}
    halves |= {each.name: (each.name,) for each in cases[0].errors}
    now = anew()
    # one unit of each axis: of the scales, and of the offsets
    units = dict.fromkeys(sensors, np.repeat([0.0, 1.0], [9, 3]))
    alone = tuple(
        CalibrationError(of=name, covariance=np.diag(one))
        for name, one in ({GYROSCOPE: np.eye(3).ravel()} | units).items()
    )
    each = effect([replace(case, errors=alone) for case in cases], x).sources
    return FilterAdvice(
        cases=tuple(cases),
        band=band,
        settings=found,
        bound=effect([replace(case, errors=()) for case in cases], {}).worst,
        others={name: effect(cases, told) for name, told in OTHERS.items()},
        halves={name: anew(*own) / now for name, own in halves.items()},
        shifts={error.of: found.effect.worst / each[error.name] for error in alone},
        ends=tuple(
            effect(
                [case.scaled(end) for case in cases],
                {n: x.get(n, 1.0) / end.get(n, 1.0) for n in cases[0].factors},
            )
            for end in ends
        ),
    )


# ---- sentences


def _angle(value: float) -> str:
    return f"{rounded(DEGREE.factor * value, 3)}°"


def _stated(found: FilterEffect) -> str:
    """Say what error a filter states, from its NEES."""
    ratio = float(np.sqrt(3.0 / found.nees.max()))
    if abs(np.log(ratio)) < RIGHT:
        return "states its error right"
    if ratio < 1.0:
        return f"states an error {rounded(1.0 / ratio)} times too small"
    return f"states {rounded(ratio, 3)} times that"


def _nees(*found: FilterEffect) -> str:
    return " to ".join(rounded(x, 3) for x in sorted(x.nees.max() for x in found))


def advice_account(found: FilterAdvice) -> Account:
    """State advice on a filter's settings."""
    case, effect, count = found.cases[0], found.settings.effect, len(found.cases)
    seconds = sum(float(each.path.dt.sum()) for each in found.cases)
    several = f"{count} motions, of which the worst counts, " * (count > 1)
    sensors = ", ".join(each.name for each in case.truth.sensors)
    shifts = [
        f"{words} {rounded(unit.factor * found.shifts[name])} {unit.name}"
        for name, (words, unit) in SHIFTED.items()
        if name in found.shifts
    ]
    true = found.given({})
    lines = [
        Line(words, unit.name, [_cell(f"{words}, true", unit.factor * true[name]),
                                _cell(f"{words}, to give", unit.factor * value)])
        for name, value in found.given(found.settings.factors).items()
        for words, unit in [GIVEN[name]]
        if value > 0.0
    ]  # fmt: skip
    whole = sum(x**2 for x in effect.sources.values())
    errors = [x for each in found.cases for x in each.errors]
    rows = dict.fromkeys(_source(x.name) for x in errors if isinstance(x, RowError))
    ordered = sorted(effect.sources.items(), key=lambda each: -each[1])
    shares = [
        (", ".join(rows) if name == "disturbance" else name, x, 100.0 * x**2 / whole)
        for name, x in ordered
        if x > 0.0
    ]
    sources = [
        Line(name, "", [_cell(f"{name}, °", DEGREE.factor * x),
                        _cell(f"{name}, %", share)])
        for name, x, share in shares
    ]  # fmt: skip
    (source, _, share), *_ = shares
    return Account(
        title="Settings of a filter",
        said=f"{several}{seconds:.4g} s at "
        f"{1.0 / float(np.median(case.path.dt)):.4g} Hz; gyroscope, {sensors}. Errors "
        "are predicted, RMS per axis.",
        replies=[
            _give(found),
            _cost(found),
            Reply(
                title="What limits it?",
                headline=f"{source[0].upper()}{source[1:]}: {rounded(share)} % of the "
                "squared error.",
            ),
            _help(found.halves),
        ],
        values=[
            Values(title="noise settings", lines=lines,
                   heads=("true noise", "give the filter")),
            Values(title="error by source", lines=sources,
                   heads=("error, °", "% of squared error")),
        ],
        facts=[Fact("temperature", "it changes scales and offsets; any one of these "
                    f"changes makes as large an error: {', '.join(shifts)}")],
    )  # fmt: skip


def _source(name: str) -> str:
    return EXPLAINED.get(name, name)


def _cell(name: str, value: float) -> Quantity:
    return Quantity(name, float(f"{value:.3g}"))


def _give(found: FilterAdvice) -> Reply:
    (factors, achieved, honest), (low, high) = found.settings, found.band
    names = {NOISE: "gyroscope noise", WALK: "walk of its bias"}
    noises = " and ".join(
        f"{rounded(factor, 3)} times the {names.get(name, f'{name} noise')}"
        for name, factor in factors.items()
        if factor > 1.005
    )
    none = "No setting makes it state its error right. The nearest is "
    says = f"{none * (not honest)}{noises or TRUE}. It errs by"
    # NEES is a sum over the axes: one that is stated far too wide hides another
    wide = achieved.overstated
    uneven = f", but {rounded(wide)} times about one axis" * (wide > UNEVEN)
    lines = [
        f"NEES {_nees(achieved)}; 3 is right, and {low:g} to {high:g} is asked for.",
        f"With perfect calibrations it would err by {_angle(found.bound)}.",
    ]
    if found.ends:
        errors = " to ".join(map(_angle, sorted(each.worst for each in found.ends)))
        lines.append(
            f"With the inputs at the ends of their intervals it errs by {errors}, with "
            f"a NEES of {_nees(*found.ends)}."
        )
    return Reply(
        title="What should the filter be given?",
        headline=f"{says[0].upper()}{says[1:]} {_angle(achieved.worst)} and "
        f"{_stated(achieved)}{uneven}.",
        answer="fail" if not honest else "inconclusive" if uneven else "pass",
        do=""
        if honest
        else "Improve the sensor below, or accept more (--band, --parts).",
        lines=tuple(lines),
    )


def _cost(found: FilterAdvice) -> Reply:
    said = {}
    for name, x in found.others.items():
        times = rounded(x.worst / found.settings.effect.worst, 3)
        much = f"{times} times as much" if times != "1" else "as much"
        said[f"With {name} it errs by {_angle(x.worst)}, {much}, and {_stated(x)}"] = x
    true, *_, tenfold = said
    return Reply(
        title="What do other settings cost?",
        headline=f"{true}. {tenfold}.",
        lines=tuple(f"{words} (NEES {_nees(x)})." for words, x in said.items()),
    )


def _help(halves: Mapping[str, float]) -> Reply:
    gains = [
        f"{_source(name)}: {rounded(100.0 * (1.0 - x))} % less error"
        if x < NO_GAIN
        else f"{_source(name)}: less than 1 %"
        for name, x in sorted(halves.items(), key=lambda each: each[1])
    ]
    name, _, gain = gains[0].partition(": ")
    what = f"{name} error" if name.endswith("calibration") else name
    helps = gain.endswith("error")
    how = "A better part, or several averaged."
    if name.endswith("calibration"):
        how = "Four times the poses halve it, or half their noise (simval plan)."
    return Reply(
        title="What would help most?",
        headline=f"Half the {what}: {gain}, with settings found anew."
        if helps
        else "Nothing much: half of any one source lowers the error by less than 1 %.",
        do=how if helps and "disturbance" not in name else "",
        lines=tuple(gains[helps:]),
    )
