r"""Exact moments of the normalised quaternion, by quadrature.

**Quadrature over the direction of a Gaussian vector.** The density of :math:`u =
d_2/|d_2|` for :math:`d_2 \sim N(d_2^t, \tau_2^2 I)` on the sphere, with :math:`k =
|d_2^t|/\tau_2` and :math:`t = k \cos\theta`, is

.. math:: (2\pi)^{-3/2} e^{-(k^2 - t^2)/2}
   [(1 + t^2)\sqrt{2\pi}\,\Phi(t) + t e^{-t^2/2}].  \tag{U1}

Rules are products of Gauss-Legendre in the polar angle and the trapezoidal rule in
azimuth, about the direction of :math:`d_2^t` or, where the integrand varies quickly
near the direction of :math:`d_1^t`, about that.

**Isotropic independent noise.** Write :math:`\bar q = |d_2| [d_1 \times u; s_1^T u]`
with :math:`u = d_2/|d_2|`. Given u, :math:`\bar q/|d_2|` is an isotropic Gaussian of
standard deviation :math:`\tau_1 = \sqrt{\sigma_{b1}^2 + \sigma_{r1}^2}/2` in the
three-dimensional space spanned by the (a x u, 0) and (0, 1), with mean :math:`m =
[d_1^t \times u; s_1^{tT} u]`. With :math:`w = m/|m|`, :math:`\rho = |m|/\tau_1`,
:math:`R = \mathrm{diag}(I - uu^T, 1)`,

.. math::
   E[\hat q|u] = A w,\quad
   A = \sqrt{2/\pi}\, e^{-\rho^2/2}/\rho
   + (1 - 1/\rho^2)\,\mathrm{erf}(\rho/\sqrt 2), \\
   E[\hat q \hat q^T|u] = B w w^T + (1 - B)/2\, (R - w w^T),\quad
   B = 1 - 2/\rho^2 + 2\sqrt 2 D(\rho/\sqrt 2)/\rho^3,  \tag{E1}

D being Dawson's function. What is left is an average over the direction u, by the
rules above. The moments of :math:`q - \hat q` are formed from
small differences, so that they keep their digits at small noise: a standard deviation
is good to 1e-15 absolute. No expansion in the noise is made anywhere.

**Gaussian noise of any covariance.** Given d2, :math:`\bar q` is linear in :math:`z_1 =
(d_1, s_1)`, so Gaussian with a mean m and a covariance S, and in the axes of S, with
eigenvalues :math:`\lambda_k`,

.. math::
   E[\hat q|d_2] = \tfrac{2}{\sqrt\pi} \int_0^\infty E[\bar q\,e^{-s^2|\bar q|^2}]\,ds,
   \quad E[\hat q \hat q^T|d_2] =
   \int_0^\infty 2s\,E[\bar q \bar q^T e^{-s^2|\bar q|^2}]\,ds,  \tag{E2} \\
   E[\bar q_k e^{-s^2|\bar q|^2}] = m_k f_k Z, \quad
   E[\bar q_k \bar q_l e^{-s^2|\bar q|^2}]
   = (m_k m_l f_k f_l + \delta_{kl} \lambda_k f_k) Z, \\
   f_k = 1/(1 + 2 s^2 \lambda_k), \quad
   Z = \textstyle\prod_k f_k^{1/2} e^{-s^2 m_k^2 f_k}.  \tag{E3}

The same integrals without noise are w and :math:`w w^T`, :math:`w = m/|m|`; what is
integrated is the difference, :math:`\delta = E[w - \hat q]` and
:math:`D = w w^T - E[\hat q \hat q^T]`, formed without cancellation, so that

.. math:: E[(q - \hat q)(q - \hat q)^T|d_2] = (q - w)(q - w)^T
   + q \delta^T + \delta q^T - D  \tag{E4}

keeps its digits at small noise. Where the pairs are correlated, the mean of z1 given d2
is :math:`z_1^t + C_{12} C_2^{-1} (d_2 - d_2^t)` and its covariance :math:`C_1 - C_{12}
C_2^{-1} C_{12}^T`; then the length of d2 counts too, and what is left is a
Gauss-Hermite rule over d2 itself. The trapezoidal rule in :math:`\log s` converges
geometrically. Only the direction of d2 counts; what is left is an average over it, by
the rules above. For isotropic noise (E1) is the integral over s in closed form, and
shares nothing with this but (E4).
"""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any, Final

