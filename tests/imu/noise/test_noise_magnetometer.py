"""A magnetometer's noise: its own readings, its units, its share in a calibration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from written import written

from simval.errors import InputError, RefusedError
from simval.imu.logs import Column, Log
from simval.imu.multiposition.log_units import written_unit
from simval.imu.multiposition.noise import pose_noise, white_noise
from simval.imu.noise import NoiseFile, load_noise, noise_of
from simval.imu.noise.fit import noise_of_readings, own_readings, rows_to_a_reading
from simval.imu.sensor import NoiseModel
from simval.streams import cell_key, stream

KEY = cell_key("test noise of a magnetometer")
RATE = 100.0
SEEDS = range(6)


def stood(readings, each, phase=0.5):
    """Rows in which each reading stands until the next one has come."""
    rows = int(each * (len(readings) - 1))
    return readings[np.floor((np.arange(rows) + phase) / each).astype(int)]


def drawn(count, seed, step=0.0, sd=1.0):
    """Readings with white noise, in steps of a converter."""
    rng = stream(1, KEY, seed)
    rows = np.array([20.0, -5.0, 43.0]) + sd * rng.standard_normal((count, 3))
    return np.round(rows / step) * step if step else rows


# The readings themselves


TAKEN = [  # rows to a reading, steps up to noise of 0.53 of them, axes that are dead
    (1.0, 0.3, 2), (1.0, 1.9, 0), (1.55, 0.0, 0), (2.0, 1.9, 0), (2.857, 0.5, 1),
    (100.0, 1.9, 0),
]  # fmt: skip


@pytest.mark.parametrize(("each", "step", "dead"), TAKEN)
def test_each_reading_is_taken_once(each, step, dead):
    """Those that were made, by construction; rows that are readings are left alone."""
    for seed in SEEDS:
        readings = drawn(700, seed, step)
        readings[:, :dead] = 7.0
        rows = stood(readings, each, phase=seed / len(SEEDS))
        found = own_readings(rows)
        inside = found.rows
        # the first may have begun before the log, and the last is whole
        start = next(
            k for k in range(4) if np.array_equal(readings[k : k + 20], inside[:20])
        )
        assert np.array_equal(inside, readings[start : start + len(inside)])
        assert len(inside) > 690
        # two rows at the ends, over the rows of all readings
        assert abs(found.each / each - 1.0) < 2.0 / (690 * each)
        assert each > 1.0 or rows_to_a_reading(rows) == found.each == 1.0


def lost(rng, readings):
    """Bursts of lost readings."""
    rows = readings[:3000]
    for k in np.sort(rng.choice(3000, 900, replace=False)):
        rows[max(k, 1)] = rows[max(k, 1) - 1]
    return rows


def frozen(rng, readings):
    rows, start = readings[:3000], int(rng.integers(0, 1500))
    rows[start : start + 1500] = rows[start]
    return rows


def interpolated(rng, readings):
    """As the recordings of BROAD are."""
    half = 0.5 * (readings[:-1] + readings[1:])
    every = np.stack([readings[:-1], half], axis=1).reshape(-1, 3)
    return np.repeat(every, np.where(rng.random(len(every)) < 0.2, 3, 1), axis=0)[:6000]


def flipping(rng, readings):
    """Two axes dead; alone, an axis might as well be a slow one."""
    return np.eye(3)[2] * 4.0 * (rng.random((900, 1)) < 0.1)


NO_STEP, FEW = "at no regular step", "too few"
REFUSED = {  # rows of a slow or broken magnetometer, and what is said of them
    "geometric": (lambda g, y: y[np.cumsum(g.random(3000) < 0.4)], NO_STEP),
    "two rates": (
        lambda g, y: np.concatenate([stood(y[:400], 2.0), stood(y[400:900], 6)]),
        NO_STEP,
    ),
    "coarse": (lambda g, y: stood(np.round(y[:700] / 1.9) * 1.9, 1.55), NO_STEP),
    "lost": (lost, NO_STEP), "frozen": (frozen, NO_STEP),
    "interpolated": (interpolated, NO_STEP),
    "flipping": (flipping, "far above its noise"),
    **{f"{n} readings": (lambda g, y, n=n: np.repeat(y[:n], 1200 // n, axis=0), FEW)
       for n in (2, 7, 481)},
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_rows_of_which_no_own_readings_can_be_told_are_refused(kind):
    make, words = REFUSED[kind]
    for seed in SEEDS:
        rows = make(stream(1, KEY, 200 + seed), drawn(4000, 100 + seed))
        with pytest.raises(RefusedError, match=words):
            noise_of_readings(rows, RATE)


# The command

FORCE = NoiseModel(white_raw_per_sqrt_hz=0.002)
FIELD = NoiseModel(white_raw_per_sqrt_hz=0.02)  # uT


def log_with(path, compass, header="mx [uT],my [uT],mz [uT]"):
    rows = len(compass)
    force = np.array([0.3, -0.4, 9.79]) + FORCE.draw(rows, RATE, stream(1, KEY, 7))
    time = np.arange(rows) / RATE
    return written(path, f"t,ax,ay,az,{header}", time, force, compass)


def field(rows, each=1.0):
    readings = np.array([21.0, -3.0, 40.0]) + FIELD.draw(
        int(rows / each) + 2, RATE / each, stream(1, KEY, 8)
    )
    return stood(readings, each)[:rows] if each > 1.0 else readings[:rows]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Logs at rest whose magnetometer is as fast as the log, and a third as fast."""
    folder = tmp_path_factory.mktemp("compass")
    return {
        each: log_with(folder / f"{each}.csv", field(2400, each)) for each in (1.0, 3.0)
    }


