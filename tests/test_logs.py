"""Recorded logs: every layout that is promised, and every bad file by its message."""

import re

import numpy as np
import pytest
from places import recording
from written import written

from simval.errors import InputError
from simval.logs import read_log

ROWS = np.arange(70.0).reshape(10, 7) / 7.0
ROWS[:, 0] = 0.01 * np.arange(10)


def write(folder, rows, separator=" ", header=""):
    return written(folder / "log.txt", header.rstrip("\n"), rows, mark=separator)


@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ";"])
@pytest.mark.parametrize("header", ["", "# made by hand\n", "acc_x{0}acc_y{0}acc_z\n"])
def test_separators_and_headers_give_the_same_numbers(tmp_path, separator, header):
    path = write(tmp_path, ROWS[:, 1:4], separator, header.format(separator))
    log = read_log(path, rate=100.0)
    np.testing.assert_array_equal(log.accelerometer, ROWS[:, 1:4])  # repr is exact
    np.testing.assert_array_equal(log.time, np.arange(10) / 100.0)
    assert log.gyro is None


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
    given = read_log(write(tmp_path, wide), columns="-,az,ay,ax,t")
    header = "temperature,az [m/s^2],ay (m/s^2), Ax ,time\n"
    named = read_log(write(tmp_path, wide, ",", header))
    for log in (given, named):
        np.testing.assert_array_equal(log.accelerometer, ROWS[:, 1:4])
        np.testing.assert_array_equal(log.time, ROWS[:, 0])


def test_ignored_columns_may_hold_what_they_like(tmp_path):
    rows = ROWS[:, :5].copy()
    rows[3, 4] = np.nan
    log = read_log(write(tmp_path, rows), columns="t,ax,ay,az,-")
    np.testing.assert_array_equal(log.accelerometer, ROWS[:, 1:4])


def test_rows_within_counts_by_time(tmp_path):
    log = read_log(write(tmp_path, ROWS[:, :4]))
    assert log.rows_within(0.035) == 4
    with pytest.raises(InputError, match="`seconds`"):
        log.rows_within(float("nan"))


NUMBERS = [" ".join(f"{x:.3f}" for x in row) for row in ROWS[:, :4]]


def replaced(row, text):
    return "\n".join([*NUMBERS[:row], text, *NUMBERS[row + 1 :]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("\n  \n# only a remark\n", "is empty"),
        ("t ax ay az\n", "a header but no row"),
        (replaced(4, "0.04 1 nan 3"), "line 5: a value is not finite"),
        (replaced(4, "0.04 1 inf 3"), "line 5: a value is not finite"),
        (replaced(4, "0.04 1 two 3"), "line 5, column 3: 'two' is not a number"),
        ("# remark\n\n" + replaced(4, "0.04 1 two 3"), "line 7, column 3"),
        (replaced(4, "0.04 1 2"), "line 5: 3 columns, but the first row has 4"),
        (replaced(4, "0.04 1 2 3 4"), "line 5: 5 columns"),
        (replaced(4, "0.03 1 2 3"), "line 5: time 0.030000 s after 0.030000 s"),
        (replaced(4, "0.02 1 2 3"), "line 5: time 0.020000 s after 0.030000 s"),
        ("\n".join(NUMBERS[:5] + [f"9{n}" for n in NUMBERS[5:]]), "line 6: a gap of"),
        ("1 2 3\n4 5 6\n", "no time column and no rate"),
        ("1 2 3 4 5\n1 2 3 4 5\n", "has 5 columns"),
        ("1 2\n1 2\n", "has 2 columns"),
        ("0 1 2 3\n", "has one row"),
        ("1,2,3,\n1,2,3,\n", "line 1, column 4"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, content, message):
    path = tmp_path / "log.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_log(path)
    assert str(path) in str(caught.value)


def test_missing_folder_and_binary_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_log(tmp_path / "absent.txt")
    with pytest.raises(InputError, match="cannot read"):
        read_log(tmp_path)
    for content in (b"\x00\x01\x02" * 100, bytes(range(256))):
        (tmp_path / "log.bin").write_bytes(content)
        with pytest.raises(InputError, match="not a text file"):
            read_log(tmp_path / "log.bin")


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), "fast"])
def test_a_rate_must_be_a_positive_number(tmp_path, rate):
    with pytest.raises(InputError, match="`rate`"):
        read_log(write(tmp_path, ROWS[:, 1:4]), rate=rate)


@pytest.mark.parametrize(
    "columns", ["t,ax,ay", "t,ax,ay,ay", "t,ax,ay,up", "t,-,ay,az"]
)
def test_names_that_do_not_fit_are_refused(tmp_path, columns):
    with pytest.raises(InputError, match="`columns`"):
        read_log(write(tmp_path, ROWS[:, :4]), columns=columns)


def test_real_logs_read_whole():
    log = read_log(recording("xsens/xsens_acc.mat"))
    assert log.accelerometer.shape == (51175, 3)
    assert abs(log.rate - 100.0) < 0.1  # nominal 100 Hz, its clock is 1e-4 off
    np.testing.assert_array_equal(log.accelerometer[0], [33108.0, 33329.0, 36429.0])
    other = read_log(recording("mpu9150/imu0.log"), rate=100.0)
    np.testing.assert_array_equal(other.accelerometer[0], [-8.42090, 0.06710, 5.24511])
    assert other.gyro is not None
    np.testing.assert_array_equal(other.gyro[0], [0.03515, 0.00213, 0.04155])
