r"""Power series in Gaussian noise: theory for any estimator's arithmetic.

An estimator written with + - * / and sqrt is evaluated on numbers that carry all
their derivatives up to a total degree: polynomials in independent standard normal
variables :math:`\xi`, cut off beyond the degree. The moments of the result follow
from :math:`E[\xi^{2k}] = (2k-1)!!`. There is no formula of the estimator's own in
here, so this is both a service (second- and fourth-order theory of a user's
estimator) and an independent route to the closed forms.

The noise n of all vectors together enters by its moments alone. With R the symmetric
root of its covariance, :math:`n = R\xi`, vectors may be correlated with each other, and
third moments :math:`S_{ijk} = E[n_i n_j n_k]` add

.. math:: E[\xi_a \xi_b \xi_c] = \sum_{ijk} R^+_{ai} R^+_{bj} R^+_{ck} S_{ijk}
   \tag{T1}

to the moments of degree three, and nothing to those of degree four: fourth cumulants
are taken as zero. In the error :math:`e_1 + e_2 + \dots`, one term for each degree,
the covariance gains :math:`E[e_1 e_2^T] + E[e_2 e_1^T]` and the bias :math:`E[e_3]`,
both in :math:`\sigma^3`.
"""

from collections.abc import Callable
from functools import lru_cache
from itertools import combinations_with_replacement
from math import prod
from typing import Any, Final, Literal, NamedTuple, Union

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, function
from simval.arrays import Array, Places, physical_array
from simval.errors import InputError, RefusedError
from simval.moments import Moments
from simval.shapes import Float
from simval.theory.cubature import joint_root
from simval.theory.two_vector import joint_third

Scalar = Union["Series", float]


