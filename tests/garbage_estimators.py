"""Estimators that are wrong, each in its own way: a plug-in file, and what is said.

`SAID` holds for each the exit code and words of `simval check`. The clean ones, of
which they are made, pass.
"""

import os
import signal
import sys
import threading

import numpy as np
from scipy.spatial.transform import Rotation

from simval.attitude.comparators import davenport, triad
from simval.geometry import attitude_matrix, compose, conjugate, normalize
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

stored_single = spoilt(
    "stored single", 0, "PASS: all", lambda q, *_: q.astype(np.float32)
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
transposed = spoilt("transposed", 3, r"of shape \(4, 24\); it must", lambda q, *_: q.T)
silent = spoilt("silent", 3, r"as NoneType of shape \(\)", lambda q, *_: None)
imaginary = spoilt("imaginary", 3, r"\(complex\) at", lambda q, *_: q + 0j)
masked = spoilt(
    "masked",
    3,
    "quaternions with masked entries",
    lambda q, *_: np.ma.masked_where(np.abs(q) > 0.9, q),
)
in_words = spoilt("in words", 3, r"\(str\) at", lambda q, *_: q.astype(str))

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
crossed = made(
    "crossed",
    3,
    "no order or direction of the components fits any",
    lambda b1, b2, r1, r2: davenport(b1, r1, b2, r2),
)


def reflecting(b1, b2, r1, r2):
    """Orthogonal Procrustes whose determinant is mended by a sign."""
    B = b1[:, :, None] * r1[:, None] + b2[:, :, None] * r2[:, None]
    U, _, V = np.linalg.svd(B)
    A = U @ V
    A *= np.linalg.det(A)[:, None, None]
    return conjugate(Rotation.from_matrix(A).as_quat())


def turns_to_a_right_angle(q, *_):
    """The angle from its sine: right up to 90 degrees."""
    axis = normalize(q[:, :3])
    angle = np.arcsin(
        np.sin(2.0 * np.arctan2(np.linalg.norm(q[:, :3], axis=1), q[:, 3]))
    )
    half = angle[:, None] / 2.0
    return np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1)


def from_the_trace(b1, b2, r1, r2):
    """The scalar from the trace, the rest over it: no half turns."""
    A = attitude_matrix(triad(b1, b2, r1, r2))
    scalar = np.sqrt(np.maximum(1.0 + np.trace(A, axis1=1, axis2=2), 0.0)) / 2.0
    cross = np.stack(
        [A[:, 1, 2] - A[:, 2, 1], A[:, 2, 0] - A[:, 0, 2], A[:, 0, 1] - A[:, 1, 0]], 1
    )
    with np.errstate(all="ignore"):
        return np.concatenate(
            [cross / (4.0 * scalar[:, None]), scalar[:, None]], axis=1
        )


reflected = made("reflected", 3, r"\d+ of 24 rows fit, row \d+, a turn by", reflecting)
half_of_the_angles = spoilt(
    "half of the angles", 3, r"\d+ of 24 rows fit", turns_to_a_right_angle
)
one_sign_of_the_scalar = spoilt(
    "one sign of the scalar",
    3,
    r"\d+ of 24 rows fit",
    lambda q, *_: np.concatenate(
        [q[:, :3] * np.sign(q[:, :1]), np.abs(q[:, 3:])], axis=1
    ),
)

