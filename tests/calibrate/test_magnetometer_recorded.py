"""Magnetometer on real recordings: axes found, dip of the place, level rests refused.

BROAD (Laidig, Caruso, Cereatti and Seel, Data 6(7), 2021, CC BY 4.0) was taken indoors
in Berlin, where the field dips by 68 degrees and has 49.5 microtesla. Its sensor is
moved slowly, not held: a tenth of a second of slow turning stands for a pose, with an
acceleration of the hand of some 0.15 m/s^2 for its noise.
"""

import numpy as np
import pytest
from places import RECORDINGS
from scipy.io import loadmat

from simval.calibrate import calibrate_magnetometer
from simval.errors import GeometryError

pytestmark = pytest.mark.ci
WINDOW = 29  # rows, 0.1 s
HAND, FIELD_STD = 0.15, 0.5  # m/s^2, microtesla
BERLIN = {"g": 9.8127, "field": 49.5}


def recording(name):
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"the recording {path} is not on this machine")
    return path


@pytest.fixture(scope="module")
def windows():
    """Means over windows of both sensors, and whether the sensor moved in them."""
    path = recording("broad/05_undisturbed_slow_rotation_with_breaks_B.mat")
    log = loadmat(path)
    count = len(log["imu_acc"]) // WINDOW * WINDOW
    body, iron = (log[k][:count].reshape(-1, WINDOW, 3) for k in ("imu_acc", "imu_mag"))
    moved = log["movement"].ravel()[:count].reshape(-1, WINDOW).min(axis=1) > 0
    whole = np.isfinite(body).all(axis=(1, 2)) & np.isfinite(iron).all(axis=(1, 2))
    return body.mean(axis=1), iron.mean(axis=1), moved & whole, ~moved & whole


def test_axes_and_dip_of_a_real_sensor_are_found(windows):
    body, iron, moved, _ = windows
    pick = np.flatnonzero(moved)[::5]
    given = {"accelerometer_std": HAND, "magnetometer_std": FIELD_STD, **BERLIN}
    found = calibrate_magnetometer(body[pick], iron[pick], hemisphere="north", **given)
    assert found.status == "converged"
    assert found.right_handed
    # both sensors are on one board, aligned: a turn of some degrees at the most, and
    # scales within 15 % of microtesla
    np.testing.assert_allclose(found.M, np.eye(3), rtol=0, atol=0.15)
    assert abs(np.degrees(found.dip) - 68.0) < 4.0  # iron of the building
    # the same readings with their axes in the order of another sensor
    order = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    other = calibrate_magnetometer(body[pick], iron[pick] @ order.T, **given)
    np.testing.assert_allclose(other.M @ order, found.M, rtol=0, atol=1e-8)
    assert "det M > 0" in other.assumption
    # the hand is no rest: chi-square does not believe the stated noise, or names poses
    assert found.findings


def test_real_rests_on_a_table_are_refused(windows):
    body, iron, _, still = windows
    pick = np.flatnonzero(still)[::20]
    with pytest.raises(GeometryError, match="as on a level table"):
        calibrate_magnetometer(
            body[pick], iron[pick], accelerometer_std=1e-3, magnetometer_std=0.02,
            **BERLIN,
        )  # fmt: skip
