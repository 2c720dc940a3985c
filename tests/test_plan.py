"""Planning: predicted error bars, the next pose, and the noise of a pose mean."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from rounding import EPS

from simval.calibrate import calibrate
from simval.calibrate.files import save_calibration
from simval.cli.commands.plan import command
from simval.cli.plan import named_poses
from simval.errors import InputError
from simval.poses import cube_faces, fibonacci_sphere
from simval.sensor import AccelerometerModel
from simval.theory.plans import plan, pose_noise

G = 9.80665


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
    assert predicted.rank == 9
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


def test_the_next_pose_helps():
    cap = fibonacci_sphere(40)
    cap = cap[cap[:, 2] > 0.3]
    found = plan(cap, 0.01)
    # one pose more takes no information away, up to rounding of two inverses
    assert np.all(found.sd_next <= found.sd * (1 + 1e4 * EPS))
    # the axis that the cap does not show at all: 0.08 is seen
    assert found.sd_next[8] < 0.7 * found.sd[8]
    assert found.next_direction[2] < 0  # the half of the sphere that was not seen


def test_six_faces_cannot_be_planned():
    found = plan(cube_faces(), 0.01)
    assert found.rank == 6
    assert np.isinf(found.condition)
    assert np.isinf(found.sd).all()
    assert np.isnan(found.bias).all()


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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"hold": 0.0, "noise_density": 1.0}, "`hold`"),
        ({"hold": np.nan, "noise_density": 1.0}, "`hold`"),
        ({"hold": 1.0}, "exactly one"),
        (
            {"hold": 1.0, "noise_density": 1.0, "velocity_random_walk": 1.0},
            "exactly one",
        ),
        ({"hold": 1.0, "noise_density": -1.0}, "`noise_density`"),
        ({"hold": 1.0, "velocity_random_walk": -1.0}, "`velocity_random_walk`"),
    ],
)
def test_pose_noise_refuses(arguments, words):
    with pytest.raises(InputError, match=words):
        pose_noise(**arguments)


def invoke(*arguments):
    return CliRunner().invoke(command, list(arguments))


def test_command_turns_density_and_hold_into_sigma():
    found = invoke(
        "--poses", "edges", "--noise-density", "0.002", "--hold", "2", "--json"
    )
    assert found.exit_code == 0, found.output
    data = json.loads(found.output)
    # three operations
    assert np.isclose(data["noise_std"], 0.001, rtol=4 * EPS, atol=0)
    # an inverse of condition 1e2
    np.testing.assert_allclose(data["sd"][6:], 0.0005, rtol=1e3 * EPS)
    assert data["rank"] == 9


def test_command_says_what_is_missing():
    found = invoke("--poses", "faces", "--noise-std", "0.01")
    assert found.exit_code == 0
    assert "rank 6 of 9" in found.output
    assert "next direction  (0.577, 0.577, 0.577)" in found.output
    assert (
        json.loads(invoke("--poses", "faces", "--noise-std", "1", "--json").output)[
            "sd"
        ]
        == [None] * 9
    )


def test_command_reads_directions_and_a_sensor(tmp_path):
    directions = fibonacci_sphere(14) * 3.0
    np.savetxt(tmp_path / "d.txt", directions, delimiter=",")
    sensor = AccelerometerModel(T=np.eye(3), K=np.full(3, 1 / 400), B=np.full(3, 33e3))
    raw = sensor.distort(G * fibonacci_sphere(20), np.random.default_rng(0))
    save_calibration(tmp_path / "c.json", calibrate(raw))
    found = invoke(
        *("--directions", str(tmp_path / "d.txt"), "--noise-std", "4"),
        *("--sensor", str(tmp_path / "c.json"), "--json"),
    )
    assert found.exit_code == 0, found.output
    expected = plan(directions, 4.0, sensor=sensor)
    # the poses come from a file with all digits: an inverse of condition 1e2
    np.testing.assert_allclose(
        json.loads(found.output)["sd"], expected.sd, rtol=1e3 * EPS
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--poses", "dodecahedron", "--noise-std", "1"], "'dodecahedron'"),
        (["--poses", "fibonacci:0", "--noise-std", "1"], "fibonacci:0"),
        (["--poses", "edges"], "noise of a pose mean is not known"),
        (["--poses", "edges", "--noise-density", "1"], "not known"),
        (["--noise-std", "1", "--noise-density", "1"], "leave out the rest"),
        (["--noise-std", "0"], "`noise_std` is 0.0"),
        (["--noise-std", "nan"], "`noise_std` is nan"),
        (["--directions", "no-such-file", "--noise-std", "1"], "no-such-file"),
    ],
)
def test_command_refuses(arguments, words):
    found = invoke(*arguments)
    assert isinstance(found.exception, InputError)
    assert found.exception.exit_code == 2
    assert words in str(found.exception)


def test_direction_files_that_are_not(tmp_path):
    for text in ("1 2\n", "1 2 x\n", ""):
        (tmp_path / "d.txt").write_text(text)
        found = invoke("--directions", str(tmp_path / "d.txt"), "--noise-std", "1")
        assert isinstance(found.exception, InputError)
