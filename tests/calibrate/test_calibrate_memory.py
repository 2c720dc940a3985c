"""Memory of a large batch and of a large set, as numpy's allocator reports it."""

import tracemalloc

import numpy as np
import pytest

from simval.calibrate import calibrate
from simval.poses import fibonacci_sphere, random_directions

G = 9.81
MIB = 2**20


def peak(poses, **options):
    tracemalloc.start()
    try:
        fit = calibrate(poses, G, **options)
        return fit, tracemalloc.get_traced_memory()[1] / MIB
    finally:
        tracemalloc.stop()


@pytest.mark.ci
@pytest.mark.parametrize(
    "residual",
    [
        "squared",
        "sampson",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("norm", "weighted")),
    ],
)
def test_ten_thousand_trials_of_forty_poses(residual):
    noise = np.random.default_rng(0).standard_normal((10_000, 40, 3))
    poses = G * fibonacci_sphere(40) + 0.02 * noise
    fit, used = peak(poses, residual=residual)
    assert fit.converged.all()
    assert used < 300


@pytest.mark.ci
def test_a_million_samples():
    rng = np.random.default_rng(1)
    poses = G * random_directions(1_000_000, rng)
    poses += 0.05 * rng.standard_normal(poses.shape)
    fit, used = peak(poses, repeats=True)
    assert fit.status == "converged"
    assert fit.iterations <= 5
    assert used < 300
