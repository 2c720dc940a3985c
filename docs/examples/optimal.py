"""Classical estimators of Wahba's problem for two pairs, one attitude at a time.

Numbers only: no library hides an operation, so they can be counted: each plug-in gives
its method as `arithmetic`, and `optimal.toml` measures them all. For their digits
Davenport's matrix K by LAPACK and SciPy's `align_vectors` are beside them. b and r are
unit vectors, a weights, B the sum of a b r', z that of a b x r, sigma the trace of B;
attitudes take reference to body. Of two pairs the greatest eigenvalue of Davenport's K
is sqrt(a1^2 + a2^2 + 2 a1 a2 cos(angle of b's less that of r's)) (Shuster and Oh 1981,
eq. 71).
"""

from functools import partial

import numpy as np

from simval.imu.attitude.comparators import align_vectors, davenport
from simval.plugins import Estimator

SMALL = 0.1
"""Below it the reference is turned by half a turn (sequential rotations, Shuster and Oh
1981): of the squared scalar part in QUEST, of the greatest eigenvalue less sigma in
ESOQ2, of |d1 x d2| in EULER-2, of the square of four times qbar in the closed form."""
SWEEPS = 6  # of Jacobi's rotations; each squares what is left


def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u, v):
    return [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ]


def _unit(q):
    scale = 1.0 / (sum((x * x for x in q[1:]), q[0] * q[0])) ** 0.5
    return [x * scale for x in q]


def _profile(b1, b2, r1, r2, a1, a2):
    """B, the greatest eigenvalue of K, and the slope there of K's polynomial.

    The eigenvalues are +-l and +-m with l^2 - m^2 = 4 a1 a2 |b1 x b2| |r1 x r2|.
    """
    u1, u2 = [a1 * x for x in b1], [a2 * x for x in b2]
    B = [[u1[i] * r1[j] + u2[i] * r2[j] for j in range(3)] for i in range(3)]
    n, m = _cross(b1, b2), _cross(r1, r2)
    sines, twice = (_dot(n, n) * _dot(m, m)) ** 0.5, 2.0 * a1 * a2
    cos = _dot(b1, b2) * _dot(r1, r2) + sines
    largest = (a1 * a1 + a2 * a2 + twice * cos) ** 0.5
    return B, largest, 4.0 * largest * twice * sines


def _antisymmetric(B):
    """The vector z."""
    return [B[1][2] - B[2][1], B[2][0] - B[0][2], B[0][1] - B[1][0]]


def _turned(method, b1, b2, r1, r2, a1, a2):
    """A method's quaternion in the first frame that is far enough from singular.

    A half turn about axis k negates the other components of the references; [1_k; 0]
    times what is found there is the answer.
    """
    best = 0.0, [0.0, 0.0, 0.0, 1.0]
    for k in (None, 0, 1, 2):
        s1, s2 = r1, r2
        if k is not None:
            s1, s2 = ([r[j] if j == k else -r[j] for j in range(3)] for r in (r1, r2))
        size, q = method(b1, b2, s1, s2, a1, a2)
        if k is not None:
            i, j = (k + 1) % 3, (k + 2) % 3
            turned = [0.0, 0.0, 0.0, -q[k]]
            turned[k], turned[i], turned[j] = q[3], -q[j], q[i]
            q = turned
        best = (size, q) if size > best[0] else best
        if size > SMALL:
            break
    return _unit(best[1])


def _closed_form(b1, b2, r1, r2, a1, a2):
    d1 = [x - y for x, y in zip(b1, r1, strict=True)]
    d2 = [x - y for x, y in zip(b2, r2, strict=True)]
    s1 = [x + y for x, y in zip(b1, r1, strict=True)]
    q = [*_cross(d1, d2), _dot(s1, d2)]
    return sum((x * x for x in q[1:]), q[0] * q[0]), q


def closed_form(*given):
    """Peng and Choukroun's eqs. (8) to (10), which have no weights."""
    return _turned(_closed_form, *given)


