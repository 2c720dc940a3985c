"""Text as loggers and terminals write it, spoilt and whole: read with a word, or asked.

Each form is written by the program's own layout, of which the source stands beside it.
"""

import csv
import io
import json
import re

import numpy as np
import pytest

from simval.errors import InputError
from simval.imu.logs import read_log

N = 60
RNG = np.random.default_rng(37)
NS = 1_700_000_000_987_000_000 + 10_000_000 * np.arange(N)  # crosses a whole second
FORCE, GYRO = RNG.normal(size=(N, 3)) * 9, RNG.normal(size=(N, 3))
MAG = RNG.normal(size=(N, 3)) * 40
SIX = [[*f, *w] for f, w in zip(FORCE.tolist(), GYRO.tolist(), strict=True)]


def table(header, rows, **how):
    out = io.StringIO()
    csv.writer(out, lineterminator="\n", **how).writerows(
        [*([header] if header else []), *rows]
    )
    return out.getvalue()


def echo():
    # ros2cli, ros2topic/verb/echo.py, and rosidl_runtime_py/convert.py, message_to_csv:
    # https://github.com/ros2/rosidl_runtime_py/blob/rolling/rosidl_runtime_py/convert.py
    return "".join(
        ",".join(map(str, [t // 10**9, t % 10**9, "imu_link", 0.0, 0.0, 0.0, 1.0,
                           *[0.0] * 9, *row[3:], *[0.0] * 9, *row[:3], *[0.0] * 9]))
        + "\n" for t, row in zip(NS.tolist(), SIX, strict=True)
    )  # fmt: skip


def rostopic():
    # ros_comm, rostopic/__init__.py, CallbackEcho with field_filter and -p:
    # https://wiki.ros.org/rostopic#rostopic_echo
    header = ["%time", "field.header.seq", "field.header.stamp",
              "field.header.frame_id", *(f"field.orientation.{a}" for a in "xyzw"),
              *(f"field.angular_velocity.{a}" for a in "xyz"),
              *(f"field.linear_acceleration.{a}" for a in "xyz"),
              *(f"field.linear_acceleration_covariance{k}" for k in range(9)),
              ]  # fmt: skip
    return table(header, [
        [t, k, t - 100, "imu", 0.0, 0.0, 0.0, 1.0, *row[3:], *row[:3], *[0.0] * 9]
        for k, (t, row) in enumerate(zip(NS.tolist(), SIX, strict=True))
    ])  # fmt: skip


def ulog():
    # pyulog, ulog2csv.py: https://github.com/PX4/pyulog/blob/main/pyulog/ulog2csv.py
    header = ["timestamp", *(f"gyro_rad[{k}]" for k in range(3)), "gyro_integral_dt",
              "accelerometer_timestamp_relative",
              *(f"accelerometer_m_s2[{k}]" for k in range(3))]  # fmt: skip
    start = 180_000_000
    return table(header, [
        [start + 10_000 * k, *row[3:], 10_000, 0, *row[:3]]
        for k, row in enumerate(SIX)
    ])  # fmt: skip


NAMES = ["ax", "ay", "az", "gx", "gy", "gz"]


def arrow(line, k, start=86399.7):
    # Arduino IDE, serial monitor with "Toggle Timestamp":
    # https://docs.arduino.cc/software/ide-v2/tutorials/ide-v2-serial-monitor/
    ms = round(1000 * start) + 10 * k
    day = ms % 86_400_000
    clock = (
        f"{day // 3_600_000:02d}:{day // 60_000 % 60:02d}:{day % 60_000 / 1000:06.3f}"
    )
    return f"{clock} -> {line}\n"


def labelled(mark=",", between=":"):
    # https://docs.arduino.cc/software/ide-v2/tutorials/ide-v2-serial-plotter/
    return [
        mark.join(f"{n}{between}{v}" for n, v in zip(NAMES, row, strict=True))
        for row in SIX
    ]


def plotter():
    return "".join(arrow(line, k) for k, line in enumerate(labelled()))


def monitor():
    lines = [
        "MPU6050 found",
        ",".join(NAMES),
        *(",".join(map(str, row)) for row in SIX),
    ]
    return "".join(arrow(line, k) for k, line in enumerate(lines))


