"""Columns that only look like an accelerometer's are asked for, never taken."""

from contextlib import suppress
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation
from written import written

from simval.errors import InputError
from simval.imu.logs import read_log

N = 400
RNG = np.random.default_rng(372)
TIME = np.arange(N)[:, None] / 100
FORCE = np.where(TIME < 2, [0.1, -0.2, 9.8], [9.7, 0.3, 0.2])
FORCE = FORCE + 0.02 * RNG.standard_normal((N, 3))
GYRO = [0.01, -0.02, 0.03] + 0.001 * RNG.standard_normal((N, 3))
TURN = GYRO + np.where(np.abs(TIME - 2) < 0.5, [0.0, 1.6, 0.2], 0.0)


def saved(path, *columns, header="", form="{:.6f}"):
    return written(path, header, *columns, form=form)


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("gyro.txt", False),
        ("imu_gyr_01.csv", False),
        ("Magnetometer.csv", False),
        ("linacce.txt", False),
        ("gravity.txt", False),
        ("acce.txt", True),
        ("acc_and_gyro.csv", True),
        ("image1.csv", True),
        ("gyrate.csv", True),
    ],
)
def test_the_name_of_a_file_tells_of_columns_without_names(tmp_path, name, taken):
    path = saved(tmp_path / name, TIME, FORCE)
    if not taken:
        with pytest.raises(InputError, match="by the name of the file"):
            read_log(path)
    assert len(read_log(path, columns=None if taken else "t,ax,ay,az").time) == N


@pytest.mark.parametrize("scale", [1, 1000])
@pytest.mark.parametrize("gyro", [GYRO, TURN], ids=["still", "turned"])
def test_a_gyroscope_that_comes_first_is_seen(tmp_path, gyro, scale):
    """In SI units also at rest; in counts where it turns."""
    parts = scale * gyro, scale * FORCE
    wrong = saved(tmp_path / "wrong.csv", TIME, *parts)
    right = saved(tmp_path / "right.csv", TIME, *parts[::-1])
    assert read_log(right).gyro is not None
    if scale > 1 and gyro is GYRO:
        return
    with pytest.raises(InputError, match="t,wx,wy,wz,ax,ay,az"):
        read_log(wrong)


def turning(rests):
    """A log of a hand: its force, rate, and the field of the earth in uT."""
    rng = np.random.default_rng(rests)
    rate = ndimage.gaussian_filter1d(rng.normal(size=(4000, 3)), 30, axis=0) * 20
    rate *= np.sin(np.arange(4000) / 300)[:, None] > (0.5 if rests else -2)
    turns = Rotation.from_rotvec(rate / 100)
    q = [Rotation.identity()]
    for turn in turns[:-1]:
        q.append(q[-1] * turn)
    to_body = Rotation.concatenate(q).inv()
    noise = rng.normal(size=(3, 4000, 3))
    force = to_body.apply([0, 0, 9.8]) + 0.02 * noise[0]
    return force, rate + 0.002 * noise[1], to_body.apply([20, 0, -40]) + 0.3 * noise[2]


