r"""Derivatives of the residuals, term by term, as two source derivations write them.

The solver works on moment matrices; these are the same derivatives for one reading,
with the sources' misprints put right (``docs/errata.md``).

- the scalar chain rule: the nine derivatives of g^2 - |a|^2 entry by entry, with
  :math:`a = (I - S) K' (A - b)`  (R2), whose reported scale is
  :math:`K = K'^{-1}` (`FitResult.sensor_scale`);
- the symmetric Gauss-Newton derivation: :math:`e = |K (a - B)|^2 - g^2` with its
  gradient and all 45 second derivatives  (R3).
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Inexact

from simval.arrays import Array


def chain_rule_jacobian(
    parameters: Inexact[Array, "9"], reading: Float[Array, "n 3"]
) -> Inexact[Array, "n 9"]:
    """Jacobian of g^2 - |a|^2 entry by entry, eq. (R2)."""
    s_yx, s_zx, s_zy, k_x, k_y, k_z = parameters[:6]
    x, y, z = (reading - parameters[6:]).T
    a_x = x * k_x
    a_y = x * k_x * s_yx + y * k_y
    a_z = -x * k_x * s_zx + y * k_y * s_zy + z * k_z
    f_x, f_y, f_z = -2.0 * a_x, -2.0 * a_y, -2.0 * a_z
    columns = [
        f_y * (x * k_x),
        f_z * (-x * k_x),
        f_z * (y * k_y),
        f_x * x + f_y * (x * s_yx) + f_z * (-x * s_zx),
        f_y * y + f_z * (y * s_zy),
        f_z * z,
        f_x * -k_x + f_y * (-k_x * s_yx) + f_z * (k_x * s_zx),
        f_y * -k_y + f_z * (-k_y * s_zy),
        f_z * -k_z,
    ]
    return np.stack(columns, axis=-1)


def symmetric_residual(
    parameters: Inexact[Array, "9"], reading: Float[Array, "n 3"], g: float
) -> Inexact[Array, " n"]:
    """Residual of the symmetric derivation."""
    A, B, C, D, E, F = _form(parameters)
    x, y, z = (reading - parameters[6:]).T
    square = A * x * x + B * y * y + C * z * z + D * x * y + E * y * z + F * z * x
    return np.asarray(square - g**2)


def _form(parameters: Inexact[Array, "9"]) -> tuple[Any, ...]:
    k11, k12, k13, k22, k23, k33 = parameters[:6]
    return (
        k11**2 + k12**2 + k13**2,
        k12**2 + k22**2 + k23**2,
        k13**2 + k23**2 + k33**2,
        2 * (k11 * k12 + k12 * k22 + k13 * k23),
        2 * (k12 * k13 + k22 * k23 + k23 * k33),
        2 * (k11 * k13 + k12 * k23 + k13 * k33),
    )


def symmetric_jacobian(
    parameters: Inexact[Array, "9"], reading: Float[Array, "n 3"]
) -> Inexact[Array, "n 9"]:
    """Gradient of the symmetric residual for each reading."""
    A, B, C, D, E, F = _form(parameters)
    k11, k12, k13, k22, k23, k33 = parameters[:6]
    x, y, z = (reading - parameters[6:]).T
    columns = [
        2 * x * (k11 * x + k12 * y + k13 * z),
        2 * (k12 * (x * x + y * y) + (k11 + k22) * x * y + k13 * y * z + k23 * z * x),
        2 * (k13 * (x * x + z * z) + k23 * x * y + k12 * y * z + (k11 + k33) * z * x),
        2 * y * (k12 * x + k22 * y + k23 * z),
        2 * (k23 * (y * y + z * z) + k13 * x * y + (k22 + k33) * y * z + k12 * z * x),
        2 * z * (k13 * x + k23 * y + k33 * z),
        -2 * A * x - D * y - F * z,
        -D * x - 2 * B * y - E * z,
        -F * x - E * y - 2 * C * z,
    ]
    return np.stack(columns, axis=-1)


def symmetric_hessian(
    parameters: Float[Array, "9"], reading: Float[Array, "n 3"]
) -> Float[Array, "n 9 9"]:
    """All 45 second derivatives of the symmetric residual, eq. (R3)."""
    A, B, C, D, E, F = _form(parameters)
    k11, k12, k13, k22, k23, k33 = parameters[:6]
    x, y, z = (reading - parameters[6:]).T
    zero = 0.0 * x
    rows = [
        [
            2 * x * x,
            2 * x * y,
            2 * z * x,
            zero,
            zero,
            zero,
            -2 * (2 * k11 * x + k12 * y + k13 * z),
            -2 * k12 * x,
            -2 * k13 * x,
        ],
        [
            2 * (x * x + y * y),
            2 * y * z,
            2 * x * y,
            2 * z * x,
            zero,
            -2 * (2 * k12 * x + (k11 + k22) * y + k23 * z),
            -2 * ((k11 + k22) * x + 2 * k12 * y + k13 * z),
            -2 * (k23 * x + k13 * y),
        ],
        [
            2 * (x * x + z * z),
            zero,
            2 * x * y,
            2 * z * x,
            -2 * (2 * k13 * x + k23 * y + (k11 + k33) * z),
            -2 * (k23 * x + k12 * z),
            -2 * ((k11 + k33) * x + k12 * y + 2 * k13 * z),
        ],
        [
            2 * y * y,
            2 * y * z,
            zero,
            -2 * k12 * y,
            -2 * (k12 * x + 2 * k22 * y + k23 * z),
            -2 * k23 * y,
        ],
        [
            2 * (y * y + z * z),
            2 * y * z,
            -2 * (k13 * y + k12 * z),
            -2 * (k13 * x + 2 * k23 * y + (k22 + k33) * z),
            -2 * (k12 * x + (k22 + k33) * y + 2 * k23 * z),
        ],
        [2 * z * z, -2 * k13 * z, -2 * k23 * z, -2 * (k13 * x + k23 * y + 2 * k33 * z)],
        [2 * A + zero, D + zero, F + zero],
        [2 * B + zero, E + zero],
        [2 * C + zero],
    ]
    result = np.empty((len(reading), 9, 9), np.result_type(parameters, reading))
    for i, row in enumerate(rows):
        for j, value in enumerate(row, start=i):
            result[:, i, j] = result[:, j, i] = value
    return result
