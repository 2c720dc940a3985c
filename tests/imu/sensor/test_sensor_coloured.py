"""Coloured noise against its Allan variance, from spectra and by brute force."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from simval.imu.sensor import NoiseModel
from simval.streams import cell_key, stream

KEY = cell_key("test coloured noise")
RATE = 50.0
N, B, K = 0.02, 0.3, 0.5  # each of the three is the largest somewhere
LENGTHS = (1, 2, 8, 60)  # rows in an average
DRAWS, ROWS = 40, 2048


def allan_variance(rows, m):
    """Mean square of the differences of neighbouring averages, one by one: (V2)."""
    means = np.stack([rows[i : len(rows) - m + 1 + i] for i in range(m)]).mean(axis=0)
    return np.mean((means[m:] - means[:-m]) ** 2, axis=0) / 2.0


def expected(m):
    """Allan variances of white noise, flicker and walk as spectra give them.

    The integral over both signs of the frequency of the spectrum of the *rows* and
    2 sin^4(pi m f)/(m sin(pi f))^2, f in cycles a row. It shares nothing with the
    recursions (C1) to (C3) but their densities.
    """

    def integral(power):
        def integrand(f):
            sine = np.sin(np.pi * f)
            window = np.sin(np.pi * m * f) ** 4 / (m * sine) ** 2
            return 4.0 * window / (2.0 * sine) ** power

        edges = np.arange(m + 1) / (2.0 * m)  # between the zeros of the sine
        return sum(integrate.quad(integrand, a, b)[0] for a, b in pairwise(edges))

    return np.array([N**2 * RATE, B**2, K**2 / RATE]) * [integral(p) for p in (0, 1, 2)]


def z_scores(variances, predicted):
    se = variances.std(axis=0, ddof=1) / np.sqrt(len(variances))
    return (variances.mean(axis=0) - predicted) / se


@pytest.fixture(scope="module")
def measured():
    """Allan variances of the parts and their sum, (draws times axes, lengths, 4)."""
    model = NoiseModel(white_raw_per_sqrt_hz=N, flicker_raw=B, walk_raw_per_sqrt_s=K)
    rng = stream(1, KEY, 0)
    out = []
    for _ in range(DRAWS):
        parts = np.stack(model.parts(ROWS, RATE, rng)[:3], axis=-1)
        parts = np.concatenate([parts, parts.sum(axis=-1, keepdims=True)], axis=-1)
        out.append(np.stack([allan_variance(parts, m) for m in LENGTHS], axis=1))
    return np.concatenate(out)


def test_allan_variances_of_the_parts_and_of_their_sum(measured):
    parts = np.array([expected(m) for m in LENGTHS])
    predicted = np.concatenate([parts, parts.sum(axis=1, keepdims=True)], axis=1)
    # the flicker's past is one record long: relative (m/rows)^2/(32 ln 2), 4e-5 at the
    # longest, where the standard error is 3e-2
    limit = stats.t.isf(1e-4 / (2 * predicted.size), len(measured) - 1)
    z = z_scores(measured, predicted)
    assert np.abs(z).max() < limit
    # power: each part a tenth larger, and the sum without one part, would be seen
    assert np.all(np.abs(z_scores(measured, 1.1**2 * predicted)).max(axis=0) > limit)
    for without in range(3):
        other = predicted[:, 3] - parts[:, without]
        assert np.abs(z_scores(measured[..., 3], other)).max() > limit


def test_flicker_is_the_plain_sum_over_the_past():
    n = 50
    model = NoiseModel(flicker_raw=[1.0, 2.0, 0.0])
    flicker = model.parts(n, RATE, stream(2, KEY, 0))[1]
    driven = stream(2, KEY, 0).spawn(3)[1].spawn(3)
    weights = np.ones(2 * n)
    for j in range(1, 2 * n):
        weights[j] = weights[j - 1] * (j - 0.5) / j
    for axis, size in ((0, 1.0), (1, 2.0), (2, 0.0)):
        normal = driven[axis].standard_normal(2 * n)
        plain = [weights[: k + 1] @ normal[k::-1] for k in range(n, 2 * n)]
        # rounding of a transform of 150 numbers of size 1 and 3
        np.testing.assert_allclose(flicker[:, axis], size * np.array(plain), atol=1e-13)
