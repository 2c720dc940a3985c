"""Errors of attitude, and whether a filter is what it says: rates, power, routes."""

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from simval.consistency import (
    LOST,
    diverged,
    heading_and_inclination,
    instant_scores,
    judge,
    mean_of_trials,
    normalised_squares,
    pairs_of,
    rotation_error,
    settled_at,
    whitened,
)
from simval.geometry import attitude_matrix, random_quaternions


def passive(rotation):
    """Quaternions whose attitude matrix is that of a rotation (its transpose's)."""
    return rotation.inv().as_quat()


def correlated(rng, trials, instants, size, rho):
    """Standard normal errors that are correlated in time, neighbours by rho."""
    rows = rng.standard_normal((trials, instants, size))
    for k in range(1, instants):
        rows[:, k] = rho * rows[:, k - 1] + np.sqrt(1.0 - rho**2) * rows[:, k]
    return rows


def test_the_error_is_the_turn_from_the_truth_to_the_estimate():
    rng = np.random.default_rng(1)
    truth = random_quaternions(200, rng)
    turn = rng.uniform(-1.0, 1.0, (200, 3))  # rad
    turn[0] = 0.0
    # A_hat = expm(-[turn x]) A: the body of the estimate is turned by `turn`
    A = np.array([scipy.linalg.expm(-np.cross(np.eye(3), v)) for v in turn])
    estimate = passive(
        Rotation.from_matrix((A @ attitude_matrix(truth)).swapaxes(1, 2)).inv()
    )
    assert np.allclose(
        attitude_matrix(estimate), A @ attitude_matrix(truth), atol=1e-12
    )
    for sign in (1.0, -1.0):
        found = rotation_error(sign * estimate, truth)
        assert np.abs(found - turn).max() < 1e-12


def test_heading_and_inclination_are_a_turn_about_the_vertical_after_a_tilt():
    rng = np.random.default_rng(2)
    truth = random_quaternions(300, rng)
    heading = rng.uniform(-3.0, 3.0, 300)
    tilt, along = rng.uniform(0.0, 3.0, 300), rng.uniform(0.0, 2.0 * np.pi, 300)
    axis = np.stack([np.cos(along), np.sin(along), 0.0 * along], axis=1)
    about_up = Rotation.from_rotvec(heading[:, None] * np.array([0.0, 0.0, 1.0]))
    in_the_world = about_up * Rotation.from_rotvec(tilt[:, None] * axis)
    estimate = in_the_world.as_matrix() @ attitude_matrix(truth).swapaxes(1, 2)
    quaternion = Rotation.from_matrix(estimate).as_quat()
    found = heading_and_inclination(quaternion, truth)
    assert np.abs(found[0] - heading).max() < 1e-9
    assert np.abs(found[1] - tilt).max() < 1e-9
    # the inclination alone is the angle between the two verticals, whatever the order
    up = np.array([0.0, 0.0, 1.0])
    between = np.vecdot(attitude_matrix(quaternion) @ up, attitude_matrix(truth) @ up)
    assert np.abs(np.cos(found[1]) - between).max() < 1e-12


def test_normalised_squares_and_whitened_neighbours_by_hand():
    rng = np.random.default_rng(3)
    error = rng.standard_normal((5, 4, 3))
    root = rng.standard_normal((5, 4, 3, 3))
    P = root @ root.swapaxes(-1, -2)
    by_hand = np.einsum("nki,nkij,nkj->nk", error, np.linalg.inv(P), error)
    assert np.allclose(normalised_squares(error, P), by_hand, rtol=1e-9)
    white = whitened(error, P)
    same = pairs_of(white, white)
    assert np.allclose(same, 2.0 * by_hand / 3.0, rtol=1e-9)
    assert np.abs(pairs_of(white, whitened(-error, P))).max() < 1e-12


def test_innovations_that_correlate_are_told_from_white_ones():
    # at 1e-3, two-sided: 3.29; power of rho = 0.1 with 40 x 50 pairs of 3: z = 7.7
    rng = np.random.default_rng(4)
    eye = np.broadcast_to(np.eye(3), (40, 51, 3, 3))
    for rho, seen in ((0.0, False), (0.1, True)):
        rows = correlated(rng, 40, 51, 3, rho)
        white = whitened(rows, eye)
        mean, error, n = mean_of_trials(pairs_of(white[:, 1:], white[:, :-1]))
        assert n == 40
        assert (abs(mean - 1.0) > 3.29 * error) == seen
        assert abs(mean - 1.0 - rho) < 4.0 * error


def test_an_error_settles_where_it_stays():
    rng = np.random.default_rng(5)
    time = np.arange(1.0, 21.0)
    angle = rng.uniform(0.0, 1.2, (200, 20)) * np.linspace(2.0, 0.9, 20)
    most = np.full(20, 1.0)
    found = settled_at(angle, time, most)
    for row, at in zip(angle, found, strict=True):
        after = [t for k, t in enumerate(time) if (row[k:] <= 1.0).all()]
        assert at == (after[0] if after else np.inf)
    assert np.isinf(found).any()
    assert np.isfinite(found).any()


def test_a_trial_that_strays_has_diverged():
    angle = np.zeros((3, 10))
    angle[1, 2] = angle[2, 7] = 1.01 * LOST
    assert diverged(angle).tolist() == [0.0, 1.0, 1.0]
    assert diverged(angle, since=5).tolist() == [0.0, 0.0, 1.0]


@pytest.mark.ci
def test_scores_of_instants_have_the_normal_law():
    # Kolmogorov-Smirnov at 1e-3 over 4000 independent instants of 40 trials
    rng = np.random.default_rng(6)
    squares = np.sum(rng.standard_normal((40, 4000, 3)) ** 2, axis=-1)
    scores = instant_scores(squares, 3)
    assert scipy.stats.kstest(scores, "norm").pvalue > 1e-3
    # power: a variance 10 % too small in the statement
    assert scipy.stats.kstest(instant_scores(1.1 * squares, 3), "norm").pvalue < 1e-9
    # far out it stays finite, with its sign
    assert instant_scores(1e4 * squares[:, :1], 3)[0] > 30.0
    assert instant_scores(1e-4 * squares[:, :1], 3)[0] < -30.0


CAMPAIGNS = 500
ALPHA = 0.05


def alarms(rng, scale, trials=40, instants=10, rho=0.9):
    """Share of campaigns that are called overconfident, and underconfident."""
    error = correlated(rng, CAMPAIGNS * trials, instants, 3, rho)
    squares = scale * np.sum(error**2, axis=-1).reshape(CAMPAIGNS, trials, instants)
    called = [judge(each, 3, ALPHA).answer for each in squares]
    return [called.count(f"{s}confident") / CAMPAIGNS for s in ("over", "under")]


@pytest.mark.ci
def test_the_rate_of_false_alarms_is_the_stated_one_and_faults_are_seen():
    # stated 5 %: 500 campaigns see at most 8.2 % with 99.9 % if it is true;
    # Bonferroni's rule between correlated instants makes it less
    rng = np.random.default_rng(7)
    over, under = alarms(rng, 1.0)
    assert over + under < 0.082
    assert over > 0.002, "a test that never alarms tests nothing"
    # power at 40 trials, each side by its own name: 4.5 and 2 of 3
    assert alarms(rng, 1.5)[0] > 0.95
    assert alarms(rng, 1.0 / 1.5)[1] > 0.95
