"""`simval tell` from its options to its answers."""

import json

import numpy as np
import pytest
import scipy
import yaml
from faces import bare
from made_logs import of_scene

from simval.cli import run
from simval.cli.tell import (
    START_STD,
    Course,
    calibrated,
    case_of,
    course_of,
    measured,
    noise_of,
    sheet_errors,
)
from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.imu.calibrate import calibrate, save_calibration
from simval.poses import fibonacci_sphere

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
        (["--motion", "gimbal", *SHEET, "--settle", "9999"], "settle"),
        (["--motion", "nowhere.csv", *SHEET], "no such file"),
        (["--motion", "gimbal", *SHEET, "--scale-error", "1e200"], "0 to 1e+06"),
    ],
)
def test_what_cannot_be_told(capsys, words, said):
    code, _, err = told(capsys, *words)
    assert code == 2
    assert said in err.casefold()


HOW = dict(columns=None, instance=None, start=None, stop=None)
PLAIN = HOW, None, None, ()  # without a rate, a calibration or units


def course(angle, hertz=10.0, **more):
    """A turn about x by angles, at so many rows a second."""
    q = np.column_stack(
        [np.sin(angle / 2), *np.zeros((2, len(angle))), np.cos(angle / 2)]
    )
    felt = more.pop("felt", np.zeros((len(q) - 1, 3)))
    return Course("m", np.arange(len(q)) / hertz, q, felt, **more)


def attitudes(folder, q, hertz, names="qx,qy,qz,qw"):
    file = folder / "poses.csv"
    rows = np.column_stack([np.arange(len(q)) / hertz, q])
    np.savetxt(file, rows, delimiter=",", header=f"t,{names}", comments="")
    return file


@pytest.mark.ci  # a search of a hundred rows
def test_no_setting_is_right_in_every_part(capsys, tmp_path):
    """The exit code says so, and the answer."""
    angle = np.cumsum(np.where(np.arange(101) < 50, 0.2, 0.0))
    turning = course(angle).attitude
    file = attitudes(tmp_path, turning, 5.0)
    code, found, _ = told(
        capsys, "--motion", str(file), *SHEET[:6], "--rate", "5", "--parts", "4",
        "--band", "2.99", "3", "--scale-error", "gyroscope=0.01",
    )  # fmt: skip
    assert code == 3
    assert found["answers"][0]["answer"] == "fail"


def test_too_few_attitudes_are_not_taken_for_a_log(tmp_path):
    """What is wrong with the attitudes, and no word of an accelerometer's columns."""
    file = attitudes(tmp_path, np.tile([0.0, 0.0, 0.0, 1.0], (6, 1)), 1.0)
    with pytest.raises(InputError, match=r"and 50 are needed.*\(--columns\)"):
        course_of(str(file), *PLAIN)


def test_the_part_that_turns_most_is_taken():
    steps = np.arange(61)
    angle = np.cumsum(np.where((steps > 30) & (steps <= 40), 0.1, 1e-3))
    found = course(angle).taken(10.0, 10)
    assert found.time[0] == pytest.approx(3.0)
    assert "3 to 4 s, which turn most" in found.said[-1].words


def test_a_row_of_several_feels_their_mean():
    felt = np.arange(60.0).reshape(20, 3)
    found = course(np.zeros(21), 100.0, felt=felt).taken(25.0, 100)
    np.testing.assert_allclose(found.felt, felt.reshape(5, 4, 3).mean(axis=1))


def test_without_a_magnetometer_the_heading_is_that_of_the_start():
    way = course(np.full(41, 0.7))
    white = {"N": 1e-3, "K": 0.0, "accelerometer": 1e-2, "magnetometer": 0.0}
    up = attitude_matrix(way.attitude[0])[:, 2]
    P = case_of(way, white, [], 5e-3, 1.0).truth.start[:3, :3]
    np.testing.assert_allclose(P, START_STD**2 * (np.eye(3) - np.outer(up, up)))
    P = case_of(way, white | {"magnetometer": 1e-7}, [], 5e-3, 1.0).truth.start
    variances = np.repeat([START_STD**2, 25e-6], 3)
    np.testing.assert_allclose(P, np.diag(variances))


@pytest.mark.ci  # the noise of a log, and two searches of sixty rows
def test_a_walk_that_a_rest_cannot_show_is_said(capsys, tmp_path):
    """It doubles the variance of the mean of the rest, N^2/T + K^2 T/3."""
    rows = 3000
    white = np.random.default_rng(2).standard_normal((rows, 6)) * np.repeat(
        [0.02, 1e-3], 3
    )
    white += np.repeat([[0.0, 0.0, 9.81, 0.0, 0.0, 0.0]], rows, axis=0)
    log, file = tmp_path / "rest.csv", tmp_path / "noise.json"
    np.savetxt(log, np.column_stack([np.arange(rows) / 50.0, white]), delimiter=",",
               header="t,ax,ay,az,wx,wy,wz", comments="")  # fmt: skip
    assert run(["noise", str(log), "--json", "--gyro-unit", "rad/s"]) == 0
    file.write_text(capsys.readouterr().out)
    size, ends, fact = measured(file, {})
    assert size["N"] == pytest.approx(1e-3 / np.sqrt(50.0), rel=0.1)
    seconds = 3.0**0.5 * size["N"] / size["K"]
    assert fact.notable
    assert f"below what {seconds:.0f} s can show" in fact.words
    assert 30.0 < seconds <= 60.0  # of the log's one minute
    assert ends[0]["K"] < 1.0 < ends[1]["K"]
    # and on the terminal, which leaves out no answer and no warning
    motion = attitudes(tmp_path, course(0.2 * np.arange(61)).attitude, 5.0)
    words = ["--motion", str(motion), "--noise", str(file), "--rate", "5"]
    code, found, _ = told(capsys, *words)
    assert [each["said"] for each in found["warnings"]] == [fact.words]
    assert run(["tell", *words]) == code
    terminal = bare(capsys.readouterr().out)
    for each in found["answers"]:
        assert all(each[x] in terminal for x in ("question", "reason", "do"))
    assert fact.words in terminal


