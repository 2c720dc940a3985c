"""Studies of the attitude error: orders, efficiency, limits, geometries, errata."""

from itertools import islice

import numpy as np
import pytest
from cells import answers, outcome
from errata.polynomials import INDICES, Q, R, U, X, isserlis, times
from oracles.attitude_errors import multiplicative_matrix, paper_fourth_terms

from simval.geometry import (
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.imu.attitude.kernel import raw_quaternion
from simval.studies import attitude_geometries, attitude_limits
from simval.studies.attitude import noise_shapes, random_geometry
from simval.studies.attitude_geometries import regular_geometries
from simval.theory import attitude as theory_of_attitude
from simval.theory import attitude_moments
from simval.theory.exact import flip_probability
from simval.theory.expansion import (
    complete_fourth_covariance,
    paper_fourth_covariance,
    quadratic_covariance,
    quadratic_form,
    scaled_error_moments,
    second_order_bias,
    second_order_covariance,
    tangent_projector,
)
from simval.theory.two_vector import (
    noise_covariances,
    true_vectors,
    two_vector_geometry,
)


def values(rows, statistic):
    return {r.predictor: r.value for r in rows if str(r.statistic) == statistic}


@pytest.mark.parametrize("noise", ["isotropic", "full", "tangent"])
@pytest.mark.parametrize("geometry", [1, 3, 5, 8, 11])
def test_every_formula_shows_its_order(geometry, noise):
    rows = outcome("attitude_order", geometry=geometry, noise=noise).rows
    assert answers(rows) == {"pass"}
    slopes = values(rows, "covariance_order")
    # orders 4 and 6 of a pure power; the study itself allows 0.2 for the next term
    assert slopes["order 4, source"] < 4.2 < 5.8 < slopes["order 4, complete"]


def test_a_formula_with_a_term_missing_fails(monkeypatch):
    # power: the complete fourth order without the terms of x2 is of second order
    monkeypatch.setattr(
        theory_of_attitude,
        "complete_fourth_covariance",
        lambda m: paper_fourth_covariance(m.q, m.P),
    )
    rows = outcome.__wrapped__("attitude_order", geometry=3).rows
    failed = [row for row in rows if "fail" in answers([row])]
    assert [row.predictor for row in failed] == ["order 4, complete"]


@pytest.mark.ci
def test_the_closed_form_costs_a_percent_or_two():
    rows = outcome("attitude_efficiency", geometries=120, trials=50).rows
    ratio = values(rows, "rms_ratio[combined,median]")["first order"]
    # not below the bound, and above it by the measured 1 to 2 % of the closed form
    assert 1.0 < ratio < 1.03


@pytest.mark.ci
def test_limits_depend_on_norm_over_noise_alone():
    # seven times the length of qbar moves the limit by a third at most: the constant
    # of (sigma/|qbar|)^2 depends on the geometry, its order of magnitude does not
    low, high = (
        outcome("attitude_limits", norm=norm, samples=4096).rows for norm in (0.1, 0.7)
    )
    for what in ("covariance,1%", "covariance,10%", "bias,1%"):
        a, b = (values(rows, f"limit_ratio[{what}]") for rows in (low, high))
        assert set(a) == {"order 2", "order 4, source", "order 4, complete"}
        for predictor in a:
            assert a[predictor] == pytest.approx(b[predictor], rel=0.33)
        # the complete fourth order holds to two and a half times the noise
        assert a["order 2"] > 1.3 * a["order 4, complete"]


@pytest.mark.ci
def test_limit_is_where_the_formula_is_off_by_that_much():
    rows = outcome("attitude_limits", norm=0.4, samples=4096).rows
    found = values(rows, "limit_ratio[bias,10%]")
    truth = attitude_limits.geometry_of_norm(0.4)
    for order, label in ((2, "order 2"), (4, "order 4, complete")):
        bias, exact = (
            attitude_moments(*truth, 0.4 / found[label], o, "plain").bias
            for o in (order, "exact")
        )
        off = np.linalg.norm(bias - exact) / np.linalg.norm(exact)
        # interpolated on a grid of 10 % in sigma: curvature of a power law is nil, the
        # next order bends it by a percent or two
        assert off == pytest.approx(0.1, rel=0.03)


@pytest.mark.parametrize("ratio", [0.7, 1.2, 1.6])
@pytest.mark.parametrize("std", [(1, 1, 1, 1), (0.3, 1, 0.5, 1), (1, 0.2, 1, 0.4)])
def test_flip_probability_against_monte_carlo(ratio, std):
    q, r1, r2 = attitude_limits.geometry_of_norm(0.35)
    noise = np.array(std) * 0.35 / ratio
    geometry = two_vector_geometry(q, r1, r2, "plain")
    chance = flip_probability(geometry, noise_covariances(noise))
    rng = np.random.default_rng(4)
    count = 200_000
    truth = true_vectors(q, r1, r2)[1].reshape(12, 1)
    vectors = truth + np.repeat(noise, 3)[:, None] * rng.standard_normal((12, count))
    flips = np.sum(geometry.q_true @ raw_quaternion(vectors, "plain") < 0)
    assert chance * count > 25
    z = (flips - count * chance) / np.sqrt(count * chance * (1 - chance))
    assert abs(z) < 4.4  # 1e-5 two-sided, nine cases


@pytest.mark.ci
def test_flips_are_judged_when_there_are_enough():
    rare = outcome("attitude_limits", ratio=6.0, samples=4096).rows
    often = outcome("attitude_limits", ratio=1.5, samples=100_000).rows
    assert answers(rare) == set()
    assert answers(often) == {"pass"}
    assert often[-1].value > rare[-1].value  # the share of other frames
    # no noise: no flips, and a flat density: a half
    g = two_vector_geometry(*attitude_limits.geometry_of_norm(0.3), "plain")
    assert flip_probability(g, noise_covariances(0.0)) == 0.0
    assert flip_probability(g, noise_covariances(50.0)) == pytest.approx(0.5, abs=1e-2)


def found(rows, predictor):
    return {
        "".join(r.statistic.entries) or r.statistic.family.name: r.value
        for r in rows
        if r.predictor == predictor
    }


# As an independent program found them over 500 other geometries: median and share
# nearer. A median of 500 has a standard error of 0.02 here, a share one of 0.022; four
# of them both ways.
@pytest.mark.ci
@pytest.mark.parametrize(
    ("noise", "frame", "median", "share"),
    [
        ("isotropic", "greatest", 1.69, 0.08),
        pytest.param("isotropic", "plain", 1.28, 0.31, marks=pytest.mark.slow),
        pytest.param("tangent", "greatest", 1.26, 0.01, marks=pytest.mark.slow),
        pytest.param("full", "greatest", 1.05, 0.44, marks=pytest.mark.slow),
    ],
)
def test_distributions(noise, frame, median, share):
    rows = outcome("attitude_geometries", noise=noise, frame=frame).rows
    source = found(rows, "order 4, source")
    assert source["median"] == pytest.approx(median, abs=0.1)
    assert source["nearer"] == pytest.approx(share, abs=0.09)
    assert source["least"] > 0.1  # never of higher order
    printed = found(rows, "eq. (63), as printed")
    assert printed["nearer"] == 1.0
    assert printed["most"] < 1.0
    assert answers(rows) == {"pass"}


def test_a_wrong_leading_term_fails(monkeypatch):
    # power: the source's terms alone, for all of them
    monkeypatch.setattr(
        attitude_geometries,
        "complete_fourth_covariance",
        lambda m: 1.001 * complete_fourth_covariance(m),
    )
    rows = outcome.__wrapped__("attitude_geometries", geometries=20).rows
    assert answers(rows) == {"fail"}


@pytest.mark.parametrize("noise", ["isotropic", "tangent", "full"])
def test_the_greatest_noise_is_one(noise):
    truth = random_geometry(3)
    for each, shape in ((True, (4,)), (False, ())):
        sizes = np.linalg.eigvalsh(noise_shapes(noise, 3, truth, each))[:, -1]
        greatest = sizes if each else sizes.max()
        np.testing.assert_allclose(greatest, np.ones(shape), rtol=1e-14)


@pytest.mark.parametrize("noise", ["isotropic", "tangent", "full"])
def test_the_squared_bias_stands_in_for_the_variance_along_q(noise):
    # q'(q - qhat) is half the squared length of the error, so its variance is half of
    # tr (Pi P Pi)^2; the linear covariance has none along q, and the squared bias has
    # (tr Pi P Pi)^2 / 4: with three eigenvalues, half to one and a half of it
    for number, truth, geometry in islice(regular_geometries("greatest"), 60):
        moments = scaled_error_moments(geometry, noise_shapes(noise, number, truth))
        q, P = moments.q, moments.P
        linear = second_order_covariance(q, P)
        along = q @ (complete_fourth_covariance(moments) - linear) @ q
        projected = tangent_projector(q) @ P @ tangent_projector(q)
        assert along == pytest.approx(0.5 * np.sum(projected**2), rel=1e-9)
        assert abs(q @ linear @ q) < 1e-12 * np.trace(linear)
        ratio = (q @ second_order_bias(q, P)) ** 2 / along
        assert 0.5 - 1e-12 < ratio < 1.5 + 1e-12


def evaluate(polynomial, q, P):
    values = {f"q{i + 1}": q[i] for i in range(4)}
    values |= {f"s{i + 1}{j + 1}": P[i, j] for i in range(4) for j in range(i, 4)}
    return sum(
        c * np.prod([values[n] for n in names]) for names, c in polynomial.items()
    )


def problem(seed=0):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((4, 4))
    return normalize(rng.standard_normal(4)), F @ F.T / 10, rng


def test_the_six_terms_are_the_moment_of_the_quadratic_error():
    # definition, with Terms 2 and 3 made symmetric, against the contraction in use
    q, P, _ = problem()
    terms = np.zeros((6, 4, 4))
    for i, j in INDICES:
        parts = [
            (0, times(U, U, X[i], X[j]), 1.0),
            (1, times(U, U, U, X[i], Q[j]), -1.5),
            (1, times(U, U, U, X[j], Q[i]), -1.5),
            (2, times(R, U, X[i], Q[j]), 0.5),
            (2, times(R, U, X[j], Q[i]), 0.5),
            (3, times(R, R, Q[i], Q[j]), 0.25),
            (4, times(U, U, R, Q[i], Q[j]), -1.5),
            (5, times(U, U, U, U, Q[i], Q[j]), 2.25),
        ]
        for k, polynomial, factor in parts:
            value = evaluate(isserlis(polynomial), q, P)
            terms[k, i - 1, j - 1] += factor * value
    # 50 to 350 products of numbers below 1
    np.testing.assert_allclose(paper_fourth_terms(q, P), terms, rtol=0, atol=1e-13)
    total = terms.sum(axis=0)
    mean = np.einsum("bcd,cd->b", quadratic_form(q), P)
    np.testing.assert_allclose(mean, second_order_bias(q, P), rtol=0, atol=1e-14)
    found = quadratic_covariance(q, P) + np.outer(mean, mean)
    np.testing.assert_allclose(found, total, rtol=0, atol=1e-13)


def test_composition_with_the_printed_scalar_breaks_the_multiplicative_error():
    # eq. (38) prints e1.e2 - q1 q2; then q^-1 * q = (0, -1), which contradicts (45)
    q, _, rng = problem(2)
    other = random_quaternions(1, rng)[0]
    right = compose(conjugate(q), other)
    np.testing.assert_allclose(
        right, -multiplicative_matrix(q) @ other, rtol=0, atol=1e-15
    )  # (47)
    e1, s1, e2, s2 = -q[:3], q[3], other[:3], other[3]
    printed_scalar = e1 @ e2 - s1 * s2
    assert printed_scalar == pytest.approx(-right[3], abs=1e-15)
