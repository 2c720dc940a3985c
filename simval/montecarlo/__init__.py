"""Seeded trials: streaming moments with standard errors, and variance reduction."""

from simval.montecarlo.plain import (
    Sampler,
    Sums,
    batch_means,
    mean_square,
    moments_of,
    simulate,
    sums_of,
)
from simval.montecarlo.reduction import METHODS, Taylor, simulate_reduced, taylor

__all__ = [
    "METHODS",
    "Sampler",
    "Sums",
    "Taylor",
    "batch_means",
    "mean_square",
    "moments_of",
    "simulate",
    "simulate_reduced",
    "sums_of",
    "taylor",
]