def test_of_several_logs_the_largest_noise_counts():
    """Of each kind; that of the last, or of the first, is not taken for all."""
    each = [
        {"N": 1.0, "K": 5.0, "accelerometer": 3.0},
        {"N": 2.0, "accelerometer": 1.0},
    ]
    ways = [course(np.zeros(3), white=white) for white in (*each, {})]
    white, _, facts = noise_of(ways, None, {}, {"K": 7.0})
    assert white == {"N": 2.0, "K": 7.0, "accelerometer": 3.0, "magnetometer": 0.0}
    assert any("largest" in fact.words and fact.notable for fact in facts)
    assert noise_of(ways[:1], None, {}, {})[2] == []


@pytest.mark.parametrize("known", [True, False])
def test_what_a_calibration_leaves(tmp_path, known):
    """A field of 1 has the motion's strength, and shares stay; a scatter's interval."""
    file, s = tmp_path / "c.json", 1e-3
    rng = np.random.default_rng(0)
    poses = 9.8 * fibonacci_sphere(12)
    poses = poses + s * rng.standard_normal(poses.shape)
    fit = calibrate(poses, 9.8, noise_std=s if known else None)
    save_calibration(file, fit)
    document = json.loads(file.read_text())
    document["magnetometer"] = {
        "M": (2.0 * np.eye(3)).tolist(), "field": 0.5,
        "covariance": (s**2 * np.eye(13)).tolist(),
    }  # fmt: skip
    file.write_text(json.dumps(document))
    M, (accelerometer, magnetometer), ends = calibrated(file, np.array([0, 0, 4e-5]))
    np.testing.assert_allclose(M["magnetometer"], 2.0 * 4e-5 / 0.5 * np.eye(3))
    variances = np.diagonal(magnetometer.covariance)
    np.testing.assert_allclose(variances[:9], (s / 2.0) ** 2)
    # an offset of the reading by s, in tesla
    np.testing.assert_allclose(variances[9:], (s * M["magnetometer"][0, 0]) ** 2)
    if known:
        assert ends == [{}, {}]
        return
    # chi-square of 3 degrees of freedom over them is seen / true, of the variances
    low, high = (end[accelerometer.name] for end in ends)
    chi2 = scipy.stats.chi2(fit.dof)
    assert chi2.cdf(fit.dof / low**2) == pytest.approx(0.975)
    assert chi2.cdf(fit.dof / high**2) == pytest.approx(0.025)
    document["magnetometer"]["covariance"] = 5
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"magnetometer.*covariance"):
        calibrated(file, np.array([0, 0, 4e-5]))


@pytest.mark.slow  # a log is calibrated, and followed by the filter
def test_a_log_without_a_clock_has_the_rate_that_is_stated(tmp_path):
    """Its noise is that of the rests, whatever the filter that follows it is given."""
    rows = [line.split(",") for line in of_scene(tmp_path).read_text().splitlines()]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(row[1:7]) for row in rows))
    units = "0.0024", "0.0011"
    found = course_of(str(bare), HOW, 100.0, None, units)
    assert found.rate == pytest.approx(100.0)
    assert found.white["accelerometer"] == pytest.approx(9.6e-4, rel=0.1)
    assert any("scatter in" in fact.words for fact in found.noise)
    with pytest.raises(InputError, match="--rate"):
        course_of(str(bare), HOW, None, None, units)


@pytest.mark.parametrize("order", ["qx,qy,qz,qw", "qw,qx,qy,qz"])
def test_a_file_of_attitudes_is_a_motion(tmp_path, order):
    """Body to world, scalar first or last: those of the file, one row in two."""
    q = np.random.default_rng(0).standard_normal((101, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    file = attitudes(tmp_path, np.roll(q, order.startswith("qw"), axis=1), 50.0, order)
    found = course_of(str(file), *PLAIN).taken(25.0, 40)
    assert found.rate == pytest.approx(25.0)
    assert len(found.time) == len(found.attitude) == 41
    first = round(found.time[0] * 50.0)
    np.testing.assert_allclose(found.attitude, q[first : first + 81 : 2], atol=1e-12)


def test_numbers_of_sensors():
    """Of one or of all, the last counts; where each stands."""
    stated = {"--scale-error": ["0.01", "gyroscope=0.02"], "--misalignment": ["0.03"],
              "--bias-error": ["gyroscope=0.5", "magnetometer=0.25"]}  # fmt: skip
    found, bias = sheet_errors(stated)
    assert bias == 0.5
    sd = {each.of: np.sqrt(np.diagonal(each.covariance)) for each in found}
    for name, scale, offset in (("gyroscope", 0.02, []), ("accelerometer", 0.01, 0.0),
                                ("magnetometer", 0.01, 0.25)):  # fmt: skip
        matrix = 0.03 + (scale - 0.03) * np.eye(3).ravel()
        np.testing.assert_allclose(sd[name], [*matrix, *np.tile(offset, 3)])