def sums_and_differences(b1, b2, r1, r2, a1, a2):
    """The same formula of differences and sums, which is optimal: docs/theory.md, 9."""
    (d, s), (e, t) = (
        (
            [x - y for x, y in zip(u, v, strict=True)],
            [x + y for x, y in zip(u, v, strict=True)],
        )
        for u, v in ((b1, b2), (r1, r2))
    )
    if a1 == a2:
        d_by, s_by = ((_dot(r, r) / _dot(b, b)) ** 0.5 for b, r in ((d, e), (s, t)))
        d, s = [d_by * x for x in d], [s_by * x for x in s]
    else:
        d_b, s_b, d_r, s_r = (_dot(v, v) ** 0.5 for v in (d, s, e, t))
        cos, sin = s_r * s_b + d_r * d_b, (d_r * s_b - s_r * d_b) * (a1 - a2)
        scale = 1.0 / (cos * cos + sin * sin) ** 0.5
        cos, sin, d_by, s_by = cos * scale, sin * scale, 1.0 / d_b, 1.0 / s_b
        d, s = [d_by * x for x in d], [s_by * x for x in s]
        d, s = (
            [d_r * (cos * x + sin * y) for x, y in zip(d, s, strict=True)],
            [s_r * (cos * y - sin * x) for x, y in zip(d, s, strict=True)],
        )
    return _turned(_closed_form, d, s, e, t, a1, a2)


def _euler2(b1, b2, r1, r2, a1, a2):
    d1 = [x - y for x, y in zip(b1, r1, strict=True)]
    d2 = [x - y for x, y in zip(b2, r2, strict=True)]
    axis = _cross(d1, d2)
    length = _dot(axis, axis) ** 0.5
    if not length > 0.0:
        return 0.0, [*axis, 0.0]
    e = [x / length for x in axis]
    sine = cosine = 0.0
    for b, r, a in ((b1, r1, a1), (b2, r2, a2)):
        sine = sine + a * _dot(e, _cross(b, r))
        cosine = cosine + a * (_dot(b, r) - _dot(e, b) * _dot(e, r))
    size = (sine * sine + cosine * cosine) ** 0.5
    if cosine > 0.0:  # half of the angle, without a loss near 0 or a half turn
        return length, [*(sine * x for x in e), size + cosine]
    return length, [*((size - cosine) * x for x in e), sine]


def euler2(*given):
    """EULER-2 (Mortari 1996): the axis across both differences, the best angle."""
    return _turned(_euler2, *given)


def _quest(b1, b2, r1, r2, a1, a2):
    B, largest, slope = _profile(b1, b2, r1, r2, a1, a2)
    sigma, z = B[0][0] + B[1][1] + B[2][2], _antisymmetric(B)
    S = [[B[i][j] + B[j][i] for j in range(3)] for i in range(3)]
    minors = [_cross(S[1], S[2]), S[0][0] * S[2][2] - S[0][2] * S[0][2]]
    kappa = minors[0][0] + minors[1] + S[0][0] * S[1][1] - S[0][1] * S[0][1]
    alpha = largest * largest - sigma * sigma + kappa
    beta, det = largest - sigma, _dot(S[0], minors[0])
    Sz = [_dot(row, z) for row in S]
    SSz = [_dot(row, Sz) for row in S]
    X = [alpha * x + beta * y + w for x, y, w in zip(z, Sz, SSz, strict=True)]
    scalar = alpha * (largest + sigma) - det
    return scalar / slope, [*X, scalar]


def quest(*given):
    """QUEST (Shuster and Oh 1981), its sequential rotations included."""
    return _turned(_quest, *given)


def _esoq2(b1, b2, r1, r2, a1, a2):
    B, largest, _ = _profile(b1, b2, r1, r2, a1, a2)
    sigma, z = B[0][0] + B[1][1] + B[2][2], _antisymmetric(B)
    less, more = sigma - largest, sigma + largest
    M = [[0.0, 0.0, 0.0] for _ in range(3)]
    for i in range(3):
        M[i][i] = less * (B[i][i] + B[i][i] - more) - z[i] * z[i]
        for j in range(i):
            M[i][j] = M[j][i] = less * (B[i][j] + B[j][i]) - z[i] * z[j]
    columns = [_cross(M[1], M[2]), _cross(M[2], M[0]), _cross(M[0], M[1])]
    e = max(columns, key=lambda u: _dot(u, u))
    return -less, [*(-less * x for x in e), _dot(z, e)]


def esoq2(*given):
    """ESOQ2 (Mortari 2000): the Euler axis spans the null space of a 3 x 3 matrix."""
    return _turned(_esoq2, *given)


