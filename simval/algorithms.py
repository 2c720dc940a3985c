"""The package's own estimators and calibrators, declared like plug-ins.

A user's algorithm is compared with them by the same studies (`simval.plugins.loading`
has their names). The estimators declare their class, so theory judges them too.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix, cross_matrix, normalize
from simval.imu.attitude import (
    case_quaternion,
    estimate_attitude,
    kernel,
    sequential_quaternion,
    two_vector_quaternion,
    wahba_quaternion,
)
from simval.imu.attitude.comparators import triad as triad_quaternion
from simval.imu.calibrate import calibrate
from simval.imu.filters import Mekf
from simval.plugins import Calibrator, Estimator
from simval.plugins.protocol import Filter
from simval.shapes import Float
from simval.vocabulary import Residual

LEAST = 1e-12
"""Relative noise of readings that have none: some residuals ask for its size, and this
moves a parameter by less than rounding."""

_own = partial(Estimator, components="xyzs", matrix="passive")


def _covariance(
    body: Float[Array, "n k 3"],
    references: Float[Array, "n k 3"],
    _: float,
    *,
    covariances: Float[Array, "n 2 k 3 3"],
    weights: Float[Array, " k"] | None = None,
) -> Float[Array, "n 3 3"]:
    r"""First-order covariance of least squares under any noise, in body axes, rad².

    With a the weights, :math:`M^{-1} \sum_i a_i^2 [b_i\times] (P_{bi} + A P_{ri} A^T)
    [b_i\times]^T M^{-1}` and :math:`M = \sum_i a_i (I - b_i b_i^T)`.
    """
    A = attitude_matrix(wahba_quaternion(body, references, weights))[:, None]
    P = covariances[:, 0] + A @ covariances[:, 1] @ A.swapaxes(-1, -2)
    cross = cross_matrix(normalize(body))
    a = np.ones(body.shape[1]) if weights is None else weights
    spread = np.einsum("k,nkij,nkjl,nkml->nim", a**2, cross, P, cross)
    inverse = np.linalg.inv(np.einsum("k,nkij,nklj->nil", a, cross, cross))
    result: Array = inverse @ spread @ inverse
    return (result + result.swapaxes(-1, -2)) / 2.0


wahba = _own(
    name="wahba",
    takes="vectors",
    estimate=lambda body, references, covariances: wahba_quaternion(body, references),
    covariance=_covariance,
    reads=("covariances",),
    kind="wahba",
)
weighted_wahba = _own(
    name="weighted-wahba",
    takes="vectors",
    estimate=lambda body, references, covariances, weights: wahba_quaternion(
        body, references, weights
    ),
    covariance=_covariance,
    reads=("covariances", "weights"),
    kind="weighted wahba",
)


def _arithmetic(frame: str, *vectors: Any) -> Any:
    """Apply the package's own formula to one set of vectors of any number type."""
    block = np.array(vectors, dtype=object).reshape(12, 1)
    if frame == "plain":
        raw = kernel.raw_quaternion(block, frame)
    else:
        if frame == "optimal":
            kernel.fit_pairs(block)
        combines = frame == "combined"
        columns = kernel.column_matrix(block, symmetric=combines)
        pick = kernel.combined_quaternion if combines else kernel.best_quaternion
        raw = pick(columns)
    return raw[:, 0] * (1.0 / np.sqrt(kernel.squared_norm(raw)))[0]


triad = _own(name="triad", estimate=triad_quaternion, kind="triad")
optimal = _own(
    name="optimal",
    estimate=two_vector_quaternion,
    arithmetic=partial(_arithmetic, "optimal"),
    kind="wahba",
)
closed_form = _own(
    name="closed-form",
    estimate=partial(two_vector_quaternion, frame="best"),
    arithmetic=partial(_arithmetic, "best"),
    kind="closed form",
)
combined = _own(
    name="combined",
    estimate=partial(two_vector_quaternion, frame="combined"),
    arithmetic=partial(_arithmetic, "combined"),
    kind="combined",
)
sequential = _own(
    name="sequential",
    estimate=lambda b1, b2, r1, r2: sequential_quaternion(b1, b2, r1, r2).q,
)
table_1 = _own(name="table-1", estimate=case_quaternion)
plain = _own(
    name="plain",
    estimate=lambda b1, b2, r1, r2: estimate_attitude(b1, b2, r1, r2, "plain").q,
    arithmetic=partial(_arithmetic, "plain"),
    fails_at=(
        "identity",
        "reference as body",
        "small angles",
        "half turns about r1",
        "half turns about r2",
        "yaw only",
        "axis in the plane",
    ),
)


def _fit(
    poses: Float[Array, "n 3"], g: float, noise_std: float, *, residual: Residual
) -> tuple[Any, Any, Any]:
    """Calibrate one set of poses of known noise."""
    known = max(noise_std, LEAST * float(np.abs(poses).max()))
    fit = calibrate(poses, g, residual=residual, noise_std=known).require_converged()
    return fit.matrix, fit.B, fit.covariance


def _calibrator(residual: Residual) -> Calibrator:
    return Calibrator(
        name=residual, calibrate=partial(_fit, residual=residual), noise_std=True
    )


squared = _calibrator("squared")
norm = _calibrator("norm")
weighted = _calibrator("weighted")
sampson = _calibrator("sampson")
adjusted = _calibrator("adjusted")

mekf = Filter(
    name="mekf",
    make=Mekf,
    components="xyzs",
    matrix="passive",
    world="NWU",
    reads=(
        "start",
        "start_std",
        "bias_std",
        "gravity",
        "field",
        "gyroscope_noise",
        "gyroscope_walk",
        "accelerometer_noise",
        "magnetometer_noise",
    ),
    batch=True,
)
_OF_THE_FIELD = ("field", "magnetometer_noise")
mekf_six = replace(
    mekf,
    name="mekf-six",
    magnetometer=False,
    reads=tuple(word for word in mekf.reads if word not in _OF_THE_FIELD),
)
