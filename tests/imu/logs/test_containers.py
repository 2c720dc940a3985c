"""Every container of a log: what was written, what is damaged, what is asked."""

import json
import os
import re
import shutil
import sqlite3
import struct
import tracemalloc
import zipfile
from contextlib import closing

import numpy as np
import pytest
from containers import CHECKED, SINGLE, WRITERS, ros, ulog_of
from places import ROOT
from places import recording as recording_of
from rosbags.rosbag2 import StoragePlugin
from text_forms import FORMS

from simval.errors import InputError
from simval.imu.logs import read_log

ROWS = 240


def recording(name, seed=0, rows=ROWS):
    """Times in microseconds and nine axes, all of them different numbers."""
    rng = np.random.default_rng([37, seed])
    us = np.arange(rows) * 10_000 + rng.integers(0, 2000, rows)
    us -= us[0]
    axes = rng.normal(size=(3, rows, 3))
    axes[0, :, 2] += 9.8
    if name in SINGLE:
        axes = axes.astype(np.float32).astype(float)
    return us, *axes


def made(folder, name, *log):
    """Path of a container in a folder of its own."""
    folder.mkdir()
    return (WRITERS | FORMS)[name](folder / "log", *log)


@pytest.mark.ci
@pytest.mark.parametrize("name", WRITERS)
def test_what_was_written_is_read_to_the_bit(name, tmp_path):
    us, force, rate, field = recording(name)
    log = read_log(made(tmp_path / name, name, us, force, rate, field))
    np.testing.assert_array_equal(log.accelerometer, force)
    np.testing.assert_array_equal(log.gyro, rate)
    np.testing.assert_array_equal(log.magnetometer, field)
    np.testing.assert_array_equal(log.time, us / 1e6)


