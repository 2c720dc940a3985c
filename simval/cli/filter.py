"""`simval filter`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import (
    AccelerometerUnit,
    AsJson,
    Columns,
    From,
    GyroDelay,
    GyroUnit,
    Instance,
    LogPath,
    Number,
    OutFile,
    Page,
    Positive,
    Rate,
    RowsOf,
    Until,
    command_again,
    declared,
    refuse_if,
    refusing,
    with_rows,
    write,
)
from simval.cli.terminal import show
from simval.errors import (
    CrashedPluginError,
    InputError,
    PluginError,
    UnusablePluginError,
)
from simval.vocabulary import FILTER_SECONDS, TruthWorld

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from simval.account import Account
    from simval.imu.logs import Log, Truth
    from simval.imu.recorded import Alignment, Evaluation
    from simval.imu.recorded.description import FilteredLog
    from simval.imu.recorded.evaluation import FilterRun
    from simval.imu.recorded.settings import Signals, Start
    from simval.imu.recorded.world import TruthWorld
    from simval.plugins.protocol import Filter

MOST_ROWS = 200_000
"""Rows whose answers are kept: covariances of six by six are then 60 MB. Of a longer
log rows are left out evenly."""


@declared("filter")
def command(
    path: LogPath,
    plugins: Annotated[
        tuple[str, ...],
        "A filter: FILE.py, FILE.py:NAME, or the name of an installed one; may be "
        "repeated to compare several.",
        dict(name="--plugin", metavar="PLUGIN"),
    ],
    truth: Annotated[
        str | None,
        "Recorded attitudes: the common name of four columns of LOG ('log' if it has "
        "only four), or another file.",
        dict(metavar="NAME|FILE"),
    ] = None,
    truth_columns: Annotated[
        str | None,
        "The columns of the truth's file in their order, as t,qx,qy,qz,qs (or "
        "q0,q1,q2,q3), with - for one to ignore.",
        dict(metavar="NAMES"),
    ] = None,
    truth_rate: Annotated[
        float | None,
        "Rows per second of a truth's file that has no clock.",
        dict(metavar="HZ"),
    ] = None,
    truth_world: Annotated[
        TruthWorld | None,
        "World of the truth; 'estimated' turns it to the log's own magnetometer.  "
        "[default: that of its data set, else the nearest]",
    ] = None,
    truth_axes: Annotated[
        str | None,
        "What the sensor's x, y and z point along in the truth's body, as "
        "x,-y,-z, within 30 degrees; needed if the log allows two readings "
        "of the truth.",
        dict(metavar="AXES"),
    ] = None,
    calibration: Annotated[
        Path | None,
        "Correct the log first, by a JSON file that `simval calibrate --out` wrote.",
    ] = None,
    noise: Annotated[
        Path | None,
        "Noise given to the filters, a file made by `simval noise LOG --json`.  "
        "[default: measured in the log's rests]",
    ] = None,
    accelerometer_noise: Annotated[
        Positive | None,
        "Noise of the accelerometer for the filters, per row and axis, "
        "m/s^2. A log with motion needs more than the scatter at rest, "
        "because of the accelerations that are not gravity.  [default: "
        "measured in the log's rests]",
        dict(metavar="STD"),
    ] = None,
    as_published: Annotated[
        bool,
        "Also measure by the definitions of the benchmark BROAD: started "
        "at the first row, truth as recorded, rows marked by the column "
        "`movement`.",
    ] = False,
    rate: Rate = None,
    columns: Columns = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    accelerometer_unit: AccelerometerUnit = None,
    gyro_unit: GyroUnit = None,
    gyro_rows: RowsOf = "found",
    gyro_delay: GyroDelay = 0.0,
    time_limit: Annotated[
        float,
        Number(0.0, 86_400.0, min_open=True),
        "Time that each filter may take.",
        dict(metavar="SECONDS"),
    ] = FILTER_SECONDS,
    out: Annotated[OutFile | None, "Write the result to this JSON file."] = None,
    page: Page = None,
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print everything: every digit, what each answer rests on, and how "
        "log and truth were read.",
    ] = False,
) -> int:
    """Run attitude filters over a recorded LOG and measure their errors.

    LOG must have a gyroscope, an accelerometer and at least one rest. Its columns and
    its clock are read as by `simval calibrate`. If the log has no magnetometer, give a
    filter that needs none (simval:mekf-six, or magnetometer=False); its heading is
    measured from its start.

    With --truth, errors are measured against recorded attitudes; their clock and axes
    are found from the log and stated with error bars, and their world is compared
    with the one that the log shows. Without --truth, the command can only show what a
    filter says about itself.

    Exit code 0 measured, 2 unreadable input, 3 refused, 4 a filter crashed.
    """
    from simval.imu.logs import read_log
    from simval.imu.multiposition.description import with_log
    from simval.imu.noise import load_noise
    from simval.imu.recorded.alignment import prepared, stated_axes
    from simval.imu.recorded.description import FilteredLog
    from simval.imu.recorded.published import published_rows, published_start
    from simval.imu.recorded.settings import longest_part, start_of

    filters = filters_of(plugins)
    refuse_if(
        truth_axes is not None and truth is None and truth_columns is None,
        "`--truth-axes` is of a truth; give that (--truth NAME or FILE)",
    )
    axes = None if truth_axes is None else stated_axes(truth_axes)
    log = read_log(path, rate, columns, instance, start=start, stop=stop)
    log = longest_part(log)
    with refusing(log):
        log = with_rows(log, gyro_rows, gyro_delay)
        recorded = truth_of(log, truth, truth_columns, truth_rate, instance)
        units = accelerometer_unit, gyro_unit
        found, alignment = prepared(
            log,
            recorded,
            calibration,
            units,
            truth_world,
            find_rows=gyro_rows == "found",
            axes=axes,
        )
        begin = start_of(
            found,
            None if noise is None else load_noise(noise),
            str(noise),
            accelerometer_noise=accelerometer_noise,
        )
    more = None
    if as_published:
        world = None if alignment is None else alignment.world
        truth_rows, marks = published_rows(log, recorded, world, instance)
        more = truth_rows, marks, published_start(found, begin)
    done, failed, code = _evaluated(filters, found, begin, alignment, time_limit, more)
    whole = FilteredLog(
        found=found,
        start=begin,
        done=tuple(done),
        failed=failed,
        alignment=alignment,
        recorded=recorded,
        quaternions=_offered(path, instance) if recorded is None else (),
    )
    account = with_log(whole.account, log)
    if out is not None or as_json:
        written = whole.as_object(log) | account.as_object()
    if out is not None:
        write(out, json.dumps(written, allow_nan=False, indent=1) + "\n")
    if page is not None:
        _write_page(page, log, whole, account)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
    else:
        show(account, verbose=verbose)
    return code


def _write_page(page: Path, log: Log, whole: FilteredLog, account: Account) -> None:
    from simval.report.filter_page import filter_page  # starts the drawing
    from simval.report.log_page import render_log

    write(page, render_log(filter_page(log, whole, account, command_again())))


def truth_of(
    log: Log,
    truth: str | None,
    columns: str | None,
    rate: float | None,
    instance: str | None,
) -> Truth | None:
    """Read the true attitudes from columns of the log or a file; None without."""
    from simval.imu.logs import read_truth

    if truth is not None and truth != "log" and Path(truth).exists():
        return read_truth(truth, columns=columns, rate=rate)
    refuse_if(
        rate is not None,
        "`--truth-rate` is for a truth in a file of its own; give that (--truth FILE)",
    )
    if truth is None and columns is None:
        return None
    if truth is not None and truth.lower().endswith((".csv", ".txt", ".mat", ".tsv")):
        msg = f"cannot read {truth}: there is no such file; give the path of the truth"
        raise InputError(msg)
    stem = "" if truth in (None, "log") else str(truth)
    return read_truth(
        log.path, stem=stem, columns=columns, clock=log.time, instance=instance,
        rows=log.of_file,
    )  # fmt: skip


def _offered(path: Path, instance: str | None) -> tuple[str, ...]:
    from simval.imu.logs.truth import quaternion_stems

    stems = quaternion_stems(str(path), instance)
    return tuple(stem.rstrip("_.- ") or "log" for stem in stems)


def filters_of(plugins: Sequence[str]) -> dict[str, str]:
    """Name each filter as a table calls it, with the word that loads it.

    Raises
    ------
    UnusablePluginError
        If one cannot be loaded, or holds no filter.
    """
    from simval.plugins.loading import meant
    from simval.plugins.protocol import Filter

    found: dict[str, str] = {}
    for plugin in plugins:
        held = [each for each in meant(plugin) if each.field == Filter.taken_by]
        if not held:
            msg = (
                f"{plugin} holds no Filter; only a Filter runs over a log, so give "
                "the file of one"
            )
            raise UnusablePluginError(msg)
        for each in held:
            found[each.name if each.name not in found else each.word] = each.word
    return found


def run_on_log(
    name: str,
    algorithm: str,
    found: Signals,
    start: Start,
    time_limit: float,
    alignment: Alignment | None = None,
) -> FilterRun:
    """Run one filter over a log in a child process.

    Raises
    ------
    PluginError
        If it cannot be loaded, breaks a rule of its answers, stays in no world, or
        does not end in time.
    """
    import numpy as np

    from simval.imu.recorded.evaluation import (
        FilterRun,
        filter_input,
        given_rows,
        in_view,
    )
    from simval.plugins.child import started
    from simval.plugins.loading import find_plugin
    from simval.plugins.protocol import Filter
    from simval.plugins.runs import run_filter
    from simval.plugins.worlds import find_world

    longer = "give it more time by --time-limit"
    with started(time_limit, f"the filter {name}", longer) as child:
        filter = child.ask(find_plugin, algorithm, Filter)
        if found.field is None:
            _require_six(filter)
        if not filter.magnetometer and alignment is not None:
            start = in_view(start, found, alignment.attitude)
        given = filter_input(found, start)
        stride = -(-len(given.dt) // MOST_ROWS)
        keep = np.arange(stride - 1, len(given.dt), stride)
        rate = 1.0 / float(np.median(given.dt))
        child.expect(len(given.dt), "rows")
        world = find_world(filter, given.told, rate)
        child.measure()
        output = run_filter(filter, given, keep, world.world)
    how = "declared" if filter.world else "found"
    at = "" if filter.magnetometer else f"; it starts at {found.time[start.row]:.2f} s"
    return FilterRun(
        name=name,
        world=world.world,
        how=f"{how}: {world.words}{at}",
        output=replace(output, kept=output.kept + given_rows(found, start).start),
        six=None if filter.magnetometer else start,
        thinned=stride > 1,
        told=start.of_nis(filter.reads, 1 + filter.magnetometer),
        motion=start.motion,
        cautious=start.limit and "gyroscope_walk" in filter.reads,
    )


def _require_six(filter: Filter) -> None:
    unknown = {"field", "magnetometer_noise"}.intersection(filter.reads)
    if filter.magnetometer:
        msg = (
            "it takes a magnetometer and the log has none; give a "
            "filter of six axes (simval:mekf-six, or your own with "
            "magnetometer=False), or name the columns of the magnetometer "
            "(--columns)"
        )
        raise UnusablePluginError(msg)
    if unknown:
        msg = (
            f"it reads `{'`, `'.join(sorted(unknown))}`, which a log "
            "without a magnetometer cannot give; take them out of its `reads`"
        )
        raise UnusablePluginError(msg)


def _evaluated(
    filters: dict[str, str],
    found: Signals,
    start: Start,
    alignment: Alignment | None,
    time_limit: float,
    published: tuple[Truth, NDArray[np.bool_], Start] | None,
) -> tuple[list[Evaluation], dict[str, str], int]:
    # what was measured, why others were not, and the exit code of that
    from simval.imu.recorded import evaluate
    from simval.imu.recorded.published import steps
    from simval.studies.filter_prediction import six_axis_bound

    done, failed, code = [], {}, 0
    bound = None
    for name, word in filters.items():
        try:
            run = run_on_log(name, word, found, start, time_limit, alignment)
            if published is not None:
                recorded, marks, at = published
                first = run_on_log(name, word, found, at, time_limit)
        except PluginError as error:
            failed[name] = str(error)
            code = 4 if isinstance(error, CrashedPluginError) else max(code, 3)
            continue
        if run.six and alignment is not None and bound is None:
            bound = six_axis_bound(found, run.six, alignment)
        each = evaluate(run, found, alignment, bound)
        if published is not None and alignment is not None:
            changed = steps(first, run, found, recorded, alignment, marks)
            each = replace(each, published=tuple(changed))
        done.append(each)
    return done, failed, code
