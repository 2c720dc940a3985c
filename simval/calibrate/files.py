"""A calibration as a JSON file: written, read back exactly, and checked."""

import json
from os import PathLike
from typing import Any

import numpy as np

from simval.arguments import file_path, instance
from simval.arrays import Array, positive_number
from simval.calibrate.result import FitResult
from simval.errors import InputError
from simval.sensor import forms

FORMAT = "simval calibration 1"
_NUMBERS = ("cost", "condition", "rms", "chi2_per_dof", "gradient_norm")


def to_json(fit: FitResult) -> dict[str, Any]:
    """Return one fit as plain JSON values; NaN becomes null.

    Parameters
    ----------
    fit : FitResult
        Fit of one set.

    Returns
    -------
    dict
        Everything that `from_json` needs, and T, K, matrix, sd and names to read.

    Raises
    ------
    InputError
        If the fit is a batch.
    """
    if instance("fit", fit, FitResult).parameters.ndim != 1:
        msg = f"a batch of {len(fit.parameters)} fits is not one calibration; pick one"
        raise InputError(msg)
    numbers = {name: _plain(getattr(fit, name)) for name in _NUMBERS}
    return {
        "format": FORMAT,
        "model": fit.model,
        "method": fit.method,
        "residual": fit.residual,
        "loss": fit.loss,
        "g": fit.g,
        "names": list(fit.names),
        "parameters": _plain(fit.parameters),
        "sd": _plain(fit.sd),
        "T": _plain(fit.T),
        "K": _plain(fit.K),
        "B": _plain(fit.B),
        "matrix": _plain(fit.matrix),
        "covariance": _plain(fit.covariance),
        "covariance_kind": fit.covariance_kind,
        "confidence_95": _plain(fit.intervals),
        "dof": fit.dof,
        "status": str(fit.status),
        "iterations": int(fit.iterations),
        **numbers,
    }


def from_json(data: Any, source: str = "the calibration") -> FitResult:
    """Rebuild a fit from what `to_json` made.

    Parameters
    ----------
    data : dict
        Plain JSON values.
    source : str, default "the calibration"
        Where they came from, for messages.

    Returns
    -------
    FitResult
        The same fit, bit for bit.

    Raises
    ------
    InputError
        If a value is missing or wrong, or T and K contradict the parameters.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        msg = f"{source} is not a calibration file (no format {FORMAT!r}); write one "
        raise InputError(msg + "with `simval calibrate LOG --out FILE`")
    try:
        model = forms.check_model(data["model"])
        fit = FitResult(
            model=model,
            method=str(data["method"]),
            residual=str(data["residual"]),
            loss=str(data["loss"]),
            g=positive_number("g", data["g"], "m/s^2"),
            parameters=_array(data, "parameters", (9,)),
            covariance=_array(data, "covariance", (9, 9)),
            covariance_kind=str(data["covariance_kind"]),
            dof=int(data["dof"]),
            status=np.str_(data["status"]),
            iterations=np.int64(data["iterations"]),
            **{name: _array(data, name, ()) for name in _NUMBERS},
        )
        stated = _array(data, "matrix", (3, 3))
    except KeyError as error:
        msg = f"{source} lacks {error}; write it again with `simval calibrate --out`"
        raise InputError(msg) from None
    except (TypeError, ValueError, OverflowError) as error:
        msg = f"{source} has a value that cannot be used: {error}; write it again"
        raise InputError(msg) from None
    if not np.isfinite(fit.parameters).all():
        msg = f"{source} has parameters that are not finite; calibrate again"
        raise InputError(msg)
    # the matrix is a product of two parameters, so equal to a few roundings
    scale = np.abs(fit.matrix).max()
    if not np.abs(stated - fit.matrix).max() <= 1e-12 * scale:
        msg = (
            f"{source}: `matrix` does not belong to `parameters`; it was edited by "
            "hand in one place only: change both, or calibrate again"
        )
        raise InputError(msg)
    return fit


def write_json(path: str | PathLike[str], data: dict[str, Any]) -> None:
    """Write a JSON object to a file.

    Parameters
    ----------
    path : path-like
        File to write.
    data : dict
        Plain JSON values.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = file_path("path", path)
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}; choose another file"
        raise InputError(msg) from None


def save_calibration(path: str | PathLike[str], fit: FitResult) -> None:
    """Write one fit to a JSON file.

    Parameters
    ----------
    path : path-like
        File to write.
    fit : FitResult
        Fit of one set.
    """
    write_json(path, to_json(fit))


def load_calibration(path: str | PathLike[str]) -> FitResult:
    """Read a fit from a JSON file.

    Parameters
    ----------
    path : path-like
        File that `save_calibration` or ``simval calibrate`` wrote.

    Returns
    -------
    FitResult
        The fit, bit for bit.

    Raises
    ------
    InputError
        If the file is missing or is not a calibration.
    """
    path = file_path("path", path)
    try:
        text = path.read_text(encoding="utf-8")
        data = json.loads(text)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give the path of a calibration"
        raise InputError(msg) from None
    except (ValueError, RecursionError) as error:
        msg = f"{path} is not JSON ({error}); give a file of `simval calibrate --out`"
        raise InputError(msg) from None
    return from_json(data, str(path))


def _plain(value: Any) -> Any:
    # lists of floats, NaN as None
    array = np.asarray(value, dtype=float)
    plain = array.astype(object)
    plain[~np.isfinite(array)] = None
    return plain.tolist()


def _array(data: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    array = np.array(data[name], dtype=float)  # null becomes NaN
    if array.shape != shape:
        msg = f"`{name}` has shape {array.shape}, not {shape}"
        raise InputError(msg)
    return array
