"""Cells of a run: how they end, and how they are stored and read back.

A worker makes plain values of what a study left, with their digest, so that the driver
only writes them down. Numbers are stored as they are, and NaN as NULL.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple, get_args

from simval.errors import InputError
from simval.results import CellName, Check, Row
from simval.statistics import FAMILIES, Statistic
from simval.studies.study import Cell

REFUSED = "refused: "
"""Beginning of a cell's error if it was refused; that of a crash begins with a
traceback."""

MAX_SAMPLES = 2**53
"""From here on a number of samples is not exact as a float."""

Stored = tuple[Any, ...]
"""A cell or a row as it is stored: numbers, words and None, in the order of fields."""


CELL_FIELDS = (
    *("position", "cell", "study", "seed", "parameters"),
    *("status", "error", "seconds", "times"),
)
ROW_FIELDS = tuple(f.name for f in (*fields(Statistic), *fields(Row)[1:]))
"""Fields of a row's statistic, whose entries are a JSON list, and of the row."""


class DamagedError(InputError):
    """A part of a run folder that no sweep has written so."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellResult:
    """A cell of a run, with its parameters and results."""

    position: int = 0
    name: str  # unique name in the run
    study: str
    seed: int
    parameters: Mapping[str, Any]
    status: str  # ``done``, ``failed`` or ``pending``
    error: str  # why it failed
    seconds: float  # CPU time, s
    rows: tuple[Row, ...]
    run: str = ""  # how a command names the run that it was read from; empty: not said

    @property
    def refused(self) -> bool:
        """True if it was refused with a reason, and so has no result."""
        return self.status == "failed" and self.error.startswith(REFUSED)

    @property
    def ending(self) -> str:
        """How it ended: its status, with ``refused`` apart from ``crashed``."""
        crashed = "refused" if self.refused else "crashed"
        return crashed if self.status == "failed" else self.status

    @property
    def reason(self) -> str:
        """Why it failed, in one line."""
        last = (self.error.strip().splitlines() or [""])[-1]
        return last.removeprefix(REFUSED) if self.refused else last

    @property
    def named(self) -> CellName:
        """The cell's name, with its study."""
        return CellName(self.study, self.name)

    def row(self, statistic: Statistic, predictor: str = "") -> Row | None:
        """The row of a statistic; None if there is none."""
        key = (statistic, predictor)
        return next((row for row in self.rows if row.key == key), None)


class Done(NamedTuple):
    """A finished cell as it is stored."""

    cell: Stored  # its entry
    rows: Sequence[Stored]  # each with its cell and its place; none where it failed
    digest: str  # of both
    artifacts: Mapping[str, Any] = {}
    machine: str = ""  # that computed it; empty where none did

    @property
    def failed(self) -> bool:
        """True if it crashed or was refused."""
        return bool(self.cell[CELL_FIELDS.index("status")] == "failed")


def cell_entry(
    position: int,
    cell: Cell,
    status: str,
    error: str = "",
    seconds: float = 0.0,
    times: Mapping[str, float] | None = None,
) -> Stored:
    """Stored entry of a cell, in the order of `CELL_FIELDS`."""
    parameters = json.dumps(cell.parameters.named())
    head = (position, cell.name, cell.study, cell.seed, parameters)
    timed = json.dumps(dict(times)) if times else ""
    return (*head, status, error, float(seconds), timed)


def row_entries(position: int, rows: Iterable[Row]) -> list[Stored]:
    """Stored entries of a cell's rows."""
    return [_row_entry(position, ordinal, row) for ordinal, row in enumerate(rows)]


def _row_entry(position: int, ordinal: int, row: Row) -> Stored:
    wrong = _impossible(row)
    if wrong:
        given = row.statistic.family.name if wrong == "family" else getattr(row, wrong)
        msg = (
            f"row {ordinal}, {row.statistic}: `{wrong}` is {given!r:.60}, which such a "
            "statistic cannot have"
        )
        raise DamagedError(msg)
    statistic = row.statistic
    return (
        position,
        ordinal,
        *_named(
            statistic.family.name,
            statistic.entries,
            statistic.controlled,
            statistic.unit,
        ),
        _number(row.value),
        _number(row.standard_error),
        int(row.n),
        None if row.prediction is None else _number(row.prediction),
        row.predictor,
        _number(row.remainder),
        row.check,
        row.outside,
    )


def _impossible(row: Row) -> str:
    """Name of a field with an impossible value; empty if all are possible.

    What was not measured is NaN, which never passes.
    """
    family = row.statistic.family
    possible = {
        "family": family.name in FAMILIES,
        "value": row.value != row.value or family.least <= row.value <= family.most,
        "standard_error": not row.standard_error < 0.0,
        "n": 0 <= row.n < MAX_SAMPLES,
        "prediction": row.prediction is None
        or row.prediction != row.prediction
        or family.least <= row.prediction <= family.most,
        "predictor": row.predictor.isprintable(),
        "outside": row.outside.isprintable(),
        "remainder": not row.remainder < 0.0,
        "check": row.check in get_args(Check),
    }
    return next((name for name, is_so in possible.items() if not is_so), "")


@lru_cache(maxsize=4096)
def _named(
    family: str, entries: tuple[str, ...], controlled: bool, unit: str
) -> Stored:
    """Make a statistic; equal ones are the same object, so that they travel once."""
    return family, json.dumps(entries, separators=(",", ":")), int(controlled), unit


def _number(value: float) -> float | None:
    number = float(value)
    return None if number != number else number  # as SQLite stores what is no number


def digest_of_entries(cell: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """Digest of everything that is stored of a cell."""
    return digest_of([list(cell), *(list(row[1:]) for row in rows)])


def digest_of(content: Any) -> str:
    """SHA-256 of nested lists of numbers and words, exact and typed."""
    return hashlib.sha256(repr(content).encode()).hexdigest()


def cell_result(cell: Sequence[Any], rows: Iterable[Stored]) -> CellResult:
    """Rebuild a cell from its stored entry and rows."""
    position, name, study, seed, parameters, status, error, seconds, _ = cell
    return CellResult(
        position=position,
        name=name,
        study=study,
        seed=seed,
        parameters=json.loads(parameters),
        status=status,
        error=error,
        seconds=seconds,
        rows=tuple(map(_row, rows)),
    )


def _row(entry: Stored) -> Row:
    family, entries, controlled, unit, value, error, n, *theory = entry[2:]
    prediction, predictor, remainder, check, outside = theory
    return Row(
        statistic=_statistic(family, entries, controlled, unit),
        value=math.nan if value is None else value,
        standard_error=math.nan if error is None else error,
        n=n,
        prediction=prediction,
        predictor=_same(predictor),
        remainder=math.nan if remainder is None else remainder,
        check=_same(check),
        outside=_same(outside),
    )


@lru_cache(maxsize=4096)
def _same(words: Any) -> Any:
    """One object for equal words, which saves most memory."""
    return words


@lru_cache(maxsize=4096)
def _statistic(family: str, entries: str, controlled: int, unit: str) -> Statistic:
    if family not in FAMILIES:
        msg = (
            f"this version of simval has no statistic `{family:.60}`; read the "
            "run with the version that wrote it, or run the sweep again"
        )
        raise DamagedError(msg)
    words = tuple(json.loads(entries))
    return Statistic(
        family=FAMILIES[family], entries=words, controlled=bool(controlled), unit=unit
    )
