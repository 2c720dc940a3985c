"""Whole numbers as people write them, 100000 or 1e5, and nothing that is rounded."""

from decimal import Decimal, InvalidOperation
from numbers import Integral, Real
from typing import Any, Final

EXACT: Final = 2**53
"""Up to here each whole number is a float of its own."""

DIGITS: Final = 30
"""Most digits of a whole number in text: more is a slip, and slow to read."""


def exact(value: Any) -> Any:
    """Make an integer of a real number that is one exactly; leave the rest."""
    real = isinstance(value, Real) and not isinstance(value, Integral)
    if real and abs(value) <= EXACT and value == int(value):
        return int(value)
    return value


def read(text: str) -> int | None:
    """Read a whole number; None if the text is none."""
    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        return None
    if not number.is_finite() or number.adjusted() >= DIGITS:
        return None
    return int(number) if number == number.to_integral_value() else None
