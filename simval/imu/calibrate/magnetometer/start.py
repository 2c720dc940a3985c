r"""Starting points of a magnetometer's fit: closed form, or several for few poses.

**The start in closed form: an ellipsoid for each sensor, then the turn between them.**

The ellipsoids leave the up direction u of each pose and the field m in axes of the
magnetometer's own; with the turn R from these to the accelerometer's axes,
:math:`u^T R m + s = 0` is linear in (R, s),

.. math:: [\,u \otimes m,\ 1\,]\,(\mathrm{vec} R, s) = 0,  \tag{M3}

so they are the vector that all poses together see least, its nine entries made
orthogonal. Without noise it is exact, and it finds any order of the axes. A quadric
takes nine poses; where they are fewer, or fix none, a sphere stands in, which takes
four, and the steps of the solver do the rest.

**Few poses: several starts, and whether one answer alone fits.**

From twelve poses on the closed form (M3) starts within the noise. Below, its ellipsoids
and its turn are not fixed by the poses, and more than one calibration may fit: eight
poses are 24 equations for 22 unknowns. Then the turn is sought among all the turns of a
cube, and each of the best is solved twice, first with both sensors held near a sphere
(within `ROUND`), then freely; and from the best answer others are sought along what the
poses see least. The best answer counts; where another one explains the
poses as well, to within `APART` of chi-square, none does.

**The two-step calibration, for comparison: an ellipsoid of each sensor, then a
rotation.**

An unweighted ellipsoid for each sensor, :math:`M_m = R\,S` with S symmetric, and the
rotation R and the sine s of the dip with the least
:math:`\sum (u^T R S (y - b) + s)^2`. It throws away what the angle between the two
vectors says of shape and hard iron.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array, outer
from simval.errors import GeometryError, InputError
from simval.imu.calibrate.accelerometer import pose_means
from simval.imu.calibrate.equations import Prior, Problem, solved
from simval.imu.calibrate.gauss_newton import JointSolution, minimize
from simval.imu.calibrate.magnetometer.result import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
)
from simval.imu.calibrate.minimization import fit_ellipsoid, normalized
from simval.imu.calibrate.residuals import moment_matrix, monomial_rows
from simval.imu.sensor import forms
from simval.poses import axis_orders
from simval.shapes import Float

_QUADRIC = 9  # coefficients
# A quadric as flat as that is no sensor's, whose scales would differ by 100: a sphere
# stands in.
_FLATTEST = 1e-4
_STEPS = 8  # of Gauss-Newton for three angles and the dip: digits double in each


class Shape(NamedTuple):
    """An ellipsoid |M(z - b)| = 1, M symmetric."""

    root: Float[Array, "t 3 3"]
    bias: Float[Array, "t 3"]
    quadric: Any  # bool: whether the poses themselves gave it, (t,)


def start(problem: Problem) -> Float[Array, "t 22"]:
    """Starting point of the 22 parameters; a known accelerometer keeps its own."""
    body, iron = both_shapes(problem)
    turn, sine = turn_between(*seen(problem, body, iron))
    return assembled(body, iron, turn, sine)


def both_shapes(
    problem: Problem, *, spheres: bool = False
) -> tuple[Float[Array, "t 9"], Shape]:
    """Starting parameters of the accelerometer, and the magnetometer's ellipsoid."""
    least = np.inf if spheres else _QUADRIC
    iron = shape(problem.magnetometer.readings, least)
    if problem.prior is not None:
        return problem.prior.theta[:, ACCELEROMETER], iron
    own = problem.accelerometer
    body = shape(own.readings, least)
    return forms.from_gram(own.model, body.root @ body.root, body.bias), iron


def seen(
    problem: Problem, body: Float[Array, "t 9"], iron: Shape
) -> tuple[Float[Array, "t n 3"], Float[Array, "t n 3"]]:
    """Up in the accelerometer's axes, and the field in the magnetometer's own axes."""
    up = problem.accelerometer.corrected(body).w
    return up, (problem.magnetometer.readings - iron.bias[:, None]) @ iron.root


def assembled(
    body: Float[Array, "t 9"], iron: Shape, turn: Array, sine: Array
) -> Float[Array, "t 22"]:
    """The 22 parameters, from two ellipsoids and the turn between their axes."""
    theta = np.empty((len(body), PARAMETERS))
    theta[:, ACCELEROMETER] = body
    theta[:, MATRIX] = (turn @ iron.root).reshape(-1, 9)
    theta[:, IRON] = iron.bias
    theta[:, DIP] = sine
    return theta


