"""Three sensors in one fit: rows, recovery, limiting cases, the bound, refusals."""

from dataclasses import fields as fields_of_class
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fits import CASES, CLEAN, squares
from magnetometer_sets import FIELD, IRON, IRON_STD
from nine_axes import (
    ACC,
    DIP,
    GYRO,
    MAG,
    TRUTH,
    attitudes,
    calibrated,
    drawn,
    fields_of,
)
from scipy import stats
from scipy.spatial.transform import Rotation
from tumbles import ACCELEROMETER, FORCE_STD, GYROSCOPE, WALK, path_of, tumble

from simval.errors import (
    ConvergenceError,
    GeometryError,
    InputError,
)
from simval.geometry import attitude_matrix
from simval.imu.calibrate import (
    ImuFit,
    calibrate_imu,
    calibrate_magnetometer,
    calibrate_nine_axis,
)
from simval.imu.calibrate.gyroscope.imu import ImuReadings
from simval.theory import (
    MovePath,
    nine_axis_moments,
)

POSES = np.r_[0:9, 21:34]  # parameters of accelerometer and magnetometer


@cache
def bound(walk=WALK, field_std=IRON_STD, pieces=40):
    """Cramer-Rao bound of all 34 at a tumble of 40 poses."""
    truth = tumble()
    rows = np.diff(truth.intervals)[:, 0]
    margins = np.full(len(rows), 20)  # ten rows on either side are the moves'
    margins[[0, -1]] = 10
    seconds = (rows - margins).sum() * (truth.time[1] - truth.time[0])
    return nine_axis_moments(
        GYROSCOPE, ACCELEROMETER, IRON, attitudes(truth), DIP, path_of(truth, pieces),
        pose_std=truth.pose_std, field_std=field_std,
        bias_std=WALK / np.sqrt(seconds), g=truth.g, field=FIELD,
        angle_random_walk=walk,
    ).cramer_rao  # fmt: skip


def again(found, poses, fields, gyroscope=None, magnetometer=None, **changed):
    """The one fit alone, from other starts or with other noise."""
    given = {"pose_std": 1e-3, "field_std": IRON_STD, "angle_random_walk": WALK}
    return calibrate_nine_axis(
        found.moves,
        poses,
        fields,
        gyroscope or found.gyroscope,
        magnetometer or found.magnetometer,
        **given | changed,
    )


def test_wrong_starts_lead_to_the_same_end():
    """Starts a percent off, readings of `fits` without noise."""
    case, rng = CASES["nine axes"], np.random.default_rng(4)
    clean = {name: values[None] for name, values in CLEAN.items()}
    fit = case.fit(clean, times=1e-6)
    noise = {"pose_std": 1e-10, "field_std": 5e-9, "angle_random_walk": 1e-11}
    starts = []
    for part in (fit.gyroscope, fit.magnetometer):
        off = 0.01 * rng.standard_normal(part.parameters.shape)
        values = part.parameters + off * np.maximum(np.abs(part.parameters), 1e-2)
        starts.append(replace(part, parameters=values))
    found = calibrate_nine_axis(
        case.moves(clean["rates"]), clean["poses"], clean["fields"], *starts, **noise
    )
    assert found.converged.all()
    assert found.iterations[0] > 2
    size = case.units({"poses": 1.0, "rates": 1.0, "fields": 1000.0 / FIELD})
    assert np.abs((found.parameters[0] - case.truth) / size).max() < 1e-11


@pytest.fixture(scope="module")
def noisy():
    truth = tumble(20)
    data = drawn(truth, 2, np.random.default_rng(6))
    return truth, data, calibrated(truth, *data)