# wrong at one class of attitudes
no_half_turns = made("no half turns", 1, "fails at  half turns about x", from_the_trace)
no_half_turn_about_y = spoilt(
    "no half turn about y",
    1,
    "fails at  half turns about y 100.0%\n",
    lambda q, *_: where(q, np.abs(q[:, 1]) > 1.0 - 1e-12, IDENTITY),
)
nothing_small = spoilt(
    "nothing small",
    1,
    r"fails at  small angles \d+.\d%\n",
    lambda q, *_: where(q, np.abs(q[:, 3]) > 1.0 - 1e-8, IDENTITY),
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

first_reference = made(
    "first reference",
    3,
    "1 of 24 rows fit|any of 24 rows",
    lambda b1, b2, r1, r2: davenport(
        b1, b2, *(np.tile(r[0], (len(b1), 1)) for r in (r1, r2))
    ),
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
single = made(
    "single precision",
    0,
    "PASS: all",
    lambda *v: davenport(*(x.astype(np.float32).astype(float) for x in v)),
)
coarse = spoilt(
    "sixteen bits",
    3,
    "its conventions fit, its precision does not: it answers the same where",
    lambda q, *_: normalize(np.round(q * 2.0**15) / 2.0**15),
)

# of its covariance
two_percent = spoilt(
    "two percent",
    3,
    r"trace is 1\.02 times what it should be",
    lambda q, *_: q,
    covariance=lambda *v: leading(*v, factor=1.02),
)
other_side = spoilt(
    "other side",
    3,
    'it fits side="body"',
    lambda q, *_: q,
    covariance=leading,
    side="reference",
)
in_degrees = spoilt(
    "in degrees",
    3,
    "trace is 3283 times",
    lambda q, *_: q,
    covariance=lambda *v: leading(*v, factor=np.degrees(1.0) ** 2),
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
indefinite = spoilt(
    "indefinite",
    3,
    "is not positive definite",
    lambda q, *_: q,
    covariance=lambda *v: -leading(*v),
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


# of more than its arguments
def drifting():
    """Drifts by 1e-4 rad with every call."""
    calls = []

    def spoil(q, *_):
        calls.append(1)
        return about_x(q, 1e-4 * (len(calls) - 1))

    return spoil


def overwriting(q, b1, *_):
    b1[:] = 0.0
    return q


def reused():
    """Answers with a view of one array, in which the next call overwrites it."""
    buffer = np.empty((1 << 16, 4))

    def spoil(q, *_):
        buffer[: len(q)] = q
        return buffer[: len(q)]

    return spoil


def racing():
    """Two threads write the same rows; the wrong one is last in every third call."""
    turn = [0]

    def spoil(q, *_):
        out, turn[0] = np.empty_like(q), turn[0] + 1
        threads = [
            threading.Thread(target=np.copyto, args=(out, q if own else IDENTITY))
            for own in (turn[0] % 3 == 1, turn[0] % 3 != 1)
        ]
        for thread in threads:
            thread.start()
            thread.join()
        return out

    return spoil


def raising_in_row(row):
    def spoil(q, *_):
        if len(q) > row:
            msg = f"row {row}"
            raise IndexError(msg)
        return q

    return spoil


def shouting(q, *_):
    sys.stdout.write("x" * (1 << 23))
    sys.stdout.flush()
    return q


def tiring():
    """Is a degree off from its sixtieth call on."""
    calls = []

    def spoil(q, *_):
        calls.append(1)
        return about_x(q, 0.0 if len(calls) < 60 else np.radians(1.0))

    return spoil


def warming():
    """Is wrong in its first call."""
    calls = []

    def spoil(q, *_):
        calls.append(1)
        return q if len(calls) > 1 else about_x(q, 0.1)

    return spoil


def late():
    """Overwrites what it was given in the call before."""
    kept = []

    def spoil(q, *v):
        for old in kept:
            old[:] = 0.0
        kept[:] = v
        return q

    return spoil


drifts = spoilt("drifts", 3, "not what it is when alone: 0.0001 rad", drifting())
tires = spoilt("tires", 3, "not what it is when alone: 0.0175 rad", tiring())
overwrites = spoilt("overwrites", 3, "changes its input", overwriting)
races = spoilt(
    "races", 3, "it must answer the same each time|rows fit|fits any", racing()
)
warms_up = spoilt("warms up", 3, "it must answer the same each time", warming())


def dicing(q, *v):
    return about_x(q, 0.1 * off(*v) * np.random.standard_normal(len(q)))  # noqa: NPY002


def seeded(q, *v):
    np.random.seed(0)  # noqa: NPY002
    return dicing(q, *v)


rolls_dice = spoilt("rolls dice", 3, "not what it is when alone", dicing)
seeds_dice = spoilt("seeds dice", 3, "not what it is when alone", seeded)
centred = spoilt(
    "centred",
    3,
    "right in a batch of 24, but in one of 1024",
    lambda q, *_: normalize(q - 1e-3 * q.mean(axis=0)) if len(q) > 100 else q,
)
wrong_in_the_last_row = spoilt(
    "last row",
    3,
    "in one of 4096 its row 4095 is",
    lambda q, *_: where(q, np.arange(len(q)) == 4095, IDENTITY),
)
raises_in_row_4095 = spoilt(
    "row 4095", 4, "raised IndexError: row 4095", raising_in_row(4095)
)
raises = spoilt("raises", 4, "raised IndexError: row 0", raising_in_row(0))
shouts = spoilt("shouts", 4, "File too large", shouting)
kills = spoilt(
    "kills",
    4,
    r"was killed by SIGSEGV",
    lambda *_: os.kill(os.getpid(), signal.SIGSEGV),
)
leaves = spoilt("leaves", 4, r"raised SystemExit: 0", lambda *_: sys.exit(0))

# odd, and of no harm to what is measured
reuses = spoilt("reuses", 0, "PASS: all", reused())
moves_away = spoilt("moves away", 0, "PASS: all", lambda q, *_: os.chdir("/") or q)
raises_floats = spoilt(
    "raises floats", 0, "PASS: all", lambda q, *_: np.seterr(all="raise") and q
)

# wrong, and unseen: docs/plugins.md says so
overwrites_later = spoilt("overwrites later", 0, "PASS: all", late())
quadratic_of_no_kind = spoilt(
    "quadratic of no kind",
    0,
    "PASS: all",
    lambda q, *v: about_x(q, 0.3 * off(*v) ** 2),
)
