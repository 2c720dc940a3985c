"""Random legal settings of each study whose judged rows rest on samples.

A setting is drawn from a seed: geometry, poses, noise, dip, algorithm. It has few
samples, which is the harder case, and is one at which the study judges its rows. The
studies of a user's code are given the package's own, in this process: what is asked is
whether the study's verdicts are right, and not whether a process can be started.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, get_args

import numpy as np

from simval.plugins import Calibrator, find_plugin
from simval.streams import Streams
from simval.studies import (
    attitude,
    attitude_efficiency,
    attitude_limits,
    attitude_singular,
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
    thermal,
)
from simval.theory.two_vector import two_vector_geometry

FEW = 1024
"""Trials, of which the studies of calibrations have as many in the smoke suite."""

LEAST = 256
"""Trials of a study whose trials are slow: with fewer the gate judges nothing."""

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


NUMBERS = 1_000_000  # of geometries


def _attitude(rng):
    number = int(rng.integers(NUMBERS))
    # between 20 and 100 standard deviations from where the estimate flips
    norm = two_vector_geometry(*attitude.random_geometry(number)).norm
    return attitude.Parameters(
        geometry=number,
        noise_std=float(norm / rng.uniform(20.0, 100.0)),
        samples=attitude.MIN_BATCHES * attitude.BATCH,
    )


RESIDUALS = get_args(ladder.Parameters.model_fields["residual"].annotation)


def _even_seeds(parameters, streams):
    # the study draws the streams of the next seed too, which is then no other run's
    return sampling.run(parameters, Streams(2 * streams.seed, streams.key))


def _estimator(rng):
    names = ("wahba", "weighted-wahba", "triad", "closed-form", "combined")
    name = names[rng.integers(len(names))]
    kinds = ("body", "all", "tangent", "unequal", "general")
    return estimator.Parameters(
        algorithm=f"simval:{name}",
        vectors=int(rng.integers(2, 4)) if name.endswith("wahba") else 2,
        geometry=int(rng.integers(NUMBERS)),
        noise=kinds[rng.integers(len(kinds))],
        noise_std=float(10 ** rng.uniform(-3.0, -2.0)),
        samples=4096,
        cases=64,
    )


def _calibrator(rng):
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


def _faces(poses, g):
    up, down = np.split(poses.reshape(-1, 6, 3).mean(axis=0), 2)
    up, down = np.diag(up), np.diag(down)
    return np.diag(2.0 * g / (up - down)), (up + down) / 2.0


SIX: Final = Calibrator(name="six faces", calibrate=_faces, estimates=("scale", "bias"))
"""A calibrator of less than nine parameters, which the package has none of."""


def _calibrated(parameters, streams):
    name = parameters.algorithm
    plugin = find_plugin(name, Calibrator) if name else SIX
    return calibrator.outcome(plugin, parameters, streams)


def _scenario(rng):
    scenario = ("gimbal slow", "long rest")[rng.integers(2)]
    wrong = (
        "",
        f", scale {rng.uniform(-2e-3, 2e-3):.3g}",
        f", calibration {rng.uniform(1e-4, 2e-3):.3g}",
        f", gyroscope noise {10 ** rng.uniform(-0.5, 0.5):.3g}",
    )
    return scenario + wrong[rng.integers(len(wrong))]


def drawn(study, **settings):
    """Parameters of a study, drawn in this order: (low, high), or a function of rng."""

    def one(rng, value):
        match value:
            case (int() as low, int() as high):
                return int(rng.integers(low, high))
            case (float() as low, float() as high):
                return float(rng.uniform(low, high))
        return value(rng) if callable(value) else value

    return lambda rng: study.Parameters(
        **{name: one(rng, value) for name, value in settings.items()}
    )


def power_of_ten(low, high):
    return lambda rng: float(10 ** rng.uniform(low, high))


def either(one, other):
    return lambda rng: one if rng.random() < 0.5 else other


def one_of(*values):
    return lambda rng: values[rng.integers(len(values))]


def sampled(study, **settings):
    return study.run, drawn(study, **settings)


SETTINGS: Final[Mapping] = MappingProxyType(
    {
        "sampling": (
            _even_seeds, drawn(sampling, blocks=(2, 33), numbers=(1024, 8193))
        ),
        "calibration": sampled(
            calibration,
            poses=(12, 41), noise_std=(0.003, 0.03), hold_time=0.02, trials=FEW,
        ),
        "ladder": sampled(
            ladder, residual=one_of(*RESIDUALS), scale_spread=(0.0, 0.9), trials=FEW
        ),
        "coverage": sampled(
            coverage, poses=(15, 60), sigma=either("known", "type A"), trials=4 * FEW
        ),
        "thermal": sampled(
            thermal, poses=(24, 60), temperature_span=(10.0, 60.0), trials=FEW
        ),
        "gyroscope": sampled(gyroscope, poses=(13, 25), trials=256),
        "magnetometer": sampled(
            magnetometer,
            poses=(30, 100), dip_deg=(-75.0, 75.0), field_noise=(1e-4, 5e-3),
            trials=FEW,
        ),
        "attitude": (attitude.run, _attitude),
        "attitude_efficiency": sampled(
            attitude_efficiency,
            geometries=(100, 201), trials=(10, 51), noise_std=power_of_ten(-5.0, -3.0),
        ),
        "attitude_limits": sampled(
            attitude_limits, ratio=(1.5, 2.5), norm=(0.1, 0.7), samples=16_384
        ),
        "attitude_singular": sampled(
            attitude_singular,
            case=one_of(*"ABCD"), distance=(8.0, 24.0),
            geometry=(0, NUMBERS), noise_std=power_of_ten(-5.0, -2.0),
        ),
        "attitude_vectors": sampled(
            attitude_vectors,
            vectors=(2, 7), ratio=power_of_ten(0.0, 2.0), geometry=(0, NUMBERS),
            samples=4096,
        ),
        "noise_model": sampled(
            noise_model,
            estimate="known weights", rows=4096, flicker=(0.2, 2.0), walk=(0.1, 1.0),
        ),
        "detector": sampled(
            detector,
            scene=either("die", "gimbal"), poses=(14, 18), noise_std=(0.003, 0.03),
            multiplier=(4.0, 12.0),
            window=lambda rng: 2 * int(rng.integers(15, 36)) + 1,
            trim=(5, 26), trials=LEAST,
        ),
        "end_to_end": sampled(
            end_to_end,
            poses=(12, 15), attitudes=(2, 9), accelerometer_noise_std=(0.005, 0.04),
            magnetometer_noise_std=power_of_ten(-8.0, -7.0), average=(10, 400),
            trials=LEAST,
        ),
        "estimator": (estimator.compute, _estimator),
        "calibrator": (_calibrated, _calibrator),
        "filter": (
            filter.compute,
            drawn(
                filter, scenario=_scenario, rate=one_of(25.0, 50.0), seconds=4.0,
                accelerometer_noise=power_of_ten(-3.0, -2.0),
                magnetometer_noise=power_of_ten(-2.5, -2.0),
                angle_random_walk=power_of_ten(-2.5, -1.5),
                start_std=power_of_ten(-3.0, -2.0), trials=LEAST,
            ),
        ),
    }
)  # fmt: skip
"""Studies whose judged rows rest on samples, each with its random settings."""
