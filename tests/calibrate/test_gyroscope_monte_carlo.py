"""Error bars of the gyroscope's calibration, against simulated readings.

Forty poses, moves of two seconds at 100 Hz, every sample drawn. False alarms: each
limit is one in 1e4 for its number of comparisons.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, fitted, readings, tumble

from simval.calibrate import calibrate, calibrate_gyroscope, moves_between
from simval.calibrate.gyroscope import fit as fit_module
from simval.theory.gyroscope import MovePath, gyroscope_moments
from simval.theory.joint_bias import gyroscope_bias

TRUTH = np.concatenate([ACCELEROMETER.parameters, M.ravel(), GYROSCOPE.B])
EVERY, ACC, OWN, MATRIX = slice(None), slice(0, 9), slice(9, 21), slice(9, 18)
BLOCK = 10


@dataclass
class Sample:
    """Errors, covariances and chi-squares of many trials."""

    error: np.ndarray
    covariance: np.ndarray
    chi2: np.ndarray
    dof: int
    accelerometer: np.ndarray  # its covariance alone

    def nees(self, some=OWN):
        e, C = self.error[:, some], self.covariance[:, some, some]
        return np.vecdot(e, np.linalg.solve(C, e[..., None])[..., 0])

    def ratio(self, some):
        """Mean of the squared errors over their predicted variances."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)
        return (self.error**2 / variance)[:, some]


def sample(trials, seed, *, prepare=lambda rows: rows, margin=10, **options):
    """Calibrations of simulated readings; `prepare` may spoil the rows."""
    truth, rng = tumble(), np.random.default_rng(seed)
    parts = []
    for _ in range(trials // BLOCK):
        poses, rows = readings(truth, BLOCK, rng)
        acc, moves = fitted(truth, poses, prepare(rows), margin=margin)
        parts.append(
            (
                calibrate_gyroscope(
                    moves, poses, acc, pose_std=truth.pose_std,
                    angle_random_walk=WALK, start=np.eye(3), **options,
                ),
                acc,
            )
        )  # fmt: skip
    fits = [fit for fit, _ in parts]
    assert all(fit.converged.all() for fit in fits)
    found = np.concatenate([np.c_[f.accelerometer, f.parameters] for f in fits])
    return Sample(
        error=found - TRUTH,
        covariance=np.concatenate([f.covariance for f in fits]),
        chi2=np.concatenate([f.chi2_per_dof * f.dof for f in fits]),
        dof=fits[0].dof,
        accelerometer=np.concatenate([acc.covariance for _, acc in parts]),
    )


def limit(comparisons):
    return stats.norm.isf(1e-4 / (2 * comparisons))


def z_of_mean(values, expected):
    return (values.mean() - expected) / (values.std(ddof=1) / np.sqrt(len(values)))


def judged(found, some, comparisons):
    """z scores of NEES and of the variances, mean over the parameters by trial."""
    size = np.arange(21)[some].size
    scores = [
        z_of_mean(found.nees(some), size),
        z_of_mean(found.ratio(some).mean(1), 1),
    ]
    return np.abs(scores) < limit(comparisons)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("estimator", "some"),
    [("joint", EVERY), ("generalised", OWN), ("unweighted", MATRIX)],
)
def test_error_bars_hold(estimator, some):
    """100 trials: NEES, variances, chi-square, each estimator by its own covariance."""
    bias = "first rest" if estimator == "unweighted" else "constant"
    found = sample(100, 11, estimator=estimator, bias=bias)
    assert judged(found, some, 9).all()
    if estimator != "unweighted":
        assert abs(z_of_mean(found.chi2, found.dof)) < limit(9)


@pytest.mark.slow
def test_error_bars_hold_in_2000_trials():
    found = sample(2000, 12)
    assert judged(found, OWN, 4).all()
    assert judged(found, EVERY, 4).all()
    # 21 correlated shares of 2000: each has a standard error of 0.5 %
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    covered = (np.abs(found.error) < 1.959964 * sd).mean(axis=1)
    assert abs(covered.mean() - 0.95) < 0.01
    assert abs(z_of_mean(covered, 0.95)) < limit(4)
    assert stats.kstest(found.nees(OWN), stats.chi2(12).cdf).pvalue > 1e-4
    # bias: below the resolution of this many trials, in each of the 21
    shift = found.error.mean(axis=0) / (found.error.std(axis=0) / np.sqrt(2000))
    assert np.abs(shift).max() < limit(21)


