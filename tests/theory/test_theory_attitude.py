"""Moments of the attitude error: every formula by routes that know no closed form.

Power series differentiate the arithmetic that is written here, to rounding; cubature
takes the public estimator as a black box, and shows the order of what a formula leaves
out. A batch is its samples one by one.
"""

import doctest
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from places import ROOT
from random_attitudes import apart, full_covariances, geometry, plain_column
from rounding import EPS, relative

from simval.errors import GeometryError, InputError, RefusedError, SimvalError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.imu.attitude import case_quaternion, two_vector_quaternion, wahba_quaternion
from simval.imu.attitude.kernel import column_matrix, normalize_columns, raw_quaternion
from simval.moments import Moments
from simval.theory import (
    attitude_bound,
    attitude_moments,
    cubature_moments,
    exact,
    multiplicative_moments,
    sufficient_order,
    wahba_moments,
)
from simval.theory.attitude import BLOCK
from simval.theory.estimators import direct_covariance
from simval.theory.expansion import column_matrix as theory_columns
from simval.theory.series import series_moments
from simval.theory.sign_flips import flip_probability
from simval.theory.two_vector import (
    column_norms,
    noise_covariances,
    noise_of_samples,
    tangent_covariances,
    true_vectors,
    two_vector_geometry,
)

NOISES = {
    "isotropic": lambda vectors, rng: noise_covariances(1.0),
    "unequal": lambda vectors, rng: noise_covariances(
        np.linspace(0.2, 1.0, len(vectors)), len(vectors)
    ),
    "full": lambda vectors, rng: full_covariances(rng, 1.0),
    "tangent": lambda vectors, rng: tangent_covariances(vectors, 1.0),
    "together": lambda vectors, rng: correlated(rng, len(vectors)),
}


def correlated(rng, count):
    """A full covariance of the stacked vectors, greatest eigenvalue 1."""
    F = rng.standard_normal((3 * count, 3 * count))
    S = F @ F.T
    return S / np.linalg.eigvalsh(S)[-1]


# sigma, second order, eq. (63) as printed, the source's fourth, complete fourth
TABLE = [
    (0.0125, 6.16e-4, 4.14e-4, 1.15e-3, 1.5e-6),
    (0.025, 2.48e-3, 1.67e-3, 4.61e-3, 2.4e-5),
    (0.05, 1.03e-2, 6.8e-3, 1.87e-2, 4.2e-4),
]


@pytest.mark.parametrize("row", TABLE)
def test_relative_errors_of_the_covariance_table(row):
    """Of docs/attitude.md; its geometry: default_rng(3), q, then r1, then r2."""
    sigma, second, eq63, paper, complete = row
    rng = np.random.default_rng(3)
    q, r1, r2 = (normalize(rng.standard_normal(n)) for n in (4, 3, 3))
    truth = attitude_moments(q, r1, r2, sigma, "exact", "plain").covariance
    moments = {
        order: attitude_moments(q, r1, r2, sigma, order, "plain")
        for order in (2, "4-paper", 4)
    }
    found = [relative(m.covariance, truth) for m in moments.values()]
    found.append(relative(moments[2].second_moment, truth))
    # the table prints three digits (half a unit of the last: 0.5 %), two for the
    # complete fourth, whose last row also came from a fit (2.5 %)
    np.testing.assert_allclose(found, [second, paper, complete, eq63], rtol=0.03)
    np.testing.assert_allclose(found[:2], [second, paper], rtol=6e-3)


def unit(v):
    return v / np.sqrt(np.sum(v * v))


def plain(b1, b2, r1, r2):
    """The plain closed form in arithmetic alone."""
    s1, d1, d2 = (b1 + r1) / 2, (b1 - r1) / 2, (b2 - r2) / 2
    return unit(np.array([*np.cross(d1, d2), np.dot(s1, d2)]))


def of_unit_vectors(*vectors):
    return plain(*(unit(v) for v in vectors))


