"""Parameters of other projects: applied as each does, against `simval correct`.

A reading of each project's formula stands here by itself, from its source: see the
module `simval.imu.multiposition.parameters` for the files and their commits.
"""

import json
import re
from itertools import chain

import numpy as np
import pytest
import yaml
from made_logs import of_scene
from places import recording

from simval.imu.logs import read_log
from simval.imu.multiposition import parameters
from simval.imu.multiposition.noise import log_noise
from simval.imu.sensor import NoiseModel
from simval.poses import fibonacci_sphere
from simval.vocabulary import TARGETS

STRENGTH = 44.7213595499958  # uT, of the scene
FELT = 2e-3  # rad/s per m/s^2
HEADER = "t [s],ax [g],ay,az,wx [deg/s],wy,wz,mx [uT],my,mz"
UNITS = np.array([[9.80665], [np.pi / 180.0], [1.0]])  # of the log, in m/s^2, rad/s


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A log in units of a header, whose gyroscope feels force; its files and rows."""
    from simval.cli import run

    folder = tmp_path_factory.mktemp("parameters")
    rows = np.loadtxt(of_scene(folder), delimiter=",", skiprows=1)[:, :17]
    raw = rows[:, :10] * ([1.0] + [2.4e-3] * 3 + [1.1e-3] * 3 + [0.15] * 3)
    raw[:, 4:7] += FELT * rows[:, 11:14] @ np.roll(np.eye(3), 1, axis=0)
    raw[:, 1:] /= np.repeat(UNITS, 3)
    log, out = folder / "imu.csv", folder / "cal.json"
    np.savetxt(log, raw, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    files = {name: folder / name for name in TARGETS}
    to = [word for name in TARGETS for word in ("--to", name, str(files[name]))]
    ask = ["calibrate", str(log), "--out", str(out), "--field", str(STRENGTH), *to]
    assert run(ask) == 0
    fixed = folder / "fixed.csv"
    words = ["correct", str(log), "--calibration", str(out), "--out", str(fixed)]
    assert run(words) == 0
    right = np.loadtxt(fixed, delimiter=",", skiprows=1)
    data = json.loads(out.read_text())
    assert np.any(data["gyroscope"]["G"])
    return files, data, raw[:, 1:].reshape(-1, 3, 3), right[:, 1:].reshape(-1, 3, 3)


def px4(path, raw):
    """A parameter file of QGroundControl, for readings in m/s^2, rad/s and gauss."""
    rows = [x.split("\t") for x in path.read_text().splitlines() if x[0] != "#"]
    assert all(len(row) == 5 and row[4] == "9" for row in rows)
    values = {row[2]: float(row[3]) for row in rows}
    assert len(values) == 18
    return autopilot(
        [np.array([values[f"CAL_{name[0]}0_{axis}{name[1]}"] for axis in "XYZ"])
         for name in (("ACC", "OFF"), ("ACC", "SCALE"), ("GYRO", "OFF"),
                      ("MAG", "OFF"), ("MAG", "SCALE"), ("MAG", "ODIAG"))],
        raw, 1e-2, -1.0,
    )  # fmt: skip


def ardupilot(path, raw):
    """Read by pymavlink; the compass offset is added, in milligauss."""
    values = pytest.importorskip("pymavlink.mavparm").MAVParmDict()
    assert values.load(str(path))
    assert len(values) == 18
    return autopilot(
        [np.array([values[f"{name}_{axis}"] for axis in "XYZ"]) for name in (
            "INS_ACCOFFS", "INS_ACCSCAL", "INS_GYROFFS",
            "COMPASS_OFS", "COMPASS_DIA", "COMPASS_ODI")],
        raw, 10.0, 1.0,
    )  # fmt: skip


def autopilot(three, raw, field, sign):
    """Both turn a raw vector so, but for the sign of the field's offset."""
    offset, scale, still, iron, (d, e, f), (a, b, c) = three
    S = np.array([[d, a, b], [a, e, c], [b, c, f]])
    mag = (field * raw[:, 2] + sign * iron) @ S.T / field
    return np.stack([(raw[:, 0] - offset) * scale, raw[:, 1] - still, mag], axis=1)


