"""Tables of parsed numbers, as most readers return them."""

from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.shapes import Bool, Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayTable(ReadOnly):
    """A table whose columns are numbers already."""

    path: str  # file they came from
    names: tuple[str, ...] | None  # name of each column
    values: Float[Array, "n columns"]  # (n, columns)
    source: tuple[tuple[str, str], ...] = ()  # label and words: what was taken
    restarts: tuple[int, ...] = ()  # none: its rows are of one recording
    rate: tuple[str, float] | None = None  # name and Hz, where the file states it
    refused: str = ""  # nothing: its names are those of its columns
    empty: frozenset[int] = frozenset()  # none: it has no columns without readings

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.values)

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places, NaN for a missing one."""
        return self.values[:, places]

    def texts(self, place: int) -> list[str]:
        """Return one column as text."""
        return [str(value) for value in self.values[:, place]]

    def distinct(self, place: int) -> "ArrayTable":
        """Return the table itself, as no row was recorded twice."""
        return self

    def rows(self, taken: Bool[np.ndarray, " n"]) -> "ArrayTable":
        """Select some of the rows."""
        return self if np.all(taken) else replace(self, values=self.values[taken])

    def where(self, row: int) -> str:
        """Say where a row is in the file."""
        return f"{self.path}, row {row + 1}"

    def is_text(self, place: int) -> bool:
        """Return False: no column is text."""
        return False