def combined(vectors, q_true):
    """The combined estimator from a fixed starting column."""
    greatest = int(np.argmax(np.abs(q_true @ theory_columns(*vectors))))

    def arithmetic(*noisy):
        M = theory_columns(*noisy)
        raw = M @ (M.T @ M[:, greatest])
        along = sum(raw[i].coefficients[0] * q_true[i] for i in range(4))
        return float(np.sign(along)) * unit(raw)

    return arithmetic


# frame, whether vectors are normalised, orders
SERIES = [("plain", False, (2, 4)), ("plain", True, (2,)), ("combined", False, (2,))]


@pytest.mark.parametrize(("frame", "normalized", "orders"), SERIES)
@pytest.mark.parametrize("kind", NOISES)
def test_closed_forms_equal_the_series_to_rounding(kind, frame, normalized, orders):
    q, vectors, rng = geometry(1, plain_column)
    q *= np.sign(q[:3] @ np.cross(*vectors[2:]))  # the sign of the plain formula
    noise = 0.03**2 * NOISES[kind](vectors, rng)
    for order in orders:
        found = attitude_moments(
            q, *vectors[2:], noise, order, frame, normalized=normalized
        )
        estimator = {
            "plain": of_unit_vectors if normalized else plain,
            "combined": combined(vectors, found.q_true),
        }[frame]
        series = series_moments(estimator, vectors, noise, order)
        # sums of some thousand rounded terms, amplified by 1/|qbar|^4 relative to a
        # leading term that has 1/|qbar|^2
        limit = 1000 * EPS / 0.15**2
        assert relative(found.bias, series.bias) < limit
        assert relative(found.covariance, series.covariance) < limit
        # power: without the shortened mean the bias is visibly another one
        raw = attitude_moments(q, *vectors[2:], noise, order, frame)
        if normalized and kind != "tangent":
            assert relative(raw.bias, series.bias) > 0.01


def problem_of(name, normalized=False):
    """An estimator as a black box, its vectors and truth, and its theory."""
    if name == "three pairs":
        return three_pairs()
    q, vectors, _ = geometry(30, plain_column)
    given = q, *vectors[2:]

    def estimate(*noisy):
        noisy = [normalize(v) for v in noisy] if normalized else noisy
        return two_vector_quaternion(*noisy, name, length_tolerance=np.inf)

    def moments(noise, order, **more):
        more |= {"normalized": True} if normalized else {}
        return attitude_moments(*given, noise, order, name, **more)

    return estimate, vectors, moments(1e-4, 2).q_true, moments


def three_pairs():
    """The public least squares of three weighted pairs."""
    rng = np.random.default_rng(5)
    q = random_quaternions(1, rng)[0]
    references = normalize(rng.standard_normal((3, 3)))
    body = references @ attitude_matrix(q).T
    weights = np.array([0.5, 1.0, 2.0])

    def estimate(*vectors):
        b, r = (np.stack(v, axis=-2) for v in (vectors[:3], vectors[3:]))
        found = wahba_quaternion(b, r, weights)
        return found * np.copysign(1.0, found @ q)[:, None]

    def moments(noise, order, **more):
        return wahba_moments(q, references, noise, weights, order, **more)

    return estimate, np.concatenate([body, references]), q, moments


def slopes_of(gaps):
    """Orders at which the bias and the covariance come nearer, noise being halved."""
    sizes = [
        [np.linalg.norm(getattr(a, what) - getattr(b, what)) for a, b in gaps]
        for what in ("bias", "covariance")
    ]
    return np.diff(np.log2(sizes), axis=1)[:, 0]


ORDERS = {2: 4.0, "4-paper": 4.0, 4: 6.0}
ALL = ("isotropic", "full", "tangent", "together")
# frame or pairs, whether vectors are normalised, orders, the smaller noise (small where
# noise would make another column the greatest), kinds of it
CASES = [
    ("plain", False, (2, "4-paper", 4), 0.01, ALL),
    ("x", False, (2, "4-paper", 4), 0.01, ["together"]),
    ("y", False, (2, "4-paper", 4), 0.01, ["full"]),
    ("z", False, (2, "4-paper", 4), 0.01, ["together"]),
    ("x", True, (2, 4), 0.01, ["full", "tangent", "together"]),
    ("combined", True, (2, 4), 0.009, ["full", "together"]),
    ("combined", False, (2, 4), 0.009, ALL),
    ("three pairs", False, (2, 4), 0.01, ["unequal", "together"]),
]


