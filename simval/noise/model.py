"""Noise model of a signal, and what it was found from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, frozen, positive_number
from simval.errors import RefusedError
from simval.noise.covariance import allan_law
from simval.shapes import Float, Int

LEAST_ROWS: Final = 500  # averages over 1 to 50 rows: 17 lengths for four coefficients
UNITS = {"N": "raw/sqrt(Hz)", "B": "raw", "K": "raw/sqrt(s)", "Q": "raw s"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """One coefficient of a noise model, or its upper bound.

    Attributes
    ----------
    kind : str
        ``N`` white noise, raw units per root hertz; ``B`` flicker, raw units; ``K``
        rate random walk, raw units per root second; ``Q`` rounding of increments, raw
        units times second.
    value : float or None
        The estimate; None where the signal does not show the coefficient.
    sd : float or None
        Its standard deviation; None where there is no estimate.
    low, high : float
        Ends of its 95 % interval: 0 and the upper bound where it is not seen; `high`
        is infinite where nothing bounds it.
    """

    kind: str
    value: float | None
    sd: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisNoise:
    """Noise of one signal.

    Attributes
    ----------
    rate_hz : float
        Rows per second, Hz.
    rows : int
        Rows of the signal.
    counts : Array
        Rows to an average, (m,).
    variances : Array
        Overlapping Allan variances, raw units squared, (m,).
    variance_sd : Array
        Their standard deviations by (V4), (m,).
    used : tuple of int
        First and last but one of the lengths that the fit took.
    coefficients : tuple of Coefficient
        N, B, K (and Q); none where no range of lengths follows the model.
    squares : Array
        N^2, B^2, K^2 and Q^2 of the fit in units of rows, raw units squared, (4,).
    chi2 : float
        Chi-square of the fit.
    dof : int
        Its degrees of freedom.
    p_value : float
        Chance of one at least as high if the model is right.
    step : float
        Step of the converter, raw units; 0 where none is seen.
    statements : tuple of str
        What a reader of the coefficients must know.
    """

    rate_hz: float
    rows: int
    counts: Int[Array, " m"]
    variances: Float[Array, " m"]
    variance_sd: Float[Array, " m"]
    used: tuple[int, int]
    coefficients: tuple[Coefficient, ...]
    squares: Float[Array, "4"]
    chi2: float
    dof: int
    p_value: float
    step: float
    statements: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("variances", "variance_sd", "squares"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def seconds(self) -> Float[Array, " m"]:
        """Averaging times, s, (m,)."""
        return np.asarray(self.counts / self.rate_hz)

    def law(self, seconds: Float[Array, " t"]) -> Float[Array, " t"]:
        """Allan variance of the fitted model.

        Parameters
        ----------
        seconds : Array
            Averaging times, s, (t,).

        Returns
        -------
        Array
            Raw units squared, (t,).
        """
        return np.asarray(allan_law(np.asarray(seconds) * self.rate_hz) @ self.squares)

    def variance_at(self, seconds: float) -> float:
        """Measured Allan variance at an averaging time.

        Parameters
        ----------
        seconds : float
            Averaging time, s, within those that were measured.

        Returns
        -------
        float
            Raw units squared, by straight lines between logarithms.

        Raises
        ------
        RefusedError
            If the time is shorter or longer than those that were measured.
        """
        seconds = positive_number("seconds", seconds, "s")
        times = self.seconds
        near = 1e-9  # relative: a time that is one of them, but for rounding
        if not times[0] * (1.0 - near) <= seconds <= times[-1] * (1.0 + near):
            msg = (
                f"the noise was measured for averages over {times[0]:.3g} s to "
                f"{times[-1]:.3g} s, and {seconds:.3g} s is asked for; a rest of "
                f"{10.0 * seconds:.3g} s shows that"
            )
            raise RefusedError(msg)
        if not np.all(self.variances > 0.0):
            msg = "the readings do not vary, so they show no noise"
            raise RefusedError(msg)
        logs = np.interp(np.log(seconds), np.log(times), np.log(self.variances))
        return float(np.exp(logs))


def largest(
    axes: Sequence[AxisNoise], kind: str, scales: Float[Array, " axes"]
) -> tuple[float | None, float | None]:
    """Largest value that is seen of the axes; largest bound of those that show none."""
    each = [
        (c, float(scale))
        for axis, scale in zip(axes, scales, strict=True)
        for c in axis.coefficients
        if c.kind == kind
    ]
    seen = [scale * c.value for c, scale in each if c.value is not None]
    bounds = [
        scale * c.high for c, scale in each if c.value is None and np.isfinite(c.high)
    ]
    return max(seen, default=None), max(bounds, default=None)
