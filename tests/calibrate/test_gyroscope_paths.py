"""Path statistics and their derivative, against integrators that share no step."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from simval.calibrate.gyroscope.moves import (
    SCHEMES,
    cross,
    merged,
    path_statistics,
)
from simval.calibrate.gyroscope.turn import (
    bias_slopes,
    end_of,
    map_of,
    map_slopes,
    turn,
    wander,
)

RNG = np.random.default_rng(7)
M = np.eye(3) + 0.05 * RNG.standard_normal((2, 3, 3))
B = 0.1 * RNG.standard_normal((2, 3))


def smooth_rate(t):
    """A rate that is zero at both ends, with its axis turning; raw units.

    Three derivatives are zero there too: of a minimum-jerk move the second is not, and
    a cubic across that end is of order three.
    """
    hump = 630.0 * t**4 * (1.0 - t) ** 4
    return np.stack(
        [
            2.0 * hump * np.cos(3.0 * t),
            -1.5 * hump * np.sin(2.0 * t + 0.4),
            hump * (1.0 + t),
        ],
        axis=-1,
    )


def rows(n, scheme):
    """Rows of one second: 3 before, n + 1 from its start to its end, 3 after."""
    t = np.arange(-3, n + 4) / n
    inside = np.clip(t, 0.0, 1.0)
    if scheme != "averages":
        return np.where(((t >= 0) & (t <= 1))[:, None], smooth_rate(inside), 0.0)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mean = np.zeros((len(t), 3))
    for x, w in zip(nodes, weights, strict=True):
        at = t - (0.5 - 0.5 * x) / n
        moving = ((at > 0) & (at < 1))[:, None]
        mean += 0.5 * w * np.where(moving, smooth_rate(np.clip(at, 0, 1)), 0.0)
    return mean


def exact(matrix, bias):
    """The turn by SciPy's integrator of the kinematic equation, to 1e-12."""

    def slope(t, c):
        w = matrix @ (smooth_rate(np.array(t)) - bias)
        C = c.reshape(3, 3)
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return (C @ skew).ravel()

    found = solve_ivp(slope, (0, 1), np.eye(3).ravel(), rtol=1e-12, atol=1e-13)
    return found.y[:, -1].reshape(3, 3)


def by_scheme(n, scheme, chunk=1, matrix=M[:1], bias=B[:1]):
    made = path_statistics(
        rows(n, scheme)[None], np.full(n + 7, 1.0 / n),
        np.array([3]), np.array([n + 3]), scheme, chunk,
    )  # fmt: skip
    return made, end_of(made, matrix, bias)[0, 0]


def off(C, truth):
    return Rotation.from_matrix(C @ truth.T).magnitude()


@pytest.mark.parametrize(
    ("scheme", "order"), [("averages", 4), ("cubic", 4), ("linear", 2)]
)
def test_order_of_each_integrator(scheme, order):
    """Halving the step divides the error by 2 to the order; without a bias, whose jump
    at the ends of the rate no scheme is asked to follow."""
    truth = exact(M[0], np.zeros(3))
    none = np.zeros((1, 3))
    error = [off(by_scheme(n, scheme, bias=none)[1], truth) for n in (50, 100, 200)]
    slopes = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(slopes, order, atol=0.3)


def test_runge_kutta_on_samples_is_the_linear_scheme():
    """IMU-TK's and INSLIB's integrator, written out: the same error, of order two."""

    def rate_matrix(w):
        x, y, z = w
        return np.array([[0, z, -y, x], [-z, 0, x, y], [y, -x, 0, z], [-x, -y, -z, 0]])

    for n in (50, 100):
        w = rows(n, "linear")[3 : n + 4] @ M[0].T
        q, h = np.array([0.0, 0.0, 0.0, 1.0]), 1.0 / n
        for a, b in itertools.pairwise(w):
            k1 = 0.5 * rate_matrix(a) @ q
            k2 = 0.5 * rate_matrix(0.5 * (a + b)) @ (q + 0.5 * h * k1)
            k3 = 0.5 * rate_matrix(0.5 * (a + b)) @ (q + 0.5 * h * k2)
            k4 = 0.5 * rate_matrix(b) @ (q + h * k3)
            q = q + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
            q /= np.linalg.norm(q)
        ours = by_scheme(n, "linear", bias=np.zeros((1, 3)))[1]
        truth = exact(M[0], np.zeros(3))
        error = off(ours, truth)
        # what Runge-Kutta's own fourth order leaves is small beside the straight lines'
        assert off(Rotation.from_quat(q).as_matrix(), ours) < 0.02 * error
        assert error > 1e-5


def test_without_the_coning_term_the_order_is_two():
    """Power: S alone, no A and m, is what the mean rate gives."""
    truth = exact(M[0], np.zeros(3))
    error = []
    for n in (50, 100):
        made, _ = by_scheme(n, "averages")
        made[:, :, 3:9] = 0.0
        error.append(off(end_of(made, M[:1], np.zeros((1, 3)))[0, 0], truth))
    assert 1.8 < np.log2(error[0] / error[1]) < 2.2
    assert error[1] > 100 * off(
        by_scheme(100, "averages", bias=np.zeros((1, 3)))[1], truth
    )


