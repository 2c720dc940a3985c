"""What every sensor model does to rows of three, whatever it measures."""

from typing import Any

import numpy as np

from simval.arrays import Array, frozen, physical_array
from simval.errors import InputError
from simval.shapes import Float
from simval.text import shown


def unscaled(
    matrix: Float[Array, "3 3"], values: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Readings less bias that a matrix M takes to these values, M^-1 of each row."""
    rows: Array = np.linalg.solve(matrix, values.reshape(-1, 3).T).T
    return rows.reshape(values.shape)


def levels_of_axes(name: str, value: Any) -> Float[Array, "3"]:
    """One number of 0 or more for each axis, from three or from one for all.

    Raises
    ------
    InputError
        If it is neither.
    """
    array = physical_array(name, value, ())
    if array.shape not in ((), (3,)) or not np.all(array >= 0.0):
        msg = f"`{name}` is {shown(value)}; give one number or three, each 0 or more"
        raise InputError(msg)
    return frozen(np.broadcast_to(array, (3,)))
