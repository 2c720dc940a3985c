"""Every number of docs/theory.md, from the definitions by an exact quadrature."""

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs/theory.md"


def worked_geometry():
    """Quaternion and true vectors b1, b2, r1, r2 of the page's geometry."""
    generator = np.random.default_rng(3)
    q, r1, r2 = (generator.standard_normal(n) for n in (4, 3, 3))
    q, r1, r2 = (v / np.linalg.norm(v) for v in (q, r1, r2))
    e, s = q[:3], q[3]
    A = (s * s - e @ e) * np.eye(3) + 2 * np.outer(e, e)
    A -= 2 * s * np.cross(e, np.eye(3)).T  # v -> e x v
    return q, A @ r1, A @ r2, r1, r2


def nodes():
    """Three-point rule in nine variables: exact to degree five in each."""
    x, w = np.polynomial.hermite_e.hermegauss(3)
    grid = np.array(list(product(x, repeat=9))).T
    weights = np.array(list(product(w / w.sum(), repeat=9))).prod(axis=1)
    return grid.reshape(3, 3, -1), weights


@pytest.fixture(scope="module")
def terms():
    """q, weights and the terms of (O1), (O2) at the nodes for noise of one."""
    q, b1, b2, r1, r2 = worked_geometry()
    d1, s1, d2 = (b1 - r1) / 2, (b1 + r1) / 2, (b2 - r2) / 2
    truth = np.append(np.cross(d1, d2), s1 @ d2)
    norm = np.linalg.norm(truth)
    q = truth / norm
    (dd1, ds1, dd2), weights = nodes()
    dd1, ds1, dd2 = (v / np.sqrt(2) for v in (dd1, ds1, dd2))  # half of two vectors'
    col = (slice(None), None)

    def estimate(change):
        turned = np.cross((d1[col] + change * dd1).T, (d2[col] + change * dd2).T).T
        scalar = np.sum((s1[col] + change * ds1) * (d2[col] + change * dd2), axis=0)
        return np.vstack([turned, scalar])

    odd = (estimate(1.0) - estimate(-1.0)) / 2
    even = (estimate(1.0) + estimate(-1.0)) / 2 - truth[col]
    return q, weights, -odd / norm, -even / norm


def forms(q, x):
    """The four terms of (O1) at x."""
    u, r, q = q @ x, np.sum(x * x, axis=0), q[:, None]
    return (
        x - u * q,
        u * x + (r / 2 - 1.5 * u**2) * q,
        (1.5 * u**2 - r / 2) * x - (2.5 * u**3 - 1.5 * u * r) * q,
        (2.5 * u**3 - 1.5 * u * r) * x - (35 * u**4 - 30 * u**2 * r + 3 * r**2) / 8 * q,
    )


def polar(q, n, first, second):
    """n Q_n(first, ..., first, second): the part of Q_n linear in `second`."""
    # four points, so that the derivative of a polynomial up to degree four is exact
    steps = {1: 2 / 3, -1: -2 / 3, 2: -1 / 12, -2: 1 / 12}
    return sum(w * forms(q, first + h * second)[n - 1] for h, w in steps.items())


@pytest.fixture(scope="module")
def groups(terms):
    """The groups of the fourth order: covariances, and means along q."""
    q, weights, x1, x2 = terms

    def mean(left, right):
        half = (left * weights) @ right.T
        return (half + half.T) / 2

    e1, quadratic, cubic, quartic = forms(q, x1)
    flat = forms(q, x2)[0]
    m2 = quadratic @ weights
    covariances = [
        mean(quadratic, quadratic) - np.outer(m2, m2),
        2 * mean(e1, cubic),
        mean(flat, flat),
        2 * mean(flat, quadratic),
        2 * mean(e1, polar(q, 2, x1, x2)),
    ]
    means = [quartic, polar(q, 3, x1, x2), forms(q, x2)[1]]
    return q, mean(e1, e1), m2, covariances, [q @ (m @ weights) for m in means]


def printed(heading):
    """The numbers of the last or only numeric column under a heading, by row."""
    section = PAGE.read_text().split(f"## {heading}")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("|")]
    hits = [re.findall(r"\| \**([+−]\d+\.\d\d)\** \|", line) for line in rows]
    return [float(hit[0].replace("−", "-")) for hit in hits if hit]


def test_the_groups_of_the_page(groups):
    _, _, _, covariances, means = groups
    traces = [np.trace(c) for c in covariances]
    right = [*traces, sum(traces), *means, sum(means)]
    assert printed("6. ") == [pytest.approx(v, abs=0.005) for v in right]  # two digits


def test_unit_length_order_by_order(groups):
    q, C2, m2, covariances, means = groups
    assert np.trace(C2) == pytest.approx(2 * q @ m2, rel=1e-13)  # rounding
    C4 = sum(covariances)
    assert np.trace(C4) + m2 @ m2 == pytest.approx(2 * sum(means), rel=1e-12)
    # the direction of the bias, and the variance along q
    assert q @ m2 == pytest.approx(np.trace(C2) / 2, rel=1e-13)
    assert q @ C4 @ q == pytest.approx(np.trace(C2 @ C2) / 2, rel=1e-12)


def test_sentences_with_numbers(groups):
    q, C2, m2, covariances, _means = groups
    C4, kept = sum(covariances), covariances[0]
    page = " ".join(PAGE.read_text().split())
    for words, value in (
        ("What is left out, −{:.2f}", np.trace(kept - C4)),
        ("here its error is {:.2f} times", norm(C4 - kept) / norm(C4)),
        ("8.96 + {:.2f} = 25.21", m2 @ m2),
        ("+{:.2f} is missing", np.trace(C2 @ C2) / 2),
        ("and +{:.2f} is added", (q @ m2) ** 2),
        ("falls to {:.2f} of that of $C_2$", norm(C4 - np.outer(m2, m2)) / norm(C4)),
    ):
        assert words.format(value) in page


def norm(matrix):
    return np.linalg.norm(matrix)


def test_closed_forms_of_the_page(groups, terms):
    """The formulas in the page's table of groups, written out, are those means."""
    q, weights, x1, x2 = terms
    _, _, _, covariances, _ = groups
    P, V = (x1 * weights) @ x1.T, (x2 * weights) @ x2.T
    G = np.einsum("an,bn,cn,n->abc", x2, x1, x1, weights)
    Pi, Q, one = np.eye(4) - np.outer(q, q), np.eye(4) - 3 * np.outer(q, q), np.eye(4)
    T = [(np.outer(b, q) + np.outer(q, b)) / 2 + (b @ q) / 2 * Q for b in one]
    T = np.array(T)
    a, t = q @ P @ q, np.trace(P)
    inner = (15 * a - 3 * t) * q - 6 * P @ q
    D = 3 * np.outer(q, P @ q) - P + (3 * a - t) / 2 * one - np.outer(inner, q) / 2
    halves = [
        np.einsum("aij,jk,bkl,li->ab", T, P, T, P),
        Pi @ P @ D,
        Pi @ V @ Pi / 2,
        np.einsum("ac,cde,bde->ab", Pi, G, T),
        2 * np.einsum("ac,dce,bed->ab", Pi, G, T),
    ]
    for half, group in zip(halves, covariances, strict=True):
        whole = half + half.T
        assert whole == pytest.approx(group, abs=1e-12 * norm(group) * 10)
