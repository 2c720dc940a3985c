"""Studies of the attitude error: orders, efficiency, limits, geometries, errata."""

import numpy as np
import pytest
from cells import answers, outcome
from errata.polynomials import INDICES, Q, R, U, X, isserlis, times
from oracles.attitude_errors import paper_fourth_terms

from simval.geometry import normalize
from simval.studies import attitude_limits
from simval.studies.attitude import noise_shapes, random_geometry
from simval.theory import attitude_moments
from simval.theory.expansion import (
    quadratic_covariance,
    quadratic_form,
    second_order_bias,
)


def values(rows, statistic):
    return {r.predictor: r.value for r in rows if str(r.statistic) == statistic}


@pytest.mark.parametrize("noise", ["isotropic", "full", "tangent"])
@pytest.mark.parametrize("geometry", [1, 3, 5, 8, 11])
def test_every_formula_shows_its_order(geometry, noise):
    rows = outcome("attitude_order", geometry=geometry, noise=noise).rows
    assert answers(rows) == {"pass"}
    slopes = values(rows, "covariance_order")
    # orders 4 and 6 of a pure power; the study itself allows 0.2 for the next term, so
    # a formula of the source's terms alone would fail as the complete one
    assert slopes["order 4, source"] < 4.2 < 5.8 < slopes["order 4, complete"]


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


@pytest.mark.parametrize("noise", ["isotropic", "tangent", "full"])
def test_the_greatest_noise_is_one(noise):
    truth = random_geometry(3)
    for each, shape in ((True, (4,)), (False, ())):
        sizes = np.linalg.eigvalsh(noise_shapes(noise, 3, truth, each))[:, -1]
        greatest = sizes if each else sizes.max()
        np.testing.assert_allclose(greatest, np.ones(shape), rtol=1e-14)


def evaluate(polynomial, q, P):
    values = {f"q{i + 1}": q[i] for i in range(4)}
    values |= {f"s{i + 1}{j + 1}": P[i, j] for i in range(4) for j in range(i, 4)}
    return sum(
        c * np.prod([values[n] for n in names]) for names, c in polynomial.items()
    )


def test_the_six_terms_are_the_moment_of_the_quadratic_error():
    # definition, with Terms 2 and 3 made symmetric, against the contraction in use
    rng = np.random.default_rng(0)
    F = rng.standard_normal((4, 4))
    q, P = normalize(rng.standard_normal(4)), F @ F.T / 10
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