@pytest.mark.ci
@pytest.mark.parametrize("name", WRITERS)
def test_a_part_and_a_hole_are_the_same_in_every_container(name, tmp_path):
    """No advice to split a file that cannot be split: two options read its parts."""
    us, *axes = recording(name)
    us = us + 60_000_000 * (np.arange(ROWS) >= ROWS // 2)
    path = made(tmp_path / name, name, us, *axes)
    log = read_log(path)
    assert "60 s of them at once" in " ".join(log.described())
    assert log.rate == pytest.approx(100.0, rel=0.05)
    halves = slice(0, ROWS // 2), slice(ROWS // 2, ROWS)
    assert log.parts() == [*halves]
    start, stop = log.time[ROWS // 2], log.time[ROWS // 2 - 1]
    for rows, how in zip(halves, ({"stop": stop}, {"start": start}), strict=True):
        part = read_log(path, **how)
        np.testing.assert_array_equal(part.time, log.time[rows])
        for own, every in zip(
            (part.accelerometer, part.gyro, part.magnetometer), axes, strict=True
        ):
            np.testing.assert_array_equal(own, every[rows])


def test_the_table_of_formats_has_every_container():
    lines = (ROOT / "docs" / "howto" / "logs.md").read_text().splitlines()
    cells = [line.split("|")[3] for line in lines if line.count("|") == 5]
    assert set(re.findall(r"`(\w+)`", " ".join(cells))) == set(WRITERS)
    rows = lines[lines.index("| program | what is odd in it | writer |") :]
    last = " ".join(line.split("|")[3] for line in rows[2 : rows.index("")])
    assert set(re.findall(r"`(\w+)`", last)) == set(FORMS)


def test_what_stands_in_a_folder_is_looked_at_before_it_is_read(tmp_path):
    path = made(tmp_path / "log", "ros2_folder", *recording("ros2_folder"))
    with pytest.raises(InputError, match=r"log\.db3.*compressed; give the folder"):
        read_log(next(path.glob("*.db3")))
    (path / "metadata.yaml").unlink()
    os.mkfifo(path / "metadata.yaml")
    with pytest.raises(InputError, match="it is a pipe"):
        read_log(path)


def truncated(content, rng):
    return content[: int(rng.integers(len(content)))]


def flipped(content, rng):
    damaged = bytearray(content)
    for at in rng.integers(0, len(content), int(rng.integers(1, 8))):
        damaged[at] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


def zeroed(content, rng):
    size = int(10 ** rng.uniform(0, 3.5))
    at = int(rng.integers(len(content)))
    return content[:at] + bytes(len(content[at : at + size])) + content[at + size :]


def read_or_refused(path):
    """The log, or None where it is refused in words that name it."""
    try:
        return read_log(path)
    except InputError as error:
        words = str(error)
    assert str(path) in words
    assert 20 < len(words) - len(str(path)) < 1200
    return None


def removed(content, rng):
    at, size = int(rng.integers(len(content))), int(10 ** rng.uniform(0, 3.5))
    return content[:at] + content[at + size :]


FAMILIES = (truncated, flipped, zeroed, removed)
STATED = {"ros1", "ros2_folder", "ros2_db3", "mcap", "mcap_zstd"}
"""Formats that state how many messages they have."""


def files_of(path):
    return [each for each in path.rglob("*") if each.is_file()] or [path]


def assert_rounded(rows, true):
    """Each row is a true one, but for the last two of 17 digits where a text ends."""
    for row in rows:
        assert np.min(np.max(np.abs(true - row), axis=1)) < 1e-12


@pytest.mark.ci
@pytest.mark.parametrize("name", [*WRITERS, *FORMS])
@pytest.mark.parametrize("trials", [6, pytest.param(90, marks=pytest.mark.slow)])
def test_damage_is_refused_or_leaves_rows_that_were_written(name, trials, tmp_path):
    """A file that was cut off gives none but true rows, and so does a checksum.

    Without one a byte that is changed within a number cannot be seen by anybody: then
    the rows are at most as many, finite, and in the order of time.
    """
    us, force, rate, field = recording(name)
    good = made(tmp_path / "good", name, us, force, rate, field)
    true = {row.tobytes() for row in np.hstack([force, rate])}
    rng = np.random.default_rng([trials, len(name)])
    seen = 0
    for k in range(trials):
        family = FAMILIES[k % len(FAMILIES)]
        shutil.rmtree(tmp_path / "bad", ignore_errors=True)
        shutil.copytree(tmp_path / "good", tmp_path / "bad")
        bad = tmp_path / "bad" / good.relative_to(tmp_path / "good")
        file = files_of(bad)[int(rng.integers(len(files_of(bad))))]
        content = file.read_bytes()
        file.write_bytes(family(content, rng))
        log = read_or_refused(bad)
        seen += log is None or not np.array_equal(log.accelerometer, force)
        if log is None:
            continue
        assert len(log.time) <= ROWS
        labels = {label for label, _ in log.source}
        assert len(log.time) == ROWS or name not in STATED or "damaged" in labels
        assert np.all(np.diff(log.time) > 0.0)
        assert np.isfinite(log.accelerometer).all()
        if (family is truncated or name in CHECKED) and log.gyro is not None:
            if name in FORMS:
                assert_rounded(log.accelerometer, force)
                assert_rounded(log.gyro, rate)
                continue
            rows = np.hstack([log.accelerometer, log.gyro])
            assert {row.tobytes() for row in rows} <= true
    assert seen > trials / 10 or name in FORMS  # of a folder it may be a file unread


def deleted(file):
    """Nine messages of a SQLite file, as a repair of it leaves them out."""
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("DELETE FROM messages WHERE id BETWEEN 101 AND 109")


def blanked(file):
    """Nine records of an MCAP file, whose bytes are as many empty records."""
    content, at, found = file.read_bytes(), 8, []
    while content[at] != 0x02:
        size = 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        size = 49 if content[at] == 0x06 else size  # into a chunk
        found += [(at, at + size)] * (content[at] == 0x05)
        at += size
    start, stop = found[100][0], found[108][1]
    file.write_bytes(content[:start] + bytes(stop - start) + content[stop:])


def overstated(file):
    """The count of a ROS 1 bag's summary, nine more than there are."""
    head, _, tail = file.read_bytes().rpartition(struct.pack("<I", ROWS - 9))
    file.write_bytes(head + struct.pack("<I", ROWS) + tail)


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        *(("ros2_db3", deleted), ("ros2_folder", deleted)),
        *(("mcap", blanked), ("ros1", overstated)),
    ],
)
def test_a_bag_says_how_many_messages_it_lacks(name, damage, tmp_path):
    rows = ROWS - 9 if damage is overstated else ROWS
    path = made(tmp_path / "log", name, *recording(name, rows=rows)[:3])
    said = ("damaged", f"/imu/data: it states {ROWS} messages and has {ROWS - 9}")
    assert said not in read_log(path).source
    damage(next(each for each in files_of(path) if each.suffix != ".yaml"))
    log = read_log(path)
    assert (len(log.time), said in log.source) == (ROWS - 9, True)


def test_a_bag_in_several_files_is_not_held_against_the_whole(tmp_path):
    path = made(tmp_path / "log", "ros2_db3", *recording("ros2_db3")[:3])
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "UPDATE metadata SET metadata = "
            "replace(metadata, '- log.db3', '- log_0.db3\n- log.db3')"
        )
    deleted(path)
    assert "damaged" not in {label for label, _ in read_log(path).source}


