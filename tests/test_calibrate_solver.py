"""The iteration by itself, on costs whose minimum is known."""

import numpy as np
import pytest

from simval.calibrate.solver import Code, Local, Rules, minimize

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
    np.testing.assert_allclose(steps[0], full / np.linalg.norm(full), atol=1e-4)
    # at the last, 1e12 of the mean, the elements of J'J are 1e-12 beside it
    np.testing.assert_allclose(steps[-1], np.full(9, 1.0 / 3.0), atol=1e-11)