@pytest.mark.parametrize(
    ("kind", "case"), [(kind, case[:-1]) for case in CASES for kind in case[-1]]
)
def test_the_order_of_what_a_formula_leaves_out(kind, case):
    """And the exact moments are those of the cubature."""
    name, normalized, orders, level = case
    estimate, vectors, truth, predicted = problem_of(name, normalized)
    each = NOISES[kind](vectors, np.random.default_rng(1))
    if len(vectors) > 4:  # two exact references: twelve directions of noise for a rule
        first = 12 if kind == "together" else 4
        each = np.array(each)
        each[first:] = 0.0
        if kind == "together":
            each[:, first:] = 0.0
    found = {order: [] for order in orders}
    for sigma in (level, 2.0 * level):
        noise = sigma**2 * each
        degree = 9 if name == "plain" else 7
        cubature = cubature_moments(estimate, vectors, noise, truth, degree)
        for order in orders:
            found[order].append((predicted(noise, order), cubature))
    for order in orders:
        # of correlated vectors the next term bends a slope by 0.06 (measured); one that
        # is missing is 2 away
        np.testing.assert_allclose(
            slopes_of(found[order]), ORDERS[order], rtol=0, atol=0.07
        )
    if name in ("plain", "combined", "three pairs") and not normalized:
        oracle = predicted(noise, "exact")
        # degree 9 leaves (sigma/|qbar|)^8, with a sum of weights of 325; what is exact
        # for the combined estimator and for pairs is of degree 7
        limit = 325 * (0.06**8 if name == "plain" else 0.06**6)
        assert relative(oracle.covariance, cubature.covariance) < limit
        assert relative(oracle.bias, cubature.bias) < limit


def two_point_moments(estimator, vectors, truth, root, skewness):
    """Exact moments under skewed noise: all 4096 combinations of two values each."""
    wide = np.sqrt(skewness**2 + 4.0)
    values = (skewness + np.array([-wide, wide])) / 2.0
    chances = np.array([values[1], -values[0]]) / (values[1] - values[0])
    picks = (np.arange(4096)[:, None] >> np.arange(12)) & 1
    noise = (values[picks] @ root.T).reshape(4096, -1, 3)
    weights = chances[picks].prod(axis=1)
    error = truth - estimator(*(v + noise[:, i] for i, v in enumerate(vectors)))
    mean = weights @ error
    off = error - mean
    return Moments(bias=mean, covariance=(weights[:, None] * off).T @ off)


@pytest.mark.parametrize("name", ["plain", "combined", "three pairs"])
def test_third_moments_leave_the_fourth_order(name):
    """Correlated skewed noise of two values in each of twelve directions."""
    estimate, vectors, truth, predicted = problem_of(name)
    root = np.zeros((vectors.size, 12))
    root[:12] = np.random.default_rng(4).standard_normal((12, 12)) / 5.0
    S = 2.0 * np.einsum("ia,ja,ka->ijk", root, root, root)
    found = {(2, False): [], (3, False): [], (3, True): [], (4, True): []}
    for sigma in (0.002, 0.004):
        exactly = two_point_moments(estimate, vectors, truth, sigma * root, 2.0)
        for (order, skewed), off in found.items():
            third = sigma**3 * S if skewed else None
            noise = sigma**2 * root @ root.T
            off.append((predicted(noise, order, third_moments=third), exactly))
    for (_, skewed), off in found.items():
        # the next order bends a slope by its relative size, some ten times 0.004
        np.testing.assert_allclose(
            slopes_of(off), 4.0 if skewed else 3.0, rtol=0, atol=0.15
        )