@pytest.mark.parametrize("stated", [0, 1000, 2**30])
def test_a_directory_that_lies_about_sizes_takes_no_memory(stated, tmp_path):
    """32 MB of rows in 50 kB, whose size by the directory is another."""
    path = tmp_path / "log.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Accelerometer.csv", b"0,0,9.8\n" * 2**22)
    content = bytearray(path.read_bytes())
    for start, at in ((b"PK\1\2", 24), (b"PK\3\4", 22)):
        place = content.rfind(start) + at
        content[place : place + 4] = struct.pack("<I", stated)
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="unpack"):
            read_log(path, rate=100.0)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


OF_THE_FILE = ("source", "columns", "units", "sha256")


def calibration(simval, path):
    """What `simval calibrate` says of a log, but for how it was read."""
    code, out, err = simval("calibrate", path, "--json")
    assert code == 0, err
    said = json.loads(out)
    # a container that states a unit is held to it
    said["warnings"] = [x for x in said["warnings"] if x["about"] != "unit"]
    return {key: said[key] for key in said if key not in OF_THE_FILE}


def readings(simval, path):
    """Of a log that has too few rests for a calibration: its rows."""
    log = read_log(path)
    return [x.tobytes() for x in (log.time, log.accelerometer, log.gyro)] + [
        log.magnetometer.tobytes()
    ]


BINARY = ["dataflash", "mcap_zstd", "npz", "ros1", "ulog"]
BROAD = "broad/05_undisturbed_slow_rotation_with_breaks_B.mat"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("files", "rate", "containers", "answer"),
    [
        (["mpu9150/imu0.log"], 100.0, BINARY, calibration),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (["mpu9150/imu0.log"], 100.0, sorted(WRITERS), calibration),
                (["xsens/xsens_acc.mat", "xsens/xsens_gyro.mat"], None, BINARY,
                 calibration),
                ([BROAD], None, [*BINARY, "matlab", "parquet"], readings),
            )
        ),
    ],
)  # fmt: skip
def test_a_recording_gives_the_same_from_every_container(
    files, rate, containers, answer, tmp_path, simval
):
    """The same numbers and stamps, so the same bits; in single precision of a format
    that has no other."""
    columns = {"xsens/xsens_gyro.mat": "t,ax,ay,az"}  # else its name objects
    log, *others = (
        read_log(recording_of(file), rate=rate, columns=columns.get(file))
        for file in files
    )
    us = np.rint((log.time - log.time[0]) * 1e6).astype(np.int64)
    sensors = [log.accelerometer, log.gyro, *(each.accelerometer for each in others)]
    sensors = [each for each in (*sensors, log.magnetometer) if each is not None]
    single = [each.astype(np.float32).astype(float) for each in sensors]
    expected = {}
    for name, values in ((False, sensors), (True, single)):
        path = made(tmp_path / f"csv{name}", "csv", us, *values)
        expected[name] = answer(simval, path)
    # a bit of a reading is seen; counts are the same in single precision
    same = all(map(np.array_equal, sensors, single))
    assert (expected[True] == expected[False]) == same
    for name in containers:
        values = single if name in SINGLE else sensors
        path = made(tmp_path / name, name, us, *values)
        assert answer(simval, path) == expected[name in SINGLE], name


