r"""The calibration error of one draw of noise, to second order.

The estimating equation (K1) of `simval.theory.calibration`, solved in powers of the
noise :math:`n_i` of each pose and not of its mean. With
:math:`H = \sum_i a_i d_i d_i^T` and subscripts for derivatives at the truth,

.. math::
   \delta_1 = -H^{-1} \sum_i a_i d_i\, c_{y,i} n_i, \qquad
   c_1 = c_y n + d^T \delta_1  \tag{K5}

.. math::
   \delta_2 = -H^{-1} \sum_i \big[a\,d\,c_2 + a\,c_1 d_1 + a_1 c_1 d + c_1^2 b\big],
   \tag{K6}

:math:`c_2 = \tfrac12 n^T c_{yy} n + n^T d_y^T \delta_1 + \tfrac12 \delta_1^T d_\theta
\delta_1`, :math:`d_1 = d_y n + d_\theta \delta_1`,
:math:`a_1 = a_y n + a_\theta \delta_1`. The first is linear in the noise, the second a
quadratic form, and left out is the third order. What `adjusted` takes out of its
moments is a constant, which is not in (K6).

A use that must not depend on theory being right, such as a control variate, takes the
means from the forms themselves: `Expansion.slope` and `Expansion.mean_second`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simval.arrays import Array, positive_number
from simval.geometry import normalize
from simval.poses import one_set
from simval.sensor import AccelerometerModel, forms
from simval.shapes import Float
from simval.theory.calibration import _geometry


@dataclass(frozen=True, kw_only=True, eq=False)
class Expansion:
    """Equations (K5) and (K6) of one sensor, its poses and a residual."""

    inverse: Float[Array, "9 9"]  # of H
    d: Float[Array, "n 9"]
    along: Float[Array, "n 3"]  # dc/dy
    cross: Float[Array, "n 9 3"]  # d2c/dtheta dy
    bend: Float[Array, "n 9 9"]  # d2c/dtheta2
    quadric: Float[Array, "3 3"]  # half of d2c/dy2, the same in every pose
    a: Float[Array, " n"]
    a_along: Float[Array, "n 3"]
    a_turn: Float[Array, "n 9"]  # da/dtheta
    b: Float[Array, "n 9"]

    @cached_property
    def slope(self) -> Float[Array, "9 d"]:
        """Of the first order, by the noise of each axis of each pose in turn."""
        each = (self.a[:, None] * self.d)[:, :, None] * self.along[:, None, :]
        return -self.inverse @ each.transpose(1, 0, 2).reshape(9, -1)

    @cached_property
    def mean_second(self) -> Float[Array, "9"]:
        """Mean of the second order for noise of deviation 1, the trace of its form."""
        unit = np.eye(3 * len(self.d)).reshape(-1, len(self.d), 3)
        return self.second(unit).sum(axis=0)

    def first(self, noise: Float[Array, "t n 3"]) -> Float[Array, "t 9"]:
        """First order of each draw, eq. (K5)."""
        return noise.reshape(len(noise), -1) @ self.slope.T

    def second(self, noise: Float[Array, "t n 3"]) -> Float[Array, "t 9"]:
        """Second order of each draw, eq. (K6)."""
        first = self.first(noise)
        by_pose = np.swapaxes(noise, 0, 1)  # (n, t, 3): a matrix product for each pose
        c1 = (by_pose @ self.along[:, :, None])[..., 0] + self.d @ first.T
        turned = by_pose @ np.swapaxes(self.cross, 1, 2)
        bent = first @ np.swapaxes(self.bend, 1, 2)
        c2 = np.vecdot(by_pose @ self.quadric, by_pose)
        c2 += np.vecdot(turned + 0.5 * bent, first)
        a1 = (by_pose @ self.a_along[:, :, None])[..., 0] + self.a_turn @ first.T
        total = (self.a[:, None] * c2 + a1 * c1).T @ self.d + (c1**2).T @ self.b
        change = (self.a[:, None] * c1)[..., None] * (turned + bent)
        return -(total + change.sum(axis=0)) @ self.inverse


def calibration_expansion(
    model: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    residual: str = "squared",
) -> Expansion:
    """Expansion of a calibration's error, triangular form, poses of equal noise."""
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    x = np.linalg.solve(model.matrix, g * u.T).T
    theta = forms.from_gram("triangular", model.matrix.T @ model.matrix, model.B)
    p = _geometry("triangular", theta, x, g)
    weighted = residual in ("weighted", "sampson")
    a = 0.25 / p.q if weighted else np.ones_like(p.q)
    slope = -a / p.q if weighted else np.zeros_like(p.q)
    a_turn = slope[:, None] * (0.5 * p.turn)
    b = np.zeros_like(p.d)
    if residual == "norm":
        b = -0.75 * p.d
    elif residual == "sampson":
        b = 0.5 * a_turn
    quadric = model.matrix.T @ model.matrix / g**2
    ax = x @ quadric
    first = forms.matrix_derivatives("triangular", theta)
    half = np.einsum("jrk,rl->jkl", first, forms.matrix("triangular", theta)) / g**2
    slopes = np.einsum("jkl,nl->njk", half + np.swapaxes(half, -1, -2), x)
    fixed = np.broadcast_to(-2.0 * quadric, (len(x), 3, 3))
    return Expansion(
        inverse=np.linalg.inv((p.d * a[:, None]).T @ p.d),
        d=p.d,
        along=2.0 * ax,
        cross=np.concatenate([2.0 * slopes, fixed], axis=1),
        bend=p.bend,
        quadric=quadric,
        a=a,
        a_along=slope[:, None] * (2.0 * ax @ quadric),
        a_turn=a_turn,
        b=b,
    )
