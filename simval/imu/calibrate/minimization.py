r"""Least-cost ellipsoid of scaled readings.

**The squared residual's ellipsoid by its centre alone: three unknowns for nine.**

An ellipsoid :math:`c = m^T v` of eq. (Q1) is least at its centre, where it is -1. Of
all quadrics with :math:`m(b)^T v = -1` at a point b, that of the least cost
:math:`v^T G v` is

.. math:: v = -\Gamma m(b) / \psi(b), \quad \psi(b) = m(b)^T \Gamma\, m(b), \quad
   \Gamma = s\,G^{-1}  \tag{H1}

and its cost :math:`s/\psi`. An ellipsoid has :math:`m(y)^T v \ge -1` everywhere, so the
least cost over b and v together, the squared residual's minimum, is a (local) maximum
of :math:`\psi`, the leverage that a reading at b would have, and there b is the centre.
With s the sum of squares that the closed-form start p of eq. (E1) leaves, and
:math:`G_9` the first nine rows and columns of G,

.. math:: \psi(b) = (1 - p^T m_9)^2 + s\, m_9^T G_9^{-1} m_9  \tag{H2}

keeps all digits where s is nothing but rounding: noise-free readings. One factorisation
of :math:`G_9` serves every step, and a step costs the same in each form of parameters.

Gauss-Newton in the nine coefficients of the quadric, :math:`v_{10} = \ell^T A^{-1}
\ell/4 - 1`, has the Jacobian :math:`m_9(y_k) - m_9(b)`, a change of :math:`G_9` by rank
two, and its step takes b to the centre of (H1), a step with the normal matrix
:math:`2A/\psi`  (H3) on the function :math:`1/2\psi` that is minimised here. It never
raises the cost while A is an ellipsoid's, and leaves of an error the share of
:math:`\sum c^2` in it: two or three steps to twelve digits.

**The closed-form start: the ellipsoid through the poses, by linear least squares.**

In readings :math:`z` moved to their mean and scaled to unit size, every ellipsoid
through the poses has its own equation :math:`z^T \tilde A z + \ell^T z = 1`  (E1),
because the mean lies inside it. The nine coefficients are linear, so no starting
values are needed, whatever the unit, the scale or the bias. Then
:math:`b = -\tilde A^{-1} \ell / 2` and :math:`A = \tilde A / (1 + b^T \tilde A b)`.

**The costs to minimise, with their derivatives, for a batch of trials.**

A `Local` is put together from weighted moment matrices and the derivatives of the
quadrics' ten coefficients, so no Jacobian of poses by parameters is ever formed.

**Residuals whose weights depend on the parameters but are held fixed in a step.**

The weighted residual takes :math:`w = 1/4q` at the measured reading, a robust loss a
weight that falls with the standardised distance. Each round computes the weights,
one weighted moment matrix and one solution; the rounds end by the same stop rule.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.residuals import (
    LOSSES,
    PAIRS,
    SLOPES,
    curvature,
    distance_quadric,
    distance_seconds,
    evaluate,
    in_lanes,
    moment_matrix,
    monomials,
    quadratic,
    residual_quadric,
    residual_seconds,
    residual_values,
    value_derivatives,
    weighted_sum,
)
from simval.imu.calibrate.solver import (
    Code,
    Factors,
    Local,
    Objective,
    Rules,
    Solution,
    factorize,
    minimize,
    trace,
)
from simval.imu.sensor import forms
from simval.poses import cube_corners, cube_edges, cube_faces
from simval.shapes import Float

_LEAST = 1e-61  # raw units; squares of the results stay finite


def _scale_changes() -> Float[Array, "w 6"]:
    # w'Ew in the six parameters of E, one row for each direction w, up to its sign
    directions = np.concatenate([cube_faces(), cube_edges(), cube_corners()])
    return np.unique(monomials(directions)[:, :6].round(15), axis=0)


_SCALES = _scale_changes()
_SCALES.setflags(write=False)


def normalized(
    poses: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 3"], Float[Array, " t"]]:
    """Move readings to their mean and scale them to unit size."""
    count = poses.shape[1]
    centre = np.vecmat(np.ones(count), poses) / count
    z = np.ascontiguousarray(np.swapaxes(poses, -1, -2)) - centre[..., None]
    flat = z.reshape(len(z), -1)
    scale = np.sqrt(np.vecdot(flat, flat) / count)
    one = scale <= _LEAST  # all readings are one
    z /= np.where(one, np.inf, scale)[:, None, None]
    return np.swapaxes(z, -1, -2), centre, np.where(one, 1.0, scale)


def direction_condition(
    model: str,
    theta: Float[Array, "t 9"],
    moments: Float[Array, "t 10 10"],
    usable: Any,
) -> tuple[Float[Array, " t"], Float[Array, " t"]]:
    """Condition of the corrected directions, eq. (P2) of `poses`, and their stretch.

    A step E of the natural parameters, which turns M into (1 + E) M with E lower
    triangular, changes the scale along a direction w by w'Ew. The row (P1) is twice
    the monomials of the direction, but for the signs of the last three.
    """
    safe = np.where(
        usable[:, None], theta, forms.from_gram(model, np.eye(3), np.zeros(3))
    )
    change = _corrected_monomials(model, safe)
    normal = change @ moments @ np.swapaxes(change, -1, -2)
    factors = factorize(in_lanes(normal))
    root = np.moveaxis(factors.root(), -1, 0).copy()
    flat = root.reshape(len(root), -1)
    good = usable & (factors.pivot > 0.0)
    back = np.where(good, np.vecdot(flat, flat), 1.0)
    condition = np.sqrt(trace(normal) * back) / 9.0
    seen = _SCALES @ np.swapaxes(root[:, :, :6], -1, -2)
    stretch = np.vecdot(seen, seen).max(axis=-1) / 4.0
    return np.where(good, condition, np.inf), np.where(good, stretch, np.inf)


def _corrected_monomials(
    model: str, theta: Float[Array, "t 9"]
) -> Float[Array, "t 9 10"]:
    # the matrix that takes the monomials of a reading to those of M (y - b)
    rows = np.zeros((3, 4, len(theta)))  # u = rows (y, 1)
    rows[:, :3] = np.moveaxis(forms.matrix(model, theta), 0, -1)
    for axis in range(3):
        rows[:, 3] -= rows[:, axis] * theta[:, 6 + axis]
    result = np.zeros((9, 10, len(theta)))
    first, second = np.array([(0, 0), (1, 1), (2, 2), *PAIRS]).T
    both = rows[first, :, None] * rows[second, None]
    for place, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), *PAIRS]):
        result[:6, place] = both[:, i, j]
        if i != j:
            result[:6, place] += both[:, j, i]
    result[:6, 6:9] = both[:, :3, 3] + both[:, 3, :3]
    result[:6, 9] = both[:, 3, 3]
    result[6:, 6:] = rows
    return np.moveaxis(result, -1, 0).copy()


def minimize_leverage(
    model: str,
    leverage: "Leverage",
    theta: Float[Array, "t 9"],
    rules: Rules,
    slack: float,
) -> Solution:
    """Minimise v'Gv over the ellipsoids, from the centre of the given one."""

    def objective(bias: Array, rows: Any) -> Local:
        few = leverage if rows.size == len(theta) else leverage.take(rows)
        return few.local(bias, newton=rules.method == "newton")

    found = minimize(objective, theta[:, 6:], rules, slack)
    result = forms.from_gram(model, leverage.gram(found.theta), found.theta)
    # not an ellipsoid's
    lost = ~np.asarray(np.isfinite(result).all(axis=-1), dtype=bool)
    converged = found.code == Code.CONVERGED
    return replace(
        found,
        theta=np.where(lost[:, None], theta, result),
        code=np.where(lost & converged, int(Code.STALLED), found.code),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leverage:
    """Parts of a leverage, in lanes."""

    factors: Factors  # of G_9
    start: Float[Array, "9 t"]  # p of eq. (E1)
    start_cost: Float[Array, " t"]  # s of eq. (H1)

    @classmethod
    def of(cls, moments: Float[Array, "t 10 10"]) -> "Leverage":
        """Factorise the moments of some trials."""
        m = in_lanes(moments)
        factors = factorize(m[:9, :9])
        start = factors.solve(m[:9, 9:])[:, 0]
        cost = m[9, 9] - _dot(start, m[9, :9])
        return cls(factors=factors, start=start, start_cost=cost)

    def take(self, rows: Any) -> "Leverage":
        """Those of some trials."""
        return Leverage(
            factors=self.factors.take(rows),
            start=self.start[:, rows],
            start_cost=self.start_cost[rows],
        )

    def local(self, bias: Float[Array, "t 3"], *, newton: bool) -> Local:
        """The function 1/2 psi of eq. (H2) at a point."""
        b, at = bias.T, _monomials(bias.T)
        psi, v = self._best(at)
        two_a = _twice_quadratic(v)
        slope = _product(two_a, b) + v[6:]  # half of -psi'
        normal = two_a / (psi * psi)
        matrix = _first(normal)
        bent = self._bend(b, slope, psi) if newton else None
        return Local(
            cost=np.where(_is_positive(two_a), 0.5 / psi, np.inf),
            gradient=_first(slope / (psi * psi)),
            normal=matrix,
            hessian=matrix if bent is None else matrix - _first(bent),
        )

    def _bend(
        self, b: Float[Array, "3 t"], slope: Float[Array, "3 t"], psi: Array
    ) -> Float[Array, "3 3 t"]:
        # what the second derivatives of 1/2 psi fall short of the matrix (H3)
        by_b = _monomial_slopes(b)
        bent = _inner(by_b, self.start_cost * self.factors.solve(by_b))
        tilt = _inner(by_b, self.start[:, None])[:, 0]
        bent += tilt[:, None] * tilt
        bent -= 4.0 * slope[:, None] * slope / psi
        return np.asarray(bent / (psi * psi))

    def gram(self, bias: Float[Array, "t 3"]) -> Float[Array, "t 3 3"]:
        """A = M'M of the ellipsoid of eq. (H1) about its centre."""
        psi, v = self._best(_monomials(bias.T))
        return _first(_twice_quadratic(v) / (2.0 * psi))

    def _best(
        self, at: Float[Array, "9 t"]
    ) -> tuple[Float[Array, " t"], Float[Array, "9 t"]]:
        # psi, and psi times the first nine coefficients of eq. (H1)
        drawn = self.start_cost * self.factors.solve(at[:, None])[:, 0]
        depth = 1.0 - _dot(self.start, at)
        psi = depth * depth + _dot(at, drawn)
        return psi, depth * self.start - drawn


def _dot(a: Float[Array, "k t"], b: Float[Array, "k t"]) -> Float[Array, " t"]:
    total = a[0] * b[0]
    for i in range(1, len(a)):
        total += a[i] * b[i]
    return total


def _product(
    matrix: Float[Array, "k p t"], vector: Float[Array, "p t"]
) -> Float[Array, "k t"]:
    total = matrix[:, 0] * vector[0]
    for i in range(1, len(vector)):
        total += matrix[:, i] * vector[i]
    return total


def _inner(
    left: Float[Array, "k a t"], right: Float[Array, "k c t"]
) -> Float[Array, "a c t"]:
    total = left[0, :, None] * right[0]
    for i in range(1, len(left)):
        total += left[i, :, None] * right[i]
    return total


def _first(values: Float[Array, "... t"]) -> Float[Array, "t ..."]:
    # the trials on the first axis
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))


