r"""Run a filter over readings, and repeat runs of any algorithm.

A fresh filter is made for each trial, or one for a batch of all, and stepped row by row
in its own conventions; its answers are converted afterwards, all at once. What cannot
be believed is refused: answers that are no attitudes or covariances, input that is
changed, state that outlives a run.

With C the matrix from NWU to a world, :math:`r_W = C\, r`, an attitude that carries NWU
to the body carries that world to it as :math:`A_W = A\, C^T`. An error on the reference
side has the axes of the filter's own world: :math:`P_b = A_W P_W A_W^T`.

Rows come in stretches: the readings of one are copied for the filter, stepped through,
and compared with what they were; its answers are checked together, and its time taken.
So a row costs little more than the filter itself. Our own filter takes a stretch in one
call, and is not run again: that it keeps nothing is shown by its tests.

State that outlives a run, and trials of a batch that depend on each other, are told by
answers that differ.

Some trials are asked again, in another order and then fewer of them: their answers must
be what they were. So it is found whatever is kept, a mean, a last answer or a count of
calls, and in a batch also what depends on a place or on what stands beside it. An
answer that is kept for good is the same again; but then it is that of other trials too.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from time import perf_counter
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.arrays import Array, Places
from simval.errors import PluginError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    normalize,
)
from simval.imu.filters import Mekf
from simval.imu.filters.signals import FilterInput, FilterOutput
from simval.plugins.answers import Form, called, ended, form_of
from simval.plugins.attitudes import WORLD_AXES, package_quaternion, tail
from simval.plugins.child import answered, where_it_lives
from simval.plugins.protocol import Filter
from simval.shapes import Float


def from_scene(world: str) -> Float[Array, "3 3"]:
    """Matrix C from NWU, the world of the scenes, to another world."""
    north, up = (np.array(axis) for axis in WORLD_AXES[world])
    return np.stack([north, np.cross(up, north), up], axis=1)


def _quaternion(world: str) -> Float[Array, "4"]:
    # A(c) = C: of the package's quaternions that which is written "active" as C itself
    return package_quaternion(from_scene(world)[None], "matrix", "active")[0]


QUATERNIONS: Final[Mapping[str, Array]] = MappingProxyType(
    {world: _quaternion(world) for world in WORLD_AXES}
)
"""From NWU to each world."""


def written(filter: Filter, q: Float[Array, "... 4"], world: str) -> Array:
    """Attitudes as a filter with that world would write them."""
    own = compose(conjugate(QUATERNIONS[world]), normalize(q))
    if filter.components == "matrix":
        A = attitude_matrix(own)
        return A if filter.matrix == "active" else A.mT.copy()
    if filter.matrix == "active":
        own = conjugate(own)
    return np.roll(own, 1, axis=-1) if filter.components == "sxyz" else own


def own_quaternions(filter: Filter, raw: Float[Array, "n ..."]) -> Float[Array, "n 4"]:
    """Sound answers of a filter as quaternions from its own world to the body."""
    return normalize(package_quaternion(raw, filter.components, filter.matrix))


def to_scene(own: Float[Array, "... 4"], world: str) -> Float[Array, "... 4"]:
    """Attitudes from NWU to the body, from those of another world."""
    return compose(QUATERNIONS[world], own)


def on_body_side(
    filter: Filter, covariance: Float[Array, "n p p"], own: Float[Array, "n 4"]
) -> Float[Array, "n p p"]:
    """Covariances of the error in body axes, exactly symmetric."""
    turned = covariance
    if filter.side == "reference":
        turn = np.broadcast_to(np.eye(covariance.shape[-1]), covariance.shape).copy()
        turn[:, :3, :3] = attitude_matrix(own)
        turned = turn @ covariance @ turn.mT
    return (turned + turned.mT) / 2.0


FEWER = 3
"""Of the trials every third is asked in a batch of its own size."""


DISTINCT = 0.9
"""Least share of different answers: the noise of no two trials is the same."""


def require_no_memory(
    name: str,
    first: Float[Array, "n p"],
    again: Callable[[Places], Array],
    allowed: Float[Array, "n p"],
    rounds: int = 1,
) -> None:
    """Check that answers do not depend on the order of the trials.

    Raises
    ------
    PluginError
        If they have not: `first` and what ``again(places)`` gives differ by more than
        is allowed.
    """
    distinct = len(np.unique(first[:, np.isfinite(allowed).all(axis=0)], axis=0))
    if distinct < DISTINCT * len(first):
        msg = (
            f"{name} gives {distinct} different answers to {len(first)} trials "
            "with different noise: estimate each from its own readings, and "
            "keep nothing from one call to the next"
        )
        raise PluginError(msg)
    rng = np.random.default_rng(20_275)
    orders = [rng.permutation(len(first)) for _ in range(rounds)]
    for places in chain.from_iterable((order, order[::FEWER]) for order in orders):
        apart = np.abs(again(places) - first[places]) / allowed[places]
        if not np.all(apart <= 1.0):
            count = int(np.sum(~np.all(apart <= 1.0, axis=1)))
            msg = (
                f"{name} answers {count} of {len(places)} trials differently when "
                "they are asked again in another order: keep nothing from one call "
                "to the next, and in a batch let no row depend on its place or on "
                "the others"
            )
            raise PluginError(msg)


SENSORS: Final = ("gyroscope", "accelerometer", "magnetometer")

LEAST_ROWS: Final = 128
MOST_ROWS: Final = 1024
STRETCHES: Final = 64
"""A run has about so many, of `LEAST_ROWS` to `MOST_ROWS` rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """Readings for each step of a filter, in its own conventions."""

    where: str  # " of trial 3", or nothing
    lead: tuple[int, ...]  # of a batch, the number of trials
    dt: Float[Array, " T"]
    end: Float[Array, " T"]  # time at the end of each step, s
    sensors: tuple[Float[Array, "T ..."], ...]
    reads: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """Answers of a run at the kept rows, in the filter's own conventions."""

    words: dict[str, Float[Array, "k ..."]]
    rows: Places  # (s,), of each stretch
    seconds: Float[Array, " s"]  # of each stretch


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
    """Make a new filter, yield the function that steps it, and close it at the end."""
    # its own copies, which it may keep and change
    own = {
        word: value.copy() if isinstance(value, np.ndarray) else value
        for word, value in readings.reads.items()
    }
    found = called(f"`make` of {filter.name}", filter.make, **own)
    update = getattr(found, "update", found)
    if not callable(update):
        msg = (
            f"`make` of {filter.name} returned {type(found).__name__}, which "
            "has no `update`; return an object with `update`, or that function "
            "itself"
        )
        raise PluginError(msg)
    close = getattr(found, "close", None)
    try:
        yield update
    except BaseException:
        if callable(close):
            with suppress(PluginError):
                called(f"`close` of {filter.name}", close)
        raise
    if callable(close):
        called(f"`close` of {filter.name}", close)


