r"""Truncated power series in Gaussian noise: theory for any arithmetic estimator.

An estimator written with + - * / and sqrt is evaluated on numbers that carry all
their derivatives up to a total degree: polynomials in independent standard normal
variables :math:`\xi`, cut off beyond the degree. The moments of the result follow
from :math:`E[\xi^{2k}] = (2k-1)!!`. There is no formula of the estimator's own in
here, so this is both a service (second- and fourth-order theory of a user's
estimator) and an independent route to the closed forms.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from math import prod
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, function
from simval.arrays import Array, physical_array
from simval.errors import InputError, RefusedError
from simval.moments import Moments
from simval.shapes import Float
from simval.theory.cubature import covariance_roots
from simval.theory.two_vector import checked_covariances

Scalar = Union["Series", float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Algebra:
    """Monomials of a number of variables up to a total degree, and their products.

    Attributes
    ----------
    dimension : int
        Number of variables.
    degree : int
        Highest total degree kept.
    degrees : NDArray
        Total degree of each monomial, (m,).
    means : Array
        Expectation of each monomial of standard normals.
    left, right, target : NDArray
        Monomial left[i] times right[i] is target[i], (t,).
    """

    dimension: int
    degree: int
    degrees: NDArray[np.intp]
    means: Float[Array, " m"]
    left: NDArray[np.intp]
    right: NDArray[np.intp]
    target: NDArray[np.intp]

    def variable(self, index: int) -> "Series":
        """One of the variables as a series."""
        coefficients = np.zeros(self.means.size)
        coefficients[1 + index] = 1.0
        return Series(coefficients, self)


@lru_cache(maxsize=16)
def algebra(dimension: int, degree: int) -> Algebra:
    """Tables of the truncated polynomials; the constant comes first."""
    # a monomial is the sorted tuple of its variables, repeated by exponent
    monomials = [
        combination
        for total in range(degree + 1)
        for combination in combinations_with_replacement(range(dimension), total)
    ]
    index = {monomial: i for i, monomial in enumerate(monomials)}
    degrees = np.array([len(monomial) for monomial in monomials])
    up_to = np.searchsorted(degrees, range(degree + 1), side="right")
    triples = [
        (i, j, index[tuple(sorted(first + second))])
        for i, first in enumerate(monomials)
        for j, second in enumerate(monomials[: up_to[degree - len(first)]])
    ]
    left, right, target = np.array(triples).T
    means = np.array([_normal_moment(monomial) for monomial in monomials])
    return Algebra(
        dimension=dimension,
        degree=degree,
        degrees=degrees,
        means=means,
        left=left,
        right=right,
        target=target,
    )


def _normal_moment(monomial: tuple[int, ...]) -> float:
    powers = [monomial.count(variable) for variable in set(monomial)]
    if any(power % 2 for power in powers):
        return 0.0
    return float(prod(prod(range(1, power, 2)) for power in powers))


class Series:
    """A number with its derivatives: a truncated polynomial in the noise."""

    __slots__ = ("algebra", "coefficients")

    def __init__(self, coefficients: Float[Array, " m"], tables: Algebra) -> None:
        self.coefficients = coefficients
        self.algebra = tables

    def _lift(self, other: Scalar) -> Float[Array, " m"]:
        if isinstance(other, Series):
            return other.coefficients
        constant = np.zeros_like(self.coefficients)
        constant[0] = other
        return constant

    def _new(self, coefficients: Float[Array, " m"]) -> "Series":
        return Series(coefficients, self.algebra)

    def __add__(self, other: Scalar) -> "Series":
        return self._new(self.coefficients + self._lift(other))

    __radd__ = __add__

    def __sub__(self, other: Scalar) -> "Series":
        return self._new(self.coefficients - self._lift(other))

    def __rsub__(self, other: Scalar) -> "Series":
        return self._new(self._lift(other) - self.coefficients)

    def __neg__(self) -> "Series":
        return self._new(-self.coefficients)

    def __mul__(self, other: Scalar) -> "Series":
        if not isinstance(other, Series):
            return self._new(self.coefficients * float(other))
        tables, size = self.algebra, self.coefficients.size
        terms = self.coefficients[tables.left] * other.coefficients[tables.right]
        total = np.bincount(tables.target, weights=terms, minlength=size)
        return self._new(np.asarray(total, dtype=np.float64))

    __rmul__ = __mul__

    def __truediv__(self, other: Scalar) -> "Series":
        if not isinstance(other, Series):
            return self._new(self.coefficients / float(other))
        return self * other._power(-1.0)

    def __rtruediv__(self, other: float) -> "Series":
        return self._power(-1.0) * other

    def __pow__(self, exponent: float) -> "Series":
        if isinstance(exponent, int) and exponent >= 0:
            return prod([self] * exponent, start=self * 0.0 + 1.0)
        return self._power(float(exponent))

    def __pos__(self) -> "Series":
        return self

    def __abs__(self) -> "Series":
        return self * self._sign()

    # a branch is the one that is taken without noise
    def __lt__(self, other: Scalar) -> bool:
        return (self - other)._sign() < 0.0

    def __gt__(self, other: Scalar) -> bool:
        return (self - other)._sign() > 0.0

    __le__, __ge__ = __lt__, __gt__

    def __bool__(self) -> bool:
        return self._sign() != 0.0

    def _sign(self) -> float:
        if self.coefficients[0] == 0.0:
            msg = (
                "the estimator branches at a quantity that is 0 without noise, so it "
                "has no power series there; use a regular frame"
            )
            raise RefusedError(msg)
        return float(np.sign(self.coefficients[0]))

    def sqrt(self) -> "Series":
        """Square root; also what `numpy.sqrt` of an array of series calls."""
        return self._power(0.5)

    def _power(self, exponent: float) -> "Series":
        # binomial series about the constant term c: c^p (1 + y)^p by Horner's rule
        constant = float(self.coefficients[0])
        if not (constant > 0.0 or (constant != 0.0 and exponent == -1.0)):
            msg = (
                f"power {exponent:g} of a quantity that is {constant:g} without noise: "
                "the estimator has no power series there; use a regular frame"
            )
            raise RefusedError(msg)
        rest = self * (1.0 / constant) - 1.0
        total = self * 0.0 + 1.0
        for k in range(self.algebra.degree, 0, -1):
            total = 1.0 + rest * total * ((exponent - k + 1) / k)
        return total * constant**exponent

    def mean(self) -> float:
        """Expectation over independent standard normal variables."""
        return float(self.coefficients @ self.algebra.means)


def series_moments(
    estimator: Callable[..., Any], inputs: Any, covariances: Any, order: int = 4
) -> Moments:
    """Bias and covariance of an arithmetic estimator, truth minus estimate.

    Parameters
    ----------
    estimator : callable
        Takes k object arrays (3,) of numbers and returns p numbers, using
        + - * / ** and `numpy.sqrt` only; `numpy.cross`, `dot` and `sum` are these.
        `abs` and comparisons follow the branch that is taken without noise.
    inputs : array_like
        True values of the k vectors, (k, 3).
    covariances : array_like
        Covariance of the Gaussian noise on each, independent from vector to vector,
        (k, 3, 3).
    order : int, default 4
        Highest power of the noise kept, even, 2 to 6.

    Returns
    -------
    Moments
        Prediction; the truth is the estimate without noise.

    Raises
    ------
    InputError
        If a shape or the order is wrong.
    RefusedError
        If the estimator has no power series at the truth.
    """
    function("estimator", estimator)
    order = choice("order", order, (2, 4, 6))
    centre = physical_array("inputs", inputs, (None, 3))
    roots = covariance_roots(checked_covariances("covariances", covariances))
    if roots.shape != (*centre.shape, 3):
        msg = (
            f"`inputs` has shape {centre.shape} and `covariances` {roots.shape}; give "
            "(k, 3) and (k, 3, 3)"
        )
        raise InputError(msg)
    estimate = _estimated(estimator, _noisy(centre, roots, order))
    errors = [_without_constant(-1.0 * number) for number in estimate]
    bias = np.array([error.mean() for error in errors])
    second = np.array([[(a * b).mean() for b in errors] for a in errors])
    # bias bias' only through the order kept
    lowest = [np.array([_mean_of_degree(e, d) for e in errors]) for d in (2, 4)]
    square = np.outer(lowest[0], lowest[0]) if order >= 4 else 0.0
    if order == 6:
        mixed = np.outer(lowest[0], lowest[1])
        square = square + mixed + mixed.T
    return Moments(bias=bias, covariance=second - square)


def _estimated(
    estimator: Callable[..., Any], vectors: list[NDArray[np.object_]]
) -> list[Series]:
    # what the estimator returns, a number without noise as a series, too
    try:
        found = list(estimator(*vectors))
        one = vectors[0][0] * 0.0
        series = [one + (np.nan if n is np.ma.masked else n) for n in found]
    except (TypeError, AttributeError, ValueError, IndexError) as error:
        msg = (
            f"the estimator cannot work with power series ({error}); it must use only "
            "+ - * / **, abs, comparisons and numpy.sqrt, take one sample, k vectors "
            "(3,), not batches, and return a sequence of numbers"
        )
        raise InputError(msg) from error
    if not all(
        isinstance(s, Series) and np.isfinite(s.coefficients).all() for s in series
    ):
        msg = (
            "the estimator returned something that is not a finite number; it must "
            "return p of them"
        )
        raise InputError(msg)
    return series


def _noisy(
    centre: Float[Array, "k 3"], roots: Float[Array, "k 3 3"], order: int
) -> list[NDArray[np.object_]]:
    used = np.abs(roots).max(axis=1) > 0.0  # (k, 3): columns that carry noise
    tables = algebra(max(1, int(used.sum())), order)
    zero = tables.variable(0) * 0.0
    vectors, variable = [], 0
    for mean, root, columns in zip(centre, roots, used, strict=True):
        vector = np.array([zero + float(value) for value in mean], dtype=object)
        for column in np.flatnonzero(columns):
            xi = tables.variable(variable)
            variable += 1
            vector = vector + np.array([xi * float(c) for c in root[:, column]])
        vectors.append(vector)
    return vectors


def _without_constant(number: Series) -> Series:
    coefficients = number.coefficients.copy()
    coefficients[0] = 0.0
    return Series(coefficients, number.algebra)


def _mean_of_degree(number: Series, degree: int) -> float:
    tables = number.algebra
    kept = tables.degrees == degree
    return float(number.coefficients[kept] @ tables.means[kept])
