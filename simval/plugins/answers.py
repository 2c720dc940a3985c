r"""Asking an algorithm, and the checks of what it answers.

Vectors are a list b1, ..., bk, r1, ..., rk of batches, whatever the form. Arrays that
are one to the caller are one to the estimator, and it works on copies, which it must
leave as they were.

Every answer of a plug-in goes through here first: an answer that fails a check, and any
exception of the plug-in, becomes a `PluginError`.

The first answer sets the form of all: an attitude, a pair or a mapping, with the same
words and shapes. Each row is copied when it comes, since a filter may answer with the
same array again and again.
"""

import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, finite_array
from simval.errors import CrashedPluginError, InputError, PluginError, RefusedError
from simval.plugins.attitudes import (
    fault_of,
    finite_rows,
    package_quaternion,
    sound_rows,
    tail,
)
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.protocol import (
    ANSWERS,
    BatchCalibrator,
    Calibrator,
    Estimator,
    Filter,
)
from simval.sensor import forms
from simval.sensor.models import FIXED, places_of
from simval.shapes import Bool, Float
from simval.text import message_of, words_of


def called(name: str, function: Any, *arguments: Any, **words: Any) -> Any:
    """What a user's function answers; what it raises is told by `ended`."""
    try:
        return function(*arguments, **words)
    except PluginError:
        raise
    except Exception as error:  # whatever a user's function may raise
        raise ended(name, error) from error


def ended(name: str, error: BaseException, where: str = "") -> PluginError:
    """What is said of a plug-in that has raised: it has crashed.

    But for one of our refusals: a plug-in that says that its data has no answer. What
    was found of it already stays what it is.
    """
    if isinstance(error, PluginError):
        return type(error)(f"{error}{where}")
    if isinstance(error, RefusedError):
        return PluginError(f"{name} refuses what it is given: {words_of(error)}{where}")
    return CrashedPluginError(f"{name} raised {message_of(error)}{where}")


def answers(
    estimator: Estimator,
    function: Callable[..., Any],
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None,
    *more: Any,
) -> list[Any]:
    """Answers of a function: one for a batch, else one for each row."""
    given, words = stacked(estimator, vectors), handed(estimator, vectors, noise)
    kept = [a.copy() for a in (*given, *words.values())]
    if estimator.batch:
        found = [called(estimator.name, function, *given, *more, **words)]
    else:
        rows = range(len(vectors[0]))
        found = [
            called(estimator.name, function, *one, *more, **own)
            for one, own in (_row(i, given, words) for i in rows)
        ]
    now = (*given, *words.values())
    if not all(np.array_equal(a, b) for a, b in zip(now, kept, strict=True)):
        msg = f"{estimator.name} changes its input; work on a copy"
        raise PluginError(msg)
    return found


def one_answer(
    estimator: Estimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Float[Array, "1 3"]],
    noise: VectorNoise,
) -> Any:
    """Answer of one row of numbers of any kind, unchecked; `truth` is their values."""
    given, words = stacked(estimator, vectors), handed(estimator, truth, noise)
    if not estimator.batch:
        given, words = _row(0, given, words)
    return estimator.estimate(*given, **words)


def stacked(estimator: Estimator, vectors: list[Any]) -> list[Any]:
    """Vectors as an estimator takes them, in copies."""
    k = len(vectors) // 2
    own = {id(v): np.array(v) for v in vectors}
    each = [own[id(v)] for v in vectors]
    if estimator.takes == "pairs":
        return each
    body = np.stack(each[:k], axis=1)
    same = all(b is r for b, r in zip(each[:k], each[k:], strict=True))
    return [body, body if same else np.stack(each[k:], axis=1)]


