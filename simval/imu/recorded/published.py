r"""Errors by a benchmark's own definitions, and the steps from these to simval's.

BROAD (D. Laidig, M. Caruso, A. Cereatti and T. Seel, Data 6(7):72, 2021; the program of
their repository, `example_code`) starts a filter at the first row of a trial, by that
row's specific force and field, and gives it every row from the first on. Its truth is
as recorded, row by row on the log's clock. The rows that count are those that the trial
marks as `movement` and that have a truth. With the error quaternion d in the world,
scalar w and vertical part z, their errors are

.. math:: e = 2 \arccos |w|, \quad e_h = 2 \arctan |z / w|, \quad
   e_i = 2 \arccos \sqrt{w^2 + z^2}, \tag{R5}

which are those of (R4) but for the sign of heading, and a trial has their RMS.

Ours differ in four ways, which are changed one after the other: the start (at the first
rest, by the mean of its rows), the truth (clock, axes and world found from the log),
and the rows (all with a truth from the start on).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from simval.errors import InputError, RefusedError
from simval.imu.logs import Log, Truth
from simval.imu.logs.readers import read_table
from simval.imu.recorded.alignment import Alignment
from simval.imu.recorded.attitudes import composed, meant, of_matrix
from simval.imu.recorded.errors import errors_of, table
from simval.imu.recorded.evaluation import FilterRun, Stage, resting
from simval.imu.recorded.settings import Signals, Start, two_vectors
from simval.imu.recorded.world import World
from simval.shapes import Bool

MARKS: Final = "movement"


def published_start(found: Signals, start: Start) -> Start:
    """A start before the first row, at the attitude that this row alone gives.

    Raises
    ------
    InputError
        If the log has no magnetometer.
    """
    if found.field is None:
        msg = (
            "`--as-published` starts a filter by the first row's specific force and "
            "field, and the log has no magnetometer; leave the option out"
        )
        raise InputError(msg)
    return replace(start, row=-1, attitude=two_vectors(found, slice(0, 1)))


def published_rows(
    log: Log, recorded: Truth | None, world: World | None, instance: str | None
) -> tuple[Truth, Bool[np.ndarray, " n"]]:
    """The truth for this comparison, and the rows whose errors count.

    Raises
    ------
    InputError
        If the truth is not of the log's own rows and of a world of its own, or the log
        does not mark its movement.
    """
    if recorded is None or world is None or recorded.own_clock:
        msg = (
            "`--as-published` compares row by row with attitudes in the log's own "
            "rows; give their columns (--truth NAME)"
        )
        raise InputError(msg)
    if world.taken == "estimated":
        msg = (
            "`--as-published` takes the truth's world as it is recorded; state it "
            "(--truth-world ENU), or leave --truth-world out"
        )
        raise InputError(msg)
    table = read_table(log.path, instance)
    if log.of_file is not None:
        table = table.rows(log.of_file)
    places = [k for k, name in enumerate(table.names or ()) if name == MARKS]
    if not places:
        msg = (
            f"{log.path} has no column `{MARKS}`, and by `--as-published` errors are "
            "of the rows alone that it marks with 1; add it, or leave the option out"
        )
        raise InputError(msg)
    marks = table.numbers(places[:1])[:, 0]
    if not np.isin(marks, (0.0, 1.0)).all() or not marks.any():
        msg = (
            f"{log.path}: column `{MARKS}` must hold 0 and 1, and some 1; it marks the "
            f"rows that errors are of, and holds {np.unique(marks)[:3].tolist()}"
        )
        raise InputError(msg)
    return recorded, marks == 1.0


def steps(
    first: FilterRun,
    own: FilterRun,
    found: Signals,
    recorded: Truth,
    alignment: Alignment,
    movement: Bool[np.ndarray, " n"],
) -> Iterator[Stage]:
    """Errors while the published definitions are changed to simval's, one by one.

    Parameters
    ----------
    first : FilterRun
        Answers of the filter started as published.
    own : FilterRun
        Its answers as started by us.
    found : Signals
        The log.
    recorded : Truth
        Its truth, row by row.
    alignment : Alignment
        The same, aligned.
    movement : Array
        Rows that the published errors are of, (n,).

    Yields
    ------
    Stage
        Errors after each change.

    Raises
    ------
    RefusedError
        If no row that is marked has a truth and an answer.
    """
    raw = meant(recorded.components, alignment.meaning)
    raw = composed(of_matrix(alignment.world.matrix.T), raw)
    everything = np.ones_like(movement)
    for words, run, truth, rows in (
        ("as published", first, raw, movement),
        ("started at the first rest, by its mean", own, raw, movement),
        ("truth's clock and axes found", own, alignment.attitude, movement),
        ("all rows with a truth: as above", own, alignment.attitude, everything),
    ):
        kept = run.output.kept
        there = rows[kept] & np.isfinite(truth[kept]).all(axis=1)
        if not there.any():
            msg = (
                "no row that `movement` marks has a recorded attitude; check both "
                "columns"
            )
            raise RefusedError(msg)
        at = kept[there]
        errors = errors_of(
            found.time[at], truth[at], run.output.attitude[0][there], resting(found)[at]
        )
        yield Stage(words=words, rms=table(errors)["all"])
