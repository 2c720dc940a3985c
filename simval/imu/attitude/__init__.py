"""Attitude from vector observations: closed form, its repairs, other estimators.

The established estimators are in `simval.imu.attitude.comparators`, not imported here:
they need `scipy.spatial`.
"""

from simval.imu.attitude.estimator import (
    AttitudeEstimate,
    Validity,
    estimate_attitude,
    two_vector_quaternion,
)
from simval.imu.attitude.singular import (
    Case,
    SequentialEstimate,
    SingularSolution,
    case_quaternion,
    sequential_quaternion,
    singular_solution,
    turn_is_singular,
)
from simval.imu.attitude.wahba import (
    Consistency,
    WahbaEstimate,
    consistency,
    wahba_covariance,
    wahba_estimate,
    wahba_quaternion,
)

__all__ = [
    "AttitudeEstimate",
    "Case",
    "Consistency",
    "SequentialEstimate",
    "SingularSolution",
    "Validity",
    "WahbaEstimate",
    "case_quaternion",
    "consistency",
    "estimate_attitude",
    "sequential_quaternion",
    "singular_solution",
    "turn_is_singular",
    "two_vector_quaternion",
    "wahba_covariance",
    "wahba_estimate",
    "wahba_quaternion",
]
