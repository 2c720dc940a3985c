r"""Covariance of an accelerometer's fit, and consistency of its poses with it.

**Covariance and fit statistics at a solution, in the scaled units of the fit.**

The estimate solves :math:`\sum_k a_k c_k\, d_k = 0`, :math:`d = \partial c /
\partial\theta`, up to terms of second order in the noise, with :math:`a = 1`
(squared, norm, adjusted) or :math:`1/4q`, times the share of the pose by its noise
where that is known (weighted, sampson), and
:math:`\partial c/\partial y` has squared length :math:`4q`. So to first order

.. math:: \mathrm{Cov} = N^{-1} \Big(\sum_k 4 q_k a_k^2 \sigma_k^2 d_k d_k^T\Big)
   N^{-1}, \quad N = \sum_k a_k d_k d_k^T  \tag{U1}

when sigma is known. Type A takes for it the least scatter of the distances to an
ellipsoid nearby,

.. math:: s^2 = \min_\delta \sum_k \frac{(c_k + d_k^T \delta)^2}{4 q_k} \Big/ (n-9)
   \tag{U2}

which is :math:`\sigma^2 \chi^2_{n-9}/(n-9)` to first order; at the minimum of the
weighted and Sampson residuals :math:`\delta = 0`. The scatter about the squared or norm
residual's own ellipsoid is greater where the axes differ in scale, by a third at 12
poses and scales 1 to 3. The textbook :math:`s^2 (J^T J)^{-1}` would hold the
residuals c for equally noisy, which they then are not (5 % of spread costs 3 % of a
sd). For a robust loss with influence function :math:`\psi`, both cases take Huber's
:math:`s^2 = \kappa^2 \sum\psi_k^2 / (n-9) / \overline{\psi'}^2`  (U3),
:math:`\kappa = 1 + (9/n) \mathrm{var}(\psi')/\overline{\psi'}^2`, which a few
outliers do not move.

**How many quadrics pass through the poses within their noise.**

A quadric with coefficients v has the value :math:`m_k^T v` at a reading, and noise s
of the reading moves it by s times its gradient. So the noise of each axis that lets a
quadric through the poses is the root of :math:`v^T G_c v / v^T C v`, and the roots
:math:`s_1 \le s_2 \le \ldots` of the pencil

.. math:: \det(G_c - s^2 C) = 0, \quad
   G_c = \sum_k w_k (m_k - \bar m)(m_k - \bar m)^T, \quad
   C = \sum_k w_k \frac{\partial m_k}{\partial y} \frac{\partial m_k}{\partial y}^T
   \tag{N1}

rank them: the first is the ellipsoid's own, the second says how far the next one is.
Poses below rank nine have a second quadric through them, so :math:`s_2` is noise, too.
Nothing is fitted, so no axis is stretched until its noise looks like poses; and a
shear or a scale of the axes changes the rank of no pose set.

Where two quadrics pass through the poses, their values are Gaussian to first order and
the ratio of the two roots is that of the singular values of (n - 8) x 2 random numbers,
which exceeds x with the probability

.. math:: \left(\frac{2x}{1 + x^2}\right)^{\nu}, \quad \nu = n - 9,  \tag{N2}

the law of Mauchly's test of sphericity in two dimensions. So s_2 must exceed the noise
found in the residuals by a factor that is great where few of them are left.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array, outer
from simval.errors import GeometryError, RefusedError
from simval.imu.calibrate.minimization import normalized
from simval.imu.calibrate.residuals import (
    LOSSES,
    WEIGHTED,
    moment_matrix,
    monomial_rows,
    monomial_slopes,
    monomials,
    residual_quadric,
    residual_values,
    value_derivatives,
)
from simval.imu.calibrate.solver import Code, inverse_root, negative_pivots
from simval.imu.sensor.readable import NORMAL_95
from simval.poses import PARAMETERS, describe, observability
from simval.shapes import Float
from simval.spelling import counted


class Summary(NamedTuple):
    """Statistics of each trial at its solution, in scaled units."""

    covariance: Float[Array, "t 9 9"]  # covariance of theta; NaN where there is none
    cost: Float[Array, " t"]  # sum of squared residuals
    rms: Float[Array, " t"]  # root mean square of the norm less one
    # chi-square per degree of freedom; NaN without sigma
    chi2_per_dof: Float[Array, " t"]
    # standard deviation of the distances, by degree of freedom
    distance_std: Float[Array, " t"]
    steepness: Float[Array, " t"]  # root mean square of the gradient of c


def summarize(
    model: str,
    residual: str,
    theta: Float[Array, "t 9"],
    m: Float[Array, "t 10 n"],
    moments: Float[Array, "t 10 10"],
    *,
    sigma: Float[Array, "t n"] | None,
    loss: str = "linear",
    ratio: Float[Array, "t n"] | None = None,
    shares: Float[Array, "t n"] | None = None,
    covariance: bool = True,
) -> Summary:
    """Covariance and statistics of each trial at its solution."""
    c, q = residual_values(model, theta, m)
    dof = m.shape[2] - 9
    a = None  # of eq. (U1); None for 1
    if residual in WEIGHTED:
        a = 0.25 / q if shares is None else 0.25 / q * shares
    weighed = c if a is None else a * c
    distance2 = 0.25 * c * c / q
    chi2 = spread = np.full(len(m), np.nan)
    if dof > 0:
        spread = np.sqrt(distance2.sum(axis=-1) / dof)
    if sigma is not None and dof > 0:
        known = np.asarray((sigma > 0.0).all(axis=-1))
        size = np.where(known[:, None], sigma, np.nan)
        chi2 = (distance2 / size**2).sum(axis=-1) / dof
    matrix = np.full((len(m), 9, 9), np.nan)
    if covariance and (dof > 0 or (sigma is not None and ratio is None)):
        dv = value_derivatives(residual_quadric(model, theta))
        if ratio is not None:
            weight = np.ones(m.shape[2]) if shares is None else shares
            variance = _huber_variance(np.sqrt(distance2 * weight), ratio, loss)
            variance = variance[:, None] / weight
        elif sigma is not None:
            variance = sigma**2
        else:
            own = spread * spread if a is not None else _least_scatter(dv, m, c, q)
            variance = own[:, None]
        middle = 4.0 * q * variance
        normal = moments if a is None else moment_matrix(m, a)
        weights = middle if a is None else a * a * middle
        root, _ = inverse_root(dv.mT @ (normal @ dv))
        inverse = root.mT @ root  # of N
        matrix = inverse @ (dv.mT @ (moment_matrix(m, weights) @ dv)) @ inverse
    norm = np.sqrt(np.maximum(1.0 + c, 0.0)) - 1.0
    squares = np.vecdot(norm, norm)
    return Summary(
        covariance=matrix,
        cost=squares if residual == "norm" else np.vecdot(weighed, c),
        rms=np.sqrt(squares / m.shape[2]),
        chi2_per_dof=chi2,
        distance_std=spread,
        steepness=2.0 * np.sqrt(q.mean(axis=-1)),
    )


def _least_scatter(
    dv: Float[Array, "t 10 9"],
    m: Float[Array, "t 10 n"],
    c: Float[Array, "t n"],
    q: Float[Array, "t n"],
) -> Float[Array, " t"]:
    # eq. (U2)
    w = 0.25 / q
    pull = np.vecmat(np.matvec(m, w * c), dv)
    root, _ = inverse_root(dv.mT @ (moment_matrix(m, w) @ dv))
    drawn = np.matvec(root, pull)
    least = np.vecdot(w * c, c) - np.vecdot(drawn, drawn)
    return np.maximum(least, 0.0) / (m.shape[2] - 9)  # rounding may leave -1e-32


def _huber_variance(
    distance: Float[Array, "t n"], ratio: Float[Array, "t n"], loss: str
) -> Float[Array, " t"]:
    # eq. (U3)
    count = distance.shape[-1]
    pull = distance * LOSSES[loss].weight(ratio)
    slope = LOSSES[loss].slope(ratio)
    mean = slope.mean(axis=-1)
    total = np.vecdot(pull, pull) / max(count - 9, 1)
    with np.errstate(divide="ignore", invalid="ignore"):  # no pose is near: NaN
        inflation = 1.0 + 9.0 / count * slope.var(axis=-1) / mean**2
        return inflation**2 * total / mean**2


FALSE_ACCEPTANCE = 1e-3  # of poses with two quadrics through them, by (N2)

# The greatest error of a combination of parameters is about the noise over s_2; beyond
# 1/7 the terms of second order, left out of the error bars, reach a seventh of them.
NOISE_MARGIN = 7.0

# In units of the root mean square reading. No mean of a hold is off by a tenth of
# gravity: s_2 above that is shape, whatever the residuals. Even poses have a s_2 of 0.2
# (9 poses) to 0.31, with scales up to a factor 4 apart 0.107 or more; rank-deficient
# ones at 0.3 m/s^2 of noise reach it in two of 48 000 sets of 9 to 20 poses.
GREATEST_NOISE = 0.1


# C of eq. (N1) by the moments of x, y, z and 1; of each entry of C two at most
_GRADIENTS = np.einsum("iak,jal->ijkl", *2 * [monomial_slopes()]).reshape(81, 16)


def pencil(
    moments: Float[Array, "t 10 10"],
) -> tuple[Float[Array, "t 9 9"], Float[Array, "t 9 9"]]:
    """The two matrices of the eigenvalue problem (N1)."""
    mean = moments[:, :9, 9]
    middle = outer(mean / moments[:, 9:, 9], mean)
    products = np.matvec(_GRADIENTS, moments[:, 6:, 6:].reshape(-1, 16))
    return moments[:, :9, :9] - middle, products.reshape(-1, 9, 9)


def required_noise(
    level: Float[Array, " t"], dof: int, *, known: bool
) -> Float[Array, " t"]:
    """The least noise s_2 with which poses are accepted, in the unit of the level."""
    factor = NOISE_MARGIN
    if not known and dof > 0:
        tail = FALSE_ACCEPTANCE ** (1.0 / dof)
        factor = max(factor, (1.0 + np.sqrt(1.0 - tail * tail)) / tail)  # of (N2)
    return np.fmin(factor * level, GREATEST_NOISE)


def ambiguous(moments: Float[Array, "t 10 10"], limit: Float[Array, " t"]) -> Any:
    """True where the poses fit a second quadric too, within the limit.

    By Sylvester's law of inertia the roots of (N1) below the limit are as many as the
    negative pivots of G_c - limit^2 C.
    """
    scatter, noise = pencil(moments)
    return negative_pivots(scatter - (limit * limit)[:, None, None] * noise) > 1


# An uncalibrated sensor is within some percent of its nominal scale, so error bars
# wider than this say less than its data sheet. Of caps and of jittered rank-deficient
# poses one in a thousand came out wrong by 10 percent with 0.1, two with 0.2; of 12
# even poses at 0.4 m/s^2, beyond any suite's noise, 0.1 would refuse a tenth.
WIDEST = 0.15


def judge(
    code: Any,
    m: Float[Array, "t 10 n"],
    moments: Float[Array, "t 10 10"],
    noise: Float[Array, "t n"] | None,
    summary: Summary,
    shares: Float[Array, "t n"] | None,
    *,
    condition: Float[Array, " t"],
    stretch: Float[Array, " t"],
) -> tuple[Any, Float[Array, " t"]]:
    """Refuse trials whose poses and noise cannot support their answer.

    Also the 95 percent half-width of the scale along its worst direction, relative; NaN
    where the noise is not known.
    """
    level = summary.distance_std
    if noise is not None:  # a noise that is stated too low hides nothing
        # root mean variance of the weighted readings over their mean weight
        weights = np.ones(noise.shape[1]) if shares is None else shares
        mean = np.vecdot(noise * noise, weights) / weights.sum(axis=-1)
        known, chi = np.sqrt(mean), np.sqrt(summary.chi2_per_dof)
        level = np.fmax(known, np.where(np.isnan(chi), level, known * chi))
    if shares is not None:
        moments = moment_matrix(m, shares)
    dof = m.shape[2] - PARAMETERS
    limit = required_noise(level, dof, known=noise is not None)
    half_width = NORMAL_95 * level * summary.steepness * np.sqrt(stretch)
    judged = np.where(half_width > WIDEST, Code.WIDE, code)
    # the condition of the corrected poses could be made of noise
    stretched = condition * level * NOISE_MARGIN > 1.0
    judged = np.where(stretched, Code.NOISE_RANK, judged)
    judged = np.where(code == Code.CONVERGED, judged, code)
    return np.where(ambiguous(moments, limit), Code.NOISE_RANK, judged), half_width


FEW = 3  # degrees of freedom; below, the factor of eq. (N2) exceeds 20
STATE_NOISE = "state `noise_std` if it is known"
REPEATS = "or pass `repeats=True` if these are single quantised samples"
_RANK_TOLERANCE = 1e-7  # relative; what a scatter matrix of readings can resolve


def screen(
    poses: Float[Array, "t n 3"],
    raw_range: Float[Array, "t 3 2"],
    *,
    full_scale: float | None,
    repeats: bool,
) -> Any:
    """Code of each trial from its readings alone, before any fit."""
    code = np.full(poses.shape[0], Code.CONVERGED)
    finite = np.isfinite(raw_range).all(axis=(-2, -1))
    if not repeats:
        ordered = np.sort(poses[..., 0], axis=-1)
        suspects, _ = np.nonzero(ordered[:, 1:] == ordered[:, :-1])
        for row in set(suspects.tolist()):
            if repeated_poses(poses[row]).size:
                code[row] = Code.DUPLICATES
    if full_scale is not None:
        clipped = (np.abs(raw_range) >= full_scale).any(axis=(-2, -1))
        code[clipped] = Code.SATURATED
    code[~finite] = Code.NON_FINITE
    return code


def repeated_poses(poses: Float[Array, "n k"]) -> Any:
    """Indices of readings that equal an earlier one bit by bit."""
    _, first = np.unique(poses, axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(poses)), first)


def repeated_words(poses: Float[Array, "n k"], of: str = "") -> str:
    """Say which readings equal an earlier one, and what to do."""
    index = repeated_poses(poses)[0]
    same = np.flatnonzero((poses == poses[index]).all(axis=1))[0]
    return (
        f"poses {same} and {index} are identical in every bit{of}; means of two holds "
        "never are, so the same data was counted twice: remove one"
    )


def refuse(
    code: int,
    poses: Float[Array, "n 3"],
    *,
    full_scale: float | None,
    limit: float,
    condition: float,
    half_width: float,
    suspects: Sequence[tuple[int, float]] = (),
) -> None:
    """Raise the error of one refused set; geometry if its poses leave the fit open."""
    if code == Code.DUPLICATES:
        msg = f"{repeated_words(poses)}, {REPEATS}"
        raise RefusedError(msg)
    if code == Code.SATURATED:
        bound = float(np.inf if full_scale is None else full_scale)
        pose, axis = np.argwhere(np.abs(poses) >= bound)[0]
        msg = (
            f"pose {pose} reads {poses[pose, axis]:g} on axis {'xyz'[axis]}, at "
            f"or beyond full scale ({bound:g}); a saturated reading does not "
            "show the force, so remove the pose, or use a wider range"
        )
        raise RefusedError(msg)
    if suspects:
        off = " and ".join(
            f"pose {pose} ({size:.3g} standard deviations off)"
            for pose, size in suspects
        )
        many = len(suspects) > 1
        what, them = ("do not lie", "them") if many else ("does not lie", "it")
        msg = (
            f"{off} {what} on the ellipsoid of the other {len(poses) - len(suspects)} "
            f"poses, and without {them} they calibrate: look at the hold for a push, a "
            f"collision or another unit, leave {them} out and calibrate again"
        )
        raise RefusedError(msg)
    if code == Code.WIDE:
        msg = (
            f"the scale is uncertain by {100.0 * half_width:.0f} percent along some "
            f"direction (95 percent half-width), and at most {100.0 * WIDEST:.0f} "
            f"percent is accepted: {_advice(poses)}, or hold each pose longer"
        )
        raise RefusedError(msg)
    raise GeometryError(_geometry_message(code, poses, condition, limit))


def _directions(poses: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    # unit vectors of the readings from their middle, the ellipsoid made round
    offset = _rounded(poses)
    length = np.linalg.norm(offset, axis=-1)
    return offset[length > 0.0] / length[length > 0.0, None]


def _advice(poses: Float[Array, "n 3"]) -> str:
    geometry = observability(_directions(poses))
    helps = ", ".join(f"{x:.2f}" for x in geometry.next_direction)
    return (
        f"add poses between them, first one with the specific force along ({helps}) "
        "in sensor axes"
    )


def _noise_message(poses: Float[Array, "n 3"]) -> str:
    # how near a second quadric is, and what else would tell it from noise
    z, _, scale = normalized(poses[None])
    scatter, noise = pencil(moment_matrix(monomial_rows(z)))
    values = np.linalg.eigvals(np.linalg.solve(noise[0], scatter[0])).real
    enough = np.sqrt(max(np.sort(values)[1], 0.0)) * scale[0]  # s_2 of eq. (N1)
    message = (
        f"noise of {enough:.2g} raw units in each reading is enough to let "
        "a second quadric through them, so their shape does not stand out "
        "of the noise"
    )
    dof = len(poses) - PARAMETERS
    if dof > FEW:
        return message
    left = counted(dof, "degree of freedom", "degrees of freedom")
    told = f"{left} say too little of the noise"
    return f"{message}, and {told}: {STATE_NOISE}"


def _geometry_message(
    code: int, poses: Float[Array, "n 3"], condition: float, limit: float
) -> str:
    # Say what the poses leave open, and which pose would help.
    directions = _directions(poses)
    if len(directions) == 0:
        return (
            f"all {len(poses)} poses read the same; a calibration needs {PARAMETERS} "
            "or more different directions"
        )
    what, advice = describe(directions), _advice(poses)
    if code == Code.CONDITION:
        return (
            f"the {len(poses)} poses ({what}) are ill-conditioned: {condition:.3g}, at "
            f"most {limit:g} is accepted; they cover too little of the sphere to "
            f"separate bias from scale; {advice}"
        )
    if code == Code.NOISE_RANK:
        return (
            f"the {len(poses)} poses ({what}) show fewer than {PARAMETERS} "
            f"combinations of parameters above their noise: {_noise_message(poses)}; "
            f"{advice}"
        )
    if code == Code.NOT_ELLIPSOID:
        return (
            f"the best quadric through the {len(poses)} poses ({what}) is not an "
            "ellipsoid: the readings are not all of the same gravity, or lie too close "
            f"together; check for outliers and units, and {advice}"
        )
    columns = monomials(_rounded(poses))[:, :9]
    rank = np.linalg.matrix_rank(columns, rtol=_RANK_TOLERANCE)
    return (
        f"the {len(poses)} poses ({what}) have rank {min(rank, 8)} of "
        f"{PARAMETERS}, so they do not determine all parameters; {advice}"
    )


def _rounded(poses: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    # offsets from the middle, the ellipsoid made round by the symmetric root of their
    # scatter, which keeps the axes; a direction without any extent stays flat
    offset = poses - (poses.max(axis=0) + poses.min(axis=0)) / 2.0
    greatest = np.abs(offset).max()
    offset = offset / (greatest if greatest > 0.0 else 1.0)
    values, vectors = np.linalg.eigh(offset.T @ offset / len(offset))
    flat = ~(values > _RANK_TOLERANCE**2 * values[-1])
    root = 1.0 / np.sqrt(np.where(flat, 1.0, values))
    return offset @ (vectors * np.where(flat, 0.0, root)) @ vectors.T
