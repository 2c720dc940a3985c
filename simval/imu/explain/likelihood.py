r"""How well an explanation fits: one marginal likelihood for parameters of any rank.

The noise of a rest that is felt is that along the vector. With b the bias and A the
upper triangle of an ellipsoid, rest i is off along the ray from b by

.. math:: e_i = \frac{1}{s_i}\Bigl(|r_i| - \frac{|r_i|}{|A x_i|} - \ell_i\Bigr), \quad
   r_i = \frac{x_i}{1 + c_i + g_i}, \quad
   x_i = (1 + c_i) \circ (y_i - b) + g_i \circ y_i - d_i,  \tag{J1}

y the readings with the change of the explanation undone, d, c, g and :math:`\ell` what
its columns do to bias, scale, gain and length, s the noise of the mean along the
vector, as measured, times what undoing multiplied it by. The readings of each
explanation are taken in units of their own root mean square, and the noise with them,
or shrinking a part of a log to a point would fit best. The noise is a common factor
times s; that factor, near 1 by a belief of :math:`\nu` degrees of freedom, integrates
to

.. math:: \ln m = -a \ln\Bigl(1 + \frac{\sum e_i^2}{\nu}\Bigr)
   - \tfrac12 |\theta - \theta_0|_P^2 - \tfrac12 \ln\frac{\det(w J^TJ + P)}{\det P}
   + \tfrac k2 \ln a + \ln\Gamma(a - \tfrac k2), \quad a = \tfrac{\nu + n}{2}, \quad
   w = \frac{2a}{\nu + \sum e_i^2},  \tag{J2}

up to a constant common to all, by Laplace's method in the parameters :math:`\theta`,
with Student's law for the k of them that the readings fix: exact where these are
linear. The weak priors P (axes within 30 % of a common size that is free, 10 degrees, a
bias of 1 g) are rows like any others: a fit exists for one rest as for a hundred, and
the determinant counts what is free. The prior of the columns is spread over `DECADES`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.imu.explain.catalogue import plain, radius_of
from simval.imu.explain.explanation import (
    BIAS,
    GAIN,
    LENGTH,
    SCALE,
    Explanation,
    RestMeans,
)
from simval.shapes import Float, Int

NU = 2.0  # of the belief in the measured noise: rests scatter up to ten times it
DECADES = (1.0, 0.1, 0.01)  # of the prior sizes: what is seen of an effect has no size
AXES_SD, COMMON_SD, SHEAR_SD, BIAS_SD = 0.3, 3.0, 0.17, 1.0
LEAST = 1e-6  # of gravity: noise of a mean below it is a converter's silence
_STEPS = 40  # of Levenberg-Marquardt
# of one alone: by small noise, poses in half of the sphere want a hundred from a sphere
_PATIENT = 400
_SETTLED = 1e-4  # of a log likelihood
_TRIED, _HOPELESS = 3, 20.0  # steps, after which one so far behind in it is given up
_SEVERAL = 3  # rests that may be off at once
_EXTENDED = 40  # sets of rests that are tried with one more
_SETS = 5  # of each size that are fitted
_AT_ONCE = 512  # explanations: some ten megabytes
_POINT = 1e-3  # of a scale: a part that has shrunk to it is far off all the same
_SPHERE = 0.3  # of the widest spread of readings, the least of those all over a sphere
_SEEN = 10.0  # times the noise
_FAR = 2.0  # of a sphere's radius
_NINE = 9
_UPPER = np.triu_indices(3)
_DIAGONAL = [0, 3, 5]


class Fit(NamedTuple):
    """An explanation after it has been fitted.

    Attributes
    ----------
    log : float
        Marginal likelihood (J2), natural logarithm.
    squares : (n,) array
        Squared residuals (J1) by the measured noise.
    known : float
        Parameters that the readings fix, rather than their priors.
    theta : (9 + m,) array
        Ellipsoid in units of the readings' root mean square, and columns.
    value : float
        Less by the fit: (J2) without its determinant, negative.
    """

    log: float
    squares: Array
    known: float
    theta: Array
    value: float

    @property
    def free(self) -> float:
        """Degrees of freedom of the residuals."""
        return len(self.squares) - self.known

    @property
    def misfit(self) -> float:
        """Scatter of the residuals in multiples of the measured noise."""
        return float(np.sqrt(self.squares.sum() / max(self.free, 0.05)))

    def chance(self, freedom: Float[Array, " n"]) -> float:
        r"""Chance of residuals as large, given the measured noise.

        A residual over a noise of d degrees of freedom is Student's; Wallace's
        transformation, :math:`d \ln(1 + e^2/d)` times a constant, makes it normal
        within 0.01 of a deviation from d = 5 on.
        """
        if self.free < 0.05:
            return 1.0
        d = np.minimum(freedom, 1e9)
        normal = ((8.0 * d + 1.0) / (8.0 * d + 3.0)) ** 2 * d
        total = float(np.sum(normal * np.log1p(self.squares / d)))
        return float(scipy.special.chdtrc(self.free, total))


def along(rests: RestMeans, fit: Fit | None = None) -> Float[Array, " n"]:
    """Noise of each mean along the direction that its length depends on.

    It is that along the slope of (J1): across the ellipsoid of a fit of nothing but it,
    without one across the nearest sphere. Of a poor part these are 0.1 rad apart, where
    a hand's tremor, which the length does not feel, is ten times the noise.
    """
    radius = radius_of(rests.readings - rests.zero)
    z = (rests.readings - rests.zero) / radius
    if fit is None:
        slope = z - _centre(z)
        far = np.linalg.norm(slope, axis=1, keepdims=True)
        slope = slope / np.maximum(far, LEAST)
    else:
        A, x = np.zeros((3, 3)), z - fit.theta[6:_NINE]
        A[_UPPER] = fit.theta[:6]
        v, far = x @ A.T, np.maximum(np.linalg.norm(x, axis=1, keepdims=True), LEAST)
        length = np.maximum(np.linalg.norm(v, axis=1, keepdims=True), LEAST)
        slope = x / far * (1.0 - 1.0 / length) + far * (v @ A) / length**3
    variance = np.einsum("na,nab,nb->n", slope, rests.covariance, slope)
    return np.sqrt(np.maximum(variance, (LEAST * radius) ** 2))


def _centre(z: Float[Array, "n 3"]) -> Float[Array, "3"]:
    # of the sphere nearest to some directions, 0 where they do not fix it
    rows = np.column_stack([2.0 * z, np.ones(len(z))])
    weak = np.diag([1e-2, 1e-2, 1e-2, 0.0])
    target = np.concatenate([np.sum(z**2, axis=1), np.zeros(4)])
    centre = np.linalg.lstsq(np.concatenate([rows, weak]), target)[0][:3]
    return centre if np.linalg.norm(centre) < 2.0 else np.zeros(3)


def zero_of(rests: RestMeans, y: Float[Array, "n 3"]) -> Float[Array, "3"]:
    """Zero of the readings: the centre of a sphere if they lie on one, else as given.

    Such are counts of a converter whose zero is not known.
    """
    mean = y.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((y - mean) ** 2, axis=1))))
    axes = np.linalg.eigvalsh(np.cov(y.T, bias=True))
    least, most = np.sqrt(np.maximum(axes[[0, 2]], 0.0))
    noise = np.sqrt(np.linalg.trace(rests.covariance).max())
    all_over = least > max(_SPHERE * most, _SEEN * noise)
    if not all_over or np.linalg.norm(mean - rests.zero) < _FAR * spread:
        return rests.zero
    centre = mean + spread * _centre((y - mean) / spread)
    common = np.full(3, centre.mean())  # as of one converter
    return common if np.abs(centre - common).max() < spread else centre


def _sphere(z: Float[Array, "n 3"]) -> Float[Array, "9"]:
    # the nearest one, as an ellipsoid
    centre = _centre(z)
    theta = np.zeros(_NINE)
    theta[_DIAGONAL] = 1.0 / max(radius_of(z - centre), LEAST)
    theta[6:] = centre
    return theta


def fits(
    tried: Sequence[Explanation],
    rests: RestMeans,
    noise: Float[Array, " n"],
    start: Fit | None = None,
) -> list[Fit]:
    """Fit several explanations, those with equally many columns at once.

    From a `start`, whose columns stand before an explanation's own, where these leave
    the readings as they are; those that stay far worse than it are not fitted to the
    end.
    """
    found: dict[int, Fit] = {}
    order = sorted(range(len(tried)), key=lambda k: len(tried[k].sd))
    while order:
        width = len(tried[order[0]].sd)
        batch = [k for k in order[:_AT_ONCE] if len(tried[k].sd) == width]
        order = order[len(batch) :]
        some = _fits([tried[k] for k in batch], rests, noise, start)
        found.update(zip(batch, some, strict=True))
    return [found[k] for k in range(len(tried))]


def _fits(
    tried: Sequence[Explanation], rests: RestMeans, noise: Array, start: Fit | None
) -> list[Fit]:
    h, m = len(tried), len(tried[0].sd)
    problem = _problem(tried, rests, noise)
    theta = np.concatenate([problem.start, np.zeros((h, m))], axis=1)
    if start is not None:
        same = [np.array_equal(e.readings, rests.readings) for e in tried]
        theta[same, : len(start.theta)] = start.theta
    sd, each = np.array([e.sd for e in tried]), []
    cost = problem.cost + np.log([e.noise for e in tried]).sum(axis=1)
    for decade in DECADES if m else DECADES[:1]:
        bar = np.inf if start is None else start.value
        found = _settled(problem, _prior(h, decade * sd), theta, bar)
        each.append((found[0] - cost, *found[1:]))
        theta = found[3]
    logs = np.array([log for log, *_ in each])
    total = scipy.special.logsumexp(logs, axis=0) - np.log(len(each))
    best = logs.argmax(axis=0)
    return [
        Fit(float(total[i]), *(part[i] for part in each[k][1:]))
        for i, k in enumerate(best)
    ]


def farthest(
    rests: RestMeans, noise: Float[Array, " n"], fit: Fit
) -> list[tuple[int, ...]]:
    """Sets of up to three rests whose removal improves a plain fit most.

    By the algebra of its linear form: freeing the set S takes
    :math:`e_S^T (I - H)_{SS}^{-1} e_S` off them.
    """
    e, J = _rows(_problem([plain(rests)], rests, noise), fit.theta[None])
    e, J, n = e[0], J[0], len(noise)
    w = (NU + n) / (NU + e @ e)
    P = _prior(1, np.empty((1, 0)))[0] / w
    room = np.eye(n) - J @ np.linalg.solve(J.T @ J + P, J.T)
    room[np.diag_indices(n)] += LEAST  # where a rest fixes a parameter alone
    found: list[tuple[int, ...]] = []
    best: list[tuple[int, ...]] = [()]
    for size in range(1, min(_SEVERAL, int(fit.free) - 1) + 1):
        sets = sorted({tuple(sorted({*some, k})) for some in best for k in range(n)})
        rows = np.array([some for some in sets if len(some) == size])
        own = room[rows[:, :, None], rows[:, None, :]]
        off = e[rows][..., None]
        lower = (off.mT @ np.linalg.solve(own, off))[:, 0, 0]
        order = np.argsort(-lower)[: _EXTENDED if size < _SEVERAL else _SETS]
        best = [tuple(map(int, rows[k])) for k in order]
        found += best[:_SETS]
    return found


class _Stack(NamedTuple):
    # h explanations side by side, in units of their own radius
    z: Float[Array, "h n 3"]
    s: Float[Array, "h n"]
    columns: Float[Array, "h n 10 m"]
    start: Float[Array, "h 9"]  # nearest sphere
    cost: Float[Array, " h"]  # of a centre anywhere so far away

    def at(self, some: Int[NDArray[np.intp], " k"]) -> "_Stack":
        return _Stack(*(part[some] for part in self))


def _problem(tried: Sequence[Explanation], rests: RestMeans, noise: Array) -> _Stack:
    # readings that are the same array have the same zero and start at the same sphere
    own = {id(e.readings): _about_zero(rests, e.readings) for e in tried}
    each = [own[id(e.readings)] for e in tried]
    radius = np.array([one.radius for one in each])
    unit = np.array([e.unit * e.noise for e in tried])
    columns = np.array([e.columns for e in tried])
    columns[:, :, BIAS:SCALE] /= radius[:, None, None, None]
    return _Stack(
        z=np.array([one.z for one in each]), s=noise * unit / radius[:, None],
        columns=columns, start=np.array([one.sphere for one in each]),
        cost=np.array([one.cost for one in each]),
    )  # fmt: skip


class _AboutZero(NamedTuple):
    # readings about their zero
    z: Float[Array, "n 3"]  # in units of the radius
    radius: float
    sphere: Float[Array, "9"]  # nearest
    cost: float  # of a zero that may be anywhere as far away


def _about_zero(rests: RestMeans, y: Float[Array, "n 3"]) -> _AboutZero:
    zero = zero_of(rests, y)
    radius = radius_of(y - zero)
    z, far = (y - zero) / radius, float(np.linalg.norm(zero - rests.zero))
    return _AboutZero(
        z, radius, _sphere(z), 3.0 * float(np.log(max(far / radius, 1.0)))
    )


def _prior(h: int, sd: Float[Array, "h m"]) -> Float[Array, "h p p"]:
    p = _NINE + sd.shape[1]
    prior = np.zeros((p, p))
    axes = AXES_SD**2 * np.eye(3) + COMMON_SD**2
    prior[np.ix_(_DIAGONAL, _DIAGONAL)] = np.linalg.inv(axes)
    prior[[1, 2, 4], [1, 2, 4]] = SHEAR_SD**-2
    prior[range(6, 9), range(6, 9)] = BIAS_SD**-2
    every = np.tile(prior, (h, 1, 1))
    every[:, range(_NINE, p), range(_NINE, p)] = sd**-2.0
    return every


def _rows(problem: _Stack, theta: Float[Array, "h p"]) -> tuple[Array, Array]:
    # (J1) and its derivative
    z, s, columns = problem[:3]
    A = np.zeros((len(z), 3, 3))
    A[:, *_UPPER] = theta[:, :6]
    effect = (columns @ theta[:, None, _NINE:, None])[..., 0]
    centred = z - theta[:, None, 6:_NINE]
    scale, gain = effect[..., SCALE:GAIN], effect[..., GAIN:LENGTH]
    x = (1.0 + scale) * centred + gain * z - effect[..., BIAS:SCALE]
    stretch = 1.0 + scale + gain
    stretch = np.where(np.abs(stretch) < _POINT, _POINT, stretch)
    ray = x / stretch  # from the centre to the reading, in the unit of the readings
    v = x @ A.mT
    length = np.maximum(np.sqrt(np.vecdot(v, v)), 1e-9)
    far = np.maximum(np.sqrt(np.vecdot(ray, ray)), 1e-9)
    e = (far - far / length - effect[..., LENGTH]) / s
    unit = v / length[..., None]
    slope = (far / length**2)[..., None]
    by_ray = ((1.0 - 1.0 / length) / far)[..., None] * ray / stretch
    by_x = slope * (unit @ A) + by_ray
    by_A = slope * unit[..., _UPPER[0]] * x[..., _UPPER[1]]
    each = [-by_x, by_x * centred - by_ray * ray, by_x * z - by_ray * ray]
    by_effect = np.concatenate([*each, np.full_like(slope, -1.0)], axis=-1)
    by_columns = (by_effect[:, :, None, :] @ columns)[:, :, 0]
    J = np.concatenate([by_A, -by_x * (1.0 + scale), by_columns], axis=-1)
    return e, J / s[..., None]


def _settled(
    problem: _Stack, prior: Array, start: Array, bar: float
) -> tuple[Array, Array, Array, Array, Array]:
    # least of -(J2) without its determinant, by Levenberg-Marquardt; then (J2)
    n, (h, p) = problem.z.shape[1], start.shape
    centre = np.concatenate([np.eye(3)[_UPPER], np.zeros(p - 6)])
    eye = np.eye(p)

    def value_of(e: Array, theta: Array, P: Array) -> Array:
        away = theta - centre
        rest = 0.5 * (NU + n) * np.log1p(np.vecdot(e, e) / NU)
        return rest + 0.5 * np.vecdot(away, (P @ away[..., None])[..., 0])

    theta, damping, alive = start.copy(), np.full(h, 1e-3), np.arange(h)
    e, J = _rows(problem, theta)
    value = value_of(e, theta, prior)
    for step in range(_STEPS if h > 1 else _PATIENT):
        ea, Ja, P, at = e[alive], J[alive], prior[alive], theta[alive]
        w = ((NU + n) / (NU + np.vecdot(ea, ea)))[:, None]
        H = w[..., None] * (Ja.mT @ Ja) + P
        gradient = w[..., None] * (Ja.mT @ ea[..., None])
        gradient += P @ (at - centre)[..., None]
        damped = np.linalg.diagonal(H) * damping[alive, None]
        new = at - np.linalg.solve(H + damped[..., None] * eye, gradient)[..., 0]
        e_new, J_new = _rows(problem.at(alive), new)
        gain = value[alive] - value_of(e_new, new, P)
        better = gain > 0.0
        won = alive[better]
        theta[won], e[won], J[won] = new[better], e_new[better], J_new[better]
        value[won] -= gain[better]
        damping[alive] *= np.where(better, 0.1, 10.0)
        alive = alive[(gain > _SETTLED) | (~better & (damping[alive] < 1e6))]
        if step >= _TRIED:
            alive = alive[value[alive] < min(bar, value.min()) + _HOPELESS]
        if not len(alive):
            break
    squares = e**2
    JJ = J.mT @ J
    w = (NU + n) / (NU + squares.sum(axis=1))
    H = w[:, None, None] * JJ + prior
    known = np.linalg.trace(np.linalg.solve(JJ + prior, JJ))
    log = -value - 0.5 * (np.linalg.slogdet(H)[1] - np.linalg.slogdet(prior)[1])
    a = 0.5 * (NU + n)
    log += 0.5 * known * np.log(a) + scipy.special.gammaln(a - 0.5 * known)
    return log, squares, known, theta, value
