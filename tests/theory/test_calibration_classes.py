"""Calibrations of fewer than nine parameters: bounds, what they leave and meet."""

import numpy as np
import pytest
from rounding import EPS
from scipy.optimize import minimize

from simval.errors import GeometryError
from simval.geometry import normalize
from simval.imu.sensor import AccelerometerModel
from simval.imu.sensor.models import (
    ALL,
    CLASSES,
    mean_square_left,
    own_sensor,
    places_of,
)
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.poses import cube_faces, fibonacci_sphere
from simval.theory.calibration import calibration_moments
from simval.theory.calibration_classes import (
    bound_left,
    class_bound,
    least_left,
    pseudo_true,
)

LESS = CLASSES[:2]
SPHERE, FACES = fibonacci_sphere(24), cube_faces()
POSES = [(SPHERE, False), (FACES, True)]


def misaligned(rng, size=0.05):
    values = np.concatenate(
        [
            rng.uniform(-size, size, 3),
            rng.uniform(0.8, 1.2, 3),
            rng.uniform(-0.3, 0.3, 3),
        ]
    )
    return AccelerometerModel.from_parameters(values)


def bound(sensor, directions, places, known):
    return class_bound(sensor, directions, places, g=G, noise_std=0.01, known=known)


def test_what_is_left_is_the_mean_square_over_all_directions():
    # the cube's corners integrate a quadratic over the sphere exactly; the frame by the
    # rotation that fits 8 vectors best, an algorithm that knows nothing of (L1)
    rng = np.random.default_rng(3)
    corners = normalize(np.array(np.meshgrid(*[[1.0, -1.0]] * 3)).reshape(3, 8).T)
    for _ in range(20):
        sensor = misaligned(rng, 0.3)
        matrix = sensor.matrix + 0.1 * rng.standard_normal((3, 3))
        bias = sensor.B + 0.1 * rng.standard_normal(3)
        raw = sensor.distort(G * corners, rng)
        found = (raw - bias) @ matrix.T
        centred = found - found.mean(axis=0)  # a rotation about the mean
        U, _, V = np.linalg.svd(centred.T @ (G * corners))
        turn = V.T @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ U.T
        error = centred @ turn.T - G * corners
        direct = np.mean(np.sum(error**2, axis=1)) + np.sum(found.mean(axis=0) ** 2)
        left = mean_square_left(matrix, bias, sensor, G)
        # a hundred roundings of g squared
        assert left == pytest.approx(direct, rel=0, abs=100 * EPS * G**2)


def test_nothing_is_left_of_the_truth_in_any_frame():
    sensor = probe_sensor()
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    for matrix in (sensor.matrix, turn @ sensor.matrix):
        left = mean_square_left(matrix, sensor.B, sensor, G)
        assert left <= (20 * EPS * G) ** 2


def test_the_bound_of_some_is_the_inverse_of_their_information():
    for estimates in CLASSES:
        sensor = own_sensor(probe_sensor(estimates), estimates)
        places = list(places_of(estimates))
        whole = calibration_moments(sensor, SPHERE, g=G, noise_std=0.01).cramer_rao
        part = np.linalg.inv(np.linalg.inv(whole)[np.ix_(places, places)])
        found = bound(sensor, SPHERE, tuple(places), False)
        np.testing.assert_allclose(found, part, rtol=0, atol=1e-9 * np.abs(part).max())


def test_the_bound_of_known_directions_is_a_regression_of_each_axis():
    sensor = own_sensor(probe_sensor(), ("scale", "bias"))
    found = bound(sensor, FACES, tuple(range(3, 9)), True)
    # y = a u + B with a = g / K: two of six readings see a, all see B
    K = sensor.K
    expected = 0.01**2 * np.concatenate([K**4 / G**2 / 2.0, np.full(3, 1.0 / 6.0)])
    np.testing.assert_allclose(found, np.diag(expected), rtol=0, atol=1e-18)


def test_poses_that_do_not_show_the_parameters_are_refused():
    sensor = own_sensor(probe_sensor(), ("scale", "bias"))
    for directions in (np.eye(3), SPHERE[:5], np.tile([1.0, 0.0, 0.0], (9, 1))):
        with pytest.raises(GeometryError, match="do not show the parameters K_x"):
            bound(sensor, directions, tuple(range(3, 9)), False)
    with pytest.raises(GeometryError, match="S_yx"):
        bound(probe_sensor(), FACES, places_of(ALL), False)


