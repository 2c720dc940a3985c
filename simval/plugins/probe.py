"""Noise-free probes of the conventions that a plug-in declares.

An estimator is given exact vectors of known attitudes, half turns and small angles
among them; a calibrator exact readings of a known sensor. What comes back must be the
truth, whatever the rounding. Where it is not, the probe says which other convention
the answers would fit. A covariance is probed by its leading term, with differences of
the estimator itself, so that no theory of ours stands behind the verdict.
"""

from itertools import product
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.plugins.answers import (
    Calibration,
    calibration_of,
    covariances_of,
    package_quaternion,
    quaternions_of,
)
from simval.plugins.errors import PluginError
from simval.plugins.protocol import Calibrator, Estimator
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel, forms

TOLERANCE = 1e-6
"""Rad, and relative to the parameters: the root of rounding is 1.5e-8, which is what a
sound but ill-conditioned algorithm may lose, times 64."""

STEP = 1e-5
"""Of the differences: central, so their own error is about STEP^2."""

COVARIANCE_TOLERANCE = 1e-3
"""Relative, of the leading term; differences are good to 1e-9, and a wrong factor, side
or unit is off by far more."""

COUNT = 24


def probe_estimator(estimator: Estimator) -> float:
    """Check an estimator's conventions without noise.

    Parameters
    ----------
    estimator : Estimator
        As it declares itself.

    Returns
    -------
    float
        Greatest attitude error, rad.

    Raises
    ------
    PluginError
        If an answer has a wrong shape or is not finite, its attitude is not the true
        one, it changes its input, its rows depend on each other, or the covariance is
        not that of its errors.
    """
    truth, vectors = _observations()
    given = [v.copy() for v in vectors]
    q = quaternions_of(estimator, *given)
    if not all(np.array_equal(a, b) for a, b in zip(given, vectors, strict=True)):
        msg = f"{estimator.name} changes its input; work on a copy"
        raise PluginError(msg)
    error = float(attitude_error(truth, q).max())
    if not error <= TOLERANCE:
        msg = (
            f"{estimator.name} is {error:.3g} rad from the truth without noise, "
            f"{TOLERANCE:g} is allowed; {_other_convention(estimator, truth, vectors)}"
        )
        raise PluginError(msg)
    alone = quaternions_of(estimator, *(v[:1] for v in vectors))
    if not float(attitude_error(alone, q[:1]).max()) <= TOLERANCE:
        msg = f"{estimator.name}: row 0 of a batch is not what it is when alone"
        raise PluginError(msg)
    if estimator.covariance is not None:
        _probe_covariance(estimator, truth, vectors)
    return error


