"""How an estimator is called: in pairs or in stacks, in batches or one by one.

Vectors are a list b1, ..., bk, r1, ..., rk of batches, whatever the form. Arrays that
are one to the caller are one to the estimator, and it works on copies, which it must
leave as they were.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError, RefusedError
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.protocol import Estimator
from simval.shapes import Float
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
    """Answers of a function of the estimator: one for a batch, else one for each row.

    Raises
    ------
    PluginError
        If it raises, or changes what it is given.
    """
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
