"""Power series to every order: the error of order k is of order k + 2, by quadrature.

The oracle is a tensor product of Gauss-Hermite rules over the noise itself. It knows no
series: the estimator is called with plain arrays at the nodes.
"""

import numpy as np
import pytest

from simval.theory.series import series_moments

INPUTS = np.array([[0.5, 1.0, -0.5], [1.0, 0.25, 0.5]])
ROOTS = np.zeros((2, 3, 3))  # of the covariances, at noise 1: three normals
ROOTS[0, :2, :2] = [[1.0, 0.0], [-0.5, 0.75]]
ROOTS[1, 2, 2] = 0.5
NODES = 40  # a normal; 60 change no digit


def estimator(a, b):
    """Roots, a quotient and products, on series and on batches (3, n) alike.

    Every function is smooth as far as the quadrature looks.
    """
    length = (4.0 + a[0] + a[1] * a[1]) ** 0.5
    return [
        length - b[2] * b[2],
        a[1] / (3.0 + a[0] + b[2]),
        length * b[2] + 2.0 * a[0] * a[0] * a[0],
    ]


def quadrature(noise):
    """Mean and covariance of truth minus estimate."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    x = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij")).reshape(3, -1)
    w = np.prod(np.meshgrid(weights, weights, weights, indexing="ij"), axis=0).ravel()
    w /= w.sum()
    a = INPUTS[0][:, None] + noise * ROOTS[0][:, :2] @ x[:2]
    b = INPUTS[1][:, None] + noise * ROOTS[1][:, 2:] @ x[2:]
    error = np.array(estimator(*INPUTS))[:, None] - np.array(estimator(a, b))
    mean = error @ w
    off = error - mean[:, None]
    return mean, (off * w) @ off.T


def left_out(noise, order):
    """Bias and covariance that the series of an order leaves out, entry by entry."""
    covariances = noise**2 * ROOTS @ ROOTS.transpose(0, 2, 1)
    found = series_moments(estimator, INPUTS, covariances, order=order)
    mean, covariance = quadrature(noise)
    upper = np.triu_indices(3)
    return np.concatenate([found.bias - mean, (found.covariance - covariance)[upper]])


@pytest.mark.parametrize("order", [2, 4, 6])
def test_what_an_order_leaves_out_is_two_orders_higher(order):
    # between noise s and s/2 the next term falls by 2^(k+2), and the one after it, at
    # s = 0.2 up to a quarter of it, by 2^(k+4): the slope is k + 2 within 0.4. At s/2
    # and order 6 at least 2e-11 is left out, and rounding is 1e-15.
    coarse, fine = left_out(0.2, order), left_out(0.1, order)
    seen = np.abs(coarse) > 1e-9  # of one product the next two terms nearly cancel
    slope = np.log2(np.abs(coarse[seen] / fine[seen]))
    assert seen.sum() >= 8
    np.testing.assert_allclose(slope, order + 2.0, rtol=0, atol=0.4)
