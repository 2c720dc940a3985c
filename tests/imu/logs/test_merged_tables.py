"""Tables that sensors of several rates share: each reading to the bit, once."""

import numpy as np
import pytest
from merged_tables import merged

from simval.errors import InputError
from simval.imu.logs import read_log
from simval.imu.logs.joining import COVERED, SLOWEST
from simval.imu.logs.truth import read_truth


def require_each_reading(log, case):
    """Require of each row the nearest reading of each sensor, unchanged."""
    parts = {"force": log.accelerometer, "gyro": log.gyro, "mag": log.magnetometer}
    inertial = [each for kind, each in case.sensors.items() if kind != "mag"]
    base = min(inertial, key=lambda sensor: len(sensor[0]))[0]
    late = log.time - log.time[0]
    starts = (each for each in base if np.abs(base - each - late[-1]).min() < 1e-5)
    time = next(starts) + late  # a clock of dates begins with the log's first row
    for kind, (stamps, values) in case.sensors.items():
        if parts[kind] is None:  # too slow, or there for too short a time
            step = np.median(np.diff(stamps))
            near = np.abs(stamps[:, None] - base).min(axis=0) <= step + 1e-9
            assert 1 / step < SLOWEST or np.mean(near) < COVERED, kind
            continue
        place = {tuple(reading): k for k, reading in enumerate(values)}
        places = np.array([place[tuple(reading)] for reading in parts[kind]])
        nearest = np.abs(stamps[:, None] - time).min(axis=0)
        # clocks are printed to a microsecond or their tick
        np.testing.assert_allclose(np.abs(stamps[places] - time), nearest, atol=2e-6)
    assert parts["force"] is not None
    assert (parts["gyro"] is not None) <= ("gyro" in case.sensors)


@pytest.mark.parametrize("first", [0, pytest.param(20, marks=pytest.mark.ci)])
def test_a_merged_table_is_read_to_the_bit(tmp_path, first):
    """Of 300; `drawn` of `merged_tables.py` has what varies. None is refused."""
    for seed in range(first, 300 if first else 20):
        case = merged(np.random.default_rng([50, seed]))
        path = tmp_path / "log.csv"
        path.write_text(case.text)
        require_each_reading(read_log(path), case)


N = 100
RNG = np.random.default_rng(51)
FORCE, GYRO, MAG = (np.round(RNG.normal(size=(N, 3)), 4).tolist() for _ in range(3))


def rows_of(path, *fields):
    """Write a line of fields above and one for each row."""
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in fields))
    return path


def mag_in(path, cells):
    header = ["t", "ax", "ay", "az", "mx", "my", "mz"]
    body = ([k / 100, *FORCE[k], *cells(k)] for k in range(N))
    return rows_of(path, header, *body)


@pytest.mark.parametrize("hole", ["nan", "", "overflow", "inf"])
def test_a_reading_of_two_axes_is_damage_and_said(tmp_path, hole):
    def cells(k):
        return [hole, *MAG[k][1:]] if k == 4 else MAG[k]

    path = mag_in(tmp_path / "log.csv", cells)
    log = read_log(path)
    assert log.magnetometer is None
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    assert "left out          the magnetometer: " in "\n".join(log.described())
    assert ", line 6" in log.unclear[0].words
    with pytest.raises(InputError):  # but not where it is asked for
        read_log(path, columns="t,ax,ay,az,mx,my,mz")


def test_a_slow_magnetometer_is_read_and_one_that_is_too_slow_is_said(tmp_path):
    for every, taken in ((10, True), (20, False)):
        path = mag_in(
            tmp_path / "log.csv", lambda k, n=every: ["", "", ""] if k % n else MAG[k]
        )
        log = read_log(path)
        said = "\n".join(log.described())
        np.testing.assert_array_equal(log.accelerometer, FORCE)
        assert (log.magnetometer is not None) == taken
        assert ("each reading stands in 10 rows" in said) == taken
        assert ("fewer than 7 readings a second" in said) != taken


