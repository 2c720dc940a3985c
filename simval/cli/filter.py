"""What `simval filter` does."""

import json
from pathlib import Path
from typing import Any

import click

from simval.cli.filter_object import evaluation_object, truth_object
from simval.cli.filter_words import alignment_lines, filter_lines
from simval.cli.noise_units import accelerometer_scale, gyro_scale
from simval.cli.options import refuse_if, write
from simval.cli.reproduced import command_again
from simval.cli.taken import log_object
from simval.cli.terminal import say
from simval.errors import CrashedPluginError, InputError, PluginError
from simval.logs import Log, Truth, read_log, read_truth
from simval.logs.truth import quaternion_stems
from simval.noise import load_noise
from simval.recorded import Alignment, Evaluation, align, evaluate
from simval.recorded.evaluation import filters_of, run_on_log
from simval.recorded.settings import (
    Signals,
    Start,
    rests_of_log,
    signals,
    start_of,
    with_gyro_unit,
)
from simval.recorded.world import TruthWorld
from simval.statics import interval_means

FORMAT = "simval filter 1"


def run(
    path: Path,
    plugins: tuple[str, ...],
    truth: str | None,
    truth_columns: str | None,
    truth_rate: float | None,
    truth_world: TruthWorld | None,
    calibration: Path | None,
    noise: Path | None,
    rate: float | None,
    columns: str | None,
    accelerometer_unit: str | None,
    gyro_unit: str | None,
    time_limit: float,
    out: Path | None,
    page: Path | None,
    as_json: bool,
) -> int:
    """Do what `simval filter` is asked."""
    filters = filters_of(plugins)
    log = read_log(path, rate, columns)
    recorded = truth_of(log, truth, truth_columns, truth_rate)
    units = accelerometer_unit, gyro_unit
    found, alignment = prepared(log, recorded, calibration, units, truth_world)
    start = start_of(found, None if noise is None else load_noise(noise), str(noise))
    head = [*log.described(), *found.said(), *start.said]
    head += alignment_lines(alignment, recorded, found)
    head += _offered(path) if recorded is None else []
    say([] if as_json else head)
    done, failed, code = _evaluated(filters, found, start, alignment, time_limit)
    written = as_object(log, found, start, alignment, recorded) | {
        "filters": [evaluation_object(each) for each in done],
        "failed": failed,
    }
    if out is not None:
        write(out, json.dumps(written, allow_nan=False, indent=1) + "\n")
    if page is not None:
        _write_page(page, log, head, done, failed)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
    else:
        say(["", *filter_lines(done, failed, alignment is not None)])
    return code


def _write_page(
    page: Path,
    log: Log,
    said: list[str],
    done: list[Evaluation],
    failed: dict[str, str],
) -> None:
    from simval.report.filter_page import filter_page  # starts the drawing
    from simval.report.log_page import render_log

    write(page, render_log(filter_page(log, said, done, failed, command_again())))


def truth_of(
    log: Log, truth: str | None, columns: str | None, rate: float | None
) -> Truth | None:
    """Recorded attitudes: columns of the log, a file of their own, or none."""
    if truth is not None and Path(truth).is_file():
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
    return read_truth(log.path, stem=stem, columns=columns, clock=log.time)


def prepared(
    log: Log,
    recorded: Truth | None,
    calibration: Path | None,
    units: tuple[str | None, str | None],
    world: TruthWorld | None = None,
) -> tuple[Signals, Alignment | None]:
    """Readings in SI units, and the truth aligned with them."""
    rests = rests_of_log(log)
    accelerometer = accelerometer_scale(
        log, interval_means(log.accelerometer, rests), units[0]
    )
    gyro = gyro_scale(log, units[1])
    found = signals(
        log,
        rests,
        accelerometer=(accelerometer.si_per_raw, accelerometer.how),
        gyro=(gyro.si_per_raw, gyro.how),
        calibration=None if calibration is None else str(calibration),
    )
    if recorded is None:
        return with_gyro_unit(found, None), None
    alignment = align(
        recorded,
        found.time,
        found.gyro,
        found.force,
        found.field,
        found.rests,
        world,
    )
    return with_gyro_unit(found, alignment.fit.scale), alignment


def _offered(path: Path) -> list[str]:
    stems = quaternion_stems(str(path))
    if not stems:
        return []
    named = ", ".join(stem.rstrip("_.- ") or "log" for stem in stems)
    return [f"quaternions       {named}: if that is the truth, give it (--truth NAME)"]


def _evaluated(
    filters: dict[str, str],
    found: Signals,
    start: Start,
    alignment: Alignment | None,
    time_limit: float,
) -> tuple[list[Evaluation], dict[str, str], int]:
    # what was measured, why others were not, and the exit code of that
    done, failed, code = [], {}, 0
    for name, word in filters.items():
        try:
            run = run_on_log(name, word, found, start, time_limit)
        except PluginError as error:
            failed[name] = str(error)
            code = 4 if isinstance(error, CrashedPluginError) else max(code, 3)
            continue
        done.append(evaluate(run, found, alignment))
    return done, failed, code


def as_object(
    log: Log,
    found: Signals,
    start: Start,
    alignment: Alignment | None,
    recorded: Truth | None,
) -> dict[str, Any]:
    """The log, what filters were told, and the truth, as plain JSON values."""
    told = start.told
    return {
        "format": FORMAT,
        **log_object(log),
        "units": {
            "gyroscope": found.gyro_unit,
            "accelerometer": found.force_unit,
            "magnetometer": found.field_unit or None,
        },
        "rests": found.rests.tolist(),
        "start": {"row": start.row, "attitude": start.attitude.tolist()},
        "told": {
            "gyroscope_noise": told.gyroscope_noise,
            "gyroscope_walk": told.gyroscope_walk,
            "accelerometer_noise": told.accelerometer_noise,
            "magnetometer_noise": told.magnetometer_noise,
            "gravity": told.gravity,
            "field": told.field.tolist(),
            "start_std": told.start_std,
            "bias_std": told.bias_std,
        },
        "truth": None
        if alignment is None or recorded is None
        else truth_object(alignment, recorded),
    }
