"""Moments of many geometries at once: the single ones, sample by sample."""

import doctest
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from random_attitudes import apart, full_covariances, geometry
from rounding import EPS, relative

from simval.attitude import two_vector_quaternion
from simval.consistency import rotation_error
from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import compose, normalize
from simval.streams import Streams
from simval.studies import attitude_vectors
from simval.studies.attitude_vectors import closed_form_square
from simval.theory import (
    attitude_bound,
    attitude_moments,
    cubature_moments,
    exact,
    multiplicative_moments,
    sufficient_order,
)
from simval.theory.attitude import BLOCK
from simval.theory.cubature import covariance_roots
from simval.theory.expansion import column_matrix, combined_moments, tangent_projector
from simval.theory.two_vector import (
    MIN_NORM,
    column_norms,
    noise_of_samples,
    true_vectors,
)

FORMULAS = [
    (order, frame, {})
    for order in (2, "4-paper", 4)
    for frame in (None, "plain", "x", "y", "z")
] + [
    (2, "combined", {}),
    (2, "combined", {"normalized": True}),
    (2, None, {"normalized": True}),
    (2, "plain", {"normalized": True}),
]


def random_batch(count, seed):
    """Geometries with every column above a hundredth, and full covariances."""
    rng = np.random.default_rng(seed)
    q, (r1, r2) = rng.standard_normal((count, 4)), rng.standard_normal((2, count, 3))
    norms = column_norms(*(normalize(v) for v in (q, r1, r2)))
    good = np.abs(norms).min(axis=1) > 0.01
    factors = 0.02 * rng.standard_normal((count, 4, 3, 3))
    return q[good], r1[good], r2[good], (factors @ factors.swapaxes(-1, -2))[good]


def check_samples(batch, formula, which):
    """Hold samples of a batch to the single calls."""
    order, frame, options = formula
    many = attitude_moments(*batch, order, frame, **options)
    for i in which:
        one = attitude_moments(*(v[i] for v in batch), order, frame, **options)
        # the same products in another order, 60 of them, over |qbar|^4 at the most
        limit = 60 * EPS
        assert relative(many.bias[i], one.bias) < limit / one.norm
        assert relative(many.covariance[i], one.covariance) < limit
        np.testing.assert_array_equal(many.q_true[i], one.q_true)
        assert (many.frame[i], many.norm[i]) == (one.frame, one.norm)


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_sample_of_a_batch_is_the_single_one(formula):
    batch = random_batch(2 * BLOCK + 200, 1)
    ends = [0, BLOCK - 1, BLOCK, 2 * BLOCK - 1, 2 * BLOCK, len(batch[0]) - 1]
    check_samples(batch, formula, [*ends, *range(20, len(batch[0]), 80)])


def test_the_forms_of_the_noise_are_told_by_their_last_axes():
    q, r1, r2, _ = random_batch(6, 3)
    q, r1, r2 = q[:4], r1[:4], r2[:4]
    std = np.array([0.01, 0.02, 0.03, 0.04])
    each = attitude_moments(q, r1, r2, std[:, None])  # one for each sample
    for_vectors = attitude_moments(q, r1, r2, std)  # one for each vector
    both = attitude_moments(q, r1, r2, np.tile(std, (4, 1)))
    np.testing.assert_array_equal(for_vectors.covariance, both.covariance)
    for i in range(4):
        one = attitude_moments(q[i], r1[i], r2[i], std[i])
        np.testing.assert_array_equal(each.covariance[i], one.covariance)
        full = std[i] ** 2 * np.tile(np.eye(3), (4, 1, 1))
        np.testing.assert_array_equal(
            attitude_moments(q[i], r1[i], r2[i], full).covariance, one.covariance
        )
    assert noise_of_samples(np.ones((5, 2, 4, 3, 3)) * np.eye(3)).shape[:2] == (5, 2)
    for shape in ((3,), (5, 3), (4, 3), (3, 3), (2, 3, 3)):
        with pytest.raises(InputError, match="one of each sample"):
            attitude_moments(q, r1, r2, np.full(shape, 0.01))


def test_leading_axes_broadcast():
    q, r1, r2, noise = random_batch(8, 4)
    found = attitude_moments(q[:3, None], r1[0], r2[:2], noise[0], 4)
    assert found.bias.shape == (3, 2, 4)
    assert found.covariance.shape == (3, 2, 4, 4)
    assert found.norm.shape == found.frame.shape == (3, 2)
    assert found.sd.shape == found.rms.shape == (3, 2, 4)
    one = attitude_moments(q[2], r1[0], r2[1], noise[0], 4)
    assert relative(found.covariance[2, 1], one.covariance) < 60 * EPS
    np.testing.assert_allclose(found.rms[2, 1], one.rms, rtol=60 * EPS)
    # one geometry, many noises
    levels = attitude_moments(q[0], r1[0], r2[0], np.array([[0.01], [0.02]]))
    assert relative(levels.covariance[1], 4 * levels.covariance[0]) < 60 * EPS
    assert levels.q_true.shape == (2, 4)
    empty = attitude_moments(np.ones((0, 4)), r1[0], r2[0], 0.01, "exact")
    assert empty.covariance.shape == (0, 4, 4)


