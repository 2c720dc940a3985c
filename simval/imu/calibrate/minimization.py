r"""Ellipsoid of least cost through scaled readings.

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

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array, outer
from simval.imu.calibrate.residuals import (
    FIRST,
    LOSSES,
    SECOND,
    SLOPES,
    curvature,
    distance_quadric,
    distance_seconds,
    moment_matrix,
    monomial_slopes,
    monomials,
    quadratic,
    residual_quadric,
    residual_seconds,
    residual_values,
    value_derivatives,
)
from simval.imu.calibrate.solver import (
    Code,
    Local,
    Objective,
    Rules,
    Solution,
    Trials,
    inverse_root,
    minimize,
    trace,
)
from simval.imu.sensor import forms
from simval.poses import cube_corners, cube_edges, cube_faces
from simval.shapes import Float

_LEAST = 1e-61  # raw units; squares of the results stay finite


# w'Ew in the six parameters of E, one row for each direction w, up to its sign
_SCALES = np.unique(
    monomials(np.concatenate([cube_faces(), cube_edges(), cube_corners()]))[
        :, :6
    ].round(15),
    axis=0,
)
_SCALES.setflags(write=False)
_SLOPES = monomial_slopes()


def normalized(
    poses: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 3"], Float[Array, " t"]]:
    """Centre readings on their mean and scale them to unit size."""
    count = poses.shape[1]
    centre = np.vecmat(np.ones(count), poses) / count
    z = np.ascontiguousarray(poses.mT) - centre[..., None]
    flat = z.reshape(len(z), -1)
    scale = np.sqrt(np.vecdot(flat, flat) / count)
    one = scale <= _LEAST  # all readings are one
    z /= np.where(one, np.inf, scale)[:, None, None]
    return z.mT, centre, np.where(one, 1.0, scale)


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
    change = _corrected_monomials(model, theta)
    normal = change @ moments @ change.mT
    root, pivot = inverse_root(normal)
    good = usable & (pivot > 0.0)
    flat = root.reshape(-1, 81)
    back = np.where(good, np.vecdot(flat, flat), 1.0)
    condition = np.sqrt(trace(normal) * back) / 9.0
    seen = root[:, :, :6] @ _SCALES.T
    stretch = np.einsum("tiw,tiw->tw", seen, seen).max(axis=-1) / 4.0
    return np.where(good, condition, np.inf), np.where(good, stretch, np.inf)


def _corrected_monomials(
    model: str, theta: Float[Array, "t 9"]
) -> Float[Array, "t 9 10"]:
    # the matrix that takes the monomials of a reading to those of M (y - b)
    rows = np.zeros((3, 4, len(theta)))  # u = rows (y, 1)
    rows[:, :3] = forms.matrix(model, theta).transpose(1, 2, 0)
    for axis in range(3):
        rows[:, 3] -= rows[:, axis] * theta[:, 6 + axis]
    result = np.zeros((9, 10, len(theta)))
    both = rows[FIRST[:6], :, None] * rows[SECOND[:6], None]
    result[:6] = both[:, FIRST, SECOND]
    result[:6, 3:9] += both[:, SECOND[3:9], FIRST[3:9]]
    result[6:, 6:] = rows
    return result.transpose(2, 0, 1).copy()


def minimize_leverage(
    model: str,
    leverage: "Leverage",
    theta: Float[Array, "t 9"],
    rules: Rules,
    slack: float,
) -> Solution:
    """Minimise v'Gv over the ellipsoids, starting from the centre of a given one."""

    def objective(bias: Array, rows: Any) -> Local:
        few = leverage if rows.size == len(theta) else leverage.take(rows)
        return few.local(bias, newton=rules.method == "newton")

    found = minimize(objective, theta[:, 6:], rules, slack)
    result = forms.from_gram(model, leverage.gram(found.theta), found.theta)
    # not an ellipsoid's
    lost = ~np.asarray(np.isfinite(result).all(axis=-1))
    converged = found.code == Code.CONVERGED
    return found._replace(
        theta=np.where(lost[:, None], theta, result),
        code=np.where(lost & converged, Code.STALLED, found.code),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leverage(Trials):
    """Factors of the moment matrix; NaN where G_9 is not positive."""

    root: Float[Array, "t 9 9"]  # of the inverse of G_9
    pivot: Float[Array, " t"]  # least of G_9
    start: Float[Array, "t 9"]  # p of eq. (E1)
    start_cost: Float[Array, " t"]  # s of eq. (H1)

    @classmethod
    def of(cls, moments: Float[Array, "t 10 10"]) -> "Leverage":
        """Factorise the moment matrices of some trials."""
        root, pivot = inverse_root(moments[:, :9, :9])
        start = np.vecmat(np.matvec(root, moments[:, :9, 9]), root)
        return cls(
            root=root,
            pivot=pivot,
            start=start,
            start_cost=moments[:, 9, 9] - np.vecdot(start, moments[:, 9, :9]),
        )

    def local(self, bias: Float[Array, "t 3"], *, newton: bool) -> Local:
        """The cost 1/2 psi of eq. (H2) and its derivatives at a centre."""
        psi, v = self._best(bias)
        two_a = 2.0 * quadratic(v)
        slope = np.matvec(two_a, bias) + v[:, 6:]  # half of -psi'
        square = psi * psi
        normal, hessian = two_a / square[:, None, None], None
        if newton:  # the second derivatives fall short of the matrix (H3)
            by_b = np.empty((len(bias), 9, 3))
            by_b[:] = _SLOPES[..., 3]
            by_b += np.einsum("mij,tj->tmi", _SLOPES[..., :3], bias)
            drawn = self.root @ by_b
            bent = drawn.mT @ drawn
            bent *= self.start_cost[:, None, None]
            tilt = np.vecmat(self.start, by_b)
            bent += outer(tilt, tilt)
            bent -= 4.0 * outer(slope, slope) / psi[:, None, None]
            hessian = normal - bent / square[:, None, None]
        return Local(
            cost=np.where(_is_positive(two_a), 0.5 / psi, np.inf),
            gradient=slope / square[:, None],
            normal=normal,
            hessian=hessian,
        )

    def gram(self, bias: Float[Array, "t 3"]) -> Float[Array, "t 3 3"]:
        """A = M'M of the best ellipsoid about a centre, eq. (H1)."""
        psi, v = self._best(bias)
        return quadratic(v) / psi[:, None, None]

    def _best(
        self, bias: Float[Array, "t 3"]
    ) -> tuple[Float[Array, " t"], Float[Array, "t 9"]]:
        # psi, and psi times the first nine coefficients of eq. (H1)
        at = monomials(bias)[:, :9]
        drawn, cost = np.matvec(self.root, at), self.start_cost
        depth = 1.0 - np.vecdot(self.start, at)
        psi = depth * depth + cost * np.vecdot(drawn, drawn)
        back = np.vecmat(drawn, self.root)
        return psi, depth[:, None] * self.start - cost[:, None] * back


def _is_positive(a: Float[Array, "t 3 3"]) -> Any:
    # by Sylvester's criterion
    (aa, ab, ac), (_, bb, bc), (_, _, cc) = a.transpose(1, 2, 0)
    two = aa * bb - ab * ab
    last = cc * two - bc * (aa * bc - ab * ac)
    last -= ac * (bb * ac - ab * bc)
    return (aa > 0.0) & (two > 0.0) & (last > 0.0)


# Relative to a column's own length, so the square of a sine: rounding of exactly
# singular monomials leaves 1e-15, poses at the limit of the condition 1e-7 or more.
_LEAST_PIVOT = 1e-12


class Ellipsoid(NamedTuple):
    """An ellipsoid |M(z - b)| = 1 through the poses, and how well they determine it."""

    gram: Float[Array, "t 3 3"]  # A = M'M; NaN where the poses do not fix an ellipsoid
    bias: Float[Array, "t 3"]  # its centre
    leverage: Leverage  # of the same moments
    # whether the nine monomials of the poses have full rank, (t,) of bool
    determined: Any
    proper: Any  # whether the quadric is an ellipsoid, (t,) of bool


def fit_ellipsoid(moments: Float[Array, "t 10 10"]) -> Ellipsoid:
    """Linear least squares of eq. (E1) from the moment matrices."""
    leverage = Leverage.of(moments)
    gram, linear = quadratic(leverage.start), leverage.start[:, 6:]
    root, pivot = inverse_root(gram)
    drawn = np.matvec(root, linear)  # b'Ab = l'A^-1 l/4
    level = 1.0 + np.vecdot(drawn, drawn) / 4.0
    return Ellipsoid(
        gram=gram / level[:, None, None],
        bias=np.vecmat(drawn, root) / -2.0,
        leverage=leverage,
        determined=leverage.pivot > _LEAST_PIVOT,
        proper=pivot > 0.0,  # the level is then 1 or more
    )


def pose_objective(
    model: str,
    residual: str,
    m: Float[Array, "t 10 n"],
    shares: Float[Array, "t n"] | None = None,
    *,
    newton: bool,
) -> Objective:
    """Cost of a residual that has to visit every pose in each step."""

    def objective(theta: Array, rows: Any) -> Local:
        x = m if rows.size == len(m) else m[rows]
        share = None if shares is None else shares[rows]
        c = residual_quadric(model, theta)
        q = distance_quadric(c)
        dc, dq = value_derivatives(c), value_derivatives(q)
        both = np.stack([c.values, q.values], axis=1) @ x
        values_c, values_q = both[:, 0], both[:, 1]
        slopes = SLOPES[residual](values_c, values_q, newton=False).weighted(share)
        pull_c, pull_q = np.matvec(x, slopes.c), np.matvec(x, slopes.q)
        normal = _curve(x, slopes, dc, dq)
        hessian = None
        if newton:
            bent = SLOPES[residual](values_c, values_q, newton=True).weighted(share)
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
    x: Float[Array, "t 10 n"],
    slopes: Any,
    dc: Float[Array, "t 10 9"],
    dq: Float[Array, "t 10 9"],
) -> Float[Array, "t 9 9"]:
    # Curvature by the parameters from the curvature by (c, q).
    left, other = dc.mT, dq.mT
    total = left @ moment_matrix(x, slopes.cc) @ dc
    if np.any(slopes.qq):
        cross = left @ moment_matrix(x, slopes.cq) @ dq
        total += cross + cross.mT
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
    m: Float[Array, "t 10 n"],
    theta: Float[Array, "t 9"],
    noise: Float[Array, "t n"] | None,
    rules: Rules,
    slack: float,
    shares: Float[Array, "t n"] | None = None,
) -> tuple[Solution, Float[Array, "t n"] | None]:
    """Solve for weights that depend on the solution, renewed in rounds."""
    count = len(theta)
    result, gradient = theta.copy(), np.full(count, np.nan)
    code = np.full(count, Code.MAX_ITERATIONS)
    iterations = np.zeros(count, dtype=int)
    ratios = np.zeros((count, m.shape[2]))
    scale, last = np.full(count, np.nan), np.full(count, np.inf)
    rows = np.arange(count)
    for turn in range(_ROUNDS):
        x = m if rows.size == count else m[rows]
        c, q = residual_values(model, result[rows], x)
        distance = np.abs(c) / (2.0 * np.sqrt(q))
        weights = 0.25 / q if residual == "weighted" else np.ones_like(q)
        if shares is not None:
            share = shares[rows]
            weights, distance = weights * share, distance * np.sqrt(share)
        if loss != "linear":
            if turn < _SCALE_ROUNDS and noise is not None:
                scale[rows] = noise[rows].max(axis=-1)
            elif turn < _SCALE_ROUNDS:  # nine of the distances are fitted
                shrunk = np.sqrt(m.shape[2] / max(m.shape[2] - 9, 1))
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
        code[rows[settled & ~failed]] = Code.CONVERGED
        rows = rows[~(settled | failed)]
        if rows.size == 0:
            break
    solution = Solution(
        theta=result, code=code, iterations=iterations, gradient_norm=gradient
    )
    return solution, None if loss == "linear" else ratios
