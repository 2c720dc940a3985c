"""What stands beside a sensor in a binary file is never taken for its own."""

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io
from containers import ros, ulog_of

from simval.errors import InputError
from simval.imu.logs import read_log

N = 60
RNG = np.random.default_rng(371)
FORCE, GYRO, MAG = RNG.normal(size=(3, N, 3))
US = 10_000 * np.arange(N)
FORM = "uint64_t timestamp;uint32_t device_id;float x;float y;float z;"


def said(log):
    return "\n".join(log.described())


def message(values, device):
    fields = dict(zip("xyz", values.T, strict=True))
    return FORM, {"timestamp": US, "device_id": np.full(N, device)} | fields


def test_a_gyroscope_goes_with_the_accelerometer_of_its_chip(tmp_path):
    """Numbers of PX4's messages need not agree between the sensors of one chip."""
    path = ulog_of(
        tmp_path / "log",
        {
            ("sensor_accel", 0): message(FORCE, 11),
            ("sensor_accel", 1): message(2 * FORCE, 22),
            ("sensor_gyro", 0): message(2 * GYRO, 22),
            ("sensor_gyro", 1): message(GYRO, 11),
        },
    )
    for number, scale in ((0, 1), (1, 2)):
        log = read_log(path, instance=f"sensor_accel {number}")
        np.testing.assert_array_equal(log.gyro, np.float32(scale * GYRO))


def test_a_bag_says_what_it_does_not_measure(tmp_path):
    log = read_log(ros(tmp_path / "log", US, FORCE, 0 * GYRO))
    assert log.gyro is None
    assert "angular_velocity is zero in every message" in said(log)


@pytest.mark.parametrize("name", ["gyr", "linear_acceleration", "free_acc", "pose"])
def test_a_matrix_with_the_name_of_something_else_is_no_accelerometer(tmp_path, name):
    path = tmp_path / "log.npz"
    np.savez(path, fs=100.0, **{name: GYRO})
    what = "which columns are the accelerometer's|has no column named as an"
    with pytest.raises(InputError, match=what):
        read_log(path)
    np.savez(path, fs=100.0, data=FORCE)
    np.testing.assert_array_equal(read_log(path).accelerometer, FORCE)


def test_variables_with_another_number_of_rows_are_told_or_asked_for(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, fs=100.0, acc=FORCE, gyr=GYRO[::2])
    assert "gyr: 30 rows, where the others have 60" in said(read_log(path))
    np.savez(path, fs=100.0, acc1=FORCE, acc2=FORCE[::2])
    with pytest.raises(InputError, match="acc1, acc2"):
        read_log(path)
    assert len(read_log(path, instance="acc2").time) == N // 2


def test_the_rate_of_a_structure_is_its_own(tmp_path):
    path = tmp_path / "log.mat"
    mag, imu = {"data": MAG[::5], "fs": 20.0}, {"acc": FORCE, "fs": 100.0}
    scipy.io.savemat(path, {"mag": mag, "imu": imu})
    assert read_log(path).rate == 100.0
    scipy.io.savemat(path, {"acc": FORCE, "mag": mag, "imu": {"fs": 100.0}})
    with pytest.raises(InputError, match="--rate"):
        read_log(path)


def test_an_index_of_pandas_and_a_duration_are_clocks(tmp_path):
    path = tmp_path / "log.parquet"
    axes = dict(zip(("ax", "ay", "az"), FORCE.T, strict=True))
    elapsed = (1000 * US).astype("m8[ns]")
    stamps = np.datetime64("2026-03-29T00:59:59.9", "ns") + elapsed
    for name, clock in (("__index_level_0__", stamps), ("elapsed", elapsed)):
        pyarrow.parquet.write_table(pyarrow.table(axes | {name: clock}), path)
        np.testing.assert_allclose(read_log(path).time, US / 1e6, atol=1e-12)
    counter = {"__index_level_0__": np.arange(N)}
    pyarrow.parquet.write_table(pyarrow.table(axes | counter), path)
    with pytest.raises(InputError, match="--rate"):
        read_log(path)


def test_an_attribute_is_a_rate_and_a_compound_dataset_a_table(tmp_path):
    """In HDF5, as h5py writes them; a table beside one of another rate is told."""
    h5py = pytest.importorskip("h5py", reason="the extra `logs` is not installed")
    path = tmp_path / "log.h5"
    fields = [f"{sensor}{axis}" for sensor in ("acc_", "gyr_") for axis in "xyz"]
    rows = np.zeros(N, [(name, "<f8") for name in fields])
    for name, values in zip(fields, np.hstack([FORCE, GYRO]).T, strict=True):
        rows[name] = values
    with h5py.File(path, "w") as file:
        file["imu/rows"] = rows
        file["imu"].attrs["sampling_rate"] = 100.0
        file["gps/fix"] = np.zeros((N // 10, 3))
        file["gps"].attrs["sampling_rate"] = 10.0
        file["picture"] = h5py.ExternalLink("/etc/hostname", "/")
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    np.testing.assert_array_equal(log.gyro, GYRO)
    assert log.rate == 100.0
