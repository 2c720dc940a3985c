r"""What a calibration's covariance leaves in the readings that a filter is given.

A reading is corrected by :math:`\hat M (y - \hat B)`. With errors dM and dB of the two
it is off, to first order, by

.. math:: E x + e, \qquad E = \mathrm{d}M\, M^{-1}, \qquad e = -M\, \mathrm{d}B,
   \tag{F13}

x being what is to be read. A constant e of a gyroscope is a part of the bias that a
filter estimates, and belongs to its start.
"""

from typing import Any

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, physical_array
from simval.errors import InputError
from simval.sensor import forms
from simval.shapes import Float
from simval.theory.filter_errors import G_SENSITIVITY, GYROSCOPE, CalibrationError


def calibration_error(
    of: str, matrix: Any, covariance: Any, *, form: str | None = None
) -> CalibrationError:
    """Errors of readings that are corrected by an uncertain calibration, eq. (F13).

    Parameters
    ----------
    of : str
        ``gyroscope``, or the name of a vector sensor.
    matrix : array_like
        M of the calibration, (3, 3).
    covariance : array_like
        Of M row by row and then B, (12, 12), as of a gyroscope's or a magnetometer's
        calibration; of the gyroscope M alone will do, (9, 9).
    form : {"triangular", "upper", "symmetric"}, optional
        That the covariance is of the nine parameters of an accelerometer in this form.

    Returns
    -------
    CalibrationError
        For `filter_prediction`.

    Raises
    ------
    InputError
        If a shape does not fit, or M is singular or not of the form.
    """
    instance("of", of, str)
    M = physical_array("matrix", matrix, (3, 3))
    if M.shape != (3, 3) or not np.linalg.cond(M) < 1.0 / np.finfo(float).eps:
        msg = f"`matrix` of {of} must be one matrix of full rank, (3, 3)"
        raise InputError(msg)
    if of == G_SENSITIVITY:
        msg = (
            "the g-sensitivity G is a matrix of its own; give `CalibrationError` the "
            "covariance of M G, row by row"
        )
        raise InputError(msg)
    J = np.zeros((12, 12))
    J[:9, :9] = np.kron(np.eye(3), np.linalg.inv(M).T)
    J[9:, 9:] = -M
    if form is not None:
        J = J @ _of_form(form, M)
    if of == GYROSCOPE:
        J = J[:9, :9]
    C = physical_array("covariance", covariance, (None, None))
    sizes = {J.shape[1], 12 if of == GYROSCOPE else J.shape[1]}
    if C.ndim != 2 or C.shape[0] != C.shape[1] or len(C) not in sizes:
        wanted = " or ".join(f"({n}, {n})" for n in sorted(sizes))
        msg = f"`covariance` of {of} has shape {C.shape}; give {wanted}"
        raise InputError(msg)
    own = C[: J.shape[1], : J.shape[1]]
    return CalibrationError(of=of, covariance=J @ own @ J.T)


def _of_form(form: str, M: Float[Array, "3 3"]) -> Float[Array, "12 9"]:
    # M row by row and B, by the nine parameters of a form
    form = choice("form", form, forms.MODELS)
    theta = forms.from_gram(form, M.T @ M, np.zeros(3))
    off = float(np.abs(forms.matrix(form, theta) - M).max())
    # 1e-6 of it: a matrix that was written with seven digits
    if not off <= 1e-6 * np.abs(M).max():
        msg = f"`matrix` is no {form} one, by {off:.1e}; give that of the covariance"
        raise InputError(msg)
    J = np.zeros((12, 9))
    J[:9, :6] = forms.matrix_derivatives(form, theta).reshape(6, 9).T
    J[9:, 6:] = np.eye(3)
    return J
