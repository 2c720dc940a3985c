"""Whether a change of a statistic is for the better: what each family is best at.

An error is best small, a share of what was found best large, and a ratio of what was
measured to what was stated (a normalised squared error, a coverage) best at its
prediction. Of the other statistics (a condition, an order) a change is a change.
"""

from typing import Literal

from simval.statistics import (
    ALLAN_ERROR,
    BIAS,
    BUDGET,
    CHI_SQUARE_OF_FREEDOM,
    COVARIANCE,
    COVERAGE,
    COVERAGE_NORMAL,
    DIVERGED,
    EFFICIENCY,
    FAILURES,
    FITTED,
    FLIP_RATE,
    IMPURE,
    LEFT,
    NEES,
    NIS,
    OTHER_SELECTION_RATE,
    OUTSIDE,
    POOLED_NEES,
    PRECISION,
    RECALL,
    RECOVERY,
    RESTS_FOUND,
    RMS,
    RMS_AT,
    RMS_DIFFERENCE,
    RMS_OVER_BOUND,
    SCALE_BIAS,
    SD,
    SETTLING,
    SETTLING_TRIALS,
    SQUARED_ERROR,
    STEPS,
    VARIANCE_OVER_BOUND,
    WORST_INSTANT,
    Statistic,
)

Direction = Literal["better", "worse", "changed"]

SMALL = (
    BIAS, SD, COVARIANCE, RMS, RMS_AT, RMS_DIFFERENCE, RMS_OVER_BOUND,
    VARIANCE_OVER_BOUND, RECOVERY, SCALE_BIAS, STEPS, BUDGET, FLIP_RATE,
    OTHER_SELECTION_RATE, DIVERGED, SETTLING, WORST_INSTANT, LEFT, FAILURES, IMPURE,
    OUTSIDE,
)  # fmt: skip
LARGE = (EFFICIENCY, PRECISION, RECALL, RESTS_FOUND, FITTED, SETTLING_TRIALS)
AS_STATED = (
    NEES, POOLED_NEES, NIS, COVERAGE, COVERAGE_NORMAL, SQUARED_ERROR, ALLAN_ERROR,
    CHI_SQUARE_OF_FREEDOM,
)  # fmt: skip


def direction(
    what: Statistic, old: float, new: float, prediction: float | None
) -> Direction:
    """Whether a statistic that went from one value to another is better or worse."""
    family = what.family
    off_diagonal = family == COVARIANCE and len(set(what.entries)) > 1
    if family in SMALL and not off_diagonal:
        gain = abs(old) - abs(new)
    elif family in LARGE:
        gain = new - old
    elif family in AS_STATED and prediction is not None:
        gain = abs(old - prediction) - abs(new - prediction)
    else:
        return "changed"
    if gain == 0.0 or gain != gain:
        return "changed"
    return "better" if gain > 0.0 else "worse"