def probe_calibrator(calibrator: Calibrator) -> float:
    """Check a calibrator's conventions without noise.

    Parameters
    ----------
    calibrator : Calibrator
        As it declares itself.

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
    sensor = probe_sensor()
    g = 9.80665
    raw = sensor.distort(g * fibonacci_sphere(COUNT), np.random.default_rng(0))
    found = calibration_of(calibrator, raw, g, 0.0)
    error = _calibration_error(found, sensor)
    if not error <= TOLERANCE:
        msg = (
            f"{calibrator.name} is {error:.3g} from the true parameters without noise, "
            f"{TOLERANCE:g} is allowed; {_other_meaning(found, sensor)}"
        )
        raise PluginError(msg)
    return error


def probe_sensor() -> AccelerometerModel:
    """Give the sensor that the probe of a calibrator uses, free of noise.

    Returns
    -------
    AccelerometerModel
        Raw units are not m/s^2, so that scale and bias cannot be mixed up.
    """
    values = np.array([0.03, -0.02, 0.05, 2.06, 1.92, 2.1, 0.3, -0.2, 0.1])
    return AccelerometerModel.from_parameters(values)


def rotation_error(truth: Array, estimate: Array, side: str) -> Array:
    """Rotation vector from the true attitude to the estimate.

    Parameters
    ----------
    truth, estimate : Array
        Unit quaternions, the package's convention, (..., 4).
    side : {"body", "reference"}
        Of the error.

    Returns
    -------
    Array
        Rotation vector, rad, (..., 3).
    """
    if side == "body":
        difference = compose(conjugate(truth), estimate)
    else:
        difference = compose(estimate, conjugate(truth))
    vector, scalar = difference[..., :3], difference[..., 3:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar)) * np.where(scalar < 0.0, -1.0, 1.0)
    return angle * vector / np.maximum(sine, np.finfo(float).tiny)


def _observations() -> tuple[Array, list[Array]]:
    rng = np.random.default_rng(20_268)
    q = random_quaternions(COUNT, rng)
    q[-2] = [1.0, 0.0, 0.0, 0.0]  # a half turn, and nearly no turn at all
    q[-1] = normalize(np.array([0.0, 1e-3, 0.0, 1.0]))
    r1, r2 = (normalize(rng.standard_normal((COUNT, 3))) for _ in range(2))
    A = attitude_matrix(q)
    b1, b2 = (np.einsum("nij,nj->ni", A, r) for r in (r1, r2))
    return q, [b1, b2, r1, r2]


def _other_convention(estimator: Estimator, truth: Array, vectors: list[Array]) -> str:
    raw = np.asarray(estimator.estimate(*(v.copy() for v in vectors)), dtype=float)
    for components, matrix in product(("xyzs", "sxyz"), ("active", "passive")):
        q = package_quaternion(normalize(raw), components, matrix)
        if float(attitude_error(truth, q).max()) <= TOLERANCE:
            return f'declare components="{components}", matrix="{matrix}" instead'
    return (
        "no order or direction of the components fits either: is it b = A r, with "
        "body vectors first?"
    )


def _probe_covariance(estimator: Estimator, truth: Array, vectors: list[Array]) -> None:
    # the last rows are a half turn and a small angle: singular for some estimators
    rows = slice(0, COUNT - 2)
    noise = 1e-3
    b1, b2, r1, r2 = (v[rows] for v in vectors)
    claimed = covariances_of(estimator, b1, b2, r1, r2, noise)
    seen = {
        side: noise**2 * _leading(estimator, truth[rows], [b1, b2, r1, r2], side)
        for side in ("body", "reference")
    }
    off = {
        side: float(
            np.max(
                np.linalg.norm(claimed - value, axis=(-2, -1))
                / np.linalg.norm(value, axis=(-2, -1))
            )
        )
        for side, value in seen.items()
    }
    other = "reference" if estimator.side == "body" else "body"
    if not off[estimator.side] <= COVARIANCE_TOLERANCE + noise:
        factor = float(np.median(_trace(claimed) / _trace(seen[estimator.side])))
        hint = (
            f'it fits side="{other}": declare that'
            if off[other] <= COVARIANCE_TOLERANCE + noise
            else f"its trace is {factor:.4g} times what it should be"
        )
        msg = (
            f"the covariance of {estimator.name} is {off[estimator.side]:.3g} off, "
            f"relative, from that of its own errors at a noise of {noise:g}; {hint}"
        )
        raise PluginError(msg)


def _leading(
    estimator: Estimator, truth: Array, vectors: list[Array], side: str
) -> Array:
    """J J' of the estimator, by central differences: covariance for unit noise."""
    total = np.zeros((len(truth), 3, 3))
    for which, axis in product(range(4), range(3)):
        ends = []
        for sign in (1.0, -1.0):
            moved = [v.copy() for v in vectors]
            moved[which][:, axis] += sign * STEP
            q = quaternions_of(estimator, *moved)
            ends.append(rotation_error(truth, q, side))
        slope = (ends[0] - ends[1]) / (2.0 * STEP)
        total += slope[:, :, None] * slope[:, None, :]
    return total


def _trace(matrices: Array) -> Array:
    return np.trace(matrices, axis1=-2, axis2=-1)


def _calibration_error(found: Calibration, sensor: AccelerometerModel) -> float:
    truth = sensor.parameters
    gram = found.matrix.T @ found.matrix
    parameters = forms.from_gram("triangular", gram, found.bias)
    off = np.abs(parameters - truth)
    off[6:] /= np.abs(truth[6:]).max()
    return float(off.max())


def _other_meaning(found: Calibration, sensor: AccelerometerModel) -> str:
    M, B = found.matrix, found.bias
    invertible = np.linalg.cond(M) < 1.0 / np.finfo(float).eps
    inverse = np.linalg.inv(M) if invertible else M
    readings: dict[str, tuple[Array, Array]] = {
        "`matrix` looks inverted: it must take raw readings to force": (inverse, B),
        "`matrix` looks transposed": (M.T, B),
        "`B` has the wrong sign: force = matrix @ (raw - B)": (M, -B),
        "`B` looks added after the matrix: force = matrix @ (raw - B)": (
            M,
            inverse @ B,
        ),
    }
    for words, (matrix, bias) in readings.items():
        other = Calibration(matrix=matrix, bias=bias, covariance=None)
        if _calibration_error(other, sensor) <= TOLERANCE:
            return words
    return "no other sign, order or direction fits either"


def declared(plugin: Estimator | Calibrator) -> dict[str, Any]:
    """Give what a plug-in declares, for people.

    Parameters
    ----------
    plugin : Estimator or Calibrator
        The plug-in.

    Returns
    -------
    dict
        Words by name.
    """
    if isinstance(plugin, Calibrator):
        return {"kind": "calibrator", "form": plugin.form}
    return {
        "kind": "estimator",
        "components": plugin.components,
        "matrix": plugin.matrix,
        "side": plugin.side,
        "claim": plugin.claim if plugin.covariance is not None else "none",
    }
