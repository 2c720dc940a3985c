"""How many cells a suite may have, said before any of them is made."""

from math import prod
from typing import Any, Final

from pydantic import BaseModel

from simval.errors import InputError

MOST_CELLS: Final = 2_000_000
"""The bill of `docs/cluster.md` is of 1e6, whose store takes 8.5 GB; at a second a cell
twice as many are 23 days of one processor."""


def require_size(name: str, suite: BaseModel) -> None:
    """Refuse a suite of more cells than a run can have, by its axes alone.

    Raises
    ------
    InputError
        With the axes that make it so large.
    """
    content = suite.model_dump(exclude_none=True)
    seeds = _count(content.pop("seed", 1))
    tables = {study: grid for study, grid in content.items() if isinstance(grid, dict)}
    cells = seeds * sum(prod(map(_count, grid.values())) for grid in tables.values())
    if cells <= MOST_CELLS:
        return
    axes = {"seed": seeds} | {
        f"{study}.{key}": _count(value)
        for study, grid in tables.items()
        for key, value in grid.items()
    }
    longest = sorted(axes, key=lambda axis: -axes[axis])[:3]
    listed = ", ".join(f"{axes[axis]:,} of `{axis}`" for axis in longest)
    msg = (
        f"suite {name} has {cells:,} cells ({listed}); a run may have "
        f"{MOST_CELLS:,}, so shorten an axis, or split the suite into several"
    )
    raise InputError(msg)


def _count(value: Any) -> int:
    return len(value) if isinstance(value, list) else 1
