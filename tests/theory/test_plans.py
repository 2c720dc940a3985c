"""Plans of a calibration: error bars, the pose or turn that helps, the command."""

import json

import numpy as np
import pytest
from magnetometer_sets import compass_of, made, random_set, tilted
from rounding import EPS
from scipy.spatial.transform import Rotation

from simval.errors import GeometryError, InputError
from simval.geometry import random_quaternions
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.files import save_calibration
from simval.imu.sensor import AccelerometerModel, GyroscopeModel, MagnetometerModel
from simval.poses import cube_faces, fibonacci_sphere, named_poses
from simval.theory import (
    gyroscope_moments,
    magnetometer_moments,
    plan,
    plan_gyroscope,
    plan_magnetometer,
    plans,
    pose_noise,
)
from simval.turns import turns_of

G = 9.80665
IDEAL = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
STILL = GyroscopeModel(M=np.eye(3), B=np.zeros(3))
MOVES = {
    "pose_std": 1e-3, "angle_random_walk": np.radians(0.01), "rotation_seconds": 2.0,
    "rest_seconds": 1.0,
}  # fmt: skip
FIELD = {"accelerometer_noise": 1e-4, "magnetometer_noise": 5e-3}
DIP = np.radians(60.0)


def of_poses(n):
    return plan(fibonacci_sphere(n), 0.02)


def of_moves(n, **more):
    return plan_gyroscope(fibonacci_sphere(n), **{**MOVES, **more})


def of_attitudes(n):
    return plan_magnetometer(random_set(n, 3).q, DIP, **FIELD)


@pytest.mark.parametrize("planner", [of_poses, of_moves, of_attitudes])
def test_each_pose_helps_and_too_few_tell_nothing(planner):
    found, less = planner(20), planner(5)
    # one pose more takes no information away, up to rounding of two inverses
    assert np.all(found.sd_next <= found.sd * (1 + 1e4 * EPS))
    assert np.linalg.norm(found.sd_next) < np.linalg.norm(found.sd)
    assert less.rank < found.rank
    assert np.isinf(less.sd).all()


def test_plan_is_what_a_simulation_then_finds():
    """4000 calibrations of an ideal sensor: each sd within 4.5 of its own 1.1 %."""
    directions, sigma, trials = fibonacci_sphere(15), 0.02, 4000
    noise = np.random.default_rng(0).standard_normal((trials, 15, 3))
    fits = calibrate(G * directions + sigma * noise, G)
    predicted = plan(directions, sigma)
    ratio = fits.parameters.std(axis=0) / predicted.sd
    # a standard deviation's standard error is 1/sqrt(2 trials); 4.5 of them, false
    # alarm 7e-6 for each of nine
    assert np.all(np.abs(ratio - 1) < 4.5 / np.sqrt(2 * trials))
    # equal for the efficient fit, up to rounding of two inverses
    assert np.all(predicted.bound <= predicted.sd * (1 + 1e4 * EPS))


def test_numbers_of_known_sets():
    """sd(B)/sigma: full sphere of 40, six faces with twelve edges, twelve edges."""
    expected = {
        "fibonacci:40": 0.274,
        "faces+edges": 1 / np.sqrt(6),
        "edges": 0.5,
        "faces+corners": 0.463,
    }
    for name, value in expected.items():
        sd = plan(named_poses(name), 1.0).sd[6:]
        # stated to three digits: half a unit of the last is 1.8e-3 of 0.274
        np.testing.assert_allclose(sd, value, rtol=2e-3)


def test_the_next_pose_is_on_the_side_that_was_not_seen():
    cap = fibonacci_sphere(40)
    found = plan(cap[cap[:, 2] > 0.3], 0.01)
    # the axis that the cap does not show at all: 0.08 is seen
    assert found.sd_next[8] < 0.7 * found.sd[8]
    assert found.next_direction[2] < 0


def test_six_faces_cannot_be_planned():
    found, moved = plan(cube_faces(), 0.01), plan_gyroscope(cube_faces(), **MOVES)
    assert (found.rank, found.condition) == (6, np.inf)
    assert np.isnan(found.bias).all()
    assert moved.rank < 9
    assert np.isinf(moved.sd).all()


def test_pose_noise_against_simulated_white_noise():
    """A density D sampled at f has sigma D sqrt(f/2) in each sample; means over t."""
    density, rate, hold, trials = 0.002, 200.0, 3.0, 4000
    sigma = density * np.sqrt(rate / 2)
    samples = sigma * np.random.default_rng(1).standard_normal(
        (trials, int(rate * hold))
    )
    found = samples.mean(axis=1).std()
    expected = pose_noise(hold, noise_density=density)
    # 4.5 standard errors of a standard deviation
    assert abs(found / expected - 1) < 4.5 / np.sqrt(2 * trials)
    walk = density / np.sqrt(2)
    # three operations
    assert np.isclose(
        pose_noise(hold, velocity_random_walk=walk), expected, rtol=4 * EPS, atol=0
    )
    for both in ({}, {"noise_density": 1.0, "velocity_random_walk": 1.0}):
        with pytest.raises(InputError, match="exactly one"):
            pose_noise(hold, **both)