def test_exact_moments_of_a_batch(monkeypatch):
    q, r1, r2, noise = random_batch(4, 6)
    noise = np.stack([0.01**2 * np.broadcast_to(np.eye(3), (4, 3, 3)), noise[1]])
    many = attitude_moments(q[:2], r1[:2], r2[:2], noise, "exact")
    for i in range(2):
        one = attitude_moments(q[i], r1[i], r2[i], noise[i], "exact")
        np.testing.assert_array_equal(many.covariance[i], one.covariance)
        np.testing.assert_array_equal(many.bias[i], one.bias)
    # a rule that is too coarse for the second, whose noise is not isotropic
    monkeypatch.setattr(exact, "_NODES", (3, 4))
    with pytest.raises(RefusedError, match=r"^sample \(1,\): the quadrature"):
        attitude_moments(q[:2], r1[:2], r2[:2], 25.0 * noise, "exact")


def test_a_multiplicative_batch():
    additive = attitude_moments(*random_batch(30, 7), 4)
    many = multiplicative_moments(additive)
    batch = random_batch(30, 7)
    for i in (0, 11):
        one = multiplicative_moments(attitude_moments(*(v[i] for v in batch), 4))
        assert relative(many.bias[i], one.bias) < 1e3 * EPS
        assert relative(many.covariance[i], one.covariance) < 60 * EPS


def test_the_first_bad_sample_is_named():
    q, r1, r2, noise = random_batch(20, 8)
    parallel = r2.copy()
    parallel[[3, 5]] = r1[[3, 5]]
    for options in ({}, {"frame": "combined"}, {"normalized": True}):
        with pytest.raises(GeometryError, match=r"^2 of \d+ .* sample \(3,\): .*apart"):
            attitude_moments(q, r1, parallel, noise, **options)
    singular = q.copy()
    singular[4] = [0.0, 0.0, 0.0, 1.0]
    with pytest.raises(GeometryError, match=r"sample \(4,\): \|qbar\| is 0.00e\+00"):
        attitude_moments(singular, r1, r2, noise, 2, "plain")
    wrong = noise.copy()
    wrong[2, 1] = -np.eye(3)
    with pytest.raises(InputError, match=r"sample \(2,\): .*not a covariance"):
        attitude_moments(q, r1, r2, wrong)
    hole = q.copy()
    hole[6, 2] = np.nan
    with pytest.raises(InputError, match=r"index \(6, 2\)"):
        attitude_moments(hole, r1, r2, noise)
    with pytest.raises(InputError, match=r"leading axes do not match"):
        attitude_moments(q[:5], r1[:4], r2[:5], 0.01)
    with pytest.raises(InputError, match=r"noise the leading axes \(3,\)"):
        attitude_moments(q[:5], r1[:5], r2[:5], noise[:3])


def test_a_small_sample_of_a_batch_is_checked_by_its_own_scale():
    # beside 1 a negative variance of 1e-14 would pass for rounding
    q, r1, r2, noise = random_batch(4, 9)
    noise[0], noise[1] = np.eye(3), -1e-14 * np.eye(3)
    with pytest.raises(InputError, match=r"sample \(1,\)"):
        attitude_moments(q, r1, r2, noise)


def test_what_takes_one_geometry_refuses_a_batch():
    q, r1, r2, _ = random_batch(4, 10)
    for function in (attitude_bound, sufficient_order):
        with pytest.raises(InputError, match=r"`q` has shape .* give one"):
            function(q, r1, r2, 0.01)
        with pytest.raises(InputError, match="`noise_std` has shape"):
            function(q[0], r1[0], r2[0], [[0.01], [0.02]])


def test_a_batch_against_cubature():
    """The public estimator as a black box, at the sixth order that is left out."""
    problems = [geometry(seed, apart) for seed in range(3)]
    noise = np.stack([full_covariances(rng, 0.005) for *_, rng in problems])
    q = np.stack([truth for truth, *_ in problems])
    vectors = np.stack([v for _, v, _ in problems])
    found = attitude_moments(q, vectors[:, 2], vectors[:, 3], noise, 4)
    for i in range(3):
        frame = str(found.frame[i])
        estimator = partial(two_vector_quaternion, frame=frame, length_tolerance=np.inf)
        measured = cubature_moments(estimator, vectors[i], noise[i], found.q_true[i], 7)
        left = 300 * (0.005 / found.norm[i]) ** 4
        assert relative(found.bias[i], measured.bias) < left
        assert relative(found.covariance[i], measured.covariance) < left