def test_chunks_hold_any_matrix_and_bias():
    """(N1): the same ten numbers, another M and B; against chunks of one step."""
    for matrix, bias in zip(M, B, strict=True):
        one = by_scheme(400, "averages", 1, matrix[None], bias[None])[1]
        error = [
            off(by_scheme(400, "averages", c, matrix[None], bias[None])[1], one)
            for c in (2, 4, 8)
        ]
        # what is left out is of the third order in a chunk's angle, 0.03 rad and more,
        # and of alternating sign along a smooth path
        assert error[0] < error[1] < error[2] < 1e-4
        assert error[1] / error[0] > 3.5


def test_merging_is_exact_for_the_first_two_orders():
    """(N2) against the double integral by brute force over pieces."""
    y = RNG.standard_normal((1, 40, 3))
    step = RNG.uniform(0.5, 1.5, 40)
    first, last = np.array([2]), np.array([34])
    made = path_statistics(y, step, first, last, "averages", 1)
    whole = merged(made, 32)[0, 0, :, 0]
    S, tau = made[0, 0, :3].T, made[0, 0, 9]
    A, m = made[0, 0, 3:6].sum(axis=1), made[0, 0, 6:9].sum(axis=1)
    for a in range(32):
        for b in range(a + 1, 32):
            A = A + 0.5 * np.cross(S[a], S[b])
            m = m + 0.5 * (tau[a] * S[b] - tau[b] * S[a])
    np.testing.assert_allclose(whole, [*S.sum(0), *A, *m, tau.sum()], rtol=1e-11)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("chunk", [1, 4])
def test_derivative_is_that_of_the_turn(scheme, chunk):
    """(N3), (N4) against central differences of the turns, whose own code has no J."""
    y = RNG.standard_normal((2, 400, 3)).cumsum(axis=1) * 0.2
    first = np.array([3, 100, 220])
    made = path_statistics(
        y, np.full(400, 0.01), first, first + np.array([90, 60, 77]), scheme, chunk
    )
    found = turn(made, M, B)
    np.testing.assert_allclose(found.C, end_of(made, M, B), atol=1e-13)
    h = 1e-6
    for p in range(12):
        ends = []
        for s in (h, -h):
            M2, B2 = M.copy(), B.copy()
            if p < 9:
                M2[:, p // 3, p % 3] += s
            else:
                B2[:, p - 9] += s
            ends.append(end_of(made, M2, B2))
        turned = ends[0] @ np.swapaxes(ends[1], -1, -2)
        theta = Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec() / (2 * h)
        # rounding 1e-16 / 2e-6 and h^2 of the third derivative
        np.testing.assert_allclose(
            found.slopes[..., p], theta.reshape(2, 3, 3), atol=5e-9 * 4.0
        )


def test_map_slopes_by_complex_step():
    """dF, eq. (N4), to rounding: F is a polynomial."""
    slopes = map_slopes(M, B)
    h = 1e-30
    for p in range(12):
        M2, B2 = M.astype(complex), B.astype(complex)
        if p < 9:
            M2[:, p // 3, p % 3] += 1j * h
        else:
            B2[:, p - 9] += 1j * h
        exactly = map_of(M2, B2).imag / h
        np.testing.assert_allclose(slopes[..., p], exactly.reshape(2, 30), atol=1e-15)


def test_wander_is_the_covariance_of_white_noise():
    """Against the turns of noisy rows, 4000 draws: five standard errors an entry."""
    n, draws = 60, 4000
    rng = np.random.default_rng(3)
    clean, step = rows(n, "averages"), np.full(n + 7, 1.0 / n)
    noise = 1e-4 * np.sqrt(n) * rng.standard_normal((draws, n + 7, 3))
    first, last = np.array([3]), np.array([n + 3])
    made = path_statistics(clean + noise, step, first, last, "averages", 1)
    base = path_statistics(clean[None], step, first, last, "averages", 1)
    one, zero = M[:1], np.zeros((1, 3))
    C = end_of(base, one, zero)[0, 0]
    ends = end_of(made, np.repeat(one, draws, 0), np.zeros((draws, 3)))[:, 0]
    theta = Rotation.from_matrix(ends @ C.T).as_rotvec()
    expected = wander(turn(base, one, zero), base, 1e-4 * one)[0, 0]
    seen = theta.T @ theta / draws
    sd = np.sqrt(
        (np.outer(expected.diagonal(), expected.diagonal()) + expected**2) / draws
    )
    assert np.all(np.abs(seen - expected) < 5.0 * sd)  # 6 entries: 3e-6 of false alarm


def test_bias_with_weight_one_is_the_bias():
    made, _ = by_scheme(100, "averages")
    found = turn(made, M[:1], B[:1])
    even = bias_slopes(found, made, M[:1], B[:1], np.ones((1, made.shape[-1])))
    np.testing.assert_allclose(even, found.slopes[..., 9:], atol=1e-14)


def test_cross_is_numpys():
    a, b = RNG.standard_normal((2, 4, 3, 5))
    expected = np.cross(a, b, axis=-2)
    np.testing.assert_allclose(cross(a, b), expected, atol=1e-15)
