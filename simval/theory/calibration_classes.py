r"""Bound and remaining error of calibrators with fewer than nine parameters.

The parameters are those of the triangular form, some of them estimated and the others
fixed (`simval.imu.sensor.models`). Of a sensor of the same class the errors are small;
what is left, eq. (L1), is then quadratic in them,

.. math:: \tfrac{g^2}{3} \|\mathrm{sym}(\delta M\,M^{-1})\|_F^2 + |M\,\delta B|^2
   + O(\delta^3),  \tag{L2}

and its mean at the Cramer-Rao bound of the class is the least there is. For unknown
directions the bound has one equation for each pose, that of the length of
:math:`M(y - B)`; for known ones, as in the six faces of a cube, three: those of y.

Of a sensor outside the class something is left without any noise. What is the least of
it (`least_left`) is no matter of how one fits. What a calibrator converges to
(`pseudo_true`) is, in second order of what it does not model: least squares of squared
lengths, of lengths, of the linear equation of the ellipsoid and, for known directions,
of the force or of the reading end in different parameters.
"""

from collections.abc import Callable, Iterator

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import ConvergenceError, GeometryError
from simval.geometry import normalize
from simval.imu.sensor import AccelerometerModel, forms
from simval.imu.sensor.models import FIXED
from simval.shapes import Float

SCALES, BIASES = slice(3, 6), slice(6, 9)
STEPS = 1000
"""Of the search for the least; a factor of the squared misalignment each."""

SETTLED = 1e-15
"""Relative change of the scales at which the search ends: some roundings."""

RANK = 1e-8
"""Relative, of the singular values of an information; as that of poses."""


def class_bound(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    places: tuple[int, ...],
    *,
    g: float,
    noise_std: float,
    known: bool,
) -> Float[Array, "p p"]:
    """Cramér-Rao bound of some of the nine parameters, if the others are known.

    Parameters
    ----------
    sensor : AccelerometerModel
        The true sensor.
    directions : Array
        True directions of the specific force, (n, 3).
    places : tuple of int
        Which of the nine parameters are estimated.
    g : float
        Gravity, m/s^2.
    noise_std : float
        Noise of each axis of a pose mean, raw units.
    known : bool
        Whether the directions are known; else each is estimated as well.

    Returns
    -------
    Array
        Bound, (p, p).

    Raises
    ------
    GeometryError
        If the poses do not show these parameters.
    """
    u, M = normalize(directions), sensor.matrix
    x = np.linalg.solve(M, g * u.T).T
    slopes = forms.matrix_derivatives("triangular", sensor.parameters)
    # of M (y - B) by the parameters, at a fixed reading, (n, 3, 9)
    force = np.empty((len(u), 3, 9))
    force[..., :6] = np.einsum("jkl,nl->nkj", slopes, x)
    force[..., 6:] = -M
    if known:
        rows = np.linalg.solve(M, force).reshape(-1, 9)
    else:  # the length alone: along u, over the noise that M carries there
        rows = np.einsum("nk,nkj->nj", u, force)
        rows /= np.linalg.norm(u @ M, axis=1)[:, None]
    rows = rows[:, list(places)]
    unit = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    values = np.linalg.svd(rows / unit, compute_uv=False)
    if len(rows) < len(places) or not values[-1] > RANK * values[0]:
        msg = (
            f"the {len(u)} directions do not show the parameters "
            f"{', '.join(forms.names('triangular')[k] for k in places)}; use more "
            "different poses, or estimate fewer parameters"
        )
        raise GeometryError(msg)
    back = np.linalg.pinv(rows / unit) / unit[:, None]
    return noise_std**2 * (back @ back.T)


def bound_left(
    sensor: AccelerometerModel,
    bound: Float[Array, "p p"],
    places: tuple[int, ...],
    g: float,
) -> float:
    """RMS force error that a covariance of a class's parameters leaves, eq. (L2)."""
    M = sensor.matrix
    slopes = forms.matrix_derivatives("triangular", sensor.parameters) @ np.linalg.inv(
        M
    )
    stretch = (slopes + slopes.mT) / 2.0 * g / np.sqrt(3.0)
    weight = np.zeros((12, 9))
    weight[:9, :6] = stretch.reshape(6, 9).T
    weight[9:, 6:] = M
    chosen = weight[:, list(places)]
    return np.sqrt(np.trace(chosen @ bound @ chosen.T))


