"""Magnetometer: bad input ends in words, thousands of good sets do not."""

import numpy as np
import pytest
from magnetometer_sets import (
    BODY_STD,
    FIELD,
    IRON_STD,
    G,
    made,
    normalised_squares,
    random_sensors,
    random_set,
    tilted,
)
from scipy import stats

from simval.calibrate import (
    calibrate,
    calibrate_magnetometer,
    ellipsoid_then_rotation,
)
from simval.errors import GeometryError, InputError, RefusedError, SimvalError
from simval.geometry import random_quaternions

NOISE = {"accelerometer_std": BODY_STD, "magnetometer_std": IRON_STD}
FORTY = random_set(40, 5)


def noisy(case, seed=1):
    body, iron = case.noisy(1, np.random.default_rng(seed))
    return body[0], iron[0]


def refused(body, iron, kind=GeometryError, **options):
    """The words with which a set is refused."""
    with pytest.raises(kind) as caught:
        calibrate_magnetometer(body, iron, G, FIELD, **(NOISE | options))
    return str(caught.value)


# what leaves something open


@pytest.mark.ci
@pytest.mark.parametrize("tilt", [0.0, 3.0, 8.0])
def test_turning_on_a_level_table_is_refused(tilt):
    for seed in range(3):
        said = refused(*noisy(made(tilted(40, tilt, seed)), seed))
        assert "as on a level table" in said
        assert "tilt it" in said


def test_turning_about_one_axis_is_refused():
    half = np.linspace(0.0, 3.0, 40)
    q = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=1)
    assert "lie in a plane, as when all turns are about one axis" in refused(
        *noisy(made(q))
    )


@pytest.mark.ci
@pytest.mark.parametrize("dip_deg", [90.0, -90.0, 89.6])
def test_a_vertical_field_is_refused(dip_deg):
    for seed in range(3):
        said = refused(*noisy(random_set(40, seed, dip_deg=dip_deg), seed))
        assert "along the vertical" in said


@pytest.mark.parametrize("dip_deg", [0.0, 60.0, -85.0, 88.5])
def test_any_other_dip_is_fitted(dip_deg):
    case = random_set(40, 5, dip_deg=dip_deg)
    found = calibrate_magnetometer(*noisy(case), G, FIELD, **NOISE)
    assert found.status == "converged"
    assert abs(found.dip - np.radians(dip_deg)) < 5.0 * found.sd[-1]


def test_too_few_poses_are_refused():
    for count in (1, 5, 7):
        said = refused(*noisy(random_set(count, 1)))
        assert f"{count} pose(s) given" in said
        assert "8 poses or more" in said


@pytest.mark.ci
def test_seven_poses_are_enough_beside_a_known_accelerometer():
    own = calibrate(noisy(random_set(20, 2))[0], G, noise_std=BODY_STD)
    said = refused(*noisy(random_set(6, 1)), known=own)
    assert "two equations for the magnetometer" in said
    assert "7 poses or more" in said
    case = random_set(8, 7)
    found = calibrate_magnetometer(*noisy(case), G, FIELD, known=own, **NOISE)
    assert found.status == "converged"
    assert found.dof == 11
    # one set: of 22 numbers the greatest is within 4.6 error bars in all but 1 of 1e4
    assert np.abs((found.parameters - case.truth) / found.sd).max() < 4.6
    assert "8 poses leave 11 degrees of freedom" in found.findings[0]


def test_near_the_equator_the_hemisphere_tells_nothing():
    case = noisy(random_set(40, 5, dip_deg=0.0))
    said = refused(*case, kind=RefusedError, hemisphere="north")
    assert "leave `hemisphere` out" in said
    assert calibrate_magnetometer(*case, G, FIELD, **NOISE).status == "converged"


def test_repeated_poses_are_refused():
    body, iron = (np.vstack([x, x[4:5]]) for x in noisy(FORTY))
    assert "poses 4 and 40 are identical" in refused(body, iron, RefusedError)
    # of one sensor alone they are none: a turn about the vertical leaves gravity
    iron[40] += 1.0
    calibrate_magnetometer(body, iron, G, FIELD, **NOISE)