def run_of(filter: Filter, readings: Readings, keep: Places) -> Run:
    """Make a new filter and step it through all rows (`stepped`)."""
    with making(filter, readings) as update:
        return stepped(filter, update, readings, keep)


def run_once(filter: Filter, given: FilterInput) -> Run:
    """Run a filter over the first trial, in NWU if it leaves the world open."""
    first = slice(0, 1) if filter.batch else 0
    readings = readings_of(filter, given, first, filter.world or "NWU")
    return run_of(filter, readings, np.array([len(given.dt) - 1]))


def stepped(
    filter: Filter,
    update: Callable[..., Any],
    readings: Readings,
    keep: Places,
) -> Run:
    """Step a filter through all rows, and keep its answers at some.

    Raises
    ------
    PluginError
        If it raises, changes its readings, or an answer breaks a rule; with the row.
    """
    edges = stretches(len(readings.dt))
    own: Any = getattr(update, "__self__", None)
    ours = type(own) is Mekf and getattr(update, "__func__", None) is Mekf.update
    form: Form | None = None
    found: list[list[Array]] = []
    seconds: list[float] = []
    for first, last in pairwise(edges.tolist()):
        rows = slice(first, last)
        columns = [np.array(a[rows], order="C") for a in readings.sensors]
        given = [readings.dt[rows].tolist(), *(list(a) for a in columns)]
        row, put, arrays = -1, None, list[Array]()
        kept = keep[(keep >= first) & (keep < last)] - first
        judged = np.arange(last - first)
        if form is not None:
            put, arrays = form.storing(last - first)
        start = perf_counter()
        try:
            if ours:
                given = [[] for _ in given]
                answers = own.update_rows(readings.dt[rows], *columns)
                columns = []  # which it does not change
                one = {word: a[0] for word, a in answers.items()}
                form = form or form_of(filter, one, readings.lead)
                # what is kept, and the last row, to which a NaN is carried on
                judged = np.union1d(kept, judged[-1])
                arrays = [answers[word][judged] for word in form.shapes]
            for row, values in enumerate(zip(*given, strict=True)):
                answer = update(*values)
                if put is None:
                    form = form_of(filter, answer, readings.lead)
                    put, arrays = form.storing(last - first)
                put(row, answer)
        except (Exception, SystemExit) as error:  # whatever a user's filter may raise
            where = f", {place(readings, first + max(row, 0))}"
            raise ended(filter.name, error, where) from error
        seconds.append(perf_counter() - start)
        answered((last - first) * math.prod(readings.lead))
        _require_unchanged(filter, readings, rows, columns)
        assert form is not None
        if fault := form.fault(arrays):
            row, words = fault
            msg = f"{words}, {place(readings, first + int(judged[row]))}"
            raise PluginError(msg)
        found.append([a[np.searchsorted(judged, kept)] for a in arrays])
    assert form is not None
    whole = [np.concatenate(each) for each in zip(*found, strict=True)]
    return Run(
        words=dict(zip(form.shapes, whole, strict=True)),
        rows=np.diff(edges),
        seconds=np.array(seconds),
    )