def bare_monitor():
    return "".join(arrow("\t".join(map(str, row)), k) for k, row in enumerate(SIX))


def objects():
    rows = [
        dict(zip(["ms", *NAMES], [10 * k, *row], strict=True))
        for k, row in enumerate(SIX)
    ]
    return "".join(json.dumps(row) + "\n" for row in rows)


def sensorlog():
    # http://sensorlog.berndthomas.net and its example files
    header = ["loggingTime(txt)", "loggingSample(N)", "locationTimestamp_since1970(s)",
              "accelerometerTimestamp_sinceReboot(s)",
              *(f"accelerometerAcceleration{a}(G)" for a in "XYZ"),
              "gyroTimestamp_sinceReboot(s)",
              *(f"gyroRotation{a}(rad/s)" for a in "XYZ"),
              *(f"motionUserAcceleration{a}(G)" for a in "XYZ"),
              *(f"motionRotationRate{a}(rad/s)" for a in "XYZ"),
              *(f"magnetometer{a}(µT)" for a in "XYZ")]  # fmt: skip
    return table(header, [
        [f"2026-11-23 10:00:00.{k:03d} +0100", k, 1.7e9, 5000 + k / 100, *row[:3],
         5000 + k / 100, *row[3:], 0.0, 0.0, 0.0, 9.0, 9.0, 9.0, *MAG[k].tolist()]
        for k, row in enumerate(SIX)
    ])  # fmt: skip


FORMS = [echo, rostopic, ulog, plotter, monitor, bare_monitor, objects, sensorlog]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_each_form_gives_every_reading_to_the_bit(tmp_path, form):
    path = tmp_path / "log.csv"
    path.write_text(form(), encoding="utf-8")
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    np.testing.assert_array_equal(log.gyro, GYRO)
    # nanoseconds since 1970 are rounded to 256 in a double, of a step of 1e7
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-4)
    assert ("is continued" in "".join(log.described())) == (
        form in (plotter, monitor, bare_monitor)
    )
    if form is sensorlog:
        np.testing.assert_array_equal(log.magnetometer, MAG)


PLAIN = [
    "t,ax,ay,az,wx,wy,wz",
    *(f"{k / 100:.2f}," + ",".join(map(str, row)) for k, row in enumerate(SIX)),
]


def lines(*picked, end="\n"):
    return "\n".join(picked) + end


def echo_with_losses():
    said = ["A message was lost!!!", "\ttotal count change:1", "\ttotal count: 1---"]
    rows = echo().splitlines()
    return lines(*rows[:9], *said, *rows[9:])


ALL = slice(0, N)
HEAD, *BODY = PLAIN
MENDED = {  # what is spoilt, and the rows that are read
    "nul at the end": (lines(*PLAIN) + "\0" * 5000, ALL),
    "a row cut by nul": (lines(*PLAIN)[:-3] + "\0" * 512, slice(0, N - 1)),
    "nul between rows": (lines(*PLAIN[:30]) + "\0" * 99 + lines(*PLAIN[30:]), ALL),
    "a cut last line": (lines(*PLAIN, end="")[:-40], slice(0, N - 1)),
    "a cut last field": (lines(*PLAIN, end="")[:-13], slice(0, N - 1)),
    "a last word": (lines(*PLAIN, "Stopped"), ALL),
    "a cut first line": (lines(PLAIN[5][9:], *PLAIN), ALL),
    "rows above the header": (lines(*PLAIN[20:23], *PLAIN), ALL),
    "the header again": (lines(*PLAIN[:30], HEAD, *PLAIN[30:]), ALL),
    "a remark is the header again": (
        lines(f"#{HEAD}", *BODY[:30], f"#{HEAD}", *BODY[30:]), ALL),
    "a row cut by a restart": (
        lines(*PLAIN[:30], PLAIN[30][:50], HEAD, *PLAIN[31:]),
        np.delete(np.arange(N), 29)),
    "a row twice": (lines(*PLAIN[:30], *PLAIN[29:]), ALL),
    "messages lost": (echo_with_losses(), ALL),
}  # fmt: skip


@pytest.mark.parametrize("case", MENDED.values(), ids=MENDED)
def test_what_is_mended_is_said(tmp_path, case, simval):
    content, rows = case
    path = tmp_path / "log.csv"
    path.write_text(content)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, FORCE[rows])
    np.testing.assert_array_equal(log.gyro, GYRO[rows])
    assert {label for label, _ in log.source} == {"mended"}
    assert log.described()[0].startswith("mended            ")


