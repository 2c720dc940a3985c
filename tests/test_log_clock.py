"""Limits of a log's clock, each on both of its sides: gaps, rates, units, dates."""

import numpy as np
import pytest
from written import written

from simval.errors import InputError
from simval.logs import read_log
from simval.logs.clock import GAP

ROWS = 40
OFF = 1e-5  # of a limit: beyond the digits of a file, and of a changed constant


def log_of(tmp_path, time, header="t[s] ax ay az"):
    force = np.random.default_rng(1).standard_normal((len(time), 3))
    return written(tmp_path / "log.txt", header, time, force, mark=" ", form="{:.12g}")


def with_gap(step, gap):
    steps = np.full(ROWS, step)
    steps[ROWS // 2] = gap
    return np.cumsum(steps)


@pytest.mark.parametrize("step", [0.001, 0.01, 0.1])
def test_a_gap_is_five_seconds(tmp_path, step):
    log = read_log(log_of(tmp_path, with_gap(step, GAP * (1 - OFF))))
    assert len(log.time) == ROWS
    lost = round(GAP / step) - 1
    assert f"; {lost} rows are missing, 5 s of them at once" in log.described()[-1]
    with pytest.raises(InputError, match=r"a gap of 5\.000 s before it"):
        read_log(log_of(tmp_path, with_gap(step, GAP * (1 + OFF))))


def test_lost_rows_do_not_contradict_a_stated_rate(tmp_path):
    time = np.delete(0.01 * np.arange(ROWS), [3, 4, 9, 14, 15, 22, 30])
    assert read_log(log_of(tmp_path, time), rate=100.0).rate < 90.0


@pytest.mark.parametrize(
    ("rate", "good"),
    [
        (100.0 / 1.1 * (1 + OFF), True),
        (100.0 / 1.1 * (1 - OFF), False),
        (100.0 / 0.9 * (1 - OFF), True),
        (100.0 / 0.9 * (1 + OFF), False),
    ],
)
def test_a_stated_rate_agrees_within_a_tenth(tmp_path, rate, good):
    path = log_of(tmp_path, 0.01 * np.arange(ROWS))
    if good:
        # the clock's own rate is what counts; its digits are exact to 1e-12
        assert read_log(path, rate=rate).rate == pytest.approx(100.0, rel=1e-10)
    else:
        with pytest.raises(InputError, match="says 100 Hz"):
            read_log(path, rate=rate)


@pytest.mark.parametrize(
    ("rate", "good"),
    [
        (7.0 * (1 + OFF), True),
        (7.0 * (1 - OFF), False),
        (5e4 * (1 - OFF), True),
        (5e4 * (1 + OFF), False),
    ],
)
def test_a_clock_without_a_unit_is_seconds_at_rates_of_accelerometers(
    tmp_path, rate, good
):
    path = log_of(tmp_path, np.arange(ROWS) / rate, header="t ax ay az")
    if good:
        assert read_log(path).rate == pytest.approx(rate, rel=1e-6)
    else:
        with pytest.raises(InputError, match="what is its unit"):
            read_log(path)


@pytest.mark.parametrize(
    ("start", "good"),
    [(1e9, True), (1e9 - 1.0, False), (2.5e9 - 1.0, True), (2.5e9, False)],
)
def test_another_unit_counts_for_dates_of_this_century(tmp_path, start, good):
    """Milliseconds since 1970, 100 rows a second."""
    time = 1e3 * start + 10.0 * np.arange(ROWS)
    path = log_of(tmp_path, time, header="t ax ay az")
    if good:
        assert read_log(path).rate == pytest.approx(100.0, rel=1e-6)
    else:
        with pytest.raises(InputError, match="what is its unit"):
            read_log(path)


@pytest.mark.parametrize(
    ("unit", "seconds"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)]
)
def test_each_unit_of_a_header_is_its_size(tmp_path, unit, seconds):
    time = np.arange(ROWS) * 0.01 / seconds
    path = log_of(tmp_path, time, header=f"t[{unit}] ax ay az")
    found = read_log(path)
    np.testing.assert_allclose(found.time, 0.01 * np.arange(ROWS), rtol=1e-10)
    assert found.rate == pytest.approx(100.0, rel=1e-10)
