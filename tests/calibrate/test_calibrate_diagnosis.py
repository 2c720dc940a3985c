"""Residuals, outliers, verdicts and robust losses."""

import numpy as np
import pytest
from rounding import EPS
from scipy import stats

from simval.calibrate import calibrate
from simval.calibrate.diagnosis import FALSE_ALARM, diagnose, residuals, verdict
from simval.errors import InputError
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel

G = 9.81
SIGMA = 0.005
MODEL = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.86, 1.15, 0.3, -0.2, 0.1])
)


def poses(n=40, trials=1, seed=0):
    clean = MODEL.distort(G * fibonacci_sphere(n), np.random.default_rng(0))
    noise = np.random.default_rng(seed).standard_normal((trials, n, 3))
    return clean + SIGMA * noise


def test_distances_are_the_shortest_way_to_the_ellipsoid():
    """Newton's method on the foot of the perpendicular, from the fit's own M and B."""
    y = poses(15)[0]
    fit = calibrate(y, G)
    found = diagnose(fit, y).distance
    for reading, distance in zip(y, found, strict=True):
        x = reading - fit.B
        gram = fit.matrix.T @ fit.matrix
        foot, multiplier = x.copy(), 0.0
        for _ in range(50):
            foot = np.linalg.solve(np.eye(3) + multiplier * gram, x)
            slope = (
                -2
                * foot
                @ gram
                @ np.linalg.solve(np.eye(3) + multiplier * gram, gram @ foot)
            )
            multiplier -= (foot @ gram @ foot - G**2) / slope
        exact = np.linalg.norm(x - foot)
        # next order: distance^2 / radius
        assert abs(abs(distance) - exact) < 2 * exact**2 / G


@pytest.mark.ci
@pytest.mark.parametrize("residual", ["squared", "norm", "weighted", "sampson"])
def test_standardised_residuals_are_standard(residual):
    """Known sigma: each pose's has variance 1, whatever its leverage (12 poses)."""
    trials = 500
    batch = poses(12, trials, seed=1)
    values = residuals(
        calibrate(batch, G, residual=residual), batch, SIGMA
    ).standardized
    believed = np.isfinite(values).all(axis=1)
    assert believed.all()
    # a chi-square below 1 % falls back to the scatter: it cuts the tail only
    variance = values.var(axis=0)
    assert np.all(np.abs(variance - 1) < 5 * np.sqrt(2 / trials) + 0.05)
    leverage = diagnose(calibrate(batch[0], G, residual=residual), batch[0]).leverage
    np.testing.assert_allclose(leverage.sum(), 9.0, rtol=1e-10)
    # a diagonal of a projector is 1 at most, up to rounding of the sum of nine
    assert leverage.max() < 1.0 + 100 * EPS


@pytest.mark.parametrize("residual", ["squared", "norm", "weighted", "sampson"])
@pytest.mark.parametrize("known", [True, False])
def test_leverage_is_what_a_pose_pulls_its_own_fit_by(residual, known):
    """A reading moved by e along its normal changes its distance by (1 - h) e."""
    y = poses(14, seed=8)[0]
    noise = SIGMA * np.geomspace(0.3, 3.0, 14)
    given = {"noise_std": noise} if known else {}
    fit = calibrate(y, G, residual=residual, **given)
    leverage = diagnose(fit, y, noise).leverage
    step = 1e-4
    for k in (0, 6, 13):
        normal = (y[k] - fit.B) @ fit.matrix.T @ fit.matrix
        moved = []
        for sign in (1, -1):
            other = y.copy()
            other[k] += sign * step * normal / np.linalg.norm(normal)
            refit = calibrate(other, G, residual=residual, **given)
            moved.append(diagnose(refit, other, noise).distance[k])
        pulled = 1.0 - (moved[0] - moved[1]) / (2 * step)
        # residuals of 0.5 % of the radius leave second derivatives of as much
        assert abs(pulled - leverage[k]) < 0.02


@pytest.mark.ci
def test_type_a_standardised_residuals_follow_student():
    trials, n = 1200, 12
    batch = poses(n, trials, seed=2)
    values = residuals(calibrate(batch, G), batch).standardized[:, 3]
    law = stats.t(n - 10)
    # false-alarm rate 1e-4; the power below rejects the wrong law at the same level
    assert stats.kstest(values, law.cdf).pvalue > 1e-4
    assert stats.kstest(values, stats.norm.cdf).pvalue < 1e-4  # power


