"""Checks of what a plug-in answers: shapes, finite numbers, unit lengths, conventions.

Every answer of a plug-in goes through here first: an answer that fails a check, and any
exception of the plug-in, becomes a `PluginError`.
"""

import reprlib
from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, finite_array
from simval.errors import InputError, PluginError
from simval.plugins.calling import answers
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Estimator
from simval.plugins.rotations import (
    fault_of,
    finite_rows,
    package_quaternion,
    sound_rows,
    tail,
)
from simval.shapes import Float
from simval.text import message_of

LISTED = 1 << 10
"""Entries up to which nested lists are searched for truth values: all that a
calibrator answers, and what an estimator is probed with."""


def quaternions_of(
    estimator: Estimator,
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None = None,
) -> Float[Array, "n 4"]:
    """Estimate attitudes and bring them to the package's convention."""
    found = raw_attitudes(estimator, vectors, noise)
    what = "matrices" if estimator.components == "matrix" else "quaternions"
    bad = np.flatnonzero(~finite_rows(found))
    if len(bad):
        msg = (
            f"{estimator.name} returned non-finite {what} in {len(bad)} of "
            f"{len(found)} rows ({len(bad) / len(found):.3g} of them), the first is "
            f"row {bad[0]}; every row must be an estimate"
        )
        raise PluginError(msg)
    if not sound_rows(found, estimator.components).all():
        words = fault_of(found, estimator.components)
        msg = f"{estimator.name} returned {words}"
        raise PluginError(msg)
    return package_quaternion(found, estimator.components, estimator.matrix)


@where_it_lives
def raw_attitudes(
    estimator: Estimator,
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None = None,
) -> Float[Array, "n ..."]:
    """Answers in the estimator's own convention; rows need not be attitudes."""
    name, shape = estimator.name, tail(estimator.components)
    found = answers(estimator, estimator.estimate, vectors, noise)
    what = "matrices" if estimator.components == "matrix" else "quaternions"
    if estimator.batch:
        whole = (len(vectors[0]), *shape)
        return _plain(name, what, found[0], whole, hint=_other_form).astype(float)
    rows = [_plain(name, what, row, shape, hint=_other_form) for row in found]
    return np.array(rows, dtype=float)


def _other_form(found: tuple[int, ...], required: tuple[int, ...]) -> str:
    """What to declare where the shape is that of another form of answer."""
    forms = {
        (4,): ", or declare the order of the `components`",
        (3, 3): ', or declare components="matrix"',
    }
    if len(required) > 2 or required[1:] == (4,):  # a batch
        if found == (3, 3) or (found == (4,) and required[0] != 4):
            return ", or declare batch=False if it takes one sample at a time"
        return forms.get(found[1:], "") if found[:1] == required[:1] else ""
    return forms.get(found, "")


@where_it_lives
def covariances_of(
    estimator: Estimator, vectors: list[Float[Array, "n 3"]], noise: VectorNoise
) -> Float[Array, "n 3 3"]:
    """Ask an estimator for its covariances."""
    name = estimator.name
    assert estimator.covariance is not None
    shape = (len(vectors[0]), 3, 3)
    one = () if "noise_std" in estimator.reads else (noise.noise_std,)
    found = answers(estimator, estimator.covariance, vectors, noise, *one)
    if estimator.batch:
        covariances = array_of(name, "covariance", found[0], shape, (3, 3))
    else:
        covariances = np.array(
            [array_of(name, "covariance", row, (3, 3)) for row in found]
        )
    check_covariance(name, covariances)
    return np.broadcast_to(covariances, shape)


def array_of(name: str, what: str, value: Any, *shapes: tuple[int, ...]) -> Array:
    """Finite numbers of one of the shapes."""
    found = _plain(name, what, value, *shapes)
    try:
        return finite_array(what, found, found.shape)
    except InputError as error:
        msg = f"{name} returned a bad answer: {error}"
        raise PluginError(msg) from None


def _plain(
    name: str,
    what: str,
    value: Any,
    *shapes: tuple[int, ...],
    hint: Callable[[tuple[int, ...], tuple[int, ...]], str] = lambda *_: "",
) -> NDArray[np.generic]:
    """Plain numbers of one of the shapes; nothing is parsed, filled in or cut off."""
    try:
        array = np.asarray(value)
    except Exception as error:  # ragged, or whatever a user's object may raise
        msg = f"{name} returned {what} that is not an array ({message_of(error)})"
        raise PluginError(msg) from None
    if array.shape not in shapes:
        msg = (
            f"{name} returned {what} as {type(value).__name__} of shape {array.shape}; "
            f"it must be an array of shape {' or '.join(map(str, shapes))}"
            f"{hint(array.shape, shapes[0])}"
        )
        raise PluginError(msg)
    fault = "masked entries" if np.ma.is_masked(value) else _fault(array)
    if isinstance(value, list | tuple) and array.size <= LISTED and not fault:
        # among numbers, NumPy takes a truth value for 0 or 1
        fault = _fault(np.asarray(value, dtype=object))
    if fault:
        msg = f"{name} returned {what} with {fault}; every entry must be a plain number"
        raise PluginError(msg)
    # rows first, as an answer that was sent is: products of the same numbers by columns
    # end in other bits on some processors
    return np.asarray(array, order="C")


def _fault(array: NDArray[np.generic]) -> str:
    """First entry that is no real number of a double's range, with its place."""
    if array.dtype.kind in "iuf":
        return ""
    for place in np.ndindex(array.shape):
        entry: Any = array.item(place)
        if isinstance(entry, bool) or not isinstance(entry, Real):
            return f"{reprlib.repr(entry)} ({type(entry).__name__}) at {place}"
        try:
            float(entry)
        except OverflowError:
            return f"a number beyond the range of a double at {place}"
    return ""


def check_covariance(name: str, matrices: Float[Array, "... p p"]) -> None:
    """Require symmetric and positive definite matrices.

    Raises
    ------
    PluginError
        If one is not.
    """
    scale = np.abs(matrices).max(axis=(-2, -1), keepdims=True)
    skew = np.abs(matrices - np.swapaxes(matrices, -1, -2)) / np.maximum(scale, 1e-300)
    if not float(skew.max()) <= 1e-9:
        msg = f"the covariance of {name} is not symmetric"
        raise PluginError(msg)
    if not float(np.linalg.eigvalsh(matrices / np.maximum(scale, 1e-300)).min()) > 0.0:
        msg = f"the covariance of {name} is not positive definite"
        raise PluginError(msg)