def handed(
    estimator: Estimator,
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None,
) -> dict[str, Array]:
    """What an estimator asked to be handed, by name."""
    noise = vector_noise("body", len(vectors) // 2) if noise is None else noise
    words = noise.told(estimator.reads, vectors)
    if estimator.takes == "pairs":
        return words
    return {word: _in_rows(word, values) for word, values in words.items()}


def _row(
    i: int, given: list[Any], words: dict[str, Array]
) -> tuple[list[Any], dict[str, Array]]:
    """One row of what a batch is given; only covariances are of each row."""
    own = {word: a[i] if word == "covariances" else a for word, a in words.items()}
    return [a[i] for a in given], own


def _in_rows(word: str, values: Array) -> Array:
    """One row of body and one of reference vectors, where there are both."""
    if word == "weights":
        return values
    axis = 1 if word == "covariances" else 0
    shape = (*values.shape[:axis], 2, -1, *values.shape[axis + 1 :])
    return values.reshape(shape)


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
    """Require symmetric and positive definite matrices."""
    scale = np.abs(matrices).max(axis=(-2, -1), keepdims=True)
    skew = np.abs(matrices - np.swapaxes(matrices, -1, -2)) / np.maximum(scale, 1e-300)
    if not float(skew.max()) <= 1e-9:
        msg = f"the covariance of {name} is not symmetric"
        raise PluginError(msg)
    if not float(np.linalg.eigvalsh(matrices / np.maximum(scale, 1e-300)).min()) > 0.0:
        msg = f"the covariance of {name} is not positive definite"
        raise PluginError(msg)


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


ASYMMETRY: Final = 1e-6
"""Of a covariance, relative to the standard deviations: that of single precision."""

NEGATIVE: Final = -1e-9
"""Least eigenvalue of a correlation matrix that rounding makes of 0."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Form:
    """What each answer of a filter is."""

    name: str  # of the filter
    kind: str  # "attitude", "pair" or "mapping"
    words: tuple[str, ...]  # in the order of `ANSWERS`
    shapes: tuple[tuple[int, ...], ...]  # of each word


def form_of(filter: Filter, answer: Any, lead: tuple[int, ...]) -> Form:
    """Form of a first answer; `lead` is () or, of a batch, the number of trials."""
    kind = _kind(answer)
    words = _words(filter.name, kind, answer)
    given = dict(zip(words, _values(kind, words, answer), strict=True))
    shapes = [_shape(filter, word, given, lead) for word in words]
    return Form(filter.name, kind, words, tuple(shapes))


def storing(form: Form, arrays: list[Array]) -> Callable[[int, Any], None]:
    """Build the function that copies the answer of a row into arrays of all rows."""
    ndarray, shapes = np.ndarray, form.shapes
    if form.kind == "attitude":
        (array,), (shape,) = arrays, shapes

        def put_attitude(row: int, answer: Any) -> None:
            if (
                type(answer) is ndarray
                and answer.shape == shape
                and answer.dtype.kind == "f"
            ):
                array[row] = answer
            else:
                array[row] = _converted(form, "attitude", answer, shape)

        return put_attitude
    kind, words = form.kind, form.words
    places = list(zip(words, arrays, shapes, strict=True))

    def put(row: int, answer: Any) -> None:
        if _kind(answer) != kind or (kind == "mapping" and len(answer) != len(words)):
            raise PluginError(_changed(form, answer))
        for (word, array, shape), value in zip(
            places, _values(kind, words, answer), strict=True
        ):
            if (
                type(value) is ndarray
                and value.shape == shape
                and value.dtype.kind == "f"
            ):
                array[row] = value
            else:
                array[row] = _converted(form, word, value, shape)

    return put


def faults(form: Form, filter: Filter, arrays: list[Array]) -> tuple[int, str] | None:
    """First row at which answers break a rule, and what is wrong there, in words."""
    found = [
        each
        for word, array, shape in zip(form.words, arrays, form.shapes, strict=True)
        if (each := _first_fault(filter, word, array, shape)) is not None
    ]
    return min(found, default=None)


def _first_fault(
    filter: Filter, word: str, array: Float[Array, "..."], shape: tuple[int, ...]
) -> tuple[int, str] | None:
    """First bad row of one word, whose rows may hold a batch of trials each."""
    own = _own(filter, word)
    each = array.reshape(-1, *shape[len(shape) - own :])
    sound = _sound(filter, word, each)
    if sound.all():
        return None
    bad = int(np.argmin(sound))
    words = _words_of_fault(filter, word, each[bad])
    return bad // (len(each) // len(array)), f"{filter.name} returned {words}"


def _own(filter: Filter, word: str) -> int:
    """Axes of one word of one trial."""
    if word == "attitude":
        return len(tail(filter.components))
    return 2 if word.endswith("covariance") else 1


def _sound(filter: Filter, word: str, each: Float[Array, "n ..."]) -> Bool[Mask, " n"]:
    if word == "attitude":
        return sound_rows(each, filter.components)
    if word.endswith("covariance"):
        return sound_covariances(each)
    return finite_rows(each)


def sound_covariances(each: Float[Array, "n p p"]) -> Bool[Mask, " n"]:
    """Which are finite, symmetric and positive, the first three definitely so.

    What is known exactly has a row of zeros, as the bias of a gyroscope without one.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        variances = np.diagonal(each, axis1=1, axis2=2)
        std = np.sqrt(np.maximum(variances, 0.0))
        size = std[:, :, None] * std[:, None, :]
        skew = np.abs(each - each.swapaxes(1, 2)) <= ASYMMETRY * size
        sound: Mask = np.logical_and(skew.all((1, 2)), finite_rows(each))
        sound &= (variances >= 0.0).all(axis=1) & (variances[:, :3] > 0.0).all(axis=1)
    if sound.all():
        try:
            np.linalg.cholesky(each)
        except np.linalg.LinAlgError:
            pass
        else:
            return sound
    safe = np.where(size > 0.0, size, 1.0)
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.where(sound[:, None, None], each / safe, np.eye(each.shape[-1]))
    least: Mask = np.linalg.eigvalsh(scaled)[:, 0] >= NEGATIVE
    definite: Mask = np.linalg.eigvalsh(scaled[:, :3, :3])[:, 0] > 0.0
    return sound & least & definite


def _words_of_fault(filter: Filter, word: str, value: Float[Array, "..."]) -> str:
    what = f"`{word}`"
    if not np.isfinite(value).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(value))[0])
        number = value[first]
        return f"{what} with {number} at {list(first)}; every number must be finite"
    if word == "attitude":
        words = fault_of(value[None], filter.components)
        return words.replace(" in row 0", "").replace("; every one", "; each")
    apart = float(np.abs(value - value.T).max() / np.abs(value).max(initial=1e-300))
    if apart > ASYMMETRY:
        return (
            f"{what} that is not symmetric, by {apart:.2g} of its greatest entry; "
            "update it symmetrically, or return (P + P.T) / 2"
        )
    least = float(np.linalg.eigvalsh((value + value.T) / 2.0)[0])
    return (
        f"{what} that is not positive definite: its least eigenvalue is {least:.3g}; "
        "a variance is above zero in each direction (Joseph's form keeps it so)"
    )


