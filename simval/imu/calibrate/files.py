"""Calibration files: written, read back exactly, checked, and applied to readings.

**What a calibration file states, and whether its statements agree.**

Some statements say all, the others follow from them. A statement that follows is
recomputed and compared, entry by entry, to six digits, as a person copies them.

**A calibration as a JSON file: written, read back exactly, and checked.**

A file states one thing in several ways: parameters, T, K, B and their product, a
covariance and the error bars in it. Any of them can be left out, as long as the
sensor is determined: by `parameters` with `model`, or by T, K and B. What is there is
held against the rest, so that no edit by hand is ignored: it counts, or it is refused.

**Whether a calibration belongs to the readings it is applied to.**

A calibration turns any numbers into some force; only their size tells that they are
of another unit or another sensor. At rest, whatever the pose, the force is g. A log
without a rest says less: the mean of :math:`|f|` is at least that of the mean force in
the world, which is g but for the change of velocity over the time of the log, and
nothing that is carried is shaken at many g from end to end.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from simval.arguments import choice, file_path, instance, whole_number
from simval.arrays import (
    Array,
    json_values,
    nonnegative_number,
    positive_number,
    shaped_array,
)
from simval.errors import InputError, RefusedError
from simval.files import MOST_DOCUMENT, parsed, read_text
from simval.imu.calibrate.result import STANDARD_GRAVITY, FitResult, raw_unit
from simval.imu.calibrate.thermal import EDGE, TERMS, Term
from simval.imu.sensor import GyroscopeModel, MagnetometerModel, forms
from simval.shapes import Float
from simval.text import shown
from simval.vocabulary import Model

_ROUNDING = 1e-12  # a sum of products of two parameters is off by a few times 1e-16
_SIX_DIGITS = 5e-6  # half a unit in the sixth digit, relative, of a leading 1
_REACH = 1.5  # readings at rest, over g; the fit's own residuals are far below a half


def derived(fit: FitResult) -> dict[str, Any]:
    """Entries of a file that follow from its other entries."""
    return {
        "names": list(fit.names),
        **{
            name: json_values(getattr(fit, name))
            for name in ("T", "K", "B", "matrix", "sd")
        },
        "confidence_95": json_values(fit.intervals),
        "raw_per_g": json_values(fit.raw_per_g),
        "raw_unit": fit.raw_unit,
    }


def require_possible(fit: FitResult) -> None:
    """Refuse values that no real calibration can have."""
    fit.sensor()  # T K can be inverted
    known = np.isfinite(fit.covariance)
    if known.any() != known.all() or known.any() == (fit.covariance_kind == "none"):
        msg = (
            f"`covariance_kind` is {fit.covariance_kind!r}, and {known.sum()} of the "
            "81 entries of `covariance` are there; give both, or leave both out"
        )
        raise InputError(msg)
    if known.all():
        size = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
        skew = np.abs(fit.covariance - fit.covariance.T)
        good = (skew <= _ROUNDING * np.outer(size, size)).all() and (size > 0.0).all()
        if not good:
            msg = "`covariance` is not symmetric with variances above 0; leave it out"
            raise InputError(msg)
    low, high = fit.raw_range.T
    reach = _REACH * fit.g * np.linalg.norm(np.linalg.inv(fit.matrix), axis=1)
    stated = np.isfinite(fit.raw_range)
    inside = (fit.B - reach <= low) & (low <= high) & (high <= fit.B + reach)
    if stated.any() and not (stated.all() and inside.all()):
        msg = (
            f"`raw_range` is {shown(fit.raw_range.tolist())}, and with this g, K and B "
            f"a sensor at rest reads from {shown((fit.B - reach).tolist())} to "
            f"{shown((fit.B + reach).tolist())}; correct what is wrong, or leave it out"
        )
        raise InputError(msg)


def require_agreement(data: dict[str, Any], fit: FitResult) -> None:
    """Refuse an entry that contradicts what follows from the others."""
    for name, value in derived(fit).items():
        stated = data.get(name, value)
        if name in ("names", "raw_unit"):
            if stated != value:
                raise InputError(_contradiction(name, stated, value))
            continue
        want = np.array(value, dtype=float)
        have = array({name: stated}, name, want.shape)
        row = np.max(np.abs(want), axis=-1, keepdims=want.ndim > 1)
        same = np.abs(have - want) <= _SIX_DIGITS * np.abs(want) + _ROUNDING * row
        same |= np.isnan(have) & np.isnan(want)
        if not same.all():
            place = tuple(int(i) for i in np.argwhere(~same)[0])
            field = name + "".join(f"[{i}]" for i in place)
            values = (f"{x[place]:.12g}" for x in (have, want))
            raise InputError(_contradiction(field, *values))


def _contradiction(field: str, stated: Any, derived: Any) -> str:
    return (
        f"`{field}` is {stated}, but the rest of the file makes it {derived}; it was "
        "edited by hand in one place only: keep T, K, B and g alone, which say all, "
        "or calibrate again"
    )


def array(data: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """Read an array from a file's object; null and missing numbers become NaN."""
    if name not in data:
        return np.full(shape, np.nan)
    numbers = shaped_array(name, _filled(data[name]), ())
    if numbers.shape != shape or np.isinf(numbers).any():
        msg = (
            f"`{name}` has shape {numbers.shape}; finite numbers of {shape} are needed"
        )
        raise InputError(msg)
    return numbers