@pytest.mark.ci
def test_moves_that_tell_nothing_leave_the_magnetometers_fit(noisy):
    """With an endless walk the rows of the gaps count for nothing."""
    truth, (poses, _, fields), found = noisy
    fit = again(
        found, poses, fields, pose_std=truth.pose_std, angle_random_walk=1e4
    )  # fmt: skip
    off = (fit.parameters[:, POSES] - found.magnetometer.parameters) / (
        found.magnetometer.sd
    )
    # both solve the same equations to 1e-6 of a standard deviation
    assert np.abs(off).max() < 1e-5
    np.testing.assert_allclose(
        fit.magnetometer.covariance, found.magnetometer.covariance,
        rtol=0, atol=1e-6 * np.abs(found.magnetometer.covariance).max(),
    )  # fmt: skip
    np.testing.assert_allclose(fit.magnetometer.sd, found.magnetometer.sd, rtol=1e-6)
    # power: with its walk they differ
    far = (found.fit.parameters[:, POSES] - found.magnetometer.parameters) / (
        found.magnetometer.sd
    )
    assert np.abs(far).max() > 0.3


def test_a_magnetometer_that_tells_nothing_leaves_the_gyroscopes_fit(noisy):
    """The gyroscope's fit takes its weights once, a step before its end."""
    truth, (poses, _, fields), found = noisy
    fit = again(found, poses, fields, pose_std=truth.pose_std, field_std=1e5)
    own = found.gyroscope
    whole = np.concatenate([own.accelerometer, own.parameters], axis=1)
    sd = np.sqrt(np.diagonal(own.covariance, axis1=1, axis2=2))
    # a step of a hundredth of the weights' own noise of 1e-4, and that of the answer
    assert np.abs((fit.parameters[:, :21] - whole) / sd).max() < 2e-2
    np.testing.assert_allclose(fit.sd[:, :21], sd, rtol=5e-3)
    far = (found.fit.parameters[:, :21] - whole) / sd
    assert np.abs(far).max() > 5e-2


@pytest.mark.ci
def test_variances_over_the_bound():
    """The bound has every attitude unknown, and shares no formula with the fit."""
    truth = tumble()
    fit = calibrated(truth, *drawn(truth, 1, np.random.default_rng(8))).fit
    stated = np.diagonal(fit.covariance[0])
    # taken at a noisy estimate, of a field that is known to half a percent
    np.testing.assert_allclose(stated / np.diagonal(bound()), 1.0, atol=0.03)
    # power: a magnetometer that is ten percent noisier is told
    other = np.diagonal(bound(field_std=1.1 * IRON_STD))
    assert np.abs(stated / other - 1.0).max() > 0.1


def test_a_refused_trial_leaves_its_neighbours(noisy):
    truth, (poses, _, fields), found = noisy
    values = found.magnetometer.parameters.copy()
    values[0] = np.nan
    status = np.array(["refused: rank below 22", "converged"])
    compass = replace(found.magnetometer, parameters=values, status=status)
    fit = again(found, poses, fields, None, compass, pose_std=truth.pose_std)
    assert list(fit.status) == ["refused: rank below 22", "converged"]
    assert np.isnan(fit.parameters[0]).all()
    np.testing.assert_allclose(
        fit.parameters[1], found.fit.parameters[1], rtol=0, atol=1e-5
    )
    with pytest.raises(ConvergenceError, match="the first is trial 0"):
        fit.require_converged()


