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
from simval.plugins.child import where_it_lives
from simval.plugins.filter_protocol import Filter, Force
from simval.plugins.filter_signals import Told
from simval.plugins.filter_signs import require_signs
from simval.plugins.filter_strays import DECLARED, STAYS, Stray, Trial
from simval.plugins.protocol import Components
from simval.plugins.reference_frames import WORLDS

DIRECTIONS: Final[tuple[Literal["active", "passive"], ...]] = ("active", "passive")

PREFERRED: Final = ("NWU", "NED", *(w for w in WORLDS if w not in ("NWU", "NED")))
"""Of worlds that are the same to a filter the scenes' is taken, or the usual one."""


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


@where_it_lives
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
        does, with what was tried; or if a sign of its bias is wrong.
    """
    trial = Trial(filter, told, rate)
    worlds = (filter.world,) if filter.world else WORLDS
    strays = trial.all_of(replace(filter, world=world) for world in worlds)
    if not any(each.judged <= STAYS for each in strays):
        raise _misdeclared(trial, filter, min(strays, key=lambda each: each.judged))
    # of a declared one that has any north the others say nothing
    more = () if filter.world and _any_north(filter) else WORLDS
    every = trial.all_of(replace(filter, world=world) for world in (*worlds, *more))
    alike = list({e.declared.world: e for e in every if e.judged <= STAYS}.values())
    if len(alike) > 1 and not _any_north(filter):
        alike = _lasting(trial, filter, alike)
    best = _chosen(filter, alike)
    names = [str(each.declared.world) for each in alike]
    world = str(best.declared.world)
    rest = tuple(name for name in PREFERRED if name in names and name != world)
    require_signs(filter, told, world, rate)
    return FoundWorld(world=world, alike=rest, stray=best.judged)


def _any_north(filter: Filter) -> bool:
    """Whether a filter has the north that it is given, by start and field."""
    return not filter.magnetometer or "field" in filter.reads


def _lasting(trial: Trial, filter: Filter, alike: list[Stray]) -> list[Stray]:
    """Worlds in which a filter stays over a long rest as well, the declared one too."""
    after = trial.after_a_long_rest(alike)
    lasting = [each for each in after if each.judged <= STAYS]
    for own in after:
        if lasting and own.declared.world == filter.world and own not in lasting:
            raise _misdeclared(trial, filter, own)
    return lasting or alike


def _chosen(filter: Filter, alike: list[Stray]) -> Stray:
    """The declared one of the worlds in which a filter stays, or one that is its own.

    Raises
    ------
    PluginError
        If it is left open, and cannot be found.
    """
    order = (filter.world, *PREFERRED)
    best = min(alike, key=lambda each: order.index(each.declared.world))
    if filter.world is not None or len(alike) == 1 or _any_north(filter):
        return best
    names = " and ".join(str(each.declared.world) for each in alike)
    msg = (
        f"{filter.name} stays where it is started in the worlds {names} alike, so its "
        "own cannot be found: declare its `world`"
    )
    raise PluginError(msg)


def _misdeclared(trial: Trial, filter: Filter, off: Stray) -> PluginError:
    """Say which declaration fits a filter that strays, or what was tried."""
    tried = trial.all_of(_declarations(filter))
    fits = [each for each in tried if each.judged <= STAYS]
    if not fits and off.error is not None:
        return off.error
    as_declared = _said(filter, None)
    where = (
        f"fails as it is declared ({as_declared}: {off.error})"
        if off.error is not None
        else f"strays by {np.degrees(off.judged):.0f} degrees from the truth, without "
        f"noise, as it is declared ({as_declared})"
    )
    if not fits:
        why = trial.explained(off.declared) or _what_was_tried(filter, tried)
        return PluginError(f"{filter.name} {where}; {why}")
    if len(fits) > 2 and not _any_north(filter):  # two are the same, upside down
        after = trial.after_a_long_rest(fits)
        fits = [each for each in after if each.judged <= STAYS] or fits
    best = min(fits, key=lambda each: (_changes(each.declared, filter), each.judged))
    msg = (
        f"{filter.name} {where}; declare {_said(best.declared, filter)}: so it stays "
        f"within {np.degrees(best.judged):.2g} degrees"
    )
    return PluginError(msg)


def _declarations(filter: Filter) -> list[Filter]:
    """The filter in each convention, those of its own form of answer first."""
    return [
        replace(filter, components=form, matrix=matrix, accelerometer=force, world=w)
        for form, matrix, force, w in product(
            get_args(Components), DIRECTIONS, get_args(Force), WORLDS
        )
    ]


def _changes(other: Filter, filter: Filter) -> tuple[int, bool]:
    """How many declarations differ, and whether one is the accelerometer's.

    One that was left open is free. What is the same upside down is told by the world.
    """
    changed = [
        word
        for word in DECLARED
        if getattr(filter, word) not in (None, getattr(other, word))
    ]
    return len(changed), "accelerometer" in changed


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
