"""Rank sizes of which less is better, and find ties.

Two are told apart where what judges the pair sees a difference beyond chance, and where
the digits that a person is shown differ. Who is not told apart from the least, or from
the greatest, is tied with it, and stands beside it wherever it is named.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

DIGITS: Final = 3
"""Of a size, as results show it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranking:
    """Names by size, with those that tie with the best and with the worst."""

    order: tuple[str, ...]  # the least first
    best: tuple[str, ...]  # the least first, then those that tie with it
    worst: tuple[str, ...]  # nor from the greatest, which comes first

    @property
    def tied(self) -> bool:
        """True if even the best and the worst tie, so that nothing is ranked."""
        return self.order[-1] in self.best


def ranked(sizes: Mapping[str, float], apart: Callable[[str, str], bool]) -> Ranking:
    """Rank names by finite sizes; `apart` says whether two differ beyond chance."""
    order = tuple(sorted(sizes, key=lambda name: (sizes[name], name)))
    shown = {name: f"{size:.{DIGITS}g}" for name, size in sizes.items()}

    def with_ties(end: str) -> tuple[str, ...]:
        others = (
            name
            for name in order
            if name != end and (shown[name] == shown[end] or not apart(end, name))
        )
        return (end, *others)

    return Ranking(order=order, best=with_ties(order[0]), worst=with_ties(order[-1]))