@pytest.mark.parametrize("bits", [1e-6, 1e-3])
def test_a_counter_of_32_bits_is_continued(tmp_path, bits):
    unit = "us" if bits == 1e-6 else "ms"
    ticks = (2**32 - 200 + np.rint(0.01 * np.arange(N) / bits).astype(int)) % 2**32
    path = tmp_path / "log.csv"
    path.write_text(
        table(
            [f"time_{unit}", *NAMES],
            [[t, *row] for t, row in zip(ticks, SIX, strict=True)],
        )
    )
    log = read_log(path)
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-6)
    assert "begins again" in log.described()[0]


THREES = ["ax,ay,az", *["1,2,3"] * 30]
OTHER = [*labelled()[:20], "ax:1,ay:2,az:3", *labelled()[20:]]
SHORT = [[(10_000 * k) % 2**16, *row] for k, row in enumerate(SIX)]
AT_100 = {"rate": 100.0}
REFUSED = {  # what is spoilt so that no word mends it
    "the clock jumps back at a header": (lines(*PLAIN, *PLAIN), {}, "again above it"),
    "a header again, no clock": (lines(*THREES, *THREES), AT_100, "no clock says how"),
    "many rows above a header": (lines(*PLAIN[20:50], *PLAIN), {}, "split the file"),
    "a row cut in the middle": (
        lines(*PLAIN[:20], PLAIN[20][:60], *PLAIN[21:]), {}, "line 21"),
    "other labels": (lines(*OTHER), AT_100, "line 21"),
    "a counter of 16 bits": (table(["time_us", *NAMES], SHORT), {}, "must increase"),
    "UTF-16 without its mark": ("\0".join(lines(*PLAIN)), {}, "not a text file"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_mended_is_refused(tmp_path, case):
    content, how, words = case
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=re.escape(words)):
        read_log(path, **how)


PAIRS = [  # names of two instances, and the word of each
    ("acc1_{}", "acc2_{}", "gyro1_{}", "gyro2_{}", "1", "2"),
    ("imu0_a{}", "imu1_a{}", "imu0_g{}", "imu1_g{}", "imu0", "imu1"),
    ("left_acc_{}", "right_acc_{}", "left_gyro_{}", "right_gyro_{}", "left", "right"),
    ("imu0.linear_acceleration.{}", "imu1.linear_acceleration.{}",
     "imu0.angular_velocity.{}", "imu1.angular_velocity.{}", "imu0", "imu1"),
]  # fmt: skip


@pytest.mark.parametrize("names", PAIRS, ids=[names[0] for names in PAIRS])
def test_one_of_two_sensors_is_asked_for_by_name(tmp_path, names):
    header = ["t", *(name.format(axis) for name in names[:4] for axis in "xyz")]
    rows = np.column_stack([0.01 * np.arange(N), FORCE, 2 * FORCE, GYRO, 2 * GYRO])
    path = tmp_path / "log.csv"
    path.write_text(table(header, rows.tolist()))
    with pytest.raises(
        InputError, match=f"--instance {names[4]} or --instance {names[5]}"
    ):
        read_log(path)
    with pytest.raises(InputError, match="no accelerometer 'up' is in its header"):
        read_log(path, instance="up")
    for scale, word in enumerate(names[4:], start=1):
        log = read_log(path, instance=word)
        np.testing.assert_array_equal(log.accelerometer, scale * FORCE)
        np.testing.assert_array_equal(log.gyro, scale * GYRO)


def test_a_gyroscope_of_another_sensor_is_not_taken(tmp_path):
    header = [
        "t",
        *(f"{n}_{a}" for n in ("imu0_acc", "imu1_acc", "imu1_gyro") for a in "xyz"),
    ]
    rows = np.column_stack([0.01 * np.arange(N), FORCE, 2 * FORCE, GYRO])
    path = tmp_path / "log.csv"
    path.write_text(table(header, rows.tolist()))
    assert read_log(path, instance="imu1").gyro is not None
    log = read_log(path, instance="imu0")
    assert log.gyro is None
    assert "1 gyroscope is named and none is taken" in log.unclear[0]