def _monomials(b: Float[Array, "3 t"]) -> Float[Array, "9 t"]:
    return np.concatenate([b * b, np.stack([b[i] * b[j] for i, j in PAIRS]), b])


def _monomial_slopes(b: Float[Array, "3 t"]) -> Float[Array, "9 3 t"]:
    result = np.zeros((9, *b.shape))
    for axis in range(3):
        result[axis, axis] = 2.0 * b[axis]
        result[6 + axis, axis] = 1.0
    for index, (i, j) in enumerate(PAIRS):
        result[3 + index, i], result[3 + index, j] = b[j], b[i]
    return result


def _is_positive(a: Float[Array, "3 3 t"]) -> Any:
    # by Sylvester's criterion
    two = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    last = a[2, 2] * two - a[1, 2] * (a[0, 0] * a[1, 2] - a[0, 1] * a[0, 2])
    last -= a[0, 2] * (a[1, 1] * a[0, 2] - a[0, 1] * a[1, 2])
    return (a[0, 0] > 0.0) & (two > 0.0) & (last > 0.0)


def _twice_quadratic(v: Float[Array, "9 t"]) -> Float[Array, "3 3 t"]:
    result = np.empty((3, 3, v.shape[1]))
    for axis in range(3):
        result[axis, axis] = 2.0 * v[axis]
    for index, (i, j) in enumerate(PAIRS):
        result[i, j] = result[j, i] = v[3 + index]
    return result


