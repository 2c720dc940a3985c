"""The magnetometer's fit: twins, findings, recordings, sets that are no calibration.

What it shares with the other fits is in `test_fits`.
"""

import re

import numpy as np
import pytest
from magnetometer_sets import (
    BODY_STD,
    FIELD,
    IRON,
    IRON_STD,
    G,
    compass_of,
    made,
    random_sensors,
    random_set,
    squares,
    tilted,
)
from places import recording
from scipy import stats
from scipy.io import loadmat

from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import random_quaternions
from simval.imu.calibrate import (
    calibrate,
    ellipsoid_then_rotation,
)
from simval.imu.sensor import MagnetometerModel
from simval.poses import fibonacci_sphere

FORTY = random_set(40, 5)


def test_the_model_and_what_is_none():
    field = np.random.default_rng(1).standard_normal((7, 2, 3)) * FIELD
    raw = IRON.distort(field, np.random.default_rng(0))
    # a backward stable solve and a product of 3 x 3, numbers of 500
    np.testing.assert_allclose(IRON.correct(raw), field, rtol=0, atol=1e-11)
    assert not MagnetometerModel(M=-IRON.M, b=IRON.b).right_handed
    assert MagnetometerModel(M=1e-40 * np.eye(3), b=np.zeros(3)).right_handed
    for change, words in (
        ({"M": np.zeros((3, 3))}, "singular"),
        ({"M": 1e-100 * np.eye(3)}, "has size 1.0e-100"),
        ({"M": np.ones((3, 3))}, "singular"),
        ({"b": np.zeros((4, 3))}, "shape"),
    ):
        with pytest.raises(InputError, match=words):
            MagnetometerModel(**({"M": IRON.M, "b": IRON.b} | change))


def noisy(case, seed=1):
    body, iron = case.noisy(1, np.random.default_rng(seed))
    return body[0], iron[0]


def kinds(found):
    """What is to be known of a fit, by kind."""
    return [each.kind for each in found.findings]


def test_the_twin_is_exact_and_the_hemisphere_picks_one():
    body, iron = noisy(FORTY)
    unstated = compass_of(body, iron)
    assert "det M > 0" in unstated.assumption
    north, south = (compass_of(body, iron, hemisphere=h) for h in ("north", "south"))
    np.testing.assert_array_equal(north.parameters, unstated.parameters)
    np.testing.assert_array_equal(south.M, -north.M)
    assert south.dip == -north.dip
    assert south.chi_square == pytest.approx(north.chi_square, rel=1e-12)
    np.testing.assert_allclose(south.sd, north.sd, rtol=1e-9)
    assert north.right_handed
    assert not south.right_handed
    assert kinds(south) == ["axes"]
    assert not north.findings
    # a left-handed order of columns: seen where the hemisphere is stated, only there
    mirrored = iron * [1.0, -1.0, 1.0]
    assert not compass_of(body, mirrored).findings
    told = compass_of(body, mirrored, hemisphere="north")
    assert kinds(told) == ["axes"]
    np.testing.assert_allclose(told.M[:, 1], -north.M[:, 1], rtol=1e-9)


@pytest.mark.ci
def test_a_known_accelerometer_joins_with_its_covariance():
    # 200 trials: another calibration of the accelerometer each, then twelve poses
    rng, other, twelve = np.random.default_rng(8), random_set(20, 1), random_set(12, 7)
    trials = 200
    own = calibrate(other.noisy(trials, rng)[0], G, noise_std=BODY_STD)
    body, iron = twelve.noisy(trials, rng)
    found = compass_of(body, iron, known=own)
    assert found.dof == 3 * 12 + 9 - 22
    assert found.model == own.model
    assert found.converged.all()
    nees = squares(found.parameters - twelve.truth, found.covariance)
    # mean of chi-square(22) over 200: sd 0.47; one alarm in 1e4 is 3.9 of them
    assert abs(nees.mean() - 22.0) < 3.9 * np.sqrt(44.0 / trials)
    # it knows more than either alone
    assert np.all(found.sd[:, :9] <= own.sd * (1.0 + 1e-9))


# one trial, looked at


def varies_by(found):
    (first, *_) = found.findings
    assert first.kind == "varies"
    assert f"by {first.numbers['percent']:.2g} percent" in str(first)
    return first.numbers["percent"]


