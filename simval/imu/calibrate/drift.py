r"""Test for a bias or a gain that drifts while the poses are taken.

With the whitened residuals r of a fit and their derivative J by its parameters, a
property c of the sensor that drifts as :math:`\sum_{j=1}^m \gamma_j P_j(\tau)`,
Legendre polynomials over the time :math:`-1 \le \tau \le 1` of the poses, adds the
columns :math:`D = P_j(\tau)\,\partial r/\partial c`. With Q an orthonormal basis of the
columns of J, the fit leaves :math:`(I - QQ^T)D` of them, and the least squares of r on
that lower its sum of squares by a share whose law in white noise is known, whatever the
poses (the F test; the chi-square where the noise is known and explains the rest):

.. math:: p = N \min_{c,\,m} P\{\text{a drop as great by chance}\},  \tag{W1}

N the number of pairs (c, m) tried, m up to three: at most the chance that a sensor that
does not drift shows as much. The biases of a triad are tried together too, as a part
that warms up moves them all; one axis alone leaves the drift of the others as noise.
What the order of the poses hides is the factor

.. math:: h = \max_c \sqrt{\frac{n - p}{n - 1}}\,
   \frac{|D_1|}{|(I - QQ^T)D_1|},  \tag{W2}

by which an even drift (m = 1) must be greater to leave as much in the residuals as with
the same poses in an order of chance.
"""

from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.goodness_of_fit import LEFT, Drop
from simval.shapes import Float

DRIFT_FALSE_ALARM: Final = 1e-3
"""Chance that a sensor that does not drift is said to."""
HIDDEN: Final = 5.0
"""Factor (W2) beyond which the order of the poses hides a drift: of 500 sets of 14
random directions 99 % lose at most 4.4, of 20 2.4."""
_DEGREE: Final = 3
_TOLD: Final = 0.01
"""Relative: what the fit leaves of a drift that is tried. One that leaves less is a
hundred times greater than it shows, and what it explains is rather something else."""
_SEEN: Final = 1e-6  # relative: what the fit leaves of a column; rounding leaves 1e-13


class Drift(NamedTuple):
    """Result of a test of the residuals for a drift over time.

    Attributes
    ----------
    p_value : float
        Chance (W1) of residuals that follow the time as much; NaN where too few poses
        are left to tell.
    what : str
        What explains them best by drifting.
    span : float
        Its greatest less its least value over the poses, in its own unit; of several
        that of the one that drifts most.
    drop : float
        What that takes off the sum of squares.
    hidden : float
        Factor (W2); infinite where a drift leaves nothing.
    hides : str
        What drifts unseen by that factor.
    """

    p_value: float
    what: str
    span: float
    drop: float
    hidden: float
    hides: str

    @property
    def seen(self) -> bool:
        """True if there is a drift, at the level `DRIFT_FALSE_ALARM`."""
        return self.p_value < DRIFT_FALSE_ALARM

    @property
    def excluded(self) -> bool:
        """True if there is no drift, and one could not hide in this order of poses."""
        return self.p_value >= DRIFT_FALSE_ALARM and self.hidden <= HIDDEN


def find_drift(
    r: Float[Array, " n"],
    J: Float[Array, "n p"],
    properties: dict[str, Float[Array, "n ..."]],
    time: Float[Array, " n"],
    *,
    known: bool,
    white: Array | None = None,
) -> Drift:
    """Test which property drifts, or several together, each by its column.

    `white` whitens the residuals and all columns.
    """

    def whitened(rows: Array) -> Array:
        return rows if white is None else white @ rows

    r, J = whitened(r), whitened(J)
    q = np.linalg.qr(J / np.linalg.norm(J, axis=0))[0]
    n, p = J.shape
    dof = n - p
    left = r - q @ (q.T @ r)
    before = float(left @ left)
    tau = 2.0 * (time - time.min()) / np.ptp(time) - 1.0
    basis = np.polynomial.legendre.legvander(tau, _DEGREE)[:, 1:]
    best, tried, hidden = (np.nan, np.nan, "", 0.0, 0.0), 0, (0.0, "")
    for what, column in properties.items():
        each = column.reshape(n, -1, 1) * basis[:, None]
        width = each.shape[1]
        D = whitened(each.mT.reshape(n, -1))  # the degrees in turn
        size = np.linalg.norm(D, axis=0)
        own = D - q @ (q.T @ D)
        if width == 1:
            seen = np.linalg.norm(own[:, 0]) / size[0]
            lost = float(np.sqrt(dof / (n - 1)) / seen) if seen > _SEEN else np.inf
            hidden = max(hidden, (lost, what))
        for degree in range(1, min(_DEGREE, (dof - LEFT) // width) + 1):
            count = degree * width
            u, s, v = np.linalg.svd(own[:, :count] / size[:count], full_matrices=False)
            u, s, v = u[:, s > _TOLD], s[s > _TOLD], v[s > _TOLD]
            along = u.T @ r
            rest = max(before - float(along @ along), before * np.finfo(float).eps)
            free = dof - len(s)
            drop = Drop(rest=rest, dof=free, known=1.0 if known else None)
            chance = drop.chance(before, len(s)) if len(s) and before > 0.0 else 1.0
            gamma = ((v.T @ (along / s)) / size[:count]).reshape(degree, width)
            tried += 1
            if not (chance, rest / free) >= best[:2]:
                span = float(np.ptp(basis[:, :degree] @ gamma, axis=0).max())
                best = (chance, rest / free, what, span, before - rest)
    return Drift(
        p_value=min(1.0, tried * best[0]) if tried else np.nan,
        what=best[2], span=best[3], drop=best[4],
        hidden=hidden[0], hides=hidden[1],
    )  # fmt: skip


def of_a_triad(
    normal: Float[Array, "n 3"], x: Float[Array, "n 3"]
) -> dict[str, Float[Array, "n ..."]]:
    """Columns of the properties of a three-axis sensor that may drift."""
    columns = np.concatenate([normal, normal * x], axis=1).T
    names = [f"the {axis} {what}" for what in ("bias", "gain") for axis in "xyz"]
    return {**dict(zip(names, columns, strict=True)), "the biases": normal}
