"""A table of means: each row is what a sensor read in a pose, averaged before.

Nothing is known of the rests but their means, so error bars are by the residuals, and a
fault within a rest is not seen. Without an accelerometer a magnetometer's means lie on
an ellipsoid, too, which tells its scales, their misalignment among themselves and its
bias in a field of constant strength, and nothing of the accelerometer's axes.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose, order_words
from simval.imu.calibrate.estimate import (
    matrix_lines,
    parameter_lines,
    residual_line,
    status_line,
)
from simval.imu.calibrate.files import to_json
from simval.imu.logs import Log
from simval.imu.multiposition.description import log_object
from simval.shapes import Float

_WORDS: Final = {
    "accelerometer": "{g:g} m/s^2 was assumed for gravity",
    "magnetometer": (
        "a field of {g:g} was assumed in all poses; how its axes stand to an "
        "accelerometer's is not known, nor their handedness, nor one turn of all three"
    ),
}


class MeansCalibration(NamedTuple):
    """Calibration of one sensor by a table of its means."""

    sensor: str
    fit: FitResult
    diagnosis: Diagnosis
    rows: Any  # of the table that were used
    left_out: tuple[str, ...]

    def lines(self) -> list[str]:
        """Describe it in lines of text."""
        hidden = order_words(self.diagnosis.hidden, self.diagnosis.hides)
        means, fit = "rows are means of poses, as given (--means)", self.fit
        return [
            f"poses             {len(self.rows)}, of the {self.sensor}: {means}",
            *(f"left out          {each}" for each in self.left_out),
            status_line(fit), "", *parameter_lines(fit), "", *matrix_lines(fit), "",
            *([residual_line(fit)] if self.sensor == "accelerometer" else []),
            f"verdict           {self.diagnosis.verdict}",
            *([f"order of poses    {hidden}"] if hidden else []),
            *(f"outlier           row {self.rows[k]}" for k in self.diagnosis.outliers),
            f"least determined  {self.diagnosis.least_determined.sentence}",
            f"{'assumed':18s}{_WORDS[self.sensor].format(g=fit.g)}",
            "error bars        by the residuals: the noise of a pose is not known",
        ]  # fmt: skip

    def as_object(self, log: Log) -> dict[str, Any]:
        """Return it as one JSON object; of an accelerometer a calibration file."""
        said = {
            "sensor": self.sensor, "rows": self.rows.tolist(),
            "pose_noise": "residuals", "verdict": self.diagnosis.verdict,
            "left_out": list(self.left_out),
            "outliers": self.rows[[*self.diagnosis.outliers]].tolist(),
        }  # fmt: skip
        return to_json(self.fit) | log_object(log) | said


def calibrate_means(
    log: Log,
    fitted: Callable[[Float[Array, "n 3"], float], FitResult],
    *,
    g: float,
    field: float,
    leave_out: Sequence[float] = (),
) -> MeansCalibration:
    """Calibrate the accelerometer of a table of means, or a magnetometer alone.

    Raises
    ------
    InputError
        If it has a gyroscope only, or a row that is to be left out is none.
    RefusedError
        If its rows are no calibration.
    """
    sensor, samples = "accelerometer", log.accelerometer
    if not log.has_force:
        if log.magnetometer is None:
            msg = (
                f"{log.path} has means of a gyroscope alone, which at rest show its "
                "bias and nothing else; give a log with its turns"
            )
            raise InputError(msg)
        sensor, samples = "magnetometer", log.magnetometer
    wrong = [x for x in leave_out if x not in range(len(samples))]
    if wrong:
        msg = (
            f"there is no row {wrong[0]:g}, which is to be left out; the rows of means "
            f"are numbered from 0 to {len(samples) - 1}"
        )
        raise InputError(msg)
    rows = np.setdiff1d(np.arange(len(samples)), np.array(leave_out, dtype=int))
    poses = samples[rows]
    fit = fitted(poses, g if sensor == "accelerometer" else field).require_converged()
    beside = (
        ("gyroscope", log.gyro, "how it was turned between them"),
        ("magnetometer", log.magnetometer, "its noise; give its columns alone"),
    )
    left = tuple(
        f"the {name}: means of poses do not show {what}"
        for name, given, what in beside
        if given is not None and name != sensor
    )
    return MeansCalibration(sensor, fit, diagnose(fit, poses), rows, left)