# Relative to a column's own length, so the square of a sine: rounding of exactly
# singular monomials leaves 1e-15, poses at the limit of the condition 1e-7 or more.
_LEAST_PIVOT = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipsoid:
    """An ellipsoid |M(z - b)| = 1 through the poses, and how well they fix it."""

    gram: Float[Array, "t 3 3"]  # A = M'M; NaN where the poses do not fix an ellipsoid
    bias: Float[Array, "t 3"]  # its centre
    leverage: Leverage  # of the same moments
    # whether the nine monomials of the poses have full rank, (t,) of bool
    determined: Any
    proper: Any  # whether the quadric is an ellipsoid, (t,) of bool


def fit_ellipsoid(moments: Float[Array, "t 10 10"]) -> Ellipsoid:
    """Linear least squares of eq. (E1) from the moment matrices."""
    leverage = Leverage.of(moments)
    p = leverage.start
    gram = in_lanes(quadratic(p.T))
    three = factorize(gram)
    bias = three.solve(p[6:, None] / -2.0)[:, 0]
    # b'Ab = -b'l/2
    level = 1.0 - (bias[0] * p[6] + bias[1] * p[7] + bias[2] * p[8]) / 2.0
    gram /= level
    return Ellipsoid(
        gram=np.ascontiguousarray(np.moveaxis(gram, -1, 0)),
        bias=bias.T.copy(),
        leverage=leverage,
        determined=leverage.factors.pivot > _LEAST_PIVOT,
        proper=three.pivot > 0.0,  # the level is then 1 or more
    )