@pytest.mark.ci
def test_clean_sets_have_few_outliers():
    """The stated chance of any: 1 %; 150 sets, binomial at 1e-4."""
    trials = 150
    batch = poses(20, trials, seed=3)
    for sigma in (None, SIGMA):
        found = residuals(calibrate(batch, G), batch, sigma)
        called = np.sum(found.outlier.any(axis=1))
        assert called <= stats.binom.isf(1e-4, trials, FALSE_ALARM)


@pytest.mark.parametrize("sigma", [None, SIGMA])
@pytest.mark.parametrize("where", [0, 7, 39])
def test_a_bad_pose_is_named(where, sigma):
    """0.1 m/s^2 along its own force: 20 sigma, which moves a parameter by some sd."""
    y = poses(seed=4)[0]
    force = MODEL.correct(y[where])
    y[where] += 0.1 * force / np.linalg.norm(force)
    found = diagnose(calibrate(y, G), y, sigma)
    assert found.outliers == (where,)
    assert found.standardized[where] > 5


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_robust_losses_let_go_of_bad_poses(loss):
    """Three of forty poses wrong by 0.5 m/s^2: 39 sd for least squares.

    Huber and soft_l1 keep a bounded pull: some 3 * 1.3 sigma / 40; Cauchy none.
    """
    y = poses(seed=5)[0]
    clean = calibrate(y, G)
    for k in (3, 17, 30):
        y[k] += 0.5 * np.array([0.6, -0.64, 0.48])
    plain = calibrate(y, G)
    robust = calibrate(y, G, loss=loss)
    assert robust.status == "converged"
    shift = np.abs(robust.parameters - clean.parameters) / clean.sd
    spoiled = np.abs(plain.parameters - clean.parameters) / clean.sd
    assert spoiled.max() > 10
    assert shift.max() < (1.0 if loss == "cauchy" else 2.5)
    assert set(diagnose(robust, y).outliers) >= {3, 17, 30} or loss != "cauchy"


@pytest.mark.ci
def test_robust_loss_costs_little_on_clean_data():
    """Tuned for 95 % efficiency in location; here the parameters' spread grows by
    less than 8 %, and the error bars still cover."""
    batch = poses(40, 1000, seed=6)
    plain = calibrate(batch, G)
    for loss in ("huber", "cauchy"):
        robust = calibrate(batch, G, loss=loss)
        # as the plain fit on clean data: all of them converge
        assert robust.converged.mean() > 0.99
        good = robust.converged
        growth = robust.parameters[good].std(axis=0) / plain.parameters[good].std(
            axis=0
        )
        assert np.all(growth < 1.08 + 3 / np.sqrt(2 * 1000))
        limits = robust.intervals[good]
        inside = (limits[..., 0] <= MODEL.parameters) & (
            MODEL.parameters <= limits[..., 1]
        )
        # binomial sd 0.7 %; Huber's (U3) is asymptotic, some 1 % at n = 40
        assert np.all(np.abs(inside.mean(axis=0) - 0.95) < 0.035)


def test_verdicts():
    assert "noise is the limit" in verdict(1.0, 30)
    assert "the poses are the limit" in verdict(19.6, 29)
    assert "4.4 times" in verdict(19.6, 29)
    assert "overstated" in verdict(0.1, 30)
    assert "not judged" in verdict(np.nan, 30)
    assert "nine poses fit exactly" in verdict(np.nan, 0)


def test_verdict_rate():
    """Clean sets with the right sigma: 1 % on either side."""
    trials = 1000
    fits = calibrate(poses(20, trials, seed=7), G, noise_std=SIGMA)
    words = [verdict(float(x), 11) for x in fits.chi2_per_dof]
    wrong = sum("noise is the limit" not in w for w in words)
    assert stats.binom.ppf(1e-4, trials, 0.02) <= wrong
    assert wrong <= stats.binom.isf(1e-4, trials, 0.02)


def test_bad_arguments():
    y = poses(12)[0]
    fit = calibrate(y, G)
    with pytest.raises(InputError, match="made from 12 poses"):
        diagnose(fit, y[:10])
    with pytest.raises(InputError, match="above 0"):
        diagnose(fit, y, 0.0)
    batch = calibrate(np.stack([y, y]), G)
    with pytest.raises(InputError, match="one set"):
        diagnose(batch, y)