@pytest.mark.ci
def test_combined_and_flips_of_large_noise_against_monte_carlo():
    """Correlated pairs, by this generator and the kernel's columns alone."""
    q, vectors, rng = geometry(2, plain_column)
    noise = 0.2**2 * correlated(rng, 4)
    found = attitude_moments(q, *vectors[2:], noise, "exact", "combined")
    plain = two_vector_geometry(q, *vectors[2:], "plain")
    draws = np.linalg.cholesky(noise) @ rng.standard_normal((12, 400_000))
    M = column_matrix(vectors.reshape(12, 1) + draws, symmetric=True)
    M = np.moveaxis(M, -1, 0).swapaxes(1, 2)  # columns last
    start = np.argmax(np.abs(column_norms(q, *vectors[2:])))
    raw = normalize(np.matvec(M @ M.swapaxes(1, 2), M[:, :, start]))
    error = found.q_true - raw * np.sign(np.mean(raw @ found.q_true))
    products = error[:, :, None] * error[:, None, :]
    sampled = np.concatenate([error.T, products[:, *np.triu_indices(4)].T])
    expected = np.append(found.bias, found.second_moment[np.triu_indices(4)])
    z = (sampled.mean(axis=1) - expected) / (sampled.std(axis=1) / np.sqrt(400_000))
    assert np.abs(z).max() < 4.5  # 14 of them: one false alarm in 1e4
    second = attitude_moments(q, *vectors[2:], noise, 2, "combined")
    power = sampled[4:].mean(axis=1) - second.second_moment[np.triu_indices(4)]
    assert np.abs(power / (sampled[4:].std(axis=1) / np.sqrt(400_000))).max() > 10.0
    along = normalize_columns(
        raw_quaternion(vectors.reshape(12, 1) + 2 * draws, "plain")
    )
    chance = flip_probability(plain, 4.0 * noise)
    share = np.mean(plain.q_true @ along < 0.0)
    assert abs(share - chance) < 4.5 * np.sqrt(chance / 400_000)
    apart_only = flip_probability(plain, 4.0 * blocks_of(noise))
    assert abs(share - apart_only) > 9.0 * np.sqrt(chance / 400_000)


def blocks_of(noise):
    """Covariances of each vector alone."""
    each = noise.reshape(4, 3, 4, 3)
    return np.stack([each[k, :, k] for k in range(4)])


def test_one_power_step_is_the_singular_vector_to_second_order():
    _, vectors, rng = geometry(3, apart)
    directions = rng.standard_normal((12, 400))
    off = []
    for sigma in (1e-3, 1e-2):
        noisy = vectors.reshape(12, 1) + sigma * directions
        M = np.moveaxis(column_matrix(noisy, symmetric=True), [0, 1, 2], [2, 1, 0])
        top = np.linalg.svd(M)[0][:, :, 0]
        batch = np.moveaxis(noisy.reshape(4, 3, -1), 2, 1)
        error = attitude_error(top, two_vector_quaternion(*batch, "combined"))
        off.append(np.sqrt(np.mean(error**2)))
    # the step shrinks a first-order error by (s2/s1)^2, of second order: slope 3
    assert np.log10(off[1] / off[0]) == pytest.approx(3.0, abs=0.1)


magnitudes = st.sampled_from([0.0, 5e-324, 1e-200, 1e-141, 1e-139, 1e-20, 1e-8, 1e-3])
noises = st.one_of(magnitudes, st.floats(0.0, 2e6))


@given(
    std=st.tuples(noises, noises, noises, noises),
    order=st.sampled_from([2, "4-paper", 4, "exact"]),
    seed=st.integers(0, 50),
)
@example(std=(1e-200,) * 4, order="exact", seed=0)
@example(std=(1e6,) * 4, order=4, seed=0)
def test_an_answer_is_finite_or_refused(std, order, seed):
    rng = np.random.default_rng(seed)
    q = random_quaternions(1, rng)[0]
    r1, r2 = normalize(rng.standard_normal((2, 3)))
    try:
        found = attitude_moments(q, r1, r2, std, order)
    except SimvalError:
        return
    assert np.isfinite(found.bias).all()
    assert np.isfinite(found.covariance).all()
    if order in (2, "4-paper", "exact"):  # the complete fourth order is not a square
        lowest = np.linalg.eigvalsh(found.covariance)[0]
        assert lowest >= -1e-9 * np.trace(found.covariance) - 1e-30


