r"""Density of the two-vector estimate, and the regions that it falls in.

Near a singularity two moments say little: the estimate is spread over the sphere. Given
:math:`d_2 = l u` of length l, :math:`\bar q / l` is Gaussian with a mean :math:`m_0 +
l m_1` and a covariance S in the space of the (a x u, 0) and (0, 1), of three dimensions
(`simval.theory.exact`); :math:`m_1` is 0 for pairs that are not correlated. The
directions y and -y of such a Gaussian vector have together the density

.. math:: g(y; m, S) = \frac{1 + t^2}{2\pi |S|^{1/2} A^{3/2}}\, e^{-(C - t^2)/2},
   \tag{D1}

:math:`A = y^T S^{-1} y, \; t = y^T S^{-1} m/\sqrt A, \; C = m^T S^{-1} m`. A quaternion
[e; s] lies in the space of u where u is normal to e, on a circle. As q and -q are one
attitude, the density of the attitude is, exactly, for any covariances,

.. math:: f(\hat q) = \frac{1}{|e|} \oint \int_0^\infty l^2 N(l u; d_2, C_2)\,
   g(\hat q; m_0 + l m_1, S)\, dl\, d\varphi. \tag{D2}

In l it is a polynomial times a Gaussian, and of its moments on the half line

.. math:: M_k = \int_{-\tau}^\infty (x + \tau)^k \frac{e^{-x^2/2}}{\sqrt{2\pi}}\, dx
   = \tau M_{k-1} + (k - 1) M_{k-2}, \quad M_0 = \Phi(\tau). \tag{D3}

The trapezoidal rule on a circle converges geometrically. The region of a probability is
where the density is above a level: the smallest set that holds the estimate with it.
What a level h leaves outside is a mean over attitudes that are drawn with density g,

.. math:: 1 - p = E_g\big[w\, [f < h]\big] / E_g[w], \quad w = f / g,  \tag{D4}

of standard error :math:`\sqrt{\sum w^2 ([f < h] - (1 - p))^2} / \sum w`. A third of
them is drawn as estimates are, a third with twice the noise and a third evenly, so that
the rare ones that a region of 99.999 % leaves out are among them, of one spread or of
two, and no weight exceeds 3.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from simval.arguments import choice
from simval.arrays import Array, ReadOnly, finite_array, real_number
from simval.errors import InputError, RefusedError
from simval.geometry import cross, normalize
from simval.shapes import Float
from simval.theory.cubature import covariance_roots, normal_points
from simval.theory.exact import direction_maps
from simval.theory.expansion import half_noise, unit
from simval.theory.two_vector import (
    FRAMES,
    Column,
    TwoVectorGeometry,
    chosen_columns,
    noise_of_vectors,
    require_one,
    turned_geometry,
    unit_arguments,
)

_CIRCLE: Final = (64, 128, 256, 512, 1024, 2048)
_CLOSE: Final = 1e-5
"""Of two rules on the circle, relative to a density, or to the least that counts."""
_FAR: Final = 1e-9
"""Of the greatest density of all points: less does not count."""
_AT_ONCE: Final = 65_536
"""Nodes; their matrices take 5 MB each."""
_NEGLIGIBLE: Final = 1e-15
"""Density of a direction of d2, for each steradian; that of none would be 0.08."""
_NO_AXIS: Final = 1e-12
"""Of |e|: at e = 0 the density is infinite, and that of this is given."""
_DRAWS: Final = 9
"""Powers of two of the quasi-random attitudes of each kind in (D4), doubled."""
_MOST_ERROR: Final = 0.25
"""Standard error that is borne, of the share outside a region, or inside if less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeDensity(ReadOnly):
    """Density of the attitude that the closed form estimates.

    Attributes
    ----------
    geometry : TwoVectorGeometry
        The truth, in its frame.
    C1, C2 : Array
        Covariances of (d1, s1) given d2, (6, 6), and of d2, (3, 3).
    slope : Array
        Change of the mean of (d1, s1) by that of d2, (6, 3); 0 for pairs that are not
        correlated.
    levels, outside, error : Array
        Densities at the edges of regions, ascending, the share of the estimates that
        each region leaves outside, and its standard error, (n,).
    """

    geometry: TwoVectorGeometry
    C1: Float[Array, "6 6"]
    C2: Float[Array, "3 3"]
    slope: Float[Array, "6 3"]
    levels: Float[Array, " n"]
    outside: Float[Array, " n"]
    error: Float[Array, " n"]

    def __call__(self, q: Any) -> Float[Array, "..."]:
        """Density at attitudes, for each unit of area of the half sphere.

        Parameters
        ----------
        q : array_like
            Attitudes, of either sign, (..., 4).

        Returns
        -------
        Array
            The density, (...); at e = 0 of the frame, where (D2) is infinite, that at
            |e| of 1e-12.

        Raises
        ------
        InputError
            If a quaternion is none.
        RefusedError
            If the noise is so small that the rules do not resolve it.
        """
        given = normalize(finite_array("q", q, (4,)))
        flat = given.reshape(-1, 4) @ self.geometry.back
        noise = self.C1, self.C2, self.slope
        density = _density_of(self.geometry, noise, flat, float(self.levels[0]))
        return density.reshape(given.shape[:-1])

    def contains(self, q: Any, probability: float) -> Any:
        """Test which attitudes are in the smallest region of a probability.

        The share that it leaves outside is right to the standard error of (D4): some
        5 percent of it for a region of 90 percent, 10 for 99.9, 20 for 99.999.

        Parameters
        ----------
        q : array_like
            Attitudes, of either sign, (..., 4).
        probability : float
            Share of the estimates that the region holds, between 0 and 1.

        Returns
        -------
        bool or array of bool
            One for each attitude, (...).

        Raises
        ------
        InputError
            If a quaternion or the probability is none.
        RefusedError
            If the noise is so small that the rules do not resolve it, or the standard
            error of the share outside is more than a quarter of it.
        """
        inside = real_number("probability", probability, "")
        if not 0.0 < inside < 1.0:
            msg = f"`probability` is {inside:g}; it must be between 0 and 1"
            raise InputError(msg)
        least, most = 1.0 - self.outside[[-1, 0]]
        if not least <= inside <= most:
            msg = (
                f"`probability` is {inside:.10g}; the level of its region is known to "
                f"{_MOST_ERROR:.0%} of the share outside for one from {least:.1g} to "
                f"1 - {1.0 - most:.1g}: ask for one of these"
            )
            raise RefusedError(msg)
        return self(q) >= np.interp(1.0 - inside, self.outside, self.levels)


