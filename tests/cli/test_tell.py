"""`simval tell` from its options to its answers."""

import json

import numpy as np
import pytest
import yaml

from simval.cli import run
from simval.errors import InputError

NOISE = {
    "angle-random-walk": 1.75e-4, "rate-random-walk": 2e-5,
    "velocity-random-walk": 2e-3, "magnetometer-noise": 2.2e-8, "rate": 4.0,
}  # fmt: skip
SHEET = [word for name, x in NOISE.items() for word in (f"--{name}", str(x))]


def told(capsys, *words):
    code = run(["tell", *words, "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else None, err


@pytest.mark.ci  # a search of 400 rows
def test_a_data_sheet(capsys, tmp_path):
    """A scale of 1 %, in the shares and settings that are printed and written."""
    file = tmp_path / "imu.yaml"
    code, found, err = told(
        capsys, "--motion", "gimbal", *SHEET, "--scale-error", "gyroscope=0.01",
        "--misalignment", "gyroscope=0.01", "--to", "kalibr", str(file),
    )  # fmt: skip
    assert code == 0
    assert found["honest"]
    x = found["factors"]
    assert found["settings"]["N"] == pytest.approx(1.75e-4 * x["N"])
    row = 2e-3 * np.sqrt(4.0)
    assert found["settings"]["accelerometer"] == pytest.approx(
        row * x.get("accelerometer", 1.0), rel=1e-6
    )
    truth, achieved = (found["effects"][x] for x in ("the true noise", "achieved"))
    assert achieved["rms"] < truth["rms"]
    assert truth["nees"][0][0] > 10.0 * achieved["nees"][0][0]
    whole = sum(part**2 for part in found["sources"].values())
    assert np.sqrt(whole) == pytest.approx(achieved["rms"], rel=1e-6)
    assert found["with_half"]["gyroscope calibration"] < 1.0
    written = yaml.safe_load(file.read_text())
    assert written["gyroscope_noise_density"] == found["settings"]["N"]
    assert "random_walk" in err  # of the accelerometer, which no data sheet stated
    questions = [each["question"] for each in found["answers"]]
    assert len(questions) == 4


@pytest.mark.slow  # a calibration, the attitudes of a log, and two searches
def test_a_calibration_and_a_log(capsys, tmp_path):
    """What a calibration leaves is its covariance; a log has its noise and motion."""
    from made_logs import of_scene

    log, cal = of_scene(tmp_path), tmp_path / "cal.json"
    assert run(["calibrate", str(log), "--out", str(cal)]) in (0, 3)
    capsys.readouterr()
    code, found, _ = told(capsys, str(cal), "--motion", str(log), "--rate", "4")
    assert code == 0
    document = json.loads(cal.read_text())
    sensors = [each for each in ("gyroscope", "magnetometer") if each in document]
    for name in ("accelerometer", *sensors):
        assert found["sources"][f"{name} calibration"] > 0.0
    # half of its covariance's deviations is half of its share
    for block in (document, *(document[name] for name in sensors)):
        block["covariance"] = (0.25 * np.array(block["covariance"])).tolist()
    document = {k: v for k, v in document.items() if k not in ("sd", "confidence_95")}
    cal.write_text(json.dumps(document))
    _, half, _ = told(capsys, str(cal), "--motion", str(log), "--rate", "4")
    share = [
        each["sources"]["accelerometer calibration"] / each["sources"]["start"]
        for each in (found, half)
    ]
    assert half["effects"]["achieved"]["rms"] < found["effects"]["achieved"]["rms"]
    assert share[1] < share[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--motion", "gimbal"], "noise of the sensors is not known"),
        (["--motion", "gimbal", *SHEET, "--scale-error", "gyro=1"], "gyroscope=0.01"),
        (["--motion", "gimbal", *SHEET, "--bias-error", "0.1"], "gyroscope=0.01"),
        (["--motion", "gimbal", *SHEET, "--band", "3", "2"], "band"),
        (["--motion", "gimbal", *SHEET, "--settle", "9999"], "settle"),
        (["--motion", "nowhere.csv", *SHEET], "no such file"),
        (["--motion", "gimbal", *SHEET, "--scale-error", "1e200"], "0 to 1e+06"),
        (
            ["--motion", "gimbal", *SHEET[:4], "--velocity-random-walk", "1e-20"],
            "noise of the accelerometer",
        ),
    ],
)
def test_what_cannot_be_told(capsys, words, said):
    code, _, err = told(capsys, *words)
    assert code == 2
    assert said in err.casefold()


HOW = dict(columns=None, instance=None, start=None, stop=None, rate=None, units=())


def test_too_few_attitudes_are_not_taken_for_a_log(tmp_path):
    """What is wrong with the attitudes, and no word of an accelerometer's columns."""
    from simval.cli.tell import course_of

    file = tmp_path / "few.csv"
    file.write_text("t,qx,qy,qz,qw\n" + "".join(f"{k},0,0,0,1\n" for k in range(6)))
    with pytest.raises(InputError, match=r"and 50 are needed.*\(--columns\)"):
        course_of(str(file), None, HOW)


def test_a_row_of_several_feels_their_mean():
    from simval.cli.tell import Course

    felt = np.arange(60.0).reshape(20, 3)
    q = np.tile([0.0, 0.0, 0.0, 1.0], (21, 1))
    course = Course("m", np.arange(21) / 100.0, q, {}, felt)
    found = course.taken(25.0, 100)
    np.testing.assert_allclose(found.felt, felt.reshape(5, 4, 3).mean(axis=1))
    assert course.taken(100.0, 100).felt is not None


@pytest.mark.slow  # a log is calibrated, and followed by the filter
def test_a_log_without_a_clock_has_the_rate_that_is_stated(tmp_path):
    from made_logs import of_scene

    from simval.cli.tell import course_of

    rows = [line.split(",") for line in of_scene(tmp_path).read_text().splitlines()]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(row[1:7]) for row in rows))
    how = HOW | dict(rate=100.0, units=("m/s^2", "rad/s"))
    assert course_of(str(bare), None, how).rate == pytest.approx(100.0)
    with pytest.raises(InputError, match="--rate"):
        course_of(str(bare), None, how | dict(rate=None))


@pytest.mark.parametrize("order", ["qx,qy,qz,qw", "qw,qx,qy,qz"])
def test_a_file_of_attitudes_is_a_motion(tmp_path, order):
    """Body to world, scalar first or last: those of the file, one row in two."""
    from simval.cli.tell import course_of

    q = np.random.default_rng(0).standard_normal((101, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    time = np.arange(101) / 50.0
    rows = np.column_stack([time, np.roll(q, order.startswith("qw"), axis=1)])
    file = tmp_path / "poses.csv"
    np.savetxt(file, rows, delimiter=",", header=f"t,{order}", comments="")
    found = course_of(str(file), None, HOW).taken(25.0, 40)
    assert found.rate == pytest.approx(25.0)
    assert len(found.time) == len(found.attitude) == 41
    first = round(found.time[0] * 50.0)
    np.testing.assert_allclose(found.attitude, q[first : first + 81 : 2], atol=1e-12)


def test_numbers_of_sensors():
    from simval.cli.tell import by_sensor

    assert by_sensor("--scale-error", ["0.01", "gyroscope=0.02"]) == {
        "gyroscope": 0.02, "accelerometer": 0.01, "magnetometer": 0.01,
    }  # fmt: skip
    with pytest.raises(InputError, match="--scale-error"):
        by_sensor("--scale-error", ["gyroscope=-1"])
