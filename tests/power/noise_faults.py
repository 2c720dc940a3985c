"""Small faults of noise and streams, in the smoke suite's own cells.

Each leaves errors that look right: noise a hundredth too loud, a stream that is used
twice, an algorithm that is told a hundredth too much, n for n - 1.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from power.fault import Fault, Part, after, everywhere, wrapped
from simval.arrays import Array
from simval.filters import Mekf
from simval.montecarlo import plain
from simval.sensor import AccelerometerModel, NoiseModel
from simval.streams import Streams
from simval.studies import (
    coverage,
    gyroscope,
    ladder,
    magnetometer,
    response,
    trials,
)

LOUDER = 1.01
TOO_SMALL = (
    "1/n of a variance that n trials tell to sqrt(2/n); the functions that all studies "
    "share are judged by `sampling`, a study's own lines are not"
)
DRAWN = (
    "ladder",
    "coverage",
    "magnetometer",
    "gyroscope",
    "filter",
    "attitude_vectors",
)
"""Studies that draw their normals from the generator of a block."""
FELT = ("calibration", "end_to_end")
"""Studies whose accelerometer draws its own."""
BLOCKS = (*FELT, *DRAWN, "noise_model")


class ChangedNormals(np.random.Generator):
    """A generator whose normals are changed on their way."""

    def __init__(
        self,
        generator: np.random.Generator,
        change: Callable[[np.random.Generator, Any], Array],
    ) -> None:
        super().__init__(generator.bit_generator)
        self._generator = generator
        self._change = change

    def standard_normal(self, size: Any = None) -> Any:  # type: ignore[override]
        """Normals, changed."""
        return self._change(self._generator, size)


def small_noise_faults() -> list[Fault]:
    """All of them."""
    return [*_louder(), *_told(), *_again(), *_shared(), *_freedom()]


def _smoke(study: str, part: Part, name: str, inject: Any) -> Fault:
    return Fault(f"smoke {study}", part, f"{name}, {study}", inject)


def _normals(change: Callable[[np.random.Generator, Any], Array]) -> Any:
    def broken(original: Any, streams: Streams, number: int) -> Any:
        return ChangedNormals(original(streams, number), change)

    return wrapped(Streams, "block", broken)


def _louder() -> list[Fault]:
    def loud(generator: np.random.Generator, shape: Any) -> Array:
        return LOUDER * generator.standard_normal(shape)

    def accelerometer(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        return original(replace(model, noise_std=LOUDER * model.noise_std), f_s, rng)

    def white(original: Any, model: NoiseModel, *given: Any) -> Array:
        own = LOUDER * np.asarray(model.white_raw_per_sqrt_hz)
        return original(replace(model, white_raw_per_sqrt_hz=own), *given)

    name = "noise 1 % louder"
    felt = wrapped(AccelerometerModel, "distort", accelerometer)
    return [
        *(_smoke(study, "noise", name, _normals(loud)) for study in DRAWN),
        *(_smoke(s, "noise", name, felt) for s in FELT),
        _smoke("noise_model", "noise", name, wrapped(NoiseModel, "draw", white)),
    ]  # fmt: skip


def _told() -> list[Fault]:
    def more(*names: str) -> Any:
        def change(original: Any, *given: Any, **named: Any) -> Any:
            named |= {name: LOUDER * named[name] for name in names}
            return original(*given, **named)

        return change

    def told(study: str, owner: Any, function: str, *names: str) -> Fault:
        inject = wrapped(owner, function, more(*names))
        return _smoke(study, "calibrator", "told 1 % more noise", inject)

    both = ("accelerometer_std", "magnetometer_std")
    return [
        told("magnetometer", magnetometer, "calibrate_magnetometer", *both),
        told("gyroscope", gyroscope, "calibrate_gyroscope", "angle_random_walk"),
        told("filter", Mekf, "__init__", "accelerometer_noise", "magnetometer_noise"),
    ]


def _again() -> list[Fault]:
    def first(original: Any, streams: Streams, number: int) -> Any:
        return original(streams, 0)

    def second(original: Any, streams: Streams, number: int) -> Any:
        return original(streams, 0 if number == 1 else number)

    every, once = wrapped(Streams, "block", first), wrapped(Streams, "block", second)
    few = ("calibration", "gyroscope", "noise_model", "end_to_end", "filter")
    return [
        *(_smoke(s, "noise", "every block the same noise", every) for s in BLOCKS),
        *(_smoke(s, "noise", "one block's noise used twice", once) for s in few),
    ]


def _shared() -> list[Fault]:
    def pair(generator: np.random.Generator, shape: Any) -> Array:
        noise = generator.standard_normal(shape)
        if np.ndim(noise) == 3 and len(noise) == 2:
            noise[1] = noise[0]
        return noise

    class Again:
        # the second draw repeats the first one's numbers
        def __init__(self, original: Any, streams: Streams, number: int) -> None:
            self.make: Callable[[], Any] = lambda: original(streams, number)

        def standard_normal(self, shape: Any = None) -> Any:
            return self.make().standard_normal(shape)

    again = wrapped(Streams, "block", Again)
    name = "two sensors share a stream"
    return [
        _smoke("magnetometer", "noise", name, _normals(pair)),
        *(_smoke(s, "noise", name, again) for s in ("gyroscope", "filter")),
    ]


def _freedom() -> list[Fault]:
    def biased(moments: Any) -> Any:
        n = moments.samples
        return replace(moments, covariance=moments.covariance * ((n - 1) / n))

    def variance(original: Any, sums: Any) -> Any:
        return original(sums) * ((sums.batches - 1) / sums.batches)

    def mean(original: Any, values: Any) -> Any:
        value, error, n = original(values)
        return value, error * np.sqrt((n - 1) / n), n

    def reduced(original: Any, values: Array, *given: Any) -> Any:
        value, error = original(values, *given)
        return value, error * np.sqrt((len(values) - 1) / len(values))

    def fewer(original: Any, poses: Array, *given: Any, **named: Any) -> Any:
        # Type A variances by n - 8
        fit = original(poses, *given, **named)
        n = poses.shape[-2]
        return replace(fit, covariance=fit.covariance * ((n - 9) / (n - 8)))

    def free(original: Any, *given: Any) -> Any:
        fit = original(*given)
        return replace(fit, dof=fit.dof + 1)

    def by_n(
        study: str, part: Part, inject: Any, where: str = "", why: str = ""
    ) -> Fault:
        name = f"n for n - 1{where}"
        return replace(_smoke(study, part, name, inject), baseline=why)

    return [
        by_n("sampling", "estimator", everywhere(plain, "_variance", variance)),
        by_n(
            "sampling", "estimator", everywhere(trials, "mean_of", mean),
            " in an error of a mean",
        ),
        by_n(
            "sampling", "estimator", everywhere(response, "reduced_mean", reduced),
            " under control variates",
        ),
        by_n("coverage", "calibrator", wrapped(coverage, "calibrate", fewer)),
        by_n(
            "magnetometer",
            "calibrator",
            everywhere(magnetometer, "fitted", free),
        ),
        by_n(
            "ladder", "estimator", after(ladder, "moments_of", biased),
            " in the study's own lines", TOO_SMALL,
        ),
    ]  # fmt: skip
