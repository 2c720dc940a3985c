"""The theory of estimating equations, on a sensor that nobody calibrates here.

A dual-axis inclinometer on a table of known tilt errors: two rows a rest, which share
the noise of the table and have their own of the readings.
"""

import numpy as np
import pytest
from scipy.optimize import root

from simval.theory.estimating import Block, Estimating
from simval.theory.plans import error_bars, next_best

RESTS, TRUTH = 9, np.array([1.02, 0.03, -0.02, 0.98, 0.01, -0.02])
TILT = np.random.default_rng(5).uniform(-0.9, 0.9, (RESTS, 2))
SIGMA = np.repeat([[0.002, 0.002, 0.001]], RESTS, axis=0)  # of both axes, of the table
ZERO = np.zeros((RESTS, 3))


def axis(k, tilt, columns):
    """What is left of axis k: noise of its reading, then of the table."""

    def rows(theta, z):
        about = tilt + z[..., columns[1], None] * np.array([1.0, 0.5])
        gain = theta[:, None, 2 * k : 2 * k + 2]
        seen = np.sum(TRUTH[2 * k : 2 * k + 2] * np.sin(tilt), axis=-1)
        read = seen + TRUTH[4 + k] + z[..., columns[0]]
        left = np.sum(gain * np.sin(about), axis=-1) + theta[:, None, 4 + k] - read
        return left[..., None]

    return rows


def both(theta, z):
    """Rows of both axes."""
    return at(TILT)(theta, z)


def at(tilt):
    """Rows of both axes at these tilts."""
    return lambda theta, z: np.concatenate(
        [axis(k, tilt, (k, 2))(theta, z) for k in (0, 1)], axis=-1
    )


def whole(weights):
    """Each rest a block of two rows."""
    return Estimating(
        blocks=(Block(rows=both, y=ZERO, sigma=SIGMA),), theta=TRUTH, weights=weights
    )


def test_rows_that_share_a_noise_may_be_blocks_of_their_own():
    names = np.arange(3 * RESTS).reshape(RESTS, 3)
    parts = tuple(
        Block(
            rows=axis(k, TILT, (0, 1)),
            y=ZERO[:, :2],
            sigma=SIGMA[:, [k, 2]],
            noise=names[:, [k, 2]],
        )
        for k in (0, 1)
    )
    split, one = Estimating(blocks=parts, theta=TRUTH, weights="truth"), whole("truth")
    sd = np.sqrt(np.diagonal(one.covariance))
    np.testing.assert_allclose(split.bias / sd, one.bias / sd, atol=1e-10)
    for name in ("covariance", "bound"):
        apart = (getattr(split, name) - getattr(one, name)) / np.outer(sd, sd)
        np.testing.assert_allclose(apart, 0.0, atol=1e-10)


@pytest.mark.parametrize("weights", ["none", "estimate"])
def test_moments_are_those_of_the_solved_equations(weights):
    """A root is found with each noise moved; nothing of theory is differentiated."""
    theory = whole(weights)

    def equations(theta, z):
        eps = 1e-30
        ways = theta + 1j * eps * np.eye(6)
        J = np.moveaxis(both(ways, z + np.zeros((6, 1, 1))).imag / eps, 0, -1)
        c = both(theta[None], z[None])[0]
        if weights == "none":
            return np.einsum("nmp,nm->p", J, c)
        moved = z + 1j * eps * np.eye(3)[:, None]
        D = (
            np.moveaxis(both(np.tile(theta, (3, 1)), moved).imag / eps, 0, -1)
            * SIGMA[0]
        )
        V = D @ np.swapaxes(D, 1, 2)
        return np.einsum("nmp,nm->p", J, np.linalg.solve(V, c[..., None])[..., 0])

    moves = np.eye(3 * RESTS).reshape(-1, RESTS, 3) * SIGMA
    ends = [
        np.array([root(equations, TRUTH, args=(s * z,), tol=1e-13).x for z in moves])
        for s in (-1.0, 1.0)
    ]
    sd, slope = np.sqrt(np.diagonal(theory.covariance)), (ends[1] - ends[0]) / 2.0
    apart = (slope.T @ slope - theory.covariance) / np.outer(sd, sd)
    np.testing.assert_allclose(apart, 0.0, atol=1e-5)
    bias = 0.5 * np.sum(ends[0] + ends[1] - 2.0 * TRUTH, axis=0)
    np.testing.assert_allclose(bias / sd, theory.bias / sd, atol=1e-6)
    assert np.max(np.abs(theory.bias / sd)) > 1e-4
    # of draws of one noise each, the second order of the draws adds up to the bias
    each = theory.second(np.eye(3 * RESTS))
    np.testing.assert_allclose(each.sum(axis=0) / sd, theory.bias / sd, atol=1e-10)


def test_a_sensor_of_its_own_gets_its_plan():
    """The next rest of a grid: no other lowers the total variance more."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1.2, 1.2, 9)] * 2), -1).reshape(-1, 2)

    def rests(tilt):
        y = np.zeros((len(tilt), 3))
        sigma = np.repeat(SIGMA[:1], len(tilt), axis=0)
        return Estimating(blocks=(Block(rows=at(tilt), y=y, sigma=sigma),), theta=TRUTH)

    now, after, best = next_best(whole("estimate"), rests(grid))
    bars = [np.sqrt(np.diagonal(rests(np.vstack([TILT, each])).bound)) for each in grid]
    np.testing.assert_allclose(error_bars(after), bars[best], rtol=1e-10)
    total = np.sum(np.square(bars), axis=1)
    assert total[best] <= total.min() * (1.0 + 1e-6)
    np.testing.assert_allclose(
        error_bars(now), np.sqrt(np.diagonal(whole("estimate").bound)), rtol=1e-10
    )
    few = rests(TILT[:2])
    assert few.rank < len(TRUTH)
    assert np.isinf(error_bars(few.information.sum(axis=0))).all()
