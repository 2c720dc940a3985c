"""Three sensors in one fit: rows, recovery, limiting cases, the bound, refusals."""

from dataclasses import fields as fields_of_class
from dataclasses import replace

import numpy as np
import pytest
from magnetometer_sets import FIELD, IRON, IRON_STD
from nine_axes import (
    DIP,
    GYRO,
    MAG,
    TRUTH,
    attitudes,
    bound,
    calibrated,
    drawn,
    fields_of,
)
from scipy import stats
from scipy.spatial.transform import Rotation
from test_gyroscope_monte_carlo import path_of
from tumbles import ACCELEROMETER, FORCE_STD, GYROSCOPE, WALK, M, tumble

from simval.calibrate import (
    ImuFit,
    calibrate_imu,
    calibrate_magnetometer,
    calibrate_nine_axis,
)
from simval.calibrate.gyroscope.imu import ImuReadings
from simval.calibrate.nine_axis import linearise
from simval.errors import (
    ConvergenceError,
    GeometryError,
    InputError,
)
from simval.geometry import attitude_matrix
from simval.sensor import MagnetometerModel
from simval.theory import (
    MovePath,
    gyroscope_moments,
    magnetometer_moments,
    nine_axis_moments,
)

POSES = np.r_[0:9, 21:34]  # parameters of accelerometer and magnetometer
SIZE = np.abs(np.r_[np.ones(21), np.full(9, FIELD / 500.0), np.full(3, 100.0), 1.0])


@pytest.fixture(scope="module")
def short():
    return tumble(12, every=1, move_time=1.5, first_hold=1.0, hold_time=0.3)


def clean(truth):
    quiet = np.random.default_rng(0)  # draws nothing
    poses = ACCELEROMETER.distort(truth.directions, quiet)
    rows = GYROSCOPE.distort(truth.rate, quiet)
    return poses[None], rows[None], fields_of(truth)[None]


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


def spoilt(fit, size, rng):
    """A fit with every parameter off by some share of a relative error."""
    off = size * rng.standard_normal(fit.parameters.shape)
    values = fit.parameters + off * np.maximum(np.abs(fit.parameters), 1e-2)
    return replace(fit, parameters=values)


@pytest.mark.ci
def test_noise_free_recovery_from_wrong_starts(short):
    """Starts a percent off, readings at 500 Hz without noise."""
    poses, rows, fields = clean(short)
    found = calibrated(short, poses, rows, fields, chunk=1)
    rng = np.random.default_rng(4)
    fit = again(
        found, poses, fields, spoilt(found.gyroscope, 0.01, rng),
        spoilt(found.magnetometer, 0.01, rng),
    )  # fmt: skip
    assert fit.converged.all()
    assert fit.iterations[0] > 2
    # the scene's averages give the attitudes back to rounding; documented: 1e-9
    assert np.abs((fit.parameters[0] - TRUTH) / SIZE).max() < 1e-9


@pytest.mark.ci
@pytest.mark.parametrize("form", ["upper", "symmetric"])
def test_noise_free_recovery_in_other_forms(short, form):
    poses, rows, fields = clean(short)
    found = calibrated(short, poses, rows, fields, chunk=1, form=form)
    fit = found.fit
    turn = fit.gyroscope.M[0] @ np.linalg.inv(M)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        fit.magnetometer.M[0], turn @ IRON.M, rtol=0, atol=1e-9 * FIELD
    )
    assert fit.names[:9] == found.magnetometer.names[:9]


def captured(monkeypatch, found, poses, fields, **more):
    """The problem and the state that a fit begins with."""
    seen = {}

    def solve(problem, state):
        seen["both"] = problem, state
        raise InterruptedError

    with monkeypatch.context() as patch:
        patch.setattr("simval.calibrate.nine_axis.solve", solve)
        with pytest.raises(InterruptedError):
            again(found, poses, fields, **more)
    return seen["both"]


