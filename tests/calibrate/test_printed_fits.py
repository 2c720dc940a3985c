"""`print(fit)` says what `simval calibrate` says, by the same code."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.calibrate import calibrate
from simval.calibrate.estimate import entry_lines
from simval.logs import read_log
from simval.multiposition import calibrate_log, calibrate_sensors
from simval.poses import fibonacci_sphere
from simval.sensor import MODELS, AccelerometerModel, forms

SENSORS = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0
[gyroscope]
T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
K = [2.1e-4, 2.1e-4, 2.2e-4]
B = [12, -30, 5]
white_raw_per_sqrt_hz = 0.8
[magnetometer]
T = [[1, 0, 0], [0.02, 1, 0], [0.01, -0.03, 1]]
K = [1.5e-7, 1.5e-7, 1.6e-7]
B = [120, -40, 60]
noise_std_raw = 3.0
"""


def readings(noise_std=0.01, trials=None):
    model = AccelerometerModel.from_parameters(
        np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1]),
        noise_std=noise_std,
    )
    force = 9.80665 * fibonacci_sphere(20)
    if trials is not None:
        force = np.broadcast_to(force, (trials, 20, 3))
    return model.distort(force, np.random.default_rng(1))


ENTRIES = {name for model in MODELS for name, _ in forms.entries(model)}


def columns(text):
    """Words of the first line of each entry of T, K and B."""
    found = {}
    for line in text.splitlines():
        words = line.split()
        if words and words[0] in ENTRIES:
            found.setdefault(words[0], words[1:])
    return found


@pytest.mark.parametrize("model", MODELS)
def test_a_printed_fit_has_each_entry_with_its_error_bars(model):
    fit = calibrate(readings(), model=model)
    table = columns(str(fit))
    assert list(table) == [name for name, _ in forms.entries(model)]
    for (name, sign), value, sd, ends in zip(
        forms.entries(model), fit.parameters, fit.sd, fit.intervals, strict=True
    ):
        printed, error, low, _, high = table[name]
        # eight digits and three, as the table prints them
        assert float(printed) == pytest.approx(sign * value, rel=5e-8)
        assert float(error) == pytest.approx(sd, rel=5e-3)
        assert (float(low), float(high)) == pytest.approx(sorted(sign * ends), rel=5e-8)
    assert f"{model} form, 95 % intervals: Type A, Student's t, 11 dof" in str(fit)
    assert str(fit).startswith("status            converged after ")
    assert f"{float(fit.rms):.4g} m/s^2" in str(fit)


def test_the_representation_still_shows_the_fields():
    assert repr(calibrate(readings())).startswith("FitResult(parameters=")


def test_a_batch_says_how_its_trials_ended():
    assert str(calibrate(readings(trials=7))) == (
        "7 calibrations of an accelerometer: 7 converged"
    )
    poses = np.array(readings(trials=3))
    poses[1] = np.nan
    text = str(calibrate(poses))
    assert text.startswith("3 calibrations of an accelerometer: 2 converged, 1 refused")


def test_nine_poses_have_no_error_bars():
    fit = calibrate(readings(noise_std=0.0)[:9])
    assert "none: nine poses leave no degree of freedom" in str(fit)
    assert columns(str(fit))["K_x"][1:] == ["-", "-", "to", "-"]


@given(
    st.sampled_from(MODELS),
    st.lists(st.floats(-1e6, 1e6), min_size=9, max_size=9),
    st.lists(st.floats(0.0, 1e6) | st.just(np.nan), min_size=9, max_size=9),
)
def test_any_numbers_stand_in_their_columns(model, values, sd):
    values, sd = np.array(values), np.array(sd)
    intervals = values[:, None] + np.outer(sd, [-2.0, 2.0])
    for bound in (None, sd):
        lines = entry_lines(model, values, sd, intervals, bound)
        assert len(lines) == 9
        for (name, sign), value, line in zip(
            forms.entries(model), values, lines, strict=True
        ):
            words = line.split()
            assert words[0] == name
            assert float(words[1]) == pytest.approx(sign * value, rel=5e-8)
            assert len(words) == (6 if bound is None else 7)


@pytest.mark.ci
def test_the_command_prints_what_python_prints(simval, tmp_path):
    sensors, path = tmp_path / "imu.toml", tmp_path / "log.csv"
    sensors.write_text(SENSORS)
    times = ("poses=12", "first_hold=20", "move_time=2")
    words = [word for time in times for word in ("--set", time)]
    words += ["--sensor", sensors, "--out", path, "--every", "5"]
    assert simval("scene", "gimbal", *words)[0] == 0
    code, out, _ = simval("calibrate", path)
    assert code == 0
    log = read_log(path)
    own = calibrate_log(log)
    whole = calibrate_sensors(log, own)
    assert out == "\n".join([*log.described(), str(whole), ""])
    # each fit by itself has the same numbers in the same columns, without the bound
    for text, fit in ((str(whole), whole.accelerometer), (str(own), own.fit)):
        alone, printed = columns(str(fit)), columns(text)
        assert len(alone) == 9
        for name, entry in alone.items():
            assert entry == [*printed[name][:2], *printed[name][3:]]
    for fit in (whole.gyroscope, whole.magnetometer):
        lines = str(fit).splitlines()[2:]
        assert all(line in str(whole) for line in lines)
        assert all(line in str(whole.together) for line in lines)
    assert "in one fit with the gyroscope" in str(whole.together)
    assert (
        columns(str(whole.together))["K_x"] == columns(str(whole.accelerometer))["K_x"]
    )
