"""Spell numbers for people, in one way for all faces.

A value has two digits of its standard deviation, and a limit two of its own. What is
only rounding is 0. A chance is ``p = 0.59``, and a small one ``p < 0.001``: its level
says more than its digits. JSON and CSV have every digit instead.
"""

from collections.abc import Iterable
from math import ceil, floor, inf, isfinite, log10
from typing import Final

from simval.text import number

LEAST_CHANCE: Final = 1e-3
"""A chance below this is said to be below this."""
DIGITS: Final = 16
"""Of a double, after its first."""
FEWEST: Final = -300
"""Exponent of ten below which a double has fewer."""
PLAIN: Final = range(-3, 5)
"""Exponents of ten of numbers that are written without one."""
ASCII: Final = str.maketrans({
    "±": "+-", "µ": "u", "√": "sqrt ", "°": " deg", "²": "^2", "³": "^3", "−": "-",
    "×": "x", "·": "*", "≤": "<=", "≥": ">=", "Δ": "d", "σ": "sigma", "✓": "+",
    "é": "e", "…": "...", "→": "->", "χ": "chi",
})  # fmt: skip
"""What a stream without these characters shows instead."""


def measured(value: float, sd: float, *, fixed: bool = False) -> str:
    """Spell ``value ± sd``, both rounded to two digits of the standard deviation.

    Long ones have a power of ten, but not where they are `fixed`: in a row of a table
    whose unit has one.
    """
    if not 0.0 < sd < inf or not isfinite(value):
        return number(value)
    # two digits first: of 0.0999 they are 0.10
    last = _exponent(sd, 1) - 1
    top = max(_exponent(value), last + 1) if value else last + 1
    if top < FEWEST:
        return f"{value:.3g} ± {sd:.2g}"
    if fixed or top in PLAIN:
        places = min(-last, DIGITS)
        kept = [f"{round(x, places) + 0.0:.{max(places, 0)}f}" for x in (value, sd)]
        return " ± ".join(kept)
    places, scale = min(top - last, DIGITS), 10.0**top
    sd = float(f"{sd:.1e}")  # of 205 they are 2.0, whatever it is divided by
    return f"({value / scale:.{places}f} ± {sd / scale:.{places}f})e{top}"


def _exponent(value: float, places: int = 6) -> int:
    return int(f"{value:.{places}e}".partition("e")[2])


def rounded(value: float, digits: int = 2) -> str:
    """Spell a number with so many significant digits."""
    short = float(f"{value:.{digits - 1}e}")
    return f"{short:.12g}" if 1e-4 <= abs(short) < 1e7 else f"{short:.{digits}g}"


def rounded_up(number: float) -> str:
    """Spell a factor with two digits, rounded up."""
    step = 10.0 ** (floor(log10(number)) - 1)
    return f"{ceil(number / step - 1e-9) * step:,.6g}"


def bounded(low: float, high: float, digits: int = 2) -> str:
    """Spell a quantity of which only a limit is known."""
    if isfinite(high):
        return f"< {rounded(high, digits)}"
    return f"> {rounded(low, digits)}" if low > 0.0 else "not bounded"


def chance(p: float) -> str:
    """Spell a chance as ``p = 0.59`` or ``p < 0.001``; empty if there is none."""
    if not isfinite(p):
        return ""
    small = p < LEAST_CHANCE
    return f"p < {LEAST_CHANCE:g}" if small else f"p = {p:.2g}"


def whole(count: int) -> str:
    """Spell a count in groups of three digits, as ``7 980``."""
    return f"{count:,}".replace(",", " ")


def counted(count: int, noun: str, plural: str = "") -> str:
    """Spell a count with its noun: ``1 cell``, ``2 cells``."""
    return f"{whole(count)} {noun if count == 1 else plural or f'{noun}s'}"


def standard_errors(size: str) -> str:
    """Spell a distance in standard errors: ``+1 standard error``."""
    return f"{size} standard error{'s' * (size.lstrip('+-') != '1')}"


def series(names: Iterable[str]) -> str:
    """Join names as in a sentence: ``a, b and c``."""
    *first, last = [*names] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def duration(seconds: float) -> str:
    """Spell a time: in s below a minute, then in min, h and days."""
    for unit, size, most in (("s", 1.0, 60.0), ("min", 60.0, 60.0),
                             ("h", 3600.0, 48.0)):  # fmt: skip
        if float(f"{seconds / size:.2g}") < most:
            return f"{rounded(seconds / size)} {unit}"
    return f"{rounded(seconds / 86400.0)} days"


def in_ascii(text: str) -> str:
    """Spell text in ASCII, for streams that have nothing else."""
    return text.translate(ASCII)