def moved(state, step):
    return replace(
        state,
        poses=state.poses + step[:22],
        M=state.M + step[22:31].reshape(3, 3),
        B=state.B + step[31:],
    )


def test_derivatives_of_the_rows(short, monkeypatch):
    """Central differences at the truth, where the rows are zero and E drops out."""
    poses, rows, fields = clean(short)
    found = calibrated(short, poses, rows, fields, chunk=1)
    problem, state = captured(monkeypatch, found, poses, fields)
    J = linearise(problem, state).gain.J[0]
    h, rng = 1e-5, np.random.default_rng(2)
    for unit in rng.standard_normal((4, 34)):  # any column that is wrong shows
        ends = [linearise(problem, moved(state, s * h * unit)).r[0] for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * h)
        # h^2 over 6 of a third derivative of some tens; moves turn by radians
        scale = max(1.0, np.abs(slope).max())
        np.testing.assert_allclose(J @ unit, slope, rtol=0, atol=2e-8 * scale)


@pytest.mark.ci
def test_covariance_of_the_rows_counts_each_pose_once(monkeypatch):
    """V is what unit noise of each reading does to all rows, by differences."""
    truth = tumble(12, move_time=1.5, first_hold=1.0, hold_time=0.5)
    poses, rows, fields = clean(truth)
    found = calibrated(truth, poses, rows, fields, chunk=1)
    problem, state = captured(
        monkeypatch, found, poses, fields, angle_random_walk=1e-9, bias_std=1e-7
    )
    white = linearise(problem, state).gain.white[0]
    V = np.linalg.inv(white) @ np.linalg.inv(white).T
    columns = []
    for name in ("accelerometer", "magnetometer"):
        values = getattr(problem.readings, name)
        std = getattr(problem, f"{name}_std")
        for at in np.ndindex(values.shape):
            ends = []
            for sign in (1.0, -1.0):
                other = values.copy()
                other[at] += sign * 1e-5
                readings = replace(problem.readings, **{name: other})
                ends.append(linearise(replace(problem, readings=readings), state).r[0])
            columns.append((ends[0] - ends[1]) / 2e-5 * std[at])
    L = np.array(columns).T
    gaps = 3 * (len(truth.intervals) - 1)
    sd = np.sqrt(np.diagonal(V))[:-3]
    off = (V[:-3, :-3] - (L @ L.T)[:-3, :-3]) / np.outer(sd, sd)
    # the rows at 100 Hz are not zero but 1e-6, by which their axes turn with a reading
    assert np.abs(off).max() < 3e-6
    # power: neighbouring gaps share the field of a pose, gaps and poses their readings
    shared = V[:-3, :-3] / np.outer(sd, sd)
    assert np.diagonal(shared[2:gaps:3, 5:gaps:3]).max() < -0.4
    assert np.abs(shared[:gaps, gaps:]).max() > 0.05


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


def test_trials_do_not_depend_on_their_neighbours(noisy):
    truth, (poses, rows, fields), found = noisy
    one = calibrated(truth, poses[1:], rows[1:], fields[1:]).fit
    # blocks of other sizes are summed in another order
    off = (one.parameters[0] - found.fit.parameters[1]) / one.sd[0]
    assert np.abs(off).max() < 1e-5


