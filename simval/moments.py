"""Mean and covariance of an error, predicted or measured.

`theory` produces a `Moments` without samples; `montecarlo` produces one with the
number of samples and the standard errors. Comparing the two is `verdict`'s work.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array, frozen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moments:
    """Bias and covariance of a p-vector of errors.

    Attributes
    ----------
    bias : Array
        Mean error, (p,).
    covariance : Array
        Covariance about the mean, (p, p).
    samples : int, default 0
        Number of samples behind it; 0 for a prediction.
    bias_error : Array, optional
        Standard error of each entry of `bias`, (p,); zero for a prediction.
    covariance_error : Array, optional
        Standard error of each entry of `covariance`, (p, p); zero for a prediction.
    """

    bias: Array
    covariance: Array
    samples: int = 0
    bias_error: Array | None = None
    covariance_error: Array | None = None

    def __post_init__(self) -> None:
        zeros_b = np.zeros_like(self.bias)
        zeros_c = np.zeros_like(self.covariance)
        defaults = {"bias_error": zeros_b, "covariance_error": zeros_c}
        for name in ("bias", "covariance", "bias_error", "covariance_error"):
            value = getattr(self, name)
            value = defaults[name] if value is None else value
            object.__setattr__(self, name, frozen(value))

    @property
    def sd(self) -> Array:
        """Standard deviation of each entry, (p,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def second_moment(self) -> Array:
        """Mean of the outer product of the error with itself, (p, p)."""
        return self.covariance + np.outer(self.bias, self.bias)

    @property
    def rms(self) -> Array:
        """Root mean square of each entry, (p,)."""
        return np.sqrt(np.diagonal(self.second_moment))