# The multiplicative error


def test_multiplicative_moments():
    # (53) and (64): against cubature of q^-1 * qhat itself
    q, vectors, rng = geometry(6, plain_column)
    q *= np.sign(q[:3] @ np.cross(*vectors[2:]))
    noise = full_covariances(rng, 0.005)

    def estimator(*v):
        raw = raw_quaternion(np.concatenate([x.T for x in v]), "plain").T
        return compose(conjugate(q), normalize(raw))

    truth = np.array([0.0, 0.0, 0.0, 1.0])
    found = cubature_moments(estimator, vectors, noise, truth)  # truth minus estimate
    predicted = attitude_moments(q, *vectors[2:], noise, 4, "plain")
    multiplicative = multiplicative_moments(predicted)
    # left out: (sigma/|qbar|)^4 relative, with a constant of some hundred
    limit = 300 * (0.005 / predicted.norm) ** 4
    assert relative(multiplicative.bias, -found.bias) < limit
    assert relative(multiplicative.covariance, found.covariance) < limit


@pytest.mark.parametrize("sigma", [1e-8, 1e-12, 1e-3])
def test_a_small_multiplicative_bias_keeps_its_digits(sigma):
    # subtracting the identity from (53) was 10 % off at 1e-8
    q, vectors, _ = geometry(6, plain_column)
    additive = attitude_moments(q, *vectors[2:], sigma, 2, "plain")
    found = multiplicative_moments(additive).bias
    expected = -compose(conjugate(additive.q_true), additive.bias)
    np.testing.assert_allclose(found, expected, rtol=0, atol=800 * EPS * sigma**2)


# Batches

FORMULAS = [
    *product((2, "4-paper", 4), (None, "plain", "x", "y", "z"), (False,)),
    *((2, "combined", some) for some in (False, True)),
    *((2, frame, True) for frame in (None, "plain")),
]


def random_batch(count, seed):
    """Geometries with every column above a hundredth, and full covariances."""
    rng = np.random.default_rng(seed)
    q, (r1, r2) = rng.standard_normal((count, 4)), rng.standard_normal((2, count, 3))
    norms = column_norms(*(normalize(v) for v in (q, r1, r2)))
    good = np.abs(norms).min(axis=1) > 0.01
    factors = 0.02 * rng.standard_normal((count, 4, 3, 3))
    return q[good], r1[good], r2[good], (factors @ factors.swapaxes(-1, -2))[good]


@pytest.mark.parametrize(("order", "frame", "normalized"), FORMULAS)
def test_a_sample_of_a_batch_is_the_single_one(order, frame, normalized):
    batch = random_batch(2 * BLOCK + 200, 1)
    many = attitude_moments(*batch, order, frame, normalized=normalized)
    turned = multiplicative_moments(many)
    ends = [0, BLOCK - 1, BLOCK, 2 * BLOCK - 1, 2 * BLOCK, len(batch[0]) - 1]
    for i in [*ends, *range(20, len(batch[0]), 200)]:
        given = (v[i] for v in batch)
        one = attitude_moments(*given, order, frame, normalized=normalized)
        # the same products in another order, 60 of them, over |qbar|^4 at the most
        limit = 60 * EPS
        assert relative(many.bias[i], one.bias) < limit / one.norm
        assert relative(many.covariance[i], one.covariance) < limit
        own = multiplicative_moments(one).covariance
        assert relative(turned.covariance[i], own) < limit
        np.testing.assert_array_equal(many.q_true[i], one.q_true)
        assert (many.frame[i], many.norm[i]) == (one.frame, one.norm)


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
    assert found.covariance.shape == (3, 2, 4, 4)
    assert found.norm.shape == found.frame.shape == (3, 2)
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
    monkeypatch.setattr(exact, "_WHITENED", ())
    with pytest.raises(RefusedError, match=r"^sample \(1,\): the quadrature"):
        attitude_moments(q[:2], r1[:2], r2[:2], 25.0 * noise, "exact")