def test_a_field_that_varies_with_time_is_said():
    # a quiet sensor: the rise of 3 % is then known to 0.04 %
    std = {"pose_std": BODY_STD, "field_std": 0.25}
    body, iron = (
        x[0] for x in FORTY.noisy(1, np.random.default_rng(1), BODY_STD, 0.25)
    )
    rising = IRON.correct(iron) * (1.0 + 0.03 * np.linspace(0.0, 1.0, 40)[:, None])
    raw = IRON.distort(rising, np.random.default_rng(0))
    found = compass_of(body, raw, **std)
    # the trend is known to 0.1 %, and is small enough to be linear within a tenth
    assert 2.6 < varies_by(found) < 3.4
    assert not found.disturbed
    # poses in another order: the same set, and time says which
    order = np.random.default_rng(2).permutation(40)
    mixed = compass_of(body[order], raw[order], **std)
    assert "varies" not in kinds(mixed)
    told = compass_of(body[order], raw[order], time=60.0 * order, **std)
    assert varies_by(told) == pytest.approx(varies_by(found), rel=1e-6)


@pytest.mark.ci
def test_a_disturbed_pose_is_named_and_a_clean_set_is_left_alone():
    named = clean = varying = 0
    for seed in range(12):
        body, iron = noisy(FORTY, seed)
        alone = compass_of(body, iron)
        clean += bool(alone.disturbed)
        varying += "varies" in kinds(alone)
        iron[[3, 17]] += [[30.0, 0.0, 0.0], [0.0, 0.0, -25.0]]  # 12 and 10 sigma
        found = compass_of(body, iron)
        named += set(found.disturbed) == {3, 17}
        assert {3, 17} & set(found.findings[0].numbers["poses"])
        # linear: what leaving the pose out takes off, but for the noise squared
        keep = np.arange(40) != 3
        drop = found.chi_square - compass_of(body[keep], iron[keep]).chi_square
        assert drop == pytest.approx(found.pose_chi_square[3], rel=0.03)
    # each false in 1 of 100 clean sets: 4 or more of 12 has chance 5e-6
    assert max(clean, varying) < 4
    assert named >= 10  # the others name one more by chance
    rest = found.findings[0].numbers["chi2_per_dof_without"]
    low, high = stats.chi2.ppf([5e-5, 1.0 - 5e-5], 92) / 92  # one alarm in 1e4
    assert low < rest < high


def test_the_recipe_is_exact_without_noise_and_has_the_same_axes():
    found = ellipsoid_then_rotation(FORTY.body, FORTY.iron)
    expected = FORTY.truth[9:].copy()
    expected[:9] /= FIELD
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    iron = np.stack([FORTY.iron, FORTY.iron])
    iron[0, 3, 0] = np.nan  # a trial that is not finite is NaN, and its neighbour not
    batch = ellipsoid_then_rotation(np.stack([FORTY.body, FORTY.body]), iron)
    assert np.isnan(batch[0]).all()
    np.testing.assert_array_equal(batch[1], found)


# recordings: BROAD (Laidig, Caruso, Cereatti and Seel, Data 6(7), 2021, CC BY 4.0)

WINDOW = 29  # rows, 0.1 s
HAND, FIELD_STD = 0.15, 0.5  # m/s^2, microtesla
BERLIN = {"g": 9.8127, "field": 49.5}


def windows():
    """Means of both sensors over the windows in which the sensor moved."""
    path = recording("broad/05_undisturbed_slow_rotation_with_breaks_B.mat")
    log = loadmat(path)
    count = len(log["imu_acc"]) // WINDOW * WINDOW
    body, iron = (log[k][:count].reshape(-1, WINDOW, 3) for k in ("imu_acc", "imu_mag"))
    moved = log["movement"].ravel()[:count].reshape(-1, WINDOW).min(axis=1) > 0
    moved &= np.isfinite(body + iron).all(axis=(1, 2))
    return body.mean(axis=1)[moved], iron.mean(axis=1)[moved]


