r"""Components of the noise of a rate signal: a row of the table for each.

A component is its Allan variance and its spectrum for one unit of its square, of both
signs of the frequency, as IEEE 952 (annex C) has them. In units of rows, with
:math:`\tau` the correlation time of Markov noise, :math:`f` the frequency of a sine:

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

Law = Callable[[Array, float], Array]
"""Of rows to an average, or of a frequency in radians a row, and of the component's
own time in rows."""


class Process(NamedTuple):
    """A kind of component, for one unit of its square in units of rows."""

    words: str
    law: Law
    """Allan variance."""
    spectrum: Law | None
    """Two-sided density; None of what is certain."""
    rate_power: int
    """Its square in rows over that in seconds is the rate to this power."""
    raw_unit: str
    letter: str
    """Its coefficient: Markov noise and the walk share one, their driving noise."""


class Component(NamedTuple):
    """A component of a signal's noise."""

    kind: str
    rows: float = 0.0
    """Correlation time of Markov noise, or period of a sine, rows; else 0."""

    @property
    def process(self) -> Process:
        """Its row of the table."""
        return PROCESSES[self.kind]

    def law(self, counts: Any) -> Float[Array, " m"]:
        """Allan variance of one unit of its square."""
        return self.process.law(np.asarray(counts, dtype=float), self.rows)


def _markov(m: Array, tau: float) -> Array:
    x = m / tau
    u = -np.expm1(-x)
    # by its series where the digits cancel: either is good to 1e-10 at x = 1e-3
    near = x**3 * (2.0 / 3.0 - x * (0.5 - x * (7.0 / 30.0 - x / 12.0)))
    rows = np.where(x < 1e-3, near, 2.0 * (x - u) - u**2)
    return np.asarray(tau**3 / (2.0 * m**2) * rows)


def _sine(m: Array, period: float) -> Array:
    half = np.pi / period
    return np.asarray((np.sin(half * m) ** 2 / (m * np.sin(half))) ** 2)


PROCESSES: Final = {
    "N": Process("white noise", lambda m, _: 1.0 / m, lambda w, _: w**0, 1,
                 "raw/sqrt(Hz)", "N"),
    "B": Process("flicker", lambda m, _: np.full(m.shape, 2.0 * np.log(2.0) / np.pi),
                 lambda w, _: 1.0 / w, 0, "raw", "B"),
    "K": Process("random walk", lambda m, _: m / 3.0, lambda w, _: w**-2.0, -1,
                 "raw/sqrt(s)", "K"),
    "Q": Process("rounding", lambda m, _: 3.0 / m**2,
                 lambda w, _: 4.0 * np.sin(0.5 * w) ** 2, 2, "raw s", "Q"),
    "M": Process("Markov noise", _markov, lambda w, tau: 1.0 / (w**2 + tau**-2.0), -1,
                 "raw/sqrt(s)", "K"),
    "R": Process("ramp", lambda m, _: 0.5 * m**2, None, -2, "raw/s", "R"),
    "A": Process("sine", _sine, None, 0, "raw", "A"),
}  # fmt: skip
