r"""Noise factors of a joint fit: which sensors agree with their stated noise.

The rows of a joint fit are :math:`r = J\,\mathrm{d}\theta + \sum_s n_s`, each n_s the
noise of one sensor, its source, of covariance :math:`\lambda_s V_s`; V_s is what was
stated. With :math:`S = \sum_s \lambda_s V_s` and Z a basis of what J cannot explain,
:math:`P = Z (Z^T S Z)^{-1} Z^T`, true factors give

.. math:: E\,r^T P V_s P r = \mathrm{tr}\,P V_s,\qquad
   \mathrm{var}\,r^T P V_s P r = 2\,\mathrm{tr}\,P V_s P V_s,

and the factors of restricted maximum likelihood are those that make both sides equal
(1 where that would be less): each is multiplied by the ratio until none changes. At the
stated noise the sum over the sources is chi-square of all rows. That and each source's
own part are tested first; where all are what chance leaves, nothing is done. Sources
that chance explains given the factors of the others go back to 1, one by one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.errors import RefusedError
from simval.imu.calibrate.goodness_of_fit import (
    Combination,
    Left,
    Residuals,
    SensorResiduals,
    sum_chance,
)
from simval.shapes import Float

F = TypeVar("F")
CHANCE: Final = 1e-3
"""Of a log whose noise is as stated: that any of its sensors is given more."""
MOST_FACTOR: Final = 10.0
"""Of the error bars of a sensor's own parameters. Beyond it the stated noise is less
than a hundredth of the variance that is seen: what governs the result is in no model,
and to the others the sensor tells less than a hundredth of what it was taken for, half
a percent of their error bars. It is left out."""
_STILL: Final = 1e-4  # of a factor, between steps of its search
_MOST_STEPS: Final = 500
_ROUNDS: Final = 8  # of factors and fit; three are usual
_SAME: Final = 1e-2  # of a factor, between rounds: a hundredth of an error bar


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFactors(ReadOnly):
    """What the residuals of one joint fit say of its sensors, and ask of their noise.

    A batch of trials is weighed by the noise that is stated: it has no sensors.
    """

    # chi-square, rests and moves of each sensor; empty where none was judged
    sensors: tuple[SensorResiduals, ...]
    # by how much the standard deviations of its noise exceed those stated; 1: borne
    factor: Float[Array, " s"]
    widening: Float[Array, " s"]  # the most that error bars of its own have grown by
    # chance that noise as stated leaves as much, in all rows or in those of any sensor;
    # below `CHANCE` a factor is asked for. NaN where none was judged
    p_value: float
    least_determined: Combination | None  # what the fit tells worst

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(each.name for each in self.sensors)

    @property
    def borne(self) -> bool:
        """Whether no sensor was given more than its stated noise."""
        return not np.any(self.factor > 1.0)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What there is to say of each sensor whose noise is more than was stated."""
        return tuple(
            f"noise of the {each.name}: taken {factor:.3g} times as large as stated "
            f"or measured, as its residuals ask; {each.item} {each.worst} is "
            f"farthest off ({each.deviations[each.worst]:.3g} standard deviations)"
            for each, factor in zip(self.sensors, self.factor, strict=True)
            if factor > 1.0
        )

    @property
    def lines(self) -> list[str]:
        """Each sensor's residuals, and the combination that is least determined."""
        if self.least_determined is None:
            return []
        return [
            *(
                f"residuals         {each.name}: {each.sentence}"
                for each in self.sensors
            ),
            f"least determined  {self.least_determined.sentence}",
        ]

    @property
    def refusal(self) -> str:
        """Why the fit is no calibration; empty where it is one."""
        wide = np.flatnonzero((self.factor > 1.0) & ~(self.widening <= MOST_FACTOR))
        if not wide.size:
            return ""
        s = max(wide, key=lambda each: float(self.widening[each]))
        sensor = self.sensors[s]
        return (
            f"the residuals of the {sensor.name} ask for {self.factor[s]:.3g} "
            f"times its noise as stated or measured, and for error bars "
            f"{self.widening[s]:.3g} times as wide, {MOST_FACTOR:g} at most: it does "
            "not follow the model of one calibration; look at "
            f"{sensor.item} {sensor.worst}, which is farthest off, at a scale or a "
            "bias that changes with time, at the range and the clock of the sensor, "
            "and at that noise"
        )

    def as_object(self) -> dict[str, Any]:
        """Return what was found of each sensor, as JSON can hold it."""
        numbers = zip(self.sensors, self.factor, self.widening, strict=True)
        return {
            each.name: each.as_object()
            | {"factor": float(factor), "widening": float(wider)}
            for each, factor, wider in numbers
        }


