"""Races of the two-vector estimators, of their theory, and of their Monte Carlo pass.

The vectors of the estimators are exact, each set of an attitude and of references of
its own, so every estimator, whatever it weighs, must find the same attitude; the time
depends on neither.
"""

import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy
from places import EXAMPLES

from benchmarks.race import Answers, Contender, race
from simval.arrays import Array
from simval.geometry import (
    attitude_matrix,
    compose,
    from_rotation_vector,
    normalize,
    random_quaternions,
)
from simval.imu.attitude import two_vector_quaternion
from simval.imu.attitude.comparators import davenport, triad
from simval.imu.attitude.kernel import (
    normalize_columns,
    raw_quaternion,
)
from simval.moments import Moments
from simval.shapes import Float
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments

sys.path.insert(0, str(EXAMPLES))
import optimal

NOISE = 0.01  # a level of the accuracy suite; the time does not depend on it
MANY, FEW = 50_000, 500
ROUNDING = 1e-12
"""Of an element of q q'. Chosen: a hundred times what an eigenvector of the geometry
loses, 1e-14."""
TRIALS = 2**16  # the covariance to half a percent, and not long beside the others
CHUNK = 8192  # trials at once, for the cache
SIGMAS = 5.0  # of a simulated number; the seeds are fixed, so it is right or it is not
SAMPLES = 2**19  # 6.3 million normals, 0.1 to 0.3 s: long beside the clock's step

Vectors = list[Float[Array, "n 3"]]
"""Both body vectors and both references."""


def exact_vectors(count: int) -> Vectors:
    """Vectors without noise, whose lengths and angles vary by a percent."""
    q, r1, r2 = random_geometry(3)
    rng = np.random.default_rng(1)
    turns = from_rotation_vector(0.1 * rng.standard_normal((count, 3)))
    A = attitude_matrix(compose(np.broadcast_to(q, (count, 4)), turns))
    s1, s2 = (r + NOISE * rng.standard_normal((count, 3)) for r in (r1, r2))
    return [*(np.einsum("nij,nj->ni", A, s) for s in (s1, s2)), s1, s2]


@race("estimators", "Attitude estimates, checks included", "estimates")
def estimators() -> list[Contender]:
    """List the estimators; the reference is a loop over SciPy's `align_vectors`."""
    many = exact_vectors(MANY)
    few = [v[:FEW] for v in many]

    def seen(q: Float[Array, "n 4"]) -> Answers:
        # q and -q are one attitude, and q q' is the same for both
        return {"attitudes": (q[:, :, None] * q[:, None, :], ROUNDING)}

    peers = {"scipy align_vectors, loop": _scipy}
    if find_spec("ahrs") is not None:
        peers["ahrs Davenport, loop, data unchecked"] = _ahrs
    ours = {
        **{
            f"closed form, {frame}": partial(two_vector_quaternion, *many, frame=frame)
            for frame in ("plain", "best", "combined", "optimal")
        },
        "q-method, batched": partial(davenport, *many),
        "TRIAD, batched": partial(triad, *many),
    }
    return [
        *(Contender(n, len(few[0]), partial(f, few), seen) for n, f in peers.items()),
        *(Contender(name, len(many[0]), run, seen) for name, run in ours.items()),
    ]


@race("one_attitude", "One attitude from two pairs, in Python's numbers", "estimates")
def one_attitude() -> list[Contender]:
    """List the methods whose operations are rows; the reference is SciPy's."""
    rng = np.random.default_rng(35)
    A = attitude_matrix(random_quaternions(FEW, rng))
    r = normalize(rng.standard_normal((FEW, 2, 3)))
    each = np.concatenate([r @ A.swapaxes(1, 2), r], axis=1)
    vectors, given = list(each.swapaxes(0, 1)), [(*v, 0.5, 0.5) for v in each.tolist()]

    def seen(found: Sequence[Any]) -> Answers:
        answers = np.array(found)
        if answers.ndim == 3:
            return {"attitudes": (answers, ROUNDING)}
        return {"attitudes": (attitude_matrix(answers), ROUNDING)}

    return [
        Contender("scipy align_vectors", FEW, partial(_scipy, vectors), seen),
        *(
            Contender(
                name, FEW, lambda method=method: [method(*g) for g in given], seen
            )
            for name, method in optimal.METHODS.items()
        ),
    ]