@pytest.mark.ci
def test_axes_and_dip_of_a_real_sensor_are_found():
    body, iron = (each[::15] for each in windows())
    given = {"pose_std": HAND, "field_std": FIELD_STD, **BERLIN}
    found = compass_of(body, iron, hemisphere="north", **given)
    assert found.status == "converged"
    assert found.right_handed
    # both sensors are on one board, aligned: a turn of some degrees at the most, and
    # scales within 15 % of microtesla
    np.testing.assert_allclose(found.M, np.eye(3), rtol=0, atol=0.15)
    assert abs(np.degrees(found.dip) - 68.0) < 4.0  # iron of the building
    # the same readings with their axes in the order of another sensor
    order = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    other = compass_of(body, iron @ order.T, **given)
    np.testing.assert_allclose(other.M @ order, found.M, rtol=0, atol=1e-8)
    assert "det M > 0" in other.assumption
    # the hand is no rest: chi-square does not believe the stated noise, or names poses
    assert found.findings


# what leaves something open, and what is no pair of sensors


def dead(which, axis, value):
    """Readings of forty poses, one axis of one sensor of which shows one value."""
    pair = [x.copy() for x in noisy(FORTY)]
    pair[which][:, axis] = value
    return pair


HALF = np.linspace(0.0, 3.0, 40)
ABOUT_Y = np.stack([0 * HALF, np.sin(HALF), 0 * HALF, np.cos(HALF)], axis=1)
BODY40, IRON40 = noisy(FORTY)
TWICE = [np.vstack([x, x[4:5]]) for x in (BODY40, IRON40)]
OPEN = {
    **{
        f"level, {tilt}": (noisy(made(tilted(40, tilt, 1))), "a level table.*tilt it")
        for tilt in (0.0, 8.0)
    },
    "one axis": (noisy(made(ABOUT_Y)), "in a plane, as when all turns are about one"),
    **{
        f"dip {dip}": (noisy(random_set(40, 1, dip_deg=dip)), "along the vertical")
        for dip in (-90.0, 89.6)
    },
    "seven": (noisy(random_set(7, 1)), r"7 pose\(s\) given.*8 poses or more"),
    "twice": (TWICE, "poses 4 and 40 are identical"),
    "dead y": (dead(1, 1, 12.0), "axis y of the magnetometer reads 12 in all 40"),
    "noise": (
        dead(0, 1, 1e-3 * np.random.default_rng(1).standard_normal(40)),
        "lie in a plane",
    ),
    "still": ((BODY40, 0.0 * IRON40), "reads the same in all 40 poses"),
    "copied": (dead(1, 1, IRON40[:, 0]), "magnetometer lie in a plane"),
    "one sensor": ((BODY40, BODY40), "vertical"),
    "one sensor, eight poses": (
        (G * fibonacci_sphere(8),) * 2,
        "8 poses leave some of the 22 parameters open",
    ),
    "swapped": ((IRON40, BODY40), "check units, the order.*sensors are not swapped"),
    "units": (
        (BODY40, IRON40 / np.where(np.arange(40) < 20, 1.0, 100.0)[:, None]),
        "check units",
    ),
}
OTHER = noisy(random_set(20, 1))[0]
OPEN = {name: (pair, {}, words) for name, (pair, words) in OPEN.items()} | {
    "no covariance": (
        (BODY40, IRON40), {"known": calibrate(OTHER, G, covariance=False)},
        "no covariance",
    ),
    "another g": (
        (BODY40, IRON40), {"known": calibrate(OTHER, 9.8, noise_std=BODY_STD)},
        r"g = 9\.8 .*g=fit.g",
    ),
    "a zenith": (
        noisy(random_set(40, 5, dip_deg=0.0)), {"hemisphere": "north"},
        "leave `hemisphere` out",
    ),
    "no noise": ((BODY40, IRON40), {"field_std": 0.0}, "0 for 40 of 40 poses"),
    "39 of it": (
        (BODY40, IRON40), {"field_std": np.ones(39)}, "one for each of the 40"
    ),
    "one time": ((BODY40, IRON40), {"time": np.zeros(40)}, "spans 0.0 s"),
    "39 times": ((BODY40, IRON40), {"time": np.arange(39)}, "last axes must be"),
    "too little noise": (
        (BODY40, IRON40), {"pose_std": 1e-9, "field_std": 1e-9},
        "as much as the stated noise explains",
    ),
}  # fmt: skip


