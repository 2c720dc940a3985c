r"""Temperature of the rests: its range, its changes, and what it may be confused with.

**Temperature and time.** What rises all the time is a drift as well: where the order of
the rests' temperatures is that of their times, or nearly (Spearman's correlation beyond
`MONOTONE`), terms fit either, and that is said.

**Within a rest** the force is constant. The slope u of its readings, corrected by the
terms between the rests, against the time is

.. math:: u_i = \beta\,\dot T_i + \rho + e_i, \tag{TH3}

zero but for the noise e. A sensor that heats itself, a thermometer that lags, a drift
in time, or an effect that no term has taken leave :math:`\beta` or :math:`\rho`
alike in all rests. Both are judged together by the F test, the noise by the slopes' own
scatter, beside the covariance of the terms: that of the worst of three axes counts
threefold, for the ratios of three do not add up to one of F's.
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.account import Remark
from simval.arrays import Array, ReadOnly
from simval.imu.calibrate.drift import DRIFT_FALSE_ALARM
from simval.shapes import Float
from simval.spelling import chance as p_words

LEAST_SPAN: Final = 2.0  # K over the rests
LEAST_STEPS: Final = 7.0
"""Of the thermometer, over the rests: uniform errors of the regressor weaken a slope by
2 % there (their variance over that of the temperatures)."""
LEAST_LEFT: Final = 3  # degrees of freedom; two make a t of 4.3, and one of 12.7
MONOTONE: Final = 0.95
"""Of 12 rests in an order of chance one set in 500 000 has such a correlation."""
FOLLOWS: Final = 0.9
"""Share of their variance; three axes explain as much of 24 by chance in 4e-10."""
_ALIKE = 1e3  # condition of rates of temperature fitted with a constant
_AROUND = 5  # rows of a running median


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestTemperatures(ReadOnly):
    """Temperature of each rest.

    Attributes
    ----------
    mean : Array
        Degrees Celsius, (m,).
    change : Array
        From the first to the last row, by a line, K, (m,).
    spread : Array
        Variance within each, K^2, (m,).
    time : Array
        Middle of each rest, s, (m,).
    low, high : float
        Of all their rows, degrees Celsius.
    step : float
        Least difference between two values of the thermometer, K.
    by_force : float
        Share of their variance that follows the mean readings, 0 to 1.
    """

    mean: Float[Array, " m"]
    change: Float[Array, " m"]
    spread: Float[Array, " m"]
    time: Float[Array, " m"]
    low: float
    high: float
    step: float = 0.0
    by_force: float = 0.0

    @classmethod
    def of(
        cls,
        temperature: Float[Array, " n"],
        time: Float[Array, " n"],
        rests: Any,
        poses: Float[Array, "m 3"] | None = None,
    ) -> "RestTemperatures":
        """Average the temperature of the rows over each rest.

        One or two wrong rows in a row (a bus that fails reads 85 or 0) are passed over.
        """
        rows = [
            scipy.ndimage.median_filter(temperature[a:b], _AROUND) for a, b in rests
        ]
        lines = [_line(own, time[a:b]) for own, (a, b) in zip(rows, rests, strict=True)]
        seconds = np.array([np.ptp(time[a:b]) for a, b in rests])
        mean = np.array([own.mean() for own in rows])
        return cls(
            mean=mean,
            change=np.array([slope for slope, _ in lines]) * seconds,
            spread=np.array([own.var() for own in rows]),
            time=np.array([time[a:b].mean() for a, b in rests]),
            low=float(min(own.min() for own in rows)),
            high=float(max(own.max() for own in rows)),
            step=float(np.diff(np.unique(np.concatenate(rows))).min(initial=np.inf)),
            by_force=_share(mean, poses),
        )

    @property
    def span(self) -> float:
        """Highest mean minus lowest mean, K."""
        return float(np.ptp(self.mean))

    @property
    def least_span(self) -> float:
        """Least span that could show an effect, K."""
        step = self.step if np.isfinite(self.step) else 0.0  # of one value
        return max(LEAST_SPAN, LEAST_STEPS * step)

    @property
    def reference(self) -> float:
        """Mean over the rests, degrees Celsius."""
        return float(self.mean.mean())

    @property
    def powers(self) -> Float[Array, "m 2"]:
        """Means of tau and of its square over each rest."""
        tau = self.mean - self.reference
        return np.stack([tau, tau * tau + self.spread], axis=-1)

    @property
    def line(self) -> str:
        """Say the range, and how much the temperature changes within a rest."""
        return (
            f"rests from {self.mean.min():.2f} to {self.mean.max():.2f} degC, within a "
            f"rest by {np.abs(self.change).max():.2g} K at most"
        )

    @property
    def monotone(self) -> Remark | None:
        """Say that it only rises or only falls with time; else nothing."""
        if len(self.mean) < 3 or not self.span > 0.0:
            return None
        ranks = [scipy.stats.rankdata(x) for x in (self.mean, self.time)]
        found = float(np.corrcoef(*ranks)[0, 1])
        if not abs(found) > MONOTONE:
            return None
        words = (
            f"the temperature {'rises' if found > 0.0 else 'falls'} with time "
            f"(rank correlation {found:.2f}), so that a drift in time looks the same"
        )
        do = "Let it cool down again in the same recording."
        return Remark("with time", words, do, {"rank_correlation": found})

    @property
    def confounded(self) -> Remark | None:
        """Say what else would look like an effect of temperature; else nothing."""
        if self.monotone or self.by_force < FOLLOWS:
            return self.monotone
        words = (
            f"the temperature follows the direction of the force (R^2 "
            f"{self.by_force:.2f}), so that bias and scale in it hide each other and "
            "the parameters"
        )
        do = "Take the poses in another order."
        return Remark("with force", words, do, {"R2": self.by_force})

    def not_modelled(self, why: str) -> str:
        """Say that the temperature changed but is not modelled, if it changed."""
        if not self.span > 0.0:
            return ""
        return f"temperature changed by {self.span:.2f} K; not modelled because {why}"

    def refusal(self, left: int) -> str:
        """Say why so few degrees of freedom allow no term; nothing if they do."""
        if self.span < self.least_span:
            return (
                f"{self.least_span:g} K or more between rests are needed to see an "
                "effect"
            )
        if left - 3 < LEAST_LEFT:
            return (
                f"{len(self.mean)} rests leave {left} degree(s) of freedom, and three "
                f"terms with {LEAST_LEFT} to spare need {3 + LEAST_LEFT}"
            )
        return ""


def _share(mean: Float[Array, " m"], poses: Float[Array, "m 3"] | None) -> float:
    # of the variance of the temperatures, by a plane through the mean readings
    away = mean - mean.mean()
    if poses is None or len(poses) < 8 or not away.any():
        return 0.0
    X = np.column_stack([np.ones(len(poses)), poses - poses.mean(axis=0)])
    left = away - X @ np.linalg.lstsq(X, away)[0]
    return 1.0 - (left @ left) / (away @ away)


def _line(values: Array, time: Float[Array, " n"]) -> tuple[Any, float]:
    # slope against the time, and the squares of this that it is known by
    x = time - time.mean()
    square = x @ x
    slope = x @ (values - values.mean(axis=0)) / square if square > 0.0 else 0.0
    return slope, square


class Within(NamedTuple):
    """Change of the readings within rests that no term explains, (TH3)."""

    chance: float  # of as much without an effect; NaN where the rests do not tell
    by_kelvin: Float[Array, "3"]  # raw units
    by_second: Float[Array, "3"]

    @property
    def words(self) -> str:
        """Say what was seen, and what may cause it."""
        if not self.chance < DRIFT_FALSE_ALARM:
            return "within rests the readings show no more of temperature or time"
        kelvin, hour = np.abs(self.by_kelvin).max(), 3600 * np.abs(self.by_second).max()
        return (
            f"within rests the readings change by {kelvin:.2g} raw units a kelvin and "
            f"{hour:.2g} an hour that no term explains "
            f"({p_words(self.chance)}): an effect too small between the rests, a "
            "sensor that heats itself, a thermometer that lags, or a drift in time"
        )


def within_rests(
    rows: Float[Array, "n 3"],
    time: Float[Array, " n"],
    rests: Any,
    seen: RestTemperatures,
    thermal: Any = None,
) -> Within:
    """Test the slopes of corrected readings within the rests, (TH3).

    `thermal` are the terms that corrected them, if any. A temperature that moves in
    steps must pass `LEAST_STEPS` of them in a rest (root mean square) to tell.
    """
    none = Within(np.nan, np.zeros(3), np.zeros(3))
    step = seen.step if np.isfinite(seen.step) else 0.0
    if not np.sqrt(np.mean(seen.change**2)) > LEAST_STEPS * step:
        return none
    lines = [_line(rows[a:b], time[a:b]) for a, b in rests]
    root = np.sqrt([[square] for _, square in lines])
    rate = seen.change / [np.ptp(time[a:b]) for a, b in rests]
    X = np.stack([rate, np.ones(len(rate))], axis=-1)
    dof = len(X) - 2
    if dof < LEAST_LEFT or np.linalg.cond(X / np.abs(X).max(axis=0)) > _ALIKE:
        return none
    u = np.array([slope for slope, _ in lines]) * root
    inverse = np.linalg.pinv(X * root)
    found = inverse @ u
    scatter = ((u - X * root @ found) ** 2).sum(axis=0) / dof
    V = np.multiply.outer(scatter, inverse @ inverse.T)
    if thermal is not None:
        means = np.array([rows[a:b].mean(axis=0) for a, b in rests])
        by_time = np.stack([rate, 2.0 * (seen.mean - seen.reference) * rate], axis=-1)
        moved = inverse @ (root * thermal.shifts(means, by_time))
        V = V + np.einsum("cpa,cqa->apq", moved, moved)
    if not np.all(scatter > 0.0):
        return none
    square = np.einsum("pa,apq,qa->a", found, np.linalg.inv(V), found)
    chance = 3.0 * scipy.special.fdtrc(2, dof, square.max() / 2.0)
    return Within(float(min(chance, 1.0)), *found)
