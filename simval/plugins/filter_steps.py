"""Stepping a filter through the readings of a trial, or of all trials at once.

Rows come in stretches: the readings of one are copied for the filter, stepped through,
and compared with what they were; its answers are checked together, and its time taken.
So a row costs little more than the filter itself.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter, process_time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError
from simval.plugins.calling import called, ended
from simval.plugins.filter_answers import Form, faults, form_of, storing
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import FilterInput
from simval.plugins.filter_worlds import from_scene, written
from simval.shapes import Float

SENSORS: Final = ("gyroscope", "accelerometer", "magnetometer")

LEAST_ROWS: Final = 128
MOST_ROWS: Final = 1024
STRETCHES: Final = 64
"""A run has about so many, of `LEAST_ROWS` to `MOST_ROWS` rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """What a filter is stepped through, in its own conventions."""

    where: str  # " of trial 3", or nothing
    lead: tuple[int, ...]  # of a batch, the number of trials
    dt: Float[Array, " T"]
    end: Float[Array, " T"]  # time at the end of each step, s
    sensors: tuple[Float[Array, "T ..."], ...]
    reads: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """Answers of one run at the kept rows, in the filter's own conventions."""

    words: dict[str, Float[Array, "k ..."]]
    rows: NDArray[np.intp]  # (s,), of each stretch
    seconds: Float[Array, " s"]  # of each stretch
    processor: Float[Array, " s"]  # seconds of processor time of each


def readings_of(
    filter: Filter, given: FilterInput, trials: int | slice, world: str
) -> Readings:
    """Readings of one trial, or of some as a batch."""
    batch = isinstance(trials, slice)
    start = given.start[trials]
    sensors = [getattr(given, name)[trials] for name in SENSORS]
    if filter.accelerometer == "gravity":
        sensors[1] = -sensors[1]
    if not filter.magnetometer:
        sensors.pop()
    told = given.told
    known = {
        "start": written(filter, start, world),
        "rate": float(1.0 / np.mean(given.dt)),
        "field": from_scene(world) @ told.field,
    }
    reads = {
        word: known[word] if word in known else float(getattr(told, word))
        for word in filter.reads
    }
    return Readings(
        where="" if batch else f" of trial {trials}",
        lead=(len(start),) if batch else (),
        dt=given.dt,
        end=np.cumsum(given.dt),
        sensors=tuple(np.moveaxis(a, -2, 0) for a in sensors),
        reads=reads,
    )


@contextmanager
def making(filter: Filter, readings: Readings) -> Iterator[Callable[..., Any]]:
    """Make a filter anew, give the function that steps it, and close it afterwards.

    Raises
    ------
    PluginError
        If it cannot be made or closed, or what is made cannot be stepped.
    """
    # its own copies, which it may keep and change
    own = {
        word: value.copy() if isinstance(value, np.ndarray) else value
        for word, value in readings.reads.items()
    }
    found = _called(f"`make` of {filter.name}", filter.make, **own)
    update = getattr(found, "update", found)
    if not callable(update):
        msg = (
            f"`make` of {filter.name} returned {type(found).__name__}, which cannot be "
            "stepped; it must return an object with `update`, or that function itself"
        )
        raise PluginError(msg)
    close = getattr(found, "close", None)
    try:
        yield update
    except BaseException:
        if callable(close):
            with suppress(PluginError):
                _called(f"`close` of {filter.name}", close)
        raise
    if callable(close):
        _called(f"`close` of {filter.name}", close)


def _called(name: str, function: Any, **words: Any) -> Any:
    try:
        return called(name, function, **words)
    except SystemExit as error:
        msg = f"{name} calls exit({error.code})"
        raise CrashedPluginError(msg) from None


def run_of(filter: Filter, readings: Readings, keep: NDArray[np.intp]) -> Run:
    """Make a filter anew and step it through all rows, as `stepped`."""
    with making(filter, readings) as update:
        return stepped(filter, update, readings, keep)


