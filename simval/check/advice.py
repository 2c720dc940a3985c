"""What a failure of a check means for who wrote the algorithm, and what to do."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from simval.judge import Finding
from simval.statistics import CUBATURE

_ADVICE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "failures": "mend the formula there, or declare the class in `fails_at`",
        "first_order_bias": (
            "an estimate that is right without noise has no error proportional to it: "
            "look for an offset, an absolute value or a threshold"
        ),
        "below_bound": (
            "nobody can be better than the bound: it knows the truth, or what it saw "
            "before"
        ),
        "squared_error_over_predicted": (
            "rare trials are far off, more than cubature shows: look for a threshold"
        ),
        "greatest_error": (
            "rare trials are far off, heavy tails: look for a threshold, or a step "
            "that is not taken"
        ),
        "variance_over_equal_weights": (
            "it would be better with equal weights: the weights are inverse "
            "variances, in the order of the vectors"
        ),
        "class_bias": "this is not the bias of its `kind`: mend it, or declare none",
        "class_covariance": (
            "this is not the covariance of its `kind`: mend it, or declare none"
        ),
        "cubature_bias": "the bias is greater than terms of second order can make it",
        "cubature_bias_at_small_noise": "an error is left that does not shrink with it",
        "bias": (
            "trials and cubature of the same function disagree: it jumps, or depends "
            "on more than its arguments"
        ),
        "covariance": (
            "trials and cubature of the same function disagree: it jumps, or depends "
            "on more than its arguments"
        ),
        "nees": "the covariance that it states is not that of its errors",
        "claim_off": "the covariance is not exact: declare the order that it keeps",
        "claim_off_at_the_noise": "the covariance is not that of its errors",
        "claim_off_at_half_noise": "the covariance lacks a term of the claimed order",
        "unit_length": "the quaternions are not of unit length",
    }
)
"""By family of statistics."""

_OF_A_CALIBRATOR: Final = MappingProxyType(
    {"bias": "a parameter is off by more than any sound residual makes it"}
)

_OF_A_FILTER: Final = MappingProxyType(
    {
        # of the others `filter_advice` says why
        "diverged": "it loses the attitude, or never finds it",
        "rms_below_bound": (
            "nobody can be better than the bound: it knows the truth, or what it saw "
            "before"
        ),
    }
)


UNSETTLED: Final = (
    "cubature of the function does not settle at this noise: it jumps, or is far from "
    "smooth"
)
"""Of a remainder that is too great to judge by: it is cubature's own error."""


def advice_on(finding: Finding) -> str:
    """What to do about a failure; empty where its reason says it."""
    if finding.answer == "inconclusive" and finding.against == CUBATURE:
        return UNSETTLED if "a remainder of" in finding.reason else ""
    if finding.answer != "fail" or not finding.statistic:
        return ""
    family = finding.statistic.partition("[")[0]
    if finding.study == "filter":
        return _OF_A_FILTER.get(family, "")
    if finding.study == "calibrator":
        return _OF_A_CALIBRATOR.get(family, "") or _ADVICE.get(family, "")
    return _ADVICE.get(family, "")
