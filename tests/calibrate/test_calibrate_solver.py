"""The iteration by itself, on costs whose minimum is known."""

import numpy as np
import pytest

from simval.calibrate.solver import Code, Local, Rules, minimize, solve_positive, trace

TRUTH = np.arange(-4.0, 5.0)


def arctangents(theta, rows):
    """Residuals atan(theta - truth): a full step overshoots from beyond 1.39."""
    x = theta - TRUTH
    r, slope = np.arctan(x), 1.0 / (1.0 + x * x)
    normal = slope[:, :, None] ** 2 * np.eye(9)
    return Local(
        cost=0.5 * np.vecdot(r, r), gradient=slope * r, normal=normal, hessian=normal
    )


@pytest.mark.parametrize("method", ["lm", "gauss-newton"])
def test_a_step_that_raises_the_cost_is_damped_or_shortened_until_it_does_not(method):
    start = TRUTH + np.array([3.0, -3.0, 0.0, 2.0, -2.5, 0.1, 1.6, 3.0, -1.0])
    rules = Rules(method=method, step=1.0, tolerance=1e-9, max_iterations=60)
    found = minimize(arctangents, np.stack([start, TRUTH + 0.1]), rules, 0.0)
    assert found.code.tolist() == [Code.CONVERGED] * 2
    # cubic at the end: a last step of 1e-9 leaves rounding
    np.testing.assert_allclose(found.theta, [TRUTH] * 2, rtol=0, atol=1e-14)
    # the second never overshoots; six digits a step are not lost to old damping
    assert found.iterations[1] <= 6 < found.iterations[0]


def test_damping_turns_the_step_from_gauss_newtons_to_the_gradients():
    """On a cost that every step raises, so that each one tried is damped more."""
    normal, gradient = np.diag(np.logspace(-2, 0, 9)), np.ones(9)
    tried = []

    def wall(theta, rows):
        tried.append(theta[0])
        cost = np.array([1.0 if len(tried) == 1 else 2.0])
        return Local(
            cost=cost,
            gradient=gradient[None],
            normal=normal[None],
            hessian=normal[None],
        )

    rules = Rules(method="lm", step=1.0, tolerance=0.0, max_iterations=60)
    found = minimize(wall, np.zeros((1, 9)), rules, 0.0)
    assert found.code[0] == Code.STALLED
    assert not found.theta.any()  # no step was taken
    steps = [-step / np.linalg.norm(step) for step in tried[1:]]
    full = 1.0 / np.diag(normal)
    # a first damping of 1e-6 of the mean, 0.28, beside the least element, 0.01
    np.testing.assert_allclose(steps[0], full / np.linalg.norm(full), rtol=0, atol=1e-4)
    # at the last, 1e12 of the mean, the elements of J'J are 1e-12 beside it
    np.testing.assert_allclose(steps[-1], np.full(9, 1.0 / 3.0), rtol=0, atol=1e-11)


@pytest.mark.parametrize("method", ["lm", "gauss-newton", "newton"])
def test_steps_do_not_depend_on_the_unit_of_the_cost(method):
    """Powers of two scale exactly, so the steps are equal to the bit."""

    def tried(unit):
        points = []

        def objective(theta, rows):
            points.append(theta[0].copy())
            found = arctangents(theta, rows)
            parts = ("cost", "gradient", "normal", "hessian")
            return Local(**{name: unit * getattr(found, name) for name in parts})

        rules = Rules(method=method, step=1.0, tolerance=1e-9, max_iterations=20)
        minimize(objective, TRUTH[None] + 0.5, rules, 0.0)
        return points

    one = tried(1.0)
    assert len(one) > 3
    for unit in (2.0**-40, 2.0**40):
        np.testing.assert_array_equal(tried(unit), one)


@pytest.mark.filterwarnings("error")
def test_batched_solutions_and_pivots():
    rng = np.random.default_rng(41)
    root = rng.standard_normal((6, 12, 5))
    matrices = np.swapaxes(root, -1, -2) @ root
    units = 10.0 ** rng.uniform(-3, 3, (6, 5))
    matrices *= units[:, :, None] * units[:, None, :]
    right = rng.standard_normal((6, 5, 2))
    found, pivot = solve_positive(matrices, right)
    for one, b, x, p in zip(matrices, right, found, pivot, strict=True):
        diagonal = np.sqrt(np.diag(one))
        scaled = one / np.outer(diagonal, diagonal)
        expected = np.linalg.solve(scaled, b / diagonal[:, None]) / diagonal[:, None]
        # Cholesky and LU each: p^2 roundings, amplified by the condition
        bound = 2 * 25 * np.finfo(float).eps * np.linalg.cond(scaled)
        assert np.abs(x - expected).max() <= bound * np.abs(expected).max()
        # pivots of L D L' are the squares of Cholesky's diagonal
        least = np.min(np.diag(np.linalg.cholesky(scaled)) ** 2)
        assert abs(p - least) <= bound
    np.testing.assert_allclose(
        trace(matrices), np.einsum("tii->t", matrices), rtol=5 * np.finfo(float).eps
    )


@pytest.mark.filterwarnings("error")
def test_a_matrix_that_is_not_positive_has_no_solution_and_no_warning():
    good = np.eye(3)
    bad = [np.diag([1.0, -1.0, 1.0]), np.zeros((3, 3)), np.full((3, 3), 2.0)]
    # scaled to a unit diagonal, its other elements overflow
    far = np.array([[1e-300, 1e200, 0.0], [1e200, 1e-300, 0.0], [0.0, 0.0, 1.0]])
    matrices = np.stack([good, *bad, far])
    found, pivot = solve_positive(matrices, np.ones((5, 3, 1)))
    np.testing.assert_array_equal(found[0], np.ones((3, 1)))
    assert pivot[0] == 1.0
    assert np.isnan(found[1:]).all()
    assert not (pivot[1:] > 0.0).any()