def test_a_fit_comes_back_from_afar_or_says_that_it_does_not(noisy):
    truth, (poses, _, fields), found = noisy
    far = found.magnetometer.parameters.copy()
    far[0, 9:] *= 0.5
    compass = replace(found.magnetometer, parameters=far)
    fit = again(found, poses, fields, None, compass, pose_std=truth.pose_std)
    assert fit.converged.all()
    # linearised within 1e-3 of an error bar of the end, times the relative noise
    assert np.abs((fit.parameters - found.fit.parameters) / fit.sd).max() < 1e-5
    # the poses of another order, with their own noise
    fit = again(found, poses, fields[:, ::-1], pose_std=truth.pose_std)
    assert not fit.converged.any()
    with pytest.raises(ConvergenceError, match="disagree by more"):
        fit.require_converged()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"field_std": -1.0}, "`field_std` has shape"),
        ({"field_std": [1.0, 2.0]}, "`field_std` has shape"),
        ({"pose_std": np.nan}, "`pose_std`"),
        ({"angle_random_walk": -1.0}, "`angle_random_walk`"),
        ({"known_bias": [0, 0, 0]}, "`known_bias` is given"),
        ({"fields": np.zeros((2, 3, 3))}, "give the mean of both"),
        ({"poses": "no"}, "`poses`"),
        ({"gyroscope": None}, "`gyroscope`"),
        ({"gyroscope": {"estimator": "generalised"}}, "estimator=\"joint\""),
        ({"gyroscope": {"model": "upper"}}, "in the same form"),
        ({"magnetometer": 3}, "`magnetometer`"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(noisy, change, words):
    truth, (poses, _, fields), found = noisy
    given = {
        "moves": found.moves, "poses": poses, "fields": fields,
        "gyroscope": found.gyroscope, "magnetometer": found.magnetometer,
        "pose_std": truth.pose_std, "field_std": IRON_STD,
    }  # fmt: skip
    for name, value in change.items():
        swap = isinstance(value, dict)
        given[name] = replace(given[name], **value) if swap else value
    with pytest.raises(InputError, match=words):
        calibrate_nine_axis(**given)


ONE_AXIS = {
    "attitudes": Rotation.from_rotvec(
        np.outer(np.arange(10), [0.0, 0.0, 0.6])
    ).as_quat(),
    "path": MovePath(
        turns=np.tile([0.0, 0.0, 0.15], (9, 4, 1)), seconds=np.full((9, 4), 0.25)
    ),
}


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"dip": 1.5705}, InputError, "`dip`"),
        ({"field_std": 0.0}, InputError, "noise above 0"),
        ({"attitudes": np.eye(4)}, InputError, "a rotation between any two rests"),
        ({"magnetometer": None}, InputError, "`magnetometer`"),
        ({"angle_random_walk": -1.0}, InputError, "`angle_random_walk`"),
        (ONE_AXIS, GeometryError, "of the 34 parameters open"),
    ],
)
def test_theory_refuses_what_it_cannot_tell(change, error, words):
    truth = tumble(20)
    given = {
        "gyroscope": GYROSCOPE, "accelerometer": ACCELEROMETER, "magnetometer": IRON,
        "attitudes": attitudes(truth), "dip": DIP, "path": path_of(truth, 4),
        "pose_std": 1e-3, "field_std": IRON_STD, "bias_std": 1e-4,
        "angle_random_walk": WALK,
    }  # fmt: skip
    with pytest.raises(error, match=words):
        nine_axis_moments(**given | change)


def test_the_sensors_parts_are_the_whole(noisy):
    """Each sensor's own result shows the numbers of the one fit."""
    fit = noisy[2].fit
    np.testing.assert_array_equal(fit.gyroscope.parameters, fit.parameters[:, GYRO])
    np.testing.assert_array_equal(fit.gyroscope.sd, fit.sd[:, GYRO])
    np.testing.assert_array_equal(fit.gyroscope.accelerometer, fit.parameters[:, :9])
    np.testing.assert_array_equal(fit.magnetometer.parameters, fit.parameters[:, POSES])
    np.testing.assert_array_equal(fit.magnetometer.sd, fit.sd[:, POSES])
    assert len(fit.names) == len(set(fit.names)) == 34
    low, high = np.moveaxis(fit.confidence_intervals(0.95), -1, 0)
    np.testing.assert_allclose(high - low, 2 * 1.959964 * fit.sd, rtol=1e-6)
    assert np.all(fit.magnetometer.half_width < noisy[2].magnetometer.half_width)


