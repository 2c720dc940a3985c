"""Running a user's filter over a log, in a child process with a time limit."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from simval import vocabulary
from simval.errors import UnusablePluginError
from simval.plugins.child import started
from simval.plugins.loading import find_plugin, meant
from simval.plugins.protocol import Filter
from simval.plugins.runs import FilterInput, FilterOutput, run_filter
from simval.plugins.worlds import find_world
from simval.recorded.signals import Signals
from simval.recorded.told import Start

TIME_LIMIT: Final = vocabulary.FILTER_SECONDS

MOST: Final = 200_000
"""Rows whose answers are kept: covariances of six by six are then 60 MB. Of a longer
log rows are left out evenly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterRun:
    """Answers of one filter, and the world that it has."""

    name: str
    world: str
    how: str  # declared, or found
    output: FilterOutput  # rows counted in the log
    thinned: bool  # whether rows between the kept ones are left out


def filter_input(found: Signals, start: Start) -> FilterInput:
    """What a filter is given of a log, from the row after the start on."""
    rows = slice(start.row + 1, None)
    return FilterInput(
        dt=np.diff(found.time[start.row :]),
        gyroscope=found.gyro[None, rows],
        accelerometer=found.force[None, rows],
        magnetometer=found.field[None, rows],
        start=start.attitude[None],
        told=start.told,
    )


def filters_of(plugins: Sequence[str]) -> dict[str, str]:
    """Words that mean one filter each, by the names that they are called in a table.

    Raises
    ------
    UnusablePluginError
        If one cannot be loaded, or holds no filter.
    """
    found: dict[str, str] = {}
    for plugin in plugins:
        held = [each for each in meant(plugin) if each.field == Filter.taken_by]
        if not held:
            msg = f"{plugin} holds no Filter, and that is what runs over a log"
            raise UnusablePluginError(msg)
        for each in held:
            name = each.name if each.name not in found else each.word
            found[name] = each.word
    return found


def run_on_log(
    name: str,
    algorithm: str,
    found: Signals,
    start: Start,
    time_limit: float = TIME_LIMIT,
) -> FilterRun:
    """Run a filter over a log, and give its answers a name.

    Raises
    ------
    PluginError
        If it cannot be loaded, breaks a rule of its answers, stays in no world, or
        does not end in time.
    """
    given = filter_input(found, start)
    stride = -(-len(given.dt) // MOST)
    keep = np.arange(stride - 1, len(given.dt), stride)
    rate = 1.0 / float(np.median(given.dt))
    with started(time_limit, f"the filter {name}") as child:
        filter = child.ask(find_plugin, algorithm, Filter)
        world = find_world(filter, given.told, rate)
        output = run_filter(filter, given, keep, world.world)
    how = "declared" if filter.world else "found"
    return FilterRun(
        name=name,
        world=world.world,
        how=f"{how}: {filter.name} {world.words}",
        output=_in_log(output, start.row + 1),
        thinned=stride > 1,
    )


_OUTPUTS: Final = tuple(each.name for each in fields(FilterOutput))


def _in_log(output: FilterOutput, first: int) -> FilterOutput:
    words = {each: getattr(output, each) for each in _OUTPUTS}
    return FilterOutput(**words | {"kept": output.kept + first})
