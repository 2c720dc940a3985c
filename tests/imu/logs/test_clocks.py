"""Clocks that loggers write: their forms, which of several, and rates in words."""

import numpy as np
import pytest
from text_forms import lines

from simval.errors import InputError
from simval.imu.logs import read_log

N = 300
FORCE = np.random.default_rng(55).normal(size=(N, 3)).tolist()
AXES = ["ax", "ay", "az"]
SECONDS = 0.01 * np.arange(N)


def written(path, above, names, *clocks):
    body = ([*own, *axes] for *own, axes in zip(*clocks, FORCE, strict=True))
    path.write_text(above + lines([*names, *AXES], *body))
    return path


@pytest.mark.parametrize(("step", "hertz"), [(100, 100.0), (10_000, 100.0),
    (16_667, 59.999), (833, 12.005), (5, 2000.0)])  # fmt: skip
def test_the_fine_time_of_xsens_is_in_microseconds_or_tenths_of_milliseconds(
    tmp_path, step, hertz
):
    path = written(tmp_path / "log.csv", "", ["SampleTimeFine"], step * np.arange(N))
    assert read_log(path).rate == pytest.approx(hertz, rel=1e-4)


def dates(form):
    start = np.datetime64("2026-03-04T23:59:58.5", "ms")
    stamps = (start + (10 * np.arange(N)).astype("m8[ms]")).astype("datetime64[ms]")
    for stamp in stamps.tolist():
        word = stamp.strftime(form)
        yield word.replace("@@@", f"{stamp.microsecond // 1000:03d}")


WRITTEN = [
    "%Y-%m-%d %H:%M:%S.@@@",
    "%m/%d/%Y %H:%M:%S.@@@",
    "%d/%m/%Y %H:%M:%S.@@@",
    "%d.%m.%Y %H:%M:%S:@@@",
    "%Y/%m/%d %I:%M:%S.@@@ %p",
    "%m/%d/%Y %I:%M:%S.@@@%p",
    "%I:%M:%S.@@@ %p",
    "%H:%M:%S:@@@",
]


@pytest.mark.parametrize("form", WRITTEN)
def test_a_date_in_each_form_goes_on_at_midnight(tmp_path, form):
    """March 4 to 5, or April 3 to May 3: of two orders the one without a month."""
    path = written(tmp_path / "log.csv", "", ["Time"], dates(form))
    time = read_log(path).time
    np.testing.assert_allclose(time - time[0], SECONDS, rtol=0, atol=1e-9)


@pytest.mark.parametrize("day", ["13/31/2026", "31/31/2026", "2026-13-01", "0/1/2026"])
def test_a_date_that_does_not_exist_is_no_time(tmp_path, day):
    texts = [f"{day} 12:00:{second:09.6f}" for second in SECONDS]
    path = written(tmp_path / "log.csv", "", ["Time"], texts)
    with pytest.raises(InputError, match="is not a time in numbers"):
        read_log(path)


LATE = SECONDS + 0.004 * np.random.default_rng(8).random(N)  # of who received it
NS = (1_770_000_000_000_000_000 + np.rint(1e7 * np.arange(N))).astype(int)
WHOLE, DAY = SECONDS.astype(int), ["2026-01-30"] * N
OF_DAY = [f"12:00:{second:05.2f}" for second in SECONDS]
SEVERAL = {  # names, columns, and the one that is the sensor's
    "a bag as text": (["%time", "field.header.stamp"], (NS + 12_345, NS), 1),
    "a clock and its date": (["Date", "Time"], (DAY, OF_DAY), 1),
    "whole seconds": (["time [s]", "elapsed (s)"], (WHOLE, SECONDS), 1),
    "a receiver": (["timestamp", "sensor_time [s]"], (1.7e9 + LATE, SECONDS), 1),
    "a fine time": (["SampleTimeFine", "elapsed_ms"],
                    (10_000 * np.arange(N), np.rint(1e3 * LATE)), 0),
    "stamps in two": (["time", "header.stamp.secs", "header.stamp.nsecs"],
                      (LATE, NS // 10**9, NS % 10**9), 1),
}  # fmt: skip


@pytest.mark.parametrize("case", SEVERAL.values(), ids=SEVERAL)
def test_of_several_clocks_the_sensors_own_is_taken(tmp_path, case):
    names, clocks, own = case
    log = read_log(written(tmp_path / "log.csv", "", names, *clocks))
    assert log.columns[0].name == names[own]
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-4)


STATED = [
    "// Update Rate: 100.0Hz", "Sample Rate:,100,Hz,,", "# data_rate = 100.0 Hz",
    "OutputRate:,100Hz", "# fs [Hz] = 100", "Fs,100", "Sampling frequency (Hz): 100",
    "# rate: 100 Hz", "SampleRate\t100", "# Accelerometer sampling rate: 100 hertz",
    "Logging rate: 100 samples/s",
]  # fmt: skip
UNSTATED = [
    "# rate: 100", "# baud rate: 100 Hz", "# Data rate: 100 kbit/s",
    "# Sample rate: 10 ms", "# Magnetometer rate: 100 Hz", "# Gyro rate: 100 Hz",
    "# Update rate: 0 Hz", "# Sample rate: 100 Hz\n# Update rate: 50 Hz",
]  # fmt: skip


@pytest.mark.parametrize("above", STATED)
def test_a_rate_in_words_is_taken_where_there_is_no_clock(tmp_path, above):
    path = written(tmp_path / "log.csv", f"{above}\n", [])
    log = read_log(path)
    assert log.rate == 100.0
    assert log.source[0][0] == "rate"
    assert "100 Hz, by " in log.source[0][1]
    # what is given counts, and is held against the file as a clock is
    assert "200 Hz as given, but 100 Hz by" in read_log(path, rate=200.0).source[0][1]


@pytest.mark.parametrize("above", UNSTATED)
def test_what_is_no_rate_of_the_log_is_not_taken(tmp_path, above):
    path = written(tmp_path / "log.csv", f"{above}\n", [])
    with pytest.raises(InputError, match="state the sampling rate"):
        read_log(path)


def test_a_rate_tells_the_unit_of_a_clock_or_contradicts_it(tmp_path):
    path = tmp_path / "log.csv"
    above = "Sample rate: {} Hz\n"
    ticks = 10_000 * np.arange(N)
    log = read_log(written(path, above.format(100), ["time"], ticks))
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-12)
    assert log.source == ()
    log = read_log(written(path, above.format(50), ["time_us"], ticks))
    assert log.source[0][1].startswith(
        "100 Hz by the clock, but 50 Hz by 'Sample rate'"
    )
    with pytest.raises(InputError, match="what is its unit"):
        read_log(written(path, above.format(50), ["time"], ticks))


