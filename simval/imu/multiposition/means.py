"""A table of pose means, averaged before: one row a pose.

Nothing is known of the rests but their means, so error bars are by the residuals, and a
fault within a rest is not seen. Without an accelerometer a magnetometer's means lie on
an ellipsoid, too, which tells its scales, their misalignment among themselves and its
bias in a field of constant strength, and nothing of the accelerometer's axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.account import Account, Fact, Reply, Told
from simval.arrays import Array
from simval.errors import InputError
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose
from simval.imu.calibrate.files import to_json
from simval.imu.calibrate.values import (
    how_good,
    matrix_note,
    status,
)
from simval.imu.logs import Log
from simval.imu.multiposition.description import (
    ANSWERS,
    BEGIN,
    limited,
    log_object,
    order,
)
from simval.imu.sensor.readable import accelerometer_values
from simval.shapes import Float
from simval.spelling import counted

_WORDS: Final = {
    "accelerometer": "{g:g} m/s^2 was assumed for gravity",
    "magnetometer": (
        "a field of {g:g} was assumed in all poses; how its axes stand to an "
        "accelerometer's is not known, nor their handedness, nor one turn of all three"
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeansCalibration(Told):
    """Calibration of one sensor from a table of pose means."""

    sensor: str
    fit: FitResult
    diagnosis: Diagnosis
    rows: Any  # of the table that were used
    left_out: tuple[str, ...]

    @property
    def account(self) -> Account:
        """Everything that there is to say of the calibration."""
        found, fit, force = self.diagnosis, self.fit, self.sensor == "accelerometer"
        whole = order(found, self.sensor)
        if found.cause:
            whole = whole._replace(holds=False, words=found.cause, do=found.do)
        words = "they are as wide as the scatter of the poses, whose noise is not known"
        outliers = [str(self.rows[k]) for k in found.outliers]
        return Account(
            title="Calibration from",
            source="a table of means",
            said=f"{counted(len(self.rows), 'pose')} of the {self.sensor}, each row a "
            "mean (--means)",
            replies=(
                limited(how_good(fit, force=force), found),
                Reply(
                    title="Can the error bars be trusted?",
                    headline=f"{BEGIN[whole.holds]}: "
                    f"{words if whole.holds else whole.words}.",
                    answer=ANSWERS[whole.holds],
                    do=whole.do,
                    lines=(f"Rows that are far off: {', '.join(outliers) or 'none'}.",),
                ),
            ),
            values=(accelerometer_values(fit, force=force),),
            notes=(matrix_note(fit, force=force),),
            facts=(
                *(Fact("left out", each, notable=True) for each in self.left_out),
                Fact("assumed", _WORDS[self.sensor].format(g=fit.g), notable=not force),
                status(fit),
                Fact("least determined", found.least_determined.sentence),
            ),
        )

    def as_object(self, log: Log) -> dict[str, Any]:
        """Return it as one JSON object; for an accelerometer, a calibration file."""
        said = {
            "sensor": self.sensor, "rows": self.rows.tolist(),
            "pose_noise": "residuals",
            "left_out": list(self.left_out),
            "outliers": self.rows[[*self.diagnosis.outliers]].tolist(),
        }  # fmt: skip
        return to_json(self.fit) | log_object(log) | said


def calibrate_means(
    log: Log,
    fitted: Callable[[Float[Array, "n 3"], float], FitResult],
    *,
    g: float,
    g_std: float = 0.0,
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
            f"there is no row {wrong[0]:g} to leave out; the rows of means are "
            f"numbered from 0 to {len(samples) - 1}"
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
    diagnosis = diagnose(fit, poses)
    if sensor == "accelerometer":
        fit = fit.with_gravity(g_std)
    return MeansCalibration(
        sensor=sensor, fit=fit, diagnosis=diagnosis, rows=rows, left_out=left
    )