def stepped(
    filter: Filter,
    update: Callable[..., Any],
    readings: Readings,
    keep: NDArray[np.intp],
) -> Run:
    """Step a filter through all rows, and keep some answers.

    Raises
    ------
    PluginError
        If it raises, changes its readings, or an answer breaks a rule; with the row.
    """
    edges = stretches(len(readings.dt))
    form: Form | None = None
    found: list[list[Array]] = []
    times: list[tuple[float, float]] = []
    for first, last in pairwise(edges.tolist()):
        rows = slice(first, last)
        columns = [np.array(a[rows], order="C") for a in readings.sensors]
        given = [readings.dt[rows].tolist(), *(list(a) for a in columns)]
        stretch = _Stretch(filter, readings, first, form)
        times.append(stretch.step(update, given))
        form, arrays = stretch.form, stretch.arrays
        _require_unchanged(filter, readings, rows, columns)
        assert form is not None
        if fault := faults(form, filter, arrays):
            row, words = fault
            msg = f"{words}, {place(readings, first + row)}"
            raise PluginError(msg)
        own = keep[(keep >= first) & (keep < last)] - first
        found.append([a[own] for a in arrays])
    assert form is not None
    whole = [np.concatenate(each) for each in zip(*found, strict=True)]
    return Run(
        words=dict(zip(form.words, whole, strict=True)),
        rows=np.diff(edges),
        seconds=np.array([seconds for seconds, _ in times]),
        processor=np.array([seconds for _, seconds in times]),
    )


def stretches(rows: int) -> NDArray[np.intp]:
    """Rows at which stretches begin, and the end."""
    length = min(max(-(-rows // STRETCHES), LEAST_ROWS), MOST_ROWS)
    return np.linspace(0, rows, max(rows // length, 1) + 1).astype(np.intp)


def place(readings: Readings, row: int) -> str:
    """Say where a row is."""
    return f"at row {row} ({readings.end[row]:.6g} s){readings.where}"


class _Stretch:
    """Answers to the rows of one stretch, of a form that its first may have to set."""

    def __init__(
        self, filter: Filter, readings: Readings, first: int, form: Form | None
    ) -> None:
        self.filter, self.readings, self.first = filter, readings, first
        self.form, self.arrays = form, list[Array]()

    def step(
        self, update: Callable[..., Any], given: Sequence[Sequence[Any]]
    ) -> tuple[float, float]:
        """Step through the rows; seconds that it took, and of processor time."""
        count, row = len(given[0]), -1
        put = None if self.form is None else self._puts(self.form, count)
        start = np.array([perf_counter(), process_time()])
        try:
            for row, values in enumerate(zip(*given, strict=True)):
                answer = update(*values)
                if put is None:
                    self.form = form_of(self.filter, answer, self.readings.lead)
                    put = self._puts(self.form, count)
                put(row, answer)
        except (Exception, SystemExit) as error:  # whatever a user's filter may raise
            where = f", {place(self.readings, self.first + max(row, 0))}"
            raise ended(self.filter.name, error, where) from error
        wall, processor = np.array([perf_counter(), process_time()]) - start
        return float(wall), float(processor)

    def _puts(self, form: Form, count: int) -> Callable[[int, Any], None]:
        self.arrays = [np.empty((count, *shape)) for shape in form.shapes]
        return storing(form, self.arrays)


def _require_unchanged(
    filter: Filter, readings: Readings, rows: slice, columns: list[Array]
) -> None:
    for name, whole, now in zip(SENSORS, readings.sensors, columns, strict=False):
        before = whole[rows]
        equal = (before == now) | (np.isnan(before) & np.isnan(now))
        same = equal.reshape(len(now), -1).all(axis=1)
        if not same.all():
            row = rows.start + int(np.argmin(same))
            msg = (
                f"{filter.name} changes its input: the {name}'s reading is another "
                f"after the step {place(readings, row)}; work on a copy"
            )
            raise PluginError(msg)