def stretches(rows: int) -> Places:
    """First rows of the stretches into which rows are cut, and the end."""
    length = min(max(-(-rows // STRETCHES), LEAST_ROWS), MOST_ROWS)
    return np.linspace(0, rows, max(rows // length, 1) + 1).astype(np.intp)


def place(readings: Readings, row: int) -> str:
    """Say which row it is, and when."""
    return f"at row {row} ({readings.end[row]:.6g} s){readings.where}"


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
                f"{filter.name} changes its input: the reading of the {name} is "
                f"different after the step {place(readings, row)}; work on a copy"
            )
            raise PluginError(msg)


FIRST: Final = 100
"""Rows of one trial of a batch alone."""

AGAIN: Final = 1000
"""Rows of a batch that is run again."""

ALONE: Final = 1e-9
"""Attitude error of a trial alone, rad, whose sums may be rounded in another order."""


def require_the_same_again(
    filter: Filter, readings: Readings, rows: Places, before: Run
) -> None:
    """Check that a new filter gives bit-equal answers to the same readings.

    Of a batch, which is all trials, it is asked for the beginning alone.
    """
    if readings.lead:
        readings = beginning(readings, max(AGAIN, int(rows[0]) + 1))
        rows = rows[rows < len(readings.dt)]
        words = {word: values[: len(rows)] for word, values in before.words.items()}
        before = replace(before, words=words)
    again = run_of(filter, readings, rows)
    if difference := _difference(filter, before, again):
        row, said = difference
        msg = (
            f"{filter.name} answers the same readings differently when they are run "
            f"again: {said}, {place(readings, int(rows[row]))}; it keeps state "
            "between runs, or draws random numbers: `make` must return a fresh filter, "
            "with nothing kept in the module or the class, and a generator seeded anew"
        )
        raise PluginError(msg)


def require_trials_alone(filter: Filter, batch: Readings, alone: Readings) -> None:
    """Check that a batch's first trial is answered as it is when alone."""
    batch, alone = beginning(batch), beginning(alone)
    rows = np.arange(len(batch.dt))
    runs = [run_of(filter, own, rows) for own in (batch, alone)]
    q = [own_quaternions(filter, run.words["attitude"][:, 0]) for run in runs]
    off = np.atleast_1d(attitude_error(*q))
    if not off.max() <= ALONE:
        row = int(off.argmax())
        msg = (
            f"{filter.name}: the first of {batch.lead[0]} trials differs from "
            f"the same trial alone, by {off[row]:.3g} rad {place(batch, row)}; "
            "the trials of a batch must not depend on each other"
        )
        raise PluginError(msg)


def beginning(readings: Readings, count: int = FIRST) -> Readings:
    """The first few rows of some readings."""
    rows = slice(0, count)
    return replace(
        readings,
        dt=readings.dt[rows],
        end=readings.end[rows],
        sensors=tuple(a[rows] for a in readings.sensors),
    )


def _difference(filter: Filter, before: Run, now: Run) -> tuple[int, str] | None:
    """First kept row in which two runs differ, and how."""
    if before.words.keys() != now.words.keys():
        return 0, f"{', '.join(now.words)} instead of {', '.join(before.words)}"
    found = []
    for word, values in before.words.items():
        other = now.words[word]
        if other.shape != values.shape:
            return 0, f"`{word}` of another shape"
        same = np.equal(values, other).reshape(len(values), -1).all(axis=1)
        if same.all():
            continue
        apart = f"{np.abs(values - other).max():.2g}"
        if word == "attitude":
            own = tail(filter.components)
            q = [own_quaternions(filter, a.reshape(-1, *own)) for a in (values, other)]
            apart = f"{attitude_error(*q).max():.2g} rad"
        found.append((int(np.argmin(same)), f"`{word}` by up to {apart}"))
    return min(found, default=None)


PARTS: Final = 8
"""Of a run, whose times are given."""


@where_it_lives
def run_filter(
    filter: Filter, given: FilterInput, keep: Places, world: str
) -> FilterOutput:
    """Run a filter over the readings of some trials.

    Parameters
    ----------
    filter : Filter
        As it declares itself; its `world` is not asked.
    given : FilterInput
        Readings of n trials.
    keep : NDArray
        Rows whose answers are kept, increasing, (k,).
    world : str
        World frame that it has; see `simval.plugins.worlds`.

    Returns
    -------
    FilterOutput
        Its answers at these rows, in the package's conventions.

    Raises
    ------
    PluginError
        If it raises, breaks a rule of its answers, changes its input, or keeps
        state between runs.
    """
    assert (np.diff(keep) > 0).all(), "rows increase"
    assert 0 <= keep[0] <= keep[-1] < len(given.dt), "rows are those of the readings"
    trials: list[int | slice] = list(range(len(given.start)))
    if filter.batch:
        trials = [slice(0, len(given.start))]
    each = [readings_of(filter, given, own, world) for own in trials]
    runs = [run_of(filter, own, keep) for own in each]
    _require_one_form(filter, runs)
    if filter.make is not Mekf:
        require_the_same_again(filter, each[0], keep, runs[0])
        if filter.batch:
            alone = readings_of(filter, given, slice(0, 1), world)
            require_trials_alone(filter, each[0], alone)
    words = {
        word: np.ascontiguousarray(np.moveaxis(first, 1, 0))
        if filter.batch
        else np.stack([run.words[word] for run in runs])
        for word, first in runs[0].words.items()
    }
    raw, covariance = words["attitude"], words.get("covariance")
    n, k = raw.shape[:2]
    own = own_quaternions(filter, raw.reshape(n * k, *raw.shape[2:]))
    if covariance is not None:
        flat = covariance.reshape(n * k, *covariance.shape[2:])
        covariance = on_body_side(filter, flat, own).reshape(covariance.shape)
    return FilterOutput(
        kept=keep,
        attitude=to_scene(own, world).reshape(n, k, 4),
        covariance=covariance,
        seconds=np.median([row_times(each[0], run) for run in runs], axis=0),
        bias=words.get("bias"),
        innovation=words.get("innovation"),
        innovation_covariance=words.get("innovation_covariance"),
    )


def _require_one_form(filter: Filter, runs: list[Run]) -> None:
    """Check that all trials are answered in the same words and shapes."""
    forms = [
        ", ".join(f"{word} {a.shape[1:]}" for word, a in run.words.items())
        for run in runs
    ]
    for trial, form in enumerate(forms):
        if form != forms[0]:
            msg = (
                f"{filter.name} answers trial {trial} with {form} and trial 0 "
                f"with {forms[0]}; every trial must have the same"
            )
            raise PluginError(msg)


def row_times(first: Readings, run: Run) -> Float[Array, " q"]:
    """Time that a row of one trial takes, in each part of a run, s."""
    parts = min(PARTS, len(run.rows))
    trials = first.lead[0] if first.lead else 1
    pairs = zip(
        np.array_split(run.seconds, parts),
        np.array_split(run.rows, parts),
        strict=True,
    )
    return np.array([t.sum() / r.sum() / trials for t, r in pairs])
