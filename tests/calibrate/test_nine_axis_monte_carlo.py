"""Error bars of three sensors in one fit, against simulated readings.

Forty poses, moves of two seconds at 100 Hz, every sample of the gyroscope drawn. False
alarms: each limit is one in 1e4 for its number of comparisons.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from nine_axes import ACC, EVERY, GYRO, MAG, TRUTH, bound, calibrated, drawn
from scipy import stats
from test_gyroscope_monte_carlo import limit, z_of_mean
from tumbles import tumble

from simval.calibrate.gyroscope import fit

BLOCK = 10
POSES = np.r_[0:9, 21:34]


@dataclass
class Sample:
    """Errors of many trials: of the one fit, and of those of two sensors."""

    error: np.ndarray
    covariance: np.ndarray
    chi2: np.ndarray
    dof: int
    gyroscope: np.ndarray  # 21
    magnetometer: np.ndarray  # 22
    two: tuple[np.ndarray, np.ndarray]  # covariances of these

    def nees(self, some=EVERY):
        e, C = self.error[:, some], self.covariance[:, some, some]
        sd = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
        scaled = C / (sd[:, :, None] * sd[:, None, :])
        return np.vecdot(e / sd, np.linalg.solve(scaled, (e / sd)[..., None])[..., 0])

    def over_bound(self, some=EVERY):
        """Squared errors over the bound, mean over the parameters, by trial."""
        return (self.error**2 / np.diagonal(bound()))[:, some].mean(axis=1)


def sample(trials, seed):
    truth, rng = tumble(), np.random.default_rng(seed)
    parts = []
    for _ in range(trials // BLOCK):
        found = calibrated(truth, *drawn(truth, BLOCK, rng))
        assert found.fit.converged.all()
        own, fit = found.gyroscope, found.fit
        both = np.concatenate([own.accelerometer, own.parameters], axis=1)
        parts.append(
            (
                found.error, fit.covariance, fit.chi2_per_dof * fit.dof,
                both - TRUTH[:21], found.magnetometer.parameters - TRUTH[POSES],
                own.covariance, found.magnetometer.covariance,
            )
        )  # fmt: skip
    error, covariance, chi2, gyroscope, magnetometer, *two = (
        np.concatenate(each) for each in zip(*parts, strict=True)
    )
    return Sample(error, covariance, chi2, fit.dof, gyroscope, magnetometer, tuple(two))


def judged(found, comparisons):
    """Whether NEES, chi-square and the errors over the bound are what they must be."""
    scores = [
        z_of_mean(found.nees(), 34),
        z_of_mean(found.chi2, found.dof),
        z_of_mean(found.over_bound(), 1.0),
    ]
    return np.abs(scores) < limit(comparisons)


@pytest.fixture(scope="module")
def some():
    return sample(60, 21)


@pytest.mark.slow
def test_error_bars_hold(some):
    """60 trials: NEES of 34, chi-square of 206, squared errors over the bound."""
    assert some.dof == 206
    assert judged(some, 3).all()


@pytest.mark.slow
def test_error_bars_hold_in_1500_trials():
    found = sample(1500, 22)
    assert judged(found, 7).all()
    for part, size in ((ACC, 9), (GYRO, 12), (MAG, 13)):
        assert abs(z_of_mean(found.nees(part), size)) < limit(7)
    # the standard error of the mean over all is 0.7 %
    assert found.over_bound().mean() < 1.02
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    covered = (np.abs(found.error) < 1.959964 * sd).mean(axis=1)
    assert abs(z_of_mean(covered, 0.95)) < limit(7)
    assert abs(covered.mean() - 0.95) < 0.005
    assert stats.kstest(found.nees(), stats.chi2(34).cdf).pvalue > 1e-4
    # second-order bias, of the field's noise of half a percent, a tenth of an error bar
    shift = found.error.mean(axis=0) / found.error.std(axis=0)
    assert np.abs(shift).max() < 0.1 + limit(34) / 1500**0.5


@pytest.mark.slow
def test_gain_over_the_fits_of_two_is_seen():
    """Of the same readings; what theory says of the variances, with 600 trials."""
    found = sample(600, 23)
    mag = found.magnetometer
    blind = np.diagonal(bound(walk=1e5))
    for some, own in ((MAG, slice(9, 22)), (ACC, slice(0, 9))):
        seen = (found.error[:, some] ** 2 / blind[some]).mean(axis=1)
        alone = (mag[:, own] ** 2 / blind[some]).mean(axis=1)
        predicted = (np.diagonal(bound()) / blind)[some].mean()
        # of the difference, as both are of the same readings; 1 % is second order
        off = seen - predicted * alone
        room = limit(2) * off.std(ddof=1) / np.sqrt(len(off)) + 0.01
        assert abs(off.mean()) < room
        # power: without any gain
        assert abs((seen - alone).mean()) > room


# Power: covariances that forget what is shared, and a field that is read wrong.


@pytest.mark.slow
def test_poses_that_are_counted_twice_are_seen(some):
    """The two fits as if each had poses of its own: the accelerometer's bars."""
    e = some.gyroscope[:, :9], some.magnetometer[:, :9]
    J = [np.linalg.inv(C[:, :9, :9]) for C in some.two]
    both = np.linalg.inv(J[0] + J[1])
    right = sum(np.matvec(each, error) for each, error in zip(J, e, strict=True))
    error = np.matvec(both, right)
    nees = np.vecdot(error, np.matvec(J[0] + J[1], error))
    assert z_of_mean(nees, 9.0) > limit(1)
    assert nees.mean() > 14.0  # nearly twice the information
    assert abs(z_of_mean(some.nees(ACC), 9.0)) < limit(1)


@pytest.mark.slow
def test_covariance_without_the_shared_poses_is_seen(monkeypatch):
    """Each gap and each pose with noise of its own: the magnetometer's bars."""
    whole = fit.covariance_of

    def apart(L, blocks):
        V = whole(L, blocks)
        if blocks.shape[-1] < 3:  # the gyroscope's own fit
            return V
        rows = np.arange(V.shape[-1]) // 3
        return V * (rows[:, None] == rows)

    monkeypatch.setattr(fit, "covariance_of", apart)
    found = sample(400, 24)
    assert z_of_mean(found.nees(MAG), 13.0) > limit(2)  # 15 of 13
    assert z_of_mean(found.over_bound(MAG), 1.0) > limit(2)  # 1.14


@pytest.mark.slow
def test_a_field_that_is_turned_is_seen(some):
    """Three milliradians between the magnetometer's axes and those of the others."""
    error = some.error.copy()
    turned = 3e-3 * np.cross([0, 0, 1.0], TRUTH[21:30].reshape(3, 3).T).T
    error[:, 21:30] -= turned.ravel()
    assert not judged(replace(some, error=error), 3)[0]
