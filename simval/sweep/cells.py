"""The cells of a store, read back and checked: what cannot be is never handed on.

Three questions, the one whose answer says most first: can each field be what it is,
do the name and the parameters of a cell agree, and is all of it what the sweep stored,
by its digest.
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from typing import Any

from pydantic import ValidationError

from simval.results import CellName, Row
from simval.statistics import Statistic
from simval.studies import STUDIES
from simval.studies.study import canonical
from simval.sweep import store
from simval.sweep.documents import DamagedError, read_json
from simval.sweep.plausible import name_of, row_of

REFUSED = "refused: "
"""What the error of a cell begins with whose plug-in was refused; of one that crashed
it begins with a traceback."""

STATUSES = ("pending", "done", "failed")
OTHER_VERSION = ("missing", "extra_forbidden")
"""Kinds of pydantic's errors that a study of another version explains as well."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellResult:
    """One cell of a run: what it was and what it left.

    Attributes
    ----------
    position : int
        Place in the suite.
    name : str
        Unique name in the run.
    study : str
        Name of the study.
    seed : int
        The run's seed.
    parameters : mapping
        The study's parameters.
    status : str
        ``done``, ``failed`` or ``pending``.
    error : str
        Why it failed.
    seconds : float
        CPU time, s.
    rows : tuple of Row
        Its statistics.
    """

    position: int = 0
    name: str
    study: str
    seed: int
    parameters: Mapping[str, Any]
    status: str
    error: str
    seconds: float
    rows: tuple[Row, ...]

    @property
    def refused(self) -> bool:
        """Whether it has no result because its plug-in was refused, not by a crash."""
        return self.status == "failed" and self.error.startswith(REFUSED)

    @property
    def ending(self) -> str:
        """Its status, ``refused`` and ``crashed`` told apart."""
        crashed = "refused" if self.refused else "crashed"
        return crashed if self.status == "failed" else self.status

    @property
    def reason(self) -> str:
        """Why it failed, in one line."""
        last = (self.error.strip().splitlines() or [""])[-1]
        return last.removeprefix(REFUSED) if self.refused else last

    @property
    def named(self) -> CellName:
        """The cell by its name."""
        return CellName(self.study, self.name)

    def row(self, statistic: Statistic, predictor: str = "") -> Row | None:
        """Find the row of a statistic."""
        key = (statistic, predictor)
        return next((row for row in self.rows if row.key == key), None)


def read_cells(database: sqlite3.Connection) -> Iterator[CellResult]:
    """Read the cells of a store one by one, each with its rows.

    Raises
    ------
    DamagedError
        With the cell and the field that cannot be, or the cell that is not what the
        sweep stored.
    """
    query = "SELECT cell FROM rows WHERE cell NOT IN (SELECT position FROM cells)"
    stray = database.execute(query).fetchone()
    if stray is not None:
        msg = f"there are rows of a cell {stray[0]!r:.60}, and no such cell"
        raise DamagedError(msg)
    for head in read_heads(database):
        yield read_cell(database, head.position)


def read_heads(database: sqlite3.Connection) -> Iterator[CellResult]:
    """Read the cells of a store without their rows.

    Raises
    ------
    DamagedError
        With the cell and the field that cannot be.
    """
    cells = database.execute("SELECT * FROM cells ORDER BY position")
    for number, cell in enumerate(cells):
        if cell["position"] != number:
            msg = f"the cells are not numbered from 0 without a gap: {number} is none"
            raise DamagedError(msg)
        with _named(cell):
            yield _result(cell, ())


def read_cell(database: sqlite3.Connection, position: int) -> CellResult:
    """Read one cell of a store with its rows.

    Raises
    ------
    DamagedError
        As `read_cells`.
    """
    query = "SELECT * FROM cells WHERE position = ?"
    cell = database.execute(query, (position,)).fetchone()
    query = f"SELECT {store.ROW_COLUMNS} FROM rows WHERE cell = ? ORDER BY ordinal"
    rows = database.execute(query, (position,)).fetchall()
    with _named(cell):
        found = _result(cell, rows)
        if cell["digest"] != store.digest_of_cell(cell, rows):
            msg = "its entry or its rows are not what the sweep stored (by SHA-256)"
            raise DamagedError(msg)
    return found


