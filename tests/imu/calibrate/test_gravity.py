"""Gravity of a place, and what its uncertainty does to a calibration."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from fits import (
    CASES,
    FIELD_STD,
    POSE_STD,
    Case,
    G,
    drawn,
    parameters,
    sd,
    taken,
)
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats
from true_sensor import MODEL

from simval.errors import InputError
from simval.imu.calibrate import (
    Recording,
    calibrate,
    load_calibration,
    local_gravity,
    save_calibration,
)
from simval.imu.calibrate import fit as fit_of
from simval.imu.calibrate.comparison import compare_calibrations
from simval.imu.calibrate.gravity import ANOMALY, RADIUS
from simval.poses import fibonacci_sphere

GM, OMEGA, FLAT = 3986004.418e8, 7292115e-11, 1.0 / 298.257223563


def exact_gravity(latitude, height):
    """Length of the gradient of the ellipsoid's potential, by differences of 40 digits.

    The potential in ellipsoidal coordinates (Heiskanen and Moritz 1967, eq. (2-62)),
    with the defining constants of WGS 84: no normal gravity, nor its slope, is in it.
    """
    with mpmath.workdps(40):
        a, omega = mpmath.mpf(RADIUS), mpmath.mpf(OMEGA)
        b = a * (1 - 1 / mpmath.mpf("298.257223563"))
        square = a**2 - b**2
        E = mpmath.sqrt(square)

        def q(u):
            return ((1 + 3 * u**2 / square) * mpmath.atan(E / u) - 3 * u / E) / 2

        def potential(rho, z):
            r = rho**2 + z**2 - square
            u = mpmath.sqrt((r + mpmath.sqrt(r**2 + 4 * square * z**2)) / 2)
            sine = z / u
            turned = omega**2 * a**2 / 2 * q(u) / q(b) * (sine**2 - mpmath.mpf(1) / 3)
            return (
                mpmath.mpf(GM) / E * mpmath.atan(E / u)
                + turned
                + (omega * rho) ** 2 / 2
            )

        phi = mpmath.radians(mpmath.mpf(latitude))
        across = a / mpmath.sqrt(1 - square / a**2 * mpmath.sin(phi) ** 2)
        rho = (across + height) * mpmath.cos(phi)
        z = (across * (b / a) ** 2 + height) * mpmath.sin(phi)
        slopes = [
            mpmath.diff(lambda x: potential(x, z), rho),
            mpmath.diff(lambda x: potential(rho, x), z),
        ]
        return float(mpmath.norm(slopes))


@given(latitude=st.floats(-89.9, 89.9), height=st.floats(-500.0, 9000.0))
@example(latitude=45.0, height=0.0)
@example(latitude=-89.9, height=9000.0)
def test_normal_gravity_is_that_of_the_ellipsoid(latitude, height):
    found, h = local_gravity(latitude, height), height / RADIUS
    exact = exact_gravity(latitude, height)
    # the constants have 11 digits; (GR2) leaves out the cube of the height, what the
    # flattening does to its square, and squares of flattening and rotation, which are
    # (3 f^2 + 3 m^2 + ...) h by Bruns' equation
    left = 4.0 * abs(h) ** 3 + 12.0 * FLAT * h**2 + 10.0 * FLAT**2 * abs(h)
    most = 3e-10 + 10.0 * left
    assert abs(found.g - exact) < most
    assert found.std == ANOMALY
    if height > 1000.0:  # power: without the square term it would not be
        assert most < 10.0 * 3.0 * h**2


@pytest.mark.parametrize(
    ("place", "word"), [((91.0, 0.0), "latitude"), ((0.0, 1e4), "height")]
)
def test_a_place_that_is_none_is_refused(place, word):
    with pytest.raises(InputError, match=word):
        local_gravity(*place)


NAMES = (
    "accelerometer, symmetric", "accelerometer, noise unknown", "magnetometer, upper",
    "gyroscope, joint", "gyroscope, generalised", "gyroscope, symmetric", "nine axes",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_gravity_is_in_the_scales_alone_and_wholly(name):
    """By fits that take another g, which know nothing of (GR3)."""
    case, step, std = CASES[name], 1e-4, 5e-3
    readings = taken(drawn(case, 1, np.random.default_rng(3)), 0)
    known, doubted = case.fit(readings), case.fit(readings, g_std=std)
    moved = parameters(case.fit(readings, g=G * (1.0 + step))) - parameters(known)
    # fits end within 1e-3 of an error bar
    slope, off = moved / step, 1e-3 * sd(known) / step
    more = doubted.covariance - known.covariance
    bars = np.sqrt(np.diagonal(more).clip(0.0)) * G / std
    np.testing.assert_array_less(np.abs(bars - np.abs(slope)), off + 1e-9 * bars)
    expected = np.outer(slope, slope) * (std / G) ** 2
    size = np.outer(sd(doubted), sd(doubted))
    near = np.add.outer(off, off) * np.add.outer(np.abs(slope), np.abs(slope))
    assert np.all(np.abs(more - expected) <= near * (std / G) ** 2 + 1e-12 * size)
    np.testing.assert_array_equal(parameters(doubted), parameters(known))


def test_a_known_accelerometer_brings_its_gravity_once():
    """Poses that took the same g know nothing of its error: parameters stay."""
    case = CASES["magnetometer, triangular"]
    given, other = (
        taken(drawn(case, 1, np.random.default_rng(seed)), 0) for seed in (1, 2)
    )
    found = []
    for std in (0.0, 0.05):
        own = calibrate(other["poses"], G, noise_std=POSE_STD, g_std=std)
        recording = Recording(
            poses=given["poses"], pose_std=POSE_STD, fields=given["fields"],
            field_std=FIELD_STD, g=G, g_std=std,
        )  # fmt: skip
        found.append(fit_of(recording, known=own).magnetometer)
    exact, doubted = found
    off = np.abs(doubted.parameters - exact.parameters)
    assert np.all(off < 1e-6 * exact.sd)  # rounding of a covariance less a part of it
    more = np.sqrt(np.diagonal(doubted.covariance - exact.covariance)[3:6])
    np.testing.assert_allclose(more, 0.05 / G * exact.parameters[3:6], rtol=1e-6)


def test_degrees_of_freedom_are_those_of_a_sum_of_variances():
    """Twice the square of a variance over its own variance, one part of it known."""
    poses = drawn(Case(("poses",)), 1, np.random.default_rng(0))["poses"][0]
    fit = calibrate(poses, G, g_std=1e-4)
    scatter, whole = fit.with_gravity(0.0).sd ** 2, fit.sd**2
    spread = 2.0 * scatter**2 / fit.dof  # of a variance from so many normal residuals
    np.testing.assert_allclose(fit.freedom, 2.0 * whole**2 / spread, rtol=1e-6)
    assert np.ptp(fit.freedom) > 1.0
    low, high = fit.intervals.T
    k = stats.t.ppf(0.975, fit.freedom)
    np.testing.assert_allclose((high - low) / 2.0, k * fit.sd, rtol=1e-9)


def test_with_gravity_and_back():
    fit = CASES["accelerometer, upper"].fit(
        taken(drawn(Case(("poses",)), 1, np.random.default_rng(0)), 0)
    )
    there = fit.with_gravity(3e-3)
    assert there.with_gravity(3e-3) is there
    back = there.with_gravity(0.0)
    np.testing.assert_allclose(back.sd, fit.sd, rtol=1e-9)
    with pytest.raises(InputError, match="g_std"):
        fit.with_gravity(-1.0)


STD = 2e-3


@pytest.mark.parametrize("known", [True, False])
def test_intervals_hold_where_gravity_is_drawn(known):
    """K's 95 % intervals, the g of each trial drawn; one seed in 1e4 is outside."""
    rng, trials, noise = np.random.default_rng(8), 2000, 1e-3
    g = G + STD * rng.standard_normal((trials, 1, 1))
    force = g * fibonacci_sphere(14)
    raw = MODEL.distort(force, rng) + noise * rng.standard_normal(force.shape)
    told = noise if known else None
    fit = calibrate(raw, G, noise_std=told, g_std=STD)
    low, high = np.moveaxis(fit.intervals, -1, 0)
    truth = MODEL.parameters
    held = np.sum((low < truth) & (truth < high), axis=0)
    far = stats.norm.isf(1e-4 / 9) * np.sqrt(trials * 0.95 * 0.05)
    # by t and Welch's degrees of freedom they are a little wide, as a rule
    assert np.all(held > 0.95 * trials - far)
    assert np.all(held < (0.95 if known else 0.96) * trials + far)
    # power: taken as exact, K's do not hold, and the others are the same
    exact = fit.with_gravity(0.0)
    low, high = np.moveaxis(exact.intervals, -1, 0)
    without = np.sum((low < truth) & (truth < high), axis=0)
    assert np.all(without[3:6] < 0.9 * trials)
    np.testing.assert_array_equal(without[[0, 1, 2, 6, 7, 8]], held[[0, 1, 2, 6, 7, 8]])