def least_left(sensor: AccelerometerModel, places: tuple[int, ...], g: float) -> float:
    """RMS force error that the best calibration of a class leaves.

    With Q the rotation nearest to ``diag(k) N``, N the inverse of M, the scales that
    are nearest to it are ``k_i = N_i Q_i / N_i N_i`` by rows; the two in turn never
    leave more than before.

    Raises
    ------
    ConvergenceError
        If the scales do not settle.
    """
    if 0 in places:
        return 0.0
    inverse = np.linalg.inv(sensor.matrix)
    scales = np.ones(3) if 3 not in places else 1.0 / np.linalg.norm(inverse, axis=1)
    for _ in range(STEPS):
        U, stretch, V = np.linalg.svd(scales[:, None] * inverse)
        nearest = np.sum(inverse * (U @ V), axis=1) / np.sum(inverse**2, axis=1)
        if 3 not in places or np.all(
            np.abs(nearest - scales) <= SETTLED * np.abs(scales)
        ):
            return g * np.sqrt(np.sum((stretch - 1.0) ** 2) / 3.0)
        scales = nearest
    msg = (
        f"the least that scales can leave is not found in {STEPS} steps; the sensor is "
        "too misaligned"
    )
    raise ConvergenceError(msg)


def pseudo_true(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    places: tuple[int, ...],
    *,
    g: float,
    known: bool,
) -> Float[Array, "c 9"]:
    """Parameters to which calibrators without misalignment converge.

    One row for each of the criteria by which one may fit: squared lengths, lengths,
    the linear equation; of known directions the force and the reading as well.

    Raises
    ------
    ConvergenceError
        If least squares of one of them does not converge.
    """
    u = normalize(directions)
    raw = g * np.linalg.solve(sensor.matrix, u.T).T + sensor.B
    start = FIXED.copy()
    start[list(places)] = sensor.parameters[list(places)]
    found = [
        _fitted(residual, start, places) for residual in _criteria(raw, u, g, known)
    ]
    return np.array([*found, _linear(raw, g, places)])


def _criteria(
    raw: Float[Array, "n 3"], u: Float[Array, "n 3"], g: float, known: bool
) -> Iterator[Callable[[Array, Array], Array]]:
    """Residuals of scales and biases, relative to g."""
    yield lambda k, b: np.sum((k * (raw - b)) ** 2, axis=1) / g**2 - 1.0
    yield lambda k, b: np.linalg.norm(k * (raw - b), axis=1) / g - 1.0
    if known:
        yield lambda k, b: ((k * (raw - b)) / g - u).ravel()
        yield lambda k, b: ((raw - b) / g - u / k).ravel()


def _fitted(
    residual: Callable[[Array, Array], Array],
    start: Float[Array, "9"],
    places: tuple[int, ...],
) -> Float[Array, "9"]:
    chosen = list(places)

    def whole(values: Array) -> Array:
        parameters = start.copy()
        parameters[chosen] = values
        return parameters

    def of(values: Array) -> Array:
        parameters = whole(values)
        return residual(parameters[SCALES], parameters[BIASES])

    fit = scipy.optimize.least_squares(
        of,
        start[chosen],
        jac="3-point",
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-15,
        gtol=None,
    )
    if not fit.success:
        msg = f"the pseudo-true parameters are not found: {fit.message}"
        raise ConvergenceError(msg)
    return whole(fit.x)


def _linear(
    raw: Float[Array, "n 3"], g: float, places: tuple[int, ...]
) -> Float[Array, "9"]:
    """Linear least squares of ``sum a y^2 - 2 a b y = const``, scaled by g."""
    result = FIXED.copy()
    if 3 not in places:
        D = np.column_stack([2.0 * raw, np.ones(len(raw))])
        result[BIASES] = np.linalg.lstsq(D, np.sum(raw**2, axis=1), rcond=None)[0][:3]
        return result
    D = np.column_stack([raw**2, raw])
    values = np.linalg.lstsq(D, np.ones(len(raw)), rcond=None)[0]
    b = -values[3:] / (2.0 * values[:3])
    result[SCALES] = g * np.sqrt(values[:3] / (1.0 + values[:3] @ b**2))
    result[BIASES] = b
    return result
