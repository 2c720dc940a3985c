"""Checks of what a plug-in answers: shapes, finite numbers, unit lengths, conventions.

Every answer of a plug-in goes through here first: an answer that fails a check, and any
exception of the plug-in, becomes a `PluginError`.
"""

import reprlib
from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from simval.arrays import Array, finite_array
from simval.errors import CrashedPluginError, InputError, PluginError
from simval.plugins.protocol import Estimator
from simval.text import message_of

LISTED = 1 << 10
"""Entries up to which nested lists are searched for truth values: all that a
calibrator answers, and what an estimator is probed with."""

UNIT = 1e-6
"""How far from 1 the length of a quaternion may be."""


def quaternions_of(
    estimator: Estimator,
    b1: Float[Array, "n 3"],
    b2: Float[Array, "n 3"],
    r1: Float[Array, "n 3"],
    r2: Float[Array, "n 3"],
) -> Float[Array, "n 4"]:
    """Estimate attitudes and bring them to the package's convention."""
    found = raw_quaternions(estimator, b1, b2, r1, r2)
    bad = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if len(bad):
        msg = (
            f"{estimator.name} returned non-finite quaternions in {len(bad)} of "
            f"{len(b1)} rows ({len(bad) / len(b1):.3g} of them), the first is row "
            f"{bad[0]}; every row must be an estimate"
        )
        raise PluginError(msg)
    off = np.linalg.norm(found, axis=1) - 1.0
    worst = float(off[int(np.argmax(np.abs(off)))])
    if not abs(worst) <= UNIT:
        msg = (
            f"{estimator.name} returned a quaternion whose length is off by "
            f"{worst:.2g}; every one must have length 1 to {UNIT:g}, so normalise them"
        )
        raise PluginError(msg)
    return package_quaternion(found, estimator.components, estimator.matrix)


def raw_quaternions(
    estimator: Estimator,
    b1: Float[Array, "n 3"],
    b2: Float[Array, "n 3"],
    r1: Float[Array, "n 3"],
    r2: Float[Array, "n 3"],
) -> Float[Array, "n 4"]:
    """Answers in the estimator's own convention; rows need not be finite or unit."""
    answer = called(estimator.name, estimator.estimate, b1, b2, r1, r2)
    found = _plain(estimator.name, "quaternions", answer, (len(b1), 4))
    return found.astype(float)


def package_quaternion(
    q: Float[Array, "n 4"], components: str, matrix: str
) -> Float[Array, "n 4"]:
    """Bring quaternions of a declared convention to the package's."""
    last = np.roll(q, -1, axis=-1) if components == "sxyz" else np.array(q)
    if matrix == "active":
        last[..., :3] *= -1.0
    return last


def covariances_of(
    estimator: Estimator,
    b1: Float[Array, "n 3"],
    b2: Float[Array, "n 3"],
    r1: Float[Array, "n 3"],
    r2: Float[Array, "n 3"],
    noise_std: float,
) -> Float[Array, "n 3 3"]:
    """Ask an estimator for its covariances."""
    name = estimator.name
    assert estimator.covariance is not None
    answer = called(name, estimator.covariance, b1, b2, r1, r2, noise_std)
    shape = (len(b1), 3, 3)
    covariances = array_of(name, "covariance", answer, shape, (3, 3))
    check_covariance(name, covariances)
    return np.broadcast_to(covariances, shape)


def called(name: str, function: Any, *arguments: Any) -> Any:
    """Call a user's function.

    Raises
    ------
    PluginError
        If it raises anything.
    """
    try:
        return function(*arguments)
    except PluginError:
        raise
    except Exception as error:  # whatever a user's function may raise
        msg = f"{name} raised {message_of(error)}"
        raise CrashedPluginError(msg) from error


def array_of(name: str, what: str, value: Any, *shapes: tuple[int, ...]) -> Array:
    """Finite numbers of one of the shapes."""
    found = _plain(name, what, value, *shapes)
    try:
        return finite_array(what, found, found.shape)
    except InputError as error:
        msg = f"{name} returned a bad answer: {error}"
        raise PluginError(msg) from None


def _plain(
    name: str, what: str, value: Any, *shapes: tuple[int, ...]
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
        )
        raise PluginError(msg)
    fault = "masked entries" if np.ma.is_masked(value) else _fault(array)
    if isinstance(value, list | tuple) and array.size <= LISTED and not fault:
        # among numbers, NumPy takes a truth value for 0 or 1
        fault = _fault(np.asarray(value, dtype=object))
    if fault:
        msg = f"{name} returned {what} with {fault}; every entry must be a plain number"
        raise PluginError(msg)
    return array


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
