"""Answers of a filter, row by row: copied at once, and checked some rows at a time.

The first answer sets the form of all: an attitude, a pair or a mapping, with the same
words and shapes. Each row is copied when it comes, since a filter may answer with the
same array again and again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.plugins.answers import array_of
from simval.plugins.filter_protocol import ANSWERS, Filter
from simval.plugins.rotations import fault_of, finite_rows, sound_rows, tail
from simval.shapes import Bool, Float
from simval.text import message_of

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
    """Form of a first answer; `lead` is () or, of a batch, the number of trials.

    Raises
    ------
    PluginError
        If it is no answer.
    """
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
        if (each := _fault(filter, word, array, shape)) is not None
    ]
    return min(found, default=None)


def _fault(
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
        msg = f"{error}{_other_form(value, shape)}"
        raise PluginError(msg) from None


def _other_form(value: Any, shape: tuple[int, ...]) -> str:
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
