r"""Leading terms of an estimator's errors, beside the bound and its class's theory.

By cubature at a noise h and at half of it. With
:math:`E[\theta] = l h + m h^2 + O(h^4)` and :math:`C = P h^2 + Q h^4 + O(h^6)`,

.. math:: l h = 4\,\bar\theta_{h/2} - \bar\theta_h, \quad
   m h^2 = \frac{16\,\bar\theta_{h/2} - \bar\theta_h}{3}, \quad
   P h^2 = \frac{16\,C_{h/2} - C_h}{3}.

An estimate that is right without noise is unbiased to first order: l is zero, and
nothing is below the Cramer-Rao bound. An estimator that declares its class has the m
and P of that class as well, and one that works with power series those of its own
second order. The rest of the sums are of relative order :math:`h^4`.

An estimator that chooses between formulas, as between frames of the reference, has
leading terms where h does not reach the choice. Where it does, its errors have a kink
there, and these sums are of no formula. What is wrong in the leading terms is wrong at
every h, so what fails at `NOISE` is tried once more `NEARER`.
"""

from collections.abc import Iterator

import numpy as np

from simval.arrays import Array
from simval.geometry import attitude_matrix
from simval.results import Row, limit
from simval.shapes import Float
from simval.statistics import (
    BELOW_BOUND,
    CLASS_BIAS,
    CLASS_COVARIANCE,
    CRAMER_RAO,
    FIRST_ORDER_BIAS,
    NO_BIAS,
    ORDER_2,
    class_of,
)
from simval.studies.estimator_series import series_of
from simval.studies.estimator_setting import DEGREE, Setting
from simval.theory.estimator_classes import class_moments

NOISE = 1e-3
"""The noise h: far above rounding, and its fourth power is nothing."""

TOLERANCE = 1e-3
"""Relative, as of the leading term of a claimed covariance: the package's estimators
are within 2e-8 in 60 random geometries, and a bias of less is 1e-3 of a standard
deviation."""

MOST = 5.0 * TOLERANCE
"""What a limit may be at `NEARER`, with the slack for rounding."""

NEARER = (1e-4, 1e-5)
"""Noises at which a choice is more rarely in reach: of 400 random geometries of the
two-vector estimator four have one within 1e-3 of its best frame."""


def leading_rows(setting: Setting, rounding: float) -> tuple[Row, ...]:
    """Rows of moments at `NOISE`, or `NEARER`; `rounding` of one estimate, rad."""
    rows = _rows(setting, rounding, NOISE)
    for size in NEARER:
        if _hold(rows):
            break
        near = _rows(setting, rounding, size)
        # with the slack of a coarse estimate, what is wrong would pass there
        if _hold(near) and all(_most(row) <= MOST for row in near):
            return near
    return rows


def _most(row: Row) -> float:
    return np.inf if row.prediction is None else row.prediction


def _hold(rows: tuple[Row, ...]) -> bool:
    return all(row.value <= _most(row) for row in rows)


def _rows(setting: Setting, rounding: float, size: float) -> tuple[Row, ...]:
    """Rows of moments at a noise and at half of it."""
    noise = setting.noise.small(size).noise_std
    whole, half = (setting.cubature(noise / part, DEGREE) for part in (1.0, 2.0))
    plugin, weights = setting.plugin, setting.weights
    A = attitude_matrix(setting.q) if plugin.side == "reference" else np.eye(3)
    linear = A @ (4.0 * half[0] - whole[0])[:3]
    bias = A @ (16.0 * half[0] - whole[0])[:3] / 3.0
    covariance = A @ ((16.0 * half[1] - whole[1])[:3, :3] / 3.0) @ A.T
    bound = setting.bound(noise)
    trace = float(np.trace(bound))
    most = TOLERANCE + 5.0 * weights * rounding / np.sqrt(trace)
    rows = limit(
        (FIRST_ORDER_BIAS(),), (float(np.linalg.norm(linear)) / np.sqrt(trace),),
        most, NO_BIAS, n=1,
    ) + limit(
        (BELOW_BOUND(),), (max(0.0, 1.0 - _least_ratio(covariance, bound)),),
        most, CRAMER_RAO, n=1,
    )  # fmt: skip
    slack = 6.0 * weights * rounding
    limits = (TOLERANCE + slack / trace, TOLERANCE + 2.0 * slack / np.sqrt(trace))
    for predictor, mean, spread in _predictions(setting, noise, A):
        # which is the bound's size or more, where it is the theory of an estimator
        most_spread = max(np.linalg.norm(spread), np.linalg.norm(bound))
        off = float(np.linalg.norm(covariance - spread) / most_spread)
        rows += limit(
            (CLASS_BIAS(), CLASS_COVARIANCE()),
            (float(np.linalg.norm(bias - mean)) / trace, off), limits, predictor, n=1,
        )  # fmt: skip
    return rows


def _predictions(
    setting: Setting, noise: float, A: Float[Array, "3 3"]
) -> Iterator[tuple[str, Float[Array, "3"], Float[Array, "3 3"]]]:
    """Theory of second order: of the declared class, and of the plug-in's own series.

    Each with its name, on the body side, to which A takes the plug-in's.
    """
    kind = setting.plugin.kind
    if kind is not None:
        covariances, weights = setting.covariances(noise), setting.noise.weights
        given = setting.q, setting.references, covariances, weights
        yield class_of(kind), *class_moments(kind, *given)
    if setting.plugin.series:
        own = series_of(setting, noise, 2)
        yield ORDER_2, A @ own.bias, A @ own.covariance @ A.T


def _least_ratio(covariance: Float[Array, "3 3"], bound: Float[Array, "3 3"]) -> float:
    """Least variance of any direction over the bound of its variance."""
    root = np.linalg.cholesky(bound)
    half = np.linalg.solve(root, covariance)
    return float(np.linalg.eigvalsh(np.linalg.solve(root, half.T))[0])
