"""A column of temperatures: its names and units, in degrees Celsius, or left out."""

import numpy as np
import pytest
from written import written

from simval.errors import InputError
from simval.imu.logs import read_log

ROWS = 40
CELSIUS = np.linspace(-12.25, 61.5, ROWS)
TIME = 0.01 * np.arange(ROWS)
FORCE = np.random.default_rng(7).standard_normal((ROWS, 3))


def log_of(folder, name, values, *more):
    header = f"t [s],ax,ay,az,{name}"
    return str(written(folder / "log.csv", header, TIME, FORCE, values, *more))


NAMED = {  # each name of a header, and its unit from degrees Celsius
    "temp": CELSIUS,
    "Temperature (°C)": CELSIUS,
    "temperature [degC]": CELSIUS,
    "imu.temp_c": CELSIUS,
    "tempC": CELSIUS,
    "accel_temperature": CELSIUS,
    "Temp[K]": CELSIUS + 273.15,
    "imu_temperature_kelvin": CELSIUS + 273.15,
    "temp_degF": 1.8 * CELSIUS + 32.0,
    "Temperature (°F)": 1.8 * CELSIUS + 32.0,
}
GIVEN = {  # of `--columns`
    "temp": CELSIUS,
    "temp[K]": CELSIUS + 273.15,
    "temp[degF]": 1.8 * CELSIUS + 32.0,
    "temp[raw/340+36.53]": 340.0 * (CELSIUS - 36.53),
    "temp[raw*0.125-5]": 8.0 * (CELSIUS + 5.0),
}


@pytest.mark.parametrize("name", list(NAMED))
def test_a_header_names_the_temperature_and_its_unit(tmp_path, name):
    log = read_log(log_of(tmp_path, name, NAMED[name]))
    # `written` keeps all digits; a sum and a product round by 1e-13 of 300
    np.testing.assert_allclose(log.temperature, CELSIUS, rtol=0, atol=1e-12)
    assert any("-12.25 to 61.50 degC" in line for line in log.described())


@pytest.mark.parametrize("given", list(GIVEN))
def test_the_caller_names_it(tmp_path, given):
    log = read_log(log_of(tmp_path, "x", GIVEN[given]), columns=f"t,ax,ay,az,{given}")
    np.testing.assert_allclose(log.temperature, CELSIUS, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("temp", CELSIUS + 273.15),  # no unit, and no sensor is that hot
        ("temp_raw", -340.0 * CELSIUS),
        ("temp [mV]", CELSIUS),
        ("temperature", np.full(ROWS, np.nan)),
    ],
)
def test_what_is_no_temperature_is_left_out_and_refused_if_asked_for(
    tmp_path, name, values
):
    path = log_of(tmp_path, name, values)
    log = read_log(path)
    assert log.temperature is None
    np.testing.assert_array_equal(log.accelerometer, FORCE)
    assert any("temperature" in line for line in log.described())
    unit = name.partition("[")[2].rstrip("]") or ("raw" if "raw" in name else "degC")
    with pytest.raises(InputError):
        read_log(path, columns=f"t,ax,ay,az,temp[{unit}]")


def test_a_few_rows_without_a_temperature_are_interpolated(tmp_path):
    """It is linear in the rows here, so the answer is exact to a product's rounding."""
    for hole, mark in ((slice(7, 8), "nan"), (slice(20, 24), ""), (slice(0, 5), "")):
        path = log_of(tmp_path, "temp", CELSIUS)
        rows = (tmp_path / "log.csv").read_text().splitlines()
        for k in range(ROWS)[hole]:
            rows[1 + k] = f"{rows[1 + k].rpartition(',')[0]},{mark}"
        (tmp_path / "log.csv").write_text("\n".join([*rows, ""]))
        log = read_log(path)
        if hole.stop - hole.start > ROWS // 10:
            assert "5 consecutive rows of 40 have no temp" in log.unclear[0].words
            continue
        np.testing.assert_allclose(log.temperature, CELSIUS, rtol=0, atol=1e-12)
        assert "is interpolated" in log.source[0][1]


def test_of_several_the_accelerometers_own_or_none(tmp_path):
    for names, taken in (
        ("gyro_temp,accel_temp", True),
        ("temp_1,temp_2", False),
        ("baro_temp,temp", True),
    ):
        log = read_log(log_of(tmp_path, names, CELSIUS[::-1], CELSIUS))
        assert (log.temperature is not None) == taken
        if taken:
            np.testing.assert_array_equal(log.temperature, CELSIUS)
        else:
            assert "'temp_1', 'temp_2'" in log.unclear[0].words


@pytest.mark.parametrize(
    "unit", ["K*2", "raw", "raw/0+1", "raw/340+", "raw*1e999", "furlongs", "raw+nan"]
)
def test_a_unit_that_is_none_is_refused_in_words(tmp_path, unit):
    path = log_of(tmp_path, "x", CELSIUS)
    with pytest.raises(InputError, match="temp"):
        read_log(path, columns=f"t,ax,ay,az,temp[{unit}]")