def combined_by_directions(vectors, q, noise):
    """(C1) to (C3) as sums over independent directions, one root for each vector."""
    M = column_matrix(*vectors)
    p = q @ M
    squared, projector = p @ p, tangent_projector(q)
    P, bent = np.zeros((4, 4)), np.zeros(4)
    for i, root in enumerate(covariance_roots(noise)):
        for direction in root.T:
            turned = [*vectors]
            turned[i] = direction  # M is linear in each vector of a pair
            turned[(i + 2) % 4] = np.zeros(3)
            change = column_matrix(*turned)
            moved = change @ p / squared
            P += np.outer(moved, moved)
            bent += change @ (change.T @ q) / squared - 2.0 * moved * (moved @ q)
    P = projector @ P @ projector
    return 0.5 * np.trace(P) * q - projector @ bent, P


@pytest.mark.parametrize("seed", range(4))
def test_combined_moments_by_independent_directions(seed):
    q, r1, r2, noise = (v[0] for v in random_batch(3, 20 + seed))
    q, vectors, _ = true_vectors(q, r1, r2)
    found = combined_moments(vectors, q, noise, np.zeros((4, 3)))
    expected = combined_by_directions(vectors, q, noise)
    for a, b in zip(found, expected, strict=True):
        # 200 products, over the square of |r1 x r2|
        assert relative(a, b) < 200 * EPS / np.linalg.norm(np.cross(r1, r2)) ** 2


def nees_rows():
    """Distances of the rows of normalised squares beyond their remainders."""
    parameters = attitude_vectors.Parameters(ratio=10.0, samples=8192)
    rows = attitude_vectors.run(parameters, Streams(3, (1,))).rows
    found = {str(row.statistic): row for row in rows if row.check == "nees"}
    return {
        name: (abs(row.value - row.prediction) - row.remainder) / row.standard_error
        for name, row in found.items()
    }


NAMES = {
    "nees[weighted]",
    "nees[equal weights]",
    "nees[combined]",
    "nees[best of four]",
}


@pytest.mark.ci
def test_a_covariance_that_is_wrong_is_not_its_own_remainder(monkeypatch):
    """Cubature sees the wrong one too, at any noise, so what falls is still small."""
    for name in ("closed_form_square", "normalised_square"):
        right = getattr(attitude_vectors, name)
        monkeypatch.setattr(
            attitude_vectors, name, lambda *given, right=right: 1.2 * right(*given)
        )
    found = nees_rows()
    assert set(found) == NAMES
    assert min(found.values()) > 10.0


def test_where_first_order_fails_a_covariance_is_not_judged():
    parameters = attitude_vectors.Parameters(ratio=100.0, samples=4096)
    rows = attitude_vectors.run(parameters, Streams(3, (1,))).rows
    checks = {str(row.statistic): (row.check, row.remainder) for row in rows}
    assert checks["nees[weighted]"][0] == checks["nees[best of four]"][0] == "nees"
    check, remainder = checks["nees[combined]"]
    assert check == "record"
    assert remainder > attitude_vectors.MOST_LEFT_OUT


def test_a_frame_that_is_singular_at_an_estimate_counts_nothing():
    setting = attitude_vectors.Setting(attitude_vectors.Parameters())
    r1, r2 = setting.references
    frame = setting.frames["best of four"]
    # a half turn about axis k leaves column k nothing, one about r1 the plain one
    place = ["x", "y", "z", "plain"].index(frame)
    empty = np.append(r1 if frame == "plain" else np.eye(3)[place], 0.0)
    assert abs(column_norms(empty, r1, r2)[place]) < MIN_NORM
    both = np.stack([setting.q, empty])
    error = np.full((2, 3), 1e-4)
    found = closed_form_square(both, error, setting.references, np.full(4, 0.01), frame)
    assert found[0] > 0.0
    assert found[1] == 0.0


def test_the_example_of_the_page():
    text = (Path(__file__).parents[2] / "docs/attitude.md").read_text()
    start = text.index("    >>> from simval.theory import attitude_moments, mult")
    example = text[start : text.index("\n\n", start)] + "\n"
    q, r1, r2, _ = random_batch(6, 12)
    q, r1, r2 = (normalize(v) for v in (q, r1, r2))
    vectors = true_vectors(q, r1, r2)[1]
    b1, b2 = vectors[:, 0], vectors[:, 1]
    names = {"b1": b1, "b2": b2, "r1": r1, "r2": r2, "n": len(q)}
    test = doctest.DocTestParser().get_doctest(example, names, "page", None, 0)
    assert len(test.examples) >= 5
    assert doctest.DocTestRunner(verbose=False).run(test).failed == 0


def test_a_turn_does_not_depend_on_the_sign_of_a_quaternion():
    rng = np.random.default_rng(11)
    q = normalize(rng.standard_normal(4))
    turns = rng.uniform(-1.5, 1.5, (50, 3))
    turns[0] = 0.0
    half = np.linalg.norm(turns, axis=1, keepdims=True) / 2.0
    part = turns / 2.0 * np.sinc(half / np.pi)
    estimates = compose(q, np.concatenate([part, np.cos(half)], axis=1))
    for sign in (1.0, -1.0, rng.choice([-1.0, 1.0], (50, 1))):
        found = rotation_error(sign * estimates, q)
        np.testing.assert_allclose(found, turns, rtol=0, atol=1e-14)
