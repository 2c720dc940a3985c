"""A step of biases or scales in a series of poses: false alarms, power, the place."""

import numpy as np
import pytest
from scipy import stats

from simval.calibrate.drift import find_step
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel

G = 9.81
SIGMA = 0.002


def series(rng, count):
    """Readings of a random sensor in random order, without noise."""
    angles, scale = 0.03 * rng.standard_normal(3), rng.uniform(0.8, 1.25, 3)
    values = np.concatenate([angles, scale, rng.uniform(-0.5, 0.5, 3)])
    sensor = AccelerometerModel.from_parameters(values)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return sensor.distort(G * rng.permutation(fibonacci_sphere(count) @ turn), rng)


def false_alarms(count, sets, level):
    called = 0
    for seed in range(sets):
        rng = np.random.default_rng([61, count, seed])
        y = series(rng, count)
        found = find_step(y + SIGMA * rng.standard_normal(y.shape))
        called += found.chance <= level
    return called


@pytest.mark.ci
@pytest.mark.parametrize("count", [12, 16])
def test_clean_series_have_no_step(count):
    """The chance is a bound; binomial at 1e-4. Without counting places and
    changes 14 and 19 of 20 have one."""
    assert false_alarms(count, 20, 0.05) <= stats.binom.isf(1e-4, 20, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 14, 18, 24, 32])
def test_clean_series_have_no_step_of_any_number(count):
    assert false_alarms(count, 300, 0.05) <= stats.binom.isf(1e-4 / 5, 300, 0.05)


@pytest.mark.parametrize("count", [13, 15, 20])
def test_a_bias_that_jumps_is_found_where_it_is(count):
    """0.5 m/s^2 in thirteen poses: one parameter, and three degrees of freedom left."""
    rng = np.random.default_rng(67)
    y = series(rng, count) + SIGMA * rng.standard_normal((count, 3))
    y[6:, 1] += 0.5
    found = find_step(y)
    assert (found.index, found.what, found.dof) == (6, "the bias of y", count - 10)
    # 3e-5 with three degrees of freedom is the worst of these; 0.5 is 250 sigma
    assert found.chance < 1e-3
    assert found.drop > 20
    # chi of ten degrees or fewer over its root: 2.5 has a chance below 1e-3 with three
    assert found.scatter < 2.5 * SIGMA


def test_a_scale_that_steps_is_found_where_it_is():
    """About the zero of the counter, and about the centre where the zero is far off."""
    rng = np.random.default_rng(71)
    y = series(rng, 16) + SIGMA * rng.standard_normal((16, 3))
    for axes, what in (([2], "the scale of z"), ([0, 1, 2], "the scale of all axes")):
        z = y.copy()
        z[9:, axes] *= 1.03
        found = find_step(z)
        assert (found.index, found.what) == (9, what)
        # power: 5e-9 is seen; three percent of g are 150 sigma
        assert found.chance < 1e-6
        middle = 0.5 * (y.max(axis=0) + y.min(axis=0))
        z = (y - middle) * 400.0
        z[9:, axes] *= 1.03
        assert find_step(z + 32768.0).chance < 1e-3


def test_too_few_poses_or_too_many_tell_nothing():
    rng = np.random.default_rng(73)
    assert find_step(series(rng, 11)) is None
    assert find_step(series(rng, 65)) is None
    assert find_step(np.tile(series(rng, 12)[:3], (5, 1))) is None
