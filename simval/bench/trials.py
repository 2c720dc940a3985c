"""Races of the Monte Carlo pass: beside the generator, in threads, and reduced."""

from functools import partial

import numpy as np

from simval.arrays import Array
from simval.attitude.kernel import (
    normalize_columns,
    raw_quaternion,
    sums_and_differences,
)
from simval.bench.in_numpy import normals, simulated_moments
from simval.bench.race import Answer, Contender, Done
from simval.geometry import attitude_matrix
from simval.moments import Moments
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

NOISE = 0.01  # a level of the accuracy suite; the time does not depend on it
SAMPLES = 2**19  # 6.3 million normals, 0.1 to 0.3 s: long beside the clock's step
REDUCED = 2**16
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


def _generator(samples: int) -> Contender:
    return Contender(
        name="SFC64 normals, 12 a sample",
        run=partial(normals, samples),
        seen=lambda _: Done(items=samples),
        ours=False,
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


def threads() -> list[Contender]:
    """List the full pass in one thread and in two: the same bits."""

    def same(moments: Moments) -> Done:
        bits = {
            "covariance": Answer(values=moments.covariance, within=0.0),
            "bias": Answer(values=moments.bias, within=0.0),
        }
        return Done(items=moments.samples, answers=bits)

    return [
        _generator(SAMPLES),
        *(
            Contender(name=name, run=partial(full_pass, 2 * SAMPLES, n), seen=same)
            for name, n in (("one thread", 1), ("two threads", 2))
        ),
    ]


def reductions() -> list[Contender]:
    """List the variance reductions by how many plain samples they replace."""
    q, truth = geometry()
    plain = _plain_variance(truth, q)

    def errors(x: Float[Array, "12 n"]) -> Float[Array, "4 n"]:
        return q[:, None] - normalize_columns(
            raw_quaternion(NOISE * x + truth, "plain")
        )

    def reduced(method: str) -> Moments:
        sums = simulate_reduced(
            errors,
            Streams(1, (1,)),
            dimension=12,
            method=method,  # type: ignore[arg-type]
            samples=REDUCED,
        )
        return moments_of(sums)

    def worth(covariance: Array, error: Array) -> Done:
        answer = Answer(values=covariance, within=SIGMAS * error)
        items = round(plain / float(np.sum(np.diagonal(error) ** 2)))
        return Done(items=items, answers={"covariance": answer})

    return [
        Contender(
            name="plain, NumPy alone",
            run=partial(simulated_moments, truth, NOISE, REDUCED, 1),
            seen=lambda found: worth(found[1], found[3]),
            ours=False,
        ),
        *(
            Contender(
                name=method,
                run=partial(reduced, method),
                seen=lambda m: worth(m.covariance, m.covariance_error),
            )
            for method in METHODS
        ),
    ]


def _plain_variance(truth: Float[Array, "12 1"], q: Float[Array, "4"]) -> float:
    """Variance of one plain sample, summed over the squares of the components."""
    rng = np.random.default_rng(2)
    vectors = NOISE * rng.standard_normal((12, 400_000)) + truth
    error = q[:, None] - normalize_columns(raw_quaternion(vectors, "plain"))
    return float(np.sum(np.var(error**2, axis=1)))