def pose_objective(
    model: str,
    residual: str,
    z: Float[Array, "t n 3"],
    shares: Float[Array, " n"] | None = None,
    *,
    newton: bool,
) -> Objective:
    """Cost of a residual that needs a pass over the poses for each step."""

    def objective(theta: Array, rows: Any) -> Local:
        x = z if rows.size == z.shape[0] else z[rows]
        c = residual_quadric(model, theta)
        q = distance_quadric(c)
        dc, dq = value_derivatives(c), value_derivatives(q)
        values_c, values_q = evaluate([c, q], x)
        slopes = SLOPES[residual](values_c, values_q, newton=False).weighted(shares)
        pull_c = weighted_sum(x, slopes.c)
        pull_q = weighted_sum(x, slopes.q)
        normal = _curve(x, slopes, dc, dq)
        hessian = normal
        if newton:
            bent = SLOPES[residual](values_c, values_q, newton=True).weighted(shares)
            seconds = residual_seconds(model, theta)
            hessian = _curve(x, bent, dc, dq)
            hessian += curvature(c, seconds, pull_c)
            seconds = distance_seconds(c, seconds)
            hessian += curvature(q, seconds, pull_q)
        return Local(
            cost=slopes.cost.sum(axis=-1),
            gradient=np.vecmat(pull_c, dc) + np.vecmat(pull_q, dq),
            normal=normal,
            hessian=hessian,
        )

    return objective


