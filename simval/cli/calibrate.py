"""`simval calibrate`."""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from simval.cli.options import (
    PROJECT_FILES,
    AsJson,
    Columns,
    From,
    GyroDelay,
    Instance,
    LogPath,
    Number,
    OutFile,
    Page,
    Positive,
    Rate,
    Rest,
    RowsOf,
    StatedGravity,
    Until,
    command_again,
    declared,
    numbers,
    refuse_if,
    refusing,
    stated,
    with_rows,
    write,
)
from simval.cli.terminal import say, show
from simval.errors import InputError, RefusedError
from simval.vocabulary import TARGETS, Iteration, Loss, Method, Model, Residual

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from simval.account import Account, Fact
    from simval.imu.calibrate.gravity import Gravity
    from simval.imu.logs import Log
    from simval.imu.logs.names import Measurand
    from simval.imu.multiposition import LogCalibration
    from simval.imu.multiposition.means import MeansCalibration
    from simval.imu.recorded.rows import RowEvidence
    from simval.imu.recorded.turned import TurnedCalibration


@declared("calibrate")
def command(
    path: LogPath,
    g: Annotated[StatedGravity, "Gravity where the log was recorded, m/s^2."] = 9.80665,
    g_std: Annotated[
        Positive | None,
        "Standard deviation of that gravity, m/s^2; the error bars of K "
        "then include it.  [default: taken as exact]",
        dict(name="--g-uncertainty"),
    ] = None,
    latitude: Annotated[
        float | None,
        Number(-90.0, 90.0),
        "Where the log was recorded, degrees north; gravity and its "
        "uncertainty are then those of the place, instead of --g.",
        dict(metavar="DEGREES"),
    ] = None,
    height: Annotated[
        float | None, "Height of that place above sea level.", dict(metavar="METRES")
    ] = None,
    model: Annotated[
        Model,
        "Form of the matrix: which of the equivalent, rotated matrices is reported.",
    ] = "triangular",
    rate: Rate = None,
    rest: Rest = None,
    columns: Columns = None,
    instance: Instance = None,
    start: From = None,
    stop: Until = None,
    method: Annotated[Method, "Solver of the least-squares fit."] = "lm",
    step: Annotated[Positive, "Fraction of each step that is taken, up to 1."] = 1.0,
    iteration: Annotated[
        Iteration,
        "Unknowns of the squared residual: the centre alone, or all nine "
        "with the stop rule that the sources print.",
    ] = "centre",
    residual: Annotated[Residual, "Residual whose squares are minimised."] = "squared",
    loss: Annotated[
        Loss, "Loss; all except linear give less weight to outlier poses."
    ] = "linear",
    sensors: Annotated[
        str | None,
        "What to calibrate besides the accelerometer: gyroscope, "
        "magnetometer, both separated by a comma, or none.  [default: all "
        "that the log allows]",
    ] = None,
    hemisphere: Annotated[
        Literal["unstated", "north", "south"],
        "Hemisphere of the recording; needed for a magnetometer whose axes may be "
        "left-handed.",
    ] = "unstated",
    field: Annotated[
        Positive,
        "Strength of the magnetic field there; corrected readings get its unit.",
    ] = 1.0,
    noise: Annotated[
        Path | None,
        "Measured noise of the sensors, a file made by `simval noise LOG --json`.",
    ] = None,
    leave_out: Annotated[
        str,
        "Rests to leave out, separated by commas: their numbers as printed "
        "(7,11), or times within them in s, with a decimal point (74.0).",
        dict(metavar="RESTS"),
    ] = "",
    drift: Annotated[
        bool,
        "Fit a drift of the accelerometer's bias and scale over the log, "
        "too; the parameters are then those at its middle.",
    ] = False,
    means: Annotated[
        bool,
        "Each row is the mean reading of a pose: LOG is a table of means, "
        "so no rests are looked for.",
    ] = False,
    gyro_rows: RowsOf = "found",
    gyro_delay: GyroDelay = 0.0,
    full_scale: Annotated[
        Positive | None,
        "Greatest reading that the sensor can give, in the unit of the log.",
    ] = None,
    label: Annotated[
        tuple[str, ...],
        "Note to keep in the calibration, such as date, sensor or "
        "operator; may be repeated.",
        dict(multiple=True, metavar="KEY=VALUE"),
    ] = (),
    out: Annotated[OutFile | None, "Write the calibration to this JSON file."] = None,
    page: Page = None,
    to: Annotated[
        tuple[tuple[str, Path], ...],
        "Write the calibration as parameters of a project to FILE: "
        f"{', '.join(TARGETS)}. The command says what the project cannot "
        "hold.",
        PROJECT_FILES,
    ] = (),
    as_json: AsJson = False,
    verbose: Annotated[
        bool,
        "Print everything: every digit, what each answer rests on, how the "
        "log was read, and what was tried on rests that do not fit.",
    ] = False,
) -> None:
    """Calibrate the accelerometer of a LOG, and its gyroscope and magnetometer.

    Each row of LOG is one instant, in raw counts or m/s^2. The header or --columns
    says which columns are the time and the accelerometer's x y z. Without either, 3
    columns are x y z, 4 are t x y z, 6 are x y z and the gyroscope, and 7 are t and
    those six.

    The command finds the initial rest and the static intervals, and prints the
    parameters with error bars. A gyroscope and a magnetometer are calibrated from the
    same rests; if one cannot be calibrated, the command says why. A magnetometer alone
    is calibrated from all rows, while it is turned by hand.
    """
    from simval.cli.late import postpone

    postpone()
    from simval.imu.calibrate.files import write_json
    from simval.imu.logs import read_log
    from simval.imu.logs.log import require_no_means
    from simval.imu.multiposition import calibrate_log, calibrate_sensors
    from simval.imu.multiposition.description import (
        as_object,
        log_object,
        sensors_object,
        with_log,
    )
    from simval.imu.multiposition.record import record_facts
    from simval.imu.noise import load_noise
    from simval.imu.recorded.description import row_facts, rows_object
    from simval.theory import calibration_moments

    out_of, labels = rests_of(leave_out), labels_of(label)
    gravity = gravity_of(g, g_std, latitude, height)
    record = tuple(record_facts(labels, gravity))
    alone: tuple[Measurand, ...] = ("gyro", "mag") if means else ("mag",)
    log = read_log(
        path, rate, columns, instance, start=start, stop=stop,
        alone=alone, means=means,
    )  # fmt: skip
    options: dict[str, Any] = dict(
        model=model, method=method, step=step, iteration=iteration, residual=residual,
        loss=loss, full_scale=full_scale,
    )  # fmt: skip
    if means or not log.has_force:
        how = dict(g=gravity.g, g_std=gravity.std, field=field, leave_out=out_of)
        without_rests(log, options, how, out, record, labels, means=means,
            as_json=as_json, verbose=verbose,
        )  # fmt: skip
        return
    with refusing_rests(log):
        require_no_means(log.path, log.accelerometer)
        log = with_rows(log, gyro_rows, gyro_delay)
        known = None if noise is None else load_noise(noise)
        result = calibrate_log(
            log,
            g=gravity.g,
            g_std=gravity.std,
            rest=rest,
            noise=known,
            leave_out=out_of,
            drift=drift,
            predict=calibration_moments,
            **options,
        )
        all_of = partial(
            calibrate_sensors,
            sensors=None if sensors is None else listed(sensors),
            hemisphere=hemisphere,
            field=field,
            noise=known,
        )
        whole = all_of(log, result)
        evidence = rows_of(log, whole, find=gyro_rows == "found")
        if evidence is not None and evidence.rows != log.gyro_rows:
            log = replace(log, gyro_rows=evidence.rows)
            whole = all_of(log, result)
    account = with_log(whole.account, log, row_facts(evidence), record)
    if out is not None or as_json:
        written = as_object(whole) | sensors_object(whole, log) | log_object(log)
        written |= {"gyro_rows": rows_object(evidence), "labels": labels}
        written |= account.as_object()
    if out is not None:
        write_json(out, written)
    notes = tried(result, log) if verbose else []
    notes += parameter_files(to, log, whole)
    if page is not None:
        write_page(page, log, whole, account)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
        say(notes, err=True)
        return
    show(account, verbose=verbose)
    say(notes)


