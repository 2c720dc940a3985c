"""The theorem on the four columns of docs/theory.md, section 9, without rounding.

Each step is an identity of polynomials in vectors of unit length. It is evaluated
modulo the prime 2^61 - 1, at random vectors there: a wrong one of degree 1000 is seen
with a probability of 1 - 1e-15. The columns are made as the source says, with half
turns and products of quaternions.
"""

import numpy as np

from errata.claim import claims
from errata.theorem import HALF, PRIME, over

SOURCE = "quaternion"
ONE = np.eye(4, dtype=object)
QUARTER, SIXTEENTH = over(4), over(16)


def product(p, q):
    """Hamilton's product of quaternions, vector first; a vector is a pure one."""
    p, q = (np.append(x, 0) if len(x) == 3 else x for x in (p, q))
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.append(vector, p[3] * q[3] - p[:3] @ q[:3]) % PRIME


def matrix(of):
    """The matrix of a linear map of quaternions."""
    return np.stack([of(one) for one in ONE], axis=1) % PRIME


def determinant(matrix):
    """A determinant, by elimination modulo the prime."""
    rows, found = [list(row) for row in matrix % PRIME], 1
    while rows:
        i = next((i for i, row in enumerate(rows) if row[0]), None)
        if i is None:
            return 0
        first = rows.pop(i)
        found = found * first[0] * (-1) ** i % PRIME
        rows = [
            [
                (x - row[0] * over(first[0]) * y) % PRIME
                for x, y in zip(row, first, strict=True)
            ][1:]
            for row in rows
        ]
    return found


class Four:
    """Two pairs of vectors modulo the prime, and what the source makes of them."""

    def __init__(self, b1, b2, r1, r2):
        self.b1, self.b2, self.r1, self.r2 = b1, b2, r1, r2
        self.cr, self.cb = r1 @ r2 % PRIME, b1 @ b2 % PRIME
        self.K1, self.K2 = (
            matrix(lambda x, b=b, r=r: -product(product(r, x), b))
            for b, r in ((b1, r1), (b2, r2))
        )
        self.A = matrix(
            lambda x: product(product(r2, x), b1) - product(product(r1, x), b2)
        )

    def columns(self, a1=HALF):
        """The columns x, y, z and plain, the scalar a1 s1'd2 - (1 - a1) s2'd1."""
        found = []
        for k in range(4):
            kept = np.full(3, 1 if k == 3 else -1, dtype=object)
            kept[k % 3] = 1
            r1, r2 = kept * self.r1, kept * self.r2
            (d1, d2), (s1, s2) = (
                [(b + sign * r) * HALF for b, r in ((self.b1, r1), (self.b2, r2))]
                for sign in (-1, 1)
            )
            scalar = a1 * (s1 @ d2) - (1 - a1) * (s2 @ d1)
            found.append(product(ONE[k], np.append(np.cross(d1, d2), scalar)))
        return np.stack(found, axis=1) % PRIME


def drawn(rng, size):
    """Random numbers modulo the prime."""
    return rng.integers(1, PRIME, size).astype(object)


def circle(t):
    """A point of the unit circle: cosine and sine."""
    down = over(1 + t * t)
    return (1 - t * t) * down % PRIME, 2 * t * down % PRIME


def orthonormal(rng):
    """Two unit vectors at a right angle: the image of x and y by a random rotation."""
    q = drawn(rng, 4)
    back = q * [-1, -1, -1, 1]
    down = over(q @ q)
    return [product(product(q, axis), back)[:3] * down % PRIME for axis in ONE[:2]]


def halves(rng):
    """Two pairs by half of their angles: vectors, cosines and sines of the halves."""
    found = []
    for _ in range(2):
        (u, v), (c, s) = orthonormal(rng), circle(*drawn(rng, 1))
        found.append(((c * u + s * v) % PRIME, (c * u - s * v) % PRIME, c, s))
    return found


