r"""Call an algorithm, and check its answers.

Vectors are a list b1, ..., bk, r1, ..., rk of batches, whatever the form. Arrays that
are one to the caller are one to the estimator, and it works on copies, which it must
leave as they were.

Every answer of a plug-in goes through here first: an answer that fails a check, and any
exception of the plug-in, becomes a `PluginError`.

The first answer sets the form of all: an attitude, a pair or a mapping, with the same
words and shapes. Each row is copied when it comes, since a filter may answer with the
same array again and again.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, Mask, finite_array, outer, shaped_array
from simval.errors import CrashedPluginError, InputError, PluginError, RefusedError
from simval.imu.sensor import forms
from simval.imu.sensor.models import FIXED, places_of
from simval.plugins.attitudes import (
    fault_of,
    finite_rows,
    package_quaternion,
    sound_rows,
    tail,
)
from simval.plugins.child import answered, where_it_lives
from simval.plugins.noise import VectorNoise, Vectors, vector_noise
from simval.plugins.protocol import (
    ANSWERS,
    BatchCalibrator,
    Calibrator,
    Estimator,
    Filter,
)
from simval.shapes import Bool, Float
from simval.text import raised, words_of

Shape = tuple[int, ...]


def called(name: str, function: Any, *arguments: Any, **words: Any) -> Any:
    """Call a user's function; exceptions become plug-in errors (`ended`)."""
    try:
        return function(*arguments, **words)
    except PluginError:
        raise
    except (Exception, SystemExit) as error:  # whatever a user's function may raise
        raise ended(name, error) from error


def ended(name: str, error: BaseException, where: str = "") -> PluginError:
    """Error for a plug-in that raised an exception.

    But for one of our refusals: a plug-in that says that its data has no answer. What
    was found of it already stays what it is.
    """
    if isinstance(error, PluginError):
        return type(error)(f"{error}{where}")
    if isinstance(error, RefusedError):
        return PluginError(f"{name} refuses what it is given: {words_of(error)}{where}")
    return CrashedPluginError(f"{name} raised {raised(error)}{where}")


def answers(
    estimator: Estimator,
    function: Callable[..., Any],
    vectors: Vectors,
    noise: VectorNoise | None,
    *more: Any,
) -> list[Any]:
    """Call a function on all rows at once, or on each row by itself."""
    given, words = stacked(estimator, vectors), handed(estimator, vectors, noise)
    kept = [a.copy() for a in (*given, *words.values())]
    n = len(vectors[0])
    each = (
        [(given, words)]
        if estimator.batch
        else (_row(i, given, words) for i in range(n))
    )
    found = []
    for one, own in each:
        found.append(called(estimator.name, function, *one, *more, **own))
        if function is estimator.estimate:
            answered(n if estimator.batch else 1)
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
    """Unchecked answer for one row of numbers of any type."""
    given, words = stacked(estimator, vectors), handed(estimator, truth, noise)
    if not estimator.batch:
        given, words = _row(0, given, words)
    return estimator.estimate(*given, **words)


