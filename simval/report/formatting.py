"""Text on the page: angles, names as people read them, ids."""

import re
from collections.abc import Iterable

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
    """Unit of an angle: degrees, or milliradians for a small one."""
    return DEGREE if value >= LEAST_DEGREES else MILLIRADIAN


def angle(value: float) -> str:
    """Spell an angle in degrees, or in milliradians if it is small."""
    unit = angle_unit(value)
    gap = "" if unit is DEGREE else " "
    return f"{rounded(value * unit.factor, 3)}{gap}{unit.name}"


def sign_of_entries(statistics: Iterable[Statistic]) -> str:
    """Note on the sign of S_zx, if it is among the statistics."""
    named = any("S_zx" in statistic.entries for statistic in statistics)
    return "; S_zx is minus the entry T[2][0]" if named else ""


def slug(text: str) -> str:
    """Make an id, a selector or a file name of some words."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def spelled(name: str) -> str:
    """Name of a study, a parameter or a statistic as people read it."""
    return name.replace("_", " ")


def begun(label: str) -> str:
    """Begin words with a capital, as a sentence does."""
    return label[:1].upper() + label[1:]
