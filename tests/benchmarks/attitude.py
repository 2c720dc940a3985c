"""Races of the two-vector estimators and of their theory.

The vectors are exact, each set of an attitude and of references of its own, so every
estimator, whatever it weighs, must find the same attitude; the time depends on neither.
"""

from functools import partial
from importlib.util import find_spec

import numpy as np
import scipy

from benchmarks.race import Answer, Contender, Done
from simval.arrays import Array
from simval.geometry import attitude_matrix, compose, from_rotation_vector
from simval.imu.attitude import two_vector_quaternion
from simval.imu.attitude.comparators import davenport, triad
from simval.moments import Moments
from simval.shapes import Float
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments

NOISE = 0.01  # a level of the accuracy suite; the time does not depend on it
MANY, FEW = 50_000, 500
ROUNDING = 1e-12
"""Of an element of q q'. Chosen: a hundred times what an eigenvector of the geometry
loses, 1e-14."""
TRIALS = 2**16  # the covariance to half a percent, and not long beside the others
CHUNK = 8192  # trials at once, for the cache
SIGMAS = 5.0  # of a simulated number; the seed is fixed, so it is right or it is not

Vectors = tuple[
    Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"]
]
"""Both body vectors and both references."""


def exact_vectors(count: int) -> Vectors:
    """Vectors without noise, whose lengths and angles vary by a percent."""
    q, r1, r2 = random_geometry(3)
    rng = np.random.default_rng(1)
    turns = from_rotation_vector(0.1 * rng.standard_normal((count, 3)))
    A = attitude_matrix(compose(np.broadcast_to(q, (count, 4)), turns))
    s1, s2 = (r + NOISE * rng.standard_normal((count, 3)) for r in (r1, r2))
    b1, b2 = (np.einsum("nij,nj->ni", A, s) for s in (s1, s2))
    return b1, b2, s1, s2


def estimators() -> list[Contender]:
    """List the estimators; the reference is a loop over SciPy's `align_vectors`."""
    many = exact_vectors(MANY)
    few: Vectors = tuple(v[:FEW] for v in many)  # type: ignore[assignment]
    ours = {
        **{
            f"closed form, {frame}": partial(two_vector_quaternion, *many, frame=frame)
            for frame in ("plain", "best", "combined")
        },
        "q-method, batched": partial(davenport, *many),
        "TRIAD, batched": partial(triad, *many),
    }
    peers = {"scipy align_vectors, loop": partial(_scipy, few)}
    if find_spec("ahrs") is not None:
        peers["ahrs Davenport, loop, data unchecked"] = partial(_ahrs, few)
    listed = [*peers.items(), *ours.items()]
    return [Contender(name=name, run=run, seen=_attitudes) for name, run in listed]


def _attitudes(q: Float[Array, "n 4"]) -> Done:
    # q and -q are one attitude, and q q' is the same for both
    answer = Answer(values=q[:, :, None] * q[:, None, :], within=ROUNDING)
    return Done(items=len(q), answers={"attitudes": answer})


def _scipy(vectors: Vectors) -> Float[Array, "n 4"]:
    # its weights and checks are for lengths of one
    unit = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in vectors]
    body, reference = np.stack(unit[:2], axis=1), np.stack(unit[2:], axis=1)
    align = scipy.spatial.transform.Rotation.align_vectors
    return np.array(
        [align(r, b)[0].as_quat() for b, r in zip(body, reference, strict=True)]
    )


def _ahrs(vectors: Vectors) -> Float[Array, "n 4"]:
    """Peer's q-method, one pair at a time, with its references set for each."""
    from ahrs.filters import Davenport

    unit = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in vectors]
    estimator = Davenport()
    found = np.empty((len(unit[0]), 4))
    for k, (b1, b2, r1, r2) in enumerate(zip(*unit, strict=True)):
        estimator.g_q, estimator.m_q = r1, r2
        found[k] = estimator.estimate(b1, b2)
    return found[:, [1, 2, 3, 0]]  # its scalar is first


# As a user of NumPy would write it: nothing of simval's, so that a ratio says how
# simval's code became.
def plain_quaternions(vectors: Float[Array, "4 3 n"]) -> Float[Array, "4 n"]:
    """Unit quaternions of the plain closed form, with its raw sign."""
    b1, b2, r1, r2 = vectors
    d1, d2 = b1 - r1, b2 - r2
    q = np.concatenate([np.cross(d1, d2, axis=0), np.sum((b1 + r1) * d2, axis=0)[None]])
    return q / np.linalg.norm(q, axis=0)


def simulated_moments(
    truth: Float[Array, "12 1"], noise: float, trials: int, seed: int
) -> tuple[
    Float[Array, "4"], Float[Array, "4 4"], Float[Array, "4"], Float[Array, "4 4"]
]:
    """Bias and covariance of truth minus estimate, and their standard errors."""
    rng = np.random.default_rng(seed)
    q = plain_quaternions(truth.reshape(4, 3, 1))
    x = np.concatenate(
        [
            q
            - plain_quaternions(
                (truth + noise * rng.standard_normal((12, CHUNK))).reshape(4, 3, -1)
            )
            for _ in range(trials // CHUNK)
        ],
        axis=1,
    )
    n, bias, covariance = x.shape[1], x.mean(axis=1), np.cov(x)
    x -= bias[:, None]
    squares = x * x
    spread = squares @ squares.T / n - covariance**2  # variance of x_i x_j
    return bias, covariance, np.sqrt(np.diagonal(covariance) / n), np.sqrt(spread / n)


def predictions() -> list[Contender]:
    """List the predictions of one cell; the reference is a simulation in NumPy.

    An order is as near to the exact answer as the first term that it leaves out.
    """
    q, r1, r2 = random_geometry(3)
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)
    # relative to the greatest element; the factors 10 and 100 are chosen
    left_out = {"exact": 1e-9, 4: 100.0 * NOISE**4, "4-paper": 10.0 * NOISE**2}
    left_out |= {2: 10.0 * NOISE**2}

    def several(order: int | str, times: int) -> Moments:
        for _ in range(times):
            moments = attitude_moments(q, r1, r2, NOISE, order=order)
        return moments

    def predicted(order: int | str, times: int, moments: Moments) -> Done:
        part = left_out[order]
        answers = {
            name: Answer(values=x, within=part * float(np.abs(x).max()))
            for name, x in (("bias", moments.bias), ("covariance", moments.covariance))
        }
        return Done(items=times, answers=answers)

    def simulated(found: tuple[Array, Array, Array, Array]) -> Done:
        bias, covariance, bias_error, covariance_error = found
        answers = {
            "bias": Answer(values=bias, within=SIGMAS * bias_error),
            "covariance": Answer(values=covariance, within=SIGMAS * covariance_error),
        }
        return Done(items=1, answers=answers)

    return [
        Contender(
            name=f"simulated in NumPy, {TRIALS:,} trials",
            run=partial(simulated_moments, truth, NOISE, TRIALS, 1),
            seen=simulated,
        ),
        *(
            Contender(
                name=f"order {order}",
                run=partial(several, order, times),
                seen=partial(predicted, order, times),
            )
            for order, times in (("exact", 10), (4, 100), ("4-paper", 100), (2, 100))
        ),
    ]