def stacked(estimator: Estimator, vectors: list[Any]) -> list[Any]:
    """Copies of the vectors, in the arrangement that an estimator takes."""
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
    vectors: Vectors,
    noise: VectorNoise | None,
) -> dict[str, Array]:
    """Extra arguments that an estimator asked for, by name."""
    noise = vector_noise("body", len(vectors) // 2) if noise is None else noise
    words = noise.read(estimator.reads, vectors)
    if estimator.takes == "pairs":
        return words
    # a row of body and one of reference vectors, of what is of each vector
    return {
        word: a if word == "weights" else np.stack(np.split(a, 2, axis), axis)
        for word, a in words.items()
        for axis in [int(word == "covariances")]
    }


def _row(
    i: int, given: list[Any], words: dict[str, Array]
) -> tuple[list[Any], dict[str, Array]]:
    """One row of the arguments of a batch."""
    own = {word: a[i] if word == "covariances" else a for word, a in words.items()}
    return [a[i] for a in given], own


def quaternions_of(
    estimator: Estimator,
    vectors: Vectors,
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
    vectors: Vectors,
    noise: VectorNoise | None = None,
) -> Float[Array, "n ..."]:
    """Answers in the estimator's own convention, whether attitudes or not."""
    name, shape = estimator.name, tail(estimator.components)
    found = answers(estimator, estimator.estimate, vectors, noise)
    what = "matrices" if estimator.components == "matrix" else "quaternions"
    if estimator.batch:
        whole = (len(vectors[0]), *shape)
        return numbers(name, what, found[0], whole, hint=other_form).copy()
    return np.array([numbers(name, what, row, shape, hint=other_form) for row in found])


def other_form(found: Shape, required: Shape) -> str:
    """Advice if an answer has the shape of another form of attitude."""
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
    estimator: Estimator, vectors: Vectors, noise: VectorNoise
) -> Float[Array, "n 3 3"]:
    """Ask an estimator for its covariances."""
    name, one = estimator.name, (3, 3)
    assert estimator.covariance is not None
    shapes = [(len(vectors[0]), *one), one] if estimator.batch else [one]
    size = () if "noise_std" in estimator.reads else (noise.noise_std,)
    found = answers(estimator, estimator.covariance, vectors, noise, *size)
    each = np.array([finite(name, "covariance", row, *shapes) for row in found])
    covariances = each[0] if estimator.batch else each
    require_covariances(name, covariances.reshape(-1, *one))
    return np.broadcast_to(covariances, (len(vectors[0]), *one))


def numbers(
    name: str,
    what: str,
    value: Any,
    *shapes: Shape,
    hint: Callable[[Shape, Shape], str] = lambda *_: "",
) -> Array:
    """Check for real numbers of one of the shapes, without parsing or padding."""
    try:
        array = shaped_array(what, value, ())
    except InputError as error:
        msg = f"{name} returned a bad answer: {error}"
        raise PluginError(msg) from None
    if array.shape not in shapes:
        msg = (
            f"{name} returned {what} as {type(value).__name__} of shape {array.shape}; "
            f"it must be an array of shape {' or '.join(map(str, shapes))}"
            f"{hint(array.shape, shapes[0])}"
        )
        raise PluginError(msg)
    # rows first, as an answer that was sent is: products of the same numbers by columns
    # end in other bits on some processors
    return np.asarray(array, order="C")


def finite(name: str, what: str, value: Any, *shapes: Shape) -> Array:
    """Check for finite numbers of one of the shapes."""
    found = numbers(name, what, value, *shapes)
    try:
        return finite_array(what, found, found.shape)
    except InputError as error:
        msg = f"{name} returned a bad answer: {error}"
        raise PluginError(msg) from None


ASYMMETRY: Final = 1e-6
"""Of a covariance, relative to the standard deviations: that of single precision."""

NEGATIVE: Final = -1e-9
"""Least eigenvalue of a correlation matrix that rounding makes of 0."""

LEAST_SCALE: Final = 1e-3
"""Of the greatest standard deviation of three numbers, which have one unit: a variance
that is the difference of greater ones is rounded like them."""


