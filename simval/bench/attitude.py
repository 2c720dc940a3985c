"""Races of the two-vector estimators, of their theory and of the Monte Carlo pass."""

from functools import partial
from importlib.util import find_spec

import numpy as np

from simval.arrays import Array
from simval.attitude import two_vector_quaternion
from simval.attitude.comparators import align_vectors, davenport, triad
from simval.attitude.kernel import (
    normalize_columns,
    raw_quaternion,
    sums_and_differences,
)
from simval.bench.race import Contender
from simval.geometry import attitude_matrix
from simval.montecarlo import (
    METHODS,
    fused,
    moments_of,
    simulate,
    simulate_closed_form,
    simulate_reduced,
)
from simval.montecarlo.normals import lanes
from simval.montecarlo.plain import sums_of
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import BATCH, BLOCK, random_geometry
from simval.theory import attitude_moments

NOISE = 0.01  # a level of the accuracy suite; the time does not depend on it
MANY, FEW = 200_000, 500
SAMPLES = 2**19  # 6.3 million normals, 0.1 to 0.3 s: long beside the clock's step


Vectors = tuple[
    Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"]
]
"""Both body vectors and both references."""


def noisy_vectors(count: int) -> Vectors:
    """Draw noisy observations of one geometry."""
    q, r1, r2 = random_geometry(3)
    A = attitude_matrix(q)
    rng = np.random.default_rng(1)
    truth = (A @ r1, A @ r2, r1, r2)
    b1, b2, s1, s2 = (v + NOISE * rng.standard_normal((count, 3)) for v in truth)
    return b1, b2, s1, s2


def _geometry() -> tuple[Float[Array, "4"], Float[Array, "12 1"]]:
    """Quaternion with the sign of the plain formula, (4,), and the vectors."""
    q, r1, r2 = random_geometry(3)
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)
    return normalize_columns(raw_quaternion(truth, "plain"))[:, 0], truth


def estimators() -> list[Contender]:
    """List the estimators; the reference is a loop over SciPy's `align_vectors`."""
    few, many = noisy_vectors(FEW), noisy_vectors(MANY)

    def counted(function: partial[Array], count: int) -> int:
        function()
        return count

    estimates = {
        "scipy align_vectors, loop": (partial(align_vectors, *few), FEW),
        **{
            f"closed form, {frame}": (
                partial(two_vector_quaternion, *many, frame=frame),
                MANY,
            )
            for frame in ("plain", "best", "combined")
        },
        "q-method, batched": (partial(davenport, *many), MANY),
        "TRIAD, batched": (partial(triad, *many), MANY),
    }
    contenders = [
        Contender(name=name, run=partial(counted, *estimate))
        for name, estimate in estimates.items()
    ]
    if find_spec("ahrs") is not None:
        contenders.append(Contender(name="ahrs Davenport", run=partial(_ahrs, few)))
    return contenders


def _ahrs(vectors: Vectors) -> int:
    """Peer's q-method, one pair at a time, with its references set for each."""
    from ahrs.filters import Davenport

    b1, b2, r1, r2 = vectors
    estimator = Davenport()
    for k in range(len(b1)):
        estimator.g_q, estimator.m_q = r1[k], r2[k]
        estimator.estimate(b1[k], b2[k])
    return len(b1)


def predictions() -> list[Contender]:
    """List the predictions of one cell; the reference is the exact answer."""
    q, r1, r2 = random_geometry(3)

    def once(order: int | str, times: int) -> int:
        for _ in range(times):
            attitude_moments(q, r1, r2, NOISE, order=order)
        return times

    return [
        Contender(name=f"order {order}", run=partial(once, order, times))
        for order, times in (("exact", 10), (4, 100), ("4-paper", 100), (2, 100))
    ]


def _normals(samples: int) -> int:
    """Draw twelve normals a sample into a buffer that stays in the cache."""
    rng = np.random.Generator(np.random.SFC64(1))
    buffer = np.empty(32_768)
    for _ in range(12 * samples // buffer.size):
        rng.standard_normal(out=buffer)
    return samples


def _monte_carlo(samples: int, threads: int) -> int:
    """Draw, estimate, accumulate mean and second moments with standard errors."""
    q, truth = _geometry()

    sums = simulate_closed_form(
        truth, "plain", q, NOISE, Streams(1, (1,)),
        samples=samples, block=BLOCK, threads=threads,
    )  # fmt: skip
    return moments_of(sums).samples


def _twelve(samples: int) -> int:
    """The same by an estimator of its own on twelve normals, as for any sampler."""
    q, truth = _geometry()

    def sampler(rng: np.random.Generator, count: int) -> Float[Array, "4 count"]:
        vectors = rng.standard_normal((12, count))
        vectors *= NOISE
        vectors += truth
        error = normalize_columns(raw_quaternion(vectors, "plain"))
        return np.subtract(q[:, None], error, out=error)

    sums = simulate(
        sampler, Streams(1, (1,)), samples=samples, block=BLOCK, batch=BATCH
    )
    return moments_of(sums).samples


def _without_block(samples: int) -> int:
    """The NumPy form of the pass: the same bits."""
    q, truth = _geometry()
    mean, noise = sums_and_differences(truth, "plain"), np.sqrt(2.0) * NOISE
    streams, batches = Streams(1, (1,)), BLOCK // BATCH
    means = [
        fused.in_numpy(lanes(streams, number), batches, mean, noise, q)
        for number in range(-(-samples // BLOCK))
    ]
    return moments_of(sums_of(np.concatenate(means), BATCH)).samples


def monte_carlo() -> list[Contender]:
    """List the full pass beside the generator's own rate, one thread."""
    return [
        Contender(name="SFC64 normals, 12 a sample", run=partial(_normals, SAMPLES)),
        Contender(name="twelve, any sampler", run=partial(_twelve, SAMPLES)),
        Contender(name="full pass", run=partial(_monte_carlo, SAMPLES, 1)),
        Contender(name="full pass, NumPy", run=partial(_without_block, SAMPLES // 8)),
    ]


def threads() -> list[Contender]:
    """List the full pass in one thread and in two."""
    return [
        Contender(name="one thread", run=partial(_monte_carlo, 2 * SAMPLES, 1)),
        Contender(name="two threads", run=partial(_monte_carlo, 2 * SAMPLES, 2)),
    ]


def reductions() -> list[Contender]:
    """List the variance reductions by how many plain samples they replace."""
    q, truth = _geometry()
    plain = _plain_variance(truth, q)

    def errors(x: Float[Array, "12 n"]) -> Float[Array, "4 n"]:
        return q[:, None] - normalize_columns(
            raw_quaternion(NOISE * x + truth, "plain")
        )

    def worth(method: str) -> int:
        sums = simulate_reduced(
            errors,
            Streams(1, (1,)),
            dimension=12,
            method=method,  # type: ignore[arg-type]
            samples=2**16,
        )
        error = np.diagonal(moments_of(sums).covariance_error)
        return round(plain / float(np.sum(error**2)))

    return [Contender(name=method, run=partial(worth, method)) for method in METHODS]


def _plain_variance(truth: Float[Array, "12 1"], q: Float[Array, "4"]) -> float:
    """Variance of one plain sample, summed over the squares of the components."""
    rng = np.random.default_rng(2)
    vectors = NOISE * rng.standard_normal((12, 400_000)) + truth
    error = q[:, None] - normalize_columns(raw_quaternion(vectors, "plain"))
    return float(np.sum(np.var(error**2, axis=1)))
