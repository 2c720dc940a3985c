r"""The magnetometer's rows once more, with control variates.

The linear part of the errors (`simval.studies.expanded`) is known in law: its square
under its own inverse covariance is chi-square, the events that it lies within its
intervals and its ellipsoid have the stated rate. The sum of squares of the residuals
is, to first order, that of the white equations less that of the parameters,

.. math:: \chi^2 \approx |Ex|^2 - c^T (JJ^T)^{-1} c,

whose mean is 3 n - 22, whatever J is.
"""

from collections.abc import Callable

import numpy as np
import scipy

from simval.arrays import Array
from simval.results import Row
from simval.shapes import Float
from simval.studies.expanded import (
    Expanded,
    Reduced,
    beside,
    linearized,
    reduced_mean,
    reduced_share,
)

LEVEL = 0.95
ALL = 22


def control_rows(
    rows: tuple[Row, ...],
    seen: dict[str, Array],
    errors: Callable[[Array], Array],
    equations: Float[Array, "n 3 d"],
    parts: dict[str, slice],
    bound: Float[Array, "22"],
) -> tuple[Row, ...]:
    """These rows, in their order, of the same trials with control variates."""
    x, error = seen["noise"], seen["error"]
    both = linearized(errors, x)
    fit, recipe = both.take(slice(0, ALL)), both.take(slice(ALL, None))
    own = {name: part for name, part in parts.items() if part.start >= 9}
    # the recipe's bias is not predicted: its variance is
    usual = seen["recipe"] - recipe.mean(seen["recipe"])[0]
    return beside(
        rows,
        (
            fit.mean(error),
            fit.sd(error),
            *(_square(fit, error, part, bound) for part in parts.values()),
            *(
                _square(recipe, usual, slice(part.start - 9, part.stop - 9), bound[9:])
                for part in own.values()
            ),
            *_coverage(fit, seen, equations.reshape(-1, x.shape[1])),
        ),
    )


def _square(
    known: Expanded, error: Float[Array, "t p"], part: slice, bound: Array
) -> Reduced:
    # mean over a part of the errors' squares over the bound
    few = known.take(part)
    weight = np.diag(1.0 / bound[part]) / len(bound[part])
    return few.weighted_square(error[:, part], weight)


def _coverage(
    fit: Expanded, seen: dict[str, Array], equations: Float[Array, "m d"]
) -> tuple[Reduced, ...]:
    z = -scipy.special.ndtri((1.0 - LEVEL) / 2.0)
    sd = np.sqrt(np.diagonal(fit.covariance))
    unit = fit.covariance / np.outer(sd, sd)
    ratio = fit.first / sd
    square = np.vecdot(ratio, np.linalg.solve(unit, ratio.T).T)
    quantile = 2.0 * scipy.special.gammaincinv(ALL / 2.0, LEVEL)
    freedom = len(equations) - ALL
    white = np.sum((seen["noise"] @ equations.T) ** 2, axis=1)
    return (
        reduced_share(seen["inside"] > 0.5, np.abs(ratio) <= z, LEVEL),
        reduced_share(seen["square"] <= quantile, square <= quantile, LEVEL),
        reduced_mean(seen["square"], square, ALL),
        reduced_mean(seen["chi_square"], (white - square) / freedom, 1.0),
    )
