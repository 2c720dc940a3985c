r"""Parameters of a study that runs a user's code, and its cells in a child process.

A parameter is the word for a plug-in; its files are given absolute paths once, where
the suite is read, and so mean the same in every process. With them goes what they hold.
It is the study that starts the child, so it is the same under every scheduler.

Both are called in turns on the same input, and the ratio is the median of the turns'
own, so that what else the machine does weighs on both alike. It is processor time, of
programs that a call starts as well. A time is no row: it goes to ``timing.json`` and is
never judged.
"""

import contextlib
import os
import platform
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter, process_time
from types import MappingProxyType
from typing import Annotated, Any, Final, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from simval.errors import PluginError
from simval.filters.signals import Told
from simval.plugins import Calibrator, Estimator, Filter, find_plugin
from simval.plugins.answers import calibration_of, raw_attitudes
from simval.plugins.child import Child, started, told, where_it_lives
from simval.plugins.loading import BESIDE, missing, sources
from simval.plugins.names import located, portable
from simval.plugins.noise import vector_noise
from simval.plugins.probe import probe_sensor
from simval.plugins.protocol import Plugin
from simval.plugins.runs import readings_of, run_of
from simval.plugins.worlds import path
from simval.poses import fibonacci_sphere
from simval.results import Outcome
from simval.streams import Streams
from simval.studies.study import StudyParameters

BATCH = 1024
"""Attitudes in a call of an estimator, as the study's blocks."""

NOISE = 0.01
G = 9.80665

TOLD: Final = Told(
    gyroscope_noise=1.75e-4,
    gyroscope_walk=2e-5,
    accelerometer_noise=2e-3 * G,
    magnetometer_noise=2e-7,
    gravity=G,
    field=np.array([2e-5, 0.0, -4e-5]),
    start_std=5e-3,
    bias_std=1e-3,
)
ROWS = 100.0  # Hz
SECONDS = (1.0, 1.0)  # of rest, and of a turn: a call of a filter steps through them
WORLD = "NWU"  # of a filter that leaves it open: it takes no other time

TURNS = 15
LEAST_TURNS = 3
BUDGET = 1.0
"""Seconds after which no further turn is begun, once there are `LEAST_TURNS`."""

LEAST = 1e-9
"""Seconds that a call takes at the least: what the clock can tell."""

Call = Callable[[], object]


def _estimators(
    plugin: Estimator, own: Estimator, parameters: Mapping[str, Any]
) -> tuple[Call, Call, int]:
    rng, count = np.random.default_rng(BATCH), parameters["vectors"]
    _, exact = plugin.observed(count).generic(BATCH, rng)
    body = [v + NOISE * rng.standard_normal(v.shape) for v in exact[:count]]
    vectors = [*body, *exact[count:]]
    noise = vector_noise(parameters["noise"], count, NOISE)
    return (
        lambda: raw_attitudes(plugin, vectors, noise),
        lambda: raw_attitudes(own, vectors, noise),
        BATCH,
    )


def _calibrators(
    plugin: Calibrator, own: Calibrator, parameters: Mapping[str, Any]
) -> tuple[Call, Call, int]:
    sensor, rng = probe_sensor(), np.random.default_rng(BATCH)
    raw = sensor.distort(G * fibonacci_sphere(parameters["poses"]), rng)
    noisy = raw + NOISE * rng.standard_normal(raw.shape)
    return (
        lambda: calibration_of(plugin, noisy, G, NOISE),
        lambda: calibration_of(own, noisy, G, NOISE),
        1,
    )


def _filters(plugin: Filter, own: Filter, _: Any) -> tuple[Call, Call, int]:
    given = path(TOLD, ROWS, *SECONDS).given
    last = np.array([len(given.dt) - 1])

    def run(each: Filter) -> Call:
        trial = slice(0, 1) if each.batch else 0
        readings = readings_of(each, given, trial, each.world or WORLD)
        return lambda: run_of(each, readings, last)

    return run(plugin), run(own), len(given.dt)


_CLOCKS: Final[Mapping[str, tuple[Any, Any]]] = MappingProxyType(
    {
        Estimator.taken_by: (Estimator, _estimators),
        Calibrator.taken_by: (Calibrator, _calibrators),
        Filter.taken_by: (Filter, _filters),
    }
)


