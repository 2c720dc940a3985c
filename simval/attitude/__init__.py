"""Attitude from two vector observations: closed form, its repairs, comparators."""

from simval.attitude.checks import Validity
from simval.attitude.estimator import (
    AttitudeEstimate,
    estimate_attitude,
    two_vector_quaternion,
)

__all__ = [
    "AttitudeEstimate",
    "Validity",
    "estimate_attitude",
    "two_vector_quaternion",
]
