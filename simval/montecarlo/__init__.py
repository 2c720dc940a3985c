"""Seeded trials, their moments with standard errors, and variance reduction."""

from simval.montecarlo.plain import (
    Sampler,
    Sums,
    along,
    mean_square,
    moments_of,
    simulate,
)
from simval.montecarlo.reduction import Taylor, simulate_reduced, taylor

__all__ = [
    "Sampler",
    "Sums",
    "Taylor",
    "along",
    "mean_square",
    "moments_of",
    "simulate",
    "simulate_reduced",
    "taylor",
]
