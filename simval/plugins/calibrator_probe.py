"""Check without noise that a calibrator does what it declares.

It is given exact readings of a known sensor, which has the errors that it estimates and
no others. What comes back must be the truth, whatever the rounding; where it is not,
the probe says which other meaning the answer would have, or which parameter is wrong.
"""

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError
from simval.imu.sensor import AccelerometerModel, forms
from simval.imu.sensor.models import ALL, own_sensor
from simval.plugins.answers import Calibration, calibration_of
from simval.plugins.probe import NEAR, OTHERWISE, TOLERANCE, imprecision, moved
from simval.plugins.protocol import Calibrator
from simval.poses import fibonacci_sphere
from simval.shapes import Float

POSES = 24
"""Poses, where none are given."""

G = 9.80665

MOST_DIGITS = 17
"""That a double has."""

STATED_NOISE = 1e-9
"""That is stated for the exact readings, raw units: a covariance of zero is none."""


def probe_calibrator(
    calibrator: Calibrator, directions: Float[Array, "n 3"] | None = None
) -> float:
    """Check a calibrator's conventions without noise.

    Parameters
    ----------
    calibrator : Calibrator
        As it declares itself.
    directions : Array, optional
        True directions of the poses that it needs, (n, 3); 24 spread over the sphere
        if not given.

    Returns
    -------
    float
        Greatest error of a parameter, relative to 1 for T and K and to the greatest
        entry for B.

    Raises
    ------
    PluginError
        If an answer has a wrong shape or is not finite, or the parameters are not the
        true ones.
    """
    sensor = own_sensor(probe_sensor(calibrator.estimates), calibrator.estimates)
    poses = fibonacci_sphere(POSES) if directions is None else directions
    raw = sensor.distort(G * poses, np.random.default_rng(0))

    def numbers(given: Float[Array, "n 3"]) -> Float[Array, "1 12"]:
        again = calibration_of(calibrator, given, G, STATED_NOISE)
        return np.append(again.matrix, again.bias)[None]

    answer = calibration_of(calibrator, raw, G, STATED_NOISE)
    error = float(_errors(answer, sensor).max())
    if not error <= TOLERANCE:
        first = np.append(answer.matrix, answer.bias)
        again, of_moved = numbers(raw), numbers(moved(raw))
        if not np.all(np.abs(again - first) <= TOLERANCE):
            why = (
                f"{OTHERWISE}: it must answer the same each time, so keep nothing from "
                "one call to the next"
            )
        elif meaning := _other_meaning(answer, sensor):
            why = meaning
        elif error <= NEAR:
            why = f"{imprecision(first[None], of_moved)}; {_worst(answer, sensor)}"
        else:
            why = _no_meaning(answer, sensor, calibrator.estimates)
        msg = (
            f"{calibrator.name} is {error:.3g} from the true parameters without noise, "
            f"{TOLERANCE:g} is allowed; {why}"
        )
        raise PluginError(msg)
    return error


def probe_sensor(estimates: tuple[str, ...] = ALL) -> AccelerometerModel:
    """Return the noise-free sensor with which a calibrator is measured.

    Without scales to estimate, readings are in m/s^2: its scales are near 1.
    """
    values = np.array([0.03, -0.02, 0.05, 2.06, 1.92, 2.1, 0.3, -0.2, 0.1])
    if "scale" not in estimates:
        values[3:6] /= 2.0
    return AccelerometerModel.from_parameters(values)


def _errors(answer: Calibration, sensor: AccelerometerModel) -> Float[Array, "9"]:
    truth = sensor.parameters
    off = np.abs(answer.parameters("triangular") - truth)
    off[6:] /= np.abs(truth[6:]).max()
    return off


def _other_meaning(answer: Calibration, sensor: AccelerometerModel) -> str:
    """Say which other convention would make the answer right; empty if none."""
    M, B = answer.matrix, answer.bias
    invertible = np.linalg.cond(M) < 1.0 / np.finfo(float).eps
    inverse = np.linalg.inv(M) if invertible else M
    readings = {
        "`matrix` looks inverted: it must take raw readings to force": (inverse, B),
        "`matrix` looks transposed": (M.T, B),
        "`B` has the wrong sign: force = matrix @ (raw - B)": (M, -B),
        "`B` looks added after the matrix: force = matrix @ (raw - B)": (
            M,
            inverse @ B,
        ),
    }
    for words, (matrix, bias) in readings.items():
        other = Calibration(matrix=matrix, bias=bias)
        if _errors(other, sensor).max() <= TOLERANCE:
            return words
    return ""


def _no_meaning(
    answer: Calibration, sensor: AccelerometerModel, estimates: tuple[str, ...]
) -> str:
    """Name the worst parameter of an answer that is wrong in every convention."""
    needed = (
        f"It declares that it estimates {' and '.join(estimates)}, and the sensor of "
        "the probe has no other error"
    )
    if estimates == ALL:
        needed = (
            "All nine parameters are needed: the sensor of the probe has misalignment "
            "S, scale K and bias B. If it estimates fewer, declare which in "
            "`estimates`"
        )
    return (
        f"no other sign, order or direction fits either; {_worst(answer, sensor)}. "
        f"{needed}; if it needs the six faces of a cube, set `calibrator.pose_set = "
        '"faces"` in a suite, as by `simval sweep smoke --plugin FILE.py --set '
        "calibrator.pose_set=faces`"
    )


def _worst(answer: Calibration, sensor: AccelerometerModel) -> str:
    """Name the worst parameter, with the digits that differ."""
    k = int(_errors(answer, sensor).argmax())
    seen, true = answer.parameters("triangular")[k], sensor.parameters[k]
    digits = 6
    while digits < MOST_DIGITS and f"{seen:.{digits}g}" == f"{true:.{digits}g}":
        digits += 1
    return (
        f"the worst is {forms.names('triangular')[k]}: {seen:.{digits}g} instead of "
        f"{true:.6g}"
    )
