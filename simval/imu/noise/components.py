r"""Components of the noise of a rate signal: a table with a row for each.

A component is its Allan variance and its spectrum, of both signs of the frequency, as
IEEE 952 (annex C) has them, and its covariance (V1), (V11), for one unit of its square.
In units of rows, with :math:`\tau` the correlation time of Markov noise, :math:`f` the
frequency of a sine:

.. math::
   N &: \frac1m,\ 1 \qquad
   B : \frac{2\ln2}{\pi},\ \frac1{\omega} \qquad
   K : \frac m3,\ \frac1{\omega^2} \qquad
   Q : \frac3{m^2},\ 4\sin^2\frac\omega2 \\
   M &: \frac{\tau^3}{2m^2}\,\bigl(2x - 3 + 4e^{-x} - e^{-2x}\bigr),\ x = m/\tau,\quad
   \frac1{\omega^2 + \tau^{-2}} \tag{V8}\\
   R &: \frac{m^2}2 \qquad
   A : \Bigl(\frac{\sin^2\pi f m}{m\sin\pi f}\Bigr)^2 \tag{V9, V10}

Markov noise is named by its driving noise :math:`q_c`, the coefficient K of the walk
that it is over times far below :math:`\tau`: its variance is :math:`K^2\tau/2`. The
sine is one of samples; of averages of a continuous signal the last sine in (V10) is
:math:`\pi f`. Ramp and sine are no noise but certain: see (V12).
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

SERIES: Final = 16.0  # |t|/m from which the second difference of flicker is a series

Law = Callable[[Array, float], Array]
"""Of rows to an average, or of a frequency in radians a row, and of the component's
own time in rows."""
Difference = Callable[[Array, Array, float], Array]
"""Of lags of 0 or more, of rows to an average, and of the component's own time."""
KINDS: Final = ("N", "B", "K", "Q")  # that are always asked for, in order


class Letter(NamedTuple):
    """Name and unit of a coefficient."""

    words: str
    raw_unit: str
    rate_power: int = 0
    """Its square in rows over that in seconds is the rate to this power."""


LETTERS: Final = {
    "N": Letter("white noise", "raw/sqrt(Hz)", 1),
    "B": Letter("flicker", "raw"),
    "K": Letter("random walk", "raw/sqrt(s)", -1),
    "q": Letter("Markov noise with a walk", "raw/sqrt(s)", -1),
    "T": Letter("correlation time", "s"),
    "Q": Letter("rounding", "raw s", 2),
    "R": Letter("ramp", "raw/s", -2),
    "A": Letter("sine", "raw"),
    "f": Letter("frequency of the sine", "Hz"),
}
"""Of coefficients, in the order of a reader."""


class Process(NamedTuple):
    """A kind of component, for a unit square coefficient and a unit rate."""

    letter: str
    """Its coefficient: Markov noise and the walk share one, their driving noise."""
    law: Law
    """Allan variance."""
    spectrum: Law | None
    """Two-sided density; None of what is certain."""
    difference: Difference | None
    """Second difference of (V1); None of a sine, whose (V12) is in closed form."""


class Component(NamedTuple):
    """A component of a signal's noise."""

    kind: str
    rows: float = 0.0
    """Correlation time of Markov noise, or period of a sine, rows; else 0."""

    @property
    def process(self) -> Process:
        """The component's row of the table."""
        return PROCESSES[self.kind]

    def law(self, counts: Any) -> Float[Array, " m"]:
        """Allan variance for a square coefficient of one."""
        return self.process.law(np.asarray(counts, dtype=float), self.rows)


def _markov(m: Array, tau: float) -> Array:
    x = m / tau
    u = -np.expm1(-x)
    # by its series where the digits cancel: either is good to 1e-10 at x = 1e-3
    near = x**3 * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x / 12.0)))
    rows = np.where(x < 1e-3, near, 2.0 * (x - u) - u**2)
    return tau**3 / (2.0 * m**2) * rows


def _sine(m: Array, period: float) -> Array:
    half = np.pi / period
    return (np.sin(half * m) ** 2 / (m * np.sin(half))) ** 2


# R(t + m) - 2 R(t) + R(t - m) of (V1) for t >= 0, but for what is the same, or a line,
# at all t: that cancels in (V2)


def _white_difference(t: Array, m: Array, _: float) -> Array:
    return np.minimum(t, m) - m


def _flicker_difference(t: Array, m: Array, _: float) -> Array:
    # without loss of digits where t >> m, and without m^2 ln m
    r = t / m
    far = np.maximum(r, SERIES)
    series = 2.0 * np.log(far) + 3.0 - 1.0 / (6.0 * far**2) - 1.0 / (30.0 * far**4)
    near = np.minimum(r, SERIES)
    direct = _log_square(near + 1.0) - 2.0 * _log_square(near) + _log_square(near - 1.0)
    return m**2 * np.where(r < SERIES, direct, series) / (2.0 * np.pi)


def _log_square(t: Array) -> Array:
    # t^2 ln|t|, 0 at 0
    size = np.abs(t)
    return t * t * np.log(np.where(size > 0.0, size, 1.0))


def _walk_difference(t: Array, m: Array, _: float) -> Array:
    inside = np.minimum(t, m)  # beyond m the difference of |t|^3 is a line
    cube = inside**2 * (6.0 * m - 2.0 * inside) + 2.0 * m**3 - 6.0 * m**2 * inside
    return (cube + 6.0 * m**2 * t) / 12.0


def _rounding_difference(t: Array, m: Array, _: float) -> Array:
    return 1.0 * (t == m) - 2.0 * (t == 0.0)


def _markov_difference(t: Array, m: Array, tau: float) -> Array:
    def walk(x: Array) -> Array:
        return x - 0.5 * x * x + np.expm1(-x)

    x, step = t / tau, m / tau
    twice = 2.0 * walk(x) - walk(x + step) - walk(np.abs(x - step))
    return 0.5 * tau**3 * twice


def _ramp_difference(t: Array, m: Array, _: float) -> Array:
    # of t^4/24, whose fourth difference is the d d' of a ramp
    return 0.5 * m**2 * t**2


PROCESSES: Final = {
    "N": Process("N", lambda m, _: 1.0 / m, lambda w, _: w**0, _white_difference),
    "B": Process("B", lambda m, _: np.full(m.shape, 2.0 * np.log(2.0) / np.pi),
                 lambda w, _: 1.0 / w, _flicker_difference),
    "K": Process("K", lambda m, _: m / 3.0, lambda w, _: w**-2.0, _walk_difference),
    "Q": Process("Q", lambda m, _: 3.0 / m**2,
                 lambda w, _: 4.0 * np.sin(0.5 * w) ** 2, _rounding_difference),
    "M": Process("K", _markov, lambda w, tau: 1.0 / (w**2 + tau**-2.0),
                 _markov_difference),
    "R": Process("R", lambda m, _: 0.5 * m**2, None, _ramp_difference),
    "A": Process("A", _sine, None, None),
}  # fmt: skip
