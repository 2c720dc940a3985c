"""What the store keeps of a cell and of its rows: plain values, and their digest.

A worker makes them of what a study left, so that the driver only writes them down.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from typing import Any, NamedTuple

from simval.results import Row
from simval.statistics import Statistic
from simval.studies.study import Cell
from simval.sweep.endings import Ending

ROW_FIELDS = tuple(f.name for f in (*fields(Statistic), *fields(Row)[1:]))
"""Fields of a row's statistic, whose entries are a JSON list, and of the row."""
CELL_FIELDS = (
    "position",
    "cell",
    "study",
    "seed",
    "parameters",
    "status",
    "error",
    "seconds",
)
NAMED = ("ordinal", *ROW_FIELDS)
"""Fields of a stored row without its cell."""

Stored = tuple[Any, ...]
"""A cell or a row as it is stored: numbers, words and None, in the order of fields."""


class Done(NamedTuple):
    """A cell that has ended, as it is stored."""

    cell: Stored  # its entry
    rows: Sequence[Stored]  # with its place before each; none where it failed
    digest: str  # of both
    ending: Ending
    artifacts: Mapping[str, Any] = {}
    times: Mapping[str, float] = {}
    machine: str = ""  # that computed it; empty where none did


def cell_entry(
    position: int, cell: Cell, status: str, error: str, seconds: float
) -> Stored:
    """What is stored of a cell, in the order of `CELL_FIELDS`."""
    parameters = json.dumps(cell.parameters.named())
    head = (position, cell.name, cell.study, cell.seed, parameters)
    return (*head, status, error, float(seconds))


def row_entries(position: int, rows: Iterable[Row]) -> list[Stored]:
    """What is stored of the rows of a cell: its place, then in the order of `NAMED`."""
    return [
        (
            position,
            ordinal,
            *_named(
                row.statistic.family.name,
                row.statistic.entries,
                row.statistic.controlled,
                row.statistic.unit,
            ),
            _number(row.value),
            _number(row.standard_error),
            int(row.n),
            None if row.prediction is None else _number(row.prediction),
            row.predictor,
            _number(row.remainder),
            row.check,
        )
        for ordinal, row in enumerate(rows)
    ]


@lru_cache(maxsize=4096)
def _named(
    family: str, entries: tuple[str, ...], controlled: bool, unit: str
) -> Stored:
    """A statistic; the same objects for equal ones, which then travel once."""
    return family, json.dumps(entries, separators=(",", ":")), int(controlled), unit


def _number(value: float) -> float | None:
    number = float(value)
    return None if number != number else number  # as SQLite stores what is no number


def digest_of_entries(cell: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Digest of all that is stored of a cell."""
    return digest_of([list(cell), *map(list, rows)])


def digest_of(content: Any) -> str:
    """SHA-256 of numbers, words and lists of them, exact and by type."""
    return hashlib.sha256(repr(content).encode()).hexdigest()