def attitude_density(
    q: Any, r1: Any, r2: Any, noise_std: Any, frame: Column | None = None
) -> AttitudeDensity:
    """Exact density (D2) of the two-vector estimate, at any distance from singular.

    Parameters
    ----------
    q : array_like
        True quaternion, reference to body, vector first, (4,).
    r1, r2 : array_like
        True reference vectors, (3,).
    noise_std : array_like
        Noise of the unit vectors, Gaussian: one standard deviation per axis, (4,) for
        b1, b2, r1, r2, (4, 3, 3) covariances, or (12, 12) of the stacked vectors.
    frame : {"plain", "x", "y", "z"}, optional
        The estimator's fixed frame, which may be singular at the truth; default, the
        greatest column of the truth.

    Returns
    -------
    AttitudeDensity
        A function of attitudes; `contains` says which are in a region.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value, or d1, s1 or d2 have a direction
        without noise.
    GeometryError
        If no frame is given and the vectors are parallel.
    RefusedError
        If the noise is so small that the rules do not resolve it.
    """
    require_one(q, r1, r2)
    truth = unit_arguments(q, r1, r2)
    if frame is None:
        column = chosen_columns(*truth, None)
    else:
        column = np.asarray(FRAMES.index(choice("frame", frame, FRAMES)))
    geometry = turned_geometry(column, *truth)
    C1, C2, C12 = half_noise(geometry, noise_of_vectors(noise_std))
    _require_regular("b2 and r2", C2)
    slope = np.zeros((6, 3)) if C12 is None else np.linalg.solve(C2, C12.T).T
    C1 = C1 - slope @ C2 @ slope.T
    _require_regular("b1 or r1", C1)
    root = scipy.linalg.block_diag(*(covariance_roots(C[None])[0] for C in (C1, C2)))
    root[6:, :6] = root[6:, 6:] @ slope.T
    centre = np.concatenate([geometry.d1, geometry.s1, geometry.d2])
    noise = [k * normal_points(9, k, _DRAWS) @ root for k in (1, 2)]
    d1, s1, d2 = np.split(centre + np.concatenate(noise), 3, axis=1)
    qbar = np.column_stack([cross(d1, d2), np.sum(s1 * d2, axis=1)])
    drawn = unit(np.concatenate([qbar, normal_points(4, 0, _DRAWS)]))
    f, wide = (_density_of(geometry, (k * C1, k * C2, slope), drawn) for k in (1, 4))
    if not f[: len(noise[0])].min() > 0.0:
        raise RefusedError(_unresolved(geometry, "miss estimates altogether"))
    order, even = np.argsort(f), np.pi**-2.0  # over an area of pi^2
    w = (3.0 * f / (f + wide + even))[order]
    total, squares = w.sum(), np.cumsum(w * w)
    outside = np.cumsum(w) / total
    rest = outside**2 * (squares[-1] - squares)
    error = np.sqrt((1.0 - outside) ** 2 * squares + rest) / total
    known = error <= _MOST_ERROR * np.minimum(outside, 1.0 - outside)
    known &= f[order] >= _FAR * f.max()
    unknown, median = np.flatnonzero(~known), np.searchsorted(outside, 0.5)
    kept = slice(unknown[unknown < median][-1] + 1, unknown[unknown > median][0])
    return AttitudeDensity(
        geometry=geometry, C1=C1, C2=C2, slope=slope, levels=f[order][kept],
        outside=outside[kept], error=error[kept],
    )  # fmt: skip