def made(path, g, std, rng, place=0.0):
    """A file by readings where gravity is off its stated g by so many deviations."""
    force = (g + place * std) * fibonacci_sphere(20)
    raw = MODEL.distort(force, rng) + 1e-4 * rng.standard_normal(force.shape)
    save_calibration(path, calibrate(raw, g, noise_std=1e-4, g_std=std))
    return path


def test_a_file_keeps_it(tmp_path):
    path = made(tmp_path / "a.json", G, STD, np.random.default_rng(0))
    fit = load_calibration(path)
    assert fit.g_std == STD
    assert np.all(fit.sd[3:6] > STD / G * np.abs(fit.K))


@pytest.mark.parametrize(
    ("places", "gs", "std", "drifted"),
    [
        ((0.0, 0.0), (G, 9.79), 0.0, False),  # both right
        ((1.0, -1.0), (G, 9.79), 0.0, True),  # wrong, and taken as exact
        ((1.0, -1.0), (G, 9.79), STD, False),  # wrong by what is stated
        ((1.0, -1.0), (G, G), STD, True),  # one place by its words, and two in truth
        ((1.0, 1.0), (G, G), STD, False),
    ],
)
def test_two_files_of_two_places_are_of_one_sensor(tmp_path, places, gs, std, drifted):
    rng = np.random.default_rng(4)
    a, b = (
        made(tmp_path / name, g, std or STD, rng, place)
        for name, g, place in zip("ab", gs, places, strict=True)
    )
    if not std:
        for path in (a, b):
            save_calibration(path, load_calibration(path).with_gravity(0.0))
    found = compare_calibrations(a, b)
    assert found.drifted is drifted
    said = " ".join(found.notes)
    assert ("its error is in both K" in said) == bool(std and gs[0] == gs[1])
    assert ("uncertainties are in those of K" in said) == bool(std and gs[0] != gs[1])
    assert ("a wrong g" in found.causes) == (not std)
    # the chance by the whole covariance, inverted as it stands
    (own,) = found.sensors
    V = own.a.covariance + own.b.covariance
    for state in (own.a, own.b):
        V = V + np.outer(*2 * [state.gravity * np.ones(9)])
    square = own.difference @ np.linalg.solve(V, own.difference)
    np.testing.assert_allclose(own.chi_square, square, rtol=1e-6)
    np.testing.assert_allclose(own.p_value, stats.chi2.sf(square, 9), rtol=1e-4)