def four(rng):
    """Two pairs of random unit vectors."""
    (b1, b2, *_), (r1, r2, *_) = halves(rng)
    return Four(b1, b2, r1, r2)


@claims(
    SOURCE,
    optimum_loss="the four columns: q'K q is Wahba's gain, at any q",
    optimum_columns="the four columns: M = (I + K)A/4",
    optimum_anticommute="the four columns: K A = -A K",
    optimum_square="the four columns: A^2 = 4 (K^2 - (r1'r2)(b1'b2))",
    optimum_commute="the four columns: A D = D A, (b1'b2 - r1'r2) times the identity",
    optimum_eigenvalues="the four columns: the characteristic polynomial of K",
    optimum_product="the four columns: M M'(I - K) = det(I - K)(I + K)/4",
    optimum_right="the four columns: M'M (I + K) = det(I - K)(I - K)/4",
    optimum_involution="the four columns: M^2 = delta^2 I",
    optimum_trace="the four columns: the trace of M is 0",
)
def steps(rng):
    g = four(rng)
    K, D, A, M = (g.K1 + g.K2) * HALF, (g.K1 - g.K2) * HALF, g.A, g.columns()
    cr, cb, x = g.cr, g.cb, drawn(rng, 1)[0]
    q = drawn(rng, 4)
    back = q * [-1, -1, -1, 1]  # b = q^-1 r q, in body axes
    seen = [product(product(back, r), q)[:3] for r in (g.r1, g.r2)]
    optimum_loss = (
        (seen[0] @ g.b1 + seen[1] @ g.b2) * HALF % PRIME,
        q @ K @ q % PRIME,
    )
    optimum_columns = M, (ONE + K) @ A * QUARTER % PRIME
    optimum_anticommute = K @ A % PRIME, -A @ K % PRIME
    optimum_square = A @ A % PRIME, 4 * (K @ K - cr * cb * ONE) % PRIME
    optimum_commute = (
        [A @ D % PRIME, D @ A % PRIME],
        [(cb - cr) * ONE % PRIME, (cb - cr) * ONE % PRIME],
    )
    optimum_eigenvalues = (
        determinant(x * ONE - K),
        (x**4 - (1 + cr * cb) * x**2 + (cr + cb) ** 2 * QUARTER) % PRIME,
    )
    det = determinant(ONE - K)
    optimum_product = (
        M @ M.T @ (ONE - K) % PRIME,
        det * QUARTER * (ONE + K) % PRIME,
    )
    optimum_right = (
        M.T @ M @ (ONE + K) % PRIME,
        det * QUARTER * (ONE - K) % PRIME,
    )
    delta = (cb - cr) * QUARTER
    optimum_involution = M @ M % PRIME, delta**2 * ONE % PRIME
    optimum_trace = np.trace(M) % PRIME, 0
    return locals()


@claims(
    SOURCE,
    optimum_weighted_columns="the four columns, weighted: M_a = M + (a1 - a2) delta I",
    optimum_weighted_factor="the four columns, weighted: M_a = (I + K_a)A/4",
    optimum_weighted_product=(
        "the four columns, weighted: a1 a2 M_a M_a'(I - K_a) = det(I - K_a)(I + K_a)/16"
    ),
    optimum_printed_scalar="(8), at any noise: every frame takes r1 to b1 exactly",
    optimum_other_scalar="(8) with -s2'd1, at any noise: r2 to b2 exactly",
    optimum_two_scalars="the four columns: (M + delta I)(M - delta I) = 0",
)
def weighted(rng):
    g = four(rng)
    a1 = drawn(rng, 1)[0]
    a2 = (1 - a1) % PRIME
    K, M, A = (a1 * g.K1 + a2 * g.K2) % PRIME, g.columns(a1), g.A
    delta = (g.cb - g.cr) * QUARTER
    det = determinant(ONE - K)
    optimum_weighted_columns = M, (g.columns() + (a1 - a2) * delta * ONE) % PRIME
    optimum_weighted_factor = M, (ONE + K) @ A * QUARTER % PRIME
    optimum_weighted_product = (
        a1 * a2 * M @ M.T @ (ONE - K) % PRIME,
        det * SIXTEENTH * (ONE + K) % PRIME,
    )
    first, second = g.columns(1), g.columns(0)
    optimum_printed_scalar = g.K1 @ first % PRIME, first
    optimum_other_scalar = g.K2 @ second % PRIME, second
    optimum_two_scalars = first @ second % PRIME, 0 * ONE
    return locals()


