r"""Sensor changes during the recording: a drift, a step, or a break.

**Scatter that follows the time of the poses: a bias or a gain that drifts.**

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

**A sensor whose biases or scales step to other values in the course of the poses.**

From pose k on the readings are those of another sensor; undone,

.. math:: u_i = z_i + [i \ge k]\,(d + s \circ (z_i - o)),  \tag{S1}

they lie on the ellipsoid (E1) of the earlier ones; a scale multiplies about o, the
zero of the counter if that is near the centre, or else the centre itself. Each of ten
changes (one bias, three; one scale, all alike, three; all six) at each place is fitted
by Gauss-Newton, in distances, and held against no change by

.. math:: N\,P\{F_{m,\,n-9-m} > F\}, \tag{S2}

N the number of changes and places tried, m of the parameters of the change: at most
the chance that a clean series shows any such step. A part of its own needs nine poses
and more (`find_break`), one bias a single degree of freedom.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.imu.calibrate.goodness_of_fit import LEFT, Drop
from simval.imu.calibrate.outliers import (
    LEAST_SLOPE,
    coefficients,
    deletion_of,
    scaled,
    slope_of,
)
from simval.imu.calibrate.residuals import monomials, quadratic
from simval.shapes import Float, Int

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
    """Test of the residuals for a drift over the poses.

    Attributes
    ----------
    p_value : float
        Chance (W1) of residuals that follow the time as much; NaN where too few poses
        are left to tell.
    left : float
        Squares that the best drift leaves, over their degrees of freedom.
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
    left: float
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
        """True if a drift is excluded, as poses in random order would show one."""
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
    """Look for what drifts, one property or several at once, each by its column.

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
        D = whitened(np.swapaxes(each, 1, 2).reshape(n, -1))  # the degrees in turn
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
        left=best[1], what=best[2], span=best[3], drop=best[4],
        hidden=hidden[0], hides=hidden[1],
    )  # fmt: skip


def of_a_triad(
    normal: Float[Array, "n 3"], x: Float[Array, "n 3"]
) -> dict[str, Float[Array, "n ..."]]:
    """What may drift of a triad whose bias moves residuals by `normal`, a gain by x."""
    columns = np.concatenate([normal, normal * x], axis=1).T
    names = [f"the {what} of {axis}" for what in ("bias", "gain") for axis in "xyz"]
    return {**dict(zip(names, columns, strict=True)), "the biases": normal}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """Change point of a series of poses, and the scatter that it explains."""

    index: int  # first pose after the change
    what: str  # what changed; of a break the part that stays on its ellipsoid
    chance: float  # chance that the best change of a clean series is as good
    drop: float  # scatter without a change over that with it
    scatter: float  # scatter with the change, raw units
    dof: int  # degrees of freedom that the change leaves

    def order(self) -> tuple[float, float]:
        """Sort key: the least likely by chance first, then what explains most."""
        return self.chance, -self.drop


def change(
    index: int, what: str, rest: float, left: int,
    *, before: float, dof: int, tried: int, scale: float,
) -> Change:  # fmt: skip
    """Judge a change that leaves the sum of squares `rest` with `left` freedoms.

    The F test of the squares `before` with `dof`, times the number of changes tried.
    """
    chance = scipy.special.betainc(left / 2, (dof - left) / 2, min(rest / before, 1.0))
    return Change(
        index=index,
        what=what,
        chance=float(min(1.0, tried * chance)),
        drop=float(np.sqrt(before / dof / (rest / left))),
        scatter=float(np.sqrt(rest / left)) * scale,
        dof=left,
    )


def find_break(poses: Float[Array, "n 3"]) -> Change | None:
    """Find the cut that divides a series of poses best.

    The longer part fits an ellipsoid and the shorter one, taken as outliers all
    together, does not: (O1) with the number of cuts for the binomial.
    """
    z, scale, floor = scaled(poses)
    count, dof = len(poses), len(poses) - 9
    design = monomials(z)[:, :9]
    even = np.full(count, 2.0)
    deletion = deletion_of(design, even, floor)
    cuts = [(k, "earlier", range(k, count)) for k in range(count - dof + LEFT, count)]
    cuts += [(k, "later", range(k)) for k in range(1, dof - LEFT + 1)]
    if not cuts or deletion.rank < 9:
        return None
    changes: list[Change] = []
    for _ in range(2):  # the weights of the second round are those of the best cut
        total = deletion.squares([])
        changes += [
            change(
                index, longer, deletion.squares(list(out)), dof - len(out),
                before=total, dof=dof, tried=len(cuts), scale=scale,
            )
            for index, longer, out in cuts
        ]  # fmt: skip
        best = min(changes, key=Change.order)
        out = range(best.index, count) if best.what == "earlier" else range(best.index)
        cut = coefficients(design, even, list(out))
        deletion = deletion_of(design, slope_of(cut, z), floor)
    return best


_ITERATIONS = 6  # of Gauss-Newton; a step not yet settled lowers the sum less
_MOST = (
    64  # poses, some 0.5 s; of more the parts are judged by themselves (`find_break`)
)
_SIDE = 3  # poses on either side: fewer are outliers, not a step
_LOST = 1e-9  # entries of a triangle below, relative, are not fixed by the poses
# Of the readings' radius, and of a scale: what changes by more leaves several percent
# of gravity, and freely a part shrinks to a point, which lies on any ellipsoid.
_GREATEST = 0.5

# what may change, as columns by (bias x, y, z, scale x, y, z)
_UNIT = np.eye(6)
CHANGES: dict[str, Array] = {
    "biases and scales": _UNIT,  # first: it has all others
    "the bias of x": _UNIT[:, [0]],
    "the bias of y": _UNIT[:, [1]],
    "the bias of z": _UNIT[:, [2]],
    "the scale of x": _UNIT[:, [3]],
    "the scale of y": _UNIT[:, [4]],
    "the scale of z": _UNIT[:, [5]],
    "the scale of all axes": _UNIT[:, 3:].sum(axis=1, keepdims=True),
    "the biases": _UNIT[:, :3],
    "the scales": _UNIT[:, 3:],
}


def find_step(poses: Float[Array, "n 3"], least_drop: float = 0.0) -> Change | None:
    """Look for the step that explains a series of poses best, and so much at least.

    All changes are parts of that of biases and scales: none explains more there.
    """
    z, scale, floor = scaled(poses)
    count, dof = len(poses), len(poses) - 9
    tried = {k: v for k, v in CHANGES.items() if dof - v.shape[1] >= LEFT}
    sides = {what: max(_SIDE, v.shape[1] + 1) for what, v in tried.items()}
    number = sum(max(count - 2 * side + 1, 0) for side in sides.values())
    design = monomials(z)[:, :9]
    if count > _MOST or deletion_of(design, np.full(count, 2.0), floor).rank < 9:
        return None
    slope = slope_of(coefficients(design, np.full(count, 2.0), []), z)
    p = coefficients(design, slope, [])
    total = deletion_of(design, slope, floor).squares([])
    centre = -np.linalg.solve(2.0 * quadratic(p), p[6:])
    zero = -poses.mean(axis=0) / scale
    if np.linalg.norm(zero - centre) > _GREATEST:
        zero = centre
    best: list[Change] = []
    hopeful = np.ones(count, dtype=bool)
    for what, columns in tried.items():
        places = np.arange(sides[what], count - sides[what] + 1)
        places = places[hopeful[places]]
        if len(places) == 0:
            continue
        sums = np.maximum(_squares(z, p, zero, places, columns), count * floor)
        if columns is _UNIT:  # twice: an iteration that has not settled leaves more
            hopeful[places] = sums * least_drop**2 <= 2.0 * total
        at, left = int(np.argmin(sums)), dof - columns.shape[1]
        best.append(
            change(
                int(places[at]), what, sums[at], left,
                before=total, dof=dof, tried=number, scale=scale,
            )
        )  # fmt: skip
    return min(best, key=Change.order, default=None)


def _squares(
    z: Float[Array, "n 3"],
    start: Float[Array, "9"],
    zero: Float[Array, "3"],
    places: Int[NDArray[np.intp], " places"],
    columns: Float[Array, "6 k"],
) -> Float[Array, " places"]:
    # least sum of squared distances with a step at each place
    later = np.arange(len(z)) >= places[:, None]
    moves = later[..., None] * np.concatenate([np.ones_like(z), z - zero], axis=-1)
    p = np.tile(start, (len(places), 1))
    change = np.zeros((len(places), columns.shape[1]))
    least = np.full(len(places), np.inf)
    for _ in range(_ITERATIONS):
        full = (change @ columns.T)[:, None]
        moved = moves * full
        u = z + (moved[..., :3] + moved[..., 3:])
        gradient = 2.0 * u @ quadratic(p) + p[:, None, 6:]
        by_reading = gradient * (1.0 + later[..., None] * full[..., 3:])
        slope = np.sqrt(np.vecdot(by_reading, by_reading))
        slope = np.maximum(
            slope, LEAST_SLOPE * np.median(slope, axis=-1, keepdims=True)
        )
        by_change = (np.tile(gradient, 2) * moves) @ columns
        both = np.concatenate([monomials(u)[..., :9], by_change], axis=-1)
        p, step, sums = _solved(both / slope[..., None], 1.0 / slope)
        least = np.minimum(least, sums)
        change = np.clip(change + step, -_GREATEST, _GREATEST)
    return least


def _solved(
    both: Float[Array, "places n m"], y: Float[Array, "places n"]
) -> tuple[Array, Array, Array]:
    # the nine of the quadric alone, what the others step by beside them, and the sum
    # of squares that the nine alone leave; infinite where the poses do not fix them all
    # the triangle of both and y side by side: in its last column y along the others,
    # and below the nine what these leave of it
    both = np.concatenate([both, y[..., None]], axis=-1)
    triangle = np.asarray(np.linalg.qr(both, mode="r"))
    r, along = triangle[:, :-1, :-1], triangle[:, :-1, -1:]
    size = np.abs(np.diagonal(r, axis1=-2, axis2=-1))
    lost = size.min(axis=-1) <= _LOST * size.max(axis=-1)
    r[lost] = np.eye(r.shape[-1])
    p = np.linalg.solve(r[:, :9, :9], along[:, :9])[..., 0]
    step = np.linalg.solve(r[:, 9:, 9:], along[:, 9:])[..., 0]
    left = np.sum(triangle[:, 9:, -1] ** 2, axis=-1)
    return p, step, np.where(lost, np.inf, left)