@pytest.mark.ci
@pytest.mark.parametrize(("bias", "sensitivity"), [("line", False), ("constant", True)])
def test_models_of_the_bias_and_of_force_are_kept(bias, sensitivity):
    """Six logs each: chi-square of rows and parameters; the bias as the rests say."""
    truth, rng, logs = tumble(20), np.random.default_rng(7), 6
    total, rest = 0.0, 0.0
    for _ in range(logs):
        _, rows, fields = drawn(truth, 1, rng)
        force = ACCELEROMETER.distort(truth.force, rng)
        force += FORCE_STD * rng.standard_normal(force.shape)
        imu = calibrate_imu(
            truth.time, force, rows[0], truth.intervals, g=truth.g, bias=bias,
            pose_std=truth.pose_std, angle_random_walk=WALK, sensitivity=sensitivity,
            bias_random_walk=0.0, start=np.eye(3), chunk=2,
        )  # fmt: skip
        compass = calibrate_magnetometer(
            imu.reduced.poses, fields[0], truth.g, FIELD, hemisphere="north",
            accelerometer_std=truth.pose_std, magnetometer_std=IRON_STD,
        )  # fmt: skip
        fit = together(imu, compass, fields[0])
        assert fit.noise.borne
        assert np.any(imu.G) == sensitivity
        free = np.r_[0:18, 21:34] if bias == "line" else np.arange(34)
        C = fit.covariance[np.ix_(free, free)]
        sd = np.sqrt(np.diagonal(C))
        e = (fit.parameters - TRUTH)[free] / sd
        total += e @ np.linalg.solve(C / np.outer(sd, sd), e)
        own = fit.gyroscope
        if bias == "line":
            np.testing.assert_array_equal(own.B, imu.gyroscope.B)
            np.testing.assert_allclose(own.sd[9:], imu.gyroscope.sd[9:], rtol=1e-12)
        rest += fit.chi2_per_dof * fit.dof
        # a magnetometer that tells nothing: what the moves share is the gyroscope's
        blind = together(imu, compass, fields[0], 1e5 * IRON_STD)
        sd = np.sqrt(np.diagonal(imu.covariance))
        np.testing.assert_allclose(blind.gyroscope.sd, sd[9:], rtol=1e-4)
    for value, dof in ((total, logs * free.size), (rest, logs * fit.dof)):
        # one in 1e5 on either side; without what lines add, the rows leave 1.3 times
        assert stats.chi2.ppf(1e-5, dof) < value < stats.chi2.isf(1e-5, dof)


def together(imu, compass, fields, std=IRON_STD):
    """The fit of all of one recording, from those of two sensors."""
    own = imu.reduced
    return calibrate_nine_axis(
        own.moves, own.poses, fields, imu.gyroscope, compass, pose_std=own.pose_std,
        field_std=std, angle_random_walk=own.angle_random_walk,
        bias_random_walk=own.bias_random_walk, known_bias=own.known_bias,
        bias_std=own.bias_std,
    )  # fmt: skip


def imu_of(truth, found, poses):
    """The first trial as the fit of one recording."""
    reduced = ImuReadings(
        moves=found.moves, poses=poses[0], pose_std=np.tile(truth.pose_std, (3, 1)).T,
        angle_random_walk=np.full(3, WALK), bias_random_walk=0.0, known_bias=None,
        bias_std=WALK / found.moves.rest_seconds.sum() ** 0.5,
    )  # fmt: skip
    return ImuFit(
        accelerometer=None, gyroscope=single(found.gyroscope), reasons=(),
        G=np.zeros((3, 3)), G_sd=np.zeros((3, 3)), reduced=reduced,
    )  # fmt: skip


def test_a_sensor_of_more_noise_than_it_says_does_not_spoil_the_others(noisy):
    """A field of five times its noise: the others stay within their error bars."""
    truth, (poses, rows, _), _ = noisy
    rng = np.random.default_rng(9)
    fields = fields_of(truth) + 5.0 * IRON_STD * rng.standard_normal((20, 3))
    found = calibrated(truth, poses[:1], rows[:1], fields[None])
    imu, compass = imu_of(truth, found, poses), single(found.magnetometer)
    fit = together(imu, compass, fields)
    factor = dict(zip(fit.noise.sources, fit.noise.factor, strict=True))
    assert 3.8 < factor["magnetometer"] < 6.2  # 38 degrees of freedom, one in 1e4
    assert factor["accelerometer"] == factor["gyroscope"] == 1.0
    e = (fit.parameters - TRUTH) / fit.sd
    assert np.abs(e).max() < 4.6  # one in 1e4 of 34
    # power: taken at its word it would not fit
    worse = found.fit
    assert worse.chi2_per_dof[0] > 4.0
    assert np.abs((worse.parameters[0] - TRUTH) / worse.sd[0]).max() > 4.6


