"""Estimators that are wrong, each in its own way: a plug-in file, and what is said.

`SAID` holds for each the exit code and words of `simval check`. The clean ones, of
which they are made, pass.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.attitude.comparators import davenport, triad
from simval.geometry import attitude_matrix, compose, conjugate
from simval.plugins import Estimator
from simval.plugins.attitudes import random_case, seen

SAID = {}

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def made(name, code, words, estimate, **declared):
    """An estimator, and what is said of it."""
    SAID[name] = (code, words)
    common = {"components": "xyzs", "matrix": "passive"}
    return Estimator(name=name, estimate=estimate, **{**common, **declared})


def spoilt(name, code, words, spoil, **declared):
    """A clean estimator whose answer is spoilt: ``spoil(q, b1, b2, r1, r2)``."""
    return made(name, code, words, lambda *v: spoil(davenport(*v), *v), **declared)


def off(b1, b2, r1, r2):
    """What the angle between the vectors is off by: zero without noise, else of it."""
    return np.einsum("ni,ni->n", b1, b2) - np.einsum("ni,ni->n", r1, r2)


def about_x(q, angle):
    half = np.broadcast_to(angle, len(q))[:, None] / 2.0
    turn = np.concatenate([np.sin(half), 0 * half, 0 * half, np.cos(half)], axis=1)
    return compose(q, turn)


def where(q, mask, other):
    return np.where(mask[:, None], other, q)


def leading(b1, b2, r1, r2, noise_std, factor=1.0):
    """Leading covariance of the clean estimator."""
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return factor * noise_std**2 * np.linalg.inv(H)


# the clean ones
clean = spoilt("clean", 0, "PASS: all", lambda q, *_: q)
clean_kind = spoilt("clean kind", 0, "PASS: all", lambda q, *_: q, kind="wahba")
clean_claim = spoilt("clean claim", 0, "PASS: all", lambda q, *_: q, covariance=leading)
clean_triad = made("clean triad", 0, "PASS: all", triad, kind="triad")
either_sign = spoilt(  # q and -q are the same attitude
    "either sign", 0, "PASS: all", lambda q, b1, *_: q * np.sign(b1[:, :1] + 1e-300)
)
known_to_fail = spoilt(
    "known to fail",
    0,
    r"fails at  half turns about y 100.0% \(declared\)",
    lambda q, *_: where(q, np.abs(q[:, 1]) > 1.0 - 1e-12, np.nan),
    fails_at=("half turns about y",),
)


# not finite, not of unit length, not of the shape
nan_everywhere = spoilt(
    "nan", 3, "non-finite quaternions in 24 of 24 rows", lambda q, *_: q * np.nan
)
nan_at_identity = spoilt(
    "nan at identity",
    1,
    r"fails at  identity 100.0%; reference as body 100.0%; small angles",
    lambda q, *_: where(q, np.abs(q[:, 3]) == 1.0, np.nan),
)
nan_in_some_trials = spoilt(
    "nan in some trials",
    3,
    r"non-finite quaternions in \d+ of 1024 rows \(0\.",
    lambda q, b1, *_: where(q, np.linalg.norm(b1, axis=1) > 1.03, np.nan),
)
of_length_two = spoilt(
    "long", 3, "length is off by 1; .* normalise", lambda q, *_: 2 * q
)

# another convention
conjugated = spoilt(
    "conjugated", 3, 'matrix="active" instead', lambda q, *_: conjugate(q)
)
scalar_first = spoilt(
    "scalar first", 3, 'components="sxyz"', lambda q, *_: np.roll(q, 1, axis=1)
)
swapped = made(
    "swapped",
    3,
    "is it b = A r, with body vectors first",
    lambda b1, b2, r1, r2: davenport(b2, b1, r1, r2),
)


def reflecting(b1, b2, r1, r2):
    """Orthogonal Procrustes whose determinant is mended by a sign."""
    B = b1[:, :, None] * r1[:, None] + b2[:, :, None] * r2[:, None]
    U, _, V = np.linalg.svd(B)
    A = U @ V
    A *= np.linalg.det(A)[:, None, None]
    return conjugate(Rotation.from_matrix(A).as_quat())


reflected = made("reflected", 3, r"\d+ of 24 rows fit, row \d+, a turn by", reflecting)

no_half_turn_about_y = spoilt(
    "no half turn about y",
    1,
    "fails at  half turns about y 100.0%\n",
    lambda q, *_: where(q, np.abs(q[:, 1]) > 1.0 - 1e-12, IDENTITY),
)
locked = spoilt(
    "locked",
    1,
    r"fails at  quarter turns \d+.\d%",
    lambda q, *_: where(q, np.abs(attitude_matrix(q)[:, 0, 2]) > 1.0 - 1e-12, np.nan),
)


def stubborn():
    """Answers what it answered last wherever it cannot: state across calls."""
    last = [IDENTITY]

    def estimate(q, b1, b2, r1, r2):
        out, answer = q.copy(), last[0]
        for row, bad in enumerate(np.linalg.norm(np.cross(r1, r2), axis=1) < 0.05):
            answer = out[row] = answer if bad else q[row]
        last[0] = answer
        return out

    return estimate


the_last_answer = spoilt(
    "the last answer", 3, "in one of 1024 its row .* from the truth", stubborn()
)


def raising_at_yaw(b1, b2, r1, r2):
    if r1[0, 2] == 1.0:
        msg = "gimbal lock"
        raise ZeroDivisionError(msg)
    return davenport(b1, b2, r1, r2)


yaw_raises = made("yaw raises", 1, r"fails at  yaw only 100.0%\n", raising_at_yaw)

# right where it is probed
_TRUTH, _R1, _R2 = random_case(24, np.random.default_rng(20_268))
_SEEN = {b.tobytes() for b in seen(_TRUTH, _R1, _R2)[0]}
memorised = spoilt(
    "memorised",
    3,
    "right in a batch of 24, but in one of 3",
    lambda q, b1, *_: where(
        q, np.array([b.tobytes() not in _SEEN for b in b1]), IDENTITY
    ),
)
exact_alone = spoilt(
    "exact alone",
    3,
    r"gives \d+ different answers to 1024 trials",
    lambda q, *v: where(q, np.abs(off(*v)) > 1e-3, IDENTITY),
)

three_rows = made(
    "three rows",
    3,
    "right in a batch of 24, but in one of 3",
    lambda *v: davenport(*(x.T.copy() if len(x) == 3 else x for x in v)),
)


def caching():
    """Keeps its answers, and takes vectors within 0.01 for the same."""
    known = {}

    def spoil(q, *v):
        keys = np.round(np.concatenate(v, axis=1), 2)
        return np.array(
            [known.setdefault(k.tobytes(), own) for k, own in zip(keys, q, strict=True)]
        )

    return spoil


caches = spoilt("caches", 1, "below_bound against Cramer-Rao", caching())

# biased
constant = spoilt(
    "constant",
    1,
    "bias of first order .* FAIL",
    lambda q, *v: about_x(q, np.where(np.abs(off(*v)) > 1e-7, 1e-4, 0.0)),
)
linear = spoilt(
    "linear",
    1,
    "no error proportional",
    lambda q, *v: about_x(q, 0.05 * np.abs(off(*v))),
)
quadratic = spoilt(
    "quadratic",
    1,
    "class_bias against class: wahba",
    lambda q, *v: about_x(q, 0.3 * off(*v) ** 2),
    kind="wahba",
)
above_a_noise = spoilt(
    "above a noise",
    3,
    "cubature of the function does not settle",
    lambda q, *v: about_x(q, np.where(np.abs(off(*v)) > 0.1, 0.3, 0.0)),
)
less_efficient = spoilt(
    "another class",
    1,
    "class_covariance against class: triad",
    lambda q, *_: q,
    kind="triad",
)

other_side = spoilt(
    "other side",
    3,
    'it fits side="body"',
    lambda q, *_: q,
    covariance=leading,
    side="reference",
)
too_exact = spoilt(
    "too exact", 1, "claim", lambda q, *_: q, covariance=leading, claim="exact"
)
only_at_a_noise = spoilt(
    "only at a noise",
    1,
    "lacks a term of the claimed order",
    lambda q, *_: q,
    covariance=lambda b1, b2, r1, r2, s: leading(b1, b2, r1, r2, np.sqrt(1e-3 * s)),
)
shared_covariance = spoilt(
    "shared covariance",
    3,
    "its covariance",
    lambda q, *_: q,
    covariance=lambda *v: (
        np.tile(leading(*v).mean(axis=0), (len(v[0]), 1, 1))
        if len(v[0]) > 24
        else leading(*v)
    ),
)


def overwriting(q, b1, *_):
    b1[:] = 0.0
    return q


def raising_in_row(row):
    def spoil(q, *_):
        if len(q) > row:
            msg = f"row {row}"
            raise IndexError(msg)
        return q

    return spoil


def tiring():
    """Is a degree off from its sixtieth call on."""
    calls = []

    def spoil(q, *_):
        calls.append(1)
        return about_x(q, 0.0 if len(calls) < 60 else np.radians(1.0))

    return spoil


tires = spoilt("tires", 3, "not what it is when alone: 0.0175 rad", tiring())
overwrites = spoilt("overwrites", 3, "changes its input", overwriting)


wrong_in_the_last_row = spoilt(
    "last row",
    3,
    "in one of 4096 its row 4095 is",
    lambda q, *_: where(q, np.arange(len(q)) == 4095, IDENTITY),
)
raises = spoilt("raises", 4, "raised IndexError: row 0", raising_in_row(0))


quadratic_of_no_kind = spoilt(
    "quadratic of no kind",
    0,
    "PASS: all",
    lambda q, *v: about_x(q, 0.3 * off(*v) ** 2),
)