EIGHT = "one sensor, eight poses"  # which tries many starts
OPENED = [pytest.param(n, marks=[pytest.mark.ci] * (n == EIGHT)) for n in OPEN]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", OPENED)
def test_a_set_that_is_no_calibration_is_refused_in_words(name):
    pair, options, words = OPEN[name]
    with pytest.raises((GeometryError, InputError, RefusedError), match=words):
        compass_of(*pair, **options)


MIXED = np.where(np.arange(40) == 5, 1e-3, 1.0)[:, None] * IRON40
LOUD = IRON40 + 15.0 * np.random.default_rng(5).standard_normal((40, 3))
SAID = {
    "hard iron": ((BODY40, IRON40 + 400.0 * np.eye(3)[0]), {}, "hard iron is"),
    "geometry": (noisy(made(tilted(40, 45.0, 1))), {}, "the geometry is the limit"),
    "nine poses": (noisy(random_set(9, 3)), {}, "9 poses leave 5 degrees of freedom"),
    "overstated": ((BODY40, IRON40), {"field_std": 25.0}, "overstated"),
    "another unit": ((BODY40, MIXED), {}, "pose 5 .*another unit"),
    "everywhere": ((BODY40, LOUD), {}, "the field is disturbed.*error bars would be"),
}


@pytest.mark.parametrize("name", SAID)
def test_what_is_near_a_refusal_is_fitted_and_said(name):
    pair, options, words = SAID[name]
    found = compass_of(*pair, **options)
    assert found.status == "converged"
    assert re.search(words, " ".join(map(str, found.findings)))
    document = found.as_document()
    assert document["findings"] == [str(each) for each in found.findings]
    # each has its kind, and says once what to do where anything is to be done
    for remark, each in zip(document["remarks"], found.findings, strict=True):
        assert remark == each.as_object()
        assert str(each).endswith(remark["do"])
        assert each.words.count(each.do or "none") == 0
    assert found.disturbed == ((5,) if name == "another unit" else ())


@pytest.mark.parametrize("dip_deg", [0.0, 60.0, -85.0, 88.5])
def test_any_dip_but_the_vertical_is_found(dip_deg):
    found = compass_of(*noisy(random_set(40, 5, dip_deg=dip_deg)))
    assert found.status == "converged"
    assert abs(found.dip - np.radians(dip_deg)) < 5.0 * found.sd[-1]
    # repeated for one sensor alone: a turn about the vertical leaves gravity
    body, iron = (x.copy() for x in TWICE)
    iron[40] += 1.0
    assert compass_of(body, iron).status == "converged"


# many of them


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
def test_a_thousand_random_sets_are_fitted():
    """Of twelve poses 1 % are refused, error bars above 15 %, and none is wrong."""
    trials, count = 1500, 12
    body, iron, truth = good_sets(count, trials, np.random.default_rng(count))
    found = compass_of(body, iron)
    good = np.asarray(found.converged)
    assert np.mean(~good) <= 0.01
    nees = squares((found.parameters - truth)[good], found.covariance[good])
    # a wrong answer is hundreds of standard deviations off; by chance one set of all
    # exceeds the limit in 1e4 runs, and bars of first order are allowed a third more
    assert nees.max() < 4.0 / 3.0 * stats.chi2.isf(1e-4 / trials, 22)


@pytest.mark.slow
def test_eight_poses_are_fitted_refused_or_warned_of():
    """Eight poses: what is wrong is rare, and each fit says that it may be."""
    trials = 400
    body, iron, truth = good_sets(8, trials, np.random.default_rng(8))
    found = compass_of(body, iron)
    good = np.asarray(found.converged)
    assert good.mean() > 0.7
    off = np.abs((found.parameters - truth) / found.sd)[good].max(axis=1)
    assert np.mean(off > 6.0) < 0.05
    assert "refused: two calibrations fit alike" in found.status
    one = np.flatnonzero(good)[0]
    single = compass_of(body[one], iron[one])
    assert kinds(single)[0] == "few poses"
    np.testing.assert_array_equal(single.parameters, found.parameters[one])
    alike = np.flatnonzero(found.status == "refused: two calibrations fit alike")[0]
    with pytest.raises(RefusedError, match="add poses, twelve or more"):
        compass_of(body[alike], iron[alike])