def test_the_first_bad_sample_is_named():
    q, r1, r2, noise = random_batch(20, 8)
    parallel, singular, wrong, hole = r2.copy(), q.copy(), noise.copy(), q.copy()
    parallel[[3, 5]] = r1[[3, 5]]
    singular[4] = [0.0, 0.0, 0.0, 1.0]
    wrong[0], wrong[2] = np.eye(3), -1e-14 * np.eye(3)  # small beside the first
    levels, quiet, third = np.full((8, 4), 0.01), noise.copy(), np.zeros((4, 3, 3, 3))
    huge = levels.copy()
    levels[2], huge[2], quiet[2, 0], third[0, 0, 0, 0] = -0.01, 1e7, 0.0, 1e-9
    hole[6, 2] = np.nan
    near = GeometryError, r"^2 of \d+ .* sample \(3,\): .*apart"
    for arguments, options, (error, words) in (
        ((q, r1, parallel, noise), {}, near),
        ((q, r1, parallel, noise), {"frame": "combined"}, near),
        ((q, r1, parallel, noise), {"normalized": True}, near),
        (
            (singular, r1, r2, noise, 2, "plain"), {},
            (GeometryError, r"sample \(4,\): \|qbar\| is 0.00e\+00"),
        ),
        ((q, r1, r2, wrong), {}, (InputError, r"sample \(2,\): .*not a covariance")),
        ((q, r1, r2, levels), {}, (InputError, r"sample \(2,\): ")),
        ((q, r1, r2, huge), {}, (InputError, r"at index \(2, 0\)")),
        (
            (q, r1, r2, quiet, 3), {"third_moments": third},
            (InputError, r"^sample \(2,\): `third_moments`"),
        ),
        ((hole, r1, r2, noise), {}, (InputError, r"index \(6, 2\)")),
        ((q[:5], r1[:4], r2[:5], 0.01), {}, (InputError, "leading axes do not match")),
        (
            (q[:5], r1[:5], r2[:5], noise[:3]), {},
            (InputError, r"noise the leading axes \(3,\)"),
        ),
    ):  # fmt: skip
        with pytest.raises(error, match=words):
            attitude_moments(*arguments, **options)
    with pytest.raises(InputError, match=r"`q` has shape .* give one"):
        sufficient_order(q, r1, r2, 0.01)  # of one geometry
    for function, noises in (
        (attitude_bound, np.eye(12)),  # of vectors that are independent
        (sufficient_order, [[0.01], [0.02]]),  # of one noise
    ):
        with pytest.raises(InputError, match="`noise_std` has shape"):
            function(q[0], r1[0], r2[0], noises)


def test_a_bound_and_a_direct_covariance_of_each_of_a_batch():
    rng = np.random.default_rng(4)
    q, (r1, r2) = random_quaternions(5, rng), normalize(rng.standard_normal((2, 5, 3)))
    noise = noise_covariances([0.01, 0.02, 0.03, 0.0])
    found = attitude_bound(q, r1, r2, noise)
    for i in range(5):
        alone = attitude_bound(q[i], r1[i], r2[i], noise)
        np.testing.assert_array_equal(found.rotation[i], alone.rotation)
        np.testing.assert_array_equal(found.quaternion[i], alone.quaternion)
    axes = normalize(r1 + r2)  # in the plane of the references: singular
    q = np.concatenate([np.sin(0.4) * axes, np.full((5, 1), np.cos(0.4))], axis=1)
    found = direct_covariance(q, r1, r2, noise)
    for i in range(5):
        alone = direct_covariance(q[i], r1[i], r2[i], noise)
        np.testing.assert_array_equal(found[i], alone)
    with pytest.raises(GeometryError, match=r"sample \(2,\).* leaves the plane"):
        direct_covariance(q[[0, 1, 3, 3, 4]], r1, r2, 1.0)