import numpy as np
import scipy

from simval.arrays import Array, Mask, Scalars, frozen, outer
from simval.errors import RefusedError
from simval.geometry import cross, cross_matrix
from simval.shapes import Float
from simval.theory.cubature import covariance_roots
from simval.theory.expansion import half_noise
from simval.theory.two_vector import Noise, TwoVectorGeometry, naming

Rule = tuple[Array, Array]
"""Directions or other nodes, and their weights."""
MeanAndCovariance = tuple[Array, Array]

# Azimuth nodes, with `_MORE` polar ones, about the direction of d2. Far from singular
# the second rule suffices, which the first only checks.
_MORE: Final = 10
_ABOUT_D2: Final = (12, 18, 27, 40, 60)
_AT_ONCE: Final = 4096
"""Directions of some samples; what is worked out of them takes 1 MB, for the cache."""
# Where they disagree, m passes zero inside the density: at u along d1, within an angle
# tau1. Then polar nodes per panel and azimuth nodes about the direction of d1, on
# panels that grow fourfold away from it; there w depends on the azimuth alone, and
# varies within |d1|/|s1| of azimuth; the density varies within 1/k across the pole. The
# azimuth nodes are a multiple of what resolves both.
_ABOUT_D1: Final = ((12, 12.0), (16, 20.0), (24, 30.0), (32, 40.0))
# Azimuths of the first rule at least, and of the last at most, which is for the memory;
# where more would be needed the rules disagree, which is refused.
_AZIMUTHS: Final = (64, 4096)
# Where the density has fallen to e^{-8.5^2/2} = 2e-16 of its peak, by k sin(theta).
_CUT: Final = 8.5


def about_d2(
    d2: Float[Array, "... 3"], tau: Any, nodes: tuple[int, int]
) -> tuple[Float[Array, "... n 3"], Float[Array, "... n"]]:
    """Directions and weights for the density (U1), about its centre."""
    length = np.linalg.norm(d2, axis=-1)
    # without noise all directions are that of d2, to rounding
    k = length / np.maximum(tau, 1e-150 * length)
    theta, polar = _panel(0.0, _reach(k), nodes[0])
    directions, azimuth = _grid(d2 / length[..., None], theta, nodes[1])
    sine = np.sin(theta)
    polar = polar * sine * _density(k[..., None], np.cos(theta), sine)
    return directions, np.repeat(polar * azimuth, nodes[1], axis=-1)


def _reach(k: Any) -> Any:
    # angle from its centre beyond which the density does not count
    return np.where(k > _CUT, np.arcsin(np.minimum(_CUT / k, 1.0)), np.pi)


def _about_d1(
    d1: Float[Array, "3"],
    d2: Float[Array, "3"],
    tau: tuple[float, float],
    nodes: tuple[int, int],
) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    # the same on panels about the direction of d1, where m vanishes
    if tau[1] <= 1e-9:  # the directions are within 1e-8 of that of d2: nothing to grade
        return about_d2(d2, tau[1], nodes)
    pole, length = d1 / np.linalg.norm(d1), float(np.linalg.norm(d2))
    centre, k = d2 / length, length / tau[1]
    edges = _graded_edges(tau[0], k, float(np.arccos(np.clip(pole @ centre, -1, 1))))
    panels = [_panel(a, b, nodes[0]) for a, b in pairwise(edges)]
    theta, polar = (np.concatenate(part) for part in zip(*panels, strict=True))
    directions, azimuth = _grid(pole, theta, nodes[1])
    across = np.linalg.norm(cross(directions, centre), axis=1)
    weights = np.repeat(polar * np.sin(theta) * azimuth, nodes[1])
    weights *= _density(k, directions @ centre, across)
    kept = weights > 1e-30  # of a sum of 1: all that is left out is below rounding
    return directions[kept], weights[kept]


