"""Calibration of a gyroscope: recovery, real recording, refusals, forms, choices."""

import json
from dataclasses import replace

import numpy as np
import pytest
from places import RECORDINGS
from scipy.spatial.transform import Rotation
from tumbles import (
    ACCELEROMETER,
    FIRST_UP,
    GENERIC,
    GYROSCOPE,
    WALK,
    M,
    fitted,
    of,
    readings,
    rolled,
    tumble,
)

from simval.calibrate import (
    calibrate,
    calibrate_gyroscope,
    calibrate_imu,
    moves_between,
)
from simval.errors import GeometryError
from simval.logs import read_log
from simval.multiposition import calibrate_log
from simval.scene import simulate
from simval.sensor import GyroscopeModel

ZERO = np.random.default_rng(0)


@pytest.fixture(scope="module")
def short():
    """A tumble of twelve poses at 500 Hz."""
    return tumble(12, every=1, move_time=1.5, first_hold=1.0, hold_time=0.3)


@pytest.fixture(scope="module")
def slow_clock():
    """The same at 100 Hz."""
    return tumble(12, every=5, move_time=1.5, first_hold=1.0, hold_time=0.3)


def noise_free(truth, gyroscope=GYROSCOPE):
    poses = ACCELEROMETER.distort(truth.directions, ZERO)
    return poses, gyroscope.distort(truth.rate, ZERO), calibrate(poses, truth.g)


@pytest.mark.ci
@pytest.mark.parametrize("estimator", ["joint", "generalised", "unweighted"])
@pytest.mark.parametrize("bias", ["constant", "first rest"])
def test_noise_free_recovery_at_500_hz(short, estimator, bias):
    poses, rows, acc = noise_free(short)
    moves = moves_between(short.time, rows, short.intervals)
    fit = calibrate_gyroscope(
        moves, poses, acc, pose_std=0.0, estimator=estimator, bias=bias
    )
    assert fit.status == "converged"
    # averages with the bracket give the attitudes back to rounding; issue: 1e-9
    np.testing.assert_allclose(fit.M, M, atol=1e-12)
    np.testing.assert_allclose(fit.B, GYROSCOPE.B, atol=1e-12)


