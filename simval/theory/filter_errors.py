r"""Errors of readings that a filter takes for true: of a calibration, or of each row.

A reading is off by :math:`B_k c`. With the parameters c of a matrix E, row by row, a
gyroscope reads :math:`\omega + E \omega`, or with a sensitivity to the specific force
:math:`\omega + E f`, and a vector sensor :math:`v + E v + e`; so

.. math:: B = I \otimes x^T, \quad x = \omega,\ f, \qquad B = [I \otimes v^T,\ I].
   \tag{F6}
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, frozen, physical_array
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_model import covariance_matrix

GYROSCOPE: Final = "gyroscope"
G_SENSITIVITY: Final = "g-sensitivity"
MATRIX: Final = 9
AFFINE: Final = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationError:
    """Constant error of a sensor's calibration, eq. (F6).

    Attributes
    ----------
    of : str
        ``gyroscope`` (scale and misalignment, 9), ``g-sensitivity`` (of the gyroscope,
        rad/s per m/s^2, 9), or the name of a vector sensor (9, then the offset, 3).
    covariance : Array or None
        Of the parameters, (9, 9) or (12, 12); None is zero.
    value : Array or None
        Known mean of them, (9,) or (12,); None is zero.
    force : Array or None
        Specific force, average over each step, body axes, m/s^2, (T, 3): of the
        ``g-sensitivity`` alone.

    Raises
    ------
    InputError
        If a shape does not fit, or the covariance is none.
    """

    of: str
    covariance: Float[Array, "p p"] | None = None
    value: Float[Array, " p"] | None = None
    force: Float[Array, "T 3"] | None = None

    def __post_init__(self) -> None:
        instance("of", self.of, str)
        p = self.parameters
        if self.covariance is not None:
            given = covariance_matrix("covariance", self.covariance, p)
            object.__setattr__(self, "covariance", frozen(given))
        if self.value is not None:
            value = physical_array("value", self.value, (p,))
            if value.shape != (p,):
                msg = f"`value` of {self.of} has shape {value.shape}; give ({p},)"
                raise InputError(msg)
            object.__setattr__(self, "value", frozen(value))
        if (self.force is not None) != (self.of == G_SENSITIVITY):
            msg = (
                f"`force` is {'' if self.force is not None else 'not '}given for "
                f"{self.of}; the g-sensitivity needs it, and nothing else has it"
            )
            raise InputError(msg)
        if self.force is not None:
            force = physical_array("force", self.force, (None, 3))
            object.__setattr__(self, "force", frozen(force))

    @property
    def parameters(self) -> int:
        """How many parameters it has."""
        return MATRIX if self.of in (GYROSCOPE, G_SENSITIVITY) else AFFINE

    @property
    def name(self) -> str:
        """What it is called in a budget."""
        return "g-sensitivity" if self.of == G_SENSITIVITY else f"{self.of} calibration"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowError:
    """Known error of every reading of a sensor.

    Attributes
    ----------
    of : str
        ``gyroscope``, rad/s, or the name of a vector sensor, its unit.
    rows : Array
        What is read less what is true, body axes, (T, 3).

    Raises
    ------
    InputError
        If the rows are no finite (T, 3).
    """

    of: str
    rows: Float[Array, "T 3"]

    def __post_init__(self) -> None:
        instance("of", self.of, str)
        rows = physical_array("rows", self.rows, (None, 3))
        if rows.ndim != 2 or len(rows) == 0:
            msg = f"`rows` of {self.of} has shape {rows.shape}; give one of each step"
            raise InputError(msg)
        object.__setattr__(self, "rows", frozen(rows))

    @property
    def parameters(self) -> int:
        """One: its size."""
        return 1


Error = CalibrationError | RowError


def channel(error: Error) -> str:
    """Whose readings are off."""
    return GYROSCOPE if error.of == G_SENSITIVITY else error.of


def by_parameters(
    error: Error, truth: Float[Array, "t 3"], rows: slice
) -> Float[Array, "t 3 p"]:
    """B of eq. (F6) of some rows, whose true reading is `truth`."""
    if isinstance(error, RowError):
        return error.rows[rows, :, None]
    if error.force is not None:
        return _kron(error.force[rows])
    if error.of == GYROSCOPE:
        return _kron(truth)
    offset = np.broadcast_to(np.eye(3), (len(truth), 3, 3))
    return np.concatenate([_kron(truth), offset], axis=-1)


def check_errors(errors: Any, sensors: tuple[str, ...], T: int) -> tuple[Error, ...]:
    """Require errors of sensors that there are, one for each of T steps.

    Raises
    ------
    InputError
        If an error is of another sensor, or has another number of rows.
    """
    known = (GYROSCOPE, G_SENSITIVITY, *sensors)
    if not isinstance(errors, list | tuple):
        msg = f"`errors` is {type(errors).__name__}; give a list of errors, or ()"
        raise InputError(msg)
    for each in errors:
        if not isinstance(each, Error):
            msg = (
                f"`errors` has {type(each).__name__}; give errors of a calibration "
                "(`CalibrationError`) or of rows (`RowError`)"
            )
            raise InputError(msg)
        if each.of not in known:
            msg = f"`errors` has one of {each.of!r}; there are {', '.join(known)}"
            raise InputError(msg)
        rows = each.rows if isinstance(each, RowError) else each.force
        if rows is not None and rows.shape != (T, 3):
            msg = (
                f"the error of {each.of} has rows of shape {rows.shape}; the path has "
                f"{T} steps, so give ({T}, 3)"
            )
            raise InputError(msg)
    return tuple(errors)


def _kron(x: Float[Array, "t 3"]) -> Float[Array, "t 3 9"]:
    return (np.eye(3)[:, :, None] * x[:, None, None, :]).reshape(len(x), 3, 9)
