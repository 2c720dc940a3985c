"""Logs in every layout and spelling, their clocks, and every bad file by its words."""

import bz2
import gzip
import io
import lzma
import re

import numpy as np
import pytest
import scipy.io
from log_formats import spelled
from rounding import EPS
from scipy.spatial.transform import Rotation
from written import written

from simval.cli import run
from simval.errors import InputError
from simval.imu.logs import read_log
from simval.imu.logs.clock import GAP
from simval.imu.logs.truth import read_truth

ROWS = np.arange(70.0).reshape(10, 7) / 7.0
ROWS[:, 0] = 0.01 * np.arange(10)


def write(folder, rows, separator=" ", header=""):
    return written(folder / "log.txt", header.rstrip("\n"), rows, mark=separator)


@pytest.mark.parametrize("kind", [gzip, bz2, lzma], ids=lambda kind: kind.__name__)
def test_packed_parts_one_behind_another_are_one_log(tmp_path, kind):
    whole = "\n".join(NUMBERS).encode()
    (tmp_path / "log").write_bytes(
        kind.compress(whole[:99]) + kind.compress(whole[99:])
    )
    (tmp_path / "plain").write_bytes(whole)
    found = [read_log(tmp_path / name) for name in ("log", "plain")]
    assert found[0].accelerometer.tolist() == found[1].accelerometer.tolist()
    (tmp_path / "log").write_bytes(kind.compress(whole) + b"rest")
    with pytest.raises(InputError, match="cannot be unpacked"):
        read_log(tmp_path / "log")


@pytest.mark.parametrize(
    ("columns", "rate", "has_gyro"),
    [
        (slice(1, 4), 100.0, False),
        (slice(0, 4), None, False),
        (slice(1, 7), 100.0, True),
        (slice(0, 7), None, True),
    ],
)
def test_the_number_of_columns_tells_what_they_are(tmp_path, columns, rate, has_gyro):
    log = read_log(write(tmp_path, ROWS[:, columns]), rate=rate)
    np.testing.assert_array_equal(log.accelerometer, ROWS[:, 1:4])
    assert (log.gyro is not None) == has_gyro
    if has_gyro:
        np.testing.assert_array_equal(log.gyro, ROWS[:, 4:])
    assert log.rate == pytest.approx(
        100.0, rel=1e-12, abs=0
    )  # 9 steps of 0.01, rounding


def test_columns_are_named_by_the_caller_or_by_the_header(tmp_path):
    wide = np.column_stack([np.full(10, 7.0), ROWS[:, [3, 2, 1, 0]]])
    text = "".join(f"walk {' '.join(map(repr, row[1:].tolist()))}\n" for row in wide)
    (tmp_path / "walk.txt").write_text(text)
    given = read_log(tmp_path / "walk.txt", columns="-,az,ay,ax,t")
    header = "temperature,az [m/s^2],ay (m/s^2), Ax ,time\n"
    named = read_log(write(tmp_path, wide, ",", header))
    for log in (given, named):
        np.testing.assert_array_equal(log.accelerometer, ROWS[:, 1:4])
        np.testing.assert_array_equal(log.time, ROWS[:, 0])


NUMBERS = [" ".join(f"{x:.3f}" for x in row) for row in ROWS[:, :4]]


def replaced(row, text):
    return "\n".join([*NUMBERS[:row], text, *NUMBERS[row + 1 :]])


