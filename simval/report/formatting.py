"""Text of the page: numbers with significant digits, parameters with units."""

import re
from collections.abc import Iterable
from typing import NamedTuple

from simval.spelling import rounded
from simval.statistics import ORDER_2, ORDER_4, ORDER_4_SOURCE, Statistic
from simval.units import DEGREE, MILLIRADIAN, Unit

# ---- numbers

FORMULAS = {
    ORDER_2: "second order",
    ORDER_4_SOURCE: "fourth order as published",
    ORDER_4: "fourth order, complete",
}
"""Formulas as a figure calls them; tables have their names."""
LEAST_DEGREES = 2e-3
"""Angles below this, rad, are told in milliradians: a tenth of a degree."""


def angle_unit(value: float) -> Unit:
    """Unit of an angle: the degree, of a small one the milliradian."""
    return DEGREE if value >= LEAST_DEGREES else MILLIRADIAN


def angle(value: float) -> str:
    """An angle in degrees, a small one in milliradians."""
    unit = angle_unit(value)
    gap = "" if unit is DEGREE else " "
    return f"{rounded(value * unit.factor, 3)}{gap}{unit.name}"


def sign_of_entries(statistics: Iterable[Statistic]) -> str:
    """Note on the sign of the parameter S_zx, if it is among the statistics."""
    named = any("S_zx" in statistic.entries for statistic in statistics)
    return "; S_zx is minus the entry T[2][0]" if named else ""


def slug(text: str) -> str:
    """Spell words as an id, a selector and a file name."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def spelled(name: str) -> str:
    """Spell the name of a study, a parameter or a statistic for a person."""
    return name.replace("_", " ")


def begun(label: str) -> str:
    """Words as a sentence begins."""
    return label[:1].upper() + label[1:]


# ---- parameters


class Parameter(NamedTuple):
    """Words of a parameter."""

    name: str
    unit: str = ""
    counted: bool = False  # "12 poses" rather than "poses 12"


ACCELEROMETER = (
    "calibration", "calibrator", "coverage", "detector", "ladder", "solvers",
    "thermal",
)  # fmt: skip
"""Studies whose noise is that of an accelerometer, not of a unit vector."""

PARAMETERS = {
    "accelerometer_noise": Parameter("accelerometer noise", "of gravity"),
    "accelerometer_noise_std": Parameter("accelerometer noise", "m/s²"),
    "angle_random_walk": Parameter("angle random walk", "°/√s"),
    "attitudes": Parameter("attitudes", counted=True),
    "average": Parameter("samples in a mean"),
    "dip_deg": Parameter("dip", "°"),
    "every": Parameter("rows averaged"),
    "field_noise": Parameter("field noise", "of the field"),
    "flicker": Parameter("flicker / white noise", "√Hz"),
    "geometry": Parameter("random geometry no."),
    "geometries": Parameter("geometries", counted=True),
    "hold_time": Parameter("hold", "s"),
    "magnetometer_noise_std": Parameter("magnetometer noise", "T"),
    "move_time": Parameter("moves of", "s"),
    "multiplier": Parameter("threshold / variance at rest"),
    "noise_std": Parameter("noise"),
    "norm": Parameter("|q̄|"),
    "poses": Parameter("poses", counted=True),
    "rate": Parameter("rate", "Hz"),
    "ratio": Parameter("noise of the others / the first's"),
    "rows": Parameter("rows", counted=True),
    "seconds": Parameter("length", "s"),
    "shift": Parameter("wrong vector off by", "standard deviations"),
    "temperature_span": Parameter("span of temperature", "K"),
    "trim": Parameter("trim", "samples"),
    "vectors": Parameter("vectors", counted=True),
    "walk": Parameter("random walk / white noise", "Hz"),
    "window": Parameter("window", "samples"),
}


def named(study: str, key: str) -> Parameter:
    """Name and unit of a parameter; of one that is not known its own name."""
    found = PARAMETERS.get(key, Parameter(key.replace("_", " ")))
    if key == "noise_std" and study in ACCELEROMETER:
        return found._replace(unit="m/s²")
    return found


def axis_words(study: str, key: str) -> str:
    """Label of an axis along which a parameter varies."""
    name, unit, counted = named(study, key)
    words = f"number of {name}" if counted else name
    return f"{words}, {unit}" if unit else words


def setting_words(study: str, key: str, value: object) -> str:
    """Spell a parameter with its value."""
    name, unit, counted = named(study, key)
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if value is None or isinstance(value, str):
        # a letter alone says nothing
        whole = f"{name} {value}" if value and len(value) == 1 else value
        return whole or f"no {name}"
    number = f"{value:g}" if isinstance(value, float) else f"{value}"
    if counted:
        return f"{number} {name}"
    space = "" if unit == "°" else " "
    return f"{name} {number}{space}{unit}".rstrip()
