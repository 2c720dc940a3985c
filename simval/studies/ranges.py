"""What a statistic of the studies can be at all, by the name before its bracket.

A share lies between 0 and 1, a size (a root mean square, a ratio of such, a count)
is 0 or more; a statistic that is in neither list has a sign of its own. The
prediction of a statistic is of the same kind.
"""

from math import inf

SHARES = (
    "coverage",
    "coverage_normal",
    "fitted",
    "flip_rate",
    "other_selection_rate",
    "precision",
    "recall",
    "rests_found",
)
SIZES = (
    "apart",
    "bias_error",
    "budget",
    "condition",
    "covariance_error",
    "efficiency",
    "field_mismatch",
    "impure",
    "intervals",
    "limit_ratio",
    "nees",
    "noise_of_mean",
    "norm",
    "norm_over_noise",
    "outside",
    "rank",
    "recovery",
    "rest_force",
    "rest_rate",
    "rests",
    "rms",
    "rms_ratio",
    "sd",
    "simulated_rms_ratio",
    "squared_error_over_predicted",
    "steps",
)


def range_of(statistic: str) -> tuple[float, float]:
    """Least and greatest value that a statistic can have.

    Parameters
    ----------
    statistic : str
        Its name, as in a row.

    Returns
    -------
    tuple of float
        Both included.
    """
    family = statistic.partition("[")[0]
    if family in SHARES:
        return 0.0, 1.0
    return (0.0, inf) if family in SIZES else (-inf, inf)