@pytest.mark.parametrize("each", [1.0, 3.0])
def test_the_numbers_of_a_log(simval, logs, each):
    code, out, err = simval("noise", logs[each], "--json")
    assert code == 0, err
    found = json.loads(out)
    sensor = found["sensors"]["magnetometer"]
    assert (sensor["si_unit"], sensor["unit"]) == ("T", "uT, as the header says")
    assert sensor["si_per_raw"] == 1e-6
    for axis in sensor["axes"].values():
        white = axis["coefficients"]["N"]
        # both have the same N: 5 standard deviations, three axes
        assert abs(white["value"] - 0.02) < 5.0 * white["sd"]
        assert abs(axis["rate_hz"] * each / RATE - 1.0) < 1e-3
    assert not any("magnet" in key for key in found["kalibr"])
    assert found["left_out"] == {}
    file = logs[each].with_suffix(".json")
    file.write_text(out)
    assert len(load_noise(file).magnetometer) == 3


@pytest.mark.ci
def test_a_stated_unit(simval, tmp_path):
    path = log_with(tmp_path / "log.csv", field(700), header="mx,my,mz")
    silent = json.loads(simval("noise", path, "--json")[1])["sensors"]["magnetometer"]
    assert silent["si_per_raw"] == 1e-6  # by the Earth's field
    code, out, err = simval("noise", path, "--magnetometer-unit", "mgauss", "--json")
    assert code == 0, err
    assert json.loads(out)["sensors"]["magnetometer"]["si_per_raw"] == 1e-7


def test_a_g_in_the_header_is_a_gauss_of_a_magnetometer():
    log, _, _ = tumble(4, 30, 1.0)
    for name, unit in (("mx [G]", "gauss"), ("mx (mG)", "mgauss"), ("mx [uT]", "uT")):
        columns = (Column(role="mx", place=0, name=name),)
        assert written_unit(replace(log, columns=columns), "magnetometer") == unit


# What it is for


def tumble(rests, length, each, first=0, sd=1.0, seed=11):
    """Readings in rests between which the field turns, and where the rests are."""
    lengths = np.full(rests, length)
    lengths[0] = max(first, length)
    ends = np.cumsum(lengths)
    readings = drawn(int(ends[-1] / each) + 3, seed, sd=sd)
    noise = (readings - [20.0, -5.0, 43.0]) if each == 1.0 else stood(
        readings - [20.0, -5.0, 43.0], each
    )  # fmt: skip
    rng = stream(1, KEY, 12)
    true = 40.0 * rng.standard_normal((rests, 3))
    rows = noise[: ends[-1]] + np.repeat(true, lengths, axis=0)[: len(noise)]
    intervals = np.stack([ends - lengths, np.minimum(ends, len(rows))], axis=1)
    log = Log(
        path="log",
        time=np.arange(len(rows)) / RATE,
        accelerometer=np.zeros((len(rows), 3)),
        gyro=None,
        rate=RATE,
        magnetometer=rows,
    )
    return log, intervals, true


@pytest.mark.parametrize("each", [1.0, 4.0])
@pytest.mark.parametrize("first", [0, 4000])
def test_the_noise_of_a_pose_is_the_scatter_of_means(each, first):
    """By white noise where rests are short, by the longest rest where it is long."""
    log, intervals, true = tumble(200, 120, each, first)
    rows = log.magnetometer
    white = white_noise(rows, intervals)
    found = pose_noise(log, intervals, sensor="magnetometer")
    assert found.source == ("log" if first else "white")
    means = np.array([rows[a:b].mean(axis=0) for a, b in intervals])
    z = ((means - true) / found.std[:, None])[1:]
    # sum of 597 squares, one false alarm in 1e5; the stated sd is itself known to
    # 1/sqrt(2 n) of its readings, four thousand (each 1) to one thousand of a rest
    spread = 4.4 * np.sqrt(2.0 / z.size) + (0.06 if first else 0.0)
    # a mean over readings that a rest cuts is that of (1 - 1/(3 c)) of their variance
    assert abs((z**2).mean() - 1.0) < spread + each / (3.0 * 120.0)
    if each > 1.0:  # power: each row counted as a reading
        wrong = (((means - true) / white[:, None])[1:] ** 2).mean()
        assert wrong > 2.0


def test_a_noise_file_is_taken_and_one_of_another_unit_refused():
    log, intervals, _ = tumble(60, 100, 1.0)
    rows = log.magnetometer
    white = white_noise(rows, intervals)
    force = noise_of(drawn(2000, 13), RATE)
    axes = noise_of(drawn(3000, 14), RATE)
    file = NoiseFile(
        accelerometer=force, si_per_raw=None, gravity_raw=1.0, magnetometer=axes
    )
    of = "magnetometer"
    found = pose_noise(log, intervals, sensor=of, file=file)
    assert found.source == "file"
    # both are white: N/sqrt(t), N known to 1 % in either, flicker and walk above it
    np.testing.assert_allclose(found.std, white, rtol=0.15)
    without = NoiseFile(accelerometer=force, si_per_raw=None, gravity_raw=1.0)
    assert pose_noise(log, intervals, sensor=of, file=without).source == "white"
    with pytest.raises(InputError, match="of another sensor, range or unit"):
        pose_noise(
            replace(log, magnetometer=1e3 * rows), intervals, sensor=of, file=file
        )