def test_headings_that_the_moves_do_not_know_are_the_magnetometers(noisy):
    """A field that turns about the vertical: only the moves can tell, and do."""
    truth, (poses, rows, _), _ = noisy
    rng = np.random.default_rng(10)
    turned = np.zeros((20, 4))
    half = 0.5 * 0.1 * rng.standard_normal(20)  # six degrees
    turned[:, 2], turned[:, 3] = np.sin(half), np.cos(half)
    along = FIELD * attitude_matrix(turned) @ [np.cos(DIP), 0.0, -np.sin(DIP)]
    along = (attitude_matrix(attitudes(truth)) @ along[..., None])[..., 0]
    fields = IRON.distort(along, rng) + IRON_STD * rng.standard_normal((20, 3))
    found = calibrated(truth, poses[:1], rows[:1], fields[None])
    imu, compass = imu_of(truth, found, poses), single(found.magnetometer)
    assert 0.4 < compass.chi2_per_dof < 1.9  # it sees nothing
    fit = together(imu, compass, fields)
    asked = dict(zip(fit.noise.sources, fit.noise.factor, strict=True))
    assert asked["magnetometer"] > 2.0
    assert asked["accelerometer"] == asked["gyroscope"] == 1.0
    assert "noise of the magnetometer" in fit.noise.sentences[0]
    assert np.abs((fit.parameters - TRUTH) / fit.sd).max() < 4.6
    # power: taken at its word
    worse = found.fit
    assert np.abs((worse.parameters[0] - TRUTH) / worse.sd[0]).max() > 4.6


def single(fit):
    """The first trial of a batch."""
    names = (each.name for each in fields_of_class(fit))
    batch = len(fit.parameters)
    taken = {}
    for name in names:
        value = getattr(fit, name)
        if isinstance(value, np.ndarray) and value.shape[:1] == (batch,):
            taken[name] = value[0]
    return replace(fit, **taken)


@pytest.mark.slow
def test_error_bars_and_the_gain_over_the_fits_of_two():
    """600 trials of forty poses, every sample drawn: the parts of each sensor, the
    squared errors over the bound, and what theory says of the fits of two."""
    truth, rng, parts = tumble(), np.random.default_rng(22), []
    for _ in range(60):
        found = calibrated(truth, *drawn(truth, 10, rng))
        fit = found.fit.require_converged()
        own = found.magnetometer.parameters - TRUTH[POSES]
        chi2 = fit.chi2_per_dof * fit.dof
        parts.append((fit.parameters - TRUTH, fit.covariance, chi2, own))
    error, covariance, chi2, alone = (
        np.concatenate(x) for x in zip(*parts, strict=True)
    )
    whole, blind = np.diagonal(bound()), np.diagonal(bound(walk=1e5))
    limit = stats.norm.isf(1e-4 / 12)

    def z(values, expected):
        return abs(values.mean() - expected) / (values.std() / np.sqrt(len(values)))

    assert z(chi2, fit.dof) < limit
    for some, size in ((slice(None), 34), (ACC, 9), (GYRO, 12), (MAG, 13)):
        nees = squares(error[:, some], covariance[:, some, some])
        assert z(nees, size) < limit
    assert z((error**2 / whole).mean(axis=1), 1.0) < limit
    # second-order bias, of the field's noise of half a percent, a tenth of an error bar
    shift = error.mean(axis=0) / error.std(axis=0)
    assert np.abs(shift).max() < 0.1 + stats.norm.isf(1e-4 / 68) / np.sqrt(len(error))
    for some, own in ((MAG, slice(9, 22)), (ACC, slice(0, 9))):
        seen = (error[:, some] ** 2 / blind[some]).mean(axis=1)
        two = (alone[:, own] ** 2 / blind[some]).mean(axis=1)
        # of the difference, as both are of the same readings; 1 % is second order
        off = seen - (whole / blind)[some].mean() * two
        room = limit * off.std(ddof=1) / np.sqrt(len(off)) + 0.01
        assert abs(off.mean()) < room
        assert abs((seen - two).mean()) > room  # power: without any gain
    # at these poses: of the magnetometer two thirds, of the accelerometer nine tenths
    assert 0.58 < (whole / blind)[MAG].mean() < 0.68
    assert np.all(whole[:9] < 0.92 * blind[:9])
