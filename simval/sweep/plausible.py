"""The possible values of the fields of a stored row; anything else is damage.

A number that was not measured is stored as NULL and read as NaN (a prediction as None),
which never passes; an infinite one does not pass either. All else must have its type
and lie within the range of its field or statistic.
"""

import json
import math
import sqlite3
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, get_args

from pydantic import TypeAdapter

from simval.results import Check, Row
from simval.statistics import FAMILIES, Statistic
from simval.sweep.documents import DamagedError

MAX_SAMPLES = 2**53
"""From here on a number of samples is not exact as a float."""

STATISTIC: TypeAdapter[Statistic] = TypeAdapter(Statistic)

CHECKS = get_args(Check)


def _is_size(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and value >= 0)


NUMBER = (lambda x: x is None or isinstance(x, int | float), "must be a number")
SIZE = (_is_size, "must be a number >= 0")
TEXT = (lambda x: isinstance(x, str), "must be a text")

_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = MappingProxyType(
    {
        "family": (
            lambda x: isinstance(x, str) and x in FAMILIES,
            "must be a family of statistics of this version",
        ),
        "entries": TEXT,
        "controlled": (lambda x: x in (0, 1), "must be 0 or 1"),
        "unit": TEXT,
        "value": NUMBER,
        "standard_error": SIZE,
        "n": (
            lambda x: isinstance(x, int) and 0 <= x < MAX_SAMPLES,
            f"must be a whole number from 0 to {MAX_SAMPLES - 1}",
        ),
        "prediction": NUMBER,
        "predictor": TEXT,
        "remainder": SIZE,
        "check": (lambda x: x in CHECKS, f"must be one of {', '.join(CHECKS)}"),
    }
)
"""Which values a field may have, by a test and in words."""


def row_of(entry: sqlite3.Row) -> Row:
    """Row of an entry of the store."""
    for name, (is_possible, words) in _FIELDS.items():
        if not is_possible(entry[name]):
            msg = f"`{name}` is {_shown(entry[name])}; it {words}"
            raise DamagedError(msg)
    statistic = _statistic(entry)
    low, high = statistic.family.least, statistic.family.most
    for name in ("value", "prediction"):
        number = entry[name]
        if number is not None and not low <= number <= high:
            msg = f"`{name}` is {number!r}; such a statistic is {_spelled(low, high)}"
            raise DamagedError(msg)
    return Row(
        statistic=statistic,
        value=_measured(entry["value"]),
        standard_error=_measured(entry["standard_error"]),
        n=entry["n"],
        prediction=None if entry["prediction"] is None else float(entry["prediction"]),
        predictor=entry["predictor"],
        remainder=_measured(entry["remainder"]),
        check=entry["check"],
    )


def name_of(entry: sqlite3.Row) -> str:
    """Name of the statistic of an entry, as far as it can be read."""
    try:
        return str(_statistic(entry))
    except (DamagedError, ValueError):
        return f"{entry['family']!s:.60}"


def _statistic(entry: sqlite3.Row) -> Statistic:
    try:
        return STATISTIC.validate_python(
            {
                "family": entry["family"],
                "entries": tuple(json.loads(entry["entries"])),
                "controlled": bool(entry["controlled"]),
                "unit": entry["unit"],
            }
        )
    except (ValueError, TypeError, RecursionError):
        msg = (
            f"`entries` is {_shown(entry['entries'])}; it must be a JSON list of words"
        )
        raise DamagedError(msg) from None


def _measured(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _shown(value: Any) -> str:
    return "missing" if value is None else f"{value!r:.60}"


def _spelled(low: float, high: float) -> str:
    return f"{low:g} or more" if high == math.inf else f"from {low:g} to {high:g}"