def test_one_of_two_sensors_is_taken_by_its_name(tmp_path, simval):
    log = recording("dataflash_text")
    path = made(tmp_path / "two", "dataflash_text", *log)
    lines = path.read_text().splitlines()
    fields = [line.split(", ") for line in lines if line.startswith("IMU")]
    second = [", ".join([*each[:2], "1", *each[3:]]) for each in fields]
    path.write_text("\n".join([*lines, *second, ""]))
    with pytest.raises(InputError, match="holds 2 sensors: IMU 0, IMU 1; give --inst"):
        read_log(path)
    with pytest.raises(InputError, match="none is called 'IMU 2'"):
        read_log(path, instance="IMU 2")
    for name in ("IMU 0", "IMU 1"):
        one = read_log(path, instance=name)
        np.testing.assert_array_equal(one.accelerometer, log[1])
        assert one.described()[0] == f"instance          {name}, one of IMU 0, IMU 1"


def test_a_flight_log_of_px4_is_read_by_its_one_quick_sensor(tmp_path):
    """What PX4 writes by default: drivers once a second, the corrected ones quickly."""
    us, force, rate, field = recording("ulog")
    three = dict(zip("xyz", np.ones((3, 3)), strict=True))
    form = "uint64_t timestamp;float x;float y;float z;"
    combined = {"timestamp": us + 1, "accelerometer_timestamp_relative": 0 * us}
    combined["accelerometer_timestamp_relative"][7] = 2**31 - 1  # no measurement
    magnetic = {"timestamp": us[::5] + 1}
    for k in range(3):
        combined[f"gyro_rad[{k}]"] = rate[:, k]
        combined[f"accelerometer_m_s2[{k}]"] = force[:, k]
        magnetic[f"magnetometer_ga[{k}]"] = field[::5, k]
    whole = (
        "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
        "int32_t accelerometer_timestamp_relative;"
    )
    seconds = {"timestamp": np.arange(3) * 1_000_000} | three
    messages = {
        ("sensor_accel", 0): (form, seconds),
        ("sensor_accel", 1): (form, seconds),
        ("sensor_combined", 0): (whole, combined),
        ("vehicle_magnetometer", 0): (
            "uint64_t timestamp;float[3] magnetometer_ga;",
            magnetic,
        ),
    }
    log = read_log(ulog_of(tmp_path / "log", messages))
    assert log.source[0] == ("instance", "sensor_combined")
    assert "corrected by the autopilot" in dict(log.source)["readings"]
    there = np.arange(ROWS) != 7
    np.testing.assert_array_equal(log.accelerometer, force[there])
    np.testing.assert_array_equal(log.gyro, rate[there])
    nearest = np.abs(us[::5] - us[there, None]).argmin(axis=1)
    np.testing.assert_array_equal(log.magnetometer, field[::5][nearest])
    # increments over a time that varies are read where nothing else is
    dt = np.float32(4000 + us % 100)
    increments = {
        "timestamp": us + 1,
        "delta_angle_dt": dt,
        "delta_velocity_dt": 2 * dt,
    }
    for k in range(3):
        increments[f"delta_angle[{k}]"] = rate[:, k] * dt / 1e6
        increments[f"delta_velocity[{k}]"] = force[:, k] * 2 * dt / 1e6
    form = (
        "uint64_t timestamp;float[3] delta_angle;float[3] delta_velocity;"
        "float delta_angle_dt;float delta_velocity_dt;"
    )
    messages["vehicle_imu", 0] = (form, increments)
    again = read_log(ulog_of(tmp_path / "log", messages))
    np.testing.assert_array_equal(again.accelerometer, log.accelerometer)
    assert any("vehicle_imu, increments of what" in words for _, words in again.source)
    del messages["sensor_combined", 0]
    log = read_log(ulog_of(tmp_path / "log", messages))
    assert log.source[0] == ("instance", "vehicle_imu 0")
    assert "increments over their time, corrected" in dict(log.source)["readings"]
    # a product and a quotient in single precision
    np.testing.assert_allclose(log.accelerometer, force, rtol=2e-7, atol=0)
    np.testing.assert_allclose(log.gyro, rate, rtol=2e-7, atol=0)
    assert log.magnetometer is not None


def test_a_bag_without_stamps_is_read_by_the_times_of_receipt(tmp_path):
    us, *sensors = recording("ros1")
    log = read_log(ros(tmp_path / "log", us, *sensors, stamped=False))
    np.testing.assert_array_equal(log.time, us / 1e6)
    assert "times of receipt" in dict(log.source)["readings"]