def test_the_example_of_the_page():
    text = (ROOT / "docs/attitude.md").read_text()
    start = text.index("    >>> from simval.theory import attitude_moments, mult")
    lines = text[start : text.index("\n\n", start)] + "\n"
    q, r1, r2, _ = random_batch(6, 12)
    q, r1, r2 = (normalize(v) for v in (q, r1, r2))
    vectors = true_vectors(q, r1, r2)[1]
    names = {"b1": vectors[:, 0], "b2": vectors[:, 1], "r1": r1, "r2": r2, "n": len(q)}
    test = doctest.DocTestParser().get_doctest(lines, names, "page", None, 0)
    assert len(test.examples) >= 5
    assert doctest.DocTestRunner(verbose=False).run(test).failed == 0


# The bound


@pytest.mark.ci
def test_price_of_the_closed_form():
    """RMS error over the Cramer-Rao bound, which the q-method reaches."""
    ratios = []
    for seed in range(100):  # each has bounds of its own to keep
        q, vectors, _ = geometry(1000 + seed, apart)
        bound = np.trace(attitude_bound(q, *vectors[2:], 1.0).quaternion)
        frames = ("combined", None)
        found = [attitude_moments(q, *vectors[2:], 1.0, 2, f) for f in frames]
        sine = np.linalg.norm(np.cross(*vectors[2:]))
        # rounding is magnified by the inverse square of the sine
        price = np.trace(found[0].covariance) / bound
        assert price == pytest.approx(5.0 / (4.0 + sine**2), rel=1e-13 / sine**2)
        ratios.append([np.trace(m.covariance) / bound for m in found])
    _, best = np.sqrt(ratios).T
    # the paper's single column pays more, as it must: 1.25 in the median
    assert np.median(best) > 1.2


def test_tangent_noise_has_a_bound_and_all_columns_reach_it():
    """A unit vector's length carries no attitude; `best` pays for one frame alone."""
    rng = np.random.default_rng(7)
    q, (r1, r2) = (
        random_quaternions(40, rng),
        normalize(rng.standard_normal((2, 40, 3))),
    )
    vectors = np.stack(
        [np.matvec(attitude_matrix(q), r) for r in (r1, r2)] + [r1, r2], 1
    )
    noise = tangent_covariances(vectors, 1.0)
    bound = attitude_bound(q, r1, r2, noise).quaternion
    # rounding: the inverse of an information whose condition is the square of 1 / sine
    off = 1e-13 / np.sum(np.cross(r1, r2) ** 2, axis=1) ** 2
    # it is that of isotropic noise, whose part along the vectors says nothing
    same = attitude_bound(q, r1, r2, 1.0).quaternion
    assert np.all(np.abs(bound - same).max(axis=(1, 2)) < off)
    for frame, reached in (("combined", True), ("optimal", True), (None, False)):
        found = attitude_moments(q, r1, r2, noise, 2, frame).covariance
        assert np.all(np.abs(found - bound).max(axis=(1, 2)) < off) == reached
    none = noise.copy()
    none[:, 1] = 0.0
    with pytest.raises(InputError, match="across a vector"):
        attitude_bound(q, r1, r2, none)


@pytest.mark.parametrize("frame", ["combined", "optimal"])
def test_noise_along_the_vectors_turns_about_the_normal_alone(frame):
    """(K6) of docs/theory.md; the optimum normalises it away."""
    q, vectors, rng = geometry(5, apart)
    std = rng.uniform(0.5, 2.0, 4)
    along = std[:, None, None] ** 2 * vectors[:, :, None] * vectors[:, None, :]
    found = attitude_moments(q, *vectors[2:], along, 2, frame)
    covariance = 4.0 * multiplicative_moments(found).covariance[:3, :3]
    normal = np.cross(*vectors[:2])
    sine, cosine = np.linalg.norm(normal), vectors[0] @ vectors[1]
    variance = np.sum(std**2) / 4.0 * (cosine / sine) ** 2 * (frame == "combined")
    expected = variance * np.outer(normal, normal) / sine**2
    np.testing.assert_allclose(covariance, expected, rtol=0, atol=1e-13 / sine**4)