def path_of(truth, pieces=40, margin=10):
    """Moves as theory takes them, from the scene's attitudes."""
    rows = truth.intervals
    inner = np.minimum(margin, np.diff(rows)[:, 0] // 3)
    turns, seconds = [], []
    for a, b in zip(
        rows[:-1, 1] - 1 - inner[:-1], rows[1:, 0] + inner[1:], strict=True
    ):
        nodes = np.unique(np.round(np.linspace(a, b, pieces + 1)).astype(int))
        attitude = Rotation.from_quat(truth.attitude[nodes])
        turns.append((attitude[:-1].inv() * attitude[1:]).as_rotvec())
        seconds.append(np.diff(truth.time[nodes]))
    return MovePath(turns=np.array(turns), seconds=np.array(seconds))


def bound_of(truth, rest_seconds):
    return gyroscope_moments(
        GYROSCOPE, ACCELEROMETER, truth.directions, path_of(truth),
        pose_std=truth.pose_std, bias_std=WALK / np.sqrt(rest_seconds.sum()),
        g=truth.g, angle_random_walk=WALK,
    )  # fmt: skip


def predicted(estimator, bias="constant"):
    truth = tumble()
    poses, rows = readings(truth, 1, np.random.default_rng(1))
    acc, moves = fitted(truth, poses, rows)
    fit = calibrate_gyroscope(
        moves, poses, acc, pose_std=truth.pose_std, angle_random_walk=WALK,
        estimator=estimator, bias=bias, start=np.eye(3),
    )  # fmt: skip
    bound = np.diagonal(bound_of(truth, moves.rest_seconds).cramer_rao)
    return np.diagonal(fit.covariance[0]) / bound, acc.covariance[0], fit.covariance[0]


@pytest.mark.ci
def test_variance_over_the_joint_bound():
    """The bound has every attitude unknown, and shares no formula with the fit."""
    joint, _, _ = predicted("joint")
    # taken at a noisy estimate, which moves a variance by some 1e-3 of itself; the
    # theory's segments leave 3e-4
    np.testing.assert_allclose(joint, 1.0, atol=5e-3)
    generalised, _, _ = predicted("generalised")
    assert np.all(generalised[9:] < 1.02)
    # above 1 but for the estimate that its covariance is taken at
    assert np.all(generalised[9:] > 0.99)
    unweighted, _, _ = predicted("unweighted", "first rest")
    assert 1.05 < unweighted[9:18].mean() < 1.15  # 1.10: what IMU-TK's weights cost
    assert unweighted[9:18].max() < 1.35


@pytest.mark.ci
def test_the_gaps_give_back_to_the_accelerometer():
    _, alone, together = predicted("joint")
    share = np.diagonal(together)[:9] / np.diagonal(alone)
    assert np.all((share > 0.70) & (share < 0.92))  # 0.77 to 0.90 at these poses


def predicted_bias(truth, pieces, rest_seconds):
    return gyroscope_bias(
        GYROSCOPE, ACCELEROMETER, truth.directions, path_of(truth, pieces),
        pose_std=float(truth.pose_std[1]), bias_std=WALK / np.sqrt(rest_seconds.sum()),
        angle_random_walk=WALK, g=truth.g,
    )  # fmt: skip


@pytest.mark.ci
def test_second_order_bias_is_negligible():
    """Below a hundredth of a standard deviation; no correction is worth its code."""
    truth = tumble()
    rest_seconds = np.diff(truth.intervals)[:, 0] * 0.01
    bias = predicted_bias(truth, 4, rest_seconds)
    sd = bound_of(truth, rest_seconds).sd[9:]
    assert 1e-4 < np.abs(bias / sd).max() < 5e-3
    # about minus the variance of a move's angle, of a scale of one
    angle = WALK**2 * (truth.time[-1] - truth.time[0]) / 39.0
    assert -3.0 < bias[[0, 4, 8]].mean() / angle < -0.1


@pytest.mark.slow
def test_second_order_bias_is_as_predicted():
    """Antithetic pairs at ten times the noise, where it is ten times as visible."""
    truth, times, pairs = tumble(), 10.0, 5
    rng = np.random.default_rng(3)
    std = np.full(len(truth.directions), truth.pose_std[1])
    poses = ACCELEROMETER.distort(truth.directions, rng)
    rows = GYROSCOPE.distort(truth.rate, rng)

    def errors(pose_noise, row_noise):
        moves = moves_between(
            truth.time, rows + times * row_noise, truth.intervals, chunk=2
        )
        noisy = poses + times * pose_noise
        acc = calibrate(noisy, truth.g, residual="weighted", noise_std=times * std)
        fit = calibrate_gyroscope(
            moves, noisy, acc, pose_std=times * std, angle_random_walk=times * WALK,
            start=np.eye(3),
        )  # fmt: skip
        return fit.parameters - TRUTH[OWN], moves.rest_seconds

    clean, rest_seconds = errors(
        np.zeros((1, *poses.shape)), np.zeros((1, *rows.shape))
    )
    means = []
    for _ in range(100):
        n = rng.standard_normal((pairs, *poses.shape)) * std[:, None]
        w = rng.standard_normal((pairs, *rows.shape)) * WALK / 0.1
        both = errors(np.concatenate([n, -n]), np.concatenate([w, -w]))[0] - clean
        means.append((both[:pairs] + both[pairs:]) / 2.0)
    seen = np.concatenate(means) / times**2
    error = seen.std(axis=0) / np.sqrt(len(seen))
    bias = predicted_bias(truth, 16, rest_seconds)
    # five standard errors, and what segments of 0.2 rad and the weights leave
    room = (
        5.0 * error + 0.05 * np.abs(bias[:9]).max() * np.r_[np.ones(9), np.full(3, 0.1)]
    )
    assert np.all(np.abs(seen.mean(axis=0) - bias) < room)
    # power: without the noise of the moves' angle the scales would not shrink
    assert np.all((seen.mean(axis=0) + room)[[0, 4, 8]] < 0.0)


# Power: the same test must see a covariance or a reading that is wrong.


def seen(**options):
    estimator = options.pop("estimator", "joint")
    found = sample(60, 13, estimator=estimator, **options)
    return not judged(found, OWN, 4).all()


@pytest.mark.slow
def test_covariance_without_the_shared_pose_is_seen(monkeypatch):
    whole = fit_module.covariance_of

    def apart(L, blocks):
        V = whole(L, blocks)
        rows = np.arange(V.shape[-1]) // 2
        return V * (rows[:, None] == rows)

    monkeypatch.setattr(fit_module, "covariance_of", apart)
    found = sample(600, 13, estimator="unweighted", bias="first rest")
    assert not judged(found, MATRIX, 4).all()


@pytest.mark.slow
def test_covariance_without_the_accelerometers_error_is_seen(monkeypatch):
    monkeypatch.setattr(fit_module, "carried", lambda rows, pulled: rows)
    found = sample(600, 13, estimator="generalised")
    assert not judged(found, OWN, 4).all()


@pytest.mark.ci
def test_a_lost_coning_term_is_seen(monkeypatch):
    turned, ended = fit_module.turn, fit_module.end_of

    def without(X):
        X = X.copy()
        X[:, :, 3:9] = 0.0
        return X

    monkeypatch.setattr(fit_module, "turn", lambda X, m, b: turned(without(X), m, b))
    monkeypatch.setattr(fit_module, "end_of", lambda X, m, b: ended(without(X), m, b))
    assert seen()


@pytest.mark.ci
def test_a_delay_is_seen_without_a_margin_and_costs_nothing_with_one():
    """Rows that come eight samples early: the move begins before its rest has ended.

    One sample is 1e-6 rad at the slow end of such a move, and no test sees it.
    """

    def early(rows):
        return np.roll(rows, -8, axis=1)

    assert not seen(prepare=early)
    assert seen(prepare=early, margin=0)


@pytest.mark.ci
def test_a_transposed_matrix_is_seen():
    found = sample(20, 14)
    wrong = TRUTH.copy()
    wrong[MATRIX] = M.T.ravel()
    found.error = found.error + TRUTH - wrong
    assert not judged(found, OWN, 4).all()
