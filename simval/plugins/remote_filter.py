"""A filter that another process runs, measured as any other here."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import FilterInput, FilterOutput, Told
from simval.plugins.messages import MOST_NUMBERS, Message
from simval.plugins.reference_frames import WORLDS
from simval.plugins.remote import taken
from simval.plugins.rotations import sound_rows
from simval.plugins.session import Session

PER_ROW: Final = 512
"""Numbers that a filter may answer at a row, by which its answer is bounded."""

SENSORS: Final = ("dt", "gyroscope", "accelerometer", "magnetometer", "start")
SPREAD: Final = ("covariance", "innovation_covariance")
OUTPUTS: Final = ("attitude", "bias", "innovation", "seconds", *SPREAD)
"""Arrays that a filter is given, those that are covariances, and all that it leaves."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RemoteFilter(Filter):
    """A filter that another process runs."""

    session: Session

    def found_world(
        self, told: Told, rate: float
    ) -> tuple[str, tuple[str, ...], float]:
        """Its world, others in which it stays, and how far it strays, rad."""
        words, field = _told(told)
        given, says = {"told": words, "rate": rate}, ("world", "alike", "stray")
        answer = self.session.ask("world", given, field, says).words
        world, alike = answer.get("world"), answer.get("alike")
        known = (self.world,) if self.world else WORLDS
        stray = answer.get("stray")
        if (
            world not in known
            or not isinstance(alike, list)
            or not all(each in WORLDS for each in alike)
            or not isinstance(stray, float)
        ):
            msg = "it names no world"
            raise self.session.unreadable(msg)
        return str(world), tuple(alike), stray

    def output(
        self, given: FilterInput, keep: NDArray[np.intp], world: str
    ) -> FilterOutput:
        """Its answers to the readings of some trials, at the rows that are kept."""
        told, arrays = _told(given.told)
        arrays |= {name: getattr(given, name) for name in SENSORS}
        n, k = len(given.start), len(keep)
        answer = self.session.ask(
            "filtered",
            {"told": told, "world": world},
            {**arrays, "keep": keep.astype(float)},
            most=max(MOST_NUMBERS, 8 * n * k * PER_ROW),
        )
        found = taken(self.session, answer, **_shapes(answer, n, k))
        if not _believable(found):
            msg = "entries that no attitude or covariance has"
            raise self.session.unreadable(msg)
        parts = {each.name: found.get(each.name) for each in fields(FilterOutput)}
        whole: dict[str, Any] = parts | {"kept": keep}
        return FilterOutput(**whole)


def _shapes(answer: Message, n: int, k: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the words of an answer, of n trials at k rows."""

    def last(word: str) -> int:
        return (answer.arrays[word].shape or (0,))[-1]

    shapes: dict[str, tuple[int, ...]] = {"attitude": (n, k, 4), "seconds": (0,)}
    for word in answer.arrays:
        if word.endswith("covariance"):
            shapes[word] = (n, k, last(word), last(word))
        elif word in ("bias", "innovation"):
            shapes[word] = (n, k, 3 if word == "bias" else last(word))
    if "seconds" in answer.arrays:
        shapes["seconds"] = (answer.arrays["seconds"].size,)
    if "innovation" in shapes and "innovation_covariance" in shapes:
        shapes["innovation"] = (n, k, last("innovation_covariance"))
    return {word: shape for word, shape in shapes.items() if word in OUTPUTS}


def _believable(found: Mapping[str, Array]) -> bool:
    """Whether all is finite, attitudes are such, and variances not negative.

    More of covariances is checked where the filter runs, in its own convention.
    """
    q = found["attitude"].reshape(-1, 4)
    variances = {
        word: np.diagonal(each, axis1=2, axis2=3)
        for word, each in found.items()
        if word in SPREAD
    }
    own = variances.get("covariance")
    return bool(
        all(np.isfinite(each).all() for each in found.values())
        and sound_rows(q, "xyzs").all()
        and all((each >= 0.0).all() for each in variances.values())
        and (own is None or (own.shape[-1] >= 3 and own[..., :3].all()))
    )


def _told(told: Told) -> tuple[dict[str, float], dict[str, Array]]:
    words = {
        each.name: float(getattr(told, each.name))
        for each in fields(Told)
        if each.name != "field"
    }
    return words, {"field": told.field}