@pytest.mark.ci
def test_more_poses_quicker_moves_longer_rests():
    """Directions of each dependence, and the root of the number of poses."""

    def rms(poses, **more):
        return np.sqrt((of_moves(poses, **more).sd[:9] ** 2).mean())

    assert rms(80) < 0.8 * rms(40) < 0.8 * 0.8 * rms(20)
    assert rms(40, rotation_seconds=1.0) < rms(40) < rms(40, rotation_seconds=4.0)
    assert rms(40, pose_std=5e-4) < rms(40)
    # all noise twice is twice the bound: it is linear
    twice = rms(20, pose_std=2e-3, angle_random_walk=np.radians(0.02))
    np.testing.assert_allclose(twice, 2.0 * rms(20), rtol=1e-9)


def test_the_bound_does_not_depend_on_where_the_world_points():
    """The same tumble in other sensor axes: M's covariance turns with them."""
    u = fibonacci_sphere(14)
    path = plans.smooth_path(*turns_of(u), 2.0)
    Q = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
    turned = type(path)(turns=path.turns @ Q.T, seconds=path.seconds)
    noise = {"pose_std": 1e-3, "bias_std": 1e-5, "angle_random_walk": 2e-4}
    one, two = (
        gyroscope_moments(STILL, IDEAL, v, p, form="symmetric", **noise).cramer_rao
        for v, p in ((u, path), (u @ Q.T, turned))
    )
    K = np.kron(Q, Q)  # of Q M Q', for the symmetric form turns with the axes
    expected = K @ one[9:18, 9:18] @ K.T
    np.testing.assert_allclose(
        two[9:18, 9:18], expected, atol=1e-8 * np.abs(expected).max()
    )
    same = plans.smooth_path(turns_of(u)[0], np.full(13, 1e-9), 2.0)
    with pytest.raises(GeometryError, match="nothing can be predicted"):
        gyroscope_moments(STILL, IDEAL, u[[0] * 14], same, **noise)


def test_moves_that_cannot_be_planned_are_refused():
    u = fibonacci_sphere(12)
    for bad in (
        {"pose_std": 0.0},
        {"rotation_seconds": -1.0},
        {"rest_seconds": np.nan},
    ):
        with pytest.raises(InputError):
            of_moves(12, **bad)
    axes, angles = turns_of(u)
    with pytest.raises(InputError, match="away from direction 1"):
        plan_gyroscope(u, turns=(axes[::-1], angles), **MOVES)


def test_tilts_cost_what_they_cost():
    """RMS of M's error bars beside that of attitudes of all kinds."""

    def bars(q):
        return np.sqrt(np.mean(plan_magnetometer(q, DIP, **FIELD).sd[9:18] ** 2))

    rms = {tilt: bars(tilted(40, tilt, 3)) for tilt in (20.0, 45.0)}
    even = {n: bars(random_set(n, 3).q) for n in (12, 40, 160)}
    # of 20 drawn sets of each kind: 13 to 30 times, 1.9 to 2.8 times
    assert 10.0 < rms[20.0] / even[40] < 40.0
    assert 1.7 < rms[45.0] / even[40] < 3.5
    assert even[12] / even[40] > np.sqrt(40 / 12)  # few poses cost more
    assert even[40] / even[160] == pytest.approx(2.0, rel=0.15)


@pytest.mark.ci
def test_a_plan_predicts_what_a_fit_states():
    body = AccelerometerModel(T=np.eye(3), K=np.full(3, G), B=np.zeros(3))
    iron = MagnetometerModel(M=np.eye(3), b=np.zeros(3))
    std = {"accelerometer_std": 1e-4, "magnetometer_std": 5e-3}

    def fitted(q):
        case = made(q, 60.0, body, iron, 1.0)
        stated = {"field": 1.0, "pose_std": 1e-4, "field_std": 5e-3}
        return compass_of(case.body, case.iron, **stated)

    q = random_set(20, 5).q
    found, fit = plan_magnetometer(q, DIP, **FIELD), fitted(q)
    assert found.names == fit.names
    assert found.rank == 22
    np.testing.assert_allclose(found.sd[9:], fit.sd[9:], rtol=1e-8)
    again = fitted(np.vstack([q, found.next_attitude]))
    np.testing.assert_allclose(found.sd_next[9:], again.sd[9:], rtol=1e-8)
    # no candidate does better: each is tried, with the sensors of the fit
    total = np.sum(again.sd[9:] ** 2)
    for other in plans.candidate_attitudes()[::7]:
        moments = magnetometer_moments(
            body, iron, np.vstack([q, other]), DIP, g=G, **std
        )
        assert np.sum(moments.sd[9:] ** 2) >= total * (1.0 - 1e-9)