@contextmanager
def refusing_rests(log: Log) -> Iterator[None]:
    """As `refusing`; where there are no rests, suggest the magnetometer alone."""
    try:
        with refusing(log):
            yield
    except RefusedError as error:
        if log.magnetometer is not None:
            error.add_note(
                "magnetometer      calibrated alone it needs no rests, only turns to "
                "all sides: name the clock and mx,my,mz in --columns, and - for the "
                "others"
            )
        raise


def gravity_of(
    g: float, std: float | None, latitude: float | None, height: float | None
) -> Gravity:
    """Gravity as stated, or that of the stated latitude and height."""
    from simval.imu.calibrate.gravity import Gravity, local_gravity

    if latitude is None and height is None:
        return Gravity(g, std or 0.0, "stated" if stated("g") else "assumed")
    refuse_if(stated("g"), "`--g` and the place both say gravity; give one of the two")
    if latitude is None or height is None:
        msg = (
            "`--latitude` and `--height` go together; give both, or state "
            "gravity with `--g`"
        )
        raise InputError(msg)
    found = local_gravity(latitude, height)
    return found if std is None else found._replace(std=std)


def labels_of(given: tuple[str, ...]) -> dict[str, str]:
    """Labels by their names."""
    labels: dict[str, str] = {}
    for each in given:
        name, _, value = (part.strip() for part in each.partition("="))
        refuse_if(
            not name or not value or name in labels,
            f"`--label` is {each!r}; give a name and what it states, KEY=VALUE, each "
            "name once",
        )
        labels[name] = value
    return labels


