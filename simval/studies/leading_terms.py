r"""Leading terms of an estimator's errors, beside the bound and its class's theory.

By cubature at a noise h and at half of it. With
:math:`E[\theta] = l h + m h^2 + O(h^4)` and :math:`C = P h^2 + Q h^4 + O(h^6)`,

.. math:: l h = 4\,\bar\theta_{h/2} - \bar\theta_h, \quad
   m h^2 = \frac{16\,\bar\theta_{h/2} - \bar\theta_h}{3}, \quad
   P h^2 = \frac{16\,C_{h/2} - C_h}{3}.

One whose attitudes depend on the noise that it reads has no greater trace of P than
least squares with equal weights, where noise is the same in every direction.
An estimate that is right without noise is unbiased to first order: l is zero, and
nothing is below the Cramer-Rao bound. An estimator that declares its class has the m
and P of that class as well, and one that works with power series those of its own
second order. The rest of the sums are of relative order :math:`h^4`.

The two-vector formula in its best frame has these terms where h does not reach another
frame. Where it does, its errors have a kink there, and the sums are of no formula: h is
then the first of `NEARER` that reaches none.
"""

from collections.abc import Iterator

import numpy as np

from simval.arrays import Array
from simval.attitude.kernel import column_matrix
from simval.geometry import attitude_matrix
from simval.results import Row, limit
from simval.shapes import Float
from simval.statistics import (
    BELOW_BOUND,
    CLASS_BIAS,
    CLASS_COVARIANCE,
    CRAMER_RAO,
    EQUAL_WEIGHTS,
    FIRST_ORDER_BIAS,
    NO_BIAS,
    ORDER_2,
    OVER_EQUAL_WEIGHTS,
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

NEARER = (1e-4, 1e-5)
"""Of 400 random geometries four have another frame within 1e-3 of their best one."""


def leading_rows(setting: Setting, rounding: float) -> tuple[Row, ...]:
    """Rows of moments at a noise and at half of it; `rounding` of one estimate, rad."""
    sizes = [setting.noise.small(h).noise_std for h in (NOISE, *NEARER)]
    noise = next((h for h in sizes if _of_one_formula(setting, h)), sizes[-1])
    whole, half = (setting.cubature(noise / part, DEGREE) for part in (1.0, 2.0))
    plugin, weights = setting.plugin, setting.weights
    A = attitude_matrix(setting.q) if plugin.side == "reference" else np.eye(3)
    linear = A @ (4.0 * half[0] - whole[0])[:3]
    bias = A @ (16.0 * half[0] - whole[0])[:3] / 3.0
    covariance = A @ ((16.0 * half[1] - whole[1])[:3, :3] / 3.0) @ A.T
    bound = setting.bound(noise)
    size = float(np.trace(bound))
    most = TOLERANCE + 5.0 * weights * rounding / np.sqrt(size)
    rows = limit(
        (FIRST_ORDER_BIAS(),), (float(np.linalg.norm(linear)) / np.sqrt(size),),
        most, NO_BIAS, n=1,
    ) + limit(
        (BELOW_BOUND(),), (max(0.0, 1.0 - _least_ratio(covariance, bound)),),
        most, CRAMER_RAO, n=1,
    )  # fmt: skip
    if setting.noise.isotropic and np.ptp(setting.noise.weights) and setting.weighs:
        given = setting.q, setting.references, setting.covariances(noise)
        plain = float(np.trace(class_moments("wahba", *given)[1]))
        rows += limit(
            (OVER_EQUAL_WEIGHTS(),), (float(np.trace(covariance)) / plain,),
            1.0 + most, EQUAL_WEIGHTS, n=1,
        )  # fmt: skip
    slack = 6.0 * weights * rounding
    limits = (TOLERANCE + slack / size, TOLERANCE + 2.0 * slack / np.sqrt(size))
    for predictor, mean, spread in _predictions(setting, noise, A):
        # which is the bound's size or more, where it is the theory of an estimator
        most_spread = max(np.linalg.norm(spread), np.linalg.norm(bound))
        off = float(np.linalg.norm(covariance - spread) / most_spread)
        rows += limit(
            (CLASS_BIAS(), CLASS_COVARIANCE()),
            (float(np.linalg.norm(bias - mean)) / size, off), limits, predictor, n=1,
        )  # fmt: skip
    return rows


def _of_one_formula(setting: Setting, noise: float) -> bool:
    """Whether no node of cubature has another best frame than the truth."""
    if setting.plugin.kind != "closed form":
        return True
    vectors = np.concatenate([setting.truth[None], setting.nodes(noise, DEGREE)])
    columns = column_matrix(np.moveaxis(vectors, 0, 2), symmetric=False)
    best = np.argmax(np.einsum("kin,kin->kn", columns, columns), axis=0)
    return bool(np.all(best == best[0]))


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
