"""A log in any spelling reads the same; a file that is none ends in a sentence."""

import gzip
import io
import re

import numpy as np
import pytest
import scipy.io
from log_formats import spelled
from rounding import EPS

from simval.cli import run
from simval.errors import InputError
from simval.logs import read_log


def check_read(tmp_path, seed):
    case = spelled(np.random.default_rng([12, seed]))
    path = tmp_path / "log.csv"
    path.write_bytes(case.content)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, case.force)
    # six digits are printed, of nanoseconds as of seconds; the unit rounds once more
    np.testing.assert_allclose(log.time, case.time, rtol=1e-15, atol=1e-6)
    if case.gyro is not None:
        np.testing.assert_array_equal(log.gyro, case.gyro)
    assert [each.role for each in log.columns][:4] == ["t", "ax", "ay", "az"]


def check_asked(tmp_path, seed):
    case = spelled(np.random.default_rng([13, seed]), accelerometer=False)
    path = tmp_path / "log.csv"
    path.write_bytes(case.content)
    with pytest.raises(InputError):
        read_log(path)


@pytest.mark.parametrize("seed", range(40))
def test_a_log_in_any_spelling_reads_the_same(tmp_path, seed):
    check_read(tmp_path, seed)


@pytest.mark.parametrize("seed", range(20))
def test_a_log_that_names_no_accelerometer_is_a_question(tmp_path, seed):
    check_asked(tmp_path, seed)


@pytest.mark.slow
def test_a_thousand_spellings(tmp_path):
    """Exact: none may be lost, and none without an accelerometer accepted."""
    for seed in range(1000, 2000):
        check_read(tmp_path, seed)
        check_asked(tmp_path, seed)


def write(tmp_path, header, columns=7, name="log.csv", rate=100.0):
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(30, columns))
    rows[:, 0] = np.arange(30) / rate
    if "elapsed" in header:
        rows[:, 1] = rows[:, 0]
    path = tmp_path / name
    lines = [header, *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines), encoding="latin-1")
    return path, np.array([[float(f"{x:.9g}") for x in row] for row in rows])


@pytest.mark.parametrize(
    ("header", "places"),
    [
        ("t,mx,my,mz,acc_x,acc_y,acc_z", [4, 5, 6]),
        ("Time (s),Linear Acceleration x (m/s^2),Linear Acceleration y (m/s^2),"
         "Linear Acceleration z (m/s^2),Acceleration x (m/s^2),Acceleration y (m/s^2),"
         "Acceleration z (m/s^2)", [4, 5, 6]),
        ("t,Mag_X,Mag_Y,Mag_Z,Acc_Z,Acc_Y,Acc_X", [6, 5, 4]),
        ("time,gFx,gFy,gFz,ax,ay,az", [1, 2, 3]),
        ("%time,field.header.seq,field.linear_acceleration.x,"
         "field.linear_acceleration.y,field.linear_acceleration.z,"
         "field.linear_acceleration_covariance0,q", [2, 3, 4]),
        ("t,accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2],"
         "gyro_rad[0],gyro_rad[1],gyro_rad[2]", [1, 2, 3]),
        ("seconds_elapsed,time (ns),z (m/s\xb2),y (m/s\xb2),x (m/s\xb2),a,b",
         [4, 3, 2]),
    ],
)  # fmt: skip
def test_the_header_says_which_columns(tmp_path, header, places):
    path, rows = write(tmp_path, header)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, rows[:, places])
    assert [each.place for each in log.columns][1:4] == places


