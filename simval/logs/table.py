"""A log as a table: the names of its columns, and their numbers."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float

from simval.arrays import Array, frozen
from simval.errors import InputError


@runtime_checkable
class Table(Protocol):
    """What a log is read from: columns of one length, some of them with names."""

    @property
    def path(self) -> str:
        """File it came from."""

    @property
    def names(self) -> tuple[str, ...] | None:
        """Name of each column as the file has it; None where it has none."""

    @property
    def width(self) -> int:
        """Number of columns."""

    def __len__(self) -> int:
        """Return the number of rows."""

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places."""

    def texts(self, place: int) -> list[str]:
        """Return one column as it is written."""

    def where(self, row: int) -> str:
        """Say where a row stands in the file."""

    def is_text(self, place: int) -> bool:
        """Return whether the first row has no number there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayTable:
    """Columns that are numbers already.

    Attributes
    ----------
    path : str
        File they came from.
    names : tuple of str or None
        Name of each column.
    values : Array
        (n, columns).
    """

    path: str
    names: tuple[str, ...] | None
    values: Float[Array, "n columns"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.values)

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places."""
        return self.values[:, places]

    def texts(self, place: int) -> list[str]:
        """No column of numbers is text."""
        msg = f"{self.path}, column {place + 1}: it holds numbers, not text"
        raise InputError(msg)

    def where(self, row: int) -> str:
        """Say where a row stands in the file."""
        return f"{self.path}, row {row + 1}"

    def is_text(self, place: int) -> bool:
        """No column of numbers is text."""
        return False
