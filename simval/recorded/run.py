"""Running a user's filter over a log, in a child process with a time limit."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval import vocabulary
from simval.errors import PluginError, UnusablePluginError
from simval.plugins.child import Answer, asked
from simval.plugins.filter_frames import find_world
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_run import run_filter
from simval.plugins.filter_signals import FilterInput, FilterOutput, Told
from simval.plugins.loading import find_plugin, meant
from simval.recorded.signals import Signals
from simval.recorded.told import Start

TIME_LIMIT: Final = vocabulary.FILTER_SECONDS

MOST: Final = 200_000
"""Rows whose answers are kept: covariances of six by six then fit the file that a child
may write. Of a longer log rows are left out evenly."""

PROGRAM: Final = (
    "from simval.plugins.child import respond; "
    "from simval.recorded.run import answer; respond(answer)"
)


class _Done(Answer):
    """What the child says beside the arrays that it leaves."""

    world: str = ""
    how: str = ""
    arrays: tuple[str, ...] = ()


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
    with TemporaryDirectory(prefix="simval-filter-") as folder:
        _save(Path(folder), given, keep)
        request = {"algorithm": algorithm, "folder": folder}
        done = asked(PROGRAM, request, time_limit, _Done, f"the filter {name}")
        try:
            arrays = {
                name: np.load(Path(folder, f"out_{name}.npy"), allow_pickle=False)
                for name in done.arrays
                if name in _OUTPUTS
            }
            output = _output(arrays, keep)
        except (OSError, ValueError, EOFError, KeyError) as error:
            msg = f"the filter {name} left no readable answer ({error})"
            raise PluginError(msg) from None
    return FilterRun(
        name=name,
        world=done.world,
        how=done.how,
        output=_in_log(output, start.row + 1),
        thinned=stride > 1,
    )


_OUTPUTS: Final = tuple(each.name for each in fields(FilterOutput))
_INPUTS: Final = ("dt", "gyroscope", "accelerometer", "magnetometer", "start")


def _save(folder: Path, given: FilterInput, keep: NDArray[np.intp]) -> None:
    np.save(folder / "keep.npy", keep)
    for name in _INPUTS:
        np.save(folder / f"{name}.npy", getattr(given, name))
    told = [np.atleast_1d(getattr(given.told, each.name)) for each in fields(Told)]
    np.save(folder / "told.npy", np.concatenate(told))


def _load(folder: Path) -> tuple[FilterInput, NDArray[np.intp]]:
    values: list[float] = np.load(folder / "told.npy").tolist()
    told: dict[str, Any] = {}
    for each in fields(Told):
        if each.name == "field":
            told["field"], values = np.array(values[:3]), values[3:]
        else:
            told[each.name], values = values[0], values[1:]
    arrays: dict[str, Any] = {name: np.load(folder / f"{name}.npy") for name in _INPUTS}
    return FilterInput(**arrays, told=Told(**told)), np.load(folder / "keep.npy")


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """In the child: find the world of a filter, run it, and leave its arrays."""
    filter = find_plugin(str(request["algorithm"]), Filter)
    folder = Path(str(request["folder"]))
    given, keep = _load(folder)
    rate = 1.0 / float(np.median(given.dt))
    found = find_world(filter, given.told, rate)
    output = run_filter(filter, given, keep, found.world)
    left = []
    for name in _OUTPUTS:
        value = getattr(output, name)
        if value is not None:
            np.save(folder / f"out_{name}.npy", value)
            left.append(name)
    how = "declared" if filter.world else "found"
    return {
        "world": found.world,
        "how": f"{how}: {filter.name} {found.words}",
        "arrays": left,
    }


def _output(arrays: dict[str, Any], keep: NDArray[np.intp]) -> FilterOutput:
    # what a child left is believed only in its shapes
    count = len(keep)
    expected: dict[str, tuple[int | None, ...]] = {
        "attitude": (1, count, 4),
        "covariance": (1, count, None, None),
        "bias": (1, count, 3),
        "innovation": (1, count, None),
        "innovation_covariance": (1, count, None, None),
        "seconds": (None,),
    }
    for name, shape in expected.items():
        value = arrays.get(name)
        if value is None:
            continue
        fits = value.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, value.shape, strict=True)
        )
        if not fits or value.dtype != np.float64 or not np.isfinite(value).all():
            msg = f"{name} has shape {value.shape} and type {value.dtype}"
            raise ValueError(msg)
    return FilterOutput(
        kept=keep,
        attitude=arrays["attitude"],
        covariance=arrays.get("covariance"),
        bias=arrays.get("bias"),
        innovation=arrays.get("innovation"),
        innovation_covariance=arrays.get("innovation_covariance"),
        seconds=arrays["seconds"],
    )


def _in_log(output: FilterOutput, first: int) -> FilterOutput:
    words = {each: getattr(output, each) for each in _OUTPUTS}
    return FilterOutput(**words | {"kept": output.kept + first})