REFUSED = [  # what a file holds, how it is read, and what is said
    ("", {}, "is empty"),
    ("t ax ay az\n", {}, "a header but no row"),
    (replaced(4, "0.04 1 nan 3"), {}, "line 5: a value is missing or not finite"),
    (replaced(4, "0.04 1 two 3"), {}, "line 5, column 3: 'two' is not a number"),
    ("# remark\n\n" + replaced(4, "0.04 1 two 3"), {}, "line 7, column 3"),
    (replaced(4, "0.04 1 2"), {}, "line 5 has 3 columns, but the rows from line 1"),
    (replaced(4, "0.03 1 2 3"), {}, "line 5: time 0.030000 s after 0.030000 s"),
    ("of us\n0.04 1 2\nand more\nt ax ay az\n" + replaced(0, NUMBERS[0]), {},
     "line 2 has 3 columns, but the rows from line 5"),
    ("1 2 3\n4 5 6\n", {}, "no time column and no rate"),
    ("1 2 3 4 5\n1 2 3 4 5\n", {}, "has 5 columns"),
    ("0 1 2 3\n", {}, "has one row"),
    ("1,2,3,\n1,2,3,\n", {}, "no time column and no rate"),
    *(("1 2 3\n4 5 6\n", {"rate": rate}, "`rate`")
      for rate in (0.0, float("nan"), "fast")),
    *((replaced(0, NUMBERS[0]), {"columns": names}, "`columns`")
      for names in ("t,ax,ay", "t,ax,ay,ay", "t,ax,ay,up", "t,-,ay,az")),
    (b"\x00\x01\x02" * 100, {}, "not a text file"),
    (gzip.compress(b"1,2,3"), {}, "no time column and no rate"),
    (gzip.compress(b"1,2,3" * 99)[:-5], {}, "its end is missing"),
    (gzip.compress(gzip.compress(b"1,2,3")), {}, "compressed twice"),
    (gzip.compress(b"1,2,3\n" * 10**6), {}, "100 times its size"),
    (b"\x1f\x8b" + bytes(99), {}, "cannot be unpacked"),
    (b"PK\x03\x04rest", {}, "cannot be unpacked"),
    (b"MATLAB 7.3 MAT-file", {}, "a MATLAB 7.3 file"),
    (b"1" * 10**6, {"rate": 100.0}, "1 column and no names"),
    ((b'"' + b"1" * 200_000 + b'",2,3\n') * 3, {"rate": 100.0}, "columns"),
    (b"t,ax,ay,az\n" + b"0,0,9,81,0,1,2,3\n" * 2, {}, "4 names, but"),
    *((text, {"instance": "imu1"}, "leave out --instance")
      for text in (replaced(0, NUMBERS[0]), "t,ax,ay,az\n" + "0,1,2,3\n" * 9)),
]  # fmt: skip


@pytest.mark.parametrize(("content", "how", "words"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_log_ends_in_a_sentence(tmp_path, content, how, words):
    path = tmp_path / "log.txt"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        read_log(path, **how)
    said = str(caught.value)
    assert str(path) in said or how
    assert len(said) < 1000 + len(str(path))


def test_what_cannot_be_opened_is_said(tmp_path):
    for name, words in (("absent.txt", "No such file"), ("", "without a table")):
        with pytest.raises(InputError, match=words):
            read_log(tmp_path / name)


@pytest.mark.ci
def test_an_archive_of_arrays_that_swells_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "log.npz", acc=np.zeros((10**6, 3)))
    with pytest.raises(InputError, match="more than 100 times its size"):
        read_log(tmp_path / "log.npz", rate=100.0)


@pytest.mark.parametrize("seed", range(25))
def test_a_log_in_any_spelling_reads_the_same(tmp_path, seed):
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


@pytest.mark.parametrize("seed", range(8))
def test_a_log_that_names_no_accelerometer_is_a_question(tmp_path, seed):
    case = spelled(np.random.default_rng([13, seed]), accelerometer=False)
    path = tmp_path / "log.csv"
    path.write_bytes(case.content)
    with pytest.raises(InputError):
        read_log(path)


def write_named(tmp_path, header, columns=7, name="log.csv", rate=100.0):
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(30, columns))
    rows[:, 0] = np.arange(30) / rate
    if "elapsed" in header:
        rows[:, 1] = rows[:, 0]
    path = tmp_path / name
    lines = [header, *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    path.write_text("\n".join([*lines, ""]), encoding="latin-1")
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
    path, rows = write_named(tmp_path, header)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, rows[:, places])
    assert [each.place for each in log.columns][1:4] == places


def test_a_magnetometer_is_taken_by_its_names(tmp_path, capsys):
    nine = "ax,ay,az,wx,wy,wz,mx,my,mz"
    path, rows = write_named(tmp_path, f"t,{nine}", 10)
    log = read_log(path)
    np.testing.assert_array_equal(log.gyro, rows[:, 4:7])
    np.testing.assert_array_equal(log.magnetometer, rows[:, 7:])
    assert [each.role for each in log.columns] == ["t", *nine.split(",")]
    other, _ = write_named(
        tmp_path, "t,acc_x,acc_y,acc_z,mag_z,mag_y,mag_x", 7, "other.csv"
    )
    log = read_log(other)
    assert log.gyro is None
    np.testing.assert_array_equal(log.magnetometer[:, 0], rows_of(other)[:, 6])
    with pytest.raises(InputError, match="mx, my, mz all or none"):
        read_log(other, columns="t,ax,ay,az,mz,mx,-")
    # nobody guesses nine columns without names
    bare = tmp_path / "bare.csv"
    bare.write_text("".join(f"{','.join(map(str, row))}\n" for row in rows))
    with pytest.raises(InputError, match="10 columns and no names"):
        read_log(bare)