def _filled(value: Any) -> Any:
    if isinstance(value, list):
        return [_filled(entry) for entry in value]
    return np.nan if value is None else value


FORMAT = "simval calibration 1"
_NUMBERS = ("cost", "condition", "rms", "chi2_per_dof", "gradient_norm")
_WORDS = ("method", "residual", "loss")
_KINDS = ("known sigma", "type A", "none")


def to_json(fit: FitResult) -> dict[str, Any]:
    """Return one fit as plain JSON values; NaN becomes null."""
    if instance("fit", fit, FitResult).parameters.ndim != 1:
        msg = f"this is a batch of {len(fit.parameters)} fits; pick one of them"
        raise InputError(msg)
    return {
        "format": FORMAT,
        **{name: getattr(fit, name) for name in ("model", *_WORDS)},
        "g": fit.g,
        "g_std": fit.g_std,
        "covariance_kind": fit.covariance_kind,
        "dof": fit.dof,
        "status": str(fit.status),
        "iterations": int(fit.iterations),
        **{name: json_values(getattr(fit, name)) for name in _NUMBERS},
        "parameters": json_values(fit.parameters),
        "covariance": json_values(fit.covariance),
        "raw_range": json_values(fit.raw_range),
        **derived(fit),
    }


def from_json(data: Any, source: str = "the calibration") -> FitResult:
    """Rebuild a fit from what `to_json` made, or from T, K and B."""
    if not isinstance(data, dict) or data.get("format", FORMAT) != FORMAT:
        msg = (
            f"{source} is not a calibration file (it has no format {FORMAT!r}); "
            "write one with `simval calibrate LOG --out FILE`"
        )
        raise InputError(msg)
    with named(source):
        model, parameters = _parameters(data)
        words: dict[str, Any] = {n: _word(data, n, "not stated") for n in _WORDS}
        numbers: dict[str, Any] = {name: array(data, name, ()) for name in _NUMBERS}
        fit = FitResult(
            model=model,
            parameters=parameters,
            g=positive_number("g", data.get("g", STANDARD_GRAVITY), "m/s^2"),
            g_std=nonnegative_number("g_std", data.get("g_std", 0.0), "m/s^2"),
            status=np.str_(_word(data, "status", "converged")),
            iterations=np.int64(_count(data, "iterations")),
            covariance=array(data, "covariance", (9, 9)),
            covariance_kind=choice(
                "covariance_kind", data.get("covariance_kind", "none"), _KINDS
            ),
            dof=_count(data, "dof"),
            raw_range=array(data, "raw_range", (3, 2)),
            **words,
            **numbers,
        )
        require_possible(fit)
        require_agreement(data, fit)
    return fit


@contextmanager
def named(source: str | Path) -> Iterator[None]:
    """Name the file, or a part of it, in errors about missing or wrong values."""
    try:
        yield
    except InputError as error:
        msg = f"{source}: {error}"
    except KeyError as error:
        msg = f"{source}: lacks {error}; write it with `simval calibrate --out`"
    else:
        return
    raise InputError(msg) from None


