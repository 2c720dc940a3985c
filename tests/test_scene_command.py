"""`simval scene`: a test signal that calibrates back to its truth, and pictures."""

import importlib.util
import json

import numpy as np
import pytest
from PIL import Image

from simval.cli import run
from simval.errors import InputError
from simval.logs import read_log
from simval.scene import render, render_file, simulate
from simval.scene.draw import CAMERA
from simval.scene.models import load_model, model_path
from simval.scene.signal import HEADER, write_signal
from simval.sensor.files import load_sensor

SENSOR = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0
quantum_raw = 1.0
limits_raw = [0, 65535]
"""
SHORT = ["--set", "directions=12", "--set", "hold_time=0.5", "--set", "first_hold=3"]


@pytest.fixture
def sensor(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(SENSOR)
    return path


@pytest.mark.ci
def test_the_round_trip_through_the_calibrator_finds_the_sensor(
    tmp_path, sensor, capsys
):
    log = tmp_path / "log.csv"
    words = ["scene", "gimbal", "--sensor", str(sensor), "--out", str(log)]
    assert run([*words, "--set", "first_hold=5"]) == 0
    capsys.readouterr()
    assert run(["calibrate", str(log), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "converged"
    assert found["intervals"] == 40
    model, _ = load_sensor(sensor)
    error = np.array(found["parameters"]) - model.parameters
    # nine errors in units of their own standard deviation, 31 degrees of freedom:
    # t beyond 5.2 has probability 1e-5 each, 1e-4 for all nine
    assert np.abs(error / np.array(found["sd"])).max() < 5.2
    # power: a sensor with 0.2 % more scale is told apart
    assert 0.002 * model.parameters[3] / found["sd"][3] > 5.2


def test_the_file_holds_the_truth_to_the_last_bit(tmp_path):
    trajectory = simulate("gimbal", directions=2, move_time=0.2, hold_time=0.1)
    raw = 3.0 * trajectory.specific_force + 1.0
    path = tmp_path / "log.csv"
    write_signal(path, trajectory, raw)
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert table.shape == (len(trajectory.time), len(HEADER.split(",")))
    np.testing.assert_array_equal(table[:, 0], trajectory.time)
    np.testing.assert_array_equal(table[:, 1:4], raw)
    np.testing.assert_array_equal(table[:, 4:7], trajectory.specific_force)
    np.testing.assert_array_equal(table[:, 7:10], trajectory.angular_velocity)
    np.testing.assert_array_equal(table[:, 10:13], trajectory.magnetic_field)
    np.testing.assert_array_equal(table[:, 13:17], trajectory.attitude)
    np.testing.assert_array_equal(table[:, 17], trajectory.hold)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, raw)
    np.testing.assert_array_equal(log.gyro, trajectory.angular_velocity)
    with pytest.raises(InputError, match="cannot write"):
        write_signal(tmp_path, trajectory)


@pytest.mark.ci
def test_the_same_seed_gives_the_same_file(tmp_path, sensor):
    paths = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    for path, seed in zip(paths, ("1", "1", "2"), strict=True):
        words = ["--sensor", str(sensor), "--seed", seed, "--out", str(path)]
        assert run(["scene", *SHORT, *words]) == 0
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert paths[0].read_bytes() != paths[2].read_bytes()


def test_it_says_what_it_did(capsys):
    assert run(["scene", "shaker", "--set", "poses=4", "--set", "settle_time=0.5"]) == 0
    said = capsys.readouterr().out
    assert "left out  1 that still moved" in said or "rests     4" in said
    assert run(["scene", "pivot", "--set", "turns=0.2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"]["turns"] == 0.2
    assert told["scene"] == "pivot"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["scene", "nowhere"], 2, "there is no scene 'nowhere'"),
        (["scene", "--set", "speed=1"], 2, "it has directions"),
        (["scene", "--set", "directions"], 2, "not KEY=VALUE"),
        (["scene", "--set", "directions=many"], 2, "`directions` is not an array"),
        (["scene", "--set", "settle_time=0.05"], 3, "settle longer"),
        (["scene", "--set", "timestep=0.06"], 3, "first at row"),
        (["scene", "--set", "timestep=0"], 2, "`timestep` is 0"),
        (["scene", "--sensor", "absent.toml"], 2, "cannot read the sensor file"),
        (["scene", *SHORT, "--out", "absent/log.csv"], 2, "cannot write"),
        (["scene", *SHORT, "--render", "picture.bmp"], 2, "its ending must be"),
    ],
)
def test_bad_words_are_refused_with_their_exit_code(words, code, message, capsys):
    assert run(words) == code
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def picture():
    try:
        return render("gimbal", directions=3)
    except InputError as error:
        pytest.skip(f"no picture can be drawn here: {error}")


def test_a_picture_shows_the_body(picture, tmp_path):
    path = tmp_path / "gimbal.png"
    path.write_bytes(picture)
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape == (480, 640, 3)
    orange = (pixels[..., 0] > 150) & (pixels[..., 2] < 80)  # the IMU's box
    assert 1000 < orange.sum() < 100_000


@pytest.mark.ci
def test_an_animation_has_its_frames_and_moves(picture, tmp_path):
    path = tmp_path / "gimbal.gif"
    size = {"width": 160, "height": 120, "directions": 2, "first_hold": 0.2}
    render_file(path, "gimbal", seconds=1.0, **size)
    with Image.open(path) as film:
        assert film.n_frames >= 10  # 1 s at 15 Hz, equal neighbours may be merged
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames - 1)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert (np.abs(first - last).max(axis=2) > 50).sum() > 100


def test_pictures_that_cannot_be_drawn_say_why(picture, monkeypatch, tmp_path):
    with pytest.raises(InputError, match="outside the run"):
        render("gimbal", time=1e6, directions=2)
    with pytest.raises(InputError, match="this scene allows"):
        render("gimbal", width=100_000, directions=2)
    with pytest.raises(InputError, match="`seconds` is nan"):
        render_file(tmp_path / "film.gif", "gimbal", seconds=float("nan"))
    with pytest.raises(InputError, match="no parameter `poses`"):
        render("gimbal", poses=2)


def test_a_machine_that_cannot_draw_is_told_what_to_install(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")  # MuJoCo then draws nothing
    with pytest.raises(InputError, match=r"install EGL.*libegl1.*or OSMesa") as caught:
        render("gimbal", directions=2)
    assert "disable: " in str(caught.value)


@pytest.mark.ci
def test_a_film_is_written_or_the_encoder_named(picture, tmp_path):
    path = tmp_path / "gimbal.mp4"
    size = {"seconds": 0.4, "width": 160, "height": 120, "directions": 2}
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        with pytest.raises(InputError, match="pip install imageio imageio-ffmpeg"):
            render_file(path, "gimbal", **size)
    else:
        render_file(path, "gimbal", **size)
        assert path.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize("name", ["die", "shaker", "pivot", "handheld", "cube"])
def test_every_scene_has_the_camera(name):
    model = load_model(model_path(name)).model
    assert CAMERA in [model.camera(k).name for k in range(model.ncam)]
