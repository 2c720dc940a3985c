"""Seeded trials: streaming moments with standard errors, and variance reduction."""

from simval.montecarlo.plain import (
    Sampler,
    Sums,
    mean_square,
    moments_of,
    simulate,
)
from simval.montecarlo.reduction import METHODS, Taylor, simulate_reduced, taylor

__all__ = [
    "METHODS",
    "Sampler",
    "Sums",
    "Taylor",
    "mean_square",
    "moments_of",
    "simulate",
    "simulate_reduced",
    "taylor",
]