def _require_regular(name: str, C: Array) -> None:
    values = np.linalg.eigvalsh(C)
    if not values[0] > 1e-10 * values[-1]:
        msg = (
            f"`noise_std` leaves a direction of {name} without noise, where there is "
            "no density; give each of b1, b2, r1 and r2 noise in every direction, of "
            "its own where they are correlated"
        )
        raise InputError(msg)


def _density_of(
    geometry: TwoVectorGeometry,
    noise: tuple[Array, Array, Array],
    q: Float[Array, "n 4"],
    least: float = 0.0,
) -> Float[Array, " n"]:
    # of both signs, by rules on the circle that refine; what is far below the least
    # that counts need not be known
    previous = np.full(len(q), np.inf)
    for nodes in _CIRCLE:
        rows = max(1, _AT_ONCE // nodes)
        parts = [
            _on_circle(geometry, noise, q[i : i + rows], nodes)
            for i in range(0, len(q), rows)
        ]
        found = np.concatenate([np.zeros(0), *parts])
        off = np.abs(found - previous)
        least = max(least, _FAR * found.max(initial=0.0))
        if np.all(off <= _CLOSE * np.maximum(found, least)):
            return found
        previous = found
    raise RefusedError(_unresolved(geometry, f"still differ by {off.max():.1e}"))


def _unresolved(geometry: TwoVectorGeometry, what: str) -> str:
    return (
        f"two rules for the density {what}: the noise is small against |d2| "
        f"of {np.linalg.norm(geometry.d2):.2f}, where the covariance says "
        "all there is to say, so use `attitude_moments`"
    )


def _on_circle(
    geometry: TwoVectorGeometry,
    noise: tuple[Array, Array, Array],
    q: Array,
    nodes: int,
) -> Array:
    # (D2) by the trapezoidal rule
    C1, C2, slope = noise
    length = np.linalg.norm(q[:, :3], axis=1)
    e = np.where(length[:, None] > _NO_AXIS, q[:, :3], [_NO_AXIS, 0.0, 0.0])
    length = np.maximum(length, _NO_AXIS)
    axis = unit(e)
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    across = unit(cross(axis, least))
    phi = 2.0 * np.pi * np.arange(nodes)[:, None, None] / nodes
    u = np.cos(phi) * across + np.sin(phi) * cross(axis, across)
    u = u.reshape(-1, 3)
    inverse = np.linalg.inv(C2)
    kept = np.flatnonzero(_along(u, geometry.d2, inverse) > _NEGLIGIBLE)
    u, y = u[kept], q[kept % len(q)]
    maps, basis = direction_maps(u)
    m0 = maps @ (np.concatenate([geometry.d1, geometry.s1]) - slope @ geometry.d2)
    m1 = np.matvec(maps, u @ slope.T)
    S = np.linalg.inv(maps @ C1 @ maps.mT)
    y = np.vecmat(y, basis)
    pulled = np.matvec(S, y)
    A = np.vecdot(y, pulled)
    t0, t1 = (np.vecdot(pulled, m) / np.sqrt(A) for m in (m0, m1))
    S0, S1 = np.matvec(S, m0), np.matvec(S, m1)
    square = np.vecdot(u, u @ inverse) + np.vecdot(m1, S1) - t1 * t1
    linear = u @ inverse @ geometry.d2 - np.vecdot(m1, S0) + t0 * t1
    rest = geometry.d2 @ inverse @ geometry.d2 + np.vecdot(m0, S0) - t0 * t0
    root = np.sqrt(square)
    _, _, M2, M3, M4 = _half_line(linear / root)
    polynomial = (
        (1.0 + t0 * t0) * M2 + 2.0 * t0 * t1 * M3 / root + (t1 / root) ** 2 * M4
    )
    with np.errstate(under="ignore"):
        size = np.exp(-0.5 * (rest - linear**2 / square)) * np.maximum(polynomial, 0.0)
    size *= np.sqrt(np.linalg.det(S) * np.linalg.det(inverse)) * A**-1.5 * root**-3
    circle = np.bincount(kept % len(q), size, minlength=len(q))
    return circle / (2.0 * np.pi * nodes) / length


def _along(u: Array, d2: Array, inverse: Array) -> Array:
    # density of the direction of d2
    A = np.vecdot(u, u @ inverse)
    t = u @ inverse @ d2 / np.sqrt(A)
    scale = np.sqrt(np.linalg.det(inverse)) / (2.0 * np.pi)
    with np.errstate(under="ignore"):
        tilted = np.exp(-0.5 * (d2 @ inverse @ d2 - t * t))
    return tilted * _half_line(t)[2] * scale * A**-1.5


def _half_line(tau: Array) -> list[Array]:
    # (D3)
    with np.errstate(under="ignore"):
        M = [scipy.special.ndtr(tau)]
        M.append(tau * M[0] + np.exp(-0.5 * tau * tau) / np.sqrt(2.0 * np.pi))
    for k in (2, 3, 4):
        M.append(tau * M[k - 1] + (k - 1) * M[k - 2])
    return M
