"""Statistics, rows and cells by their names, for tests only."""

from simval.results import CellName, Row
from simval.statistics import FAMILIES, Family, Statistic
from simval.sweep.run import CellResult


def statistic(name, unit="1"):
    """Statistic of a name; of a family that does not exist, a family of that name."""
    rest = name.removeprefix("control ")
    family, bracket, inside = rest.partition("[")
    entries = tuple(inside.removesuffix("]").split(",")) if bracket else ()
    known = FAMILIES.get(family, Family(family, family))
    return Statistic(known, entries, rest != name, unit)


def row(name, value, unit="1", **fields):
    """Row of a statistic by its name."""
    return Row(statistic=statistic(name, unit), value=float(value), **fields)


def named(rows, cell="study(cell)@1"):
    """Rows as those of one cell, to be judged."""
    return [(CellName(cell.partition("(")[0], cell), row) for row in rows]


def cell(rows=(), seed=1, **parameters):
    """A finished cell of a study `s` with these rows."""
    inside = ",".join(f"{k}={v}" for k, v in sorted(parameters.items()))
    return CellResult(
        name=f"s({inside})@{seed}",
        study="s",
        seed=seed,
        parameters=parameters,
        status="done",
        error="",
        seconds=0.0,
        rows=tuple(rows),
    )
