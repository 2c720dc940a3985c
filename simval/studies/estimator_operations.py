"""Operations for one attitude, counted by special numbers, and its rounding.

What an estimator gives as `arithmetic` is its method on numbers of any class. Here they
are numbers that count additions, products, divisions and roots, of unit vectors and of
weights whose sum is 1; comparisons and signs are free. The problems are the exact
generic cases, drawn once for all, so a count is a fact about the code and its branches,
without chance and the same on every machine. Its answers must be those of `estimate`.

Rounding of two vectors turns their attitude by its size over the sine between them. A
method that squares the sine, as Davenport's matrix does, loses as many digits again.
The greatest error of exact cases at each of `SINES` shows it. Down to the least sine of
the class "nearly parallel" it is held to what an estimator may err by there
(`simval.plugins.probe`); beyond it an estimator may refuse, and it is recorded.
"""

import operator
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar, Final

import numpy as np

from simval import statistics as stat
from simval.arrays import Array, Places
from simval.errors import PluginError
from simval.geometry import attitude_error, normalize
from simval.plugins import Estimator
from simval.plugins.answers import handed, quaternions_of, stacked
from simval.plugins.attitudes import (
    GENERIC,
    PARALLEL,
    package_quaternion,
    random_case,
    seen,
    sound_rows,
    tail,
)
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise, Vectors
from simval.plugins.probe import TOLERANCE, Exact, allowed
from simval.results import Rows, limit, unjudged
from simval.shapes import Float, Int
from simval.text import raised

COUNT: Final = 200
"""Problems."""

KINDS: Final = ("sums", "products", "divisions", "roots")


class Counted:
    """A real number that counts the operations made with it."""

    __slots__ = ("value",)
    value: float
    done: ClassVar[Counter[str]] = Counter()

    def __init__(self, value: Any) -> None:
        self.value = value.value if isinstance(value, Counted) else float(value)

    def sqrt(self) -> "Counted":
        """Square root; `numpy.sqrt` calls this for arrays of such numbers."""
        Counted.done["roots"] += 1
        return Counted(self.value**0.5)

    def __pow__(self, power: float) -> "Counted":
        if power == 0.5:
            return self.sqrt()
        if power not in (2, 3, 4):
            msg = (
                f"power {power} is not counted; write a root as ** 0.5, and "
                "products as products"
            )
            raise TypeError(msg)
        Counted.done["products"] += int(power) - 1
        return Counted(self.value**power)

    def __neg__(self) -> "Counted":
        return Counted(-self.value)

    def __abs__(self) -> "Counted":
        return Counted(abs(self.value))


def _compared(work: Callable[[Any, Any], Any]) -> Any:
    return lambda self, other: work(self.value, Counted(other).value)


def _operation(kind: str, swapped: bool, work: Callable[[Any, Any], Any]) -> Any:
    def counted(self: Counted, other: Any) -> Counted:
        x, y = self.value, Counted(other).value
        if not (kind == "sums" and type(other) is not Counted and y == 0.0):
            Counted.done[kind] += 1  # the 0 that a sum begins with is none
        return Counted(work(y, x) if swapped else work(x, y))

    return counted


for work in (operator.lt, operator.le, operator.gt, operator.ge):
    setattr(Counted, f"__{work.__name__}__", _compared(work))
for work, kind in (
    (operator.add, "sums"), (operator.sub, "sums"),
    (operator.mul, "products"), (operator.truediv, "divisions"),
):  # fmt: skip
    setattr(Counted, f"__{work.__name__}__", _operation(kind, False, work))
    setattr(Counted, f"__r{work.__name__}__", _operation(kind, True, work))


def operation_rows(plugin: Estimator, vectors: int) -> Rows:
    """Number of operations; none if the plug-in gives no `arithmetic`.

    The fewest, median and most of all problems, and the kinds of the median one.
    """
    if plugin.arithmetic is None:
        return ()
    _, given = plugin.observed(vectors).cases(GENERIC, COUNT)
    answers, counts = _counted(plugin, given)
    sound = sound_rows(answers, plugin.components)
    found = package_quaternion(answers[sound], plugin.components, plugin.matrix)
    apart = attitude_error(found, quaternions_of(plugin, given)[sound])
    wrong = COUNT - int(np.sum(apart <= allowed(given)[sound]))
    if wrong:
        msg = (
            f"`arithmetic` of {plugin.name} does not answer the attitude of `estimate` "
            f"in {wrong} of {COUNT} exact cases; it must be the same method, of unit "
            "vectors, in the same convention"
        )
        raise PluginError(msg)
    total = counts.sum(axis=1)
    order = np.argsort(total, kind="stable")
    return unjudged(
        stat.OPERATIONS.each(("fewest", "median", "most", *KINDS)),
        [*total[order[[0, COUNT // 2, -1]]], *counts[order[COUNT // 2]]],
        n=COUNT,
    )


SINES: Final = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Of the angle between the references."""

PROMISED: Final = 1e-3
"""Least sine of the class "nearly parallel"."""


def rounding_rows(plugin: Estimator, vectors: int, noise: VectorNoise) -> Rows:
    """Largest error without noise, for each angle between two vectors.

    It is pi where an answer is no attitude.
    """
    if vectors != 2 or plugin.fixed is not None:
        return ()
    rows: Rows = ()
    for sine in SINES:
        q, r1, other = random_case(COUNT, np.random.default_rng(COUNT))
        r2 = np.sqrt(1.0 - sine**2) * r1 + sine * normalize(np.cross(r1, other))
        worst = min(float(Exact(q, seen(q, r1, r2), noise).errors(plugin).max()), np.pi)
        given = stat.ROUNDING_AT(f"{sine:g}"), worst
        if sine < PROMISED or PARALLEL in plugin.fails_at or noise.extreme:
            rows += unjudged(*given, n=COUNT)
        else:
            rows += limit(*given, TOLERANCE / sine, stat.TRUTH, n=COUNT)
    return rows


@where_it_lives
def _counted(
    plugin: Estimator, vectors: Vectors
) -> tuple[Float[Array, "n ..."], Int[Places, "n 4"]]:
    """Answers of `arithmetic` row by row, with the operations of each."""
    assert plugin.arithmetic is not None
    number = np.frompyfunc(Counted, 1, 1)
    answers, counts = [], []
    for i in range(len(vectors[0])):
        row = [v[i : i + 1] for v in vectors]
        given, words = stacked(plugin, [*map(number, row)]), handed(plugin, row, None)
        if "weights" in words:
            words["weights"] = number(words["weights"] / words["weights"].sum())
        Counted.done = Counter()
        try:
            found = plugin.arithmetic(*(v[0] for v in given), **words)
            answer = np.array([Counted(x).value for x in np.ravel(found)])
            answers.append(answer.reshape(tail(plugin.components)))
        except Exception as fault:  # whatever a user's function may raise
            msg = (
                f"`arithmetic` of {plugin.name} cannot work with numbers that count: "
                f"{raised(fault)}; use + - * /, ** 0.5, abs, comparisons and "
                "numpy.sqrt, or leave it out"
            )
            raise PluginError(msg) from None
        counts.append([Counted.done[kind] for kind in KINDS])
    return np.array(answers), np.array(counts)
