"""Checks of what a calibrator answers: shapes, finite numbers, what it estimates."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError
from simval.plugins.answers import array_of, check_covariance
from simval.plugins.calling import called
from simval.plugins.child import where_it_lives
from simval.plugins.protocol import BatchCalibrator, Calibrator
from simval.sensor import forms
from simval.sensor.estimated import FIXED, places_of
from simval.shapes import Float

MIN_FREEDOM = 5
"""Least degrees of freedom of a Type A covariance: with fewer the normalised square
has no variance."""

ROUNDING = 1e-12
"""Relative, by which an entry that is not estimated may differ from what it is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A checked answer of a calibrator."""

    matrix: Float[Array, "3 3"]  # raw readings less bias to specific force
    bias: Float[Array, "3"]  # raw units
    # of the parameters that are estimated; of all nine in the declared form
    covariance: Float[Array, "p p"] | None = None
    # degrees of freedom of a covariance of type A; None where its size is known
    dof: int | None = None

    def parameters(self, form: str) -> Float[Array, "9"]:
        """Bring it to one of the forms: norms fix no more."""
        return forms.from_gram(form, self.matrix.T @ self.matrix, self.bias)


@where_it_lives
def calibration_of(
    calibrator: Calibrator, poses: Float[Array, "n 3"], g: float, noise_std: float
) -> Calibration:
    """Calibrate one set of poses."""
    name = calibrator.name
    arguments: tuple[Any, ...] = (poses.copy(), g)
    if calibrator.noise_std:
        arguments = (*arguments, noise_std)
    answer = called(name, calibrator.calibrate, *arguments)
    return _checked(name, calibrator, answer)


@where_it_lives
def calibrations_of(
    calibrator: Calibrator,
    sets: Float[Array, "t n 3"],
    g: float,
    noise_std: float,
    seconds: float,
) -> list[Calibration]:
    """Calibrate many sets of poses; in a batch, within some seconds for all."""
    if not isinstance(calibrator, BatchCalibrator):
        return [calibration_of(calibrator, poses, g, noise_std) for poses in sets]
    name = calibrator.name
    every = called(name, calibrator.calibrate_all, sets.copy(), g, noise_std, seconds)
    return [
        _checked(f"{name}, trial {trial},", calibrator, answer)
        for trial, answer in enumerate(every)
    ]


def _checked(name: str, calibrator: Calibrator, answer: Any) -> Calibration:
    given, bias, covariance = _parts(name, answer)
    places = places_of(calibrator.estimates)
    matrix = array_of(name, "matrix", given, (3, 3))
    if 0 not in places:
        _require_class(name, calibrator.estimates, matrix)
    checked = None
    if covariance is not None:
        checked = array_of(name, "covariance", covariance, (len(places),) * 2)
        check_covariance(name, checked)
    return Calibration(  # in copies: the next answer may be in the same arrays
        matrix=matrix.copy(),
        bias=array_of(name, "B", bias, (3,)).copy(),
        covariance=None if checked is None else checked.copy(),
        dof=_dof(name, answer, len(places)),
    )


def _require_class(
    name: str, estimates: tuple[str, ...], matrix: Float[Array, "3 3"]
) -> None:
    """Require the matrix of a calibrator that estimates less to be of its class."""
    scaled = "scale" in estimates
    fixed = np.diag(np.diagonal(matrix)) if scaled else np.diag(FIXED[3:6])
    off = np.abs(matrix - fixed)
    if not float(off.max()) <= ROUNDING * float(np.abs(fixed).max()):
        row, column = (int(k) for k in np.unravel_index(off.argmax(), off.shape))
        msg = (
            f"{name} estimates {' and '.join(estimates)}, so its matrix must be "
            f"{'diagonal' if scaled else 'the unit matrix'}, but it has "
            f"{matrix[row, column]:.6g} in row {row}, column {column}; declare in "
            "`estimates` what it estimates"
        )
        raise PluginError(msg)


def _dof(name: str, answer: Any, parameters: int) -> int | None:
    if not isinstance(answer, Mapping) or answer.get("covariance_kind") != "type A":
        return None
    dof = answer.get("dof")
    if not (isinstance(dof, int) and dof >= MIN_FREEDOM):
        msg = (
            f"{name} gives a covariance of type A with `dof` {dof!r}; its degrees of "
            f"freedom must be a whole number, {MIN_FREEDOM} or more: use "
            f"{parameters + MIN_FREEDOM} poses or more"
        )
        raise PluginError(msg)
    return dof


def _parts(name: str, answer: Any) -> tuple[Any, Any, Any]:
    if isinstance(answer, Mapping):
        if "matrix" in answer:
            matrix = answer["matrix"]
        elif {"T", "K"} <= answer.keys():
            T = array_of(name, "T", answer["T"], (3, 3))
            K = array_of(name, "K", answer["K"], (3,), (3, 3))
            matrix = T @ (np.diag(K) if K.ndim == 1 else K)
        else:
            matrix = None
        bias = answer.get("B", answer.get("bias"))
        if matrix is None or bias is None:
            keys = ", ".join(str(key) for key in answer) or "nothing"
            msg = (
                f"{name} answered with {keys}; it must hold `matrix` (or `T` and `K`) "
                "and `B`"
            )
            raise PluginError(msg)
        return matrix, bias, answer.get("covariance")
    if isinstance(answer, (tuple, list)) and len(answer) in (2, 3):
        return answer[0], answer[1], answer[2] if len(answer) == 3 else None
    msg = (
        f"{name} answered with {type(answer).__name__}; it must be (matrix, bias), "
        "(matrix, bias, covariance) or a mapping with `matrix` and `B`"
    )
    raise PluginError(msg)