def rows_of(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, encoding="latin-1")


def test_two_sensors_of_a_kind_are_left_out_and_that_is_said(tmp_path):
    gyros = [f"imu{k}_gyro_{axis}" for k in (1, 2) for axis in "xyz"]
    path, _ = write_named(tmp_path, ",".join(["t,ax,ay,az", *gyros]), 10)
    log = read_log(path)
    assert log.gyro is None
    named = ", ".join(map(repr, gyros))
    (remark,) = log.unclear
    assert remark.words == (
        f"the gyroscope: {named} are not surely those beside the accelerometer"
    )
    assert remark.do == "Choose by --columns with wx, wy, wz."
    assert read_log(path, columns="t,ax,ay,az,-,-,-,wx,wy,wz").unclear == ()
    path, _ = write_named(tmp_path, "t,ax,ay,az,gyr_x,gyr_y,temp", 7)
    log = read_log(path)
    assert log.gyro is None
    assert log.unclear[0].words.startswith(
        "the gyroscope: 'gyr_x', 'gyr_y' are not surely those beside the"
    )


@pytest.mark.parametrize(
    ("header", "why"),
    [
        ("t,one,two,three", "no three of them"),
        ("t,gyr_x,gyr_y,gyr_z", "has no column named as an"),
        ("t,acc_x,acc_y,temp", "exactly once"),
        ("t,Linear Acceleration x,Linear Acceleration y,Linear Acceleration z",
         "without gravity"),
        ("t,accx_Lin,accy_Lin,accz_Lin", "without gravity"),
        ("t,imu1_ax,imu1_ay,imu1_az,imu2_ax,imu2_ay,imu2_az", "2 accelerometers"),
        ("time,ax,ay,az,aT", "leaves gravity out"),
        ("time,ax (uT),ay (uT),az (uT)", "no three of them"),
        ("time,seconds_elapsed,z,y,x", "Sensor Logger"),
        ("time,x (rad/s),y (rad/s),z (rad/s)", "has no column named as an"),
    ],
)  # fmt: skip
def test_an_unclear_header_is_a_question(tmp_path, header, why, capsys):
    path, rows = write_named(tmp_path, header, len(header.split(",")))
    assert run(["calibrate", str(path)]) == 2
    said = capsys.readouterr().err
    assert why in said
    known_as_else = any(
        word in header for word in ("mx", "mag", "gyr", "rad", "Lin", "Free")
    )
    assert ("if the names are wrong" in said.lower()) == known_as_else
    # the line that it proposes, or the first of them, is one that is understood
    line = re.search(r"--columns (\S+)", said).group(1).rstrip(",")
    assert len(line.split(",")) == rows.shape[1]
    assert read_log(path, columns=line, rate=100.0).accelerometer.shape == (30, 3)


def test_a_bare_axis_is_not_taken_from_another_sensors_file(tmp_path):
    assert read_log(write_named(tmp_path, "t,x,y,z", 4)[0]).columns[1].name == "x"
    for name in ("Gyroscope.csv", "Magnetometer.csv", "LinearAcceleration.csv"):
        with pytest.raises(InputError, match="which columns"):
            read_log(write_named(tmp_path, "t,x,y,z", 4, name)[0])


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
    with pytest.raises(InputError, match=r"reader crashed.*export it again"):
        read_log(path)


CLOCK_ROWS = 40
OFF = 1e-5  # of a limit: beyond the digits of a file, and of a changed constant


def log_of(tmp_path, time, header="t[s] ax ay az"):
    force = np.random.default_rng(1).standard_normal((len(time), 3))
    return written(tmp_path / "log.txt", header, time, force, mark=" ", form="{:.12g}")


