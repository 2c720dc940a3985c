r"""What a gyroscope's row measures: a mean over a step or an instant, and its delay.

A sensor that integrates gives the mean rate over the step that ends at a row's stamp
(``before``), or that begins there (``after``); a register or a simulator the rate of an
instant. Any of these may come late. The middle of what row k is of is

.. math:: t_k + c, \qquad c = \{-h/2,\ 0,\ h/2\} - d  \tag{R6}

for mean before, instant and mean after, with the step h and the delay d. Only c counts
to first order; the width of what is averaged counts to second.

A delay is that against the accelerometer: what a filter does is to set one beside the
other, so a delay that both have costs nothing.

**Means over the step before.** All rows are turned into these once: from the cubic
spline through rates, integrated, or from that through the running sum of means. Beside
a hole a cubic swings, so there the rate is a straight line. No reading is continued
beyond the ends: a step that is not covered has no mean, NaN.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from simval.arguments import choice
from simval.arrays import Array, real_number
from simval.errors import InputError
from simval.shapes import Float
from simval.vocabulary import ROW_KINDS, RowKind

LONGEST: Final = 0.5  # s, of a delay
HOLE: Final = 3.5
"""Steps between two rows, beyond which a straight line joins them."""
MIDDLES: Final = {"before": -0.5, "instant": 0.0, "after": 0.5}
WORDS: Final = {
    "before": "means over the step before",
    "instant": "instants",
    "after": "means over the step after",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """What the rows of a gyroscope measure, and when.

    Attributes
    ----------
    kind : {"before", "instant", "after"}
        Mean rate over the step that ends at a row's stamp, rate at its stamp, or mean
        over the step that begins there.
    delay : float
        By how much they are late against the accelerometer's rows, s.

    Raises
    ------
    InputError
        If the kind is none, or the delay is longer than `LONGEST`.
    """

    kind: RowKind = "before"
    delay: float = 0.0

    def __post_init__(self) -> None:
        choice("kind", self.kind, ROW_KINDS)
        delay = real_number("delay", self.delay, "s")
        if not abs(delay) <= LONGEST:
            msg = (
                "the delay of the gyroscope against the accelerometer is "
                f"{1000.0 * delay:g} ms; it must be within {1000.0 * LONGEST:g} ms"
            )
            raise InputError(msg)
        object.__setattr__(self, "delay", delay)

    def __str__(self) -> str:
        side = "late" if self.delay > 0.0 else "early"
        late = f", {1e3 * abs(self.delay):g} ms {side}" if self.delay else ""
        return f"{WORDS[self.kind]}{late}"

    @property
    def options(self) -> tuple[str, ...]:
        """The options of a command that state this."""
        late = ("--gyro-delay", f"{1e3 * self.delay:g}") if self.delay else ()
        return ("--gyro-rows", self.kind, *late)

    def centre(self, step: float) -> float:
        """Middle of the time that a row measures, minus its stamp, s, eq. (R6).

        Parameters
        ----------
        step : float
            Of the log, s.

        Returns
        -------
        float
            Above 0 where it is after the stamp.
        """
        return MIDDLES[self.kind] * step - self.delay

    def in_place(
        self, time: Float[Array, " n"], rates: Float[Array, "n 3"]
    ) -> Float[Array, "n 3"]:
        """Shift the rows by whole steps to within half a step of their true time.

        Noise and readings are kept, for what is turned between two rests; a mean over
        the step after becomes the next row's over the step before.

        Parameters
        ----------
        time : Array
            Stamps, s, (n,), increasing.
        rates : Array
            Rows of this kind, in any unit, (n, 3).

        Returns
        -------
        Array
            The same rows, (n, 3), the first or last repeated at an end.
        """
        step = float(np.median(np.diff(time)))
        moved = round(self.delay / step) - (self.kind == "after")
        if not moved:
            return rates
        rows = np.clip(np.arange(len(time)) + moved, 0, len(time) - 1)
        return rates[rows]

    def means(
        self, time: Float[Array, " n"], rates: Float[Array, "n 3"]
    ) -> Float[Array, "n 3"]:
        """Mean rate over the step that ends at each row; NaN where unknown.

        Parameters
        ----------
        time : Array
            Stamps, s, (n,), increasing.
        rates : Array
            Rows of this kind, in any unit, (n, 3).

        Returns
        -------
        Array
            In the same unit, (n, 3); of means before without a delay the rows.
        """
        if self == BEFORE:
            return rates
        clock = time - time[0]
        ends = np.concatenate([[clock[0] - clock[1]], clock])  # of the steps before
        usual = float(np.median(np.diff(ends)))
        if self.kind == "instant":
            at, values = _over_holes(clock, rates, usual)
            turned = scipy.interpolate.CubicSpline(at, values).antiderivative()
        else:
            own = ends
            if self.kind == "after":
                own = np.concatenate([clock, [2.0 * clock[-1] - clock[-2]]])
            sums = np.cumsum(rates * np.diff(own)[:, None], axis=0)
            at, values = _over_holes(own, np.vstack([np.zeros(3), sums]), usual)
            turned = scipy.interpolate.CubicSpline(at, values)
        wanted = ends + self.delay
        slack = 1e-6 * usual  # of stamps that are rounded
        inside = (wanted >= at[0] - slack) & (wanted <= at[-1] + slack)
        covered = inside[:-1] & inside[1:]
        means = np.diff(turned(wanted), axis=0) / np.diff(ends)[:, None]
        return np.where(covered[:, None], means, np.nan)


BEFORE: Final = Rows()
"""What they are taken as where nothing is known."""


def _over_holes(
    at: Float[Array, " n"], values: Float[Array, "n 3"], step: float
) -> tuple[Float[Array, " m"], Float[Array, "m 3"]]:
    # knots of a cubic, with more on a straight line over each hole
    far = np.flatnonzero(np.diff(at) > HOLE * step)
    if not len(far):
        return at, values
    more = [
        np.linspace(at[k], at[k + 1], round((at[k + 1] - at[k]) / step) + 1)[1:-1]
        for k in far
    ]
    every = np.sort(np.concatenate([at, *more]))
    return every, np.column_stack([np.interp(every, at, each) for each in values.T])
