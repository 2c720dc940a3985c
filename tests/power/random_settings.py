"""Random legal settings of each study whose judged rows rest on samples.

A setting is drawn from a seed: geometry, poses, noise, dip, algorithm. It has few
samples, which is the harder case, and is one at which the study judges its rows. The
studies of a user's code are given the package's own, in this process: what is asked is
whether the study's verdicts are right, and not whether a process can be started.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, get_args

import numpy as np

from simval.arrays import Array
from simval.plugins import Calibrator, find_plugin
from simval.results import Outcome
from simval.shapes import Float
from simval.streams import Streams
from simval.studies import (
    attitude,
    attitude_efficiency,
    attitude_limits,
    attitude_vectors,
    calibration,
    calibrator,
    coverage,
    detector,
    end_to_end,
    estimator,
    filter,
    gyroscope,
    ladder,
    magnetometer,
    noise_model,
    sampling,
)
from simval.theory.two_vector import two_vector_geometry

FEW = 1024
"""Trials, of which the studies of calibrations have as many in the smoke suite."""

LEAST = 256
"""Trials of a study whose trials are slow: with fewer the gate judges nothing."""

Setting = Callable[[np.random.Generator], Any]
"""Parameters of a cell, drawn at random."""

Run = Callable[[Any, Streams], Outcome]
"""Rows of a cell."""

WITHOUT_CHANCE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "scene": "draws nothing",
        "custom_scene": "draws nothing",
        "attitude_order": "draws nothing",
        "attitude_geometries": "draws nothing: its geometries are numbered",
        "attitude_map": "draws nothing: its geometries are numbered",
        "solvers": "draws one set of readings, on which all methods must agree",
    }
)
"""Studies without a judged row that has a standard error, each with the reason."""


def _attitude(rng: np.random.Generator) -> attitude.Parameters:
    number = int(rng.integers(1_000_000))
    # between 20 and 100 standard deviations from where the estimate flips
    norm = two_vector_geometry(*attitude.random_geometry(number)).norm
    return attitude.Parameters(
        geometry=number,
        noise_std=float(norm / rng.uniform(20.0, 100.0)),
        samples=attitude.MIN_BATCHES * attitude.BATCH,
    )


def _vectors(rng: np.random.Generator) -> attitude_vectors.Parameters:
    return attitude_vectors.Parameters(
        vectors=int(rng.integers(2, 7)),
        ratio=float(10 ** rng.uniform(0.0, 2.0)),
        geometry=int(rng.integers(1_000_000)),
        samples=4096,
    )


def _calibration(rng: np.random.Generator) -> calibration.Parameters:
    poses, noise = int(rng.integers(12, 41)), float(rng.uniform(0.003, 0.03))
    return calibration.Parameters(
        poses=poses, hold_time=0.02, noise_std=noise, trials=FEW
    )


def _ladder(rng: np.random.Generator) -> ladder.Parameters:
    which = ladder.Parameters.model_fields["residual"].annotation
    residual = get_args(which)[rng.integers(5)]
    spread = float(rng.uniform(0.0, 0.9))
    return ladder.Parameters(residual=residual, scale_spread=spread, trials=FEW)


def _coverage(rng: np.random.Generator) -> coverage.Parameters:
    poses = int(rng.integers(15, 60))
    if rng.random() < 0.5:
        return coverage.Parameters(poses=poses, sigma="known", trials=4 * FEW)
    return coverage.Parameters(poses=poses, sigma="type A", trials=4 * FEW)


def _magnetometer(rng: np.random.Generator) -> magnetometer.Parameters:
    return magnetometer.Parameters(
        poses=int(rng.integers(30, 100)),
        dip_deg=float(rng.uniform(-75.0, 75.0)),
        field_noise=float(rng.uniform(1e-4, 5e-3)),
        trials=FEW,
    )


def _limits(rng: np.random.Generator) -> attitude_limits.Parameters:
    ratio = float(rng.uniform(1.5, 2.5))
    return attitude_limits.Parameters(
        norm=float(rng.uniform(0.1, 0.7)), ratio=ratio, samples=16_384
    )


def _gyroscope(rng: np.random.Generator) -> gyroscope.Parameters:
    return gyroscope.Parameters(poses=int(rng.integers(13, 17)), trials=256)


def _noise_model(rng: np.random.Generator) -> noise_model.Parameters:
    return noise_model.Parameters(
        estimate="known weights",
        rows=4096,
        flicker=float(rng.uniform(0.2, 2.0)),
        walk=float(rng.uniform(0.1, 1.0)),
    )


def _sampling(rng: np.random.Generator) -> sampling.Parameters:
    return sampling.Parameters(
        blocks=int(rng.integers(2, 33)), numbers=int(rng.integers(1024, 8193))
    )


def _even_seeds(parameters: sampling.Parameters, streams: Streams) -> Outcome:
    # the study draws the streams of the next seed too, which is then no other run's
    return sampling.run(parameters, Streams(2 * streams.seed, streams.key))


def _efficiency(rng: np.random.Generator) -> attitude_efficiency.Parameters:
    return attitude_efficiency.Parameters(
        geometries=int(rng.integers(100, 201)),
        trials=int(rng.integers(10, 51)),
        noise_std=float(10 ** rng.uniform(-5.0, -3.0)),
    )


def _detector(rng: np.random.Generator) -> detector.Parameters:
    return detector.Parameters(
        scene="die" if rng.random() < 0.5 else "gimbal",
        poses=int(rng.integers(14, 18)),
        noise_std=float(rng.uniform(0.003, 0.03)),
        multiplier=float(rng.uniform(4.0, 12.0)),
        window=2 * int(rng.integers(15, 36)) + 1,
        trim=int(rng.integers(5, 26)),
        trials=LEAST,
    )


def _end_to_end(rng: np.random.Generator) -> end_to_end.Parameters:
    return end_to_end.Parameters(
        poses=int(rng.integers(12, 15)),
        attitudes=int(rng.integers(2, 9)),
        accelerometer_noise_std=float(rng.uniform(0.005, 0.04)),
        magnetometer_noise_std=float(10 ** rng.uniform(-8.0, -7.0)),
        average=int(rng.integers(10, 400)),
        trials=LEAST,
    )


def _estimator(rng: np.random.Generator) -> estimator.Parameters:
    names = ("wahba", "weighted-wahba", "triad", "closed-form", "combined")
    name = names[rng.integers(len(names))]
    kinds = ("body", "all", "tangent", "unequal", "general")
    return estimator.Parameters(
        algorithm=f"simval:{name}",
        vectors=int(rng.integers(2, 4)) if name.endswith("wahba") else 2,
        geometry=int(rng.integers(1_000_000)),
        noise=kinds[rng.integers(len(kinds))],
        noise_std=float(10 ** rng.uniform(-3.0, -2.0)),
        samples=4096,
        cases=64,
    )


def _calibrator(rng: np.random.Generator) -> calibrator.Parameters:
    noise = float(rng.uniform(0.003, 0.03))
    if rng.random() < 0.5:  # `SIX`
        return calibrator.Parameters(
            pose_set="faces",
            sensor="full" if rng.random() < 0.5 else "own class",
            poses=6 * int(rng.integers(1, 5)),
            noise_std=noise,
            trials=FEW,
        )
    names = ("squared", "norm", "weighted", "sampson", "adjusted")
    return calibrator.Parameters(
        algorithm=f"simval:{names[rng.integers(len(names))]}",
        poses=int(rng.integers(12, 41)),
        noise_std=noise,
        trials=2 * LEAST,
    )


def _faces(
    poses: Float[Array, "n 3"], g: float
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    up, down = np.split(poses.reshape(-1, 6, 3).mean(axis=0), 2)
    up, down = np.diag(up), np.diag(down)
    return np.diag(2.0 * g / (up - down)), (up + down) / 2.0


SIX: Final = Calibrator(name="six faces", calibrate=_faces, estimates=("scale", "bias"))
"""A calibrator of less than nine parameters, which the package has none of."""


def _calibrated(parameters: calibrator.Parameters, streams: Streams) -> Outcome:
    name = parameters.algorithm
    plugin = find_plugin(name, Calibrator) if name else SIX
    return calibrator.outcome(plugin, parameters, streams)


def _filter(rng: np.random.Generator) -> filter.Parameters:
    scenario = ("gimbal slow", "long rest")[rng.integers(2)]
    wrong = (
        "",
        f", scale {rng.uniform(-2e-3, 2e-3):.3g}",
        f", calibration {rng.uniform(1e-4, 2e-3):.3g}",
        f", gyroscope noise {10 ** rng.uniform(-0.5, 0.5):.3g}",
    )
    return filter.Parameters(
        scenario=scenario + wrong[rng.integers(len(wrong))],
        rate=(25.0, 50.0)[rng.integers(2)],
        seconds=4.0,
        accelerometer_noise=float(10 ** rng.uniform(-3.0, -2.0)),
        magnetometer_noise=float(10 ** rng.uniform(-2.5, -2.0)),
        angle_random_walk=float(10 ** rng.uniform(-2.5, -1.5)),
        start_std=float(10 ** rng.uniform(-3.0, -2.0)),
        trials=LEAST,
    )


SETTINGS: Final[Mapping[str, tuple[Run, Setting]]] = MappingProxyType(
    {
        "sampling": (_even_seeds, _sampling),
        "calibration": (calibration.run, _calibration),
        "ladder": (ladder.run, _ladder),
        "coverage": (coverage.run, _coverage),
        "gyroscope": (gyroscope.run, _gyroscope),
        "magnetometer": (magnetometer.run, _magnetometer),
        "attitude": (attitude.run, _attitude),
        "attitude_efficiency": (attitude_efficiency.run, _efficiency),
        "attitude_limits": (attitude_limits.run, _limits),
        "attitude_vectors": (attitude_vectors.run, _vectors),
        "noise_model": (noise_model.run, _noise_model),
        "detector": (detector.run, _detector),
        "end_to_end": (end_to_end.run, _end_to_end),
        "estimator": (estimator.compute, _estimator),
        "calibrator": (_calibrated, _calibrator),
        "filter": (filter.compute, _filter),
    }
)
"""Studies whose judged rows rest on samples, each with its random settings."""