def _unit(vectors: Vectors) -> Vectors:
    # the peers' weights and checks are for lengths of one
    return [v / np.linalg.norm(v, axis=1, keepdims=True) for v in vectors]


def _scipy(vectors: Vectors) -> Float[Array, "n 4"]:
    b1, b2, r1, r2 = _unit(vectors)
    align = scipy.spatial.transform.Rotation.align_vectors
    pairs = zip(np.stack([b1, b2], 1), np.stack([r1, r2], 1), strict=True)
    return np.array([align(r, b)[0].as_quat() for b, r in pairs])


def _ahrs(vectors: Vectors) -> Float[Array, "n 4"]:
    """Peer's q-method, one pair at a time, with its references set for each."""
    from ahrs.filters import Davenport

    estimator = Davenport()
    found = np.empty((len(vectors[0]), 4))
    for k, (b1, b2, r1, r2) in enumerate(zip(*_unit(vectors), strict=True)):
        estimator.g_q, estimator.m_q = r1, r2
        found[k] = estimator.estimate(b1, b2)
    return found[:, [1, 2, 3, 0]]  # its scalar is first


def geometry() -> tuple[Float[Array, "4"], Float[Array, "12 1"]]:
    """Quaternion with the sign of the plain formula, (4,), and the vectors."""
    q, r1, r2 = random_geometry(3)
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)
    return normalize_columns(raw_quaternion(truth, "plain"))[:, 0], truth


def _compared(moments: Moments, relative: float = 0.0) -> Answers:
    # within its standard errors, or a share of its greatest element
    return {
        name: (x, SIGMAS * error + relative * float(np.abs(x).max()))
        for name, x, error in (
            ("bias", moments.bias, moments.bias_error),
            ("covariance", moments.covariance, moments.covariance_error),
        )
    }


# As a user of NumPy would write it: nothing of simval's, so that a ratio says how
# simval's code became.
def plain_quaternions(vectors: Float[Array, "4 3 n"]) -> Float[Array, "4 n"]:
    """Unit quaternions of the plain closed form, with its raw sign."""
    b1, b2, r1, r2 = vectors
    d1, d2 = b1 - r1, b2 - r2
    q = np.concatenate([np.cross(d1, d2, axis=0), np.sum((b1 + r1) * d2, axis=0)[None]])
    return q / np.linalg.norm(q, axis=0)


def simulated_moments(truth: Float[Array, "12 1"], trials: int) -> Moments:
    """Bias and covariance of truth minus estimate, and their standard errors."""
    rng = np.random.default_rng(1)
    parts = [
        plain_quaternions(
            (truth + NOISE * rng.standard_normal((12, CHUNK))).reshape(4, 3, -1)
        )
        for _ in range(trials // CHUNK)
    ]
    x = plain_quaternions(truth.reshape(4, 3, 1)) - np.concatenate(parts, axis=1)
    n, bias, covariance = x.shape[1], x.mean(axis=1), np.cov(x)
    x -= bias[:, None]
    squares = x * x
    spread = squares @ squares.T / n - covariance**2  # variance of x_i x_j
    return Moments(
        bias=bias, bias_error=np.sqrt(np.diagonal(covariance) / n),
        covariance=covariance, covariance_error=np.sqrt(spread / n), samples=n,
    )  # fmt: skip


@race("predictions", "Predicted bias and covariance of one attitude cell", "cells")
def predictions() -> list[Contender]:
    """List the predictions of one cell; the reference is a simulation in NumPy.

    An order is as near to the exact answer as the first term that it leaves out.
    """
    cell, (_, truth) = random_geometry(3), geometry()
    # repeated, and relative to the greatest element; the factors 10 and 100 are chosen
    orders = {
        "exact": (10, 1e-9),
        4: (100, 100.0 * NOISE**4),
        "4-paper": (100, 10.0 * NOISE**2),
        2: (100, 10.0 * NOISE**2),
    }

    def several(order: int | str, times: int) -> Moments:
        for _ in range(times):
            moments = attitude_moments(*cell, NOISE, order=order)
        return moments

    simulated = partial(simulated_moments, truth, TRIALS)
    return [
        Contender(f"simulated in NumPy, {TRIALS:,} trials", 1, simulated, _compared),
        *(
            Contender(
                f"order {order}", times, partial(several, order, times),
                partial(_compared, relative=part),
            )
            for order, (times, part) in orders.items()
        ),
    ]  # fmt: skip
