"""Mean and covariance of an error, predicted or measured.

`theory` produces a `Moments` without samples; `montecarlo` produces one with the
number of samples and the standard errors. Comparing the two is `verdict`'s work.
"""

from dataclasses import dataclass, field

import numpy as np

from simval.arrays import Array, frozen, outer
from simval.shapes import Float


def deviations(covariance: Float[Array, "... p p"]) -> Float[Array, "... p"]:
    """Standard deviations from a covariance."""
    return np.sqrt(np.linalg.diagonal(covariance))


_ERRORS = (("bias_error", "bias"), ("covariance_error", "covariance"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moments:
    """Bias and covariance of a vector of p errors, predicted or measured.

    Whoever returns it says what the errors are of, their sign, frame and unit.

    Attributes
    ----------
    bias : Array
        Mean error, (..., p).
    covariance : Array
        Covariance about the mean, (..., p, p).
    samples : int
        Number of samples that were measured; 0 for a prediction.
    bias_error : Array
        Standard error of each entry of `bias`, (..., p); zero for a prediction.
    covariance_error : Array
        Standard error of each entry of `covariance`, (..., p, p); likewise.
    """

    bias: Float[Array, "... p"]
    covariance: Float[Array, "... p p"]
    samples: int = 0
    bias_error: Float[Array, "... p"] = field(default_factory=lambda: np.zeros(0))
    covariance_error: Float[Array, "... p p"] = field(
        default_factory=lambda: np.zeros(0)
    )

    def __post_init__(self) -> None:
        for name, like in (("bias", ""), ("covariance", ""), *_ERRORS):
            value = getattr(self, name)
            if like and value.size == 0:
                value = np.zeros_like(getattr(self, like))
            object.__setattr__(self, name, frozen(value))

    @property
    def sd(self) -> Float[Array, "... p"]:
        """Standard deviation of each entry, (..., p)."""
        return deviations(self.covariance)

    @property
    def second_moment(self) -> Float[Array, "... p p"]:
        """Mean outer product of the error with itself, (..., p, p)."""
        return self.covariance + outer(self.bias, self.bias)

    @property
    def rms(self) -> Float[Array, "... p"]:
        """Root mean square of each entry, (..., p)."""
        return deviations(self.second_moment)