def foam(b1, b2, r1, r2, a1, a2):
    """FOAM (Markley 1993): the attitude matrix by B and its adjoint."""
    B, largest, _ = _profile(b1, b2, r1, r2, a1, a2)
    square = sum((_dot(row, row) for row in B[1:]), _dot(B[0], B[0]))
    adjoint = [_cross(B[1], B[2]), _cross(B[2], B[0]), _cross(B[0], B[1])]
    kappa = 0.5 * (largest * largest - square)
    scale = 1.0 / (kappa * largest - _dot(B[0], adjoint[0]))
    gram = [[_dot(u, v) for v in B] for u in B]
    cube = [
        [
            sum(gram[i][k] * B[k][j] for k in (1, 2)) + gram[i][0] * B[0][j]
            for j in range(3)
        ]
        for i in range(3)
    ]
    return [
        [
            scale * ((kappa + square) * B[i][j] + largest * adjoint[i][j] - cube[i][j])
            for j in range(3)
        ]
        for i in range(3)
    ]


def svd(b1, b2, r1, r2, a1, a2):
    """SVD (Markley 1988): U V' of B = U S V', by Hestenes' one-sided rotations."""
    B, _, _ = _profile(b1, b2, r1, r2, a1, a2)
    W, V = (
        [list(c) for c in zip(*B, strict=True)],
        [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]],
    )
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            x, y, off = _dot(W[p], W[p]), _dot(W[q], W[q]), _dot(W[p], W[q])
            if not off * off > 1e-32 * x * y:
                continue
            t = (y - x) / (off + off)
            t = (1.0 if t > 0.0 else -1.0) / (abs(t) + (1.0 + t * t) ** 0.5)
            c = 1.0 / (1.0 + t * t) ** 0.5
            s = c * t
            for C in (W, V):
                C[p], C[q] = (
                    [c * u - s * v for u, v in zip(C[p], C[q], strict=True)],
                    [s * u + c * v for u, v in zip(C[p], C[q], strict=True)],
                )
    sizes = [_dot(w, w) for w in W]
    one, two = sorted(range(3), key=lambda k: sizes[k])[1:]
    left = [[x / sizes[k] ** 0.5 for x in W[k]] for k in (one, two)]
    left.append(_cross(*left))
    right = [V[one], V[two], _cross(V[one], V[two])]
    return [
        [left[0][i] * right[0][j] + left[1][i] * right[1][j] + left[2][i] * right[2][j]
         for j in range(3)]
        for i in range(3)
    ]  # fmt: skip


def _estimate(method, b1, b2, r1, r2, weights=(1.0, 1.0)):
    unit = (v / np.linalg.norm(v) for v in (b1, b2, r1, r2))
    a = (np.array(weights) / np.sum(weights)).tolist()
    return np.array(method(*(v.tolist() for v in unit), *a))


def _plugin(name, method, components="xyzs", matrix="passive", **words):
    return Estimator(
        name=name, estimate=partial(_estimate, method), components=components,
        matrix=matrix, batch=False, **words,
        arithmetic=lambda *vectors, weights=(0.5, 0.5): method(*vectors, *weights),
    )  # fmt: skip


METHODS = {
    "closed form": closed_form, "sums and differences": sums_and_differences,
    "EULER-2": euler2, "QUEST": quest, "ESOQ2": esoq2,
    "FOAM": foam, "SVD": svd,
}  # fmt: skip
WEIGHTED = {"reads": ("weights",), "kind": "weighted wahba"}
CLOSED_FORM = _plugin("closed form", closed_form)
OPTIMUM = _plugin("sums and differences", sums_and_differences, kind="wahba")
OPTIMUM_WEIGHTED = _plugin(
    "weighted sums and differences", sums_and_differences, **WEIGHTED
)
EULER2 = _plugin("EULER-2", euler2, reads=("weights",))
QUEST, ESOQ2 = _plugin("QUEST", quest, **WEIGHTED), _plugin("ESOQ2", esoq2, **WEIGHTED)
FOAM = _plugin("FOAM", foam, "matrix", "active", **WEIGHTED)
SVD = _plugin("SVD", svd, "matrix", "active", **WEIGHTED)
EIGEN, SCIPY = (
    Estimator(name=name, estimate=method, components="xyzs", matrix="passive")
    for name, method in (("K by eigh", davenport), ("align_vectors", align_vectors))
)
