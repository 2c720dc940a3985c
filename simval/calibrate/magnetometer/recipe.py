r"""The usual recipe, for comparison: an ellipsoid for each sensor, then a turn.

An unweighted ellipsoid for each sensor, :math:`M_m = R\,S` with S symmetric, and the
rotation R and the sine s of the dip with the least
:math:`\sum (u^T R S (y - b) + s)^2`. It throws away what the angle between the two
vectors says of shape and hard iron.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.arguments import checked_readings
from simval.calibrate.frame import normalized
from simval.calibrate.magnetometer.start import refined, shape, turn_between
from simval.errors import GeometryError, InputError
from simval.sensor import forms
from simval.shapes import Float


def ellipsoid_then_rotation(
    accelerometer: Any, magnetometer: Any
) -> Float[Array, "... 13"]:
    """Matrix, hard iron and dip of the usual recipe, field strength 1.

    Parameters
    ----------
    accelerometer, magnetometer : array_like
        Mean reading of each pose, raw units, (n, 3) or (trials, n, 3), n nine or more.

    Returns
    -------
    Array
        Rows of M on the axes of the triangular form, b in raw units, and the dip in
        rad, (13,) or (trials, 13).

    Raises
    ------
    InputError
        If a shape is wrong, or a reading of one set is not finite.
    GeometryError
        If a set fixes no ellipsoid.
    """
    pair = [checked_readings(accelerometer), checked_readings(magnetometer)]
    if pair[0].shape != pair[1].shape:
        msg = (
            f"`accelerometer` has shape {pair[0].shape} and `magnetometer` "
            f"{pair[1].shape}; give the means of both sensors over the same poses"
        )
        raise InputError(msg)
    count = pair[0].shape[-2]
    (za, _, _), (zm, centre, scale) = (
        normalized(readings.reshape(-1, count, 3)) for readings in pair
    )
    body, iron = shape(za), shape(zm)
    if not (np.all(body.quadric) and np.all(iron.quadric)):
        msg = (
            "the readings of a sensor fix no ellipsoid; the recipe needs one for each, "
            "so turn the sensors to all sides"
        )
        raise GeometryError(msg)
    theta = forms.from_gram("triangular", body.root @ body.root, body.bias)
    matrix = forms.matrix("triangular", theta)
    up = (za - body.bias[:, None]) @ np.swapaxes(matrix, -1, -2)
    field = (zm - iron.bias[:, None]) @ iron.root
    turn, sine = refined(up, field, *turn_between(up, field))
    result = np.concatenate(
        [
            (turn @ iron.root / scale[:, None, None]).reshape(-1, 9),
            iron.bias * scale[:, None] + centre,
            np.arcsin(np.clip(sine, -1.0, 1.0))[:, None],
        ],
        axis=1,
    )
    return result[0] if pair[0].ndim == 2 else result