def test_bound_is_that_of_two_sensors_where_the_third_tells_nothing():
    """Two theories with other code: one eliminates attitudes, one equations."""
    truth = tumble(20)
    common = {"pose_std": truth.pose_std, "bias_std": 1e-4, "g": truth.g}
    given = GYROSCOPE, ACCELEROMETER, IRON, attitudes(truth), DIP, path_of(truth)

    def of(walk, std):
        return nine_axis_moments(
            *given, field_std=std, field=FIELD, angle_random_walk=walk, **common
        ).cramer_rao

    alone = magnetometer_moments(
        ACCELEROMETER, IRON, attitudes(truth), DIP, accelerometer_std=truth.pose_std,
        magnetometer_std=IRON_STD, g=truth.g, field=FIELD,
    ).covariance  # fmt: skip
    sd = np.sqrt(np.diagonal(alone))
    blind = of(1e5, IRON_STD)[np.ix_(POSES, POSES)]
    # inverses of condition 1e4 in scaled units
    assert np.abs((blind - alone) / np.outer(sd, sd)).max() < 1e-9
    alone = gyroscope_moments(
        GYROSCOPE, ACCELEROMETER, truth.directions, path_of(truth),
        angle_random_walk=WALK, **common,
    ).cramer_rao  # fmt: skip
    sd = np.sqrt(np.diagonal(alone))
    still = of(WALK, 1e6)[:21, :21]
    assert np.abs((still - alone) / np.outer(sd, sd)).max() < 1e-9


def brute(path, first, noise, g=9.80665):
    """Information with the attitude at every node of every move unknown, inverted.

    Readings are computed, not linearised: rotations are multiplied, their logarithm is
    what the gyroscope adds up, and all derivatives are central differences.
    """
    pose_std, field_std, bias_std, walk = noise
    j = path.seconds.shape[1]
    steps = Rotation.from_rotvec(np.array(path.turns.reshape(-1, 3)))
    nodes = [first]
    for step in steps:
        nodes.append(nodes[-1] * step)
    nodes = Rotation.concatenate(nodes)  # body to world
    tau = path.seconds.reshape(-1)

    def readings(x):
        p, turned = x[:34], nodes * Rotation.from_rotvec(x[34:].reshape(-1, 3))
        T = np.array([[1.0, 0, 0], [p[0], 1.0, 0], [-p[1], p[2], 1.0]])
        rests = turned[::j].inv()
        up = rests.apply([0.0, 0.0, g])
        field = rests.apply(FIELD * np.array([np.cos(p[33]), 0.0, -np.sin(p[33])]))
        force = np.linalg.solve(T @ np.diag(p[3:6]), up.T).T + p[6:9]
        iron = np.linalg.solve(p[21:30].reshape(3, 3), field.T).T + p[30:33]
        angle = (turned[:-1].inv() * turned[1:]).as_rotvec()
        added = np.linalg.solve(p[9:18].reshape(3, 3), angle.T).T
        added += tau[:, None] * p[18:21]
        return np.concatenate(
            [
                force.ravel() / pose_std,
                iron.ravel() / field_std,
                (added / (walk * np.sqrt(tau))[:, None]).ravel(),
                p[18:21] / bias_std,
            ]
        )

    x = np.r_[TRUTH, np.zeros(3 * len(nodes))]
    h = 1e-5 * np.r_[np.ones(21), np.full(9, 0.1), np.full(3, 100.0), 1.0]
    h = np.r_[h, np.full(3 * len(nodes), 1e-5)]
    J = [(readings(x + e) - readings(x - e)) / (2 * e.max()) for e in np.diag(h)]
    J = np.array(J).T
    size = np.linalg.norm(J, axis=0)
    inverse = np.linalg.inv((J / size).T @ (J / size)) / np.outer(size, size)
    return inverse[:34, :34]