def with_gap(step, gap):
    steps = np.full(CLOCK_ROWS, step)
    steps[CLOCK_ROWS // 2] = gap
    return np.cumsum(steps)


@pytest.mark.parametrize("gap", [GAP * (1 - OFF), GAP * (1 + OFF), 86400.0])
def test_a_hole_is_said_and_beyond_five_seconds_no_part_of_the_rate(tmp_path, gap):
    step = 0.01
    log = read_log(log_of(tmp_path, with_gap(step, gap)))
    assert len(log.time) == CLOCK_ROWS
    lost = round(gap / step) - 1
    assert f"; {lost} rows are missing, {gap:.3g} s of them at" in log.described()[-1]
    whole = gap <= GAP
    assert log.rate == pytest.approx((CLOCK_ROWS - 1) / np.ptp(log.time) if whole
                                     else 1.0 / step, rel=1e-9)  # fmt: skip
    assert [x.stop - x.start for x in log.parts()] == (
        [CLOCK_ROWS] if whole else [20, 20]
    )


def test_lost_rows_do_not_contradict_a_stated_rate(tmp_path):
    time = np.delete(0.01 * np.arange(CLOCK_ROWS), [3, 4, 9, 14, 15, 22, 30])
    assert read_log(log_of(tmp_path, time), rate=100.0).rate < 90.0


STEPS = np.arange(CLOCK_ROWS)
PLAIN, SECONDS = "t ax ay az", "t[s] ax ay az"
UNIT, SAYS = "what is its unit", "says 100 Hz"
CLOCKS = [  # header, times, stated rate, the rate that is read or what is said
    # a stated rate agrees within a tenth, and the clock's own is what counts
    *((SECONDS, 0.01 * STEPS, rate, 100.0)
      for rate in (100.0 / 1.1 * (1 + OFF), 100.0 / 0.9 * (1 - OFF))),
    *((SECONDS, 0.01 * STEPS, rate, SAYS)
      for rate in (100.0 / 1.1 * (1 - OFF), 100.0 / 0.9 * (1 + OFF))),
    # without a unit it is seconds at the rates of accelerometers
    *((PLAIN, STEPS / rate, None, rate) for rate in (7.0 * (1 + OFF), 5e4 * (1 - OFF))),
    *((PLAIN, STEPS / rate, None, UNIT) for rate in (7.0 * (1 - OFF), 5e4 * (1 + OFF))),
    # or milliseconds since 1970 at dates of this century
    *((PLAIN, 1e3 * start + 10.0 * STEPS, None, 100.0) for start in (1e9, 2.5e9 - 1.0)),
    *((PLAIN, 1e3 * start + 10.0 * STEPS, None, UNIT) for start in (1e9 - 1.0, 2.5e9)),
    # and a stated rate tells the tick: SI units, 0.1 ms of Xsens's SampleTimeFine
    *((PLAIN, STEPS / rate / tick, off * rate, rate if off < 1.1 else "time |a gap")
      for tick, rate in ((1, 50.0), (1e-3, 400.0), (1e-4, 100.0), (1e-6, 50.0),
                         (1e-9, 400.0))
      for off in (1.0, 1.09, 0.91, 1.12)),
]  # fmt: skip


@pytest.mark.parametrize(("header", "time", "rate", "found"), CLOCKS)
def test_the_limits_of_a_clock(tmp_path, header, time, rate, found):
    path = log_of(tmp_path, time, header)
    if isinstance(found, str):
        with pytest.raises(InputError, match=found):
            read_log(path, rate=rate)
    else:
        # a stated rate's digits are exact to 1e-12
        close = 1e-6 if rate is None else 1e-10
        assert read_log(path, rate=rate).rate == pytest.approx(found, rel=close)


def truth_file(tmp_path, q, time=None):
    time = 0.01 * np.arange(len(q)) if time is None else time
    return str(written(tmp_path / "truth.txt", "t[s],qw,qx,qy,qz", time, q))


@pytest.mark.parametrize(("side", "place"), [(1.0, 0), (-1.0, 59)])
def test_a_recorded_attitude_is_as_long_as_two_digits_round(tmp_path, side, place):
    q = Rotation.random(60, rng=5).as_quat()[:, [3, 0, 1, 2]]
    for length, good in ((0.01 - 1e-9, True), (0.01 + 1e-9, False)):
        given = q.copy()
        given[place] *= 1.0 + side * length
        path = truth_file(tmp_path, given)
        if good:
            found = read_truth(path).components
            np.testing.assert_allclose(found, q, rtol=0, atol=1e-15)
        else:
            with pytest.raises(InputError, match=r"1 such rows of 60\)"):
                read_truth(path)


def test_fifty_recorded_attitudes_are_enough_and_49_are_not(tmp_path):
    q = Rotation.random(60, rng=5).as_quat()[:, [3, 0, 1, 2]]
    for missing in (np.nan, 0.0):
        q[::6] = missing
        assert np.isnan(read_truth(truth_file(tmp_path, q)).components[::6]).all()
        given = q.copy()
        given[1] = missing
        with pytest.raises(InputError, match="49 of 60 rows have"):
            read_truth(truth_file(tmp_path, given))
