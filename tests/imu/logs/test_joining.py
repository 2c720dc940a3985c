"""Sensors with stamps of their own in one table: each reading as it was read, once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.imu.logs.joining import COVERED, Stream, candidates, joined


def stream(word, time, name=None):
    """Readings that tell sensor, axis and place, so that each is known again."""
    place = np.arange(len(time)) + {"acc": 1e6, "gyro": 2e6, "mag": 3e6}[word]
    columns = {f"{word}_{axis}": place + k / 4 for k, axis in enumerate("xyz")}
    return Stream(name=name or word, time=np.asarray(time), columns=columns)


steps = st.integers(1, 40)
lost = st.lists(st.tuples(st.integers(0, 300), st.integers(1, 40)), max_size=3)


@pytest.mark.ci
@given(steps, steps, steps, lost, lost, st.integers(-20, 20))
def test_each_row_has_the_nearest_readings_and_none_from_across_a_gap(
    acc, gyro, mag, holes, more, late
):
    """Stamps are whole numbers, so that every distance is exact."""
    streams = []
    for word, step, gaps, start in (
        ("acc", acc, holes, 0),
        ("gyro", gyro, more, late),
        ("mag", mag, [], 7),
    ):
        time = np.arange(start, 4000, step, dtype=float)
        for first, count in gaps:
            time = np.delete(time, slice(first, first + count))
        if len(time) < 3:
            return
        streams.append(stream(word, time))
    table = joined("log", streams)
    assert table.names[0] == "t [s]"
    rows, said = table.values, dict(table.source)
    base = max(streams[:2], key=lambda each: each.step)
    assert set(rows[:, 0]) <= set(base.time)
    taken = [word for word in ("acc", "gyro", "mag") if f"{word}_x" in table.names]
    for each in streams:
        near = np.abs(each.time[:, None] - base.time).min(axis=0) <= each.step
        if each.name not in taken:
            assert np.mean(near) < COVERED
            assert "left out" in said
            continue
        own = rows[:, table.names.index(f"{each.name}_x")]
        place = (own % 1e6).astype(int)
        apart = np.abs(each.time[place] - rows[:, 0])
        nearest = np.abs(each.time[:, None] - rows[:, 0]).min(axis=0)
        np.testing.assert_array_equal(apart, nearest)
        assert np.all(apart <= each.step)
        for k, axis in enumerate("yz", start=1):
            other = rows[:, table.names.index(f"{each.name}_{axis}")]
            np.testing.assert_array_equal(other, own + k / 4)
    if ("gyro" in taken and "mag" in taken) and len(rows) == len(base.time):
        assert "rows left out" not in said


def test_equal_stamps_are_the_same_rows_and_slow_sensors_are_said_to_stand_still():
    time = np.arange(100) / 100
    same = joined("log", [stream("acc", time), stream("gyro", time, "/gyro")])
    assert same.source == (("joined", "/gyro to acc of the same stamp"),)
    np.testing.assert_array_equal(same.values[:, 0], time)
    slow = joined("log", [stream("acc", time), stream("mag", time[::10] + 1e-4)])
    assert slow.source == (
        (
            "joined",
            "mag to acc by the nearest stamp, at most 89.9 ms away; each reading "
            "stands in 10 rows",
        ),
    )


@pytest.mark.parametrize(
    ("streams", "tables"),
    [
        (["/imu aw", "/mag m"], {"/imu": "awm"}),
        (["/cam/accel a /cam", "/cam/gyro w /cam"], {"/cam/accel": "aw"}),
        (["one aw 1", "two aw 2", "m1 m 1", "m2 m 2"], {"one": "awm", "two": "awm"}),
        (
            ["imu aw", "m1 m", "m2 m"],
            {"imu": "aw", "imu + m1": "awm", "imu + m2": "awm"},
        ),
        (["a0 a 0", "a1 a 1", "w1 w 1", "m1 m 1"], {"a0": "am", "a1": "awm"}),
        (["a1 a 1", "w1 w 1", "w2 w 2", "m m 3"], {"a1": "awm"}),
        (["slow a 1 30", "fast aw 2", "idle m 2 30"], {"fast": "aw"}),
    ],
)
def test_what_stands_beside_an_accelerometer_is_taken_or_asked_for(streams, tables):
    """Name, sensors, group and step in hundredths of a second of each stream."""
    words = {"a": "acc", "w": "gyro", "m": "mag"}
    made = []
    for name, kinds, *more in (each.split() for each in streams):
        group, step = (*more, *("", "1")[len(more) :])
        time = np.arange(300) * float(step) / 100
        parts = [stream(words[kind], time).columns for kind in kinds]
        columns = {key: value for part in parts for key, value in part.items()}
        made.append(Stream(name=name, time=time, columns=columns, group=group))
    found = candidates("log", made, "")
    has = {
        name: "".join(k for k in "awm" if f"{words[k]}_x" in table().names)
        for name, table in found.items()
    }
    assert has == tables
