"""How often the p-values of sound rows are small, in the studies that draw samples.

Each run is one cell on a fresh seed, with few trials and at a setting of its own that
is drawn from that seed: geometry, poses, noise, dip. At most the stated share of the
p-values may be below a level. The rows of a run depend on each other, so how far the
count may be off is found from the spread between the runs.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from simval.streams import Streams, cell_key
from simval.studies import (
    attitude,
    attitude_limits,
    attitude_vectors,
    calibration,
    coverage,
    gyroscope,
    ladder,
    magnetometer,
    noise_model,
)
from simval.theory.two_vector import two_vector_geometry
from simval.verdict import WEIGHTS, p_values

LEVELS = (1e-2, 1e-3, 1e-4)
"""Shares of the p-values that are counted."""

FEW = 1024
"""Trials, of which the studies of calibrations have as many in the smoke suite."""

Setting = Callable[[np.random.Generator], Any]
"""Parameters of a cell, drawn at random."""


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


SETTINGS: Mapping[str, tuple[Any, Setting]] = {
    "attitude": (attitude, _attitude),
    "attitude_limits": (attitude_limits, _limits),
    "attitude_vectors": (attitude_vectors, _vectors),
    "calibration": (calibration, _calibration),
    "coverage": (coverage, _coverage),
    "gyroscope": (gyroscope, _gyroscope),
    "ladder": (ladder, _ladder),
    "magnetometer": (magnetometer, _magnetometer),
    "noise_model": (noise_model, _noise_model),
}
"""Studies whose rows share the false-alarm rate, each with its random settings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tail:
    """How many p-values of the checks of a study are below a level."""

    study: str
    check: str
    level: float
    rows: int
    seen: int  # below the level
    runs: int
    error: float  # standard error of `seen`

    @property
    def expected(self) -> float:
        """How many of them would be, if all p-values were uniform."""
        return self.level * self.rows

    @property
    def too_many(self) -> bool:
        """Whether more are below than chance explains in 999 of 1000 looks."""
        return self.seen - self.expected > 3.1 * self.error


def tails(
    study: str, runs: int, seed: int, advance: Callable[[], object]
) -> Iterator[Tail]:
    """Judge the rows of fresh runs of a study one by one, without Holm's limits."""
    module, setting = SETTINGS[study]
    found: dict[str, list[list[float]]] = {}
    for number in range(seed, seed + runs):
        parameters = setting(np.random.default_rng([number, 1]))
        outcome = module.run(parameters, Streams(number, cell_key(study)))
        for check in WEIGHTS:
            own = [row for row in outcome.rows if row.check == check]
            if own:
                found.setdefault(check, []).append(p_values(own).tolist())
        advance()
    for check, lists in found.items():
        for level in LEVELS:
            yield _tail(study, check, level, lists)


def _tail(study: str, check: str, level: float, lists: list[list[float]]) -> Tail:
    counts = np.array([sum(p < level for p in values) for values in lists])
    rows = sum(map(len, lists))
    # beside the spread between runs that of as many independent rows is allowed: few
    # runs with none below the level have no spread
    spread = np.sqrt(len(counts)) * np.std(counts, ddof=1) if len(counts) > 1 else 0.0
    return Tail(
        study=study,
        check=check,
        level=level,
        rows=rows,
        seen=int(counts.sum()),
        runs=len(lists),
        error=float(max(spread, np.sqrt(level * rows), 1.0)),
    )
