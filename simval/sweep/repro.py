"""Compute one cell again by its name, and compare it with the run bit by bit."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from simval.errors import InputError
from simval.plugins.names import COMMAND, file_of, located, portable
from simval.results import Outcome, Row
from simval.studies import find_study
from simval.studies.plugin import PluginParameters
from simval.studies.study import Cell
from simval.sweep.executors import attempt
from simval.sweep.run import CellResult, Run
from simval.sweep.suite import load_suite, validated
from simval.text import nearest
from simval.vocabulary import builtin_suites


@dataclass(frozen=True, slots=True, kw_only=True)
class Repetition:
    """A cell that was computed again."""

    outcome: Outcome  # what it gave now; no rows where it crashed
    error: str  # why it crashed; empty where it did not
    # what the run holds; None where it has no finished cell of that name
    stored: CellResult | None
    # rows that are not equal to the bit: the stored one and the one of now
    different: tuple[tuple[Row, Row | None], ...]

    @property
    def equal(self) -> bool:
        """True if its rows equal the stored ones to the bit."""
        if self.stored is None or self.different:
            return False
        return len(self.stored.rows) == len(self.outcome.rows)


def find_cell(
    name: str, run: Run | None, plugins: Sequence[str] = (), suite: str | None = None
) -> Cell:
    """Find a cell by its name in a run, or else in a suite.

    Raises
    ------
    InputError
        If neither has a cell of that name, a plug-in is not where it was, or the cell
        has no plug-in of a given name.
    """
    held = _held(run, name)
    if held is None:
        cell = _of_suite(name, run, suite)
        study, seed, values = cell.study, cell.seed, cell.parameters.named()
    else:
        study, seed, values = held.study, held.seed, dict(held.parameters)
    model = find_study(study).parameters
    text = str(values.get(model.plugin, ""))
    if run is not None and held is not None and text:
        places = run.places.get(f"{study}.{model.plugin}", {})
        values[model.plugin] = places.get(text, text)
    for plugin in map(located, plugins):
        meant = _completed(plugin, text) if text else ""
        if not meant:
            msg = f"cell {name} has no plug-in `{portable(plugin)}`; leave it out"
            raise InputError(msg)
        values[model.plugin] = meant
    cell = Cell(study, validated(f"cell {name}", model, values), seed)
    _require_plugin(cell, run)
    return cell


def _held(run: Run | None, name: str) -> CellResult | None:
    """The cell of a run with this name, and its rows."""
    heads = enumerate(run.cells) if run is not None else ()
    place = next((place for place, cell in heads if cell.name == name), None)
    return None if run is None or place is None else run.cells[place]


def _of_suite(name: str, run: Run | None, suite: str | None) -> Cell:
    suites = builtin_suites() if suite is None else (suite,)
    cells = {cell.name: cell for each in suites for cell in load_suite(each).cells}
    if name not in cells:
        places = [f"suite {suite}" if suite else "a built-in suite"]
        if run is not None:
            places.append(f"the run {run.folder}")
        known = [c.name for c in run.cells] if run is not None else []
        near = nearest(name, dict.fromkeys([*known, *cells]), 3)
        msg = (
            f"there is no cell `{name}` in {' or '.join(places)}; "
            + (f"the nearest are {', '.join(near)}; " if near else "")
            + "give the name as a table has it, and its run with --run or its suite "
            "with --suite"
        )
        raise InputError(msg)
    return cells[name]


def _completed(given: str, text: str) -> str:
    """The value that a cell means by `text`, if it is this file; else empty."""
    name = "" if text.startswith(COMMAND) else text.removeprefix(file_of(text))
    return next((v for v in (given, given + name) if portable(v) == text), "")


def _require_plugin(cell: Cell, run: Run | None) -> None:
    held = run.manifest["files"] if run is not None else {}
    own = cell.parameters
    if isinstance(own, PluginParameters) and (gone := own.missing(held)):
        msg = (
            f"cell {cell.name}: {gone}; if its plug-in is somewhere else now, "
            "give it with --plugin"
        )
        raise InputError(msg)


def repeat(cell: Cell, run: Run | None) -> Repetition:
    """Compute a cell again, and compare it with what a run holds."""
    _, done, _ = attempt(0, cell)
    error, outcome = (done, Outcome(rows=())) if isinstance(done, str) else ("", done)
    held = _held(run, cell.name)
    stored = held if held is not None and held.status == "done" else None
    now = {row.key: row for row in outcome.rows}
    different = tuple(
        (row, now.get(row.key))
        for row in (stored.rows if stored is not None else ())
        if not _same(row, now.get(row.key))
    )
    return Repetition(outcome=outcome, error=error, stored=stored, different=different)


def _same(old: Row, new: Row | None) -> bool:
    return new is not None and all(
        _exact(getattr(old, f.name)) == _exact(getattr(new, f.name))
        for f in fields(Row)
    )


def _exact(value: Any) -> str:
    # repr tells every two different floats apart, and NaN is the same as NaN; a study
    # may leave NumPy's numbers, of which the store makes plain ones
    return repr(value.item() if isinstance(value, np.generic) else value)
