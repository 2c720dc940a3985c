"""Folders that makers' programs export, rebuilt: MbientLab's MetaBase and x-IMU3."""

import numpy as np
import pytest
from text_forms import lines

from simval.errors import InputError
from simval.imu.logs import read_log

N = 400
FORCE, GYRO, MAG = np.random.default_rng(5).normal(size=(3, N, 3)).round(3)
START = 1568464903335  # ms since 1970


def metabase(folder, kind, unit, start, step, rows, device="F1E55E2FE95F"):
    """A file of MetaBase: each begins at its own start, and counts from it, too."""
    stamps = start + step * np.arange(len(rows))
    times = (stamps.astype("M8[ms]")).astype(str)
    names = ["epoch (ms)", "time (01:00)", "elapsed (s)"]
    names += [f"{axis}-axis ({unit})" for axis in "xyz"]
    body = (
        [int(stamp), time.replace(":", "."), (stamp - start) / 1e3, *row.tolist()]
        for stamp, time, row in zip(stamps, times, rows, strict=True)
    )
    name = f"MetaWear_2019-09-14T13.41.43.335_{device}_{kind}_100.000Hz_1.4.5.csv"
    (folder / name).write_text(lines(names, *body))


def test_metabase_is_joined_by_the_stamps_that_its_files_share(tmp_path):
    late = 5  # rows by which the gyroscope begins later
    metabase(tmp_path, "Accelerometer", "g", START, 10, FORCE)
    metabase(tmp_path, "Gyroscope", "deg/s", START + 10 * late, 10, GYRO)
    metabase(tmp_path, "Magnetometer", "T", START, 40, MAG[: N // 4])
    log = read_log(tmp_path)
    first = late - 1  # a reading is taken by a row one step beside it
    np.testing.assert_array_equal(log.accelerometer, FORCE[first:])
    np.testing.assert_array_equal(log.gyro[1:], GYRO[: N - late])
    place = np.abs(np.arange(first, N)[:, None] - 4 * np.arange(N // 4)).min(axis=1)
    assert place.max() <= 3
    assert log.unit_line().endswith("accelerometer g, gyroscope deg/s, magnetometer T")
    metabase(tmp_path, "Accelerometer", "g", START, 10, MAG, device="D3138D652472")
    with pytest.raises(InputError, match=r"holds 2 sensors.*--instance"):
        read_log(tmp_path)


def test_x_imu3_has_both_sensors_in_one_file(tmp_path):
    gyro = [f"Gyroscope {axis} (deg/s)" for axis in "XYZ"]
    force = [f"Accelerometer {axis} (g)" for axis in "XYZ"]
    field = [f"Magnetometer {axis} (a.u.)" for axis in "XYZ"]
    body = ([1_000_000 + 2500 * k, *GYRO[k], *FORCE[k]] for k in range(N))
    (tmp_path / "Inertial.csv").write_text(
        lines(["Timestamp (us)", *gyro, *force], *body)
    )
    slow = ([1_001_000 + 50_000 * k, *MAG[k]] for k in range(N // 20))
    (tmp_path / "Magnetometer.csv").write_text(lines(["Timestamp (us)", *field], *slow))
    (tmp_path / "Quaternion.csv").write_text("Timestamp (us),W,X,Y,Z\n1,1,0,0,0\n")
    log = read_log(tmp_path)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    np.testing.assert_array_equal(log.gyro, GYRO)
    nearest = np.rint((np.arange(N) - 0.4) / 20).astype(int).clip(0, N // 20 - 1)
    np.testing.assert_array_equal(log.magnetometer, MAG[nearest])
    assert log.rate == pytest.approx(400.0)
    part = read_log(tmp_path, start=1.25, stop=1.5)
    np.testing.assert_array_equal(part.gyro, GYRO[100:201])
