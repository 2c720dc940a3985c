"""The cells of a suite, each made when it is asked for.

A suite is a few lines of axes and may have millions of cells, so what is kept is the
axes: the memory does not depend on the number of cells. Every point of a grid is
checked once, where the suite is read; a cell is then a copy of a checked one with the
values of its own point, so that what a plug-in was made of is noted once.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any, overload

from simval.studies.study import Cell, StudyParameters, canonical

Checked = Callable[[Mapping[str, Any]], StudyParameters]
"""From the values of a point to its parameters; raises where they are refused."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The grid of one study: every combination of the values of its axes."""

    study: str
    axes: Mapping[str, Sequence[Any]]
    models: Mapping[Any, StudyParameters]  # checked ones, by the value of their plug-in
    plugin: str  # axis of the plug-ins; empty where there is none

    def __len__(self) -> int:
        return prod(map(len, self.axes.values()))

    def parameters(self, place: int) -> StudyParameters:
        """Parameters of a point; the last axis is the fastest."""
        values: dict[str, Any] = {}
        for key in reversed(tuple(self.axes)):
            place, at = divmod(place, len(self.axes[key]))
            values[key] = self.axes[key][at]
        model = self.models[values[self.plugin] if self.plugin else ""]
        return model.model_copy(update=values)


def table(study: str, axes: Mapping[str, Sequence[Any]], checked: Checked) -> Table:
    """Check every point of a grid, and keep the axes with the values as checked."""
    kept: dict[str, dict[int, Any]] = {key: {} for key in axes}
    models: dict[Any, StudyParameters] = {}
    plugin = ""
    for places in product(*(range(len(values)) for values in axes.values())):
        point = {key: axes[key][at] for key, at in zip(axes, places, strict=True)}
        own = checked(point)
        plugin = own.plugin
        models.setdefault(getattr(own, plugin) if plugin else "", own)
        for key, at in zip(axes, places, strict=True):
            if at not in kept[key]:
                kept[key][at] = getattr(own, key)
    values = {key: tuple(found.values()) for key, found in kept.items()}
    return Table(study, values, models, plugin)


class Grid(Sequence[Cell]):
    """The cells of some tables, all of them for each seed in turn."""

    def __init__(self, seeds: Sequence[int], tables: Iterable[Table]) -> None:
        self._seeds, self._tables = tuple(seeds), tuple(tables)
        self._each = sum(map(len, self._tables))

    def __len__(self) -> int:
        return len(self._seeds) * self._each

    @overload
    def __getitem__(self, place: int) -> Cell: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Cell]: ...
    def __getitem__(self, place: int | slice) -> Cell | Sequence[Cell]:
        if isinstance(place, slice):
            return Chosen(self, range(len(self))[place])
        turn, rest = divmod(range(len(self))[place], self._each)
        for each in self._tables:
            if rest < len(each):
                return Cell(each.study, each.parameters(rest), self._seeds[turn])
            rest -= len(each)
        raise IndexError(place)

    def __iter__(self) -> Iterator[Cell]:
        return (self[place] for place in range(len(self)))

    def repeated(self) -> tuple[Cell, Cell] | None:
        """The first cell that has the name of an earlier one, and that one."""
        found = [(self._each * b, self._each * a) for a, b in _twice(self._seeds)]
        start = 0
        for each in self._tables:
            stride = len(each)
            for key, values in each.axes.items():
                stride //= len(values)
                spelled = [_spelled(each, key, value) for value in values]
                for a, b in _twice(spelled):
                    found.append((start + stride * b, start + stride * a))
            start += len(each)
        if not found:
            return None
        later, earlier = min(found)
        return self[later], self[earlier]


class Chosen(Sequence[Cell]):
    """Some of the cells of a sequence, by their places."""

    def __init__(self, cells: Sequence[Cell], places: Sequence[int]) -> None:
        self._cells, self._places = cells, places

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, place: int) -> Cell: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Cell]: ...
    def __getitem__(self, place: int | slice) -> Cell | Sequence[Cell]:
        if isinstance(place, slice):
            return Chosen(self._cells, self._places[place])
        return self._cells[self._places[place]]


def _spelled(each: Table, key: str, value: Any) -> str:
    """A value as the name of its cell has it."""
    model = next(iter(each.models.values())).model_copy(update={key: value})
    return canonical(model.named()[key])


def _twice(values: Iterable[Any]) -> Iterator[tuple[int, int]]:
    """Places of the first value that was there before, and of that one."""
    first: dict[Any, int] = {}
    for place, value in enumerate(values):
        if first.setdefault(value, place) != place:
            yield first[value], place
            return
