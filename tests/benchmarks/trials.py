"""Race of the Monte Carlo pass beside the generator."""

from functools import partial

import numpy as np

from benchmarks.race import Answer, Contender, Done
from simval.arrays import Array
from simval.geometry import attitude_matrix
from simval.imu.attitude.kernel import (
    normalize_columns,
    raw_quaternion,
    sums_and_differences,
)
from simval.moments import Moments
from simval.montecarlo import (
    fused,
    moments_of,
    simulate,
    simulate_closed_form,
)
from simval.montecarlo.fused import lanes
from simval.montecarlo.plain import sums_of
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import BATCH, BLOCK, random_geometry

NOISE = 0.01  # a level of the accuracy suite; the time does not depend on it
SAMPLES = 2**19  # 6.3 million normals, 0.1 to 0.3 s: long beside the clock's step
SIGMAS = 5.0  # of a simulated number; the seeds are fixed, so it is right or it is not


def geometry() -> tuple[Float[Array, "4"], Float[Array, "12 1"]]:
    """Quaternion with the sign of the plain formula, (4,), and the vectors."""
    q, r1, r2 = random_geometry(3)
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)
    return normalize_columns(raw_quaternion(truth, "plain"))[:, 0], truth


def full_pass(samples: int, threads: int) -> Moments:
    """Draw, estimate, accumulate mean and second moments with standard errors."""
    q, truth = geometry()
    sums = simulate_closed_form(
        truth, "plain", q, NOISE, Streams(1, (1,)),
        samples=samples, block=BLOCK, threads=threads,
    )  # fmt: skip
    return moments_of(sums)


def twelve(samples: int) -> Moments:
    """The same by an estimator of its own on twelve normals, as for any sampler."""
    q, truth = geometry()

    def sampler(rng: np.random.Generator, count: int) -> Float[Array, "4 count"]:
        vectors = rng.standard_normal((12, count))
        vectors *= NOISE
        vectors += truth
        error = normalize_columns(raw_quaternion(vectors, "plain"))
        return np.subtract(q[:, None], error, out=error)

    sums = simulate(
        sampler, Streams(1, (1,)), samples=samples, block=BLOCK, batch=BATCH
    )
    return moments_of(sums)


def without_block(samples: int) -> Moments:
    """The NumPy form of the pass: the same bits."""
    q, truth = geometry()
    mean, noise = sums_and_differences(truth, "plain"), np.sqrt(2.0) * NOISE
    streams, batches = Streams(1, (1,)), BLOCK // BATCH
    means = [
        fused.in_numpy(lanes(streams, number), batches, mean, noise, q)
        for number in range(-(-samples // BLOCK))
    ]
    return moments_of(sums_of(np.concatenate(means), BATCH))


def _measured(moments: Moments) -> Done:
    found = (
        ("bias", moments.bias, moments.bias_error),
        ("covariance", moments.covariance, moments.covariance_error),
    )
    answers = {n: Answer(values=x, within=SIGMAS * error) for n, x, error in found}
    return Done(items=moments.samples, answers=answers)


def normals(samples: int) -> None:
    """Draw twelve normals a sample into a buffer that stays in the cache."""
    rng = np.random.Generator(np.random.SFC64(1))
    buffer = np.empty(32_768)
    for _ in range(12 * samples // buffer.size):
        rng.standard_normal(out=buffer)


def _generator(samples: int) -> Contender:
    return Contender(
        name="SFC64 normals, 12 a sample",
        run=partial(normals, samples),
        seen=lambda _: Done(items=samples),
        other="draws only",
    )


def monte_carlo() -> list[Contender]:
    """List the full pass beside the generator's own rate, one thread."""
    passes = {
        "twelve, any sampler": partial(twelve, SAMPLES),
        "full pass": partial(full_pass, SAMPLES, 1),
        "full pass, NumPy": partial(without_block, SAMPLES // 8),
    }
    return [
        _generator(SAMPLES),
        *(Contender(name=n, run=run, seen=_measured) for n, run in passes.items()),
    ]
