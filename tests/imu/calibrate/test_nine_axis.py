"""Three sensors in one fit: rows, recovery, limiting cases, the bound, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from magnetometer_sets import FIELD, IRON, IRON_STD, squares
from nine_axes import DIP, GYRO, TRUTH, attitudes, calibrated, drawn
from scipy import stats
from scipy.spatial.transform import Rotation
from tumbles import ACCELEROMETER, FORCE_STD, GYROSCOPE, WALK, path_of, tumble

from simval.errors import ConvergenceError, GeometryError, InputError
from simval.imu.calibrate import fit as calibrate_all
from simval.imu.calibrate import recording_of
from simval.imu.calibrate.joint import together
from simval.imu.calibrate.path_statistics import taken
from simval.theory import MovePath, nine_axis_moments

POSES = np.r_[0:9, 21:34]  # parameters of accelerometer and magnetometer


@pytest.fixture(scope="module")
def given():
    """The fits of two trials of twenty poses, which are good."""
    truth = tumble(20)
    return calibrated(truth, *drawn(truth, 2, np.random.default_rng(6)))


@pytest.fixture(scope="module")
def whole(given):
    return given.fit


def again(given, recording=None, **parts):
    """The one fit from these of two sensors each."""
    starts = {
        name: replace(given.parts[name], **{name: parts.get(name, own)})
        for name, own in given.sensors.items()
    }
    return together(recording or given.recording, starts)


@pytest.mark.ci
def test_variances_over_the_bound():
    """The bound has every attitude unknown, and shares no formula with the fit."""
    truth = tumble()
    found = calibrated(truth, *drawn(truth, 1, np.random.default_rng(8)))
    stated = np.diagonal(found.fit.covariance[0])
    at, path = attitudes(truth), path_of(truth)
    # taken at a noisy estimate, of a field that is known to half a percent; power: a
    # magnetometer that is ten percent noisier is told
    for times, room in ((1.0, (0.0, 0.03)), (1.1, (0.1, 1.0))):
        bound = nine_axis_moments(
            GYROSCOPE, ACCELEROMETER, IRON, at, DIP, path, pose_std=truth.pose_std,
            field_std=times * IRON_STD, g=truth.g, field=FIELD, angle_random_walk=WALK,
            bias_std=WALK / np.sqrt(found.recording.rotations.rest_seconds.sum()),
        ).cramer_rao  # fmt: skip
        off = np.abs(stated / np.diagonal(bound) - 1.0).max()
        assert room[0] < off < room[1]


def test_starts_are_left_or_refused_and_neighbours_stay(given, whole):
    compass = given.magnetometer
    values = compass.parameters.copy()
    values[0] = np.nan
    status = np.array(["refused: rank below 22", "converged"])
    broken = replace(compass, parameters=values, status=status)
    fit = again(given, magnetometer=broken)
    assert list(fit.status) == ["refused: rank below 22", "converged"]
    assert np.isnan(fit.parameters[0]).all()
    np.testing.assert_allclose(fit.parameters[1], whole.parameters[1], atol=1e-5)
    with pytest.raises(ConvergenceError, match="the first is trial 0"):
        fit.require_converged()
    # from afar
    values = compass.parameters.copy()
    values[0, 9:] *= 0.5
    fit = again(given, magnetometer=replace(compass, parameters=values))
    assert fit.converged.all()
    # linearised within 1e-3 of an error bar of the end, times the relative noise
    assert np.abs((fit.parameters - whole.parameters) / fit.sd).max() < 1e-5
    # the poses of another order, with their own noise
    recording = given.recording
    fit = again(given, replace(recording, fields=recording.fields[:, ::-1]))
    assert not fit.converged.any()
    with pytest.raises(ConvergenceError, match="disagree by more"):
        fit.require_converged()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"field_std": [1.0, 2.0]}, "`field_std` has shape"),
        ({"known_bias": [0, 0, 0]}, "`known_bias` is given"),
        ({"fields": np.zeros((2, 3, 3))}, "give the means of both"),
        ({"model": "upper"}, "g=fit.g"),
        ({"time": np.zeros(20)}, "spans 0.0 s"),
    ],
)
def test_a_recording_that_cannot_be_is_refused(given, change, words):
    with pytest.raises(InputError, match=words):
        replace(given.recording, **change)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"estimator": "generalised"}, "`estimator` is for a gyroscope alone"),
        ({"known": 3, "sensors": ["gyroscope"]}, "`known` is for a magnetometer alone"),
        ({"sensors": ["barometer"]}, "`sensors`"),
        ({"sensors": []}, "no sensor beside the accelerometer"),
    ],
)
def test_a_fit_that_cannot_be_is_refused(given, how, words):
    with pytest.raises(InputError, match=words):
        calibrate_all(given.recording, **how)


@pytest.mark.parametrize("sensors", [["gyroscope"], ["magnetometer"], None])
def test_errors_of_terms_are_in_the_covariance(given, sensors):
    """Each adds the square of what a shift of one sd does, by fits of other means."""
    both = given.recording
    one = replace(
        both, poses=both.poses[0], fields=both.fields[0],
        rotations=taken(both.rotations, [0]), accelerometer=None,
    )  # fmt: skip
    rng = np.random.default_rng(4)
    errors = {
        name: size * rng.standard_normal((2, 20, 3))
        for name, size in (("accelerometer", 1e-3), ("magnetometer", 2.0))
    }
    known = replace(one, taken=one.taken._replace(shifts=errors))

    def found(**means):
        fit = calibrate_all(replace(one, **means), sensors, start=np.eye(3))
        return fit.parameters, fit.covariance

    P, h = found()[1], 0.05
    for name, means in (("accelerometer", "poses"), ("magnetometer", "fields")):
        for shift in errors[name]:
            ends = (
                found(**{means: getattr(one, means) + s * shift})[0] for s in (h, -h)
            )
            by = np.subtract(*ends) / (2.0 * h)
            P = P + np.outer(by, by)
    sd = np.sqrt(np.diagonal(P))
    stated = calibrate_all(known, sensors, start=np.eye(3)).covariance
    np.testing.assert_allclose(
        stated / np.outer(sd, sd), P / np.outer(sd, sd), rtol=0, atol=0.02
    )
    # power: without them
    assert np.abs(found()[1] / np.outer(sd, sd) - P / np.outer(sd, sd)).max() > 0.2


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
        (ONE_AXIS, GeometryError, "of the 34 parameters open"),
    ],
)
def test_theory_refuses_what_it_cannot_tell(change, error, words):
    truth = tumble(20)
    told = {
        "gyroscope": GYROSCOPE, "accelerometer": ACCELEROMETER, "magnetometer": IRON,
        "attitudes": attitudes(truth), "dip": DIP, "path": path_of(truth, 4),
        "pose_std": 1e-3, "field_std": IRON_STD, "bias_std": 1e-4,
        "angle_random_walk": WALK,
    }  # fmt: skip
    with pytest.raises(error, match=words):
        nine_axis_moments(**told | change)


def test_the_sensors_parts_are_the_whole(given, whole):
    """Each sensor's own result shows the numbers of the one fit."""
    for part, at in ((whole.gyroscope, GYRO), (whole.magnetometer, POSES)):
        np.testing.assert_array_equal(part.parameters, whole.parameters[:, at])
        np.testing.assert_array_equal(part.sd, whole.sd[:, at])
    own = whole.gyroscope.accelerometer
    np.testing.assert_array_equal(own, whole.parameters[:, :9])
    assert len(whole.names) == len(set(whole.names)) == 34
    assert np.all(whole.magnetometer.half_width < given.magnetometer.half_width)


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
        recording = recording_of(
            truth.time, force, truth.intervals, gyroscope=rows[0], g=truth.g, bias=bias,
            pose_std=truth.pose_std, angle_random_walk=WALK, sensitivity=sensitivity,
            bias_random_walk=0.0, chunk=2, field=FIELD, hemisphere="north",
        )  # fmt: skip
        imu = calibrate_all(recording, start=np.eye(3))
        recording = replace(recording, fields=fields[0], field_std=IRON_STD)
        compass = calibrate_all(recording, ["magnetometer"])
        parts = {"gyroscope": imu, "magnetometer": compass}
        fit = together(recording, parts)
        assert fit.noise.borne
        assert np.any(recording.taken.G) == sensitivity
        free = np.r_[0:18, 21:34] if bias == "line" else np.arange(34)
        C = fit.covariance[np.ix_(free, free)]
        total += squares((fit.parameters - TRUTH)[free], C)
        own = fit.gyroscope
        if bias == "line":
            np.testing.assert_array_equal(own.B, imu.gyroscope.B)
            np.testing.assert_allclose(own.sd[9:], imu.gyroscope.sd[9:], rtol=1e-12)
        rest += fit.chi2_per_dof * fit.dof
        # a magnetometer that tells nothing: what the moves share is the gyroscope's
        blind = together(replace(recording, field_std=1e5 * IRON_STD), parts)
        sd = np.sqrt(np.diagonal(imu.covariance))
        np.testing.assert_allclose(blind.gyroscope.sd, sd[9:], rtol=1e-4)
    for value, dof in ((total, logs * free.size), (rest, logs * fit.dof)):
        # one in 1e5 on either side; without what lines add, the rows leave 1.3 times
        assert stats.chi2.ppf(1e-5, dof) < value < stats.chi2.isf(1e-5, dof)