@pytest.mark.ci
def test_autopilots_hold_what_they_can_and_say_how_much_is_left(made):
    files, data, raw, right = made
    for name, applied in (("px4", px4), ("ardupilot", ardupilot)):
        found = applied(files[name], raw * UNITS)
        text = files[name].read_text()
        left = [float(re.search(words, text)[1]) for words in (
            r"up to (\S+) m/s\^2", r"up to (\S+) % of a rate",
            r"up to (\S+) rad/s at 1 g", r"up to (\S+) % of the field")]  # fmt: skip
        g = data["g"]
        size = np.linalg.norm(right, axis=2)
        off = np.linalg.norm(found - right, axis=2)
        bound = left[0] * size[:, 0] / g
        assert np.all(off[:, 0] <= 1.006 * bound)  # three digits are printed
        assert np.max(off[:, 0] / bound) > 0.5
        bound = left[1] / 100.0 * size[:, 1] + left[2] * size[:, 0] / g
        assert np.all(off[:, 1] <= 1.006 * bound)
        assert np.max(off[:, 1] / bound) > 0.3
        assert np.all(off[:, 2] <= 1.006e-2 * left[3] * size[:, 2])
        # any other scale leaves more of the mean square over all directions
        u = g * fibonacci_sphere(2000)
        y = np.linalg.solve(data["matrix"], u.T).T + data["B"]
        f = applied(files[name], np.stack([y] * 3, axis=1) * UNITS)[:, 0]
        least = np.mean((f - u) ** 2, axis=0)
        for factor in (0.9999, 1.0001):
            assert np.all(np.mean((factor * f - u) ** 2, axis=0) > least)


@pytest.mark.ci
def test_kalibr_and_openvins_and_ros_hold_what_correct_applies(made):
    files, data, raw, right = made
    force, rate = right[:, 0], right[:, 1]
    bias, bias_g = np.array(data["B"]), np.array(data["gyroscope"]["B"])

    imu = yaml.safe_load(files["kalibr"].read_text())["imu0"]
    gyro, C = imu["gyroscopes"], np.array(imu["gyroscopes"]["C_gyro_i"])
    predicted = force @ np.array(imu["accelerometers"]["M"]).T + bias
    np.testing.assert_allclose(predicted, raw[:, 0], atol=1e-12 * 20.0)
    predicted = (rate @ C.T) @ np.array(gyro["M"]).T + (force @ C.T) @ np.array(
        gyro["A"]
    ).T  # M (C w) + A (C a), in which Kalibr turns the force as well
    np.testing.assert_allclose(predicted + bias_g, raw[:, 1], atol=1e-11)
    log = read_log(str(files["kalibr"].parent / "imu.csv"))
    assert imu["update_rate"] == log.rate
    noise = log_noise(log)
    for name, axes, M in (
        ("accelerometer", noise.accelerometer, data["matrix"]),
        ("gyroscope", noise.gyro, data["gyroscope"]["M"]),
    ):
        white = [c.value for axis in axes for c in axis.coefficients if c.kind == "N"]
        most = np.max(np.linalg.norm(M * np.array(white), axis=0))  # M e_k, of axis k
        assert imu[f"{name}_noise_density"] == pytest.approx(most, rel=1e-12)

    head, text = files["openvins"].read_text().split("\n", 1)
    assert head == "%YAML:1.0"
    imu = {k: np.array(v) for k, v in yaml.safe_load(text)["imu0"].items()}
    Da, Dw = (np.linalg.inv(imu[k]) for k in ("Ta", "Tw"))
    for matrix in (Da, Dw):  # its model takes the lower triangle
        assert np.array_equal(matrix, np.tril(matrix))
    a = (raw[:, 0] - bias) @ (imu["R_IMUtoACC"].T @ Da).T
    np.testing.assert_allclose(a, force, atol=1e-11)
    w = (raw[:, 1] - bias_g - a @ imu["Tg"].T) @ (imu["R_IMUtoGYRO"].T @ Dw).T
    np.testing.assert_allclose(w, rate, atol=1e-12)

    held = yaml.safe_load(files["ros"].read_text())
    SM = np.reshape(held["SM"], (3, 3))
    np.testing.assert_allclose(raw[:, 0] @ SM.T - held["bias"], force, atol=1e-11)
    for name in data["ros_imu"]:
        np.testing.assert_array_equal(held[name], data["ros_imu"][name])