def shape(z: Float[Array, "t n 3"], least: float = _QUADRIC) -> Shape:
    """The ellipsoid through each trial's readings; a sphere where there is none."""
    root: Array = np.empty((len(z), 3, 3))
    centre: Array = np.empty((len(z), 3))
    found = np.zeros(len(z), dtype=bool)
    if z.shape[1] >= least:
        ellipsoid = fit_ellipsoid(moment_matrix(monomial_rows(z)))
        proper = ellipsoid.proper & ellipsoid.determined
        gram = np.where(proper[:, None, None], ellipsoid.gram, np.eye(3))
        values, vectors = np.linalg.eigh(gram)
        found = proper & (values[:, 0] > _FLATTEST * values[:, 2])
        roots = np.sqrt(np.maximum(values, 0.0))
        root, centre = (vectors * roots[:, None, :]) @ vectors.mT, ellipsoid.bias
    if not found.all():
        centre[~found], radius = _spheres(z[~found])
        root[~found] = np.eye(3) / radius[:, None, None]
    return Shape(root=root, bias=centre, quadric=found)


def _spheres(
    z: Float[Array, "t n 3"],
) -> tuple[Float[Array, "t 3"], Float[Array, " t"]]:
    # |z|^2 = 2 z'b + (r^2 - b'b) is linear; readings in a plane take the least b
    columns = np.concatenate([2.0 * z, np.ones((*z.shape[:-1], 1))], axis=-1)
    p = np.linalg.pinv(columns, rcond=1e-6) @ np.sum(z * z, axis=-1)[..., None]
    centre = p[:, :3, 0]
    squared = p[:, 3, 0] + np.vecdot(centre, centre)
    return centre, np.sqrt(np.maximum(squared, 1e-12))


def turn_between(
    up: Float[Array, "t n 3"], field: Float[Array, "t n 3"]
) -> tuple[Float[Array, "t 3 3"], Float[Array, " t"]]:
    """Turn between the sensors' axes, and the sine of the dip, eq. (M3)."""
    count = len(up)
    rows = outer(up, field).reshape(count, -1, 9)
    rows = np.concatenate([rows, np.ones((*rows.shape[:-1], 1))], axis=-1)
    least = np.linalg.eigh(rows.mT @ rows)[1][:, :, 0]
    left, values, right = np.linalg.svd(least[:, :9].reshape(-1, 3, 3))
    size = values.mean(axis=1)
    # the nullest vector has either sign, and that of det R picks the twin
    sign = np.sign(np.linalg.det(left @ right))
    turn = sign[:, None, None] * (left @ right)
    sine = sign * least[:, 9] / np.where(size > 0.0, size, 1.0)
    return turn, np.clip(sine, -1.0, 1.0)


def refined(
    up: Float[Array, "t n 3"],
    field: Float[Array, "t n 3"],
    turn: Float[Array, "... 3 3"],
    sine: Float[Array, " t"],
) -> tuple[Float[Array, "t 3 3"], Float[Array, " t"]]:
    """Turn and sine of the dip that minimise the sum of (u'R m + s)^2."""
    for _ in range(_STEPS):
        turned = field @ turn.mT
        rows = np.cross(turned, up)  # d(u' exp([f x]) R m) = f . (R m x u)
        rows = np.concatenate([rows, np.ones((*rows.shape[:-1], 1))], axis=-1)
        off = np.vecdot(up, turned) + sine[:, None]
        normal = rows.mT @ rows
        step = -solved(normal, np.vecmat(off, rows))
        step = np.where(np.isnan(step), 0.0, step)  # singular: vectors are parallel
        turn, sine = _rotation(step[:, :3]) @ turn, sine + step[:, 3]
    return turn, sine