def sound_covariances(each: Float[Array, "n p p"], definite: int) -> Bool[Mask, " n"]:
    """Mask of covariances that are finite, symmetric and positive (semi-)definite.

    What is known exactly has a row of zeros, as the bias of a gyroscope without one, or
    no variance in some other direction.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        variances = np.linalg.diagonal(each)
        std = np.sqrt(np.maximum(variances, 0.0))
        for k in range(definite, std.shape[1], 3):
            part = std[:, k : k + 3]
            part[:] = np.maximum(part, LEAST_SCALE * part.max(axis=1, keepdims=True))
        i, j = np.triu_indices(each.shape[-1], 1)
        skew = np.abs(each[:, i, j] - each[:, j, i])
        sound = np.all(skew <= ASYMMETRY * std[:, i] * std[:, j], axis=1)
        sound &= finite_rows(each)
        sound &= (variances >= NEGATIVE * std**2).all(1)
        sound &= (variances[:, :definite] > 0.0).all(1)
    if sound.all():
        with suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(each)
            return sound
    with np.errstate(invalid="ignore", over="ignore"):
        size = outer(std, std)
        safe = np.where(size > 0.0, size, 1.0)
        scaled = np.where(sound[:, None, None], each / safe, np.eye(each.shape[-1]))
    least = np.linalg.eigvalsh(scaled)[:, 0] >= NEGATIVE
    first = np.linalg.eigvalsh(scaled[:, :definite, :definite])[:, 0] > 0.0
    return sound & least & first


def require_covariances(name: str, each: Float[Array, "n p p"]) -> None:
    """Require symmetric and positive definite matrices."""
    sound = sound_covariances(each, each.shape[-1])
    if not sound.all():
        words = _covariance_fault("covariance", each[np.argmin(sound)])
        msg = f"{name} returned {words}"
        raise PluginError(msg)


def _covariance_fault(word: str, P: Float[Array, "p p"]) -> str:
    """Say what is wrong with a finite covariance."""
    apart = np.abs(P - P.T).max() / np.abs(P).max(initial=1e-300)
    if apart > ASYMMETRY:
        return (
            f"`{word}` that is not symmetric, by {apart:.2g} of its greatest entry; "
            "update it symmetrically, or return (P + P.T) / 2"
        )
    least = np.linalg.eigvalsh((P + P.T) / 2.0)[0]
    return (
        f"`{word}` that is not positive definite: its least eigenvalue is {least:.3g}; "
        "a variance is above zero in each direction (Joseph's form keeps it so)"
    )


MIN_FREEDOM = 5
"""Least degrees of freedom of a Type A covariance: with fewer the normalised square
has no variance."""

ROUNDING = 1e-12
"""Relative, by which an entry that is not estimated may differ from what it is."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A calibrator's answer, checked."""

    matrix: Float[Array, "3 3"]  # raw readings less bias to specific force
    bias: Float[Array, "3"]  # raw units
    # of the parameters that are estimated; of all nine in the declared form
    covariance: Float[Array, "p p"] | None = None
    # degrees of freedom of a covariance of type A; None where its size is known
    dof: int | None = None

    def parameters(self, form: str) -> Float[Array, "9"]:
        """Convert to one of the forms, as lengths determine no more than a form."""
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
    answered()
    return _checked(name, calibrator, answer)


@where_it_lives
def calibrations_of(
    calibrator: Calibrator,
    sets: Float[Array, "t n 3"],
    g: float,
    noise_std: float,
    seconds: float,
) -> list[Calibration]:
    """Calibrate many sets of poses; a batch has a time limit for all."""
    if not isinstance(calibrator, BatchCalibrator):
        return [calibration_of(calibrator, poses, g, noise_std) for poses in sets]
    name = calibrator.name
    every = called(name, calibrator.calibrate_all, sets.copy(), g, noise_std, seconds)
    return [
        _checked(f"{name}, trial {trial},", calibrator, answer)
        for trial, answer in enumerate(every)
    ]


def _checked(name: str, calibrator: Calibrator, answer: Any) -> Calibration:
    given, places = _words_of(name, answer), places_of(calibrator.estimates)
    matrix = finite(name, "matrix", given["matrix"], (3, 3))
    if 0 not in places:
        _require_class(name, calibrator.estimates, matrix)
    covariance = given.get("covariance")
    if covariance is not None:
        covariance = finite(name, "covariance", covariance, (len(places),) * 2).copy()
        require_covariances(name, covariance[None])
    dof = given.get("dof") if given.get("covariance_kind") == "type A" else MIN_FREEDOM
    if not (isinstance(dof, int) and dof >= MIN_FREEDOM):
        msg = (
            f"{name} gives a covariance of type A with `dof` {dof!r}; its degrees of "
            f"freedom must be a whole number, {MIN_FREEDOM} or more: use "
            f"{len(places) + MIN_FREEDOM} poses or more"
        )
        raise PluginError(msg)
    return Calibration(  # in copies: the next answer may be in the same arrays
        matrix=matrix.copy(),
        bias=finite(name, "B", given["B"], (3,)).copy(),
        covariance=covariance,
        dof=dof if given.get("covariance_kind") == "type A" else None,
    )


