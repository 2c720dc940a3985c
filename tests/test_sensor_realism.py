"""Every effect of a real sensor against its own law, and the truth beside it."""

import json

import numpy as np
from rounding import EPS
from scipy import stats

from simval.sensor import AccelerometerModel, Effects, load_sensor, read_sensor
from simval.streams import cell_key, stream

KEY = cell_key("test realism")
MODEL = AccelerometerModel(
    T=[[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]], K=[1.02, 0.97, 1.01], B=[0.3, 0, -1]
)
N = 20_000
TIME = 0.01 * np.arange(N)
FORCE = np.tile([3.0, -4.0, 8.0], (N, 1))


def read(effects, model=MODEL, force=FORCE, seed=1):
    return read_sensor(model, effects, TIME, force, stream(seed, KEY, 0))


def test_the_models_noise_is_taken_where_the_effects_state_none():
    noisy = AccelerometerModel(T=MODEL.T, K=MODEL.K, B=MODEL.B, noise_std=0.1)
    stated = read(Effects(noise_std_raw=0.1))
    np.testing.assert_array_equal(read(Effects(), model=noisy).raw, stated.raw)
    assert not read(Effects(noise_std_raw=0.0), model=noisy).noise_raw.any()


def test_the_bias_walk_has_independent_increments_of_the_stated_density():
    density = np.array([0.01, 0.1, 0.03])
    readings = read(Effects(bias_walk_raw_per_sqrt_s=density))
    walk = readings.bias_walk_raw
    assert not walk[0].any()
    np.testing.assert_allclose(
        # a difference of readings of up to 10: eps of that
        readings.raw - read(Effects()).raw,
        walk,
        rtol=0,
        atol=16 * EPS,
    )
    for stride in (1, 100):  # sums of increments are as independent as these are
        steps = np.diff(walk[::stride], axis=0)
        spread = np.sum(steps**2, axis=0) / (density**2 * 0.01 * stride)
        low, high = stats.chi2.ppf([1e-4 / 12, 1 - 1e-4 / 12], len(steps))
        assert np.all((low < spread) & (spread < high))


def test_vibration_is_one_line_of_the_spectrum():
    amplitude = np.array([0.5, 0.0, 0.1])
    readings = read(Effects(vibration_m_s2=amplitude, vibration_hz=12.5))
    # 12.5 Hz is a whole number of periods in 200 s: all its power is in one bin
    spectrum = 2 * np.abs(np.fft.rfft(readings.vibration_m_s2, axis=0)) / N
    line = round(12.5 * 200)
    np.testing.assert_allclose(spectrum[line], amplitude, rtol=0, atol=1e-12)
    rest = np.delete(spectrum, line, axis=0)
    # the sine's argument reaches 2 pi 12.5 200 = 16 000 rad and is rounded to eps of it
    assert rest.max() < 16_000 * np.finfo(float).eps * amplitude.max()
    np.testing.assert_allclose(
        MODEL.correct(readings.raw), FORCE + readings.vibration_m_s2, rtol=0, atol=1e-13
    )


def test_a_recording_starts_at_any_phase_of_the_vibration():
    effects = Effects(vibration_m_s2=2.0, vibration_hz=12.5)
    starts = [
        read_sensor(MODEL, effects, TIME[:1], FORCE[:1], stream(seed, KEY, 0))
        for seed in range(120)
    ]
    values = np.concatenate([start.vibration_m_s2[0] for start in starts])
    # the sine of a uniform phase has the arcsine law on (-amplitude, amplitude)
    law = stats.arcsine(loc=-2.0, scale=4.0)
    assert stats.kstest(values, law.cdf).pvalue > 1e-4
    assert stats.kstest(np.abs(values), law.cdf).pvalue < 1e-4  # power: half a turn


def test_quantisation_rounds_to_the_nearest_step():
    quantum = 0.25
    ramp = np.linspace(-20, 20, N)[:, None] * np.array([1.0, 0.7, -0.3])
    exact = read(Effects(), force=ramp).raw
    raw = read(Effects(quantum_raw=quantum), force=ramp).raw
    np.testing.assert_array_equal(raw / quantum, np.round(raw / quantum))
    error = raw - exact
    # half a step, up to eps of the reading itself, 40 steps
    assert np.abs(error).max() <= quantum / 2 * (1 + 100 * EPS)
    # a slow ramp visits every place in a step alike: variance q^2 / 12 to 2 steps in N
    np.testing.assert_allclose(error.var(axis=0), quantum**2 / 12, rtol=2e-2)


def test_range_and_saturation_stop_where_they_say():
    ramp = np.linspace(-40, 40, N)[:, None] * np.ones(3)
    readings = read(Effects(range_g=2.0), force=ramp)
    most = 2.0 * 9.80665
    np.testing.assert_array_equal(readings.out_of_range, np.abs(ramp) > most)
    np.testing.assert_allclose(
        # readings of 20, corrected: a dozen operations
        MODEL.correct(readings.raw),
        np.clip(ramp, -most, most),
        rtol=0,
        atol=12 * EPS * most,
    )
    readings = read(Effects(limits_raw=(-10.0, 25.0)), force=ramp)
    exact = read(Effects(), force=ramp).raw
    np.testing.assert_array_equal(readings.raw, np.clip(exact, -10.0, 25.0))
    np.testing.assert_array_equal(readings.saturated, (exact < -10) | (exact > 25))
    assert readings.saturated.any()
    # the element stops before the model: both at once
    both = read(Effects(range_g=2.0, limits_raw=(-10.0, 25.0)), force=ramp)
    assert both.raw.max() < 25.0
    assert both.raw.min() == -10.0


def test_a_sensor_file_is_read_in_either_form(tmp_path):
    values = {"T": MODEL.T.tolist(), "K": MODEL.K.tolist(), "B": MODEL.B.tolist()}
    toml = tmp_path / "sensor.toml"
    lines = [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    toml.write_text("\n".join([*lines, "noise_std_raw = 0.1", "quantum_raw = 0.5"]))
    other = tmp_path / "sensor.json"
    other.write_text(json.dumps(values | {"noise_std_raw": 0.1, "quantum_raw": 0.5}))
    written = tmp_path / "calibration.json"
    written.write_text(json.dumps(values | {"format": "simval calibration 1", "sd": 1}))
    for path in (toml, other, written):
        model, effects = load_sensor(path)
        np.testing.assert_array_equal(model.matrix, MODEL.matrix)
        assert effects.quantum_raw == (0.0 if path is written else 0.5)
