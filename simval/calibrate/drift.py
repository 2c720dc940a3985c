r"""Scatter that follows the time of the poses: a bias or a gain that drifts.

With the whitened residuals r of a fit and their derivative J by its parameters, a
property c of the sensor that drifts as :math:`\sum_{j=1}^m \gamma_j P_j(\tau)`,
Legendre polynomials over the time :math:`-1 \le \tau \le 1` of the poses, adds the
columns :math:`D = P_j(\tau)\,\partial r/\partial c`. With Q an orthonormal basis of the
columns of J, the fit leaves :math:`(I - QQ^T)D` of them, and the least squares of r on
that lower its sum of squares by a share whose law in white noise is known, whatever the
poses (the F test; the chi-square where the noise is known and explains the rest):

.. math:: p = N \min_{c,\,m} P\{\text{a drop as great by chance}\},  \tag{W1}

N the number of pairs (c, m) tried, m up to three: at most the chance that a sensor that
does not drift shows as much. What the order of the poses hides is the factor

.. math:: h = \max_c \sqrt{\frac{n - p}{n - 1}}\,
   \frac{|D_1|}{|(I - QQ^T)D_1|},  \tag{W2}

by which an even drift (m = 1) must be greater to leave as much in the residuals as with
the same poses in an order of chance.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.calibrate.deletion import LEFT
from simval.calibrate.outliers import Drop
from simval.shapes import Float

FALSE_ALARM: Final = 1e-3
"""Chance that a sensor that does not drift is said to."""
HIDDEN: Final = 5.0
"""Factor (W2) beyond which the order of the poses hides a drift: of 500 sets of 14
random directions 99 % lose at most 4.4, of 20 2.4."""
_DEGREE: Final = 3
_SEEN: Final = 1e-6  # relative: what the fit leaves of a column; rounding leaves 1e-13


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drift:
    """What the residuals say of a drift over the poses.

    Attributes
    ----------
    p_value : float
        Chance (W1) of residuals that follow the time as much; NaN where too few poses
        are left to tell.
    what : str
        What explains them best by drifting.
    span : float
        Its greatest less its least value over the poses, in its own unit.
    hidden : float
        Factor (W2); infinite where a drift leaves nothing.
    hides : str
        What drifts unseen by that factor.
    """

    p_value: float
    what: str
    span: float
    hidden: float
    hides: str

    @property
    def seen(self) -> bool:
        """Whether there is a drift, by the level `FALSE_ALARM`."""
        return self.p_value < FALSE_ALARM

    @property
    def excluded(self) -> bool:
        """Whether there is none, as far as poses in an order of chance would show."""
        return self.p_value >= FALSE_ALARM and self.hidden <= HIDDEN


def find_drift(
    r: Float[Array, " n"],
    J: Float[Array, "n p"],
    properties: dict[str, Float[Array, " n"]],
    time: Float[Array, " n"],
    *,
    known: bool,
    white: Float[Array, "n n"],
) -> Drift:
    """Look for a property of the sensor that drifts; `white` whitens the residuals."""
    r, J = white @ r, white @ J
    q = np.linalg.qr(J / np.linalg.norm(J, axis=0))[0]
    n, p = J.shape
    dof = n - p
    left = r - q @ (q.T @ r)
    before = float(left @ left)
    tau = 2.0 * (time - time.min()) / np.ptp(time) - 1.0
    basis = np.polynomial.legendre.legvander(tau, _DEGREE)[:, 1:]
    best, tried, hidden = (np.nan, "", 0.0), 0, (0.0, "")
    for what, column in properties.items():
        D = white @ (column[:, None] * basis)
        size = np.linalg.norm(D, axis=0)
        own = D - q @ (q.T @ D)
        seen = np.linalg.norm(own[:, 0]) / size[0]
        lost = float(np.sqrt(dof / (n - 1)) / seen) if seen > _SEEN else np.inf
        hidden = max(hidden, (lost, what))
        for degree in range(1, min(_DEGREE, dof - LEFT) + 1):
            u, s, v = np.linalg.svd(
                own[:, :degree] / size[:degree], full_matrices=False
            )
            u, s, v = u[:, s > _SEEN], s[s > _SEEN], v[s > _SEEN]
            along = u.T @ r
            rest = max(before - float(along @ along), before * np.finfo(float).eps)
            drop = Drop(rest=rest, dof=dof - len(s), known=1.0 if known else None)
            chance = drop.chance(before, len(s)) if len(s) and before > 0.0 else 1.0
            gamma = (v.T @ (along / s)) / size[:degree]
            tried += 1
            if not chance >= best[0]:
                best = (chance, what, float(np.ptp(basis[:, :degree] @ gamma)))
    return Drift(
        p_value=min(1.0, tried * best[0]) if tried else np.nan,
        what=best[1], span=best[2], hidden=hidden[0], hides=hidden[1],
    )  # fmt: skip
