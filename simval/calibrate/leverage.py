r"""The squared residual's ellipsoid by its centre alone: three unknowns for nine.

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
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import PAIRS, in_lanes
from simval.calibrate.positive import Factors, factorize
from simval.calibrate.solver import Code, Local, Rules, Solution, minimize
from simval.sensor import forms
from simval.shapes import Float


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
    """What a leverage is made of, in lanes."""

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
