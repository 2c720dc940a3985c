"""The judge of every linearised fit, against leaving out and refitting, and its power.

A false alarm of a test of many sets is one in 1e4, by the binomial of the rate that the
package states.
"""

from dataclasses import replace

import numpy as np
import pytest
from magnetometer_sets import FIELD, IRON_STD
from nine_axes import drawn
from scipy import stats
from test_core import pair
from tumbles import WALK, fitted, tumble

from simval.imu.calibrate import (
    calibrate_gyroscope,
    calibrate_magnetometer,
    calibrate_nine_axis,
)
from simval.imu.calibrate.equations import minimize, residuals
from simval.imu.calibrate.honesty import (
    FALSE_ALARM,
    Deletion,
    Left,
    Residuals,
    Source,
    least_determined_of,
)


def solved(problem, theta):
    """One trial at its end."""
    found = minimize(problem, theta, 50)
    assert found.converged.all()
    return problem.local(found.theta)


def test_leaving_out_is_what_a_fit_without_the_rest_finds():
    """Its noise times 1e6 instead: chi-square falls by what the judge says."""
    problem, theta = pair(trials=1, off=0.0)
    here = solved(problem, theta)
    told = Left(residuals(problem, here)).sensors()
    total, rows = float(here.chi_square[0]), len(here.rows[0])
    # the parts of the sensors add up exactly
    np.testing.assert_allclose(sum(s.chi_square for s in told), total, rtol=1e-10)
    np.testing.assert_allclose(sum(s.dof for s in told), rows - 22, rtol=1e-10)
    for s, sensor in enumerate(told):
        assert sensor.outliers == ()
        for rest in (0, 17, sensor.worst):
            std = problem.sensors[s].std.copy()
            std[:, rest] *= 1e6
            sensors = list(problem.sensors)
            sensors[s] = replace(sensors[s], std=std)
            without = solved(replace(problem, sensors=tuple(sensors)), theta)
            drop = total - float(without.chi_square[0])
            # relative: noise of 1e-3 of a reading bends the equations as much
            assert drop == pytest.approx(
                sensor.deviations[rest] ** 2, rel=0.02, abs=1e-3
            )


def linear(rng, shift=None, size=0.0):
    """Three sources in rows of their own and their neighbours', one item moved."""
    maps = np.zeros((3, 40, 6, 3))
    for source, L in enumerate(maps):
        L[12 * source : 12 * source + 16] = rng.standard_normal((16, 6, 3))
    xi = rng.standard_normal((3, 6, 3))
    if shift is not None:
        xi[shift] += size * np.array([0.6, -0.64, 0.48])
    sources = tuple(
        Source(
            name=name, covariance=np.einsum("rim,tim->rt", L, L), item="rest",
            items=np.moveaxis(L, 1, 0), parameters=slice(0, 8),
        )
        for name, L in zip("abc", maps, strict=True)
    )  # fmt: skip
    J = rng.standard_normal((40, 8))
    return Residuals(
        r=np.einsum("srim,sim->r", maps, xi), J=J, sources=sources,
        names=tuple("abcdefgh"),
    )  # fmt: skip


def named(told):
    return [(s, k) for s, each in enumerate(told) for k in each.outliers]


@pytest.mark.ci
def test_outliers_of_any_rows_at_their_level_and_power():
    """Correlated rows, items of three unknowns that share rows with each other."""
    rng, sets = np.random.default_rng(8), 150
    called = sum(bool(named(Left(linear(rng)).sensors())) for _ in range(sets))
    assert called <= stats.binom.isf(1e-4, sets, FALSE_ALARM)
    exact = 0
    for k in range(30):
        shift = (k % 3, k % 6)
        exact += named(Left(linear(rng, shift, 25.0)).sensors()) == [shift]
    assert exact >= 24


def test_residuals_without_several_items_are_those_of_a_new_fit():
    """Least squares by numpy on the rows and the columns of the items beside them."""
    rng = np.random.default_rng(3)
    J, r, items = (rng.standard_normal(n) for n in ((30, 5), 30, (8, 30, 2)))
    for given in (items, None):
        told = Deletion.of(J, r, given)
        U = np.eye(30)[:, :, None] if given is None else given
        for out in ([], [2], [1, 4, 6]):
            both = np.concatenate([J, *U[out]], axis=1)
            left = r - both @ np.linalg.lstsq(both, r, rcond=None)[0]
            np.testing.assert_allclose(told.without(out)[0], left, atol=1e-12)
            assert told.squares(out) == pytest.approx(left @ left)
        drop = told.squares([]) - told.squares([3])
        assert told.drops([])[3] == pytest.approx(drop)
        assert np.isnan(told.drops([1, 4])[[1, 4]]).all()
    np.testing.assert_allclose(Deletion.of(J, r).leverage().sum(), 5.0)
    hat = items.swapaxes(1, 2) @ J @ np.linalg.pinv(J) @ items
    share = np.trace(hat, axis1=1, axis2=2) / np.sum(items**2, axis=(1, 2))
    np.testing.assert_allclose(Deletion.of(J, r, items).leverage(), share)