@pytest.mark.parametrize("estimates", CLASSES)
def test_what_is_left_at_the_bound_is_the_mean_of_small_errors(estimates):
    # eq. (L2) through (L1) at the 2 p points that integrate a quadratic exactly
    sensor, places = probe_sensor(estimates), list(places_of(estimates))
    sensor = own_sensor(sensor, estimates)
    covariance = bound(sensor, SPHERE, tuple(places), False) / 1e4  # noise 1e-4
    root = np.linalg.cholesky(covariance * len(places))
    squares = []
    for step in (*root.T, *-root.T):
        values = sensor.parameters.copy()
        values[places] += step
        other = AccelerometerModel.from_parameters(values)
        squares.append(mean_square_left(other.matrix, other.B, sensor, G))
    expected = bound_left(sensor, covariance, tuple(places), G) ** 2
    # odd orders cancel: what is left is the square of steps of 1e-4, times ten
    assert np.mean(squares) == pytest.approx(expected, rel=1e-7, abs=0)


@pytest.mark.parametrize("seed", range(4))
def test_no_calibration_of_a_class_leaves_less(seed):
    rng = np.random.default_rng(seed)
    sensor = misaligned(rng, 0.2)
    least = least_left(sensor, places_of(("scale", "bias")), G)

    def left(values):  # by a simplex search, from far away
        return mean_square_left(np.diag(values[:3]), values[3:], sensor, G)

    found = [
        minimize(
            left,
            np.concatenate([rng.uniform(0.5, 1.5, 3), rng.uniform(-1, 1, 3)]),
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-13, "maxfev": 6000},
        ).fun
        for _ in range(2)
    ]
    # the search stops where a step changes no more than its own tolerance
    assert least**2 <= min(found) + 1e-12
    assert least**2 == pytest.approx(min(found), rel=1e-6, abs=0)
    only = mean_square_left(np.eye(3), sensor.B, sensor, G)
    assert least_left(sensor, places_of(("bias",)), G) ** 2 == pytest.approx(
        only, rel=1e-12, abs=0
    )
    assert least_left(sensor, places_of(ALL), G) == 0.0


@pytest.mark.parametrize(("directions", "known"), POSES)
@pytest.mark.parametrize("estimates", LESS)
def test_in_its_own_class_all_criteria_end_in_the_truth(estimates, directions, known):
    sensor = own_sensor(probe_sensor(estimates), estimates)
    places = places_of(estimates)
    found = pseudo_true(sensor, directions, places, g=G, known=known)
    assert len(found) == 5 if known else 3
    # differences of roundings near the least, over the condition of a few
    np.testing.assert_allclose(
        found, np.tile(sensor.parameters, (len(found), 1)), rtol=0, atol=1e-11
    )


@pytest.mark.parametrize(("directions", "known"), POSES)
def test_criteria_differ_in_second_order_of_the_misalignment(directions, known):
    places = places_of(("scale", "bias"))
    spread = []
    for size in (0.04, 0.02, 0.01, 0.005):
        values = probe_sensor().parameters
        values[:3] = size * np.array([0.6, -0.4, 1.0])
        sensor = AccelerometerModel.from_parameters(values)
        found = pseudo_true(sensor, directions, places, g=G, known=known)
        spread.append(np.ptp(found, axis=0).max())
    slopes = np.log2(np.array(spread[:-1]) / np.array(spread[1:]))
    # the next order is a share of 4 sizes or less
    assert np.all(np.abs(slopes - 2.0) < 0.2), slopes


def test_six_faces_without_noise_are_known_in_closed_form():
    # for faces: by the reading, half the difference of opposite faces; by the lengths,
    # the squared scales solve three linear equations, the columns of the inverse
    sensor = probe_sensor()
    found = pseudo_true(sensor, FACES, places_of(("scale", "bias")), g=G, known=True)
    inverse = np.linalg.inv(sensor.matrix)
    by_length = np.sqrt(np.linalg.solve((inverse**2).T, np.ones(3)))
    np.testing.assert_allclose(found[[0, 1, 4], 3:6] - by_length, 0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found[3, 3:6], sensor.K, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found[:, 6:] - sensor.B, 0, rtol=0, atol=1e-10)
