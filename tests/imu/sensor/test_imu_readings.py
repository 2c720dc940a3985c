"""An IMU's readings: each sensor by its own model, each effect by its own law."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from rounding import EPS
from scipy import stats
from written import FILE

from simval.errors import InputError
from simval.imu.sensor import (
    AccelerometerModel,
    Effects,
    GyroscopeEffects,
    GyroscopeModel,
    ImuModel,
    MagnetometerEffects,
    MagnetometerModel,
    Motion,
    load_imu,
    load_sensor,
    read_imu,
    read_sensor,
)
from simval.streams import cell_key, stream

KEY = cell_key("test imu readings")
N, RATE = 4000, 200.0
TIME = np.arange(N) / RATE
ANGLE = 2.0 * np.pi * TIME[:, None] * np.array([0.5, 0.7, 1.1]) + [0.0, 1.0, 2.0]
MOTION = Motion(
    time=TIME,
    specific_force=9.8 * np.sin(ANGLE),
    rate=3.0 * np.cos(ANGLE),
    field=5e-5 * np.sin(ANGLE + 0.5),
)
ACCELEROMETER = AccelerometerModel(
    T=[[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]], K=[1.02, 0.97, 1.01], B=[0.3, 0, -1]
)
M_W = np.array([[2e-3, 1e-5, 0], [-3e-5, 2.1e-3, 2e-5], [0, 4e-5, 1.9e-3]])
B_W = np.array([12.0, -30.0, 5.0])
G_W = np.array([[0.1, 0.02, 0], [0, -0.2, 0], [0.01, 0, 0.05]])
M_M = 1.5e-7 * np.array([[1, 0.02, 0], [0.1, 1.1, -0.03], [0, 0.05, 0.9]])
B_M = np.array([120.0, -40.0, 60.0])


SENSORS = {  # effects, an option of range, the truth, and the size of readings
    "accelerometer": (Effects, {"range_g": 0.5}, "specific_force", 12.0),
    "gyroscope": (GyroscopeEffects, {"range_rad_s": 2.0}, "rate", 2e3),
    "magnetometer": (MagnetometerEffects, {"range_t": 3e-5}, "field", 7e2),
}
EACH = pytest.mark.parametrize("name", SENSORS)


def imu(**parts):
    """All three sensors, without noise but for what is given."""
    return ImuModel(
        accelerometer=ACCELEROMETER,
        gyroscope=GyroscopeModel(M=M_W, B=B_W, G=G_W),
        magnetometer=MagnetometerModel(M=M_M, b=B_M),
        **parts,
    )


def read(seed=1, **parts):
    return read_imu(imu(**parts), MOTION, stream(seed, KEY, 0))


def with_effects(name, **effects):
    """Readings of one sensor, which has some effects."""
    own = SENSORS[name][0](**effects)
    return getattr(read(**{f"{name}_effects": own} if effects else {}), name)


def test_without_effects_each_is_its_model():
    readings = read()
    force, rate, field = MOTION.specific_force, MOTION.rate, MOTION.field
    back = ACCELEROMETER.correct(readings.accelerometer.raw)
    # a solve and a product of condition 1.1 at values of 10
    np.testing.assert_allclose(back, force, rtol=0, atol=64 * EPS * 10)
    raw = readings.gyroscope.raw
    felt = np.einsum("ij,nj->ni", M_W, raw - B_W - np.einsum("ij,nj->ni", G_W, force))
    np.testing.assert_allclose(felt, rate, rtol=0, atol=64 * EPS * 3.0)
    felt = np.einsum("ij,nj->ni", M_M, readings.magnetometer.raw - B_M)
    # the hard iron is a third of the reading, so it costs as many digits
    np.testing.assert_allclose(felt, field, rtol=0, atol=64 * EPS * 1e-4)
    np.testing.assert_array_equal(readings.stamp, TIME)


def test_one_sensor_leaves_the_others_numbers_alone():
    noisy = Effects(noise_std_raw=0.1)
    alone = read(accelerometer_effects=noisy)
    gyroscope = GyroscopeEffects(
        white_raw_per_sqrt_hz=0.3, flicker_raw=0.2, bias_walk_raw_per_sqrt_s=0.1
    )
    both = read(
        accelerometer_effects=noisy,
        gyroscope_effects=gyroscope,
        magnetometer_effects=MagnetometerEffects(noise_std_raw=2.0),
        clock_jitter_s=1e-4,
    )
    np.testing.assert_array_equal(alone.accelerometer.raw, both.accelerometer.raw)
    only = read(gyroscope_effects=GyroscopeEffects(white_raw_per_sqrt_hz=0.3))
    np.testing.assert_array_equal(both.gyroscope.noise_raw, only.gyroscope.noise_raw)
    drawn = [both.accelerometer, both.gyroscope, both.magnetometer]
    numbers = [(r.noise_raw / r.noise_raw.std(axis=0)).ravel() for r in drawn]
    for a, b in ((0, 1), (0, 2), (1, 2)):  # no two share a stream
        r = float(numbers[a] @ numbers[b]) / len(numbers[a])
        # a mean of 12 000 products of variance 1: one false alarm in 1e4 seeds
        assert abs(r) < stats.norm.isf(1e-4 / 6) / np.sqrt(len(numbers[a]))


@EACH
def test_what_is_added_is_recorded(name):
    sensor = with_effects(
        name, white_raw_per_sqrt_hz=[0.3, 0.1, 0.0], flicker_raw=[0.2, 0.0, 0.5],
        bias_walk_raw_per_sqrt_s=[0.1, 0.4, 0.0],
        bias_markov_raw_per_sqrt_s=[0.3, 0.0, 0.0], bias_markov_s=0.01,
        bias_ramp_raw_per_s=[0.0, -0.02, 0.0], sine_raw=[0.0, 0.0, 0.5], sine_hz=50.0,
    )  # fmt: skip
    drift = sensor.drift_raw
    parts = sensor.noise_raw + sensor.flicker_raw + sensor.bias_walk_raw + drift
    added = sensor.raw - with_effects(name).raw
    # sums of readings of this size
    np.testing.assert_allclose(added, parts, rtol=0, atol=4 * EPS * SENSORS[name][3])
    assert not sensor.flicker_raw[:, 1].any()
    assert not sensor.bias_walk_raw[:, 2].any()
    # a density of N is a sample of N sqrt(rate): chi-square, 6 of these limits
    spread = np.sum(sensor.noise_raw[:, :2] ** 2, axis=0) / RATE / [0.09, 0.01]
    low, high = stats.chi2.ppf([1e-4 / 12, 1 - 1e-4 / 12], N)
    assert np.all((low < spread) & (spread < high))
    assert np.all(1.25 * spread > high)  # power: 12 % more noise
    memory = np.exp(-1.0 / (0.01 * RATE))  # what a Markov bias has new in a row
    new = np.sum((drift[1:, 0] - memory * drift[:-1, 0]) ** 2) / (1.0 - memory**2)
    assert low < new / (0.5 * 0.3**2 * 0.01) < high
    np.testing.assert_allclose(drift[:, 1], -0.02 * TIME, rtol=4 * EPS)
    # four rows a period: sin^2 is a half on average, at any phase
    assert np.sum(drift[:, 2] ** 2) == pytest.approx(0.5 * 0.5**2 * N, rel=1e-9)


@EACH
def test_a_delay_of_whole_rows_is_a_shift(name):
    raw, before = (with_effects(name, delay_s=rows / RATE).raw for rows in (3, 0))
    # time - delay is rounded: eps of 20 s at the greatest slope, 7 a second
    atol = SENSORS[name][3] * (20.0 * 7.0 + 8.0) * EPS
    np.testing.assert_allclose(raw[3:], before[:-3], rtol=0, atol=atol)
    np.testing.assert_allclose(raw[:3], before[[0, 0, 0]], rtol=0, atol=atol)
    half = with_effects(name, delay_s=0.5 / RATE).raw[1:]
    between = (before[1:] + before[:-1]) / 2.0
    np.testing.assert_allclose(half, between, rtol=0, atol=2 * atol * RATE / 10)


@EACH
def test_a_range_stops_a_sensor(name):
    _, option, truth, _ = SENSORS[name]
    found, clean = with_effects(name, **option), with_effects(name)
    (reach,) = option.values()
    reach *= 9.80665 if "range_g" in option else 1.0
    over = np.abs(getattr(MOTION, truth)) > reach
    np.testing.assert_array_equal(found.out_of_range, over)
    whole = ~over.any(axis=1)
    np.testing.assert_array_equal(found.raw[whole], clean.raw[whole])
    assert np.all((found.raw != clean.raw)[~whole].any(axis=1))


def test_the_g_sensitivity_is_of_the_force_of_the_row():
    without = replace(imu(), gyroscope=GyroscopeModel(M=M_W, B=B_W))
    plain = read_imu(without, MOTION, stream(1, KEY, 0)).gyroscope.raw
    with_g = read().gyroscope.raw
    seen = np.linalg.lstsq(MOTION.specific_force, with_g - plain, rcond=None)[0].T
    np.testing.assert_allclose(seen, G_W, rtol=0, atol=1e4 * EPS)  # readings of 2e3


def test_time_stamps_jitter_and_stay_in_order():
    readings = read(clock_jitter_s=2e-4)
    off = readings.stamp - TIME
    spread = np.sum(off**2) / 2e-4**2
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], N)
    assert low < spread < high
    np.testing.assert_array_equal(readings.gyroscope.raw, read().gyroscope.raw)
    with pytest.raises(InputError, match=r"out of order; give a tenth of the step"):
        read(clock_jitter_s=5e-3)


def test_a_density_needs_even_steps():
    uneven = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, N))
    motion = replace(MOTION, time=uneven)
    for effects in (Effects(white_raw_per_sqrt_hz=1.0), Effects(flicker_raw=1.0)):
        with pytest.raises(InputError, match="so give rows at even steps"):
            read_imu(imu(accelerometer_effects=effects), motion, stream(1, KEY, 0))
    read_imu(
        imu(accelerometer_effects=Effects(noise_std_raw=1)), motion, stream(1, KEY, 0)
    )


def test_one_file_describes_all_sensors(tmp_path):
    path = tmp_path / "imu.toml"
    path.write_text(FILE)
    other = tmp_path / "imu.json"
    other.write_text(json.dumps(tomllib.loads(FILE)))
    for file in (path, other):
        found = load_imu(file)
        np.testing.assert_array_equal(found.accelerometer.matrix, ACCELEROMETER.matrix)
        T = np.array([[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]])
        M = T * np.array([2e-3, 2.1e-3, 1.9e-3])
        np.testing.assert_array_equal(found.gyroscope.M, M)
        np.testing.assert_array_equal(found.gyroscope.G, 0.1 * np.eye(3))
        assert found.gyroscope_effects.range_rad_s == 35.0
        np.testing.assert_array_equal(found.magnetometer.b, B_M)
        assert found.magnetometer_effects.quantum_raw == 1.0
        assert found.clock_jitter_s == 1e-5
        model, effects = load_sensor(file)
        np.testing.assert_array_equal(model.B, [0.3, 0, -1])
        np.testing.assert_array_equal(effects.noise_std_raw, [0.01] * 3)


def test_a_calibration_is_a_sensor_without_noise(tmp_path):
    values = {name: getattr(ACCELEROMETER, name).tolist() for name in "TKB"}
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(values | {"format": "simval calibration 1", "sd": 1}))
    model, effects = load_sensor(path)
    np.testing.assert_array_equal(model.matrix, ACCELEROMETER.matrix)
    assert effects.noise_std_raw is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[gyroscope]\nT", "[gyroscope]\nU", "`gyroscope` lacks T"),
        ("range_rad_s", "range_g", r"`range_g` .*`range_rad_s`"),
        ("K = [1.5e-7, 1.5e-7, 1.6e-7]", "K = [1e-7, 0, 1e-7]", "singular"),
        ("jitter_s = 1e-5", "skew = 1", "`clock` has skew"),
        ("noise_std_raw = 3.0", "noise_std_raw = 3\nwhite_raw_per_sqrt_hz = 1", "both"),
        ("[magnetometer]", "[compass]", "`compass`"),
    ],
)
def test_a_bad_table_is_named(tmp_path, old, new, message):
    path = tmp_path / "imu.toml"
    assert old in FILE
    path.write_text(FILE.replace(old, new))
    with pytest.raises(InputError, match=message):
        load_imu(path)


EFFECTS_KEY = cell_key("test realism")
ROWS = 20_000
CLOCK = 0.01 * np.arange(ROWS)
FORCE = np.tile([3.0, -4.0, 8.0], (ROWS, 1))


def read_force(effects, model=ACCELEROMETER, force=FORCE, seed=1):
    return read_sensor(model, effects, CLOCK, force, stream(seed, EFFECTS_KEY, 0))


def test_the_models_noise_is_taken_where_the_effects_state_none():
    noisy = AccelerometerModel(
        T=ACCELEROMETER.T, K=ACCELEROMETER.K, B=ACCELEROMETER.B, noise_std=0.1
    )
    stated = read_force(Effects(noise_std_raw=0.1))
    np.testing.assert_array_equal(read_force(Effects(), model=noisy).raw, stated.raw)
    assert not read_force(Effects(noise_std_raw=0.0), model=noisy).noise_raw.any()
    walking = GyroscopeModel(M=M_W, B=B_W, G=G_W, angle_random_walk=0.3)
    own = read_imu(replace(imu(), gyroscope=walking), MOTION, stream(1, KEY, 0))
    density = read(gyroscope_effects=GyroscopeEffects(white_raw_per_sqrt_hz=0.3))
    # the rate is of 200 Hz, by the clock to a rounding
    np.testing.assert_allclose(own.gyroscope.raw, density.gyroscope.raw, rtol=1e-12)


def test_vibration_is_one_line_of_the_spectrum():
    amplitude = np.array([0.5, 0.0, 0.1])
    readings = read_force(Effects(vibration_m_s2=amplitude, vibration_hz=12.5))
    # 12.5 Hz is a whole number of periods in 200 s: all its power is in one bin
    spectrum = 2 * np.abs(np.fft.rfft(readings.vibration_m_s2, axis=0)) / ROWS
    line = round(12.5 * 200)
    np.testing.assert_allclose(spectrum[line], amplitude, rtol=0, atol=1e-12)
    rest = np.delete(spectrum, line, axis=0)
    # the sine's argument reaches 2 pi 12.5 200 = 16 000 rad and is rounded to eps of it
    assert rest.max() < 16_000 * np.finfo(float).eps * amplitude.max()
    np.testing.assert_allclose(
        ACCELEROMETER.correct(readings.raw),
        FORCE + readings.vibration_m_s2,
        rtol=0,
        atol=1e-13,
    )


def test_a_recording_starts_at_any_phase_of_the_vibration():
    effects = Effects(vibration_m_s2=2.0, vibration_hz=12.5)
    starts = [
        read_sensor(
            ACCELEROMETER, effects, CLOCK[:1], FORCE[:1], stream(seed, EFFECTS_KEY, 0)
        )
        for seed in range(120)
    ]
    values = np.concatenate([start.vibration_m_s2[0] for start in starts])
    # the sine of a uniform phase has the arcsine law on (-amplitude, amplitude)
    law = stats.arcsine(loc=-2.0, scale=4.0)
    assert stats.kstest(values, law.cdf).pvalue > 1e-4
    assert stats.kstest(np.abs(values), law.cdf).pvalue < 1e-4  # power: half a turn


def test_quantisation_rounds_to_the_nearest_step():
    quantum = 0.25
    ramp = np.linspace(-20, 20, ROWS)[:, None] * np.array([1.0, 0.7, -0.3])
    exact = read_force(Effects(), force=ramp).raw
    raw = read_force(Effects(quantum_raw=quantum), force=ramp).raw
    np.testing.assert_array_equal(raw / quantum, np.round(raw / quantum))
    error = raw - exact
    # half a step, up to eps of the reading itself, 40 steps
    assert np.abs(error).max() <= quantum / 2 * (1 + 100 * EPS)
    # a slow ramp visits every place in a step alike: variance q^2 / 12 to 2 in N
    np.testing.assert_allclose(error.var(axis=0), quantum**2 / 12, rtol=2e-2)