# what is no pair of sensors


@pytest.mark.ci
def test_a_dead_axis_is_named():
    body, iron = noisy(FORTY)
    for k, axis in enumerate("xyz"):
        dead = iron.copy()
        dead[:, k] = 12.0
        assert f"axis {axis} of the magnetometer reads 12 in all 40" in refused(
            body, dead
        )
        dead = body.copy()
        dead[:, k] = 0.0
        assert f"axis {axis} of the accelerometer reads 0 in all 40" in refused(
            dead, iron
        )
        dead[:, k] = 1e-3 * np.random.default_rng(k).standard_normal(40)
        assert "lie in a plane" in refused(dead, iron)
    assert "reads the same in all 40 poses" in refused(body, 0.0 * iron)
    copied = iron.copy()
    copied[:, 1] = copied[:, 0]
    assert "magnetometer lie in a plane" in refused(body, copied)


def test_one_sensor_given_twice_is_refused():
    body, iron = noisy(FORTY)
    for both in (body, iron):
        said = refused(both, both, kind=RefusedError)
        assert "vertical" in said


def test_swapped_sensors_and_rows_are_refused():
    body, iron = noisy(FORTY)
    for a, m in ((iron, body), (body, np.roll(iron, 1, axis=0))):
        said = refused(a, m, kind=RefusedError)
        assert "check units, the order of the poses" in said
        assert "two sensors are not swapped" in said


def test_units_that_change_midway_are_refused_or_named():
    body, iron = noisy(FORTY)
    mixed = iron.copy()
    mixed[20:] /= 100.0
    assert "check units" in refused(body, mixed, kind=RefusedError)
    mixed = iron.copy()
    mixed[5] /= 1000.0
    found = calibrate_magnetometer(body, mixed, G, FIELD, **NOISE)
    assert found.disturbed[0] == 5
    assert "another unit" in found.findings[0]


def test_noise_that_is_far_too_low_hides_nothing():
    body, iron = noisy(FORTY)
    little = {"accelerometer_std": 1e-9, "magnetometer_std": 1e-9}
    assert "as much as the stated noise explains" in refused(
        body, iron, RefusedError, **little
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"magnetometer_std": 0.0}, "is 0 for 40 of 40 poses"),
        ({"magnetometer_std": np.ones(39)}, "one for each of the 40"),
        ({"time": np.zeros(40)}, "spans 0.0 s"),
        ({"time": np.arange(39)}, "last axes must be"),
    ],
)
def test_options_that_do_not_fit_the_poses(change, words):
    """What is wrong by itself is `test_magnetometer_faces`'s."""
    assert words in refused(*noisy(FORTY), InputError, **change)


@pytest.mark.parametrize("which", [0, 1])
def test_sensors_of_other_poses_are_refused(which):
    pair = list(noisy(FORTY))
    for bad in (pair[which][:-1], pair[which][None], np.tile(pair[which][:1], (40, 1))):
        given = [bad if k == which else x for k, x in enumerate(pair)]
        with pytest.raises(SimvalError):
            calibrate_magnetometer(*given, G, FIELD, **NOISE)
        with pytest.raises(SimvalError):
            ellipsoid_then_rotation(*given)


@pytest.mark.parametrize("size", [1e-30, 1e-12, 1e12, 1e30])
def test_any_unit_is_a_unit(size):
    body, iron = noisy(FORTY)
    plain = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    found = calibrate_magnetometer(
        body, size * iron, G, FIELD,
        accelerometer_std=BODY_STD, magnetometer_std=size * IRON_STD,
    )  # fmt: skip
    # rounding times the condition of the normal matrix
    np.testing.assert_allclose(found.M * size, plain.M, rtol=1e-8, atol=1e-10)
    assert found.chi_square == pytest.approx(plain.chi_square, rel=1e-8)


# many of them