@where_it_lives
def call_time(plugin: Plugin, parameters: Mapping[str, Any]) -> dict[str, float]:
    """Seconds of one call, of the package's own, their ratio, and what a call does.

    Nothing where it raises: its cell has been measured.
    """
    kind, calls = _CLOCKS[plugin.taken_by]
    with contextlib.suppress(Exception, SystemExit):
        own = find_plugin(BESIDE[plugin.taken_by][0], kind)
        theirs, ours, items = calls(plugin, own, parameters)
        return _in_turns(theirs, ours) | {"items": items}
    return {}


def _in_turns(theirs: Call, ours: Call) -> dict[str, float]:
    started = perf_counter()
    seconds: list[tuple[float, float]] = []
    ours()  # imports and memory; theirs has been called by the study
    while len(seconds) < TURNS:
        if len(seconds) >= LEAST_TURNS and perf_counter() - started > BUDGET:
            break
        seconds.append((_seconds(theirs), _seconds(ours)))
    turns = np.array(seconds)
    return {
        "seconds": float(np.median(turns[:, 0])),
        "builtin_seconds": float(np.median(turns[:, 1])),
        "ratio": float(np.median(turns[:, 0] / turns[:, 1])),
        "turns": len(turns),
    }


def _seconds(call: Call) -> float:
    started = _spent()
    call()
    return max(_spent() - started, LEAST)


def _spent() -> float:
    """Processor time of this process and of those that it has waited for, s."""
    children = getrusage(RUSAGE_CHILDREN)
    return process_time() + children.ru_utime + children.ru_stime


PluginName = Annotated[
    str, Field(min_length=1, max_length=4096), AfterValidator(located)
]
"""A value that names a plug-in, its files by absolute paths."""


SHARE = 0.5
"""Of the time limit that a cell may take and still have its calls timed: they take a
sixth of a cell's time at the most, or a second."""


class PluginParameters(StudyParameters):
    """Parameters of a study of plug-ins: they know what their code was made of."""

    _sources: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _note(self) -> Self:
        """Note what the code is made of, here and now."""
        self._sources = sources(self.word)
        return self

    @property
    def word(self) -> str:
        """What the plug-in is named by, its files by absolute paths."""
        return str(getattr(self, self.plugin))

    def named(self) -> dict[str, Any]:
        """Values with files by their names alone."""
        return self.model_dump() | {self.plugin: portable(self.word)}

    def missing(self, held: Container[str] = ()) -> str:
        """Say what of the plug-in is not on this machine."""
        if not self.word:
            return "no plug-in is given"
        return missing(self.word, held)

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of all files that the code is made of."""
        return tuple(path for path in self._sources if os.path.isabs(path))

    def require_same_sources(self) -> None:
        """Check that the code is what it was when these parameters were made."""
        if changed := sorted(_changes(self._sources, sources(self.word))):
            msg = (
                "the plug-in is not what it was when the sweep was begun: "
                f"{'; '.join(changed)}, on {platform.node()}; leave it alone while a "
                "sweep runs, and put it on a file system that all workers share"
            )
            raise PluginError(msg)


def _changes(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for key in old.keys() | new.keys():
        was, now = old.get(key, ""), new.get(key, "")
        if was != now:
            how = "is missing" if not now else "is new" if not was else "has changed"
            yield f"{key} {how}"


ESTIMATE = "estimate"
"""Name under which a study of a filter leaves the attitudes of one trial."""

Model = TypeVar("Model", bound=PluginParameters)
Kind = TypeVar("Kind", bound=Plugin)


def isolated(
    outcome: Callable[[Kind, Model, Streams], Outcome],
    parameters: Model,
    streams: Streams,
    time_limit: float,
    kind: type[Kind],
) -> Outcome:
    """Measure a plug-in that a child process runs: ``outcome(plugin, ...)``.

    Raises
    ------
    PluginError
        If the plug-in is another one now, breaks a rule, or its process raised, ended
        or answered nothing in time.
    """
    with opened(parameters, time_limit) as child:
        plugin = child.ask(find_plugin, parameters.word, kind)
        measured = outcome(plugin, parameters, streams)
        if not child.spent < SHARE * float(getattr(parameters, "time_limit", inf)):
            return measured
        return replace(measured, times=call_time(plugin, parameters.model_dump()))


@contextmanager
def opened(parameters: PluginParameters, time_limit: float) -> Iterator[Child]:
    """Open a process for a plug-in; what cannot be measured is the plug-in's doing."""
    parameters.require_same_sources()
    # numbers that overflow are judged, not announced
    with (
        started(time_limit) as child,
        np.errstate(all="ignore"),
    ):
        try:
            yield child
        except Exception as error:
            raise told(error) from error