def _rotation(phi: Float[Array, "t 3"]) -> Float[Array, "t 3 3"]:
    # Cayley's map: a rotation to second order in phi, exactly orthogonal
    half = np.zeros((len(phi), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        half[:, k, j], half[:, j, k] = phi[:, i] / 2.0, -phi[:, i] / 2.0
    return np.linalg.solve(np.eye(3) - half, np.eye(3) + half)


ENOUGH = 12
"""Poses from which the closed form is enough: of 4500 random sets none went wrong."""
ROUND = 0.1
"""How far scales and angles of a sensor are from equal and square, as a rule."""
APART = 20.0
"""Of chi-square: the odds against the worse answer are then exp(10), 22 000."""
_MOST = 100  # steps of a trial
_STARTS = 6
_WEAKEST = 4  # directions of the parameters along which another answer is looked for
_SIZES = (-0.5, -0.2, 0.2, 0.5)  # of a jump, in scaled units
_SAME = 1e-3  # of the parameters in scaled units: two ends of the same answer


def solve(problem: Problem) -> tuple[JointSolution, Any]:
    """Solution of each trial, and whether it is the only one that fits."""
    with np.errstate(all="ignore"):  # a hopeless trial has NaN, and is refused
        if problem.accelerometer.readings.shape[1] >= ENOUGH:
            theta = start(problem)
            return minimize(problem, theta, _MOST), np.ones(len(theta), dtype=bool)
        found = []
        for theta in _starts(problem):
            held = replace(problem, prior=_rounded(problem, theta))
            theta = minimize(held, theta, _MOST).theta
            found.append(minimize(problem, theta, _MOST))
        best = _best(problem, found)[0]
        found += [minimize(problem, x, _MOST) for x in _jumps(problem, best.theta)]
        return _best(problem, found)


def _jumps(problem: Problem, theta: Float[Array, "t 22"]) -> list[Array]:
    # another answer lies along what the poses see least
    normal = problem.local(theta).normal
    usable = np.asarray(np.isfinite(normal).all(axis=(1, 2)))
    vectors = np.linalg.eigh(np.where(usable[:, None, None], normal, np.eye(22)))[1]
    return [theta + size * vectors[:, :, k] for k in range(_WEAKEST) for size in _SIZES]


def _rounded(problem: Problem, theta: Float[Array, "t 22"]) -> Prior:
    # shapes near those of the start, in natural sizes; the turn is left free
    model, prior = problem.accelerometer.model, problem.prior
    root = np.zeros((len(theta), 12, PARAMETERS))
    body = theta[:, ACCELEROMETER]
    inverse = np.linalg.pinv(forms.matrix(model, body))
    slopes = forms.matrix_derivatives(model, body) @ inverse[:, None]
    inverse_m = np.linalg.pinv(theta[:, MATRIX].reshape(-1, 3, 3))
    for row, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        root[:, row, :6] = slopes[:, :, i, j] + slopes[:, :, j, i]
        for a, b in ((i, j), (j, i)):  # (dM M^-1)_ab
            columns = slice(MATRIX.start + 3 * a, MATRIX.start + 3 * a + 3)
            root[:, 6 + row, columns] += inverse_m[:, :, b]
    root /= 2.0 * ROUND
    if prior is None:
        return Prior(theta=theta, root=root)
    # the two hold at different points: (R theta - R theta_0) is all that counts
    both = np.concatenate([root[:, 6:], prior.root], axis=1)
    held = np.array(theta)
    held[:, ACCELEROMETER] = prior.theta[:, ACCELEROMETER]
    return Prior(theta=held, root=both)


def _starts(problem: Problem) -> list[Float[Array, "t 22"]]:
    body, iron = both_shapes(problem, spheres=True)
    up, field = seen(problem, body, iron)
    turns, sines, costs = [], [], []
    orders = axis_orders()
    for turn in orders[np.linalg.det(orders) > 0.0]:
        sine = -np.mean(np.vecdot(up, field @ turn.T), axis=1)
        here, sine = refined(up, field, turn, sine)
        off = np.vecdot(up, field @ here.mT) + sine[:, None]
        cost = np.vecdot(off, off)
        turns.append(here)
        sines.append(sine)
        costs.append(np.where(np.isfinite(cost), cost, np.inf))
    order = np.argsort(np.array(costs), axis=0, kind="stable")
    every, trials = (np.array(turns), np.array(sines)), np.arange(len(up))
    # refined turns that came to the same place are tried once each: the first of them
    picks = _distinct(every[0], order)
    return [
        assembled(body, iron, every[0][pick, trials], every[1][pick, trials])
        for pick in picks
    ]


def _distinct(turns: Float[Array, "k t 3 3"], order: Any) -> list[Any]:
    # indices of the best turns of each trial that are not one and the same
    trials = np.arange(turns.shape[1])
    new = np.ones(order.shape, dtype=bool)
    for later in range(1, len(order)):
        one = turns[order[later], trials]
        for earlier in range(later):
            other = turns[order[earlier], trials]
            apart = np.abs(one - other).max(axis=(1, 2)) > 1e-3
            new[later] &= apart | ~new[earlier]
    rank = np.argsort(~new, axis=0, kind="stable")  # the new ones first, in order
    return [order[rank[place], trials] for place in range(_STARTS)]


def _best(problem: Problem, found: list[JointSolution]) -> tuple[JointSolution, Any]:
    costs = np.array([each.here.chi_square for each in found])
    ended = np.array([each.converged for each in found]) & np.isfinite(costs)
    costs = np.where(ended, costs, np.inf)
    thetas = np.array([each.theta for each in found])
    best, trials = np.argmin(costs, axis=0), np.arange(costs.shape[1])
    theta = thetas[best, trials]
    with np.errstate(invalid="ignore"):  # both may be infinite
        near = costs - costs[best, trials] < APART
    mirrored = twin(theta)  # is one with it
    apart = np.minimum(
        np.abs(thetas - theta).max(axis=-1), np.abs(thetas - mirrored).max(axis=-1)
    )
    with np.errstate(invalid="ignore"):
        left = np.linalg.det(theta[:, MATRIX].reshape(-1, 3, 3)) < 0.0
    upright = np.where(left[:, None], mirrored, theta)
    return JointSolution(
        theta=upright,
        here=problem.local(upright),
        iterations=sum(each.iterations for each in found),
        converged=np.isfinite(costs[best, trials]),
    ), ~np.any(near & (apart > _SAME), axis=0)


def twin(theta: Float[Array, "t 22"]) -> Float[Array, "t 22"]:
    """The other parameters that fit as well: (-M, -s)."""
    turned = np.array(theta)
    turned[:, MATRIX] *= -1.0
    turned[:, DIP] *= -1.0
    return turned


def ellipsoid_then_rotation(
    accelerometer: Any, magnetometer: Any
) -> Float[Array, "... 13"]:
    """Matrix, hard iron and dip of the two-step calibration, field strength 1.

    Parameters
    ----------
    accelerometer, magnetometer : array_like
        Mean reading of each pose, raw units, (n, 3) or (trials, n, 3), n nine or more.

    Returns
    -------
    Array
        Rows of M on the axes of the triangular form, b in raw units, and the dip in
        rad, (13,) or (trials, 13); NaN for a trial that is not finite.

    Raises
    ------
    InputError
        If a shape is wrong, or a reading of one set is not finite.
    GeometryError
        If a set fixes no ellipsoid.
    """
    named = {"accelerometer": accelerometer, "magnetometer": magnetometer}
    pair = [pose_means(name, value) for name, value in named.items()]
    if pair[0].shape != pair[1].shape:
        msg = (
            f"`accelerometer` has shape {pair[0].shape} and `magnetometer` "
            f"{pair[1].shape}; give the means of both sensors over the same poses, in "
            "the same order"
        )
        raise InputError(msg)
    batch = [readings.reshape(-1, *readings.shape[-2:]) for readings in pair]
    finite = np.isfinite(batch).all(axis=(0, 2, 3))
    result = np.full((len(batch[0]), 13), np.nan)
    if not np.any(finite):
        return result
    (za, _, _), (zm, centre, scale) = (normalized(each[finite]) for each in batch)
    body, iron = shape(za), shape(zm)
    if not (np.all(body.quadric) and np.all(iron.quadric)):
        msg = (
            "the readings of one sensor do not determine an ellipsoid; the "
            "two-step start needs one for each sensor, so turn the sensors to "
            "all sides"
        )
        raise GeometryError(msg)
    theta = forms.from_gram("triangular", body.root @ body.root, body.bias)
    matrix = forms.matrix("triangular", theta)
    up = (za - body.bias[:, None]) @ matrix.mT
    field = (zm - iron.bias[:, None]) @ iron.root
    turn, sine = refined(up, field, *turn_between(up, field))
    result[finite] = np.concatenate(
        [
            (turn @ iron.root / scale[:, None, None]).reshape(-1, 9),
            iron.bias * scale[:, None] + centre,
            np.arcsin(np.clip(sine, -1.0, 1.0))[:, None],
        ],
        axis=1,
    )
    return result[0] if pair[0].ndim == 2 else result