def _words_of(name: str, answer: Any) -> Mapping[str, Any]:
    """A calibrator's answer, in whatever form, as a mapping."""
    if isinstance(answer, (tuple, list)) and len(answer) in (2, 3):
        return dict(zip(("matrix", "B", "covariance"), answer, strict=False))
    if not isinstance(answer, Mapping):
        msg = (
            f"{name} answered with {type(answer).__name__}; it must be (matrix, bias), "
            "(matrix, bias, covariance) or a mapping with `matrix` and `B`"
        )
        raise PluginError(msg)
    given = {"B": answer.get("bias"), **answer}
    if "matrix" not in given and {"T", "K"} <= given.keys():
        T = finite(name, "T", given["T"], (3, 3))
        K = finite(name, "K", given["K"], (3,), (3, 3))
        given["matrix"] = T @ (np.diag(K) if K.ndim == 1 else K)
    if given.get("matrix") is None or given["B"] is None:
        keys = ", ".join(str(key) for key in answer) or "nothing"
        msg = (
            f"{name} answered with {keys}; it must hold `matrix` (or `T` and `K`) "
            "and `B`"
        )
        raise PluginError(msg)
    return given


def _require_class(
    name: str, estimates: tuple[str, ...], matrix: Float[Array, "3 3"]
) -> None:
    """Check that a matrix has only the parameters that the calibrator estimates."""
    scaled = "scale" in estimates
    fixed = np.diag(np.diagonal(matrix)) if scaled else np.diag(FIXED[3:6])
    off = np.abs(matrix - fixed)
    if not off.max() <= ROUNDING * np.abs(fixed).max():
        row, column = (int(k) for k in np.unravel_index(off.argmax(), off.shape))
        msg = (
            f"{name} estimates {' and '.join(estimates)}, so its matrix must be "
            f"{'diagonal' if scaled else 'the unit matrix'}, but it has "
            f"{matrix[row, column]:.6g} in row {row}, column {column}; declare in "
            "`estimates` what it estimates"
        )
        raise PluginError(msg)


KINDS: Final = MappingProxyType(
    {
        "attitude": "an attitude",
        "pair": "a pair of attitude and covariance",
        "mapping": "a mapping of ",
    }
)
"""Forms that an answer of a filter may have."""


