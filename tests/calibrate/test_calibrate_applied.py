"""Which readings a calibration belongs to: each limit on both of its sides."""

import numpy as np
import pytest

from simval.calibrate import calibrate
from simval.calibrate.files import require_same_sensor, rest_forces
from simval.errors import RefusedError
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel

G = 9.80665
OFF = 1e-6  # of a limit; a fit to exact readings is right to 1e-12
SENSOR = AccelerometerModel.from_parameters(
    [0.03, -0.02, 0.05, 2.0, 1.9, 2.1, 0.3, -0.2, 0.1]
)


@pytest.fixture(scope="module")
def fit():
    directions = fibonacci_sphere(12)
    return calibrate(SENSOR.distort(G * directions, np.random.default_rng(0)), G)


def raw_of(force):
    return SENSOR.distort(force, np.random.default_rng(0))


def moving(size, rows=400):
    """Forces of one length that turn all the time, so that no stretch is at rest."""
    angle = 0.3 * np.arange(rows)
    zero = np.zeros(rows)
    return size * G * np.stack([np.cos(angle), np.sin(angle), zero], axis=1)


@pytest.mark.parametrize(
    ("size", "good"),
    [
        (0.75 * (1 + OFF), True),
        (0.75 * (1 - OFF), False),
        (1.25 * (1 - OFF), True),
        (1.25 * (1 + OFF), False),
    ],
)
def test_a_rest_is_within_a_quarter_of_gravity(fit, size, good):
    raw = raw_of(np.tile([0.0, 0.6 * size * G, 0.8 * size * G], (200, 1)))
    if good:
        require_same_sensor(fit, raw, 100.0)
    else:
        with pytest.raises(RefusedError, match="the log's 4 stretches at rest"):
            require_same_sensor(fit, raw, 100.0)


@pytest.mark.parametrize(
    ("size", "good"),
    [
        (0.75 * (1 + OFF), True),
        (0.75 * (1 - OFF), False),
        (8.0 * (1 - OFF), True),
        (8.0 * (1 + OFF), False),
    ],
)
def test_a_log_in_motion_is_between_three_quarters_and_eight_g(fit, size, good):
    raw = raw_of(moving(size))
    if good:
        require_same_sensor(fit, raw, 100.0)
    else:
        with pytest.raises(RefusedError, match="mean reading, in motion"):
            require_same_sensor(fit, raw, 100.0)


@pytest.mark.parametrize(
    ("rate", "rows"), [(100.0, 50), (20.0, 10), (10.0, 10), (1.0, 10), (400.0, 200)]
)
def test_a_stretch_is_half_a_second_and_ten_rows_at_least(rate, rows):
    rest = np.tile([0.0, 0.6, 0.8], (3 * rows, 1))
    assert len(rest_forces(rest, rate)) == 3
    assert len(rest_forces(rest[1:], rate)) == 2
    np.testing.assert_allclose(rest_forces(rest, rate), 1.0, rtol=1e-12)


@pytest.mark.parametrize("share", [1 - OFF, 1 + OFF])
def test_a_stretch_at_rest_scatters_by_less_than_a_twentieth(share):
    # plus and minus alternate: a standard deviation of just that
    rest = np.tile([0.0, 0.0, 2.0], (100, 1))
    rest[:, 0] += 0.05 * 2.0 * share * (-1.0) ** np.arange(100)
    assert len(rest_forces(rest, 100.0)) == (2 if share < 1 else 0)
    # of all axes together
    rest = np.tile([0.0, 0.0, 2.0], (100, 1))
    for axis in range(3):
        one = 0.05 * 2.0 * share / np.sqrt(3.0)
        rest[:, axis] += one * (-1.0) ** np.arange(100)
    assert len(rest_forces(rest, 100.0)) == (2 if share < 1 else 0)