def test_noise_free_recovery_of_raw_counts_and_swapped_axes(short):
    """Counts around 32768, axes in another order: nothing was told."""
    order = np.eye(3)[[1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    counts = GyroscopeModel(
        M=2.1e-4 * M @ order, B=np.array([32771.0, 32458.0, 32513.0])
    )
    poses, rows, acc = noise_free(short, counts)
    moves = moves_between(short.time, rows, short.intervals, chunk=2)
    fit = calibrate_gyroscope(moves, poses, acc, pose_std=0.0)
    np.testing.assert_allclose(fit.M, counts.M, atol=2e-10)  # chunks of two
    assert fit.status == "converged"


@pytest.mark.ci
@pytest.mark.parametrize("scene", ["handheld", "shaker"])
def test_noise_free_recovery_on_other_scenes(scene):
    """Moves from the middle row of each rest to that of the next: exact there too."""
    many = {
        "handheld": {"poses": 12, "first_hold": 0.5, "hold_time": 0.5},
        "shaker": {"poses": 14, "hold_time": 0.5},
    }
    truth = of(simulate(scene, **many[scene]))
    middle = np.array([(a + b) // 2 for a, b in truth.intervals])
    # the package's quaternion of world to sensor is SciPy's of sensor to world
    u = Rotation.from_quat(truth.attitude[middle]).inv().apply([0.0, 0.0, 1.0])
    poses = ACCELEROMETER.distort(truth.g * u, ZERO)
    rows = GYROSCOPE.distort(truth.rate, ZERO)
    moves = moves_between(
        truth.time, rows, middle[:, None] + np.array([-1, 2]), margin=1
    )
    fit = calibrate_gyroscope(
        moves, poses, calibrate(poses, truth.g), pose_std=0.0,
        bias="first rest", known_bias=GYROSCOPE.B,
    )  # fmt: skip
    np.testing.assert_allclose(fit.M, M, atol=1e-9)


def test_at_100_hz_the_linear_scheme_is_visibly_biased(slow_clock):
    """Of order two: 1e-4, where averages leave 1e-7 and a 40-pose error bar is 7e-5."""
    poses, _, acc = noise_free(slow_clock)
    off = {}
    rows = {
        "averages": GYROSCOPE.distort(slow_clock.rate, ZERO),
        "linear": None,
        "cubic": None,
    }
    fine = tumble(12, every=1, move_time=1.5, first_hold=1.0, hold_time=0.3)
    # the rate of an instant: mean of the two steps beside it, of 2 ms
    instant = 0.5 * (fine.rate[:-1] + fine.rate[1:])[::5]
    rows["linear"] = rows["cubic"] = GYROSCOPE.distort(
        np.concatenate([instant, np.zeros((len(slow_clock.time) - len(instant), 3))]),
        ZERO,
    )
    for scheme, some in rows.items():
        moves = moves_between(
            slow_clock.time, some, slow_clock.intervals, scheme=scheme
        )
        fit = calibrate_gyroscope(moves, poses, acc, pose_std=0.0, start=np.eye(3))
        off[scheme] = np.abs(fit.M - M).max()
    assert off["averages"] < 1e-6
    assert off["cubic"] < 2e-5  # the instant is a mean over 4 ms: h^2 of that
    assert off["linear"] > 5e-5


@pytest.fixture(scope="module")
def xsens():
    folder = RECORDINGS / "xsens"
    if not folder.exists():
        pytest.skip(f"the recording {folder} is not on this machine")
    reference = json.loads((folder / "reference_results.json").read_text())
    force = np.loadtxt(folder / "xsens_acc.mat")
    rate = np.loadtxt(folder / "xsens_gyro.mat")
    return force, rate, reference


def inclusive(reference):
    """Its intervals as rows start <= row < stop."""
    bounds = np.array(reference["intervals_start_end_index_inclusive"])
    return bounds + np.array([0, 1])


@pytest.mark.ci
def test_imu_tk_is_reproduced_on_its_own_recording(xsens):
    """Estimator and integrator on request: its cost, and its T and K."""
    force, rate, reference = xsens
    theirs = reference["imu_tk_cpp"]
    rests = inclusive(reference)
    poses = np.array([force[a:b, 1:].mean(axis=0) for a, b in rests])
    acc = calibrate(poses, reference["g"], "upper")
    T = np.array(theirs["T"])
    off = [T[0, 1], T[0, 2], T[1, 2]]
    acc = replace(acc, parameters=np.concatenate([off, theirs["K"], theirs["B"]]))
    # it integrates from the last row of a rest to the one before the next rest
    moves = moves_between(
        rate[:, 0], rate[:, 1:], rests - np.array([1, 0]),
        scheme="linear", margin=0,
    )  # fmt: skip
    fit = calibrate_gyroscope(
        moves, poses, acc, pose_std=0.5, estimator="unweighted",
        bias="first rest", known_bias=theirs["Bg"],
    )  # fmt: skip
    assert abs(fit.cost / theirs["gyro_cost"] - 1.0) < 1e-6
    found = fit.factors()
    np.testing.assert_allclose(found.shape, theirs["Tg"], atol=1e-5)
    np.testing.assert_allclose(np.diagonal(found.rest), theirs["Kg"], rtol=1e-5)


@pytest.mark.parametrize("estimator", ["joint", "generalised", "unweighted"])
def test_the_answer_does_not_depend_on_where_the_fit_begins(estimator):
    """Weights and covariance are those at the solution, whatever the noise told."""
    truth = tumble(12, first_hold=1.0)
    poses, rows = readings(truth, 8, np.random.default_rng(3), times=5.0)
    own, moves = fitted(truth, poses, rows)
    how = {"pose_std": truth.pose_std, "angle_random_walk": WALK}
    ends = []
    for _ in range(2):
        fit = calibrate_gyroscope(moves, poses, own, estimator=estimator, **how)
        ends.append(fit)
        own = replace(own, parameters=fit.accelerometer)
        how["start"] = fit.M[0]
    first, again = ends
    off = np.abs(first.parameters - again.parameters) / first.sd
    assert off.max() < 1e-4  # a hundredth of the way, times noise over readings
    np.testing.assert_allclose(first.sd, again.sd, rtol=1e-4)


@pytest.mark.ci
def test_xsens_without_a_hint(xsens):
    """Raw counts, no start: within a percent of the factory's scales, and its gauge."""
    force, rate, reference = xsens
    rests = inclusive(reference)
    fit = calibrate_imu(force[:, 0], force[:, 1:], rate[:, 1:], rests, g=reference["g"])
    assert fit.gyroscope.status == "converged"
    scale = 1.0 / np.diagonal(fit.gyroscope.factors().rest)
    np.testing.assert_allclose(scale, [4778.0, 4758.0, 4766.0], rtol=3e-3)
    assert len(fit.reasons) == 2
    # the moves' residuals are beyond the scatter within rests, and so are the poses'
    assert len(fit.gyroscope.noise.sentences) == 2
    assert 1.2 < fit.gyroscope.noise.factor[1] < 1.6
    # upper against lower: the same sensors, axes 1.35 degrees apart
    upper = fit.gyroscope.to_form("upper")
    Q = upper.M @ np.linalg.inv(fit.gyroscope.M)
    np.testing.assert_allclose(Q @ Q.T, np.eye(3), atol=1e-12)
    assert abs(np.degrees(Rotation.from_matrix(Q).magnitude()) - 1.35) < 0.01
    written = json.loads(json.dumps(fit.as_object(), allow_nan=False))
    assert written["gyroscope"]["sd"] == list(np.sqrt(fit.covariance.diagonal())[9:])
    assert written["accelerometer"]["sd"] == list(fit.accelerometer.sd)
    assert len(fit.names) == 21


@pytest.mark.ci
@pytest.mark.parametrize("name", ["imu0", "imu1"])
def test_mpu_9150_by_hand(name):
    """SI units, rests held by hand: scales within a percent of one, axes within one."""
    path = RECORDINGS / "mpu9150" / f"{name}.log"
    if not path.exists():
        pytest.skip(f"the recording {path} is not on this machine")
    log = read_log(path, rate=100.0)
    found = calibrate_log(log, g=9.81)
    fit = calibrate_imu(
        log.time, log.accelerometer, log.gyro, found.intervals, g=9.81
    ).gyroscope
    assert fit.status == "converged"
    assert np.abs(fit.M - np.eye(3)).max() < 0.02
    assert np.all(fit.sd[:9] < 5e-3)
    # the residuals are those of hands, some times the white noise
    assert not fit.noise.borne
    assert 2.0 < fit.noise.factor[1] < 5.0
    assert fit.noise.factor[0] == 1.0


def test_another_form_is_fitted_as_it_is_carried(slow_clock):
    """Fit in the upper form, or fit in the triangular one and carry 21 parameters."""
    poses, rows = readings(slow_clock, 1, np.random.default_rng(5))
    fits = {}
    for form in ("triangular", "upper", "symmetric"):
        acc = calibrate(poses[0], slow_clock.g, form, residual="weighted")
        moves = moves_between(slow_clock.time, rows[0], slow_clock.intervals)
        fits[form] = calibrate_gyroscope(
            moves, poses[0], acc, pose_std=slow_clock.pose_std, angle_random_walk=WALK
        )
    for form in ("upper", "symmetric"):
        carried = fits["triangular"].to_form(form)
        # both stop 1e-5 of a standard deviation from the minimum
        close = 1e-3 * fits[form].sd
        assert np.all(np.abs(carried.parameters - fits[form].parameters) < close)
        np.testing.assert_allclose(
            carried.covariance, fits[form].covariance,
            atol=1e-4 * np.abs(fits[form].covariance).max(),
        )  # fmt: skip


X, Y, Z = np.eye(3)
SINGULAR = {
    "axes in one plane": [
        ([np.cos(a), np.sin(a), 0.0], 1.3 + 0.1 * a) for a in range(12)
    ],
    "one axis": [(X, a) for a in np.linspace(0.5, 2.5, 12)],
    "whole turns": [(axis, 2 * np.pi) for axis, _ in GENERIC],
    "four moves": GENERIC[:4],
    "three axes there and back": [m for a in (X, Y, Z) for m in ((a, 1.2), (a, -1.2))]
    * 2,
}


def fit_of(moves_list, u0=None):
    time, rate, rests, attitudes = rolled(moves_list)
    gyro = GYROSCOPE.distort(rate, ZERO)
    forces = 9.81 * attitudes.inv().apply(FIRST_UP)
    poses = ACCELEROMETER.distort(forces, ZERO)
    # the accelerometer was calibrated with poses of its own
    many = tumble(12, every=1, move_time=1.5, first_hold=1.0, hold_time=0.3)
    acc = calibrate(ACCELEROMETER.distort(many.directions, ZERO), many.g)
    return calibrate_gyroscope(
        moves_between(time, gyro, rests), poses, acc, pose_std=1e-3,
        angle_random_walk=WALK, estimator="unweighted", bias="first rest",
        start=np.eye(3),
    )  # fmt: skip


@pytest.mark.parametrize("name", SINGULAR)
def test_singular_moves_are_refused_and_told_what_helps(name):
    with pytest.raises(GeometryError, match="do not tell") as caught:
        fit_of(SINGULAR[name])
    assert "degrees about the axis" in str(caught.value)