@pytest.mark.parametrize(("size", "most"), [(1, 6), (2, 3)])
def test_an_outlier_is_called_from_the_level_that_is_stated(size, most):
    """One item of otherwise clean rows, its chance just below (O1) and just above."""
    rng = np.random.default_rng(12)
    J, r = rng.standard_normal((30, 5)), rng.standard_normal(30)
    items = None if size == 1 else rng.standard_normal((8, 30, size))
    U = np.eye(30)[:, [3]] if items is None else items[3]
    told = Deletion.of(J, r, items)
    clean, own = told.without([3])[0], U[:, 0] - J @ np.linalg.lstsq(J, U[:, 0])[0]
    for share, named in ((0.95, [3]), (1.05, [])):
        level = share * FALSE_ALARM / most / told.count
        F = stats.f.isf(level, size, 25 - size)  # by the scatter of the others
        drop = F * size * (clean @ clean) / (25 - size)
        moved = clean + np.sqrt(drop / (own @ own)) * own
        assert Deletion.of(J, moved, items).outliers(None) == named


def test_chances_are_those_of_chi_squares():
    """Of one sensor, and of three whose rows together are the least likely."""
    rng = np.random.default_rng(6)
    rows = linear(rng)
    one = replace(
        rows, sources=(replace(rows.sources[0], covariance=4.0 * np.eye(40)),)
    )
    squares = Deletion.of(one.J, one.r / 2.0).squares([])
    expected = stats.chi2.sf(squares, 32)
    assert Left(one).sensors()[0].p_value == pytest.approx(expected)
    assert Left(one).p_value() == pytest.approx(2.0 * expected)
    more = Left(replace(rows, r=2.0 * rows.r))
    told = more.sensors()
    whole = stats.chi2.sf(sum(each.chi_square for each in told), 32)
    assert whole < min(each.p_value for each in told)
    assert more.p_value() == pytest.approx(4.0 * whole)


def test_the_least_determined_combination_is_named():
    rng = np.random.default_rng(4)
    J = rng.standard_normal((30, 5)) * [1.0, 1e6, 1e-6, 3.0, 2.0]
    J[:, 3] = 7.0 * J[:, 1] + 1e4 * rng.standard_normal(30)  # 1e6 beside 1e4
    found = least_determined_of(J, tuple("abcde"))
    assert (found.rank, found.parameters) == (5, 5)
    assert found.words in ("0.71 b -0.71 d", "0.71 d -0.71 b")
    # a hundredth of their size apart, by seven: their difference, normalised
    whole = np.linalg.inv(J.T @ J)
    unit = np.array([0.0, 1.0, 0.0, -1.0, 0.0]) / np.sqrt(2.0)
    own = unit * np.linalg.norm(J, axis=0)
    assert found.widening == pytest.approx(np.sqrt(own @ whole @ own), rel=1e-2)
    J[:, 3] = 7.0 * J[:, 1]
    found = least_determined_of(J, tuple("abcde"))
    assert found.rank == 4
    assert "undetermined" in found.sentence


FAULTS = {"accelerometer": 0.05, "magnetometer": 12 * IRON_STD, "gyroscope": 0.01}


@pytest.mark.ci
@pytest.mark.parametrize("sensor", [None, *FAULTS])
def test_a_fault_in_each_sensor_is_named(sensor):
    """One rest or one move is off; all three joint fits say which, and no other."""
    truth = tumble(20, every=10, first_hold=10.0, hold_time=0.6, move_time=1.5)
    poses, rows, fields = drawn(truth, 1, np.random.default_rng(11))
    if sensor == "accelerometer":
        poses[0, 5, 1] += FAULTS[sensor]
    if sensor == "magnetometer":
        fields[0, 5, 1] += FAULTS[sensor]
    if sensor == "gyroscope":
        a, b = truth.intervals[5, 1], truth.intervals[6, 0]
        rows[0, a:b] += FAULTS[sensor] / (b - a) / 0.02 * np.array([1.0, -1.0, 1.0])
    std, noise = truth.pose_std, {"pose_std": truth.pose_std, "angle_random_walk": WALK}
    own, moves = fitted(truth, poses, rows, chunk=2)
    imu = calibrate_gyroscope(moves, poses[0], own, start=np.eye(3), **noise)
    compass = calibrate_magnetometer(
        poses[0], fields[0], truth.g, FIELD, hemisphere="north",
        accelerometer_std=std, magnetometer_std=IRON_STD,
    )  # fmt: skip
    nine = calibrate_nine_axis(
        moves, poses[0], fields[0], imu, compass, field_std=IRON_STD, **noise
    )
    for fit in (imu, compass, nine):
        told = {each.name: each for each in fit.noise.sensors}
        expected = {name: (5,) if name == sensor else () for name in told}
        assert {name: each.outliers for name, each in told.items()} == expected
        assert str(fit).count("farthest off") >= len(told)
        assert "least determined" in str(fit)
        if sensor in told:
            assert told[sensor].worst == 5
        if sensor is None:  # the parts are the whole, with turns as well
            whole = np.sum([(s.chi_square, s.dof) for s in told.values()], axis=0)
            chi_square = fit.chi2_per_dof * fit.dof
            np.testing.assert_allclose(whole, [chi_square, fit.dof], rtol=1e-6)
