"""Density of the two-vector estimate, against exact moments and simulation."""

import numpy as np
import pytest
import scipy
from rounding import relative

from simval.errors import InputError, RefusedError
from simval.geometry import attitude_matrix, compose, conjugate, normalize
from simval.imu.attitude.kernel import normalize_columns, raw_quaternion
from simval.theory import attitude_density, attitude_moments, multiplicative_moments
from simval.theory.two_vector import noise_covariances

R1, R2 = np.array([1.0, 0.0, 0.0]), normalize(np.array([0.3, 1.0, 0.2]))


def attitude_at(norm):
    """An attitude whose plain |qbar| is the given one: half a turn of 0.6 rad."""
    normal = np.cross(R1, R2)
    sine = norm / np.linalg.norm(normal) / np.sin(0.6)
    normal = normalize(normal)
    within = np.array([0.5, 0.6, -0.3])
    within = normalize(within - (within @ normal) * normal)
    axis = sine * normal + np.sqrt(1.0 - sine**2) * within
    return np.append(np.sin(0.6) * axis, np.cos(0.6))


def sphere(count):
    """A product rule on the unit quaternions."""
    x, w = np.polynomial.legendre.leggauss(count)
    angle, weight = 0.5 * np.pi * (x + 1.0), 0.5 * np.pi * w
    phi = np.pi * np.arange(2 * count) / count
    psi, theta, phi = np.meshgrid(angle, angle, phi, indexing="ij")
    outer = np.multiply.outer(weight * np.sin(angle) ** 2, weight * np.sin(angle))
    ring = np.sin(psi) * np.sin(theta)
    points = np.stack(
        [ring * np.cos(phi), ring * np.sin(phi), np.sin(psi) * np.cos(theta),
         np.cos(psi)], axis=-1,
    )  # fmt: skip
    weights = np.broadcast_to((outer * np.pi / count)[..., None], psi.shape)
    return points.reshape(-1, 4), weights.ravel()


@pytest.mark.slow
@pytest.mark.parametrize("shared", [0.0, 0.03])
def test_its_moments_are_the_exact_ones(shared):
    q, noise = attitude_at(0.2), noise_covariances(0.3)
    noise = noise * np.linspace(0.5, 1.0, 4)[:, None, None]
    noise[0, 0, 1] = noise[0, 1, 0] = 0.02  # neither equal nor isotropic
    if shared:  # b2 with b1, and r2 with b1
        joint = scipy.linalg.block_diag(*noise)
        joint[3:6, :3] = joint[:3, 3:6] = shared * np.eye(3)
        joint[9:, :3] = joint[:3, 9:] = np.diag([0.01, -0.02, 0.01])
        noise = joint
    density = attitude_density(q, R1, R2, noise, "plain")
    points, weights = sphere(14)
    # each attitude twice on the whole sphere
    mass = 0.5 * weights * density(points)
    assert mass.sum() == pytest.approx(1.0, abs=2e-3)
    # E[qhat qhat'], from the moments of q - qhat or from simulation
    if shared:
        root = np.linalg.cholesky(noise)
        x = root @ np.random.default_rng(6).standard_normal((12, 500_000))
        A = attitude_matrix(q)
        vectors = np.concatenate([A @ R1, A @ R2, R1, R2])[:, None] + x
        found = normalize_columns(raw_quaternion(vectors, "plain")).T
        second = found.T @ found / len(found)
    else:
        exact = attitude_moments(q, R1, R2, noise, "exact", "plain")
        mean = exact.q_true - exact.bias
        second = exact.covariance + np.outer(mean, mean)
    # five standard errors of a simulated square are 3e-3
    limit = 5e-3 if shared else 2e-3
    assert relative((mass[:, None] * points).T @ points, second) < limit


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_coverage_of_its_regions(ratio):
    """By vectors drawn with 1.5 times the noise and weighed by the two noises' ratio,
    so that what a region of 99.999 % leaves out is among them."""
    sigma, count, scale = 0.1, 6000, 1.5
    q = attitude_at(ratio * sigma)
    A = attitude_matrix(q)
    vectors = np.concatenate([A @ R1, A @ R2, R1, R2])[:, None]
    x = scale * np.random.default_rng(5).standard_normal((12, count))
    found = normalize_columns(raw_quaternion(vectors + sigma * x, "plain")).T
    exponent = 0.5 * (scale**-2 - 1.0) * np.sum(x * x, axis=0)
    weights = scale**12 * np.exp(exponent)
    density = attitude_density(q, R1, R2, sigma, "plain")
    for share in (0.5, 0.9, 0.99, 0.999, 0.99999):
        left = np.where(density.contains(found, share), 0.0, weights)
        stated = np.interp(1.0 - share, density.outside, density.error)
        assert stated < 0.2 * (1.0 - share)
        # four standard errors; the level of 2048 plain draws is 13 times and more off
        error = 4.0 * np.hypot(left.std() / np.sqrt(count), stated)
        assert left.mean() == pytest.approx(1.0 - share, abs=error)
    if ratio:  # the ellipsoid of the covariance does not cover
        moments = attitude_moments(q, R1, R2, sigma, 2, "plain")
        C = 4.0 * multiplicative_moments(moments).covariance[:3, :3]
        turn = compose(conjugate(moments.q_true), found)
        turn = 2.0 * turn[:, :3] * np.sign(turn[:, 3:])
        square = np.vecdot(turn, np.linalg.solve(C, turn.T).T)
        beyond = square > 11.345  # chi-square of 3, 99 %
        assert np.average(beyond, weights=weights) > 0.02


def test_noise_that_has_no_density_is_refused():
    q = attitude_at(0.2)
    with pytest.raises(InputError, match="without noise"):
        attitude_density(q, R1, R2, [0.1, 0.0, 0.1, 0.0])
    same = np.kron(np.ones((2, 2)), 0.01 * np.eye(3))  # on b1 and b2
    same = scipy.linalg.block_diag(same, 0.0 * same)
    with pytest.raises(InputError, match=r"without noise.* of its own"):
        attitude_density(q, R1, R2, same)
    with pytest.raises(InputError, match=r"has shape \(11, 11\).* one \(12, 12\)"):
        attitude_density(q, R1, R2, np.eye(11))


@pytest.mark.parametrize("sigma", [1e-3, 1e-4, 1e-6])
def test_noise_that_no_rule_resolves_is_refused(sigma):
    # at 1e-4 two rules agree, because both have no node where the density is
    with pytest.raises(RefusedError, match="two rules for the density"):
        attitude_density(attitude_at(0.2), R1, R2, sigma)


@pytest.mark.slow
def test_attitudes_without_an_axis_are_answered():
    # e = 0, where (D2) is infinite, is the identity in the plain frame and a half turn
    # in others; of a regular frame half turns have next to nothing, on which no two
    # rules agree; the truth is 0.12 rad from the identity, about as the noise is
    q = np.array([0.05, 0.02, 0.03, 0.99])
    for frame in ("plain", None):
        density = attitude_density(q, R1, R2, 0.05, frame)
        held = density.contains(np.eye(4), 0.9)
        assert held.tolist() == [False, False, False, True]
        for rare in (1e-13, 1.0 - 1e-13):  # none of the draws is so rare
            with pytest.raises(RefusedError, match="the level of its region"):
                density.contains(np.eye(4), rare)
