"""The centre of greatest leverage is the squared residual's ellipsoid.

The oracles share no step with the code: constrained least squares over the poses, the
complex step, Gauss-Newton with the Jacobian of poses by coefficients, and arithmetic
with 50 digits.
"""

import mpmath
import numpy as np
import pytest
from rounding import EPS
from true_sensor import MODEL, PARAMETERS, G

from simval.calibrate import calibrate
from simval.calibrate.minimization import Leverage, fit_ellipsoid, minimize_leverage
from simval.calibrate.residuals import moment_matrix, monomials
from simval.calibrate.solver import Code, Rules
from simval.poses import fibonacci_sphere, random_directions
from simval.sensor import forms

RULES = Rules(method="lm", step=1.0, tolerance=1e-12, max_iterations=50)
CENTRE = np.array([0.03, -0.02, 0.01])  # near that of the readings below


def readings(count, noise, seed=0):
    rng = np.random.default_rng(seed)
    z = fibonacci_sphere(count) * [1.0, 0.9, 1.1] + CENTRE
    return z + noise * rng.standard_normal((count, 3))


def half_inverse(z, b):
    """1/2 psi by its definition, psi = s m'G^-1m, also of a complex b."""
    x, y, w = b
    m = np.array([x * x, y * y, w * w, x * y, x * w, y * w, x, y, w, 1.0])
    rows = monomials(z)
    p, *_ = np.linalg.lstsq(rows[:, :9], np.ones(len(z)), rcond=None)
    s = np.sum((rows[:, :9] @ p - 1.0) ** 2)
    # G = R'R, so m'G^-1m is the square of R^-T m, without conjugation
    seen = np.linalg.solve(np.linalg.qr(rows)[1].T.astype(m.dtype), m)
    return 0.5 / (s * np.sum(seen * seen))


def local(z, b, *, newton):
    return Leverage.of(moment_matrix(z[None])).local(b[None], newton=newton)


def test_the_least_cost_of_quadrics_that_are_minus_one_at_a_point():
    """Eq. (H1), by least squares over the poses in the null space of m(b)."""
    z = readings(20, 0.05)
    rows, at = monomials(z), monomials(CENTRE)
    leverage = Leverage.of(moment_matrix(z[None]))
    # v = v0 + N t with m'v0 = -1, N the null space of m
    v0 = -at / (at @ at)
    null = np.linalg.svd(at[None])[2][1:].T
    t, *_ = np.linalg.lstsq(rows @ null, -rows @ v0, rcond=None)
    v = v0 + null @ t
    found = leverage.local(CENTRE[None], newton=False).cost[0]
    cost = 2.0 * found * leverage.start_cost[0]
    bound = 200 * EPS * np.linalg.cond(rows) ** 2  # of normal equations
    np.testing.assert_allclose(cost, np.sum((rows @ v) ** 2), rtol=bound)
    gram = leverage.gram(CENTRE[None])[0]
    np.testing.assert_allclose(
        [*np.diag(gram), *2.0 * gram[[0, 0, 1], [1, 2, 2]]], v[:6], rtol=0, atol=bound
    )


@pytest.mark.parametrize("noise", [0.3, 0.03])
def test_gradient_and_hessian(noise):
    z, b = readings(20, noise), CENTRE + np.array([0.1, -0.05, 0.08])
    found = local(z, b, newton=True)
    h = 1e-30
    gradient = [half_inverse(z, b + 1j * h * e).imag / h for e in np.eye(3)]
    bound = 200 * EPS * np.linalg.cond(monomials(z)) ** 2
    np.testing.assert_allclose(found.cost[0], half_inverse(z, b), rtol=bound)
    np.testing.assert_allclose(found.gradient[0], gradient, rtol=0, atol=bound)

    def slope(step):
        ahead = [local(z, b + step * e, newton=False).gradient[0] for e in np.eye(3)]
        back = [local(z, b - step * e, newton=False).gradient[0] for e in np.eye(3)]
        return (np.array(ahead) - np.array(back)) / (2 * step)

    # Richardson leaves h^4 times a fifth derivative of order 1e3, and eps / h
    hessian = (4 * slope(5e-4) - slope(1e-3)) / 3
    np.testing.assert_allclose(found.hessian[0], hessian, rtol=0, atol=1e-9)
    # Gauss-Newton's matrix is another: the check can tell
    assert np.abs(found.normal[0] - hessian).max() > 1e-3 * noise


def test_its_step_is_gauss_newtons_in_the_nine_coefficients():
    """By QR of the Jacobian of all poses, with the constant a function of the nine."""
    z, b = readings(20, 0.05), CENTRE + np.array([0.05, 0.1, -0.1])
    here = local(z, b, newton=False)
    step = -np.linalg.solve(here.normal[0], here.gradient[0])
    jacobian = (monomials(z) - monomials(b))[:, :9]
    p, *_ = np.linalg.lstsq(jacobian, np.ones(len(z)), rcond=None)
    twice = np.array(
        [[2 * p[0], p[3], p[4]], [p[3], 2 * p[1], p[5]], [p[4], p[5], 2 * p[2]]]
    )
    bound = 200 * EPS * np.linalg.cond(jacobian) ** 2
    centre = -np.linalg.solve(twice, p[6:])
    np.testing.assert_allclose(b + step, centre, rtol=0, atol=bound)
    assert np.abs(step).max() > 0.05


def solved(z, b, **changed):
    rules = {name: getattr(RULES, name) for name in RULES.__slots__} | changed
    theta = np.concatenate([[0, 0, 0, 1, 1, 1], b])[None]
    leverage = Leverage.of(moment_matrix(z[None]))
    return minimize_leverage("triangular", leverage, theta, Rules(**rules), 1e-14)


