"""Seeded trials: streaming moments with standard errors, and variance reduction."""

from simval.montecarlo.fused import compiled, simulate_closed_form
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
    "compiled",
    "mean_square",
    "moments_of",
    "simulate",
    "simulate_closed_form",
    "simulate_reduced",
    "taylor",
]