def _graded_edges(tau1: float, k: float, angle: float) -> list[float]:
    # fourfold growth from both poles, and panels of three widths 1/k of the density
    # around its centre at the given angle, as far as the density reaches
    steps = [2.0 * max(tau1, 1e-6) * 4.0**i for i in range(12)]
    steps = [step for step in steps if step < 0.5 * np.pi]
    edges = {0.0, 0.5 * np.pi, np.pi, *steps, *(np.pi - step for step in steps)}
    reach = float(_reach(k))
    low, high = max(0.0, angle - reach), min(np.pi, angle + reach)
    edges |= {low, high, *(angle + 3.0 * i / k for i in range(-3, 4))}
    return sorted(edge for edge in edges if low <= edge <= high)


def _panel(
    low: float, high: Any, count: int
) -> tuple[Float[Array, "... count"], Float[Array, "... count"]]:
    x, w = _gauss("legendre", count)
    half = 0.5 * (np.asarray(high) - low)[..., None]
    return low + half * (x + 1.0), half * w


_GAUSS: Final = {
    "legendre": np.polynomial.legendre.leggauss,
    "hermite": np.polynomial.hermite_e.hermegauss,
}


@lru_cache(maxsize=64)
def _gauss(
    kind: str, count: int
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    # half of the time of an exact answer, if it is worked out anew for each panel
    x, w = _GAUSS[kind](count)
    return frozen(x), frozen(w)


def _grid(
    pole: Float[Array, "... 3"], theta: Float[Array, "... polar"], count: int
) -> tuple[Float[Array, "... n 3"], float]:
    # unit vectors at polar angles theta and even azimuths; the weight of an azimuth
    phi = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    ring = _normals(pole) @ np.stack([np.cos(phi), np.sin(phi)])
    along = np.cos(theta)[..., None, :] * pole[..., None]
    across = np.sin(theta)[..., None, :, None] * ring[..., None, :]
    directions = along[..., None] + across
    # component by component in memory, as what works on them wants it
    return directions.reshape(*pole.shape, -1).mT, 2.0 * np.pi / count


def _normals(u: Float[Array, "... 3"]) -> Float[Array, "... 3 2"]:
    # two unit vectors normal to a unit vector and to each other, as columns
    x, y, z = u[..., 0], u[..., 1], u[..., 2]
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    rows = [1.0 + sign * x * x * a, x * y * a, sign * x * y * a, sign + y * y * a]
    return np.stack([*rows, -sign * x, -y], axis=-1).reshape(*x.shape, 3, 2)


def _density(
    k: Any, cosine: Float[Array, "... n"], sine: Float[Array, "... n"]
) -> Float[Array, "... n"]:
    # (U1): e^{-(k^2 - t^2)/2} and its product with e^{-t^2/2}, without cancellation
    t = k * cosine
    tilted = np.exp(-0.5 * (k * sine) ** 2)
    bulk = (1.0 + t * t) * np.sqrt(2.0 * np.pi) * scipy.special.ndtr(t)
    density = tilted * bulk + t * np.exp(-0.5 * k * k)
    return density * (2.0 * np.pi) ** -1.5


# Agreement of successive rules. The error falls geometrically with the nodes, so the
# finer one is then good to 1e-12 or better.
_TOLERANCE: Final = 1e-9
# Below this rho the closed forms of A and B cancel (eps / rho^3); the series below
# leave out terms of rho^4 / 140, so both sides hold 1e-10 here.
_SERIES_RHO: Final = 1e-2


def exact_moments(
    geometry: TwoVectorGeometry,
    noise: Noise,
) -> tuple[Float[Array, "... 4"], Float[Array, "... 4 4"]]:
    """Exact bias and covariance of q - qhat in the turned frame, of each sample.

    Raises
    ------
    RefusedError
        If the finest two rules do not agree within 1e-9; of a batch the message names
        the sample.
    """
    batch = geometry.norm.shape
    bias, covariance = np.zeros((*batch, 4)), np.zeros((*batch, 4, 4))
    settled = np.zeros(batch, dtype=bool)
    alike = np.broadcast_to(isotropic(noise), batch)
    tau = _halves(noise) if alike.any() else np.zeros((2, *batch))
    bias[alike], covariance[alike], settled[alike] = _moments_about_d2(
        geometry[alike], tau[:, alike]
    )
    for sample in map(tuple, np.argwhere(~settled)):
        own = geometry[sample]
        with naming(sample):
            if alike[sample]:
                found = _moments_about_d1(own, *map(float, tau[:, *sample]))
            else:
                found = exact_moments_any(own, noise[sample])
        bias[sample], covariance[sample] = found
    return bias, covariance


def _moments_about_d2(
    geometry: TwoVectorGeometry, tau: Float[Array, "2 n"]
) -> tuple[Float[Array, "n 4"], Float[Array, "n 4 4"], Mask]:
    # under isotropic noise, and where two rules agree
    n = len(geometry.q)
    bias, covariance = np.full((n, 4), np.inf), np.zeros((n, 4, 4))
    gap = np.full(n, np.inf)
    q, maps, (tau1, tau2) = geometry.q, _maps(geometry), tau
    for count in _ABOUT_D2:
        left = np.flatnonzero(gap > _TOLERANCE)
        rows = max(1, _AT_ONCE // ((_MORE + count) * count))
        for start in range(0, len(left), rows):
            some = left[start : start + rows]
            u, weights = about_d2(geometry.d2[some], tau2[some], (_MORE + count, count))
            total = weights.sum(axis=-1)
            weights /= total[:, None]
            found = _moments_isotropic(q[some], maps[some], tau1[some], u, weights)
            gap[some] = _gap((bias[some], covariance[some]), found, total)
            bias[some], covariance[some] = found
    return bias, covariance, gap <= _TOLERANCE


def _moments_about_d1(
    geometry: TwoVectorGeometry, tau1: float, tau2: float
) -> MeanAndCovariance:
    # of one geometry under isotropic noise, after the last rule about d2
    d1 = np.linalg.norm(geometry.d1)
    across = np.linalg.norm(cross(geometry.d1, geometry.d2)) / d1  # |d2| sin angle
    scale = max(1.0, float(np.linalg.norm(geometry.s1) / d1))
    if tau2 > 0.0:
        scale = max(scale, 0.4 * float(across) / tau2)

    def rules() -> Iterator[Rule]:
        yield about_d2(geometry.d2, tau2, (_MORE + _ABOUT_D2[-1], _ABOUT_D2[-1]))
        for nodes in _refined(_ABOUT_D1, scale, *_AZIMUTHS):
            yield _about_d1(geometry.d1, geometry.d2, (tau1, tau2), nodes)

    given = partial(_moments_isotropic, geometry.q, _maps(geometry), tau1)
    return converged(rules(), given, float(geometry.norm), (tau1, tau2))


def _refined(
    rules: tuple[tuple[int, float], ...], scale: float, least: int, most: int
) -> Iterator[tuple[int, int]]:
    # polar and azimuth nodes of each, both of which grow: rules with as many nodes of
    # one kind agree in what these leave out
    for polar, factor in rules:
        within = np.clip(scale, least / rules[0][1], most / rules[-1][1])
        yield polar, int(factor * within)


def converged(
    rules: Iterable[Rule],
    functional: Callable[[Array, Array], MeanAndCovariance],
    norm: float,
    spread: tuple[float, float],
) -> MeanAndCovariance:
    """Moments by rules that are refined until two of them agree.

    Raises
    ------
    RefusedError
        If the finest two rules do not agree within 1e-9.
    """
    previous: MeanAndCovariance | None = None
    gap = np.inf
    for directions, weights in rules:
        total = weights.sum()
        found = functional(directions, weights / total)
        if previous is not None:
            gap = float(_gap(previous, found, total))
            if gap <= _TOLERANCE:
                return found
        previous = found
    msg = (
        f"the quadrature still changes its result by {gap:.1e} relative with its last "
        f"rule, needed {_TOLERANCE:g}: |qbar| is {norm:.2e} and the noise of the "
        f"halved pairs {spread[0]:.2e} and {spread[1]:.2e}; use another frame"
    )
    raise RefusedError(msg)


def _gap(previous: MeanAndCovariance, found: MeanAndCovariance, total: Any) -> Any:
    # Greatest relative change of bias and covariance, and what the density is off 1.
    # q - w is rounded to 1e-16, so at noise below 1e-7 a mean cannot agree better than
    # 1e-15, nor a covariance better than 1e-15 standard deviations.
    change = previous[0] - found[0], previous[1] - found[1]
    (mean, moved), (bias, covariance) = _sizes(change), _sizes(found)
    relative = moved / (covariance + 1e-6 * np.sqrt(covariance) + 1e-21)
    return np.maximum(np.maximum(mean / (bias + 1e-6), relative), np.abs(total - 1.0))


def _sizes(moments: MeanAndCovariance) -> tuple[Scalars, Scalars]:
    # norms of bias and covariance
    bias, covariance = moments
    flat = covariance.reshape(*bias.shape[:-1], 16)
    return np.sqrt(np.vecdot(bias, bias)), np.sqrt(np.vecdot(flat, flat))


def isotropic(
    noise: Noise,
) -> Mask:
    """True if every covariance is a multiple of the identity, up to rounding.

    Never of stacked vectors, which may be correlated with each other.
    """
    if noise.shape[-1] == 12:
        return np.zeros(noise.shape[:-2], dtype=bool)
    multiples = noise[..., :1, :1] * np.eye(3)
    off = np.abs(noise - multiples) > 1e-12 * np.abs(multiples)
    return np.asarray(~off.any(axis=(-3, -2, -1)))


def _halves(noise: Float[Array, "... 4 3 3"]) -> Float[Array, "2 ..."]:
    # Standard deviations tau1 of d1 (and s1) and tau2 of d2, per axis
    variances = np.moveaxis(noise[..., 0, 0], -1, 0)
    tau = 0.5 * np.sqrt(variances[:2] + variances[2:])
    # below this the square of the inverse overflows, and moments of tau^2 underflow
    return np.where(tau > 1e-140, tau, 0.0)


def _maps(geometry: TwoVectorGeometry) -> Float[Array, "... 4 3"]:
    # of a direction u to m
    rows = cross_matrix(geometry.d1), geometry.s1[..., None, :]
    return np.concatenate(rows, axis=-2)


def _moments_isotropic(
    q: Float[Array, "... 4"],
    maps: Float[Array, "... 4 3"],
    tau1: Any,
    directions: Float[Array, "... n 3"],
    weights: Float[Array, "... n"],
) -> tuple[Float[Array, "... 4"], Float[Array, "... 4 4"]]:
    # Bias and covariance from eq. (E1) averaged over the directions
    u = directions.mT
    m = maps @ u
    length = np.sqrt(np.einsum("...in,...in->...n", m, m))
    w = m / np.where(length > 0.0, length, 1.0)[..., None, :]
    tau1 = np.asarray(tau1)[..., None]
    rho = np.full_like(length, np.inf)
    np.divide(length, tau1, out=rho, where=tau1 > 0.0)
    a, half = weights * one_minus_a(rho), 0.5 * weights * one_minus_b(rho)
    gap = q[..., None] - w
    mean_w = np.matvec(w, a)
    bias = np.matvec(gap, weights) + mean_w
    # E[e e'|u] = gap gap' + a (q w' + w q') - b w w' + b/2 (R - w w')
    second = (weights[..., None, :] * gap) @ gap.mT
    second -= 3.0 * (half[..., None, :] * w) @ w.mT
    shortened = outer(q, mean_w)
    second += shortened + shortened.mT
    second += half.sum(axis=-1)[..., None, None] * np.eye(4)
    second[..., :3, :3] -= (half[..., None, :] * u) @ directions
    return bias, second - outer(bias, bias)


def one_minus_a(rho: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 - A of eq. (E1): how much a projected Gaussian's mean is shortened."""
    safe = np.maximum(rho, _SERIES_RHO)
    squared = safe * safe
    beyond = scipy.special.erfc(safe / np.sqrt(2.0))
    closed = (
        beyond
        + (1.0 - beyond) / squared
        # no underflow, which takes eight times as long
        - np.sqrt(2.0 / np.pi) * np.exp(-np.minimum(0.5 * squared, 700.0)) / safe
    )
    small = np.minimum(rho, _SERIES_RHO)
    series = 1.0 - np.sqrt(2.0 / np.pi) * (2.0 * small / 3.0 - small**3 / 15.0)
    return np.where(rho < _SERIES_RHO, series, closed)


def one_minus_b(rho: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 - B of eq. (E1): the share of the second moment across the mean."""
    safe = np.maximum(rho, _SERIES_RHO)
    dawson = scipy.special.dawsn(safe / np.sqrt(2.0))
    closed = 2.0 / safe**2 - 2.0 * np.sqrt(2.0) * dawson / safe / safe**2
    series = 2.0 / 3.0 - 2.0 * np.minimum(rho, _SERIES_RHO) ** 2 / 15.0
    return np.where(rho < _SERIES_RHO, series, closed)


# Of log(s |qbar|), |qbar| its RMS length: to the left an integrand falls as s^2 at
# least, so e^-32 of it is left out; to the right it falls as Z and at least as 1/s.
_LOG_S: Final = (-16.0, 37.0)
_NEGLIGIBLE: Final = -37.0
"""Of log Z; e^-37 is 1e-16."""
# The integrands are analytic for |Im log s| < pi/4: the trapezoidal rule is off by
# e^(-pi^2 / 2 / step) = 1e-18 times what they grow by there, 1e-12 in the tests.
_STEP: Final = 0.12
_SOME: Final = 256
"""Directions; their integrands take 3 MB, what a cache holds."""
_NODES: Final = (12, 16, 22, 32)
"""Azimuths about d2, and half of the polar angles; half as much again each time."""
# Where those disagree, the panels about d1 that `_ABOUT_D1` describes, in the whitened
# space. Of 6 geometries with |qbar| from 0.06 to 0.25 at noise of 0.1 and 0.2 of any
# covariance the second was right to 1e-9, the third to 3e-11, the last to 1e-13.
_WHITENED: Final = ((10, 16.0), (12, 24.0), (16, 40.0), (24, 60.0))
_LEAST_WEIGHT: Final = 1e-15
"""Over the greatest; 23 000 nodes below leave out 2e-11 at the most, 1e-14 in fact."""
_WHITENED_AZIMUTHS: Final = (32, 512)
"""As `_AZIMUTHS`; the most take some seconds."""
_FLAT: Final = 1e-6
"""Least over greatest variance of d2 below which whitening it would lose digits."""
_HERMITE: Final = (8, 12, 18, 27)
"""Nodes per axis of the noise of d2 where that is flat."""


def exact_moments_any(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"] | Float[Array, "12 12"]
) -> MeanAndCovariance:
    """Exact bias and covariance of q - qhat in the turned frame, any covariances.

    Raises
    ------
    RefusedError
        If the finest two rules do not agree within 1e-9.
    """
    C1, C2, C12 = half_noise(geometry, noise)
    slope = None if C12 is None else C12 @ np.linalg.pinv(C2, hermitian=True)
    if slope is not None:
        C1 = C1 - slope @ C2 @ slope.T
    rules = _rules_any(geometry, C1, C2, slope is None)
    spread = float(np.sqrt(np.trace(C1) / 6.0)), float(np.sqrt(np.trace(C2) / 3.0))
    given = partial(_moments_any, geometry, C1, slope)
    return converged(rules, given, float(geometry.norm), spread)


def _rules_any(
    geometry: TwoVectorGeometry, C1: Array, C2: Array, alone: bool
) -> Iterator[Rule]:
    # d2 + R x for standard normal x, R R' = C2; directions alone where they suffice
    d2 = geometry.d2
    variances, axes = np.linalg.eigh(C2)
    if not variances[-1] > 0.0:
        yield from [(d2[None], np.ones(1))] * 2
    elif alone and variances[0] > _FLAT * variances[-1]:
        # d2 = R v, and v is isotropic about R^-1 d2
        root = covariance_roots(C2[None])[0]
        centre = np.linalg.solve(root, d2)
        for whitened, weights in _whitened_rules(geometry, C1, centre, root):
            kept = weights > _LEAST_WEIGHT * weights.max()
            yield _normalized(whitened[kept] @ root.T), weights[kept]
    else:
        for count in _HERMITE:
            yield _hermite_rule(d2, np.maximum(variances, 0.0), axes, count)


def _whitened_rules(
    geometry: TwoVectorGeometry, C1: Array, centre: Array, root: Array
) -> Iterator[Rule]:
    # about the directions of d2 and of d1 as R^-1 turns them
    for count in _NODES:
        yield about_d2(centre, 1.0, (_MORE + count, count))
    d1 = np.linalg.solve(root, geometry.d1)
    length, stretch = np.linalg.norm(d1), np.linalg.svd(root)[1]
    # an angle tau1 about d1 is at least so much there
    tau1 = np.sqrt(np.trace(C1) / 6.0) * np.linalg.norm(root @ d1) / length / stretch[0]
    scale = max(
        1.0,
        float(np.linalg.norm(geometry.s1) / np.linalg.norm(geometry.d1)),
        0.4 * float(np.linalg.norm(cross(d1, centre)) / length),
    ) * float(np.sqrt(stretch[0] / stretch[-1]))
    for nodes in _refined(_WHITENED, scale, *_WHITENED_AZIMUTHS):
        yield _about_d1(d1, centre, (float(tau1), 1.0), nodes)


def _hermite_rule(d2: Array, variances: Array, axes: Array, count: int) -> Rule:
    x, w = _gauss("hermite", count)
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = (w[:, None, None] * w[:, None] * w).ravel() / w.sum() ** 3
    kept = weights > 1e-22
    return d2 + (grid[kept] * np.sqrt(variances)) @ axes.T, weights[kept]


def _normalized(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def _moments_any(
    geometry: TwoVectorGeometry,
    C1: Array,
    slope: Array | None,
    points: Array,
    weights: Array,
) -> MeanAndCovariance:
    # bias and covariance from (E4), averaged over d2 or its directions
    maps, basis = direction_maps(_normalized(points))
    m = maps @ np.concatenate([geometry.d1, geometry.s1])
    if slope is not None:
        m = m + np.matvec(maps, (points - geometry.d2) @ slope.T)
    variances, axes = np.linalg.eigh(maps @ C1 @ maps.mT)
    variances = np.maximum(variances, 0.0)
    means = (m[:, None, :] @ axes)[:, 0]
    delta, D = (np.empty((len(m), *shape)) for shape in ((3,), (3, 3)))
    for start in range(0, len(m), _SOME):
        some = slice(start, start + _SOME)
        delta[some], D[some] = _shortening(means[some], variances[some])
    q, axes = geometry.q, basis @ axes
    gap = q - (basis @ _normalized(m)[..., None])[..., 0]
    mean_delta = np.einsum("n,nij,nj->i", weights, axes, delta)
    mean_D = np.tensordot(weights, axes @ D @ axes.mT, 1)
    bias = weights @ gap + mean_delta
    half = np.outer(q, mean_delta)
    second = (weights[:, None] * gap).T @ gap + half + half.T - mean_D
    return bias, second - np.outer(bias, bias)


def direction_maps(u: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """Maps of (d1, s1) to the components of [d1 x u; s1'u], and a basis of these.

    It lies in the span of (p, 0), (u x p, 0) and (0, 1), p normal to u.
    """
    p, across = np.moveaxis(_normals(u), -1, 0)
    maps, basis = np.zeros((len(u), 3, 6)), np.zeros((len(u), 4, 3))
    maps[:, 0, :3], maps[:, 1, :3], maps[:, 2, 3:] = across, -p, u
    basis[:, :3, 0], basis[:, :3, 1], basis[:, 3, 2] = p, across, 1.0
    return maps, basis


def _shortening(
    m: Float[Array, "n 3"], variances: Float[Array, "n 3"]
) -> tuple[Array, Array]:
    # delta and D of (E4) in the axes of S: (E2) without noise less (E2) with it
    size = np.sqrt(np.sum(m * m + variances, axis=1, keepdims=True))
    size = np.where(size > 0.0, size, 1.0)
    m, variances = (m / size)[..., None], (variances / size**2)[..., None]
    s = _scales(m, variances)
    s2 = s * s
    double = 2.0 * s2 * variances
    f = 1.0 / (1.0 + double)
    g = double * f  # 1 - f
    clean, noisy = -s2 * np.sum(m * m, axis=1), _log_Z(s2, m, variances)
    with np.errstate(under="ignore"):
        Z0, Z = np.exp(clean), np.exp(noisy)
        # Z - Z0, by the logarithm of their ratio where they are close
        ratio = np.sum(s2 * m * m * g - 0.5 * np.log1p(double), axis=1)
        close = np.abs(ratio) < 0.5
        growth = np.where(close, Z0 * np.expm1(np.where(close, ratio, 0.0)), Z - Z0)
    first, second = 2.0 / np.sqrt(np.pi) * _STEP * s, 2.0 * _STEP * s2
    means = m[..., 0]
    delta = means * np.sum(
        (Z0 * first)[:, None] * g - (growth * first)[:, None] * f, axis=-1
    )
    Z0, growth = (Z0 * second)[:, None], (growth * second)[:, None]
    # 1 - f_k f_l = g_k + g_l - g_k g_l
    one = np.sum(Z0 * g, axis=-1)
    both = (Z0 * g) @ g.mT + (growth * f) @ f.mT
    D = outer(means, means) * (one[:, :, None] + one[:, None] - both)
    every = np.arange(3)
    D[:, every, every] -= variances[..., 0] * np.sum((Z0 + growth) * f, axis=-1)
    return delta, D


def _scales(m: Array, variances: Array) -> Array:
    # nodes s, as far as Z counts for any of the directions
    logs = np.arange(*_LOG_S, _STEP)
    counts = _log_Z(np.exp(2.0 * logs[::10]), m, variances).max(axis=0) > _NEGLIGIBLE
    last = 10 * int(np.flatnonzero(counts)[-1]) + 11
    return np.exp(logs[:last])


def _log_Z(s2: Array, m: Array, variances: Array) -> Array:
    # logarithm of Z of (E3)
    double = 2.0 * s2 * variances
    return -np.sum(s2 * m * m / (1.0 + double) + 0.5 * np.log1p(double), axis=1)