def test_a_number_in_yaml_is_read_as_that_number_by_either_version():
    """As 1e-05 is a word in YAML 1.1, 0o17 one number or another, 12:30 a time."""
    rng = np.random.default_rng(7)
    powers = [float(f"{sign}1e{k}") for k in range(-25, 26) for sign in ("", "-")]
    whole = [0.0, -0.0, 17.0, 1000.0, 123045.0, 2.0**53, 5e-324, 0.5, 1.0 / 3.0]
    values = np.array([*powers, *whole, *rng.standard_normal(12)])
    values = values[: len(values) // 3 * 3]
    held = {"row": values, "rows": values.reshape(-1, 3), "one": values[4]}
    held["table"] = {f"n{k}": x for k, x in enumerate(values)}
    text = "\n".join(parameters.yaml_lines(held))
    newer = pytest.importorskip("ruamel.yaml").YAML(typ="safe", pure=True)
    for found in (yaml.safe_load(text), newer.load(text)):
        named = [*found["table"].values()]
        read = [*found["row"], *chain(*found["rows"]), *named, found["one"]]
        assert {type(each) for each in read} == {float}
        expected = np.concatenate([values, values, values, values[4:5]])
        np.testing.assert_array_equal(read, expected)
        np.testing.assert_array_equal(np.signbit(read), np.signbit(expected))


@pytest.mark.ci
def test_kalibr_and_openvins_get_a_walk_for_slow_noise_of_any_kind(
    made, tmp_path, simval
):
    """Flicker at rest: the key that they need, marked as equivalent."""
    rows = np.loadtxt(made[0]["kalibr"].parent / "imu.csv", delimiter=",", skiprows=1)
    flicker = NoiseModel(flicker_raw=2e-4)  # g
    rows[:, 1:4] += flicker.draw(len(rows), 100.0, np.random.default_rng(4))
    log, name = tmp_path / "log.csv", "accelerometer_random_walk"
    np.savetxt(log, rows, delimiter=",", header=HEADER, comments="", fmt="%.17g")
    files = {to: tmp_path / to for to in ("kalibr", "openvins")}
    to = [word for name, path in files.items() for word in ("--to", name, path)]
    assert simval("calibrate", log, *to)[0] == 0
    found = log_noise(read_log(str(log))).accelerometer
    assert any(axis.slow and not axis.slow.is_walk for axis in found)
    for path in files.values():
        text = path.read_text()
        (line,) = (x for x in text.splitlines() if name in x)
        assert "# m/s^2/sqrt(s); equivalent over up to" in line
        assert yaml.safe_load(text.removeprefix("%YAML:1.0\n"))["imu0"][name] > 0.0


@pytest.mark.ci
def test_every_file_says_of_each_sensor_what_it_leaves_out(made):
    files = made[0]
    for name, path in files.items():
        comments = [x for x in path.read_text().splitlines() if x.startswith("#")]
        for sensor in ("accelerometer", "gyroscope", "magnetometer"):
            assert any(sensor in x for x in comments), (name, sensor)
        assert any("can the error bars be trusted" in x for x in comments)


@pytest.mark.ci
def test_a_field_that_is_not_stated_goes_out_in_gauss(made, tmp_path, simval):
    """0.6 gauss, which a strength of 1 would make 1 gauss; an offset out of range."""
    rows = np.loadtxt(made[0]["px4"].parent / "imu.csv", delimiter=",", skiprows=1)
    rows[:, 7:] *= 0.6 / STRENGTH
    rows[:, 1] += 0.5
    log, out, other = (tmp_path / name for name in ("log.csv", "out", "other"))
    head = HEADER.replace("uT", "gauss")
    np.savetxt(log, rows, delimiter=",", header=head, comments="", fmt="%.17g")
    simval("calibrate", log, "--to", "px4", out, "--to", "ardupilot", other)
    found = re.findall(r"CAL_MAG0_.(SCALE|ODIAG)\t(\S+)", out.read_text())
    d, e, f, a, b, c = (float(value) for _, value in found)
    assert np.linalg.det([[d, a, b], [a, e, c], [b, c, f]]) == pytest.approx(1.0)
    assert "field was not stated" in out.read_text()
    (words,) = (x for x in other.read_text().splitlines() if "INS_ACCOFFS_X is" in x)
    assert words.endswith("documents -3.5 to 3.5")
    assert "COMPASS_DIA_X is" not in other.read_text()  # no range is documented


@pytest.mark.ci
def test_readings_that_an_autopilot_corrected_are_said_to_be(made, tmp_path, simval):
    rows = np.loadtxt(made[0]["px4"].parent / "imu.csv", delimiter=",", skiprows=1)
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 163, 60, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
    ]
    for t, *y in rows[:, :7]:
        values = [*np.multiply(y[3:], np.pi / 180.0), *np.multiply(y[:3], 9.80665)]
        lines.append(f"IMU, {1e6 * t:.0f}, 0, {', '.join(f'{x:.9g}' for x in values)}")
    log, out = tmp_path / "log.log", tmp_path / "out"
    log.write_text("\n".join([*lines, ""]))
    code, said, _ = simval("calibrate", log, "--to", "ardupilot", out)
    assert (code, "corrected and turned by the autopilot" in said) == (0, True)
    assert "corrected and turned" in out.read_text()
    assert "corrected and turned" not in made[0]["ardupilot"].read_text()


