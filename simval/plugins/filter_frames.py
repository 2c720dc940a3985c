r"""The frame finder: in which world, and by which conventions, a filter stays.

Without noise, at rest and over a slow turn, a filter that starts from the truth must
stay there. One that was written for another world, another order or direction of the
attitude or another sign of the accelerometer leaves it: its references then pull it
elsewhere, or it turns the wrong way. So each of the plausible declarations is tried
until one is found in which it stays. A filter that reads no start is given time to
find the attitude first.

Some declarations are the same: z down with the accelerometer read as gravity is z up
with the specific force, of the same north; without a magnetometer all worlds of the
same vertical are one, and only the inclination is judged.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Literal, get_args

import numpy as np

from simval.errors import PluginError
from simval.plugins.filter_protocol import Filter, Force
from simval.plugins.filter_signals import Told
from simval.plugins.filter_strays import DECLARED, STAYS, Stray, Trial
from simval.plugins.protocol import Components
from simval.plugins.reference_frames import WORLDS

DIRECTIONS: Final[tuple[Literal["active", "passive"], ...]] = ("active", "passive")

CLEARLY: Final = 5.0
"""Times that another world must fit better than a declared one that fits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundWorld:
    """Where a filter stays."""

    world: str
    alike: tuple[str, ...]  # other worlds in which it stays just as well
    stray: float  # greatest error over rest and turn, rad

    @property
    def words(self) -> str:
        """What was found, for people."""
        more = f", and in {', '.join(self.alike)} alike" if self.alike else ""
        off = f"{np.degrees(self.stray):.2g}"
        return f"stays in {self.world} within {off} degrees{more}"


def find_world(filter: Filter, told: Told, rate: float = 100.0) -> FoundWorld:
    """Find the world of a filter, and check what it declares.

    Parameters
    ----------
    filter : Filter
        As it declares itself.
    told : Told
        What it is told of sensors and field; its start is exact.
    rate : float, default 100.0
        Rows per second, Hz.

    Returns
    -------
    FoundWorld
        Its world: as declared, or the one in which it stays.

    Raises
    ------
    PluginError
        If it does not stay as declared, with the declaration that fits or, if none
        does, with what was tried.
    """
    trial = Trial(filter, told, rate)
    worlds = (filter.world,) if filter.world else WORLDS
    strays = trial.all_of(replace(filter, world=world) for world in worlds)
    fits = [each for each in strays if each.judged <= STAYS]
    if not fits:
        raise _misdeclared(trial, filter, strays)
    others = [w for w in WORLDS if w not in worlds]
    beside = trial.all_of(replace(filter, world=world) for world in others)
    best = fits[0] if filter.world else min(fits, key=lambda each: each.judged)
    better = min([*fits, *beside], key=lambda each: each.judged)
    if np.radians(1.0) < best.judged and CLEARLY * better.judged < best.judged:
        raise _misdeclared(trial, filter, strays)
    alike = [each for each in (*fits, *beside) if each.judged <= STAYS]
    if filter.magnetometer and filter.world is None and len(alike) > 1:
        alike = trial.after_a_long_rest(alike)
        best = _only_one(filter, alike)
    names = [str(e.declared.world) for e in alike]
    world = str(best.declared.world)
    if not filter.magnetometer and filter.world is None:
        world = next(w for w in WORLDS if w in names)
    rest = tuple(name for name in WORLDS if name in names and name != world)
    return FoundWorld(world=world, alike=rest, stray=best.judged)


def _only_one(filter: Filter, fits: list[Stray]) -> Stray:
    if len(fits) == 1:
        return fits[0]
    names = " and ".join(str(each.declared.world) for each in fits)
    msg = (
        f"{filter.name} stays where it is started in the worlds {names} alike, so its "
        "own cannot be found: declare its `world`"
    )
    raise PluginError(msg)


def _misdeclared(trial: Trial, filter: Filter, strays: list[Stray]) -> PluginError:
    """Say which declaration fits a filter that strays, or what was tried."""
    tried = trial.all_of(_declarations(filter))
    fits = [each for each in tried if each.judged <= STAYS]
    off = min(strays, key=lambda each: each.judged)
    if not fits and off.error is not None:
        return off.error
    as_declared = _said(filter, None)
    where = (
        f"fails as it is declared ({as_declared}: {off.error})"
        if off.error is not None
        else f"strays by {np.degrees(off.judged):.0f} degrees from the truth, without "
        f"noise, as it is declared ({as_declared})"
    )
    if fits:
        longest = _lasting(trial, filter, fits)
        least = min(each.judged for each in longest)
        near = [each for each in longest if each.judged <= max(2 * least, 0.01)]
        best = min(near, key=lambda each: _changes(each.declared, filter))
        within = np.degrees(best.judged)
        msg = (
            f"{filter.name} {where}; declare {_said(best.declared, filter)}: so it "
            f"stays within {within:.2g} degrees"
        )
        return PluginError(msg)
    return PluginError(f"{filter.name} {where}; {_what_was_tried(filter, tried)}")


def _lasting(trial: Trial, filter: Filter, fits: list[Stray]) -> list[Stray]:
    """Those that fit after a long rest too; two are always the same, upside down."""
    if len(fits) <= 2 or not filter.magnetometer:
        return fits
    return trial.after_a_long_rest(fits)


def _declarations(filter: Filter) -> list[Filter]:
    """The filter in each convention, those of its own form of answer first."""
    return [
        replace(filter, components=form, matrix=matrix, accelerometer=force, world=w)
        for form, matrix, force, w in product(
            get_args(Components), DIRECTIONS, get_args(Force), WORLDS
        )
    ]


def _changes(other: Filter, filter: Filter) -> int:
    """How many declarations differ; one that was left open is free."""
    return sum(
        getattr(other, word) != getattr(filter, word)
        for word in DECLARED
        if getattr(filter, word) is not None
    )


def _said(filter: Filter, than: Filter | None) -> str:
    """Declarations, or those that are others than another's."""
    pairs = [
        f'{word}="{value}"'
        for word in DECLARED
        if (value := getattr(filter, word)) is not None
        and (than is None or value != getattr(than, word))
    ]
    return ", ".join(pairs)


def _what_was_tried(filter: Filter, tried: list[Stray]) -> str:
    """How far it strays in each world, by the conventions that fit best there."""
    inclined = min(tried, key=lambda each: each.inclination)
    hint = ""
    if filter.magnetometer and inclined.inclination <= STAYS:
        hint = (
            f". Its inclination stays, with {_said(inclined.declared, None)}, and "
            "its heading does not: does it use the magnetometer (if not, declare "
            "magnetometer=False), and is its north that of the field it `reads`?"
        )
    parts = []
    for world in WORLDS:
        own = [each for each in tried if each.declared.world == world]
        best = min(own, key=lambda each: each.judged)
        parts.append(f"{world} {_degrees(best.judged)}")
    return (
        f"it stays in none of the {len(tried)} declarations that were tried; by "
        f"degrees, the least in each world: {', '.join(parts)}{hint}"
    )


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.0f}" if np.isfinite(angle) else "fails"