@dataclass(frozen=True, slots=True)
class Form:
    """Form of a filter's answers, which the first answer sets."""

    filter: Filter
    lead: Shape  # () or, of a batch, the number of trials
    kind: str  # of `KINDS`
    shapes: Mapping[str, Shape]  # of each word, in the order of `ANSWERS`

    def values(self, answer: Any) -> tuple[Any, ...]:
        """Values of an answer, in the order of the form."""
        if self.kind == "attitude":
            return (answer,)
        if _kind(answer) != self.kind:
            raise PluginError(self._changed(answer))
        if self.kind == "pair":
            return tuple(answer)
        if len(answer) != len(self.shapes):
            raise PluginError(self._changed(answer))
        return tuple(answer.get(word) for word in self.shapes)

    def storing(self, rows: int) -> tuple[Callable[[int, Any], None], list[Array]]:
        """Make arrays for some rows, and a function that stores an answer in a row."""
        arrays: list[Array] = [np.empty((rows, *s)) for s in self.shapes.values()]
        ndarray, values, converted = np.ndarray, self.values, self._converted
        places = list(zip(self.shapes, self.shapes.values(), arrays, strict=True))

        def put(row: int, answer: Any) -> None:
            for (word, shape, array), value in zip(places, values(answer), strict=True):
                if (
                    type(value) is ndarray
                    and value.shape == shape
                    and value.dtype.kind == "f"
                ):
                    array[row] = value
                else:
                    array[row] = converted(word, value, shape)

        return put, arrays

    def fault(self, arrays: list[Array]) -> tuple[int, str] | None:
        """First row with an invalid answer, and what is wrong with it."""
        found = []
        for (word, shape), array in zip(self.shapes.items(), arrays, strict=True):
            # a row of a batch has a value of each trial
            each = array.reshape(-1, *shape[len(self.lead) :])
            if word == "attitude":
                sound = sound_rows(each, self.filter.components)
            elif word.endswith("covariance"):
                sound = sound_covariances(each, 3)
            else:
                sound = finite_rows(each)
            if not sound.all():
                bad = int(np.argmin(sound))
                words = f"{self.filter.name} returned {self._fault(word, each[bad])}"
                found.append((bad // (len(each) // len(array)), words))
        return min(found, default=None)

    def _fault(self, word: str, value: Float[Array, "..."]) -> str:
        if not np.isfinite(value).all():
            first = [int(i) for i in np.argwhere(~np.isfinite(value))[0]]
            number = value[tuple(first)]
            return f"`{word}` with {number} at {first}; every number must be finite"
        if word == "attitude":
            words = fault_of(value[None], self.filter.components)
            return words.replace(" in row 0", "").replace("; every one", "; each")
        return _covariance_fault(word, value)

    def _converted(self, word: str, value: Any, shape: Shape) -> Any:
        """Convert an answer to numbers; a plain list of floats goes the fast way."""
        if (
            type(value) in (list, tuple)
            and (len(value),) == shape
            and set(map(type, value)) == {float}
        ):
            return value
        if self.kind == "attitude" and (value is None or _kind(value) != self.kind):
            raise PluginError(self._changed(value))
        k = len(self.lead)

        def hint(found: Shape, required: Shape) -> str:
            own = word == "attitude" and found[:k] == self.lead
            return other_form(found[k:], required[k:]) if own else ""

        return numbers(self.filter.name, word, value, shape, hint=hint)

    def _changed(self, answer: Any) -> str:
        kind = _kind(answer)
        now = "a pair" if kind == "pair" else f"one {type(answer).__name__}"
        if answer is None:
            now = "nothing (None)"
        elif kind == "mapping":
            now = f"a mapping of {', '.join(map(repr, answer)) or 'nothing'}"
        words = ", ".join(map(repr, self.shapes)) if self.kind == "mapping" else ""
        return (
            f"{self.filter.name} returned {now}; it must answer each row, and as it "
            f"answered the first: {KINDS[self.kind]}{words}"
        )


def form_of(filter: Filter, answer: Any, lead: Shape) -> Form:
    """Form of a first answer; `lead` is () or the number of trials of a batch."""
    kind = _kind(answer)
    if kind == "mapping":
        _require_known(filter.name, answer)
        given = {word: answer[word] for word in ANSWERS if word in answer}
    else:
        values = answer if kind == "pair" else (answer,)
        given = dict(zip(ANSWERS, values, strict=False))
    shapes = {}
    for word in given:
        if word == "attitude":
            own = tail(filter.components)
        elif word in ("bias", "innovation"):
            own = (3 if word == "bias" else max(_size(filter.name, word, given), 1),)
        elif word == "covariance":  # of an attitude at the least
            own = (max(_size(filter.name, word, given), 3),) * 2
        else:
            own = (_size(filter.name, "innovation", given),) * 2
        shapes[word] = (*lead, *own)
    return Form(filter, lead, kind, shapes)


def _kind(answer: Any) -> str:
    if isinstance(answer, tuple):
        return "pair" if len(answer) == 2 else "attitude"
    mapping = type(answer) is dict or isinstance(answer, Mapping)
    return "mapping" if mapping else "attitude"


def _require_known(name: str, answer: Mapping[str, Any]) -> None:
    if "attitude" not in answer or not set(answer) <= set(ANSWERS):
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


def _size(name: str, word: str, given: Mapping[str, Any]) -> int:
    """Length of the last axis of an answer."""
    try:
        shape = np.shape(given[word])
    except Exception as error:  # ragged, or whatever a user's object may raise
        msg = f"{name} returned `{word}` that is not an array ({raised(error)})"
        raise PluginError(msg) from None
    return shape[-1] if shape else 0
