"""A calibration as a JSON file: written, read back exactly, and checked.

A file states one thing in several ways: parameters, T, K, B and their product, a
covariance and the error bars in it. Any of them can be left out, as long as the
sensor is determined: by `parameters` with `model`, or by T, K and B. What is there is
held against the rest, so that no edit by hand is ignored: it counts, or it is refused.
"""

import json
from os import PathLike
from typing import Any

import numpy as np

from simval.arguments import file_path, instance, whole_number
from simval.arrays import Array, positive_number, shaped_array
from simval.calibrate.result import STANDARD_GRAVITY, FitResult
from simval.calibrate.statements import (
    array,
    derived,
    plain,
    require_agreement,
    require_possible,
)
from simval.errors import InputError
from simval.files import MOST_DOCUMENT, parsed_json, read_text
from simval.sensor import forms
from simval.shapes import Float
from simval.text import shown

FORMAT = "simval calibration 1"
_NUMBERS = ("cost", "condition", "rms", "chi2_per_dof", "gradient_norm")
_WORDS = ("method", "residual", "loss")
_KINDS = ("known sigma", "type A", "none")


def to_json(fit: FitResult) -> dict[str, Any]:
    """Return one fit as plain JSON values; NaN becomes null.

    Raises
    ------
    InputError
        If the fit is a batch.
    """
    if instance("fit", fit, FitResult).parameters.ndim != 1:
        msg = f"a batch of {len(fit.parameters)} fits is not one calibration; pick one"
        raise InputError(msg)
    return {
        "format": FORMAT,
        **{name: getattr(fit, name) for name in ("model", *_WORDS)},
        "g": fit.g,
        "covariance_kind": fit.covariance_kind,
        "dof": fit.dof,
        "status": str(fit.status),
        "iterations": int(fit.iterations),
        **{name: plain(getattr(fit, name)) for name in _NUMBERS},
        "parameters": plain(fit.parameters),
        "covariance": plain(fit.covariance),
        "raw_range": plain(fit.raw_range),
        **derived(fit),
    }


def from_json(data: Any, source: str = "the calibration") -> FitResult:
    """Rebuild a fit from what `to_json` made, or from T, K and B.

    Raises
    ------
    InputError
        If a value is missing or wrong, or two of them contradict each other.
    """
    if not isinstance(data, dict) or data.get("format", FORMAT) != FORMAT:
        msg = f"{source} is not a calibration file (no format {FORMAT!r}); write one "
        raise InputError(msg + "with `simval calibrate LOG --out FILE`")
    try:
        model, parameters = _parameters(data)
        words = {name: _word(data, name, "not stated") for name in _WORDS}
        numbers: dict[str, Any] = {name: array(data, name, ()) for name in _NUMBERS}
        fit = FitResult(
            model=model,
            parameters=parameters,
            method=words["method"],
            residual=words["residual"],
            loss=words["loss"],
            g=positive_number("g", data.get("g", STANDARD_GRAVITY), "m/s^2"),
            status=np.str_(_word(data, "status", "converged")),
            iterations=np.int64(_count(data, "iterations")),
            covariance=array(data, "covariance", (9, 9)),
            covariance_kind=_kind(data),
            dof=_count(data, "dof"),
            raw_range=array(data, "raw_range", (3, 2)),
            **numbers,
        )
        require_possible(fit)
        require_agreement(data, fit)
    except InputError as error:
        msg = f"{source}: {error}"
        raise InputError(msg) from None
    return fit


def _parameters(data: dict[str, Any]) -> tuple[str, Float[Array, "9"]]:
    # the form and the nine parameters, or those that T, K and B amount to
    if "parameters" in data and "model" in data:
        parameters = array(data, "parameters", (9,))
        if not np.isfinite(parameters).all():
            msg = "`parameters` are not finite; calibrate again"
            raise InputError(msg)
        return forms.check_model(data["model"]), parameters
    if not all(name in data for name in ("T", "K", "B")):
        missing = [n for n in ("model", "parameters", "T", "K", "B") if n not in data]
        msg = (
            f"lacks {', '.join(map(repr, missing))}; a calibration is `model` with "
            "`parameters`, or T, K and B: write it with `simval calibrate --out`"
        )
        raise InputError(msg)
    bias = shaped_array("B", data["B"], (3,))
    for model in [data["model"]] if "model" in data else forms.MODELS:
        match = forms.from_factors(forms.check_model(model), data["T"], data["K"], bias)
        if match is not None:
            return model, match
    msg = (
        f"`T` is {shown(data['T'])} and `K` {shown(data['K'])}; three scales with a T "
        "of unit diagonal and zeros above or below it, or T the identity and a "
        "symmetric K, are needed"
    )
    raise InputError(msg)


def write_json(path: str | PathLike[str], data: dict[str, Any]) -> None:
    """Write a JSON object to a file.

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
        File that `save_calibration` or ``simval calibrate`` wrote, or one with T, K
        and B (and g, m/s^2) written by hand.

    Returns
    -------
    FitResult
        The fit, bit for bit.

    Raises
    ------
    InputError
        If the file is missing, is not a calibration, or contradicts itself.
    """
    path = file_path("path", path)
    try:
        text = read_text(path, MOST_DOCUMENT)
        data = parsed_json(text, _once)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give the path of a calibration"
        raise InputError(msg) from None
    except ValueError as error:
        msg = f"{path} is not JSON ({error}); give a file of `simval calibrate --out`"
        raise InputError(msg) from None
    return from_json(data, str(path))


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    # the last of two entries of one name would silence the first
    data = dict(pairs)
    if len(data) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        msg = f"{twice!r} is given twice"
        raise ValueError(msg)
    return data


def _word(data: dict[str, Any], name: str, default: str) -> str:
    return instance(name, data.get(name, default), str)


def _count(data: dict[str, Any], name: str) -> int:
    return whole_number(name, data.get(name, 0), 0)


def _kind(data: dict[str, Any]) -> str:
    kind = _word(data, "covariance_kind", "none")
    if kind not in _KINDS:
        msg = f"`covariance_kind` is {kind!r}; it must be one of {', '.join(_KINDS)}"
        raise InputError(msg)
    return kind