def rests_of(words: str) -> list[float]:
    """Read which rests are meant: whole numbers, or times with a decimal point."""
    values = numbers("--leave-out", words, "of rests, as 7,11, or s, as 74.0")
    written = words.split(",")
    return [
        each if "." in word else int(each)
        for word, each in zip(written, values, strict=False)
    ]


def without_rests(
    log: Log,
    options: dict[str, Any],
    how: dict[str, Any],
    out: Path | None,
    record: Iterable[Fact],
    labels: dict[str, str],
    *,
    means: bool,
    as_json: bool,
    verbose: bool,
) -> None:
    """Calibrate from a table of means, or a magnetometer in motion; print and write."""
    from simval.imu.calibrate import calibrate
    from simval.imu.calibrate.files import write_json
    from simval.imu.multiposition.description import with_log
    from simval.imu.multiposition.means import calibrate_means
    from simval.imu.recorded.turned import calibrate_turned

    with refusing(log):
        refuse_rests(means=means)
        refuse_if(
            out is not None and not log.has_force,
            "`--out` is for a calibration that `simval correct` can apply, and without "
            "an accelerometer there is none; take the numbers (--json)",
        )
        found: MeansCalibration | TurnedCalibration
        if means:
            found = calibrate_means(log, partial(calibrate, **options), **how)
        else:
            del options["residual"], options["loss"]
            fitted = partial(calibrate, **options)
            found = calibrate_turned(log, fitted, field=how["field"])
    account = with_log(found.account, log, record=record, means=means)
    written = found.as_object(log) | {"labels": labels} | account.as_object()
    if out is not None:
        write_json(out, written)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
    else:
        show(account, verbose=verbose)


_OF_RESTS = (
    "rest", "drift", "noise", "sensors", "gyro_rows", "gyro_delay", "page", "to"
)  # fmt: skip
_OF_ROWS = (*_OF_RESTS, "leave_out", "hemisphere", "residual", "loss")


def refuse_rests(*, means: bool) -> None:
    """Refuse the options that only make sense for a log with rests."""
    why = "`--means` states that each row is a mean"
    if not means:
        why = "a magnetometer alone is calibrated by its rows in motion"
    for name in _OF_RESTS if means else _OF_ROWS:
        option = {"page": "--report"}.get(name, f"--{name.replace('_', '-')}")
        refuse_if(
            stated(name),
            f"`{option}` is for a log with rests, and {why}; leave "
            f"{'one of the two' if means else 'it'} out",
        )


def rows_of(log: Log, whole: LogCalibration, *, find: bool) -> RowEvidence | None:
    """Find what the calibrated log says about the timing of its gyroscope's rows."""
    import numpy as np

    from simval.imu.recorded.rows import judged_rows, row_centre

    if log.gyro is None or whole.gyroscope is None:
        return None
    rate = whole.gyroscope.sensor().correct(log.gyro)
    force = whole.accelerometer.sensor().correct(log.accelerometer)
    seen = row_centre(log.time, rate, force, "accelerometer")
    step = float(np.median(np.diff(log.time)))
    return judged_rows((seen,), step, log.gyro_rows, find=find)


def tried(result: LogCalibration, log: Log) -> list[str]:
    """List the explanations that were tried for a misfit, each with its odds."""
    judgement = result.diagnosis.judgement
    middle = log.time[result.intervals.sum(axis=1) // 2]
    return [] if judgement is None else ["", *judgement.runners_up(middle)]


def listed(words: str) -> list[str]:
    """Names between commas; none for the word none."""
    return [] if words == "none" else [word.strip() for word in words.split(",")]


def parameter_files(
    to: Sequence[tuple[str, Path]], log: Log, whole: LogCalibration
) -> list[str]:
    """Write the parameters for each project; return notes on what is left out."""
    notes = []
    for name, file in to:
        from simval.imu.multiposition.parameters import parameters_of

        text, left = parameters_of(name, log, whole)
        write(file, text)
        notes += ["", *(f"{name:17s} {note}" for note in left)]
    return notes


def write_page(path: Path, log: Log, whole: LogCalibration, account: Account) -> None:
    """Write the page of a calibration."""
    from simval.report import render_calibration  # starts the drawing

    write(path, render_calibration(log, whole, command_again(), account))