@pytest.mark.parametrize(("method", "order"), [("newton", 2), ("gauss-newton", 1)])
def test_order_of_convergence(method, order):
    """The error after one step, by the error before it: a slope on two logarithms."""
    z = readings(20, 0.1)
    end = solved(z, CENTRE).theta[0, 6:]
    away = np.array([0.6, -0.5, 0.62])
    sizes = 2.0 ** -np.arange(4, 10)
    left = [
        np.linalg.norm(
            solved(z, end + h * away, method=method, max_iterations=1).theta[0, 6:]
            - end
        )
        for h in sizes
    ]
    slope = np.polyfit(np.log(sizes), np.log(left), 1)[0]
    # a sphere of poses is nearly even about its centre: Newton's is almost cubic
    assert slope > order - 0.1
    assert order == 2 or slope < order + 0.1
    # of Gauss-Newton about the share of sum c^2 is left, 0.06 here, not all
    assert left[0] < 0.2 * sizes[0]


@pytest.mark.filterwarnings("error")
def test_gauss_newton_never_raises_the_cost():
    """As long as it is an ellipsoid's; of 500 starts far from the centre."""
    rng = np.random.default_rng(3)
    z = readings(14, 0.1)
    leverage = Leverage.of(moment_matrix(z[None])).take(np.zeros(500, int))
    b = CENTRE + 0.4 * rng.standard_normal((500, 3))
    here = leverage.local(b, newton=False)
    fine = np.isfinite(here.cost)
    step = np.linalg.solve(
        np.where(fine[:, None, None], here.normal, np.eye(3)), here.gradient[..., None]
    )
    there = leverage.local(b - step[..., 0], newton=False)
    fine &= np.isfinite(there.cost)
    assert fine.sum() > 200
    assert np.all(there.cost[fine] <= here.cost[fine] * (1.0 + 64 * EPS))


def exact(y, bias):
    """The minimum with 50 digits: the root of the gradient at the centre."""
    with mpmath.workdps(50):
        rows = [[mpmath.mpf(float(v)) for v in one] for one in y]
        mean = [sum(column) / len(rows) for column in zip(*rows, strict=True)]
        places = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]

        def mono(x):
            return mpmath.matrix([*(x[i] * x[j] for i, j in places), *x, mpmath.mpf(1)])

        total = mpmath.matrix(10, 10)
        for row in rows:
            m = mono([a - b for a, b in zip(row, mean, strict=True)])
            total += m * m.T

        def best(b):
            v = mpmath.lu_solve(total, mono(b))
            a = mpmath.matrix(3, 3)
            for k, (i, j) in enumerate(places):
                a[i, j] = a[j, i] = v[k] / (1 if i == j else 2)
            return v, a

        def off(*b):
            v, a = best(list(b))
            return list(2 * a * mpmath.matrix(list(b)) + v[6:9, 0])

        start = [mpmath.mpf(float(b)) - c for b, c in zip(bias, mean, strict=True)]
        b = list(mpmath.findroot(off, start, tol=1e-70, maxsteps=50))
        v, a = best(b)
        a = a * mpmath.mpf(G) ** 2 / -(mono(b).T * v)[0]
        gram = np.array(a.tolist(), dtype=float)
        centre = np.array([float(x + c) for x, c in zip(b, mean, strict=True)])
        return forms.from_gram("triangular", gram, centre)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 0.02, 0.3])
def test_the_answer_to_fifty_digits(noise):
    rng = np.random.default_rng(5)
    y = MODEL.distort(G * fibonacci_sphere(14), rng)
    y += noise * rng.standard_normal(y.shape)
    fit = calibrate(y, G)
    assert fit.status == "converged"
    if noise == 0.0:  # the quadric is exact, its matrix of moments singular
        np.testing.assert_allclose(fit.parameters, PARAMETERS, rtol=0, atol=1e-13 * G)
        return
    # the stop rule leaves its 1e-12 times the share of sum c^2; rounding 1e-15 times
    # the square of the condition, 1.5 here, and of the shift to the mean
    np.testing.assert_allclose(fit.parameters, exact(y, fit.B), rtol=0, atol=1e-13 * G)


@pytest.mark.parametrize("seed", range(4))
def test_a_cap_is_answered_to_the_digits_that_it_has(seed):
    """A damped step in the nine parameters once stopped 9e-8 short of the minimum."""
    rng = np.random.default_rng([6, seed])
    directions = random_directions(400, rng)
    y = MODEL.distort(G * directions[directions[:, 2] > 0.77][:12], rng)
    y += 1e-4 * rng.standard_normal(y.shape)
    fit = calibrate(y, G)
    assert fit.status == "converged"
    assert fit.condition > 50
    # normal equations: eps times the square of the condition, in units of the fit
    bound = 100 * EPS * fit.condition**2
    assert np.abs(fit.parameters - exact(y, fit.B)).max() < bound * G


def test_no_ellipsoid_near_is_no_answer():
    """Readings of a hyperboloid, from a centre that is none of theirs."""
    rng = np.random.default_rng(7)
    z = rng.standard_normal((30, 3))
    z[:, 2] = np.sqrt(1.0 + z[:, 0] ** 2 + z[:, 1] ** 2) * rng.choice([-1, 1], 30)
    assert not fit_ellipsoid(moment_matrix(z[None])).proper[0]
    found = solved(z, CENTRE)
    assert found.code[0] != Code.CONVERGED
    np.testing.assert_array_equal(found.theta[0, 6:], CENTRE)
