"""Time of one call of a plug-in, beside the package's own in the same process.

Both are called in turns on the same input, and the ratio is the median of the turns'
own, so that what else the machine does weighs on both alike. It is processor time, of
programs that a call starts as well. A time is no row: it goes to ``timing.json`` and is
never judged.
"""

import contextlib
from collections.abc import Callable, Mapping
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter, process_time
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.plugins import Calibrator, Estimator, Filter, find_plugin
from simval.plugins.answers import raw_attitudes
from simval.plugins.builtin import BESIDE
from simval.plugins.calibrations import calibration_of
from simval.plugins.calibrator_probe import probe_sensor
from simval.plugins.child import where_it_lives
from simval.plugins.filter_path import path
from simval.plugins.filter_signals import Told
from simval.plugins.filter_steps import readings_of, run_of
from simval.plugins.noise import vector_noise
from simval.plugins.protocol import Plugin
from simval.poses import fibonacci_sphere

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