def _curve(
    x: Float[Array, "t n 3"],
    slopes: Any,
    dc: Float[Array, "t 10 9"],
    dq: Float[Array, "t 10 9"],
) -> Float[Array, "t 9 9"]:
    # Curvature by the parameters from the curvature by (c, q).
    left, other = np.swapaxes(dc, -1, -2), np.swapaxes(dq, -1, -2)
    total = left @ moment_matrix(x, slopes.cc) @ dc
    if np.any(slopes.qq):
        cross = left @ moment_matrix(x, slopes.cq) @ dq
        total += cross + np.swapaxes(cross, -1, -2)
        total += other @ moment_matrix(x, slopes.qq) @ dq
    return total


_ROUNDS = 200  # then `max iterations`; like the default of `max_iterations`
_SCALE_ROUNDS = 10  # then the scale is held, so that the rounds have a fixed point
_ROUNDING_FLOOR = 1e-9  # below it a round that moves no less than the last is rounding
_GAUSS_MAD = 1.4826  # standard deviation over median absolute one, Gaussian


def minimize_reweighted(
    model: str,
    residual: str,
    loss: str,
    z: Float[Array, "t n 3"],
    theta: Float[Array, "t 9"],
    noise: Float[Array, "t n"] | None,
    rules: Rules,
    slack: float,
    shares: Float[Array, " n"] | None = None,
) -> tuple[Solution, Float[Array, "t n"] | None]:
    """Solve with weights renewed between rounds."""
    count = len(theta)
    result, gradient = theta.copy(), np.full(count, np.nan)
    code = np.full(count, int(Code.MAX_ITERATIONS))
    iterations = np.zeros(count, dtype=int)
    ratios = np.zeros(z.shape[:2])
    scale, last = np.full(count, np.nan), np.full(count, np.inf)
    rows = np.arange(count)
    for turn in range(_ROUNDS):
        x = z[rows]
        c, q = residual_values(model, result[rows], x)
        distance = np.abs(c) / (2.0 * np.sqrt(q))
        weights = 0.25 / q if residual == "weighted" else np.ones_like(q)
        if shares is not None:
            weights, distance = weights * shares, distance * np.sqrt(shares)
        if loss != "linear":
            if turn < _SCALE_ROUNDS and noise is not None:
                scale[rows] = noise[rows].max(axis=-1)
            elif turn < _SCALE_ROUNDS:  # nine of the distances are fitted
                shrunk = np.sqrt(x.shape[1] / max(x.shape[1] - 9, 1))
                median = _GAUSS_MAD * shrunk * np.median(distance, axis=-1)
                scale[rows] = np.maximum(median, np.finfo(float).eps)
            ratios[rows] = distance / (LOSSES[loss].tuning * scale[rows])[:, None]
            weights = weights * LOSSES[loss].weight(ratios[rows])
        leverage = Leverage.of(moment_matrix(x, weights))
        inner = minimize_leverage(model, leverage, result[rows], rules, slack)
        middle = np.maximum(np.abs(inner.theta + result[rows]) / 2.0, 1.0)
        size = np.max(np.abs(inner.theta - result[rows]) / middle, axis=-1)
        result[rows], gradient[rows] = inner.theta, inner.gradient_norm
        iterations[rows] += inner.iterations
        failed = inner.code != Code.CONVERGED
        code[rows[failed]] = inner.code[failed]
        settled = size <= max(rules.tolerance, 1e-13)  # below is rounding
        settled |= (size <= _ROUNDING_FLOOR) & (size >= last[rows])
        last[rows] = size
        if loss != "linear":
            settled &= turn >= _SCALE_ROUNDS
        code[rows[settled & ~failed]] = int(Code.CONVERGED)
        rows = rows[~(settled | failed)]
        if rows.size == 0:
            break
    solution = Solution(
        theta=result, code=code, iterations=iterations, gradient_norm=gradient
    )
    return solution, None if loss == "linear" else ratios
