"""Recorded truths that cannot be used: each is refused, and says why."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_logs import made
from test_recorded_alignment import aligned
from written import written

from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import from_rotation_vector, normalize
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
    rows = np.tile(log.truth.components, 3)
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
    path.write_text("\n".join(["t,q_0,q_1,q_2,q_3", *rows, "99.0,1,what,0,0", ""]))
    with pytest.raises(InputError, match="not a number"):
        read_truth(str(path))