def garbage(rng):
    """A pair of arrays of the right shape that are no calibration's poses."""
    count = int(rng.integers(8, 40))
    body, iron = rng.standard_normal((2, count, 3))
    kind = rng.integers(6)
    if kind == 1:
        iron = body @ rng.standard_normal((3, 3)) + 0.01 * iron
    elif kind == 2:
        body[:, rng.integers(3)] *= 1e-9
    elif kind == 3:
        body = np.round(body)
    elif kind == 4:
        iron = np.cumsum(iron, axis=0)
    elif kind == 5:
        body = body / np.linalg.norm(body, axis=1, keepdims=True)
    return body * 10.0 ** rng.uniform(-6, 6), iron * 10.0 ** rng.uniform(-6, 6)


def outcome(body, iron, std):
    """What is said of a set: the words of a refusal, or the findings of a fit."""
    try:
        found = calibrate_magnetometer(
            body, iron, accelerometer_std=std[0], magnetometer_std=std[1]
        )
    except SimvalError as error:
        return str(error)
    assert np.isfinite(found.parameters).all()
    return " ".join(found.findings)


@pytest.mark.slow
def test_garbage_never_passes_in_silence():
    """Random numbers: refused, or a fit that says what is wrong with it."""
    rng = np.random.default_rng(12)
    for _ in range(30):
        pair = garbage(rng)
        std = [float(np.abs(x).max()) * 10.0 ** rng.uniform(-6, -2) for x in pair]
        assert len(outcome(*pair, std)) > 30


def good_sets(count, trials, rng, dip_deg=80.0):
    """Readings of random sensors in random attitudes, and their truth."""
    sets = []
    for _ in range(trials):
        body, iron = random_sensors(rng)
        q = random_quaternions(count, rng)
        sets.append(made(q, rng.uniform(-dip_deg, dip_deg), body, iron))
    body = np.array([s.body for s in sets])
    iron = np.array([s.iron for s in sets])
    body = body + BODY_STD * rng.standard_normal(body.shape)
    iron = iron + IRON_STD * rng.standard_normal(iron.shape)
    return body, iron, np.array([s.truth for s in sets])


@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 20, 40])
def test_thousands_of_random_sets_are_fitted(count):
    """From twelve poses on every set is fitted, and none is wrong."""
    trials = 1500
    body, iron, truth = good_sets(count, trials, np.random.default_rng(count))
    found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    refusals = np.mean(~np.asarray(found.converged))
    assert refusals <= (0.01 if count == 12 else 0.0)  # error bars above 15 %
    good = np.asarray(found.converged)
    squares = normalised_squares(
        (found.parameters - truth)[good], found.covariance[good]
    )
    # a wrong answer is hundreds of standard deviations off; by chance one set of all
    # exceeds the limit in 1e4 runs, and bars of first order are allowed a third more
    assert squares.max() < 4.0 / 3.0 * stats.chi2.isf(1e-4 / trials, 22)
    # chi-square of the residuals: the mean over trials, one alarm in 1e4
    mean = found.chi_square[good].mean() / found.dof
    assert abs(mean - 1.0) < 3.9 * np.sqrt(2.0 / found.dof / good.sum()) + 0.01


@pytest.mark.slow
def test_eight_poses_are_fitted_refused_or_warned_of():
    """Eight poses: what is wrong is rare, and each fit says that it may be."""
    trials = 400
    body, iron, truth = good_sets(8, trials, np.random.default_rng(8))
    found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    good = np.asarray(found.converged)
    assert good.mean() > 0.7
    off = np.abs((found.parameters - truth) / found.sd)[good].max(axis=1)
    assert np.mean(off > 6.0) < 0.05
    assert "refused: two calibrations fit alike" in found.status
    one = np.flatnonzero(good)[0]
    single = calibrate_magnetometer(body[one], iron[one], G, FIELD, **NOISE)
    assert "another calibration may fit as well" in single.findings[0]
    np.testing.assert_array_equal(single.parameters, found.parameters[one])
    alike = np.flatnonzero(found.status == "refused: two calibrations fit alike")[0]
    assert "add poses, twelve or more" in refused(body[alike], iron[alike])