def test_a_magnetometer_is_taken_by_its_names(tmp_path, capsys):
    nine = "ax,ay,az,wx,wy,wz,mx,my,mz"
    path, rows = write(tmp_path, f"t,{nine}", 10)
    log = read_log(path)
    np.testing.assert_array_equal(log.gyro, rows[:, 4:7])
    np.testing.assert_array_equal(log.magnetometer, rows[:, 7:])
    assert [each.role for each in log.columns] == ["t", *nine.split(",")]
    other, _ = write(tmp_path, "t,acc_x,acc_y,acc_z,mag_z,mag_y,mag_x", 7, "other.csv")
    log = read_log(other)
    assert log.gyro is None
    np.testing.assert_array_equal(log.magnetometer[:, 0], rows_of(other)[:, 6])
    # asked for by name, in any order; all or none
    log = read_log(other, columns="t,ax,ay,az,mz,mx,my")
    np.testing.assert_array_equal(log.magnetometer, rows_of(other)[:, [5, 6, 4]])
    with pytest.raises(InputError, match="mx, my, mz all or none"):
        read_log(other, columns="t,ax,ay,az,mz,mx,-")
    # nobody guesses nine columns without names
    bare = tmp_path / "bare.csv"
    bare.write_text("".join(f"{','.join(map(str, row))}\n" for row in rows))
    with pytest.raises(InputError, match="10 columns and no names"):
        read_log(bare)


def rows_of(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, encoding="latin-1")


def test_a_slow_magnetometer_is_left_out_and_that_is_said(tmp_path):
    path, rows = write(tmp_path, "t,ax,ay,az,mx,my,mz", 7)
    lines = path.read_text().split("\n")
    for hole in ("nan", ""):
        fields = lines[5].split(",")
        lines[5] = ",".join([*fields[:4], hole, *fields[5:]])
        path.write_text("\n".join(lines))
        log = read_log(path)
        assert log.magnetometer is None
        np.testing.assert_array_equal(log.accelerometer, rows[:, 1:4])
        assert "left out          the magnetometer: " in "\n".join(log.described())
        assert ", line 6" in log.unclear[0]
        with pytest.raises(InputError):  # but not where it is asked for
            read_log(path, columns="t,ax,ay,az,mx,my,mz")


def test_two_sensors_of_a_kind_are_left_out_and_that_is_said(tmp_path):
    gyros = [f"imu{k}_gyro_{axis}" for k in (1, 2) for axis in "xyz"]
    path, _ = write(tmp_path, ",".join(["t,ax,ay,az", *gyros]), 10)
    log = read_log(path)
    assert log.gyro is None
    assert log.unclear == (
        "2 gyroscopes are named and none is taken; choose one by --columns with "
        "wx, wy, wz",
    )
    assert read_log(path, columns="t,ax,ay,az,-,-,-,wx,wy,wz").unclear == ()
    path, _ = write(tmp_path, "t,ax,ay,az,gyr_x,gyr_y,temp", 7)
    log = read_log(path)
    assert log.gyro is None
    assert log.unclear[0].startswith(
        "the gyroscope has not x, y and z once each ('gyr_x', 'gyr_y'); choose"
    )


@pytest.mark.parametrize(
    ("header", "why"),
    [
        ("t,one,two,three", "no three of them"),
        ("t,mx,my,mz", "no three of them"),
        ("t,gyr_x,gyr_y,gyr_z", "no three of them"),
        ("# t, mag_x, mag_y, mag_z", "no three of them"),
        ("t,acc_x,acc_y,temp", "exactly once"),
        ("t,acc_x,acc_y,acc_y", "exactly once"),
        ("t,Linear Acceleration x,Linear Acceleration y,Linear Acceleration z",
         "without gravity"),
        ("t,FreeAcc_X,FreeAcc_Y,FreeAcc_Z", "without gravity"),
        ("t,imu1_ax,imu1_ay,imu1_az,imu2_ax,imu2_ay,imu2_az", "2 accelerometers"),
        ("time,ax,ay,az,aT", "leaves gravity out"),
        ("time,ax (uT),ay (uT),az (uT)", "no three of them"),
        ("time,seconds_elapsed,z,y,x", "Sensor Logger"),
        ("time,x (rad/s),y (rad/s),z (rad/s)", "no three of them"),
    ],
)  # fmt: skip
def test_an_unclear_header_is_a_question(tmp_path, header, why, capsys):
    path, rows = write(tmp_path, header, len(header.split(",")))
    assert run(["calibrate", str(path)]) == 2
    said = capsys.readouterr().err
    assert why in said
    known_as_else = any(
        word in header for word in ("mx", "mag", "gyr", "rad", "Lin", "Free")
    )
    assert ("only if the names are wrong" in said) == known_as_else
    # the line that it proposes, or the first of them, is one that is understood
    line = re.search(r"--columns (\S+)", said).group(1).rstrip(",")
    assert len(line.split(",")) == rows.shape[1]
    assert read_log(path, columns=line, rate=100.0).accelerometer.shape == (30, 3)