def _parameters(data: dict[str, Any]) -> tuple[Model, Float[Array, "9"]]:
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
        form = forms.check_model(model)
        match = forms.from_factors(form, data["T"], data["K"], bias)
        if match is not None:
            return form, match
    msg = (
        f"`T` is {shown(data['T'])} and `K` {shown(data['K'])}; three scales with a T "
        "of unit diagonal and zeros above or below it, or T the identity and a "
        "symmetric K, are needed"
    )
    raise InputError(msg)


def write_json(path: str | PathLike[str], data: dict[str, Any]) -> None:
    """Write a JSON object to a file."""
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
        The fit, bit for bit; where there are terms in temperature (`load_thermal`), at
        their reference.

    Raises
    ------
    InputError
        If the file is missing, is not a calibration, or contradicts itself.
    """
    return from_json(load_document(path), str(path))


def load_document(path: str | PathLike[str]) -> Any:
    """Read everything that the JSON file of a calibration holds."""
    path = file_path("path", path)
    try:
        text = read_text(path, MOST_DOCUMENT)
        return parsed(json.loads, text, object_pairs_hook=_once)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror}; give the path of a calibration"
        raise InputError(msg) from None
    except ValueError as error:
        msg = f"{path} is not JSON ({error}); give a file of `simval calibrate --out`"
        raise InputError(msg) from None


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


BLOCKS = ("gyroscope", "magnetometer")


def load_others(
    path: str | Path,
) -> tuple[GyroscopeModel | None, MagnetometerModel | None]:
    """Read the other sensors of a file whose accelerometer is loaded already."""
    data = load_document(path)
    gyroscope, magnetometer = (_block(path, data, name) for name in BLOCKS)
    made: list[Any] = [None, None]
    if gyroscope is not None:
        with named(f"{path}: gyroscope"):
            own = {name: gyroscope[name] for name in ("M", "B")}
            made[0] = GyroscopeModel(**own, G=gyroscope.get("G"))
    if magnetometer is not None:
        with named(f"{path}: magnetometer"):
            own = {name: magnetometer[name] for name in ("M", "b")}
            made[1] = MagnetometerModel(**own)
    return made[0], made[1]


def load_thermal(path: str | Path) -> dict[str, Term]:
    """Read the temperature terms of a file whose accelerometer is loaded already."""
    block = _block(path, load_document(path), "temperature") or {}
    found = {}
    for name, own in (_block(path, block, "sensors") or {}).items():
        with named(f"{path}: the terms in temperature of the {name}"):
            found[name] = _thermal(instance(name, own, dict))
    return found


_USABLE = 1e50  # far beyond any coefficient; its square is still a number


def _thermal(own: dict[str, Any]) -> Term:
    listed = instance("terms", own["terms"], list)
    terms = tuple(term for term in TERMS if list(term) in listed)
    size = len(terms)
    if size == 0 or [list(term) for term in terms] != listed:
        msg = f"`terms` is {shown(listed)}; it must be some of {TERMS}, in order"
        raise InputError(msg)
    low, high = array(own, "range_degC", (2,))
    found = Term(
        reference=float(array(own, "reference_degC", ())), low=low, high=high,
        terms=terms, coefficients=array(own, "coefficients", (size, 3)),
        covariance=array(own, "covariance", (3 * size, 3 * size)),
        centre=array(own, "centre", (3,)), dof=whole_number("dof", own["dof"], 1),
    )  # fmt: skip
    numbers = (found.coefficients, found.centre, found.covariance)
    usable = all(np.all(np.abs(x) < _USABLE) for x in numbers)
    variances = np.diagonal(found.covariance)
    if not (low <= found.reference <= high and usable and np.all(variances > 0.0)):
        msg = (
            "a number is missing or absurdly large, a variance is not above 0, "
            "or the reference is outside the range; write the file with "
            "`simval calibrate --out`"
        )
        raise InputError(msg)
    return found


def at_temperature(
    thermal: dict[str, Term],
    readings: dict[str, Any],
    temperature: Any,
    *,
    extrapolate: bool = False,
) -> tuple[dict[str, Any], list[str]]:
    """Raw readings as at the calibration's temperature, and remarks.

    By the terms of `load_thermal` and the temperature of each row, degrees Celsius; far
    beyond what the calibration saw only if that is asked for.
    """
    made, said = dict(readings), []
    for name, own in thermal.items():
        if readings.get(name) is None:
            continue
        if temperature is None:
            msg = (
                f"the calibration of the {name} depends on temperature (at "
                f"{own.reference:.1f} degC, seen from {own.low:.1f} to {own.high:.1f}) "
                "and the log has none; name its column `temp` (--columns), or, of "
                "`simval correct`, state it (--temperature DEGC)"
            )
            raise RefusedError(msg)
        rows, off = own.outside(temperature)
        where = (
            f"{rows} of {len(temperature)} rows are outside of {own.low:.2f} to "
            f"{own.high:.2f} degC, which the {name}'s calibration has seen, by up to "
            f"{off:.2f} K"
        )
        if rows and off > EDGE * (own.high - own.low) and not extrapolate:
            msg = (
                f"{where}; no reading there supports it: calibrate over a wider "
                "range, cut the log, or extrapolate the polynomial (--extrapolate)"
            )
            raise RefusedError(msg)
        if rows:
            said.append(f"extrapolated      {where}")
        made[name] = own.compensated(readings[name], temperature)
    return made, said


def _block(path: str | Path, data: dict[str, Any], name: str) -> dict[str, Any] | None:
    block = data.get(name)
    if block is None or isinstance(block, dict):
        return block
    msg = f"{path}: `{name}` is no table; write it with `simval calibrate --out`"
    raise InputError(msg)


# Another temperature moves a bias by 0.1 g and a scale by 3 %; the least mistake of a
# unit or a range is a factor of 2.
_REST = (0.75, 1.25)
# Mean |f| of a moving log, in g: g for m/s^2 is a factor of 9.8.
_MOVING = (0.75, 8.0)
_WINDOW = 0.5  # s; a hand at rest holds still for as long
_FEWEST = 10  # rows from which a scatter means something
QUIET = 0.05  # scatter of a window at rest over its mean; a cheap sensor has 0.02


def require_same_sensor(fit: FitResult, raw: Float[Array, "n 3"], rate: float) -> None:
    """Refuse readings that cannot be of the sensor that was calibrated."""
    force = fit.sensor().correct(raw) / fit.g
    rests = rest_forces(force, rate)
    if rests.size:
        typical, (low, high) = np.median(rests), _REST
        what = f"{rests.size} stretches at rest"
    else:
        typical, (low, high) = np.linalg.norm(force, axis=1).mean(), _MOVING
        what = "mean reading, in motion,"
    if low <= typical <= high:
        return
    length = np.median(np.linalg.norm(raw, axis=1))
    msg = (
        f"the log's {what} would become {typical * fit.g:.4g} m/s^2, where "
        f"{low * fit.g:.3g} to {high * fit.g:.3g} is possible: {_made_from(fit)}, and "
        f"the log holds {raw.min():.6g} to {raw.max():.6g} (by size: "
        f"{raw_unit(length)}); give the log in the unit that was calibrated, or the "
        "calibration of this sensor and unit, or --unchecked if the force is real"
    )
    raise RefusedError(msg)


def rest_forces(force: Float[Array, "n 3"], rate: float) -> Float[Array, " m"]:
    """Length of the mean specific force of each stretch at rest."""
    windows = half_seconds(force, rate)
    means = np.linalg.norm(windows.mean(axis=1), axis=1)
    scatter = np.linalg.norm(windows.std(axis=1), axis=1)
    return means[scatter < QUIET * means]


def half_seconds(rows: Float[Array, "n 3"], rate: float) -> Float[Array, "m k 3"]:
    """Cut rows into stretches of half a second; the last, shorter one is dropped."""
    size = max(_FEWEST, round(_WINDOW * rate))
    return rows[: len(rows) // size * size].reshape(-1, size, 3)


def _made_from(fit: FitResult) -> str:
    # what the calibration was made from, or what it reads at rest
    per_g = np.mean(np.abs(fit.raw_per_g))
    unit = f"{fit.raw_unit}, {per_g:.6g} of them for {fit.g:.6g} m/s^2"
    if np.isfinite(fit.raw_range).all():
        ends = f"{fit.raw_range.min():.6g} to {fit.raw_range.max():.6g}"
        return f"the calibration was made from readings of {ends} ({unit})"
    low, high = (fit.B - per_g).min(), (fit.B + per_g).max()
    return (
        f"the calibration is for readings of {low:.6g} to {high:.6g} at rest ({unit})"
    )