def test_a_truth_in_rows_of_its_own_has_a_clock_of_its_own(tmp_path):
    q = RNG.normal(size=(N, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    header = ["t", "ax", "ay", "az", "q_w", "q_x", "q_y", "q_z"]
    body = []
    for k in range(N):
        body += [[k / 100, *FORCE[k], *[""] * 4], [k / 100 + 0.004, *[""] * 3, *q[k]]]
    path = rows_of(tmp_path / "log.csv", header, *body)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    truth = read_truth(str(path), clock=log.time)
    there = np.isfinite(truth.components[:, 0])
    np.testing.assert_allclose(truth.components[there], q, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(truth.time[there], np.arange(N) / 100 + 0.004)


SHORT = {  # names for one column fewer: a name or a separator is missing
    "a separator": ("time (s)x (g),y (g),z (g)", "t"),
    "of two words": ("tacc_x,acc_y,acc_z", "t"),
    "of the clock": ("ax,ay,az", "t"),
    "of R's rows": ("t,ax,ay,az", "kt"),
    "of a date": ("ax,ay,az", "d"),
}


@pytest.mark.parametrize("case", SHORT.values(), ids=SHORT)
def test_a_header_one_name_short_is_matched_and_said(tmp_path, case):
    header, first = case
    own = {"t": lambda k: k / 100, "k": lambda k: k, "d": lambda k: 1e9 + k / 100}
    body = ([*(own[each](k) for each in first), *FORCE[k]] for k in range(N))
    path = rows_of(tmp_path / "log.csv", [header], *body)
    clock = "t" in header
    log = read_log(path, rate=None if clock else 100.0)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    assert log.source[0][0] == "names"
    assert f"names for {len(first) + 3} columns" in log.source[0][1]
    assert log.rate == pytest.approx(100.0)
    assert ("(g)" in log.columns[-1].name) == ("(g)" in header)


def test_a_header_that_fits_in_several_ways_is_refused_but_not_with_columns(tmp_path):
    body = ([k / 100, *FORCE[k], *MAG[k][:1]] for k in range(N))
    path = rows_of(tmp_path / "log.csv", ["t,ax,ay,az"], *body)
    with pytest.raises(InputError, match="line 1: the header has 4 names"):
        read_log(path)
    log = read_log(path, columns="t,ax,ay,az,-")
    np.testing.assert_array_equal(log.accelerometer, FORCE)


def test_columns_are_counted_with_and_without_those_that_are_empty(tmp_path):
    body = ([k, "", *FORCE[k], ""] for k in range(N))
    path = rows_of(tmp_path / "log.csv", *body)
    for columns in ("-,-,ax,ay,az", "-,ax,ay,az"):
        log = read_log(path, rate=100.0, columns=columns)
        np.testing.assert_array_equal(log.accelerometer, FORCE)


@pytest.mark.parametrize("every", [2, 3, 4])
def test_sensors_in_any_step_of_the_rows_are_seen(tmp_path, every):
    """Decimal commas stand in each second, third or fourth row alone."""
    body = [f"{10 * k};" + "NA;NA;NA" * (k % every > 0) for k in range(128)]
    body = [
        each if k % every else each + ";".join(f"{x},5" for x in range(k, k + 3))
        for k, each in enumerate(body)
    ]
    (tmp_path / "log.csv").write_text("\n".join(["t [ms];ax;ay;az", *body, ""]))
    force = read_log(tmp_path / "log.csv").accelerometer
    np.testing.assert_array_equal(force[:, 0], np.arange(0, 128, every) + 0.5)


def test_a_rate_tells_the_unit_of_a_clock_of_rows_between(tmp_path):
    header = ["t", "ax", "ay", "az", "wx", "wy", "wz"]
    body = []
    for k in range(N):
        body += [[20 * k, *FORCE[k], *[""] * 3], [20 * k + 7, *[""] * 3, *GYRO[k]]]
    path = rows_of(tmp_path / "log.csv", header, *body)
    log = read_log(path, rate=50.0)
    np.testing.assert_allclose(np.diff(log.time), 0.02, rtol=1e-9)
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    np.testing.assert_array_equal(log.gyro, GYRO)


@pytest.mark.parametrize("names", [("t_acc", "t_gyr"), ("Time [s]", "Time.1 [ms]")])
@pytest.mark.parametrize("slower", [True, False])
def test_sensors_side_by_side_have_the_clocks_before_them(tmp_path, names, slower):
    """The shorter one's cells are empty from its end on."""
    steps = (0.02, 0.01) if slower else (0.01, 0.02)
    counts = (N // 2, N) if slower else (N, N // 2)
    scale = 1000 if "ms" in names[1] else 1
    acc, gyr = ([round(k * step, 2) for k in range(N)] for step in steps)
    header = [names[0], "ax", "ay", "az", names[1], "gx", "gy", "gz"]
    body = []
    for k in range(N):
        first = [acc[k], *FORCE[k]] if k < counts[0] else [""] * 4
        second = [gyr[k] * scale, *GYRO[k]] if k < counts[1] else [""] * 4
        body.append([*first, *second])
    log = read_log(rows_of(tmp_path / "log.csv", header, *body))
    every = np.arange(0, N, 2)
    force = FORCE[: N // 2] if slower else np.array(FORCE)[every]
    gyro = np.array(GYRO)[every] if slower else GYRO[: N // 2]
    np.testing.assert_array_equal(log.accelerometer, force)
    np.testing.assert_array_equal(log.gyro, gyro)
    np.testing.assert_allclose(np.diff(log.time), 0.02, rtol=1e-9)


def test_a_sensor_without_a_reading_is_said_and_an_accelerometer_refused(tmp_path):
    path = tmp_path / "log.npz"
    nothing, warm = np.full((N, 3), np.nan), 20 + np.arange(N) / 10
    np.savez(path, acc=FORCE, gyr=nothing, mag=MAG, temp=warm, fs=100.0)
    log = read_log(path)
    assert log.gyro is None
    assert "left out          the gyroscope: no row has" in "\n".join(log.described())
    np.testing.assert_array_equal(log.magnetometer, MAG)
    np.savez(path, acc=nothing, gyr=GYRO, fs=100.0)
    with pytest.raises(InputError, match="no row has a reading of the accelerometer"):
        read_log(path)
    slow = np.where(np.arange(N)[:, None] % 2, np.nan, MAG)
    np.savez(path, acc=FORCE, mag=slow, temp=warm, fs=100.0)
    log = read_log(path)
    np.testing.assert_array_equal(log.temperature, warm)
    np.testing.assert_array_equal(log.magnetometer[::2], MAG[::2])


@pytest.mark.parametrize("end", ["", ","])
def test_a_name_that_is_lost_shifts_no_other(tmp_path, end):
    """Also where a separator stands behind each line, which would fill the header."""
    names = ["t", "ax", "ay", "az", "wx", "wy", "wz", "temp"]
    rows = [[k / 100, *FORCE[k], *GYRO[k], 20.5] for k in range(N)]
    for lost in names[1:]:
        header = [name for name in names if name != lost]
        lines = [",".join(map(str, row)) + end for row in (header, *rows)]
        (tmp_path / "log.csv").write_text("\n".join([*lines, ""]))
        with pytest.raises(InputError, match=r"the header has 7 names"):
            read_log(tmp_path / "log.csv")