def test_a_bare_axis_is_not_taken_from_another_sensors_file(tmp_path):
    assert read_log(write(tmp_path, "t,x,y,z", 4)[0]).columns[1].name == "x"
    for name in ("Gyroscope.csv", "Magnetometer.csv", "LinearAcceleration.csv"):
        with pytest.raises(InputError, match="which columns"):
            read_log(write(tmp_path, "t,x,y,z", 4, name)[0])


def test_a_clock_of_dates(tmp_path):
    path = tmp_path / "log.csv"
    times = [f"2024-03-01T23:59:{58 + k // 100:02d}.{k % 100:02d}Z" for k in range(200)]
    path.write_text("Time;ax;ay;az\n" + "".join(f"{t};1,5;2;3\n" for t in times))
    # printed with three digits, read exactly
    np.testing.assert_allclose(
        read_log(path).time, np.arange(200) / 100, rtol=0, atol=2 * EPS
    )
    path.write_text("Time;ax;ay;az\n" + "".join(f"at {k};1;2;3\n" for k in range(9)))
    with pytest.raises(InputError, match="is not a time in numbers"):
        read_log(path)
    assert read_log(path, rate=50.0).rate == 50.0


def test_a_text_column_that_is_left_out_may_be_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("".join(f"walk,{k / 100},1,2,{k}\n" for k in range(20)))
    log = read_log(path, columns="-,t,ax,ay,az")
    np.testing.assert_array_equal(log.accelerometer[:, 2], np.arange(20))


def matlab(**variables):
    content = io.BytesIO()
    scipy.io.savemat(content, variables)
    return content.getvalue()


ACC, CLOCK = (
    np.random.default_rng(3).normal(size=(40, 3)),
    np.arange(40.0)[:, None] / 50,
)


@pytest.mark.ci
@pytest.mark.parametrize(
    "form",
    [
        {"imu_acc": ACC, "imu_mag": ACC + 1, "t": CLOCK, "fs": 50.0, "info": "text"},
        {"imu": {"acc": ACC.T, "time_ms": 1000 * CLOCK.T}},
        {"data": np.hstack([CLOCK, ACC])},
    ],
)
def test_matlab_files(tmp_path, form):
    path = tmp_path / "log.mat"
    path.write_bytes(matlab(**form))
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, ACC)
    # a median of differences of printed times: rounding
    assert log.rate == pytest.approx(50.0, rel=100 * EPS, abs=0)


@pytest.mark.ci
def test_a_damaged_matlab_file_ends_in_a_sentence(tmp_path):
    """A type of element that does not exist: scipy's reader ends the interpreter."""
    content = bytearray(matlab(data=np.hstack([CLOCK, ACC])))
    content[176] = 0
    path = tmp_path / "log.mat"
    path.write_bytes(content)
    with pytest.raises(
        InputError, match=r"reader crashed.*save the log again with -v7"
    ):
        read_log(path)


NO_LOGS = {
    "gzip": (gzip.compress(b"1,2,3"), "compressed by gzip"),
    "zip": (b"PK\x03\x04rest", "spreadsheet"),
    "matlab 7.3": (b"MATLAB 7.3 MAT-file", "with -v7"),
    "letters": (b"x" * 10**6, "no row of numbers"),
    "one column": (b"1" * 10**6, "1 column and no names"),
    "many columns": (b"1," * 10**5, "columns"),
    "long fields": ((b'"' + b"1" * 200_000 + b'",2,3\n') * 3, "columns"),
    "fewer names": (b"t,ax,ay,az\n" + b"0,0,9,81,0,1,2,3\n" * 2, "4 names, but"),
}


@pytest.mark.parametrize("kind", NO_LOGS)
def test_what_is_no_log_ends_in_a_sentence(tmp_path, kind):
    content, words = NO_LOGS[kind]
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_log(path, rate=100.0)
    assert len(str(caught.value)) < 1000 + len(str(path))