@pytest.mark.ci
def test_bound_against_every_attitude_unknown_on_the_way():
    rng = np.random.default_rng(8)
    k, j, seconds = 8, 6, 0.2
    turns = np.repeat(rng.standard_normal((k, 1, 3)), j, axis=1)
    turns *= 1.2 / np.linalg.norm(turns, axis=2, keepdims=True) / j
    path = MovePath(turns=turns, seconds=np.full((k, j), seconds))
    first = Rotation.random(random_state=9)
    nodes = [first]
    for turn in turns:
        nodes.append(nodes[-1] * Rotation.from_rotvec(turn[0] * j))
    q = Rotation.concatenate(nodes).as_quat()
    noise = 1e-3, IRON_STD, 1e-4, 1e-3
    whole = brute(path, first, noise)
    found = nine_axis_moments(
        GYROSCOPE, ACCELEROMETER, IRON, q, DIP, path, pose_std=noise[0],
        field_std=noise[1], bias_std=noise[2], field=FIELD, angle_random_walk=noise[3],
    ).cramer_rao  # fmt: skip
    sd = np.sqrt(np.diagonal(whole))
    off = np.abs((found - whole) / np.outer(sd, sd)).max()
    # a segment of 0.2 rad is one step there: 0.2^2/12 of the walk's share
    assert off < 0.2**2 / 12.0
    # power: a magnetometer that is ten percent noisier is told
    other = brute(path, first, (noise[0], 1.1 * IRON_STD, *noise[2:]))
    assert np.abs((found - other) / np.outer(sd, sd)).max() > 0.05


@pytest.mark.ci
def test_gain_over_the_fits_of_two():
    """What the one fit is worth, at 40 poses and moves of two seconds."""
    whole = np.diagonal(bound(pieces=8))
    blind = np.diagonal(bound(pieces=8, walk=1e5))
    still = np.diagonal(bound(pieces=8, field_std=1e6))
    mag = whole[MAG] / blind[MAG]
    assert 0.28 < mag.min() < 0.36
    assert 0.78 < mag.max() < 0.86
    assert 0.58 < mag.mean() < 0.68
    # a field of half a percent adds little to gravity, and to the gyroscope
    assert np.all(whole[:21] < still[:21] * (1.0 + 1e-9))
    assert np.all(whole[:21] > 0.97 * still[:21])
    assert np.all(whole[:9] < 0.92 * blind[:9])


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


def test_a_trial_that_goes_astray_stays_where_it_was(noisy):
    """Fits that are far from each other: no step counts, and the neighbour's do."""
    truth, (poses, _, fields), found = noisy
    far = found.magnetometer.parameters.copy()
    far[0, 9:] *= 0.5
    compass = replace(found.magnetometer, parameters=far)
    fit = again(found, poses, fields, None, compass, pose_std=truth.pose_std)
    assert list(fit.status) == ["max iterations", "converged"]
    np.testing.assert_allclose(fit.parameters[0, MAG], far[0, 9:], rtol=1e-12)
    off = (fit.parameters[1] - found.fit.parameters[1]) / fit.sd[1]
    assert np.abs(off).max() < 1e-5
    with pytest.raises(ConvergenceError, match="disagree by more"):
        fit.require_converged()
    # the poses of another order, with their own noise
    fit = again(found, poses, fields[:, ::-1], pose_std=truth.pose_std)
    assert not fit.converged.any()


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


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"dip": 1.5705}, InputError, "`dip`"),
        ({"field_std": 0.0}, InputError, "noise above 0"),
        ({"attitudes": np.eye(4)}, InputError, "a move between any two rests"),
        ({"magnetometer": None}, InputError, "`magnetometer`"),
        ({"angle_random_walk": -1.0}, InputError, "`angle_random_walk`"),
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


def test_theory_refuses_poses_of_one_plane():
    """Turns about one axis leave parameters open."""
    turn = np.tile([0.0, 0.0, 0.6], (9, 4, 1)) / 4.0
    path = MovePath(turns=turn, seconds=np.full((9, 4), 0.25))
    q = Rotation.from_rotvec(np.outer(np.arange(10), [0.0, 0.0, 0.6])).as_quat()
    iron = MagnetometerModel(M=IRON.M, b=IRON.b)
    with pytest.raises(GeometryError, match="of the 34 parameters open"):
        nine_axis_moments(
            GYROSCOPE, ACCELEROMETER, iron, q, DIP, path, pose_std=1e-3,
            field_std=IRON_STD, bias_std=1e-4, angle_random_walk=WALK,
        )  # fmt: skip


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