class Algebra(NamedTuple):
    """Monomials of some variables up to a degree, and their products.

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
    degrees: Places
    means: Float[Array, " m"]
    left: Places
    right: Places
    target: Places

    def variable(self, index: int) -> "Series":
        """One variable as a series."""
        coefficients = np.zeros(self.means.size)
        coefficients[1 + index] = 1.0
        return Series(coefficients, self)


@lru_cache(maxsize=16)
def algebra(dimension: int, degree: int) -> Algebra:
    """Tables for truncated polynomials, the constant first."""
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
    return Algebra(
        dimension=dimension,
        degree=degree,
        degrees=degrees,
        means=np.array([_normal_moment(monomial) for monomial in monomials]),
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
    """A truncated polynomial in the noise that calculates like a number."""

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
        one, two = self.coefficients != 0.0, other.coefficients != 0.0
        left, right, target = tables.left, tables.right, tables.target
        if 10 * np.count_nonzero(one) * np.count_nonzero(two) < size**2:
            kept = np.flatnonzero(one[left] & two[right])
            left, right, target = left[kept], right[kept], target[kept]
        terms = self.coefficients[left] * other.coefficients[right]
        total = np.bincount(target, weights=terms, minlength=size)
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
        """Square root; `numpy.sqrt` calls this for arrays of series."""
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
        """Mean over independent standard normal variables."""
        return float(self.coefficients @ self.algebra.means)


def require_distribution(order: Any, third_moments: Any) -> None:
    """Refuse ``"exact"`` moments if third moments are given.

    Raises
    ------
    InputError
        If it is: they do not determine a distribution.
    """
    if order == "exact" and third_moments is not None:
        msg = (
            "`order` is 'exact'; third moments do not determine a distribution, so "
            "give order 3 with `third_moments`"
        )
        raise InputError(msg)


def series_moments(
    estimator: Callable[..., Any],
    inputs: Any,
    covariances: Any,
    order: Literal[2, 3, 4, 6] = 4,
    third_moments: Any = None,
) -> Moments:
    """Moments of an estimator by its own arithmetic, truth minus estimate.

    Parameters
    ----------
    estimator : callable
        Takes k object arrays (3,) of numbers and returns p numbers, using
        + - * / ** and `numpy.sqrt` only; `numpy.cross`, `dot` and `sum` are these.
        `abs` and comparisons follow the branch that is taken without noise.
    inputs : array_like
        True values of the k vectors, (k, 3).
    covariances : array_like
        Covariance of the noise on each, independent from vector to vector, (k, 3, 3),
        or of all of them together, (3k, 3k).
    order : {2, 3, 4, 6}, default 4
        Highest power of the noise kept.
    third_moments : array_like, optional
        Means of the products of three components of the noise of mean zero,
        (k, 3, 3, 3) or (3k, 3k, 3k); they count from order 3 on. Default, Gaussian
        noise; with them the fourth cumulants are still taken as zero, and there is no
        order 6.

    Returns
    -------
    Moments
        Prediction; the truth is the estimate without noise.

    Raises
    ------
    InputError
        If a shape or the order is wrong, or third moments are none.
    RefusedError
        If the estimator has no power series at the truth.
    """
    function("estimator", estimator)
    order = choice("order", order, (2, 3, 4, 6))
    centre = physical_array("inputs", inputs, (None, 3))
    root = joint_root("covariances", covariances, centre)
    root = root[:, np.abs(root).max(axis=0) > 0.0]  # columns that carry noise
    tables = algebra(max(1, root.shape[1]), order)
    if third_moments is not None:
        if order == 6:
            msg = (
                "`order` is 6; with `third_moments` the highest is 4, because sixth "
                "order takes moments of the noise up to the sixth"
            )
            raise InputError(msg)
        tables = _skewed(tables, root, third_moments, len(centre))
    estimate = _estimated(estimator, _noisy(centre, root, tables))
    errors = [_without_constant(-1.0 * number) for number in estimate]
    bias = np.array([error.mean() for error in errors])
    # means of products, from those monomials alone whose mean is not 0
    E, kept = np.stack([e.coefficients for e in errors]), tables.means[tables.target]
    even = np.flatnonzero(kept)
    second = (E[:, tables.left[even]] * kept[even]) @ E[:, tables.right[even]].T
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
    centre: Float[Array, "k 3"], root: Float[Array, "m d"], tables: Algebra
) -> list[NDArray[np.object_]]:
    coefficients = np.zeros((centre.size, tables.means.size))
    coefficients[:, 0] = centre.ravel()
    coefficients[:, 1 : 1 + root.shape[1]] = root
    numbers = np.array([Series(row, tables) for row in coefficients], dtype=object)
    return list(numbers.reshape(centre.shape))


# A direction without variance is rounded to 1e-16 of it, whose root is 1e-8.
_NO_NOISE: Final = 1e-6
_OUTSIDE: Final = 1e-9
"""Of the greatest standard deviation cubed; 1e-15 of it is rounding."""

_MOST_SKEWED: Final = 100.0
"""That of an exponential law is 2; this one has its mass within 1e-4 of the samples."""


def _skewed(
    tables: Algebra, root: Float[Array, "m d"], third_moments: Any, count: int
) -> Algebra:
    # the tables with (T1) as the means of degree three
    S = joint_third("third_moments", third_moments, count)
    whitened = _turned(np.linalg.pinv(root, rcond=_NO_NOISE), S)
    widest = np.linalg.norm(root, axis=1).max(initial=0.0)
    if not np.abs(_turned(root, whitened) - S).max() <= _OUTSIDE * widest**3:
        msg = (
            "`third_moments` are not 0 along a direction in which the noise has no "
            "variance; give noise there, or no third moment"
        )
        raise InputError(msg)
    if not np.abs(whitened).max(initial=0.0) <= _MOST_SKEWED:
        msg = (
            f"`third_moments` make a skewness of {np.abs(whitened).max():.1e}; no "
            f"expansion follows one above {_MOST_SKEWED:g}, so check their unit"
        )
        raise InputError(msg)
    means, cubic = tables.means.copy(), np.flatnonzero(tables.degrees == 3)
    triples = combinations_with_replacement(range(root.shape[1]), 3)
    for place, triple in zip(cubic, triples, strict=False):  # order 2 has no place
        means[place] = whitened[triple]
    return tables._replace(means=means)


def _turned(matrix: Array, tensor: Array) -> Array:
    # a tensor of three axes in other coordinates
    for _ in range(3):
        tensor = np.tensordot(tensor, matrix, axes=(0, 1))
    return tensor


def _without_constant(number: Series) -> Series:
    coefficients = number.coefficients.copy()
    coefficients[0] = 0.0
    return Series(coefficients, number.algebra)


def _mean_of_degree(number: Series, degree: int) -> float:
    tables = number.algebra
    kept = tables.degrees == degree
    return float(number.coefficients[kept] @ tables.means[kept])