def test_a_plan_grows_to_full_rank_from_nothing():
    q = random_quaternions(1, np.random.default_rng(1))
    ranks = []
    for _ in range(10):
        found = plan_magnetometer(q, 1.0, **FIELD)
        ranks.append(found.rank)
        assert np.isfinite(found.sd).all() == (found.rank == 22)
        q = np.vstack([q, found.next_attitude])
    assert ranks[:4] == [3, 6, 9, 12]  # three equations each, none of them wasted
    assert 22 in ranks
    assert len(np.unique(np.round(plans.candidate_attitudes(), 9), axis=0)) == 156
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-12)


@pytest.fixture
def answered(simval):
    """What the command `plan` answers in JSON."""

    def answer(*words):
        code, out, err = simval("plan", *words, "--json")
        assert code == 0, err
        return json.loads(out)

    return answer


@pytest.mark.parametrize("poses", ["faces", "fibonacci:1", "fibonacci:8"])
@pytest.mark.parametrize("gyroscope", [(), ("--angle-random-walk", "1e-4")])
def test_command_says_what_is_missing(simval, answered, poses, gyroscope):
    words = ("--poses", poses, "--hold", "1", "--noise-density", "1e-3", *gyroscope)
    code, out, errors = simval("plan", *words)
    assert (code, errors) == (0, "")
    assert " of the nine parameters, whatever the noise" in out
    assert not {"inf", "nan"} & set(out.split())
    assert answered(*words)["sd"] == [None] * 9
    if poses == "faces":
        assert "No: 6 poses determine 6 of the nine parameters" in out
        assert "Add 3 or more" in out
        assert "the force along (0.58, 0.58, 0.58)" in out


@pytest.mark.parametrize(("noise", "believed"), [("0.1", True), ("9.8", False)])
def test_a_plan_for_a_noise_in_another_unit_says_so(simval, noise, believed):
    out = " ".join(simval("plan", "--noise-std", noise)[1].split())
    assert ("the prediction does not hold" not in out) == believed


def test_command_reads_directions_and_a_sensor(tmp_path, answered):
    directions = fibonacci_sphere(14) * 3.0
    np.savetxt(tmp_path / "d.txt", directions, delimiter=",")
    sensor = AccelerometerModel(T=np.eye(3), K=np.full(3, 1 / 400), B=np.full(3, 33e3))
    raw = sensor.distort(G * fibonacci_sphere(20), np.random.default_rng(0))
    save_calibration(tmp_path / "c.json", calibrate(raw))
    files = ("--directions", tmp_path / "d.txt", "--sensor", tmp_path / "c.json")
    found = answered(*files, "--noise-std", "4")
    expected = plan(directions, 4.0, sensor=sensor)
    # the poses come from a file with all digits: an inverse of condition 1e2
    np.testing.assert_allclose(found["sd"], expected.sd, rtol=1e3 * EPS)


def test_command_plans_a_gyroscope_too(simval, answered):
    given = ["--poses", "fibonacci:20", "--hold", "1", "--noise-density", "0.0014"]
    given += ["--angle-random-walk", "1.75e-4"]
    got = answered(*given)
    assert np.isclose(got["noise_std"], 0.0014 / np.sqrt(2), rtol=4 * EPS, atol=0)
    of_gyroscope = {"pose_std": got["noise_std"], "angle_random_walk": 1.75e-4}
    expected = of_moves(20, **of_gyroscope)
    np.testing.assert_allclose(got["gyroscope"]["sd"], expected.sd, rtol=1e-12)
    assert "A turn by " in " ".join(simval("plan", *given)[1].split())
    slower = of_moves(20, **of_gyroscope, rotation_seconds=4.0).sd
    assert not np.allclose(slower, expected.sd)
    found = answered(*given, "--rotation-time", "4")["gyroscope"]["sd"]
    np.testing.assert_allclose(found, slower, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--poses", "dodecahedron", "--noise-std", "1"], "'dodecahedron'"),
        (["--poses", "fibonacci:0", "--noise-std", "1"], "fibonacci:0"),
        (["--poses", "edges"], "noise of a pose mean is not known"),
        (["--poses", "edges", "--noise-density", "1"], "not known"),
        (["--noise-std", "1", "--noise-density", "1"], "leave out the other noise"),
        (["--noise-std", "nan"], "`noise_std` is nan"),
        (["--noise-std", "1", "--rotation-time", "2"], "--angle-random-walk"),
        (["--noise-std", "1", "--angle-random-walk", "1"], "--hold"),
        (["--directions", "no-such-file", "--noise-std", "1"], "no-such-file"),
    ],
)
def test_command_refuses(simval, arguments, words):
    code, _, err = simval("plan", *arguments)
    assert code == 2
    assert words in err


@pytest.mark.parametrize("text", ["1 2\n", "1 2 x\n", ""])
def test_direction_files_that_are_not(simval, tmp_path, text):
    (tmp_path / "d.txt").write_text(text)
    words = ("--directions", tmp_path / "d.txt", "--noise-std", "1")
    assert simval("plan", *words)[0] == 2
