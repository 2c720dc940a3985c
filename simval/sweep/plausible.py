"""The possible values of the fields of a row; no other is stored, or read.

A number that was not measured is stored as NULL and read as NaN (a prediction as None),
which never passes; an infinite one does not pass either. All else must have its type
and lie within the range of its field or statistic.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, get_args

from simval.results import Check, Row
from simval.statistics import FAMILIES, Statistic
from simval.sweep.documents import DamagedError
from simval.sweep.entries import NAMED, Stored

MAX_SAMPLES = 2**53
"""From here on a number of samples is not exact as a float."""

LONGEST = 10_000
"""Characters of a text in a row; those of the studies have 40."""

CHECKS = get_args(Check)


def _is_size(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and value >= 0)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST


NUMBER = (lambda x: x is None or isinstance(x, int | float), "must be a number")
SIZE = (_is_size, "must be a number >= 0")
TEXT = (_is_text, f"must be a text of at most {LONGEST} characters")

_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = MappingProxyType(
    {
        "family": (
            lambda x: isinstance(x, str) and x in FAMILIES,
            "must be a family of statistics of this version; read it with the version "
            "of simval that wrote it, or sweep anew",
        ),
        "entries": TEXT,
        "controlled": (lambda x: x in (0, 1), "must be 0 or 1"),
        "unit": (
            lambda x: _is_text(x) and x.isprintable(),
            f"must be a printable text of at most {LONGEST} characters",
        ),
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


_REAL = (float, type(None))


def rows_of(entries: Iterable[Stored]) -> Iterator[Row]:
    """Rows of the entries of a cell; of an impossible one say which it is."""
    for number, entry in enumerate(entries):
        if entry[0] != number:
            msg = f"its rows are not numbered from 0 without a gap: {number} is missing"
            raise DamagedError(msg)
        try:
            yield row_of(entry)
        except DamagedError as error:
            msg = f"row {number}, {name_of(entry)}: {error}"
            raise DamagedError(msg) from None


def row_of(entry: Stored) -> Row:
    """Row of an entry of the store, in the order of `NAMED`."""
    _, family, entries, controlled, unit, *rest = entry
    value, error, n, prediction, predictor, remainder, check = rest
    if not (
        type(value) in _REAL
        and type(error) in _REAL
        and type(prediction) in _REAL
        and type(remainder) in _REAL
        and type(n) is int
        and 0 <= n < MAX_SAMPLES
        and type(predictor) is str
        and len(predictor) <= LONGEST
        and check in CHECKS
        and (error is None or error >= 0.0)
        and (remainder is None or remainder >= 0.0)
    ):
        _require_possible(entry)
    statistic = statistic_of(family, entries, controlled, unit)
    low, high = statistic.family.least, statistic.family.most
    if not (
        (value is None or low <= value <= high)
        and (prediction is None or low <= prediction <= high)
    ):
        _require_within(statistic, value, prediction)
    return Row(
        statistic=statistic,
        value=_measured(value),
        standard_error=_measured(error),
        n=n,
        prediction=None if prediction is None else float(prediction),
        predictor=predictor,
        remainder=_measured(remainder),
        check=check,
    )


def _require_possible(entry: Stored) -> None:
    """Name the field that cannot be what it is, if there is one."""
    fields = dict(zip(NAMED, entry, strict=True))
    for name, (is_possible, words) in _FIELDS.items():
        if not is_possible(fields[name]):
            msg = f"`{name}` is {_shown(fields[name])}; it {words}"
            raise DamagedError(msg)


def _require_within(
    statistic: Statistic, value: float | None, prediction: float | None
) -> None:
    low, high = statistic.family.least, statistic.family.most
    for name, number in (("value", value), ("prediction", prediction)):
        if number is not None and not low <= number <= high:
            msg = f"`{name}` is {number!r}; such a statistic is {_spelled(low, high)}"
            raise DamagedError(msg)


def name_of(entry: Stored) -> str:
    """Name of the statistic of an entry, as far as it can be read."""
    try:
        return str(statistic_of(*entry[1:5]))
    except (DamagedError, ValueError, TypeError):
        return f"{entry[1]!s:.60}"


@lru_cache(maxsize=4096, typed=True)
def statistic_of(family: Any, entries: Any, controlled: Any, unit: Any) -> Statistic:
    """Statistic of the entries of a row; the families and units are few."""
    for name, given in (
        ("family", family),
        ("entries", entries),
        ("controlled", controlled),
        ("unit", unit),
    ):
        is_possible, words = _FIELDS[name]
        if not is_possible(given):
            msg = f"`{name}` is {_shown(given)}; it {words}"
            raise DamagedError(msg)
    return Statistic(
        family=FAMILIES[family],
        entries=_words(entries),
        controlled=bool(controlled),
        unit=unit,
    )


def _words(entries: str) -> tuple[str, ...]:
    # of the JSON list that `sweep.entries` writes, and of nothing like it
    try:
        words = json.loads(entries)
    except (ValueError, RecursionError):
        words = None
    if not isinstance(words, list) or not all(
        isinstance(word, str) and word.isprintable() for word in words
    ):
        msg = f"`entries` is {_shown(entries)}; it must be a JSON list of words"
        raise DamagedError(msg)
    return tuple(words)


def _measured(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _shown(value: Any) -> str:
    return "missing" if value is None else f"{value!r:.60}"


def _spelled(low: float, high: float) -> str:
    return f"{low:g} or more" if high == math.inf else f"from {low:g} to {high:g}"