@pytest.mark.ci
def test_px4_takes_up_no_scales_within_a_hundredth_of_one(tmp_path, simval):
    """Its `set_scale` asks for a change of length 0.01; 1 is what it starts at."""
    off = {}
    for k in range(2):
        log, out = recording(f"mpu9150/imu{k}.log"), tmp_path / "out"
        simval("calibrate", log, "--rate", "100", "--g", "9.81", "--to", "px4", out)
        scales = re.findall(r"CAL_ACC0_.SCALE\t(\S+)", out.read_text())
        off[k] = np.linalg.norm([float(x) - 1.0 for x in scales])
        assert ("SCALE will not be taken up" in out.read_text()) == (off[k] < 0.01)
    assert off[0] < 0.01 < off[1]


@pytest.mark.ci
def test_px4_takes_up_no_small_offsets_and_says_in_which_version(
    made, tmp_path, simval
):
    """Each sensor's setter asks for a length of 0.01, in m/s^2, rad/s and gauss.

    Newer code: 0.005 gauss, and the gyroscope's first one of any size.
    """
    rows = np.loadtxt(made[0]["px4"].parent / "imu.csv", delimiter=",", skiprows=1)
    data, out = made[1], tmp_path / "out"
    biases = (data["B"], data["gyroscope"]["B"], data["magnetometer"]["b"])
    off = np.concatenate(biases) * np.repeat([*UNITS[:2], [0.01]], 3)
    along = np.array([0.6, 0.0, 0.8])
    names = ("ACC", "GYRO", "MAG")
    for sizes, said in (
        ((0.006, 0.006, 0.003), ("will not", "may not", "will not")),
        ((0.006, 0.006, 0.008), ("will not", "may not", "may not")),
        ((0.02, 0.02, 0.02), (None, None, None)),
    ):
        moved = rows.copy()
        moved[:, 1:] += (np.kron(sizes, along) - off) / np.repeat(
            [*UNITS[:2], [0.01]], 3
        )
        log = tmp_path / "log.csv"
        np.savetxt(log, moved, delimiter=",", header=HEADER, comments="", fmt="%.17g")
        assert simval("calibrate", log, "--to", "px4", out)[0] == 0
        text = out.read_text()
        for name, size, words in zip(names, sizes, said, strict=True):
            values = re.findall(rf"CAL_{name}0_.OFF\t(\S+)", text)
            length = np.linalg.norm([float(x) for x in values])
            assert length == pytest.approx(size, abs=3e-3)  # errors of the fit
            found = re.search(rf"CAL_{name}0_\*OFF (\w+ not) be taken up: .*", text)
            assert (found and found[1]) == words
            if found:  # file, line and commit, as the module has them
                assert re.search(r"\(\w+\.cpp:\d+, [0-9a-f]{7}", found[0])
                assert ("newer code" in found[0]) == (name != "ACC")


@pytest.mark.ci
@pytest.mark.parametrize("name", ["px4", "ros"])
def test_counts_are_refused_where_a_project_has_units(name, tmp_path, simval):
    out = tmp_path / "out"
    log = recording("xsens/xsens_acc.mat")
    code, _, err = simval("calibrate", log, "--to", name, out)
    if name == "ros":  # a matrix from any unit
        assert (code, out.exists()) == (0, True)
    else:
        assert (code, out.exists(), "unit of its readings" in err) == (3, False, True)


def test_a_file_to_write_is_no_input_and_no_other_output(simval, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t,ax,ay,az\n0,0,0,1\n")
    code, _, err = simval("calibrate", log, "--to", "px4", log)
    assert (code, "reads" in err) == (2, True)
    x = tmp_path / "x"
    code, _, err = simval("calibrate", log, "--to", "px4", x, "--to", "ros", x)
    assert (code, "both name" in err) == (2, True)
