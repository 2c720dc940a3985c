"""The tidy table: a line for each measured row, a column for each parameter."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any

from simval.results import COLUMNS, Row
from simval.studies.study import canonical
from simval.sweep.cells import CellResult

HEAD = {"cell": "string", "study": "string", "seed": "int64"}
"""Columns of a line before its parameters, with their types."""

_KINDS: dict[Any, str] = {float: "float64", float | None: "float64", int: "int64"}
_TYPES = {f.name: _KINDS.get(f.type, "string") for f in fields(Row)}
NUMBERS = {name: _TYPES.get(name, "string") for name in COLUMNS}
"""Columns of a row, with their types."""


def parameter_kinds(cells: Iterable[CellResult]) -> dict[str, str]:
    """Type of each parameter's column: text where studies differ in type."""
    values: dict[str, list[object]] = {}
    for cell in cells:
        for key, value in cell.parameters.items():
            values.setdefault(key, []).append(value)
    return {key: _kind(values[key]) for key in sorted(values)}


def lines(
    cells: Iterable[CellResult], kinds: Mapping[str, str]
) -> Iterator[dict[str, object]]:
    """Each row of the table, its parameters in the types of their columns."""
    for cell in cells:
        head = {"cell": cell.name, "study": cell.study, "seed": cell.seed}
        values = {
            key: _as(kind, cell.parameters.get(key)) for key, kind in kinds.items()
        }
        for row in cell.rows:
            yield head | values | row.tidy


def _kind(values: Iterable[object]) -> str:
    kinds = {type(v) for v in values if v is not None}
    if kinds == {bool}:
        return "bool_"
    if kinds == {int}:
        return "int64"
    return "float64" if kinds <= {int, float} else "string"


def _as(kind: str, value: object) -> object:
    """A parameter in the type of its column: text where studies differ in type."""
    if value is None or isinstance(value, str) or kind != "string":
        return value
    return canonical(value)
