"""A user's own limits of what is measured: ``rms < 1.1 bounds``, ``efficiency > 0.9``.

A limit names a family of statistics, or one member as tables spell it, ``bias[K_x]``;
every value of that name must keep it, in every cell. The number is in the unit of the
statistic, which may be said, or in bounds: the Cramer-Rao bound that stands beside it.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from simval.errors import InputError
from simval.results import Row
from simval.statistics import BELOW_BOUND, CRAMER_RAO
from simval.sweep.cells import CellResult

BOUNDS = "bounds"
_FORM = re.compile(r"\s*([^<>]*?)\s*([<>])\s*([-+.\deE]+)\s*(\S*)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """What a statistic must keep."""

    text: str
    statistic: str
    below: bool
    number: float
    unit: str  # of the number; `BOUNDS`, or empty where it is not said

    def of(self, row: Row) -> bool:
        """Whether a row is what it limits."""
        named = self.statistic in (str(row.statistic), row.statistic.family.name)
        return named and (self.unit != BOUNDS or _has_bound(row))

    def missed(self, row: Row) -> str:
        """Say what a row has, if that is beyond the limit."""
        bounds = self.unit == BOUNDS
        if self.unit and not bounds and self.unit != row.unit:
            msg = f"limit {self.text!r}: {row.statistic} is in {row.unit}"
            raise InputError(msg)
        value = row.value / (row.prediction if bounds and row.prediction else 1.0)
        kept = value < self.number if self.below else value > self.number
        unit = f" {BOUNDS}" if bounds else "" if row.unit == "1" else f" {row.unit}"
        return "" if kept else f"{row.statistic} is {value:.4g}{unit}"


def _has_bound(row: Row) -> bool:
    """Whether its prediction is a bound of its value."""
    return row.predictor == CRAMER_RAO and row.statistic.family != BELOW_BOUND


def limit_of(text: str) -> Limit:
    """Read a limit.

    Raises
    ------
    InputError
        If it is none.
    """
    found = _FORM.fullmatch(str(text))
    try:
        name, sign, number, unit = found.groups() if found else ("", "", "", "")
        return Limit(
            text=text, statistic=name, below=sign == "<", number=float(number),
            unit=unit,
        )  # fmt: skip
    except ValueError:
        msg = (
            f"limit {text!r} cannot be read; it must be a statistic, < or >, a number "
            'and its unit or "bounds": "rms < 1.1 bounds", "efficiency > 0.9"'
        )
        raise InputError(msg) from None


def missed_limits(limits: Iterable[str], cells: Sequence[CellResult]) -> Iterator[str]:
    """Say which limits are missed, where, and by what.

    Raises
    ------
    InputError
        If a limit is none, or limits nothing that was measured.
    """
    done = [cell for cell in cells if cell.status == "done"]
    for limit in map(limit_of, limits):
        rows = [(cell, row) for cell in done for row in cell.rows if limit.of(row)]
        if done and not rows:
            beside = limit.unit == BOUNDS
            names = {
                row.statistic.family.name
                for cell in done
                for row in cell.rows
                if not beside or _has_bound(row)
            }
            msg = (
                f"limit {limit.text!r} is of nothing that was measured"
                f"{' beside a bound' * beside}: {', '.join(sorted(names))}"
            )
            raise InputError(msg)
        for cell, row in rows:
            if words := limit.missed(row):
                yield f"{limit.text}: {words} in {cell.name}"
