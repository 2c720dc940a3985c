"""Recorded truths that cannot be used: each is refused, and says why."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_logs import made
from test_recorded_alignment import aligned
from written import written

from simval.errors import GeometryError, InputError, RefusedError, SimvalError
from simval.geometry import attitude_error, from_rotation_vector, normalize
from simval.imu.logs import read_truth


@pytest.fixture(scope="module")
def log():
    return made(21, seconds=30.0, rate=50.0)


@pytest.mark.ci
def test_no_truth_of_another_log_is_taken(log):
    # what the limit of a quarter rests on: six strangers
    for seed in range(100, 106):
        other = made(seed, seconds=30.0, rate=50.0)
        with pytest.raises(RefusedError, match=r"follows the gyroscope|in two ways"):
            aligned(replace(log, truth=other.truth))


@pytest.mark.ci
def test_noise_is_no_truth(log):
    rng = np.random.default_rng(1)
    for components in (
        normalize(rng.standard_normal((len(log.time), 4))),
        np.tile([0.0, 0.0, 0.0, 1.0], (len(log.time), 1)),
        normalize(np.cumsum(rng.standard_normal((len(log.time), 4)), axis=0)),
    ):
        with pytest.raises(RefusedError):
            aligned(log, components=components)


def test_one_axis_is_not_enough(log):
    time = log.time
    angle = np.sin(time) + 0.3 * np.sin(2.7 * time)
    components = from_rotation_vector(angle[:, None] * [0.0, 0.0, 1.0])
    rate = np.gradient(angle, time)[:, None] * [0.0, 0.0, 1.0]
    with pytest.raises((GeometryError, RefusedError), match=r"ax[ei]s|two ways"):
        aligned(replace(log, gyro=rate), components=components)


def test_left_handed_axes_are_refused(log):
    with pytest.raises(RefusedError, match=r"left-handed|follows the gyroscope"):
        aligned(replace(log, gyro=log.gyro * [1.0, 1.0, -1.0]))


def test_a_motion_that_repeats_itself_is_ambiguous(log):
    rows = slice(int(6.0 * 50), int(14.0 * 50))
    piece = slice(rows.start, rows.stop)
    gyro = np.tile(log.gyro[piece], (4, 1))[: len(log.time)]
    components = np.tile(log.truth.components[piece], (4, 1))[: len(log.time)]
    with pytest.raises(RefusedError, match=r"two ways|follows"):
        aligned(replace(log, gyro=gyro), components=components)


def test_a_rest_without_truth_is_said(log):
    components = log.truth.components.copy()
    for start, stop in log.rests:
        components[start - 20 : stop + 20] = np.nan
    with pytest.raises(RefusedError, match="rest"):
        aligned(log, components=components)


def test_a_vertical_field_has_no_north(log):
    with pytest.raises(GeometryError, match="no north"):
        aligned(replace(log, field=log.force))


HEADERS = ["t,ax,ay,az", "t,quat_a_w,quat_a_x,quat_a_y,quat_a_z,orient_w,orient_x,"
           "orient_y,orient_z", "q0,q1,q2,q3"]  # fmt: skip


@pytest.mark.parametrize("header", HEADERS, ids=["none", "two", "no clock"])
def test_one_quaternion_and_a_clock_are_wanted(header, log, tmp_path):
    rows = np.tile(log.truth.components, 2)
    rows[:, 0] = log.truth.time if header[0] == "t" else rows[:, 0]
    width = header.count(",") + 1
    path = str(written(tmp_path / "a.csv", header, rows[:, :width]))
    with pytest.raises(InputError, match="--truth"):
        read_truth(path)
    if width == 4 and header[0] == "q":
        assert len(read_truth(path, rate=50.0).time) == len(rows)


def test_columns_that_are_asked_for(log, tmp_path):
    q, time = log.truth.components, log.truth.time
    path = tmp_path / "a.csv"
    written(path, "t,a,b,c,d,e", time, q[:, [3, 0, 1, 2]], time)
    path = str(path)
    found = read_truth(path, columns="t,qs,qx,qy,qz,-")
    np.testing.assert_allclose(
        found.components, np.roll(normalize(q), 1, axis=1), rtol=0, atol=1e-15
    )
    assert found.scalar == "first"
    stamped = read_truth(path, columns="t[ms],qs,qx,qy,qz,-")
    np.testing.assert_allclose(stamped.time, 1e-3 * found.time, rtol=1e-15)
    for columns in ("t,qs,qx,qy,qz", "t,qs,qx,qy,-,-", "t,qs,qx,qy,qz,ax", ""):
        with pytest.raises(InputError, match="truth-columns"):
            read_truth(path, columns=columns)


def test_empty_fields_are_rows_without_truth(log, tmp_path):
    path = tmp_path / "a.csv"
    rows = [
        f"{t:.6f},{','.join('' if 40 <= k < 60 else repr(float(x)) for x in row)}"
        for k, (t, row) in enumerate(
            zip(log.truth.time, log.truth.components, strict=True)
        )
    ]
    path.write_text("\n".join(["t,q_0,q_1,q_2,q_3", *rows]))
    found = read_truth(str(path))
    assert np.isnan(found.components[40:60]).all()
    assert np.isfinite(np.delete(found.components, np.s_[40:60], axis=0)).all()
    path.write_text("\n".join(["t,q_0,q_1,q_2,q_3", *rows, "99.0,1,what,0,0"]))
    with pytest.raises(InputError, match="not a number"):
        read_truth(str(path))


def spoilt(log, rng):
    """The truth with one or two kinds of damage."""
    components, time = log.truth.components.copy(), log.truth.time.copy()
    a, b = np.sort(rng.integers(0, len(time), 2))
    noise = normalize(rng.standard_normal((b - a, 4)))
    damage = [
        lambda q, t: (np.concatenate([q[:a], np.nan * q[a:b], q[b:]]), t),
        lambda q, t: (np.concatenate([q[:a], 0 * q[a:b] + q[a], q[b:]]), t),
        lambda q, t: (q[:, rng.permutation(4)], t),
        lambda q, t: (q * np.where(rng.random(len(t)) < 0.2, -1.0, 1.0)[:, None], t),
        lambda q, t: (q, t * rng.choice([1.0, 1.1, 0.5])),
        lambda q, t: (np.concatenate([q[:a], noise, q[b:]]), t),
    ]
    for kind in rng.choice(6, size=rng.integers(1, 3), replace=False):
        components, time = damage[kind](components, time)
    return components, time


@pytest.mark.slow
def test_forty_ways_to_spoil_a_truth_end_in_words_or_in_the_truth(log):
    # random damage: never another exception, never a truth that is wrong unseen
    rng = np.random.default_rng(2)
    aligned_ones, words = 0, []
    for _ in range(40):
        components, time = spoilt(log, rng)
        try:
            found = aligned(log, components=components, time=time)
        except SimvalError as error:
            words.append(str(error))
            continue
        there = np.isfinite(found.attitude).all(axis=1)
        off = attitude_error(found.attitude[there], log.attitude[there])
        aligned_ones += 1
        # within the part that was not replaced, most rows are right
        assert (
            np.mean(off < 6.0 * np.sqrt(np.trace(found.errors.rotation)) + 0.02) > 0.5
        )
    assert aligned_ones >= 5
    assert len(words) >= 5
    assert min(map(len, words)) > 40