@claims(
    SOURCE,
    optimum_lengths="the four columns: what errors of the lengths do, to first order",
)
def lengths(rng):
    q, (_, _, _, _), (r1, r2, *_) = drawn(rng, 4), *halves(rng)
    back, size = q * [-1, -1, -1, 1], q @ q % PRIME
    b1, b2 = (product(product(back, r), q)[:3] * over(size) % PRIME for r in (r1, r2))
    a1 = drawn(rng, 1)[0]
    M = Four(b1, b2, r1, r2).columns(a1)  # q w'
    w = M.T @ q * over(size)
    eb1, eb2, er1, er2 = e = drawn(rng, 4)
    # M is linear in each pair: its change is that of a pair, and of the other
    changes = [
        Four(b1 * (1 + e[0]), b2, r1 * (1 + e[2]), r2).columns(a1) - M,
        Four(b1, b2 * (1 + e[1]), r1, r2 * (1 + e[3])).columns(a1) - M,
    ]
    moved = sum(changes) @ w * over(w @ w)
    # q (1 + v/2) turns what it predicts by v the other way: from b1 to b2 is b2 x b1
    a2, normal = 1 - a1, np.cross(b2, b1)
    cosine, square = b1 @ b2, over(normal @ normal)
    optimum_lengths = (
        (moved - q * (q @ moved) * over(size)) % PRIME,
        HALF
        * cosine
        * square
        * (a1 * (eb1 - er1) - a2 * (eb2 - er2))
        * product(q, normal)
        % PRIME,
    )
    return locals()


@claims(
    SOURCE,
    optimum_sums="(8) on differences and sums: every frame is Wahba's optimum",
    optimum_sums_rank="(8) on differences and sums: the columns have rank one",
    optimum_sums_weighted="(8) on differences and sums, turned: the weighted optimum",
)
def sums_and_differences(rng):
    (b1, b2, c_b, s_b), (r1, r2, c_r, s_r) = halves(rng)
    g = Four(b1, b2, r1, r2)
    d, s = (b1 - b2) * over(s_b) * s_r, (b1 + b2) * over(c_b) * c_r
    M = Four(d, s, r1 - r2, r1 + r2).columns()
    # alpha, half of what the references' angle is greater
    cosine, sine = c_r * c_b + s_r * s_b, s_r * c_b - c_r * s_b
    optimum_sums = (g.K1 + g.K2) * HALF @ M % PRIME, cosine * M % PRIME
    i, j = rng.permutation(4)[:2]
    optimum_sums_rank = (
        np.outer(M[:, i], M[j]) % PRIME,
        M * M[j, i] % PRIME,
    )
    # the turn by epsilon that weights 1 + w and 1 - w ask for: tan = w tan alpha
    cos, sin = circle(*drawn(rng, 1))
    w = sin * cosine * over(cos * sine)
    turned = (
        cos * d + sin * s_r * over(c_r) * s,
        cos * s - sin * c_r * over(s_r) * d,
    )
    M = Four(*turned, r1 - r2, r1 + r2).columns()
    optimum_sums_weighted = (
        ((1 + w) * g.K1 + (1 - w) * g.K2) * HALF @ M % PRIME,
        cosine * over(cos) * M % PRIME,
    )
    return locals()
