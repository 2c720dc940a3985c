"""Numbers for people: digits that mean something."""

import re
from collections.abc import Iterable

from simval.statistics import ORDER_2, ORDER_4, ORDER_4_SOURCE, Statistic

FORMULAS = {
    ORDER_2: "second order",
    ORDER_4_SOURCE: "fourth order as published",
    ORDER_4: "fourth order, complete",
}
"""Formulas as a figure calls them; tables have their names."""
DIGITS = 16  # of a double, after its first
FEWEST = -300  # exponent of ten below which a double has fewer


def number(value: float | None, digits: int = 6) -> str:
    """Spell a number for a person."""
    return "–" if value is None else f"{value:.{digits}g}"  # noqa: RUF001


def measured(value: float, error: float) -> str:
    """Spell a value and its standard error with digits that mean something."""
    if not error > 0.0 or not abs(value) < float("inf") or error == float("inf"):
        return number(value)
    exponent = int(f"{max(abs(value), error):e}".partition("e")[2])
    if exponent < FEWEST:
        return f"{value:.3g} ± {error:.2g}"
    places = max(0, exponent - int(f"{error:e}".partition("e")[2]) + 1)
    places = min(places, DIGITS)
    scale = 10.0**exponent
    if -3 <= exponent <= 4:
        places = max(0, places - exponent)
        return f"{value:.{places}f} ± {error:.{places}f}"
    return f"({value / scale:.{places}f} ± {error / scale:.{places}f})e{exponent}"


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
