"""The cells of a store, read back and checked; damaged ones are never passed on.

Three checks, the most informative one first: can each field have its value, do the name
and the parameters of a cell agree, and does the digest show what the sweep stored.
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
from simval.sweep.asked import Asked
from simval.sweep.documents import DamagedError, read_json
from simval.sweep.entries import Stored
from simval.sweep.plausible import rows_of

REFUSED = "refused: "
"""What the error of a cell begins with whose plug-in was refused; of one that crashed
it begins with a traceback."""

STATUSES = ("pending", "done", "failed")
OTHER_VERSION = ("missing", "extra_forbidden")
"""Kinds of pydantic's errors that another version of a study causes too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellResult:
    """One cell of a run: what it was and what it left."""

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
        """Row of a statistic; None if there is none."""
        key = (statistic, predictor)
        return next((row for row in self.rows if row.key == key), None)


def read_cells(database: sqlite3.Connection) -> Iterator[CellResult]:
    """Read the cells of a store one by one, each with its rows.

    Raises
    ------
    DamagedError
        With the cell, and its impossible field if there is one.
    """
    query = "SELECT cell FROM rows WHERE cell NOT IN (SELECT position FROM cells)"
    stray = database.execute(query).fetchone()
    if stray is not None:
        msg = f"there are rows of a cell {stray[0]!r:.60}, which does not exist"
        raise DamagedError(msg)
    for head in read_heads(database):
        yield read_cell(database, head.position)


def read_heads(database: sqlite3.Connection) -> Iterator[CellResult]:
    """Read the cells of a store without their rows."""
    asked = Asked(store.manifest(database))
    cells = database.execute("SELECT * FROM cells ORDER BY position")
    for number, cell in enumerate(cells):
        if cell["position"] != number:
            msg = (
                f"the cells are not numbered from 0 without a gap: {number} is missing"
            )
            raise DamagedError(msg)
        yield _head(cell, asked)


def _head(cell: sqlite3.Row, asked: Asked) -> CellResult:
    """A cell without its rows, the one that the suite asks for at its place."""
    with _named(cell):
        head = _result(cell, ())
        asked.require(head.position, head.study, head.seed, head.parameters)
    return head


def read_cell(database: sqlite3.Connection, position: int) -> CellResult:
    """Read one cell of a store with its rows."""
    cell, rows = store.stored_cell(database, position)
    with _named(cell):
        result = _result(cell, rows)
        if cell["digest"] != store.digest_of_cell(cell, rows):
            msg = "its entry or its rows are not what the sweep stored (by SHA-256)"
            raise DamagedError(msg)
    return result


@contextmanager
def _named(cell: sqlite3.Row) -> Iterator[None]:
    """Add the name of the cell to the message."""
    try:
        yield
    except DamagedError as error:
        msg = f"cell {cell['cell']!s:.300}: {error}"
        raise DamagedError(msg) from None


def _result(cell: sqlite3.Row, rows: Sequence[Stored]) -> CellResult:
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
        rows=tuple(rows_of(rows)),
    )


def _parameters(cell: sqlite3.Row) -> dict[str, Any]:
    parameters = read_json("its entry `parameters`", cell["parameters"])
    if not isinstance(parameters, dict):
        msg = f"its `parameters` are {parameters!r:.60}, not an object"
        raise DamagedError(msg)
    if cell["study"] in STUDIES:
        _require_possible(cell["study"], parameters)
    _require_named(cell, parameters)
    return parameters


def _require_named(cell: sqlite3.Row, parameters: Mapping[str, Any]) -> None:
    """Check that the name agrees with study, seed and parameters."""
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
    """Refuse what the study refuses, except for keys that other versions had."""
    try:
        STUDIES[study].parameters.model_validate(parameters)
    except ValidationError as error:
        for fault in error.errors():
            if fault["type"] not in OTHER_VERSION:
                key = ".".join(str(part) for part in fault["loc"])
                msg = f"its parameter `{key}` is {fault['input']!r:.60}: {fault['msg']}"
                raise DamagedError(msg) from None
