"""Predictions of errors; nothing that they predict is imported here."""

from simval.theory.attitude import (
    AttitudeMoments,
    attitude_moments,
    multiplicative_moments,
)
from simval.theory.calibration import CalibrationMoments, calibration_moments
from simval.theory.cramer_rao import AttitudeBound, attitude_bound, wahba_bound
from simval.theory.cubature import cubature_moments
from simval.theory.density import AttitudeDensity, attitude_density
from simval.theory.estimators import loss_noncentrality, wahba_moments
from simval.theory.filter_budget import (
    FilterPrediction,
    FirstUpdate,
    filter_prediction,
    first_update,
)
from simval.theory.filter_model import (
    CalibrationError,
    FilterModel,
    FilterPath,
    RowError,
    VectorSensor,
    calibration_error,
)
from simval.theory.filter_recursion import FilterBound, filter_bound
from simval.theory.gyroscope import (
    GyroscopeMoments,
    MovePath,
    NineAxisMoments,
    gyroscope_bias,
    gyroscope_moments,
    nine_axis_moments,
)
from simval.theory.magnetometer import MagnetometerMoments, magnetometer_moments
from simval.theory.orders import SufficientOrder, sufficient_order, wahba_order
from simval.theory.plans import (
    GyroscopePlan,
    MagnetometerPlan,
    Plan,
    plan,
    plan_gyroscope,
    plan_magnetometer,
    pose_noise,
)
from simval.theory.series import series_moments

__all__ = [
    "AttitudeBound",
    "AttitudeDensity",
    "AttitudeMoments",
    "CalibrationError",
    "CalibrationMoments",
    "FilterBound",
    "FilterModel",
    "FilterPath",
    "FilterPrediction",
    "FirstUpdate",
    "GyroscopeMoments",
    "GyroscopePlan",
    "MagnetometerMoments",
    "MagnetometerPlan",
    "MovePath",
    "NineAxisMoments",
    "Plan",
    "RowError",
    "SufficientOrder",
    "VectorSensor",
    "attitude_bound",
    "attitude_density",
    "attitude_moments",
    "calibration_error",
    "calibration_moments",
    "cubature_moments",
    "filter_bound",
    "filter_prediction",
    "first_update",
    "gyroscope_bias",
    "gyroscope_moments",
    "loss_noncentrality",
    "magnetometer_moments",
    "multiplicative_moments",
    "nine_axis_moments",
    "plan",
    "plan_gyroscope",
    "plan_magnetometer",
    "pose_noise",
    "series_moments",
    "sufficient_order",
    "wahba_bound",
    "wahba_moments",
    "wahba_order",
]