def _kind(answer: Any) -> str:
    if isinstance(answer, tuple):
        return "pair" if len(answer) == 2 else "attitude"
    mapping = type(answer) is dict or isinstance(answer, Mapping)
    return "mapping" if mapping else "attitude"


def _words(name: str, kind: str, answer: Any) -> tuple[str, ...]:
    if kind != "mapping":
        return ANSWERS[:1] if kind == "attitude" else ANSWERS[:2]
    unknown = [word for word in answer if word not in ANSWERS]
    if unknown or "attitude" not in answer:
        given, known = ", ".join(map(repr, answer)), ", ".join(map(repr, ANSWERS))
        msg = (
            f"{name} returned a mapping of {given or 'nothing'}; it must have "
            f"'attitude', and may have others of {known}"
        )
        raise PluginError(msg)
    if "innovation_covariance" in answer and "innovation" not in answer:
        msg = (
            f"{name} returned an `innovation_covariance` without the `innovation`; "
            "return both, or neither"
        )
        raise PluginError(msg)
    return tuple(word for word in ANSWERS if word in answer)


def _values(kind: str, words: tuple[str, ...], answer: Any) -> tuple[Any, ...]:
    if kind == "attitude":
        return (answer,)
    return answer if kind == "pair" else tuple(answer.get(word) for word in words)


def _shape(
    filter: Filter, word: str, given: Mapping[str, Any], lead: tuple[int, ...]
) -> tuple[int, ...]:
    """Shape that a word has in each answer, after the first."""
    if word == "attitude":
        return (*lead, *tail(filter.components))
    if word == "bias":
        return (*lead, 3)
    last = _last_axis(filter.name, word, given[word])
    if word == "innovation":
        return (*lead, max(last, 1))
    if word == "innovation_covariance":
        last = _last_axis(filter.name, "innovation", given["innovation"])
    else:
        last = max(last, 3)  # of an attitude at the least
    return (*lead, last, last)


def _last_axis(name: str, word: str, value: Any) -> int:
    try:
        shape = np.shape(value)
    except Exception as error:  # ragged, or whatever a user's object may raise
        msg = f"{name} returned `{word}` that is not an array ({message_of(error)})"
        raise PluginError(msg) from None
    return shape[-1] if shape else 0


def _converted(form: Form, word: str, value: Any, shape: tuple[int, ...]) -> Any:
    """Numbers that are no array of doubles; a plain list of floats is quick."""
    if (
        type(value) in (list, tuple)
        and (len(value),) == shape
        and set(map(type, value)) == {float}
    ):
        return value
    if form.kind == "attitude" and (value is None or _kind(value) != form.kind):
        raise PluginError(_changed(form, value))
    try:
        return array_of(form.name, word, value, shape)
    except PluginError as error:
        msg = f"{error}{_other_attitude(value, shape)}"
        raise PluginError(msg) from None


def _other_attitude(value: Any, shape: tuple[int, ...]) -> str:
    """What to declare where the shape is that of another form of attitude."""
    found = getattr(value, "shape", ())
    if shape[-1:] == (4,) and found[-2:] == (3, 3):
        return ', or declare components="matrix"'
    if shape[-2:] == (3, 3) and found[-1:] == (4,):
        return ", or declare the order of the `components`"
    return ""


def _changed(form: Form, answer: Any) -> str:
    kind = _kind(answer)
    if answer is None:
        now = "nothing (None)"
    elif kind == "mapping":
        now = f"a mapping of {', '.join(map(repr, answer)) or 'nothing'}"
    else:
        now = "a pair" if kind == "pair" else f"one {type(answer).__name__}"
    article = {"attitude": "an attitude", "pair": "a pair of attitude and covariance"}
    first = article.get(form.kind, f"a mapping of {', '.join(map(repr, form.words))}")
    return (
        f"{form.name} returned {now}; it must answer each row, and as it answered the "
        f"first: {first}"
    )
