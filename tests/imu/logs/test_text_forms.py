"""Text, folders and archives, whole and spoilt: read with a word, asked, or refused."""

import re

import numpy as np
import pytest
from places import recording
from text_forms import (
    FORMS,
    NINE,
    archive,
    attitudes,
    axes,
    echo,
    euroc,
    phone,
    phyphox,
    saved,
    table,
    tum_vi,
)

from simval.errors import InputError
from simval.imu.logs import read_log
from simval.imu.logs.truth import quaternion_stems, read_truth
from simval.imu.recorded.alignment import prepared

N = 60
RNG = np.random.default_rng(37)
US = 10_000 * np.arange(N)
FORCE, GYRO, MAG = (RNG.normal(size=(N, 3)) * scale for scale in (1, 1, 40))
FORCE += [0.0, 0.0, 9.8]
SIX = np.column_stack([FORCE, GYRO]).tolist()
NAMES = ["ax", "ay", "az", "gx", "gy", "gz"]
MIDNIGHT = ("plotter", "monitor", "bare_monitor")
APPLE = ("sensorlog", "iphone")


@pytest.mark.parametrize("name", FORMS)
def test_each_form_gives_every_reading_to_the_bit(tmp_path, name):
    force = FORCE / 9.8 if name in APPLE else FORCE
    log = read_log(FORMS[name](tmp_path / "log", US, force, GYRO, MAG))
    np.testing.assert_array_equal(log.accelerometer, force)
    np.testing.assert_array_equal(log.gyro, GYRO)
    assert (log.magnetometer is not None) == (FORMS[name] in NINE)
    if log.magnetometer is not None:
        np.testing.assert_array_equal(log.magnetometer, MAG)
    # nanoseconds since 1970 are rounded to 256 in a double, of a step of 1e7
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-4)
    said = "\n".join(log.described())
    assert ("midnight, and the clock is continued" in said) == (name in MIDNIGHT)
    assert ("minus the specific force" in said) == (name in APPLE)
    assert ("Accelerometer.csv of Sensor Logger" in said) == (
        name in ("android", "iphone")
    )
    if name == "ulog2csv":
        np.testing.assert_array_equal(log.temperature, 31.5)


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
@pytest.mark.parametrize("form", [euroc, tum_vi])
def test_the_truth_of_a_data_set_is_read_from_its_folder(tmp_path, form, packed):
    path = form(tmp_path / "set", US, FORCE, GYRO, MAG)
    if packed:
        files = {
            each.relative_to(path).as_posix(): each.read_text()
            for each in path.rglob("*.*")
            if each.is_file()
        }
        path = archive(tmp_path / "set.zip", files)
    assert read_log(path).source[0] == ("instance", "imu0")
    assert quaternion_stems(str(path)) == ["q_RS_"]
    truth = read_truth(str(path), clock=US / 1e6)
    np.testing.assert_allclose(truth.components, attitudes(US), rtol=0, atol=1e-15)
    assert truth.own_clock
    assert truth.scalar == "first"
    assert truth.path.endswith("data.csv")
    np.testing.assert_allclose(np.diff(truth.time), 0.01, rtol=1e-4)


@pytest.mark.ci
def test_a_truth_since_1970_is_aligned_as_from_zero(tmp_path):
    """As the recording's own file: a clock of 1.7e9 s has steps of 0.2 us."""
    path = recording("broad/05_undisturbed_slow_rotation_with_breaks_B.mat")
    own = read_log(path, 2000.0 / 7.0)
    us = np.rint(1e6 * own.time).astype(int)
    q = read_truth(str(path), stem="opt_quat", clock=own.time).components
    folder = euroc(tmp_path / "set", us, own.accelerometer, own.gyro, None, q)
    log, truth = read_log(folder), read_truth(str(folder))
    found = prepared(log, truth, None, (None, None))[1]
    assert found.meaning.scalar == "first"
    # docs/filters_recorded.md: -2.40 +- 0.24 ms; 0.9981, 0.9979, 0.9990
    assert found.fit.offset == pytest.approx(-2.40e-3, abs=0.02e-3)
    assert found.fit.share < 2e-3


def test_several_imus_of_a_folder_are_asked_for_by_name(tmp_path):
    path = euroc(tmp_path / "set", US, FORCE, GYRO, MAG)
    (path / "mav0/imu1").mkdir()
    text = (path / "mav0/imu0/data.csv").read_text()
    (path / "mav0/imu1/data.csv").write_text(text)
    with pytest.raises(InputError, match=r"imu0, imu1; give --instance NAME"):
        read_log(path)
    taken = ("instance", "imu1, one of imu0, imu1")
    assert read_log(path, instance="imu1").source[0] == taken


