"""Errors taken apart, and verdicts from one recording at their stated rate."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from simval.geometry import (
    attitude_error,
    compose,
    from_rotation_vector,
    random_quaternions,
)
from simval.recorded.errors import ALPHA, errors_of, judged, normalised, whiteness


def errors(truth, estimate, rest=None):
    time = np.arange(len(truth)) / 100.0
    return errors_of(
        time, truth, estimate, np.zeros(len(truth), bool) if rest is None else rest
    )


def test_heading_and_inclination_by_euler_angles():
    # a turn by psi about the vertical, then a tilt: by SciPy, in the world
    rng = np.random.default_rng(1)
    truth = random_quaternions(200, rng)
    psi, tilt = rng.uniform(-3.0, 3.0, 200), rng.uniform(0.0, 3.0, 200)
    way = rng.uniform(0.0, 2.0 * np.pi, 200)
    level = np.stack([np.cos(way), np.sin(way), np.zeros(200)], axis=1)
    error = Rotation.from_rotvec(tilt[:, None] * level) * Rotation.from_rotvec(
        psi[:, None] * [0.0, 0.0, 1.0]
    )
    estimate = (error * Rotation.from_quat(truth)).as_quat()
    found = errors(truth, estimate)
    # rounding: 1e-15 over the least distance of an angle from pi, 0.14
    np.testing.assert_allclose(np.abs(found.heading), np.abs(psi), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.inclination, tilt, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.total, error.magnitude(), rtol=0, atol=1e-12)
    up = np.array([0.0, 0.0, 1.0])
    true_up = Rotation.from_quat(truth).inv().apply(up)
    own_up = Rotation.from_quat(estimate).inv().apply(up)
    apart = np.arctan2(
        np.linalg.norm(np.cross(true_up, own_up), axis=1), np.vecdot(true_up, own_up)
    )
    np.testing.assert_allclose(found.inclination, apart, rtol=0, atol=1e-12)


def test_body_errors_are_those_of_a_covariance_on_the_body_side():
    rng = np.random.default_rng(2)
    truth = random_quaternions(50, rng)
    off = 0.3 * rng.standard_normal((50, 3))
    found = errors(truth, compose(truth, from_rotation_vector(off)))
    np.testing.assert_allclose(found.body, off, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        found.total,
        attitude_error(truth, compose(truth, from_rotation_vector(off))),
        atol=1e-13,
    )


def ornstein_uhlenbeck(rng, count, memory, size=3):
    """Correlated unit normal errors with a memory in rows."""
    keep = np.exp(-1.0 / memory)
    values = np.empty((count, size))
    values[0] = rng.standard_normal(size)
    noise = np.sqrt(1.0 - keep**2) * rng.standard_normal((count, size))
    for k in range(1, count):
        values[k] = keep * values[k - 1] + noise[k]
    return values


@pytest.mark.ci
@pytest.mark.parametrize("memory", [1.0, 20.0, 100.0])
def test_verdicts_keep_their_rate_and_have_power(memory):
    # logs of 2000 rows, errors that last up to a twentieth of one
    rng = np.random.default_rng(int(memory))
    trials, answers = 60, []
    for _ in range(trials):
        squares = np.sum(ornstein_uhlenbeck(rng, 2000, memory) ** 2, axis=1)
        answers.append(
            [judged(scale * squares, 3.0).verdict for scale in (1.0, 3.0, 1.0 / 3.0)]
        )
    wrong = sum(row[0] != "consistent" for row in answers)
    # at ALPHA, and 1e-3 that this test is wrong; blocks that are still correlated
    # cost up to three times ALPHA
    assert wrong <= binom.ppf(1.0 - 1e-3, trials, 3.0 * ALPHA)
    over = np.mean([row[1] == "overconfident" for row in answers])
    under = np.mean([row[2] == "underconfident" for row in answers])
    assert min(over, under) > (0.95 if memory < 50.0 else 0.4)
    assert not any(row[1] == "underconfident" for row in answers)
    assert not any(row[2] == "overconfident" for row in answers)


def test_few_rows_are_not_judged():
    assert judged(np.ones(20), 3.0).verdict == "not judged"
    assert judged(np.full(500, np.nan), 3.0).verdict == "not judged"


def test_normalised_squares():
    rng = np.random.default_rng(5)
    root = rng.standard_normal((4000, 3, 3))
    covariance = root @ root.swapaxes(1, 2)
    off = np.einsum("kij,kj->ki", root, rng.standard_normal((4000, 3)))
    squares = normalised(off, covariance)
    # chi-square of 3: variance 6, 4 standard errors
    assert squares.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 4000))
    broken = covariance.copy()
    broken[7] = -np.eye(3)
    assert np.flatnonzero(np.isnan(normalised(off, broken))).tolist() == [7]


def test_whiteness():
    rng = np.random.default_rng(6)
    covariance = np.tile(np.diag([1.0, 4.0, 9.0]), (3000, 1, 1))
    white = rng.standard_normal((3000, 3)) * [1.0, 2.0, 3.0]
    # sd of a correlation of white noise is 1 / sqrt(n); 4 of them
    assert np.abs(whiteness(white, covariance)).max() < 4.0 / np.sqrt(3000)
    red = ornstein_uhlenbeck(rng, 3000, 1.0 / np.log(2.0)) * [1.0, 2.0, 3.0]
    np.testing.assert_allclose(whiteness(red, covariance), 0.5, atol=0.08)
