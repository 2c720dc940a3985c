"""What an attitude expansion may be off by, beside the exact moments."""

import numpy as np
import pytest

from simval.geometry import normalize, random_quaternions
from simval.theory import attitude_moments
from simval.theory.attitude import RANGE, expansion_remainders


def shares(seed, count):
    """Distance from the exact moments over the remainder: (n, 6)."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        q = random_quaternions(1, rng)[0]
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        norm = attitude_moments(q, r1, r2, 1e-4).norm
        # |qbar| over the noise; beyond 50 the oracle's 1e-9 is not far below (R1)
        sigma = norm / np.exp(rng.uniform(np.log(RANGE), np.log(50.0)))
        orders = (2, "4-paper", 4, "exact")
        moments = {k: attitude_moments(q, r1, r2, sigma, k) for k in orders}
        exact, allowed = moments["exact"], expansion_remainders(moments)
        off = [
            np.abs(getattr(moments[order], what) - getattr(exact, what)).max()
            / getattr(allowed[order], what)
            for order in orders[:3]
            for what in ("bias", "covariance")
        ]
        found.append(off)
    return np.array(found)


def test_an_expansion_is_off_by_its_remainder_at_most():
    found = shares(12, 25)
    assert found.max() <= 1.0
    # power: a quarter would not do, of what follows the fourth order a quarter either
    assert np.all(found.max(axis=0) > 0.25)


@pytest.mark.slow
def test_an_expansion_is_off_by_its_remainder_at_most_in_many_geometries():
    found = shares(14, 1000)
    assert found.max() <= 1.0
    assert np.all(found.max(axis=0) > 0.5)
