"""Seeded trials: streaming moments with standard errors, and variance reduction."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.montecarlo.fused import compiled, simulate_closed_form
    from simval.montecarlo.plain import (
        Sampler,
        Sums,
        along,
        mean_square,
        moments_of,
        simulate,
    )
    from simval.montecarlo.reduction import METHODS, Taylor, simulate_reduced, taylor
else:
    present(__name__, __file__)

__all__ = [
    "METHODS",
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