@pytest.mark.parametrize("order", [2, 4])
def test_the_optimum_has_the_moments_of_least_squares(order):
    q, vectors, rng = geometry(6, apart)
    noise = full_covariances(rng, 0.02)
    found = attitude_moments(q, *vectors[2:], noise, order, "optimal")
    other = wahba_moments(found.q_true, vectors[2:], noise, None, order)
    # two expansions of one estimator: rounding of sums of some thousand terms
    assert found.bias == pytest.approx(other.bias, rel=0, abs=1e-12 * 0.02**2)
    np.testing.assert_allclose(
        found.covariance, other.covariance, rtol=0, atol=1e-10 * 0.02**2
    )


def test_bound_equals_the_full_fisher_matrix():
    # All seven unknowns at once, by central differences of the measurements in other
    # coordinates: right factor of the quaternion, spherical angles of each vector.
    q, vectors, rng = geometry(4, apart)
    noise = full_covariances(rng, 0.02)
    angles = [(np.arccos(v[2]), np.arctan2(v[1], v[0])) for v in vectors[2:]]

    def quaternion(p):
        half = p[:3] / 2
        return compose(q, np.append(half, np.sqrt(1 - half @ half)))

    def model(p):
        A = attitude_matrix(quaternion(p))
        r = []
        for k, (theta, phi) in enumerate(angles):
            t, f = theta + p[3 + 2 * k], phi + p[4 + 2 * k]
            r.append([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)])
        return np.concatenate([A @ r[0], A @ r[1], *r])

    def jacobian(fun, h=1e-5):
        steps = h * np.eye(7)
        return np.stack([(fun(s) - fun(-s)) / (2 * h) for s in steps], axis=1)

    weight = np.zeros((12, 12))
    for i, S in enumerate(noise):
        weight[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.linalg.inv(S)
    J, Q = jacobian(model), jacobian(quaternion)
    expected = Q @ np.linalg.inv(J.T @ weight @ J) @ Q.T
    found = attitude_bound(q, *vectors[2:], noise).quaternion
    # central differences: h^2 = 1e-10, amplified by the conditioning of the weights
    assert relative(found, expected) < 1e-6


@pytest.mark.parametrize("which", ["first", "second", "plane"])
@pytest.mark.parametrize("shape", ["isotropic", "unequal", "full", "tangent"])
def test_the_direct_solution_has_its_covariance(which, shape):
    """By cubature of the public function, at a noise and at half of it."""
    rng = np.random.default_rng(11)
    r1, r2 = normalize(rng.standard_normal((2, 3)))
    axis = {"first": r1, "second": r2, "plane": normalize(r1 - 0.6 * r2)}[which]
    q = np.append(np.sin(0.6) * axis, np.cos(0.6))
    _, vectors, _ = true_vectors(q, r1, r2)

    def turns(*v):
        error = compose(conjugate(q), case_quaternion(*v, 0.1))
        return 2.0 * error[:, :3] * np.sign(error[:, 3:])

    covariances = NOISES[shape](vectors, rng)
    found = [
        cubature_moments(turns, vectors, s**2 * covariances, np.zeros(3), 5).covariance
        / s**2
        for s in (1e-3, 5e-4)
    ]
    # free of the next order, whose square is left: 1e-12, and rounding over s squared
    leading = (4.0 * found[1] - found[0]) / 3.0
    known = direct_covariance(q, r1, r2, covariances)
    assert relative(known, leading) < 1e-8
    # sizes of the terms: without the turn about the normal it is another one
    assert relative(known, leading - np.diag(np.diag(known))) > 0.1
    with pytest.raises(GeometryError, match="leaves the plane"):
        direct_covariance(compose(np.append(0.1 * np.cross(r1, r2), 1.0), q), r1, r2, 1)
