"""Random attitudes and vectors, and truths that share no step with the sources."""

from collections.abc import Callable
from functools import cache
from itertools import product as every
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

X, Y, Z = np.eye(3)
AXES = {"x": X, "y": Y, "z": Z}


class Pair:
    """Two vectors seen in both frames, without noise unless `noise` (4, 3) is given."""

    def __init__(self, q: Any, r1: Any, r2: Any, noise: Any = None) -> None:
        self.q = np.asarray(q)
        A = attitude(q)
        vectors = np.stack([A @ r1, A @ r2, r1, r2])
        if noise is not None:
            vectors = vectors + noise
        self.b1, self.b2, self.r1, self.r2 = self.vectors = vectors
        self.s1, self.s2 = (self.b1 + self.r1) / 2, (self.b2 + self.r2) / 2
        self.d1, self.d2 = (self.b1 - self.r1) / 2, (self.b2 - self.r2) / 2


def unit(v: Any) -> Any:
    """The direction of v."""
    return np.asarray(v) / np.linalg.norm(v, axis=-1, keepdims=True)


def directions(n: int, rng: np.random.Generator) -> Any:
    """Random unit vectors, no two nearly parallel."""
    while True:
        found = unit(rng.standard_normal((n, 3)))
        products = np.abs(found @ found.T - np.eye(n))
        if products.max() < 0.9:
            return found


def quaternion(rng: np.random.Generator) -> Any:
    """A random quaternion without a small component."""
    while True:
        q = unit(rng.standard_normal(4))
        if np.abs(q).min() > 0.15:
            return q


def pair(rng: np.random.Generator) -> Pair:
    """A random attitude of two random vectors, well off every singular case."""
    while True:
        q, (r1, r2) = quaternion(rng), directions(2, rng)
        e_n = q[:3] @ np.cross(r1, r2)
        if abs(e_n) > 0.2:
            return Pair(q * np.sign(e_n), r1, r2)  # the sign of the estimate


def turn(axis: Any, angle: float) -> Any:
    """Quaternion of a turn, by SciPy."""
    return Rotation.from_rotvec(angle * unit(axis)).as_quat()


def attitude(q: Any) -> Any:
    """Matrix from the reference frame to the body frame, by SciPy."""
    return Rotation.from_quat(q).as_matrix().T


def multiply(p: Any, q: Any) -> Any:
    """Product of quaternions, i j = k, as a product of complex 2 x 2 matrices."""
    (a, b), (_, d) = _matrix(p) @ _matrix(q)
    return np.array([-b.imag, -b.real, -(a.imag - d.imag) / 2, (a.real + d.real) / 2])


def _matrix(q: Any) -> Any:
    x, y, z, w = q
    return np.array([[w - 1j * z, -y - 1j * x], [y - 1j * x, w + 1j * z]])


def inverse(q: Any) -> Any:
    """The inverse of a unit quaternion."""
    return q * np.array([-1, -1, -1, 1])


def skew(v: Any) -> Any:
    """Matrix of the cross product."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def covariance(n: int, rng: np.random.Generator) -> Any:
    """A random covariance of size n."""
    F = rng.standard_normal((n, n))
    return F @ F.T / n


def qbar(vectors: Any) -> Any:
    """The unnormalised estimate from b1, b2, r1, r2; complex steps allowed."""
    b1, b2, r1, r2 = vectors
    d1, d2 = (b1 - r1) / 2, (b2 - r2) / 2
    return np.append(np.cross(d1, d2), (b1 + r1) @ d2 / 2)


def jacobian(f: Callable[[Any], Any], at: Any) -> Any:
    """Derivative of an analytic function by complex steps, exact to rounding."""
    flat = np.ravel(at)
    steps = flat + 1e-30j * np.eye(flat.size)
    return np.stack([f(x.reshape(np.shape(at))).imag / 1e-30 for x in steps], axis=-1)


def taylor(f: Callable[[complex], Any], n: int) -> Any:
    """Taylor coefficients 0 to n of an analytic function, from a circle around 0."""
    radius, nodes = 0.2, 64  # singularities lie at 0.5 or farther: error 0.4^64
    t = radius * np.exp(2j * np.pi * np.arange(nodes) / nodes)
    values = np.stack([f(x) for x in t])
    weights = t ** -np.arange(n + 1)[:, None] / nodes
    return np.tensordot(weights, values, axes=1).real


@cache
def _grid(size: int, nodes: int) -> tuple[Any, Any]:
    # product rule of Gauss and Hermite for independent standard normals
    points, weights = np.polynomial.hermite_e.hermegauss(nodes)
    weight = np.prod(list(every(weights / weights.sum(), repeat=size)), axis=1)
    return np.array(list(every(points, repeat=size))), weight


def gaussian_mean(f: Callable[[Any], Any], P: Any, nodes: int = 3) -> Any:
    """Mean of f(x), x normal with covariance P; exact to degree 2 nodes - 1."""
    grid, weights = _grid(len(P), nodes)
    values = np.stack([f(x) for x in grid @ np.linalg.cholesky(P).T])
    return np.tensordot(weights, values, axes=1)


def second_order_mean(f: Callable[[Any], Any], P: Any) -> Any:
    """Coefficient of s^2 in the mean of f(s x), f(0) taken off, by extrapolation."""
    s = 0.02
    one, two, four = (
        (gaussian_mean(f, (s * k) ** 2 * P, 5) - f(np.zeros(len(P)))) / (s * k) ** 2
        for k in (1, 2, 4)
    )
    finer, coarser = (4 * one - two) / 3, (4 * two - four) / 3
    return (16 * finer - coarser) / 15  # leaves s^6


def mean_square(f: Callable[[Any], Any], P: Any) -> Any:
    """Mean of f(x) f(x)' for a quadratic f, exact."""
    return gaussian_mean(lambda x: np.outer(f(x), f(x)), P)