NOT_JUDGED: Final = NoiseFactors(
    sensors=(), factor=np.ones(0), widening=np.ones(0), p_value=float("nan"),
    least_determined=None,
)  # fmt: skip


def judged(
    found: F,
    fit: Callable[[F, Float[Array, " s"]], F],
    residuals: Callable[[F], Residuals],
) -> tuple[F, NoiseFactors]:
    """Fit again with the noise that the residuals ask for, if they ask for more.

    `fit` takes a fit, and the factors of its sources' standard deviations, to the fit
    with those; `residuals` are the rows of a fit where it ended, their covariances with
    the noise it was made with. Of the last fit it is said what its residuals say.

    Raises
    ------
    RefusedError
        If rounding decides what noise they ask for.
    """
    left = Left(residuals(found))
    for _ in range(_ROUNDS):
        asked = _asked(left)
        if np.all(np.abs(np.log(asked / left.factor)) < _SAME):
            break
        found = fit(found, asked)
        left = Left(residuals(found), asked)
    factor = left.factor
    S = sum(f * f * V for f, V in zip(factor, left.parts, strict=True))
    bars = [
        np.linalg.inv(left.J.T @ np.linalg.solve(V, left.J)).diagonal()
        for V in (S, sum(left.parts))
    ]
    wider = np.sqrt(bars[0] / bars[1])
    return found, NoiseFactors(
        sensors=left.sensors(),
        factor=factor,
        widening=np.array([wider[s.parameters].max() for s in left.sources]),
        p_value=left.p_value(),
        least_determined=left.combination(),
    )


def _asked(left: Left) -> Float[Array, " s"]:
    # factors of the standard deviations, 1 at the least
    free = list(left.free)
    if not free or left.p_value() >= CHANCE:
        return np.ones(len(left.V))
    while True:
        factor = _balanced(left, free)
        # chance that noise as stated of one leaves as much, the others as they are
        chances = [
            sum_chance(
                left.moments(np.where(np.arange(len(factor)) == s, 1.0, factor))[s]
            )
            for s in free
        ]
        most = int(np.argmax(chances))
        if len(free) == 1 or chances[most] < CHANCE / (len(left.V) + 1):
            return factor
        free.pop(most)


def _balanced(left: Left, free: list[int]) -> Float[Array, " s"]:
    # factors of these sources by restricted maximum likelihood
    factor = np.ones(len(left.V))
    for _ in range(_MOST_STEPS):
        last, found = factor.copy(), left.moments(factor)[free, :2]
        if not np.all(found > 0.0):
            names = ", ".join(each.name for each in left.sources)
            msg = (
                f"the noises of these sensors, {names}, differ by so much that "
                "rounding decides what the residuals say; state a noise that each of "
                "them can have"
            )
            raise RefusedError(msg)
        ratio = np.sqrt(found[:, 0] / found[:, 1])
        factor[free] = np.maximum(1.0, factor[free] * ratio)
        if np.all(np.abs(np.log(factor / last)) < _STILL):
            break
    return factor


_SHARE = 0.1  # of a standard deviation, over which a fit is linear


def of_both(accelerometer: Any, magnetometer: Any) -> list[Any]:
    """Shifts of one sensor's poses, and none of the other's."""
    return [
        *((own, 0.0 * own) for own in accelerometer),
        *((0.0 * own, own) for own in magnetometer),
    ]


def widened(
    covariance: Float[Array, "p p"], refitted: Callable[[Any], Any], shifts: Any
) -> Float[Array, "p p"]:
    """Covariance with errors that all rests share, each shift one of one sd."""
    shifts = np.array(shifts)
    if not len(shifts):
        return covariance
    still = refitted(0.0 * shifts[0])
    moved = np.array([refitted(_SHARE * each) - still for each in shifts]) / _SHARE
    return np.asarray(covariance + moved.T @ moved)
