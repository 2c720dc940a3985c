"""What a run was asked for: the cells that the grid in its manifest describes.

The cells of a run stand in the order of its grid: all of it for each seed in turn,
study by study, the last parameter the fastest. So the place of a cell says what it must
be, and one that is lost, doubled, swapped or of another run is found, whoever took it.
"""

from collections.abc import Mapping
from math import prod
from typing import Any

from simval.sweep.documents import DamagedError

Axes = dict[str, list[Any]]


class Asked:
    """The cells of a manifest, by their place."""

    def __init__(self, manifest: Mapping[str, Any]) -> None:
        grid = manifest["grid"]
        self._seeds: list[int] = grid["seed"]
        self._tables: list[tuple[str, Axes]] = [
            (study, {key: _listed(value) for key, value in table.items()})
            for study, table in grid.items()
            if study != "seed"
        ]
        self._sizes = [prod(map(len, axes.values())) for _, axes in self._tables]
        self._each = sum(self._sizes)
        self.count = len(self._seeds) * self._each
        if manifest["cells"] != self.count:
            msg = (
                f"the manifest says {manifest['cells']} cells, and its grid has "
                f"{self.count}"
            )
            raise DamagedError(msg)

    def require(
        self, place: int, study: str, seed: int, parameters: Mapping[str, Any]
    ) -> None:
        """Refuse a cell that is not the one which was asked for at its place."""
        if not 0 <= place < self.count:
            msg = f"it is number {place}, and the suite has {self.count} cells"
            raise DamagedError(msg)
        turn, rest = divmod(place, self._each)
        at = 0
        while rest >= self._sizes[at]:
            rest -= self._sizes[at]
            at += 1
        wanted, axes = self._tables[at]
        if (study, seed) != (wanted, self._seeds[turn]):
            msg = (
                f"the suite asks for {wanted} with seed {self._seeds[turn]} at place "
                f"{place}"
            )
            raise DamagedError(msg)
        for key in reversed(axes):
            rest, i = divmod(rest, len(axes[key]))
            if key not in parameters or parameters[key] != axes[key][i]:
                msg = (
                    f"its parameter `{key}` is {parameters.get(key)!r:.60}; the suite "
                    f"asks for {axes[key][i]!r:.60}"
                )
                raise DamagedError(msg)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]