MOTION = [f"{name}{a}" for name in ("rotationRate", "gravity", "acceleration")
          for a in "XYZ"]  # fmt: skip
FREE = {  # of a file without gravity: its name and header
    "phyphox": ("Linear Acceleration", ["Time (s)", *(f"{a} (m/s^2)" for a in "XYZ")]),
    "phyphox of iOS": ("Linear Accelerometer", ["t", "X (g)", "Y (g)", "Z (g)"]),
    "phyphox, one": ("Raw", ["t", *(f"Linear Acceleration {a} (g)" for a in "xyz")]),
    "Sensor Logger's gravity": ("Gravity", ["t", "x (g)", "y (g)", "z (g)"]),
    "user": ("userAcceleration", ["t", "ax", "ay", "az"]),
    "Sensor Logger's watch": ("WristMotion", ["time", *MOTION]),
}


@pytest.mark.parametrize("case", FREE.values(), ids=FREE)
def test_an_acceleration_without_gravity_is_never_taken(tmp_path, case):
    name, header = case
    parts = [US / 1e6, *[FORCE] * (len(header) // 3)]
    path = saved(tmp_path / f"{name}.csv", table(header, *parts))
    with pytest.raises(InputError, match="which columns are the accelerometer's"):
        read_log(path)


def part(values):
    return phone(US, axes(values))


NO_LOG = {  # files of an archive, and what is said
    "no table": ({"video.mp4": "x"}, "without a table of text"),
    "a spreadsheet": ({"[Content_Types].xml": "", "xl/a.xml": ""}, "spreadsheet"),
    "without gravity": (
        {"Accelerometer.csv": part(FORCE), "Gyroscope.csv": part(GYRO)},
        "Accelerometer.csv of Sensor Logger is without gravity"),
    "linear": ({"Linear Acceleration.csv": part(FORCE), "Gyroscope.csv": part(GYRO)},
               "has no accelerometer in a known form"),
    "a bomb": ({"Accelerometer.csv": "0,0,0\n" * 2_000_000}, "times its size"),
    "no rows": ({"Accelerometer.csv": "Time (s),X,Y,Z\n"}, "no row of numbers"),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_LOG.values(), ids=NO_LOG)
def test_what_holds_no_accelerometer_is_refused(tmp_path, case):
    files, words = case
    with pytest.raises(InputError, match=words):
        read_log(archive(tmp_path / "log.zip", files))


def test_an_archive_that_lies_or_is_locked_is_refused(tmp_path):
    path = phyphox(tmp_path / "log", US, FORCE, GYRO, MAG)
    good = path.read_bytes()
    first = good.index(b"PK\x01\x02")
    for place, value in ((8, 1), (10, 99)):  # a password; an unknown method
        bad = bytearray(good)
        bad[first + place] = value
        path.write_bytes(bytes(bad))
        with pytest.raises(InputError, match="cannot be unpacked"):
            read_log(path)
    path.write_bytes(good[: len(good) // 2])
    with pytest.raises(InputError, match="cannot be unpacked"):
        read_log(path)


PLAIN = [
    "t,ax,ay,az,wx,wy,wz",
    *(f"{k / 100:.2f}," + ",".join(map(str, row)) for k, row in enumerate(SIX)),
]


def lines(*picked, end="\n"):
    return "\n".join(picked) + end


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
    "the header again, and no more": (lines(*PLAIN, "Stopped", HEAD), ALL),
    "a row cut by a restart": (
        lines(*PLAIN[:30], PLAIN[30][:50], HEAD, *PLAIN[31:]),
        np.delete(np.arange(N), 29)),
    "a row twice": (lines(*PLAIN[:30], *PLAIN[29:]), ALL),
}  # fmt: skip


@pytest.mark.parametrize("case", MENDED.values(), ids=MENDED)
def test_what_is_mended_is_said(tmp_path, case):
    content, rows = case
    log = read_log(saved(tmp_path / "log.csv", content))
    np.testing.assert_array_equal(log.accelerometer, FORCE[rows])
    np.testing.assert_array_equal(log.gyro, GYRO[rows])
    assert {label for label, _ in log.source} == {"mended"}
    assert log.described()[0].startswith("mended            ")


COUNTERS = [("us", 1e-6, 32), ("ms", 1e-3, 32), ("ms", 1e-3, 16)]


@pytest.mark.parametrize(("unit", "tick", "bits"), COUNTERS)
def test_a_counter_of_few_bits_is_continued(tmp_path, unit, tick, bits):
    ticks = 2**bits - 200 + np.rint(0.01 * np.arange(N) / tick).astype(int)
    path = tmp_path / "log.csv"
    log = read_log(saved(path, table([f"time_{unit}", *NAMES], ticks % 2**bits, SIX)))
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-6)
    assert f"the counter of {bits} bits begins again" in log.described()[0]
    # set back to zero long before its end it did not begin again
    ticks = np.where(np.arange(N) < 30, ticks // 2, ticks - ticks[30])
    with pytest.raises(InputError, match="must increase"):
        read_log(saved(path, table([f"time_{unit}", *NAMES], ticks, SIX)))


PRINTED = {  # how numbers are written, and the scale of these
    "%.3f": ("{:.3f}".format, 9.8),
    "%g": ("{:g}".format, 9.8),
    "%g of small ones": ("{:g}".format, 2e-4),
    "all digits": (repr, 2e-4),
    "rounded": (lambda x: repr(round(x, 3)), 9.8),
    "exponents": ("{:.6e}".format, 9.8),
    "counts": ("{:.0f}".format, 16384.0),
}


@pytest.mark.parametrize("form", PRINTED)
def test_a_number_that_is_cut_is_never_read(tmp_path, form):
    """In whatever place; where all have as many decimals a whole one is not lost."""
    printed, scale = PRINTED[form]
    for seed in range(4):
        rows = scale * np.random.default_rng([5, seed]).normal(size=(50, 3))
        body = [
            ",".join([str(k), *map(printed, r)]) for k, r in enumerate(rows.tolist())
        ]
        text = lines("t [ms],ax,ay,az", *body, end="")
        last = printed(float(rows[-1, 2]))
        for cut in range(len(last)):
            path = saved(tmp_path / "log.csv", text[: len(text) - cut])
            force = read_log(path).accelerometer
            # of 17 digits one or two may be lost
            close = abs(force[-1, 2] - float(last)) < 1e-9 * scale
            assert len(force) == 49 or (len(force) == 50 and close)
            if cut == 0 and form in ("%.3f", "exponents"):
                assert len(force) == 50


def test_messages_that_ros2_lost_are_counted(tmp_path):
    """https://github.com/ros2/ros2cli, echo.py: printed among the rows."""
    said = ["A message was lost!!!", "\ttotal count change:1", "\ttotal count: 1---"]
    path = echo(tmp_path / "log", US, FORCE, GYRO, MAG)
    rows = path.read_text().splitlines()
    log = read_log(saved(path, lines(*rows[:9], *said, *rows[9:20], *said, *rows[20:])))
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    assert log.source == (("mended", "ros2 topic echo lost 2 messages"),)


LABELLED = [
    " ".join(f"{n}={v}" for n, v in zip(NAMES, row, strict=True)) for row in SIX
]
THREES = ["ax,ay,az", *["1,2,3"] * 30]
OTHER = [*LABELLED[:20], "ax:1,ay:2,az:3", *LABELLED[20:]]
YAML = "header:\n  stamp:\n    sec: 1\n    nanosec: 2\n  frame_id: imu\n---\n" * 9
AT_100 = {"rate": 100.0}
REFUSED = {  # what is spoilt so that no word mends it
    "the clock jumps back at a header": (lines(*PLAIN, *PLAIN), {}, "stands again"),
    "a header again, no clock": (lines(*THREES, *THREES), AT_100, "no clock says how"),
    "many rows above a header": (lines(*PLAIN[20:50], *PLAIN), {}, "split the file"),
    "a row cut in the middle": (
        lines(*PLAIN[:20], PLAIN[20][:60], *PLAIN[21:]), {}, "line 21"),
    "other labels": (lines(*OTHER), AT_100, "line 21"),
    "a counter of 16 bits": (
        table(["time_us", *NAMES], US % 2**16, SIX), {}, "must increase"),
    "one that begins again so soon that a pause is not seen": (
        table(["time_us", *NAMES], (65_000 + US // 100) % 2**16, SIX), {},
        "must increase"),
    "a field lost before a separator": (
        lines(*[f"{each}," for each in PLAIN[:20]], f"{PLAIN[20].partition(',')[2]},,",
              *[f"{each}," for each in PLAIN[21:]])[:-1].replace(",,", ","), {},
        "line 21 has 7 columns, but the rows from line 2 on have 8"),
    "YAML of ros2 topic echo": (YAML, {}, "with --csv"),
    "UTF-16 without its mark": ("\0".join(lines(*PLAIN)), {}, "not a text file"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_mended_is_refused(tmp_path, case):
    content, how, words = case
    path = saved(tmp_path / "log.csv", content)
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
    path = saved(tmp_path / "log.csv", table(header, rows))
    options = f"--instance {names[4]} or --instance {names[5]}"
    with pytest.raises(InputError, match=options):
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
    path = saved(tmp_path / "log.csv", table(header, rows))
    assert read_log(path, instance="imu1").gyro is not None
    log = read_log(path, instance="imu0")
    assert log.gyro is None
    assert "are not surely those beside the accelerometer" in log.unclear[0].words
