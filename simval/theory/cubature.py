r"""Gaussian cubature of an estimator, taken as a black box.

The Smolyak rule of level L combines Gauss-Hermite rules of :math:`2l - 1` nodes,

.. math:: \sum_{L - d \le |l| - d \le L - 1} (-1)^{L-1-|l|+d}
   \binom{d-1}{L-1-|l|+d}\, U_{l_1} \otimes \dots \otimes U_{l_d},  \tag{S1}

and integrates every polynomial of total degree :math:`2L - 1` in d standard normal
variables exactly. Some weights are negative, and their absolute sum grows with the
level (50 at degree 7, 128 at degree 9 in nine variables): fine for a smooth integrand,
of no use once the noise reaches a third of :math:`|\bar q|`. Nothing about the
estimator is assumed but that it is smooth around the truth, so this is a route to
bias and covariance that shares no step with the expansions.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import product
from math import comb, fsum
from typing import Any, Final

import numpy as np
import scipy

from simval.arguments import function, whole_number
from simval.arrays import (
    LEAST,
    Array,
    finite_array,
    physical_array,
    shaped_array,
)
from simval.errors import InputError, RefusedError
from simval.moments import Moments
from simval.shapes import Float
from simval.theory.two_vector import checked_covariances

Estimator = Callable[..., Any]
"""``estimator(v1, ..., vk)`` takes k batches (n, 3) and returns (n, p)."""
MOST_NODES = 10_000_000
"""More take minutes and gigabytes."""
Node = tuple[tuple[int, float], ...]
"""Axis and value of the coordinates of a node that are not zero."""
Levels = tuple[tuple[int, int], ...]
"""Axis and level above the first of the axes that have one."""


@lru_cache(maxsize=8)
def smolyak_hermite(
    dimension: int, degree: int
) -> tuple[Float[Array, "n dimension"], Float[Array, " n"]]:
    """Nodes and weights of the rule (S1) for independent standard normals.

    Raises
    ------
    InputError
        If the dimension or the degree is out of range.
    """
    whole_number("dimension", dimension, 1)
    if whole_number("degree", degree, 1, 15) % 2 == 0:
        msg = f"`degree` is {degree}; it must be an odd number from 1 to 15"
        raise InputError(msg)
    if comb(dimension + degree // 2, degree // 2) * 2 ** (degree // 2) > MOST_NODES:
        msg = (
            f"degree {degree} in {dimension} variables needs more than {MOST_NODES:g} "
            "nodes; lower `degree`, or sample at random instead"
        )
        raise InputError(msg)
    level = (degree + 1) // 2
    rules = [_hermite(2 * k + 1) for k in range(level)]
    total: dict[Node, float] = {}
    for excess in range(max(0, level - dimension), level):
        gap = level - 1 - excess
        sign = (-1) ** gap * comb(dimension - 1, gap)
        for levels in _compositions(dimension, excess):
            for node, weight in _grid(rules, levels):
                total[node] = total.get(node, 0.0) + sign * weight
    points = np.zeros((len(total), dimension))
    for row, node in zip(points, total, strict=True):
        for axis, value in node:
            row[axis] = value
    weights = _symmetric_weights(total)
    points.flags.writeable = weights.flags.writeable = False
    return points, weights


def _symmetric_weights(total: dict[Node, float]) -> Float[Array, " n"]:
    # The rule is symmetric under signs and permutations of the axes; rounding in the
    # alternating sum is not, and would let odd moments through. So each orbit gets
    # its mean weight, and the centre what makes the sum 1.
    orbits: dict[tuple[float, ...], list[float]] = {}
    keys = [tuple(sorted(abs(value) for _, value in node)) for node in total]
    for key, weight in zip(keys, total.values(), strict=True):
        orbits.setdefault(key, []).append(weight)
    means = {key: fsum(weights) / len(weights) for key, weights in orbits.items()}
    others = fsum(means[key] * len(orbits[key]) for key in means if key)
    means[()] = 1.0 - others
    return np.array([means[key] for key in keys])


def _hermite(count: int) -> list[tuple[float, float]]:
    # nodes and weights for a standard normal; the middle node is exactly zero
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    nodes = (nodes - nodes[::-1]) / 2.0
    return list(zip(nodes.tolist(), (weights / weights.sum()).tolist(), strict=True))


def _compositions(dimension: int, excess: int) -> Iterator[Levels]:
    # all levels above the first that sum to excess
    def extend(first: int, left: int, chosen: Levels) -> Iterator[Levels]:
        if left == 0:
            yield chosen
            return
        for axis in range(first, dimension):
            for step in range(1, left + 1):
                yield from extend(axis + 1, left - step, (*chosen, (axis, step)))

    return extend(0, excess, ())


def _grid(
    rules: list[list[tuple[float, float]]], levels: Levels
) -> Iterator[tuple[Node, float]]:
    # nodes of one tensor product, as (axis, value) of the coordinates that are not 0
    axes = [axis for axis, _ in levels]
    for picks in product(*(rules[step] for _, step in levels)):
        weight = 1.0
        for _, w in picks:
            weight *= w
        node = ((a, x) for a, (x, _) in zip(axes, picks, strict=True) if x != 0.0)
        yield tuple(node), weight


def cubature_moments(
    estimator: Estimator,
    inputs: Any,
    covariances: Any,
    truth: Any,
    degree: int = 9,
) -> Moments:
    """Bias and covariance of truth minus estimate by Smolyak cubature.

    Parameters
    ----------
    estimator : callable
        Takes k batches (n, 3) and returns estimates (n, p).
    inputs : array_like
        True values of the k vectors, (k, 3).
    covariances : array_like
        Covariance of the Gaussian noise on each, independent from vector to vector,
        (k, 3, 3), or of all of them together, (3k, 3k).
    truth : array_like
        What the estimate is compared with, (p,).
    degree : int, default 9
        Degree of the rule; the moments are off by terms of that order plus one.

    Returns
    -------
    Moments
        Prediction; no samples.

    Raises
    ------
    InputError
        If a shape is wrong.
    RefusedError
        If the estimator returned a value that is not finite.
    """
    function("estimator", estimator)
    degree = whole_number("degree", degree, 1, 15)
    centre = physical_array("inputs", inputs, (None, 3))
    target = physical_array("truth", truth, (None,))
    root = joint_root("covariances", covariances, centre)
    if target.ndim != 1:
        msg = f"`truth` has shape {target.shape}; give what is estimated, (p,)"
        raise InputError(msg)
    rule = smolyak_hermite(centre.size, degree)
    return _moments(estimator, centre, root, target, rule)


_DEGREES: Final = (5, 7, 9)
_MOST_REFINED: Final = 150_000
"""Nodes of the finest rule: seconds to make, once."""
_AGREEMENT: Final = 1e-3
"""Relative, of the last two rules; the finer one is ten times nearer."""
_SCRAMBLES: Final = 8
_SOBOL: Final = 15
"""Powers of two of points, each also with the other sign: 524 288 in all."""
REFINED: Final = 2e-3
"""Relative standard error of all scrambles together, at most."""


def refined_moments(
    estimator: Estimator, inputs: Array, covariances: Array, truth: Array
) -> Moments:
    """Moments of any estimator under noise of any size.

    By rules of rising degree until two agree within 1e-3, and where the noise is too
    large for that by scrambled Sobol points, whose scrambles tell their error.

    Raises
    ------
    RefusedError
        If that is more than 2e-3.
    """
    root = joint_root("covariances", covariances, inputs)
    root = root[:, np.abs(root).max(axis=0) > 0.0]
    if not root.size:
        return Moments(
            bias=np.zeros(len(truth)), covariance=np.zeros((len(truth),) * 2)
        )
    previous = None
    for degree in _DEGREES:
        half = degree // 2
        if comb(root.shape[1] + half, half) * 2**half > _MOST_REFINED:
            break
        rule = smolyak_hermite(root.shape[1], degree)
        found = _moments(estimator, inputs, root, truth, rule)
        if previous is not None and _apart(previous, found) <= _AGREEMENT:
            return found
        previous = found
    rules = (_scrambled(root.shape[1], number) for number in range(_SCRAMBLES))
    each = [_moments(estimator, inputs, root, truth, rule) for rule in rules]
    halves = each[::2], each[1::2], each
    first, second, every = (_mean_of(some) for some in halves)
    # half of the difference of two halves is the standard error of the whole
    error = 0.5 * _apart(first, second)
    if not error <= REFINED:
        msg = (
            f"the moments have a standard error of {error:.1e} relative, needed "
            f"{REFINED:g}: the noise is too large; simulate instead"
        )
        raise RefusedError(msg)
    return every


def _scrambled(dimension: int, seed: int) -> tuple[Array, Array]:
    # a rule of such points
    points = normal_points(dimension, seed, _SOBOL)
    both = np.concatenate([np.zeros((1, dimension)), points])
    weights = np.full(len(both), 1.0 / len(points))
    weights[0] = 0.0  # the centre, which errors are counted from
    return both, weights


def normal_points(dimension: int, seed: int, power: int) -> Float[Array, "n d"]:
    """Scrambled Sobol points as standard normals, each with its negative."""
    sobol = scipy.stats.qmc.Sobol(dimension, rng=np.random.default_rng(seed))
    uniform = np.clip(sobol.random_base2(power), 1e-12, 1.0 - 1e-12)
    points = scipy.special.ndtri(uniform)
    return np.concatenate([points, -points])


def _mean_of(parts: list[Moments]) -> Moments:
    bias = np.mean([part.bias for part in parts], axis=0)
    second = np.mean([part.second_moment for part in parts], axis=0)
    return Moments(bias=bias, covariance=second - np.outer(bias, bias))


def _apart(one: Moments, other: Moments) -> float:
    # greatest relative difference of bias and covariance
    pairs = (one.bias, other.bias), (one.covariance, other.covariance)
    return max(
        float(np.linalg.norm(a - b)) / max(float(np.linalg.norm(b)), LEAST)
        for a, b in pairs
    )


def _moments(
    estimator: Estimator,
    centre: Array,
    root: Array,
    target: Array,
    rule: tuple[Array, Array],
) -> Moments:
    # by a rule in as many variables as the root has columns
    points, weights = rule
    noise = (points @ root.T).reshape(-1, *centre.shape)
    batches = [mean + noise[:, i] for i, mean in enumerate(centre)]
    estimate = shaped_array("the estimate", estimator(*batches), (target.size,))
    if estimate.shape != (len(points), target.size):
        msg = (
            f"the estimator returned shape {estimate.shape} for {len(points)} samples "
            f"and a truth of {target.size} numbers; it must be (n, p)"
        )
        raise InputError(msg)
    if not np.isfinite(estimate).all():
        msg = (
            "the estimator returned a value that is not finite at a cubature node; "
            "reduce the noise or the degree, or estimate in a fixed regular frame"
        )
        raise RefusedError(msg)
    # Deviations from the centre's estimate: its weight, some hundred, would
    # otherwise multiply a rounding error of order 1.
    middle = estimate[np.argmin(np.vecdot(points, points))]
    error = middle - estimate
    shift = weights @ error
    bias = target - middle + shift
    deviation = error - shift
    covariance = (weights[:, None] * deviation).T @ deviation
    return Moments(bias=bias, covariance=(covariance + covariance.T) / 2.0)


def joint_root(name: str, covariances: Any, vectors: Array) -> Float[Array, "m m"]:
    """Root of the covariance of stacked vectors, given for each or for all.

    Raises
    ------
    InputError
        If it is neither (k, 3, 3) nor (3k, 3k), or no covariance.
    """
    size = vectors.size
    if finite_array(name, covariances, ()).shape == (size, size):
        return covariance_roots(checked_covariances(name, [covariances], size))[0]
    roots = covariance_roots(checked_covariances(name, covariances))
    if vectors.ndim != 2 or roots.shape != (*vectors.shape, 3):
        msg = (
            f"`inputs` has shape {vectors.shape} and `{name}` {roots.shape}; give "
            "(k, 3) and (k, 3, 3), or (3k, 3k) where vectors are correlated"
        )
        raise InputError(msg)
    return scipy.linalg.block_diag(*roots)


def covariance_roots(covariances: Float[Array, "k n n"]) -> Float[Array, "k n n"]:
    """Symmetric roots R, R R' equal to each covariance, singular ones included.

    The symmetric root alone does not depend on the eigenvectors that a processor's
    kernels happen to choose where eigenvalues are equal.
    """
    values, vectors = np.linalg.eigh(covariances)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return scaled @ vectors.mT