@contextmanager
def _named(cell: sqlite3.Row) -> Iterator[None]:
    """Say in which cell the damage is."""
    try:
        yield
    except DamagedError as error:
        msg = f"cell {cell['cell']!s:.300}: {error}"
        raise DamagedError(msg) from None


def _result(cell: sqlite3.Row, rows: Sequence[sqlite3.Row]) -> CellResult:
    for name, kind in (("cell", str), ("study", str), ("seed", int), ("error", str)):
        if not isinstance(cell[name], kind):
            msg = f"its `{name}` is {cell[name]!r:.60}"
            raise DamagedError(msg)
    seconds = cell["seconds"]
    if not (isinstance(seconds, int | float) and seconds >= 0 and isfinite(seconds)):
        msg = f"its `seconds` is {seconds!r:.60}; it must be 0 or more"
        raise DamagedError(msg)
    if cell["status"] not in STATUSES or (rows and cell["status"] != "done"):
        msg = f"its `status` is {cell['status']!r:.60}, with {len(rows)} rows"
        raise DamagedError(msg)
    return CellResult(
        position=cell["position"],
        name=cell["cell"],
        study=cell["study"],
        seed=cell["seed"],
        parameters=_parameters(cell),
        status=cell["status"],
        error=cell["error"],
        seconds=float(seconds),
        rows=tuple(_rows(rows)),
    )


def _rows(entries: Sequence[sqlite3.Row]) -> Iterator[Row]:
    for number, entry in enumerate(entries):
        if entry["ordinal"] != number:
            msg = f"its rows are not numbered from 0 without a gap: {number} is none"
            raise DamagedError(msg)
        try:
            yield row_of(entry)
        except DamagedError as error:
            msg = f"row {number}, {name_of(entry)}: {error}"
            raise DamagedError(msg) from None


def _parameters(cell: sqlite3.Row) -> dict[str, Any]:
    found = read_json("its entry `parameters`", cell["parameters"])
    if not isinstance(found, dict):
        msg = f"its `parameters` are {found!r:.60}, no object"
        raise DamagedError(msg)
    if cell["study"] in STUDIES:
        _require_possible(cell["study"], found)
    _require_named(cell, found)
    return found


def _require_named(cell: sqlite3.Row, parameters: Mapping[str, Any]) -> None:
    """The name says study, seed and parameters."""
    start, end = f"{cell['study']}(", f")@{cell['seed']}"
    if not (cell["cell"].startswith(start) and cell["cell"].endswith(end)):
        msg = f"it is stored as {cell['study']} with {cell['seed']}"
        raise DamagedError(msg)
    rest = "," + cell["cell"].removeprefix(start).removesuffix(end)
    for key, value in sorted(parameters.items()):
        words = f",{key}={canonical(value)}"
        if not rest.startswith(words):
            msg = f"its parameter `{key}` is {value!r:.60}; its name differs"
            raise DamagedError(msg)
        rest = rest.removeprefix(words)
    if rest.strip(","):
        msg = f"its parameters lack {rest[1:]!r:.60}, which its name has"
        raise DamagedError(msg)


def _require_possible(study: str, parameters: Mapping[str, Any]) -> None:
    """What the study would refuse today, but for keys that it had or lacked once."""
    try:
        STUDIES[study].parameters.model_validate(parameters)
    except ValidationError as error:
        for told in error.errors():
            if told["type"] not in OTHER_VERSION:
                key = ".".join(str(part) for part in told["loc"])
                msg = f"its parameter `{key}` is {told['input']!r:.60}: {told['msg']}"
                raise DamagedError(msg) from None
