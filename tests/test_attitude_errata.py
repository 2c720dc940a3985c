"""The source's printed formulas, term by term: which are right, and which are not.

The element tables of Peng and Choukroun's section 5 are in
`data/peng_choukroun_terms.txt` as printed. The definitions they expand are expanded
here by polynomial algebra and Isserlis' theorem on integers, exactly, so every
difference is a misprint (or a loss of the text extraction), and the lists below are
complete for what is legible. `docs/errata.md` explains them.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from oracles.attitude_errors import multiplicative_matrix, paper_fourth_terms
from rounding import EPS

from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    normalize,
    random_quaternions,
)
from simval.theory.orders import (
    quadratic_covariance,
    quadratic_form,
    second_order_bias,
)

DATA = Path(__file__).parent / "data" / "peng_choukroun_terms.txt"


def printed():
    tables, name = {}, ""
    for line in DATA.read_text().splitlines():
        if line.startswith("["):
            name = line[1:-1]
            tables[name] = []
        elif not line.startswith("#"):
            tables[name].append(line)
    return tables


def parse(text):
    """A sum of products as {sorted factors: coefficient}; s1^2 is the variance s11."""
    total, depth, start = Counter(), 0, 0
    pieces = []
    for i, ch in enumerate(text + "+"):
        depth += (ch == "(") - (ch == ")")
        if ch == "+" and depth == 0:
            pieces.append(text[start:i])
            start = i + 1
    for piece in pieces:
        head, _, tail = piece.partition("(")
        number, names = re.fullmatch(r"(\d*?)((?:[qxs]\d+(?:\^\d)?)*)", head).groups()
        factors = []
        for kind, index, power in re.findall(r"([qxs])(\d+)(?:\^(\d))?", names):
            count = int(power or 1)
            if kind == "s":
                count //= 3 - len(index)  # s1^2 is one covariance, s12 is one too
                index = "".join(sorted(index * (3 - len(index))))
            factors += [kind + index] * count
        inner = parse(tail[:-1]) if tail else {(): 1}
        for names, value in inner.items():
            total[tuple(sorted([*factors, *names]))] += int(number or 1) * value
    return total


def times(*polynomials):
    result = Counter({(): 1})
    for polynomial in polynomials:
        product = Counter()
        for a, x in result.items():
            for b, y in polynomial.items():
                product[tuple(sorted(a + b))] += x * y
        result = product
    return result


def gaussian_mean(polynomial):
    """Isserlis: the mean of x_a x_b x_c x_d is the sum over the three pairings."""
    total = Counter()
    for names, value in polynomial.items():
        a, b, c, d = (name[1] for name in names if name[0] == "x")
        rest = [name for name in names if name[0] != "x"]
        for pairs in ((a + b, c + d), (a + c, b + d), (a + d, b + c)):
            moments = ["s" + "".join(sorted(pair)) for pair in pairs]
            total[tuple(sorted(rest + moments))] += value
    return total


Q = {i: Counter({(f"q{i}",): 1}) for i in range(1, 5)}
X = {i: Counter({(f"x{i}",): 1}) for i in range(1, 5)}
U = Counter({(f"q{i}", f"x{i}"): 1 for i in range(1, 5)})  # q'x
R = Counter({(f"x{i}", f"x{i}"): 1 for i in range(1, 5)})  # x'x
INDICES = [(i, j) for i in range(1, 5) for j in range(1, 5)]


def corrected(items, corrections):
    """Replace each printed item as often as stated, and demand that it was there."""
    items = list(items)
    for wrong, (right, count) in corrections.items():
        for _ in range(count):
            if wrong:
                items.remove(wrong)
            items.append(right)
    return sum((parse(item) for item in items if item), Counter())


def elements(items):
    return {(int(i[0]), int(i[1])): parse(i[4:]) for i in items}


def test_products_of_term_1():
    found = elements(printed()["term 1, products of x"])
    wrong = {ij for ij, p in found.items() if p != times(U, U, X[ij[0]], X[ij[1]])}
    assert len(found) == 11
    assert wrong == {(2, 4)}
    assert found[2, 4] == found[2, 3]  # the neighbour, printed twice


# printed: (right, how often)
TERM_1 = {
    "2q3q4(s3^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", 1),
    "3q2^2s2^2s23+3q4^2s4^2s24": ("3q2^2s2^2s24+3q4^2s4^2s24", 2),
    "2q3q4(s2^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", 1),
    "2q3q4(s2^2s24+2s23s34)": ("2q3q4(s3^2s24+2s23s34)", 1),
    "2q3q4(s4^2s23+2s24s34)": ("2q3q4(s4^2s13+2s14s34)", 2),
}


def test_moments_of_term_1():
    items = printed()["term 1, moments"]
    right = sum((gaussian_mean(times(U, U, X[i], X[j])) for i, j in INDICES), Counter())
    assert corrected(items, TERM_1) == right
    assert corrected(items, {}) != right


def test_products_of_term_2_are_a_symmetric_copy():
    # E{u^3 x q'} is not symmetric, and the table is: below the diagonal it repeats
    # what stands above
    found = elements(printed()["term 2, products of x"])
    assert len(found) == 13
    for (i, j), polynomial in found.items():
        low, high = min(i, j), max(i, j)
        assert polynomial == times(U, U, U, X[low], Q[high])
        assert i == j or polynomial != times(U, U, U, X[high], Q[low])


_PAIRS = "(s12s34+s13s24+{})".format
TERM_2 = {
    f"6{factor}{_PAIRS('s12s34')}": (f"6{factor}{_PAIRS('s14s23')}", count)
    for factor, count in {
        "q2^2q3q4": 2,
        "q1q2q3q4": 3,
        "q2q3^2q4": 2,
        "q1q3^2q4": 2,
        "q2q3q4^2": 2,
        "q1q3q4^2": 2,
        "q1q2q4^2": 2,
    }.items()
} | {
    "9q2^2q3q4(s2^2s34+2s23s24)": ("6q2^2q3q4(s2^2s34+2s23s24)", 1),
    "3q1q3^3(s13s3^2+2s13s23)": ("3q1q3^3(s12s3^2+2s13s23)", 2),
    "3q2q3q4^2(s2^2s4^2+2s12^2)": ("3q2q3q4^2(s2^2s4^2+2s24^2)", 2),
    # the coefficients of these two neighbours are exchanged
    "6q2^2q3q4(s2^2s3^2+2s23^2)": ("3q2^2q3q4(s2^2s3^2+2s23^2)", 2),
    "3q2q3q4^2(s24s3^2+2s23s34)": ("6q2q3q4^2(s24s3^2+2s23s34)", 2),
    # not in the extracted text: a last line of element 33 or 44
    "": ("6q1q2q3q4(s12s34+s13s24+s14s23)", 1),
}


def test_moments_of_term_2():
    items = printed()["term 2, moments"]
    right = sum(
        (gaussian_mean(times(U, U, U, X[min(i, j)], Q[max(i, j)])) for i, j in INDICES),
        Counter(),
    )
    assert corrected(items, TERM_2) == right


def test_moments_of_term_3():
    found = elements(printed()["term 3, moments"])
    assert len(found) == 14
    wrong = {
        ij
        for ij, p in found.items()
        if p != gaussian_mean(times(R, X[ij[0]], X[ij[1]]))
    }
    assert wrong == {(4, 1), (1, 4), (3, 2)}
    # (3, 2) only lacks two items of its transpose, which is right
    lost = found[2, 3] - found[3, 2]
    assert lost == parse("3s3^2s23+s4^2s23")
    assert not found[3, 2] - found[2, 3]


def test_moments_of_term_4():
    right = gaussian_mean(times(R, R))
    items = printed()["term 4, moments"]
    fix = {"3s1^2+3s2^2+3s3^2+3s4^2": ("3s1^4+3s2^4+3s3^4+3s4^4", 1)}
    assert corrected(items, fix) == right


TERM_6 = {
    "12q1q3^3s2^2s12": ("12q1q2^3s2^2s12", 1),
    "12q1q3^2s3^2s13": ("12q1q3^3s3^2s13", 1),
    "24(s12s34+s13s24+s14s23)": ("24q1q2q3q4(s12s34+s13s24+s14s23)", 1),
    # printed as an item with an open bracket, 12q2q3^2q4(s3^2s24
    "": ("12q2^3q4s2^2s24", 1),
}


def test_moments_of_term_6():
    right = gaussian_mean(times(U, U, U, U))
    assert corrected(printed()["term 6, moments"], TERM_6) == right


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
            value = evaluate(gaussian_mean(polynomial), q, P)
            terms[k, i - 1, j - 1] += factor * value
    # 50 to 350 products of numbers below 1
    np.testing.assert_allclose(paper_fourth_terms(q, P), terms, rtol=0, atol=1e-13)
    total = terms.sum(axis=0)
    mean = np.einsum("bcd,cd->b", quadratic_form(q), P)
    np.testing.assert_allclose(mean, second_order_bias(q, P), rtol=0, atol=1e-14)
    found = quadratic_covariance(q, P) + np.outer(mean, mean)
    # six terms of up to 350 products of numbers below 1
    np.testing.assert_allclose(found, total, rtol=0, atol=400 * EPS)


def test_terms_2_and_3_as_printed_are_not_symmetric():
    q, P, _ = problem(1)

    def matrix(term):
        return np.array(
            [
                [evaluate(gaussian_mean(term(i, j)), q, P) for j in range(1, 5)]
                for i in range(1, 5)
            ]
        )

    for term in (
        lambda i, j: times(U, U, U, X[i], Q[j]),
        lambda i, j: times(R, U, X[i], Q[j]),
    ):
        as_printed = matrix(term)
        # power: 0.03, against rounding of 400 eps
        assert np.abs(as_printed - as_printed.T).max() > 1e-3


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


def directions(seed):
    rng = np.random.default_rng(seed)
    q = random_quaternions(1, rng)[0]
    r1, r2 = normalize(rng.standard_normal((2, 3)))
    A = attitude_matrix(q)
    return rng, A @ r1, A @ r2, r1, r2


def exact_qbar_covariance(vectors, noise):
    """First-order covariance of qbar by complex step, for any noise."""
    vectors = np.stack(vectors).reshape(12)

    def qbar(v):
        b1, b2, r1, r2 = v.reshape(4, 3)
        d1, d2, s1 = (b1 - r1) / 2, (b2 - r2) / 2, (b1 + r1) / 2
        return np.append(np.cross(d1, d2), s1 @ d2)

    J = np.stack([qbar(vectors + 1e-30j * e).imag / 1e-30 for e in np.eye(12)], axis=1)
    blocks = np.zeros((12, 12))
    for i, S in enumerate(noise):
        blocks[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = S
    return J @ blocks @ J.T


def test_eq60_lacks_the_correlation_of_s1_and_d1():
    rng, *vectors = directions(3)
    b1, b2, r1, r2 = vectors
    F = rng.standard_normal((4, 3, 3))
    noise = F @ F.swapaxes(1, 2)
    d1, d2, s1 = (b1 - r1) / 2, (b2 - r2) / 2, (b1 + r1) / 2
    first, second = noise[0] + noise[2], noise[1] + noise[3]
    lower_right = d2 @ first @ d2 + s1 @ second @ s1
    upper_left = cross_matrix(d2) @ first @ cross_matrix(d2).T
    upper_left += cross_matrix(d1) @ second @ cross_matrix(d1).T
    printed_upper = cross_matrix(d1) @ second @ s1
    printed_lower = -d2 @ first @ cross_matrix(d2).T + s1 @ second @ cross_matrix(d1).T
    exact = 4 * exact_qbar_covariance(vectors, noise)
    # a sum of 12 products, entries of the noise up to 10, times 4
    rounding = 12 * 4 * 10 * EPS
    # entries below 10 from 144 products with random covariances: 144 eps times 10
    np.testing.assert_allclose(exact[:3, :3], upper_left, rtol=0, atol=rounding)
    assert exact[3, 3] == pytest.approx(lower_right, abs=rounding)
    missing = -cross_matrix(d2) @ (noise[0] - noise[2]) @ d2
    np.testing.assert_allclose(
        exact[:3, 3], printed_upper + missing, rtol=0, atol=rounding
    )
    # as printed, the two corners are neither right nor each other's transpose
    assert np.abs(exact[:3, 3] - printed_upper).max() > 0.1
    assert np.abs(exact[3, :3] - printed_lower).max() > 0.1
    assert np.abs(printed_upper - printed_lower).max() > 0.1


def test_eq61_holds_for_isotropic_and_not_for_tangent_noise():
    _, *vectors = directions(4)
    b1, b2, r1, r2 = vectors
    d1, d2, s1 = (b1 - r1) / 2, (b2 - r2) / 2, (b1 + r1) / 2
    square = sum(d @ d * np.eye(3) - np.outer(d, d) for d in (d1, d2))
    corner = np.cross(d1, s1)
    printed61 = 0.5 * np.block(
        [[square, corner[:, None]], [corner[None], np.array([[d2 @ d2 + s1 @ s1]])]]
    )
    isotropic = exact_qbar_covariance(vectors, np.stack([np.eye(3)] * 4))
    # sums of 12 products of numbers below 1
    np.testing.assert_allclose(isotropic, printed61, rtol=0, atol=12 * EPS)
    tangent = np.stack([np.eye(3) - np.outer(v, v) for v in vectors])
    # power: 0.6, a term of order one
    assert np.abs(exact_qbar_covariance(vectors, tangent) - printed61).max() > 0.01


def half_turn_free(axis, angle, r1, r2):
    q = np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
    A = attitude_matrix(q)
    return q, A @ r1, A @ r2


def test_eqs_21_to_23_lose_the_sign_of_the_angle():
    r1, r2 = np.array([1.0, 0, 0]), np.array([0, 0.6, 0.8])
    for angle, right in ((0.7, True), (-0.7, False)):
        q, _, b2 = half_turn_free(r1, angle, r1, r2)
        d2, s2 = (b2 - r2) / 2, (b2 + r2) / 2
        printed21 = np.append(r1 * np.linalg.norm(d2), np.linalg.norm(s2))
        signed = np.append(np.cross(d2, s2), s2 @ s2) / np.linalg.norm(s2)
        # a dozen operations on numbers below 1, no cancellation
        np.testing.assert_allclose(signed, q, rtol=0, atol=4 * EPS)
        assert (np.abs(printed21 - q).max() < 4 * EPS) == right


def test_eqs_25_and_26_need_the_third_vectors():
    # printed with index 2 in the denominator of u and in b2.r3
    r1, r2 = normalize(np.array([[1.0, 0.2, 0], [0.1, 1.0, 0.3]]))
    axis = normalize(r1 - 0.5 * r2)
    angle = 1.1
    _, b1, b2 = half_turn_free(axis, angle, r1, r2)
    b3, r3 = normalize(np.cross(b1, b2)), normalize(np.cross(r1, r2))
    u = np.cross(b3, r3) / np.linalg.norm(np.cross(b3, r3))
    # a dozen operations, over |b3 x r3| = 0.4 and the sine of r1 and r2
    np.testing.assert_allclose(u, axis, rtol=0, atol=40 * EPS)
    assert b3 @ r3 == pytest.approx(np.cos(angle), abs=40 * EPS)
    printed = np.cross(b3, r3) / np.linalg.norm(np.cross(b2, r2))
    # power: 0.016 and 1.3, against rounding of 40 eps
    assert abs(np.linalg.norm(printed) - 1.0) > 0.01
    assert abs(b2 @ r3 - np.cos(angle)) > 0.01


def test_table_2_case_b_needs_or_and_no_free_constant():
    # a turn about r1 with r1 along x: the half turn about x is singular by the first
    # condition alone, whatever the second says
    r1 = np.array([1.0, 0, 0])
    r2 = normalize(np.array([0.3, 1.0, 0.4]))
    _, _, b2 = half_turn_free(r1, 0.8, r1, r2)
    R = np.diag([1.0, -1, -1])
    d2C = (b2 - R @ r2) / 2
    assert np.abs((r1 - R @ r1) / 2).max() == 0.0  # d1C = 0: singular
    second = (b2 + r2)[1] * r1[2] - (b2 + r2)[2] * r1[1]
    assert second == 0.0  # here both hold, trivially
    # r1 off the axis and the second condition alone: singular too, so AND is wrong
    found = None
    rng = np.random.default_rng(0)
    r1 = normalize(np.array([0.2, 0.7, 0.5]))
    for r2 in normalize(rng.standard_normal((200, 3))):
        # choose the angle so that b2x = r2x and the second condition holds: p_x = 0,
        # p = cos(a/2) n + sin(a/2) n x r1 (no rotation about n)
        n = np.cross(r1, r2)
        angle = 2 * np.arctan2(n[0], -np.cross(n, r1)[0])
        _, _, b2 = half_turn_free(r1, angle, r1, r2)
        d1C, d2C = (r1 - R @ r1) / 2, (b2 - R @ r2) / 2
        if np.linalg.norm(n) > 0.5:
            found = np.linalg.norm(np.cross(d1C, d2C))
            # two cross products of numbers below 1: 20 operations
            assert found < 20 * EPS
            k = (b2 + r2)[1] * r1[2] - (b2 + r2)[2] * r1[1]
            assert abs(k) < 20 * EPS  # with k = 1
            assert np.linalg.norm(d1C) > 0.1  # b1 is not along x
    assert found is not None
