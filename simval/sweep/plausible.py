"""What the fields of a stored row can be; anything else is damage.

A number that was not measured is kept as NULL and read as NaN (a prediction as None),
which no judgement passes; an infinite one is no pass either. All else must be of its
type and within what the field, or the statistic, can be.
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
"""Above it a number of samples is no longer exact as a float: none was ever drawn."""

STATISTIC: TypeAdapter[Statistic] = TypeAdapter(Statistic)

CHECKS = get_args(Check)

Problem = str | None


def _text(value: Any) -> Problem:
    return None if isinstance(value, str) else "must be a text"


def _family(value: Any) -> Problem:
    known = isinstance(value, str) and value in FAMILIES
    return None if known else "must be a family of statistics of this version"


def _flag(value: Any) -> Problem:
    return None if value in (0, 1) else "must be 0 or 1"


def _number(value: Any) -> Problem:
    known = value is None or isinstance(value, int | float)
    return None if known else "must be a number"


def _size(value: Any) -> Problem:
    return _number(value) or (None if value is None or value >= 0 else "must be >= 0")


def _count(value: Any) -> Problem:
    good = isinstance(value, int) and 0 <= value < MAX_SAMPLES
    return None if good else f"must be a whole number from 0 to {MAX_SAMPLES - 1}"


def _check(value: Any) -> Problem:
    return None if value in CHECKS else f"must be one of {', '.join(CHECKS)}"


_FIELDS: Mapping[str, Callable[[Any], Problem]] = MappingProxyType(
    {
        "family": _family,
        "entries": _text,
        "controlled": _flag,
        "unit": _text,
        "value": _number,
        "standard_error": _size,
        "n": _count,
        "prediction": _number,
        "predictor": _text,
        "remainder": _size,
        "check": _check,
    }
)


def row_of(entry: sqlite3.Row) -> Row:
    """Row of an entry of the store."""
    for name, problem_of in _FIELDS.items():
        problem = problem_of(entry[name])
        if problem:
            msg = f"`{name}` is {_shown(entry[name])}; it {problem}"
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
