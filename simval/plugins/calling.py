"""How an estimator is called: in pairs or in stacks, in batches or one by one.

Vectors are a list b1, ..., bk, r1, ..., rk of batches, whatever the form. Arrays that
are one to the caller are one to the estimator, and it works on copies, which it must
leave as they were.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.protocol import Estimator
from simval.text import message_of


def called(name: str, function: Any, *arguments: Any, **words: Any) -> Any:
    """What a user's function answers; whatever it raises crashes the plug-in."""
    try:
        return function(*arguments, **words)
    except PluginError:
        raise
    except Exception as error:  # whatever a user's function may raise
        msg = f"{name} raised {message_of(error)}"
        raise CrashedPluginError(msg) from error


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
    given, words = arranged(estimator, vectors, noise)
    kept = [a.copy() for a in (*given, *words.values())]
    if estimator.batch:
        found = [called(estimator.name, function, *given, *more, **words)]
    else:
        rowwise = {word for word in words if word == "covariances"}
        found = [
            called(
                estimator.name,
                function,
                *(a[i] for a in given),
                *more,
                **{word: a[i] if word in rowwise else a for word, a in words.items()},
            )
            for i in range(len(vectors[0]))
        ]
    now = (*given, *words.values())
    if not all(np.array_equal(a, b) for a, b in zip(now, kept, strict=True)):
        msg = f"{estimator.name} changes its input; work on a copy"
        raise PluginError(msg)
    return found


def arranged(
    estimator: Estimator,
    vectors: list[Float[Array, "n 3"]],
    noise: VectorNoise | None,
) -> tuple[list[Array], Mapping[str, Array]]:
    """Arguments of an estimator: its vectors, and what it asked to be handed."""
    k = len(vectors) // 2
    noise = vector_noise("body", k) if noise is None else noise
    words = noise.told(estimator.reads, vectors)
    own = {id(v): np.array(v) for v in vectors}
    each = [own[id(v)] for v in vectors]
    if estimator.takes == "pairs":
        return each, words
    body = np.stack(each[:k], axis=1)
    same = all(b is r for b, r in zip(each[:k], each[k:], strict=True))
    reference = body if same else np.stack(each[k:], axis=1)
    return [body, reference], {word: _in_rows(word, a) for word, a in words.items()}


def _in_rows(word: str, values: Array) -> Array:
    """One row of body and one of reference vectors, where there are both."""
    if word == "weights":
        return values
    axis = 1 if word == "covariances" else 0
    shape = (*values.shape[:axis], 2, -1, *values.shape[axis + 1 :])
    return values.reshape(shape)