@pytest.mark.parametrize("plugin", [None, *StoragePlugin])
def test_a_bags_times_are_the_headers_and_not_those_of_receipt(plugin, tmp_path):
    """Messages come up to 7 ms late, in their order, and the readings keep theirs."""
    us, *sensors = recording("ros1", rows=40)
    late = np.random.default_rng(38).integers(1, 7_000_000, 40).tolist()
    log = read_log(ros(tmp_path / "log", us, *sensors, plugin=plugin, late=late))
    np.testing.assert_array_equal(log.time, us / 1e6)
    np.testing.assert_array_equal(log.accelerometer, sensors[0])
    np.testing.assert_array_equal(log.magnetometer, sensors[2])
    assert "stamps of the headers" in dict(log.source)["readings"]


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_bag_of_either_byte_order_and_any_frames_name_is_read(order, tmp_path):
    """The doubles stand at multiples of eight behind names of each length."""
    us, *sensors = recording("ros2_db3", rows=40)
    frames = ["imu_links"[:k] for k in range(10)]
    options = {"plugin": StoragePlugin.SQLITE3, "order": order, "frames": frames}
    path = ros(tmp_path / "log", us, *sensors, **options)
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as database:
        starts = {row[:4] for (row,) in database.execute("SELECT data FROM messages")}
    assert starts == {b"\0\1\0\0" if order == "little" else bytes(4)}  # of CDR
    log = read_log(path)
    read = log.time, log.accelerometer, log.gyro, log.magnetometer
    for own, written in zip(read, (us / 1e6, *sensors), strict=True):
        np.testing.assert_array_equal(own, written)


def test_old_names_of_ardupilots_sensors(tmp_path):
    rows = [
        "FMT, 1, 35, IMU2, Qffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 2, 35, ACC1, QQfff, TimeUS,SampleUS,AccX,AccY,AccZ",
        "FMT, 3, 35, GYR1, QQfff, TimeUS,SampleUS,GyrX,GyrY,GyrZ",
        "IMU3",  # cut off, and no FMT says what it is
    ]
    for k in range(40):
        rows.append(f"IMU2, {10 * k}, 1, 2, 3, 4, 5, {k}")
        rows.append(f"ACC1, 0, {1000 * k}, 1, 2, {k}")
        rows.append(f"GYR1, 0, {1000 * k}, 4, 5, {-k}")
    path = tmp_path / "old.log"
    path.write_text("\n".join(["FMT, 128, 89, FMT, BBnNZ, Type", *rows, ""]))
    for name, hertz in (("IMU2", 100.0), ("ACC1", 1000.0)):
        log = read_log(path, instance=name)
        np.testing.assert_array_equal(log.accelerometer[:, 2], np.arange(40))
        assert log.gyro is not None
        assert log.rate == pytest.approx(hertz, rel=1e-12)


@pytest.mark.ci
def test_a_rate_in_the_file_is_the_clock_where_there_is_none(tmp_path):
    _, force, rate, _ = recording("npz")
    for name, there in (("sampling_rate", True), ("Fs", True), ("rates", False)):
        path = tmp_path / f"{name}.npz"
        np.savez(path, acc=force, gyro=rate, **{name: 50.0})
        if not there:
            with pytest.raises(InputError, match="no time column and no rate"):
                read_log(path)
            continue
        log = read_log(path)
        assert log.rate == 50.0
        assert ("rate", f"50 Hz, by {name!r} in the file") in log.source
        assert read_log(path, rate=100.0).rate == 100.0


def test_an_array_that_would_take_all_memory_is_refused(tmp_path):
    """A terabyte, by the header of a file of a hundred bytes."""
    form = {"descr": "<f8", "fortran_order": False, "shape": (10**11, 3)}
    path = tmp_path / "log.npy"
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, form)
    with pytest.raises(InputError, match="not a NumPy file that can be read"):
        read_log(path)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("ros1", "rosbags"),
        ("ulog", "pyulog"),
        ("parquet", "pyarrow"),
        ("hdf5", "h5py"),
    ],
)
def test_a_package_that_is_not_there_is_named(name, package, tmp_path, monkeypatch):
    path = made(tmp_path / "log", name, *recording(name))
    (tmp_path / "none" / package).mkdir(parents=True)
    init = tmp_path / "none" / package / "__init__.py"
    init.write_text(f"raise ModuleNotFoundError(name={package!r})")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "none"), prepend=":")
    with pytest.raises(InputError, match=rf"{package}.*needs the extra `"):
        read_log(path)