@pytest.mark.parametrize("rests", [True, False])
@pytest.mark.parametrize("scale", [1, 1000])
def test_a_magnetometer_is_not_taken_for_a_gyroscope(tmp_path, rests, scale):
    """Nor with iron beside it; at rest alone it is known by the earth's field."""
    time = np.arange(4000)[:, None] / 100
    force, rate, field = turning(rests)
    path = saved(tmp_path / "log.csv", time, scale * force, scale * (rate + 0.01))
    assert read_log(path).gyro is not None
    for iron in (0, [60, 30, -40]):
        saved(path, time, scale * force, scale * (field + iron))
        with pytest.raises(InputError, match="t,ax,ay,az,mx,my,mz"):
            read_log(path)
    still = np.tile(field[0], (N, 1)) + GYRO
    with pytest.raises(InputError, match="ax,ay,az,mx,my,mz"):
        read_log(saved(path, np.add(GYRO, [0.1, -0.2, 9.8]), still), rate=100.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_gyroscope_is_not_taken_for_a_magnetometer(tmp_path, seed):
    """Of a car, which turns about gravity and speeds up; and of a table that tilts."""
    rng, time = np.random.default_rng([6, seed]), np.arange(4000)[:, None] / 100
    slow, quick = (
        ndimage.gaussian_filter1d(rng.normal(size=(4000, 3)), rows, axis=0)
        for rows in (200, 20)
    )
    car = 20.0 * slow * [0, 0, 1] + quick * [0.3, 0.3, 0.1]
    push = ndimage.gaussian_filter1d(rng.normal(size=(4000, 3)), 100, axis=0)
    noise = rng.normal(size=(2, 4000, 3))
    angle = 0.5 * time  # 0.2 to 0.7 is a field in gauss, and 20 to 70 one in uT
    tilt = 9.8 * np.hstack([0 * angle, np.sin(angle), np.cos(angle)])
    tilting = np.tile([0.5, 0.0, 0.0], (4000, 1))
    for force, rate in (([0, 0, 9.8] + 8 * push, car), (tilt, tilting)):
        parts = force + 0.02 * noise[0], rate + 0.002 * noise[1]
        path = saved(tmp_path / "log.csv", time, *parts)
        assert read_log(path).gyro is not None


def test_decimals_behind_commas_are_no_columns(tmp_path):
    path = saved(tmp_path / "log.csv", FORCE, form="{:.2f}")
    path.write_text(path.read_text().replace(".", ","))
    with pytest.raises(InputError, match="decimal commas"):
        read_log(path, rate=100.0)
    counts = np.rint(np.hstack([100 * FORCE, 1000 * GYRO]))
    path = saved(path, counts, form="{:.0f}")
    np.testing.assert_array_equal(read_log(path, rate=100.0).gyro, counts[:, 3:])


@pytest.mark.parametrize(
    "header",
    [
        "t,x,y,z,qx,qy,qz",
        "t,x,y,z,vx,vy,vz",
        "t,x,y,z,roll,pitch,yaw",
        "t,ax [g],ay [m/s^2],az [g],wx,wy,wz",
    ],
)
def test_a_pose_and_a_mixture_of_units_are_asked_for(tmp_path, header):
    path = saved(tmp_path / "log.csv", TIME, FORCE, GYRO, header=header)
    with pytest.raises(InputError, match="which columns are the accelerometer's"):
        read_log(path)


def test_dates_go_on_where_summer_time_begins_and_milliseconds_are_no_seconds(
    tmp_path,
):
    """10 kHz in milliseconds since 1970 would be 10 Hz, in the year 55,000."""
    path = tmp_path / "log.csv"
    utc = np.datetime64("2026-03-29T00:59:58") + np.rint(1000 * TIME[:, 0]).astype(
        "m8[ms]"
    )
    for winter, summer in (("+01:00", "+02:00"), ("-0330", "-02:30"), ("Z", " +0045")):
        rows = ["time,ax,ay,az"]
        for k, (stamp, row) in enumerate(zip(utc, FORCE, strict=True)):
            zone = winter if k < 200 else summer
            sign = -1 if "-" in zone else 1
            digits = zone.replace(":", "").strip(" +-Z") or "0000"
            ahead = sign * (60 * int(digits[:2]) + int(digits[2:]))
            local = stamp + np.timedelta64(ahead, "m")
            rows.append(f"{local}{zone},{row[0]},{row[1]},{row[2]}")
        path.write_text("\n".join([*rows, ""]))
        np.testing.assert_allclose(read_log(path).time, TIME[:, 0], atol=1e-9)
    for hours in (1, -1):  # and without a zone the hour is told, not taken
        local = utc + np.where(np.arange(N) < 200, 0, hours).astype("m8[h]")
        rows = [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(local, FORCE, strict=True)]
        path.write_text("\n".join(["time,ax,ay,az", *rows, ""]))
        with pytest.raises(InputError, match=r"line 202.*summer time begins or ends"):
            read_log(path)
    saved(path, 1.7e12 + 10 * TIME, FORCE, header="timestamp,ax,ay,az", form="{:.3f}")
    np.testing.assert_allclose(read_log(path).rate, 1e4, rtol=1e-2)


def test_dates_are_instants_in_any_zones_and_no_zone_is_guessed(tmp_path):
    """Zones change from row to row; where a row has none, the dates are refused."""
    path, start = tmp_path / "log.csv", datetime(2026, 10, 25, 0, 59, 58, tzinfo=UTC)
    zones = [timezone(timedelta(minutes=m)) for m in (60, 120, -210, 0, 345, -720)]
    picked = np.random.default_rng(5).integers(0, 6, N)
    dates = [
        (start + timedelta(seconds=t)).astimezone(zones[k])
        for t, k in zip(TIME[:, 0], picked, strict=True)
    ]
    bare = [date.replace(tzinfo=None) for date in dates]
    for lost in ([], [0], [200], range(1, N)):
        rows = ["time,ax,ay,az"]
        for k, (x, y, z) in enumerate(FORCE):
            date = bare[k] if k in lost else dates[k]
            rows.append(f"{date.isoformat(' ', 'milliseconds')},{x},{y},{z}")
        path.write_text("\n".join([*rows, ""]))
        if lost:
            with pytest.raises(InputError, match=r"is not a time.*state the rate"):
                read_log(path)
        else:
            np.testing.assert_allclose(read_log(path).time, TIME[:, 0], atol=1e-9)


def test_a_clock_is_no_axis(tmp_path):
    path = saved(tmp_path / "log.csv", TIME, FORCE, GYRO[:, :2])
    with pytest.raises(InputError, match="as a clock does"):
        read_log(path, rate=100.0)


def flying(seed, units=(1.0, 1.0)):
    """Force and rate of what flies: vibration, pushes, a rate that is not zero."""
    rng, n = np.random.default_rng([50, seed]), 2000

    def smooth(rows):
        noise = ndimage.gaussian_filter1d(rng.normal(size=(n, 3)), rows, axis=0)
        return noise / noise.std(axis=0)

    to_body = Rotation.from_rotvec(0.2 * smooth(80) + np.pi * rng.normal(size=3)).inv()
    push, turn = rng.uniform(0.3, 2.0) * smooth(80), rng.uniform(0.1, 0.8) * smooth(60)
    force = to_body.apply(push + np.array([0.0, 0.0, 9.81]))
    force += rng.uniform(0.3, 2.5) * rng.normal(size=(n, 3))
    rate = (
        turn + rng.uniform(0.02, 0.2) * rng.normal(size=(n, 3)) + rng.normal(size=3) / 5
    )
    return force * units[0], rate * units[1]


IN_UNITS = {
    "m/s^2, rad/s": (1.0, 1.0),
    "m/s^2, deg/s": (1.0, 57.3),
    "g, rad/s": (1 / 9.81, 1.0),
    "counts": (2048 / 9.81, 16.4 * 57.3),
    "unknown": (1000.0, 1000.0),
}


@pytest.mark.ci
@pytest.mark.parametrize("units", IN_UNITS.values(), ids=IN_UNITS)
def test_a_gyroscope_that_comes_first_in_flight_is_never_read_as_gravity(
    tmp_path, units
):
    """Of 20 flights; sound ones are read where the unit is one of gravity's."""
    time = np.arange(2000)[:, None] / 200
    sound = 0
    for seed in range(20):
        force, rate = flying(seed, units)
        path = saved(tmp_path / "log.csv", time, rate, force)
        with pytest.raises(InputError, match="t,wx,wy,wz,ax,ay,az") as caught:
            read_log(path)
        named = [
            each.rstrip(",.;") for each in str(caught.value).split() if "wx" in each
        ]
        assert set(named) <= {"t,wx,wy,wz,ax,ay,az", "t,ax,ay,az,wx,wy,wz"}
        read = read_log(path, columns="t,wx,wy,wz,ax,ay,az")
        np.testing.assert_allclose(read.accelerometer, force, rtol=0, atol=1e-6)
        with suppress(InputError):
            sound += read_log(saved(path, time, force, rate)).gyro is not None
    assert sound >= (19 if units[0] <= 1.0 else 0)


COUNTER = np.arange(N)[:, None]
LABELLED = {  # header, columns beside those of the force, and what is proposed
    "no names": ("", (COUNTER, TIME), "-,t,ax,ay,az"),
    "names": ("Record,Time,One,Two,Three", (COUNTER, TIME), "-,t,ax,ay,az"),
    "a counter alone": ("Record,Flag,One,Two,Three", (COUNTER, 0 * TIME), ",ax,ay,az"),
    "six and a counter": ("", (COUNTER, TIME, GYRO), "-,t,wx,wy,wz,ax,ay,az"),
}


@pytest.mark.parametrize("case", LABELLED.values(), ids=LABELLED)
def test_the_example_of_names_has_no_counter_for_an_axis(tmp_path, case):
    header, columns, proposed = case
    path = saved(tmp_path / "log.csv", *columns, FORCE, header=header)
    with pytest.raises(
        InputError, match=f"--columns [-,]*{proposed.lstrip('-,')}"
    ) as e:
        read_log(path)
    line = str(e.value).split("--columns ")[1].split()[0].strip(",;.")
    read = read_log(path, columns=line, rate=100.0)
    np.testing.assert_allclose(read.accelerometer, FORCE, rtol=0, atol=1e-6)


def test_a_steady_rate_is_not_gravity_beside_a_ride_that_is_never_at_one_g(tmp_path):
    """A turntable on a ride: 1.3 to 2.5 g, and a rate of 0.6 rad/s."""
    length = 9.8 * (1.9 + 0.6 * np.sin(3.0 * TIME))
    force = length * [0.1, 0.2, 0.97] + 0.02 * RNG.standard_normal((N, 3))
    rate = [0.5, 0.1, 0.3] + 0.002 * RNG.standard_normal((N, 3))
    for parts in ((rate, force), (force, rate)):
        path = saved(tmp_path / "log.csv", TIME, *parts)
        with pytest.raises(InputError, match="t,wx,wy,wz,ax,ay,az"):
            read_log(path)
