"""What makes answers that are nearly right: rounding, and where it happens."""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

NEAR = 0.01
"""Rad, and relative to the parameters: another sign, order or frame is off by more."""

MOVED = 1e-10
"""By which entries are moved: more than rounding of doubles, less than any other."""

DIGITS = 8
"""Most decimals to which an answer is rounded on purpose."""


def moved(given: Float[Array, "..."]) -> Float[Array, "..."]:
    """The same, moved by what only coarse numbers do not show."""
    rng = np.random.default_rng(20_274)
    changed: Array = given + MOVED * rng.standard_normal(given.shape)
    return changed


def cause_of(answers: Float[Array, "n ..."], of_moved: Float[Array, "n ..."]) -> str:
    """Say why answers are only nearly right; the others are to moved input."""
    flat = answers.reshape(len(answers), -1)
    for digits in range(1, DIGITS + 1):
        scaled = flat * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6):
            return f"its answers are rounded to {digits} decimals"
    if np.array_equal(flat, flat.astype(np.float32)):
        return "its answers are in single precision"
    same = np.all(flat == of_moved.reshape(flat.shape), axis=1)
    if np.mean(same) > 0.5:
        return (
            f"it answers the same where what it is given is moved by {MOVED:g}, so it "
            "rounds that, or works in less than double precision"
        )
    return (
        "it rounds on its way, is off by a small constant, or stops before it has "
        "converged"
    )