# parts of a log

DAYS = [*dates("%Y-%m-%d %H:%M:%S.@@@")]
CLOCK_FORMS = [  # a clock, a part in the log's own words, and its rows
    ("t [s]", SECONDS, ("0.5", "1.2"), slice(50, 121)),
    ("t [s]", SECONDS, (None, "1.2"), slice(0, 121)),
    ("t [s]", 1e9 + SECONDS, ("01:46:40.5", "01:46:41.2"), slice(50, 121)),
    ("t [s]", 1e9 + SECONDS, ("2001-09-09 01:46:40.5Z", None), slice(50, N)),
    ("Time", DAYS, ("0.5", "1.2"), slice(50, 121)),
    ("Time", DAYS, ("23:59:59", "00:00:00.5"), slice(50, 201)),
    ("Time", DAYS, ("2026-03-05 00:00:00", None), slice(150, N)),
    ("Time", [*dates("%H:%M:%S:@@@")], ("13:00", "00:00:00"), slice(0, 151)),
    ("Time", [*dates("%I:%M:%S.@@@ %p")], ("11:59:59 PM", "0:30"), slice(50, N)),
    ("count", np.arange(N) % 250, ("2.6", None), slice(260, N)),
]


@pytest.mark.parametrize(("name", "clock", "part", "rows"), CLOCK_FORMS)
def test_a_part_keeps_the_times_of_the_whole(tmp_path, name, clock, part, rows):
    """Outside of it a row may be spoilt; its times are those that the whole shows."""
    rate = 100.0 if name == "count" else None
    path = written(tmp_path / "log.csv", "", [name], clock)
    how = {"rate": rate}
    if rate is not None:
        how["columns"] = "-,ax,ay,az"
    whole = read_log(path, **how)
    spoilt = path.read_text().splitlines()
    outside = 1 + (N - 2 if rows.stop < N else 3)
    if outside - 1 not in range(*rows.indices(N)):
        spoilt[outside] = ",".join([spoilt[outside].split(",")[0], "nan", "0", "0"])
    path.write_text("\n".join([*spoilt, ""]))
    log = read_log(path, **how, start=part[0], stop=part[1])
    np.testing.assert_allclose(log.time, whole.time[rows], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.accelerometer, whole.accelerometer[rows])
    assert log.described()[0].startswith("part ")
    assert np.flatnonzero(log.of_file).tolist() == [*range(*rows.indices(N))]


@pytest.mark.parametrize("words", ["soon", "nan", "12:61", "13:00", "7"])
def test_what_is_no_time_of_a_log_is_said_with_its_times(tmp_path, words):
    path = written(tmp_path / "log.csv", "", ["t [s]"], SECONDS)
    with pytest.raises(InputError, match=r"0\.00.* 2\.99|give seconds"):
        read_log(path, start=words)


def test_the_parts_that_a_second_header_asks_for_are_read(tmp_path):
    path = tmp_path / "log.csv"
    header, body = ",".join(AXES), [",".join(map(repr, row)) for row in FORCE]
    path.write_text("\n".join([header, *body[:200], header, *body[200:], ""]))
    with pytest.raises(InputError, match=r"--until 1\.995, or --from 1\.995"):
        read_log(path, rate=100.0)
    for part, rows in (
        ({"stop": 1.995}, slice(200)),
        ({"start": 1.995}, slice(200, N)),
    ):
        log = read_log(path, rate=100.0, **part)
        np.testing.assert_array_equal(log.accelerometer, FORCE[rows])


def test_a_log_with_times_with_and_without_a_date_is_refused(tmp_path):
    clock = [*DAYS[:100], *(day.split()[1] for day in DAYS[100:])]
    path = written(tmp_path / "log.csv", "", ["Time"], clock)
    with pytest.raises(InputError, match="is not a time"):
        read_log(path)