def test_an_unknown_variance_beside_gravity_is_taken_as_such(tmp_path):
    """Type A bars: the p-value by draws of what the variance may be, (DC2)."""
    rng = np.random.default_rng(1)
    fits = []
    for name, g in (("a", G), ("b", 9.79)):
        path = made(tmp_path / name, g, STD, rng, 1.5 if name == "a" else -1.0)
        fit = load_calibration(path)
        fits.append(replace(fit, covariance_kind="type A"))
        save_calibration(path, fits[-1])
    (own,) = compare_calibrations(tmp_path / "a", tmp_path / "b").sensors
    A, B = (fit.with_gravity(0.0).covariance for fit in fits)
    C = sum(np.outer(fit.of_gravity, fit.of_gravity) for fit in fits)
    alpha, beta = (fit.dof / rng.chisquare(fit.dof, (4000, 1, 1)) for fit in fits)
    scale = 1.0 / np.sqrt(np.diagonal(A + B))
    V = (alpha * A + beta * B + C) * np.outer(scale, scale)
    d = own.difference * scale
    tails = stats.chi2.sf(np.vecdot(d, np.linalg.solve(V, d[:, None])[..., 0]), 9)
    error = 5.0 * tails.std() / np.sqrt(len(tails))
    np.testing.assert_allclose(own.p_value, tails.mean(), atol=error)
