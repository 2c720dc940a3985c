r"""Calibration and noise of an IMU as Kalibr's ``imu.yaml`` has them.

Kalibr models readings in SI units by

.. math:: \tilde a = M_a a + b_a + n, \qquad
   \tilde\omega = M_g C \omega + A a + b_g + n,

both M lower triangular and C the rotation from the accelerometer's axes to the
gyroscope's (its models of the kind ``scale-misalignment``). So :math:`M_a` is the
inverse of this package's matrix in the triangular form, and :math:`M_g C` the inverse
of the gyroscope's. Of a log in counts the matrices are in counts.
"""

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.logs import Log
from simval.imu.multiposition.imu import ImuCalibration
from simval.imu.multiposition.noise import log_noise
from simval.imu.noise.model import largest
from simval.shapes import Float

LINES = (
    ("accelerometer_noise_density", "N", "m/s^2/sqrt(Hz)"),
    ("accelerometer_random_walk", "K", "m/s^3/sqrt(Hz)"),
    ("gyroscope_noise_density", "N", "rad/s/sqrt(Hz)"),
    ("gyroscope_random_walk", "K", "rad/s^2/sqrt(Hz)"),
)


def kalibr_yaml(log: Log, whole: ImuCalibration) -> str:
    """Text of an ``imu.yaml`` with intrinsics, and noise where a rest shows it.

    Raises
    ------
    InputError
        If the accelerometer's form is not the triangular one, or there is no gyroscope.
    """
    if whole.accelerometer.model != "triangular" or whole.gyroscope is None:
        why = "the gyroscope is not calibrated"
        if whole.accelerometer.model != "triangular":
            why = f"the form is {whole.accelerometer.model}"
        msg = (
            f"{why}; Kalibr's imu.yaml has lower triangular matrices of both sensors: "
            "calibrate a log with a gyroscope, with --model triangular"
        )
        raise InputError(msg)
    force = whole.accelerometer.sensor().matrix
    factors = whole.gyroscope.factors("kalibr")
    lines = [
        "imu0:",
        *_matrix("T_i_b", np.eye(4), 2),
        *_noise_lines(log, force, whole.gyroscope.M),
        "  accelerometers:",
        *_matrix("M", np.tril(np.linalg.inv(force)), 4),
        "  gyroscopes:",
        *_matrix("A", whole.sensitivity, 4),
        *_matrix("C_gyro_i", factors.rest, 4),
        *_matrix("M", factors.shape, 4),
        "  model: scale-misalignment",
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        f"  update_rate: {log.rate!r}",
    ]
    return "\n".join([*lines, ""])


def _matrix(name: str, matrix: Array, indent: int) -> list[str]:
    left = " " * indent
    rows = [f"{left}- [{', '.join(repr(x) for x in row)}]" for row in matrix.tolist()]
    return [f"{left}{name}:", *rows]


def _noise_lines(
    log: Log, force: Float[Array, "3 3"], rate: Float[Array, "3 3"]
) -> list[str]:
    # the largest that is seen of the axes; what is only bounded is a comment
    try:
        found = log_noise(log)
    except RefusedError as error:
        return [f"  # noise: {error}"]
    lines = []
    for name, kind, unit in LINES:
        own, M = (found.accelerometer, force) if name[0] == "a" else (found.gyro, rate)
        value, bound = largest(own, kind, np.linalg.norm(M, axis=0))
        where = f"by {found.seconds:.0f} s at rest"
        if value is not None:
            more = f"; an axis that is not seen, below {bound:.4g}" if bound else ""
            lines.append(f"  {name}: {value!r}  # {unit}{more}")
        elif bound is not None:
            lines.append(f"  # {name}: not seen, below {bound:.4g} {unit} {where}")
        else:
            lines.append(f"  # {name}: not told {where}")
    return lines
