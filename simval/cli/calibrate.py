"""What `simval calibrate` does."""

import json
from pathlib import Path
from typing import Any

import click
import numpy as np

from simval.calibrate.files import to_json, write_json
from simval.cli.options import write
from simval.cli.reproduced import command_again
from simval.cli.sensors import sensors_object
from simval.cli.taken import log_object
from simval.cli.terminal import say
from simval.logs import Log, read_log
from simval.multiposition import (
    ImuCalibration,
    calibrate_log,
    calibrate_sensors,
)
from simval.multiposition.described import bound_sd
from simval.noise import load_noise


def run(
    path: Path,
    rate: float | None,
    columns: str | None,
    sensors: str | None,
    hemisphere: str,
    field: float,
    noise: Path | None,
    out: Path | None,
    page: Path | None,
    kalibr: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Do what `simval calibrate` is asked."""
    log = read_log(path, rate, columns)
    known = None if noise is None else load_noise(noise)
    result = calibrate_log(log, noise=known, **options)
    whole = calibrate_sensors(
        log,
        result,
        sensors=None if sensors is None else listed(sensors),
        hemisphere=hemisphere,
        field=field,
        noise=known,
    )
    if out is not None or as_json:
        written = as_object(whole) | sensors_object(whole, log) | log_object(log)
    if out is not None:
        write_json(out, written)
    if kalibr is not None:
        from simval.multiposition.kalibr import kalibr_yaml

        write(kalibr, kalibr_yaml(log, whole))
    if page is not None:
        write_page(page, log, whole)
    if as_json:
        click.echo(json.dumps(written, allow_nan=False))
        return
    say([*log.described(), *str(whole).splitlines()])


def listed(words: str) -> list[str]:
    """Names between commas; none for the word none."""
    return [] if words == "none" else [word.strip() for word in words.split(",")]


def write_page(path: Path, log: Log, whole: ImuCalibration) -> None:
    """Write the page of a calibration."""
    from simval.report import render_calibration  # starts the drawing

    write(path, render_calibration(log, whole, command_again()))


def as_object(whole: ImuCalibration) -> dict[str, Any]:
    """Return the accelerometer as one JSON object; a calibration file and more."""
    result = whole.log
    diagnosis = result.diagnosis
    known = not np.isnan(diagnosis.chi2_per_dof)
    white = result.white_chi2_per_dof
    return to_json(whole.accelerometer) | {
        "intervals": len(result.intervals),
        "interval_samples": result.intervals.tolist(),
        "multiplier": result.multiplier,
        "rest_seconds": result.rest_seconds,
        "rest_found": result.rest.found,
        "chi2_per_dof": diagnosis.chi2_per_dof if known else None,
        "p_value": diagnosis.p_value if known else None,
        "white_chi2_per_dof": None if np.isnan(white) else white,
        "pose_noise": result.pose_noise.source,
        "pose_noise_std": result.pose_noise.std.tolist(),
        "pose_noise_white_std": result.pose_noise.white.tolist(),
        "verdict": diagnosis.verdict,
        "outliers": list(diagnosis.outliers),
        "next_direction": result.next_direction.tolist(),
        "bound_sd": None if result.predicted is None else bound_sd(result).tolist(),
        "bias": None if result.predicted is None else result.predicted.bias.tolist(),
    }
