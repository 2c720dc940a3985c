r"""Coloured noise of a sensor with three axes: white, flicker and a random walk.

Each axis adds to its readings, at steps of :math:`h` seconds, the sum of

.. math:: n_k &= N\,h^{-1/2}\,g_k  \tag{C1}\\
   w_k &= K\,h^{1/2}\,(g'_1 + \dots + g'_k),\quad w_0 = 0  \tag{C2}\\
   b_k &= B \sum_{j \ge 0} c_j\,g''_{k-j},\quad
   c_0 = 1,\ c_j = c_{j-1}\,(j - 1/2)/j  \tag{C3}

of independent standard normal numbers. Their spectra, of both signs of the frequency,
are :math:`N^2`, :math:`K^2/(2\pi f)^2` and :math:`B^2/(2\pi f)` far below the rate
(exactly, :math:`2\pi f` is :math:`2\sin(\pi f h)/h`), and so their Allan variances are
:math:`N^2/\tau`, :math:`K^2\tau/3` and :math:`(2\ln 2/\pi)\,B^2` for averages over many
rows. Flicker noise has no beginning: the filter runs over twice the rows, and the first
half is thrown away.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from simval.arguments import instance, whole_number
from simval.arrays import Array, positive_number
from simval.sensor.rows import levels_of_axes
from simval.shapes import Float

MOST_ROWS: Final = 10**8  # 2.4 GB for each effect; more is a slip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise of one triad; the defaults are a sensor without any.

    Each is (3,), or one number for all axes, in the raw units of the readings: counts,
    m/s^2 or rad/s.

    Attributes
    ----------
    white_raw_per_sqrt_hz : Array
        White noise N, raw units per square root of a hertz: its standard deviation in
        a row is N times the square root of the rate.
    flicker_raw : Array
        Flicker B, raw units: the Allan deviation stays at 0.664 B. Some data sheets
        call this floor the bias instability.
    walk_raw_per_sqrt_s : Array
        Rate random walk K, raw units per square root of a second: the standard
        deviation that the walk has reached after one second.

    Raises
    ------
    InputError
        If a value is negative or not finite.
    """

    white_raw_per_sqrt_hz: Array | float = 0.0
    flicker_raw: Array | float = 0.0
    walk_raw_per_sqrt_s: Array | float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, levels_of_axes(name, getattr(self, name)))

    def parts(
        self, n: int, rate_hz: float, rng: np.random.Generator
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"]]:
        """White noise, flicker and random walk of consecutive rows, each apart.

        Parameters
        ----------
        n : int
            Number of rows, from 1 to 1e8.
        rate_hz : float
            Rows per second, Hz.
        rng : numpy.random.Generator
            Spawns one stream for each part: switching one on, or making it larger,
            leaves the others' numbers alone.

        Returns
        -------
        tuple of Array
            White noise, flicker and walk, raw units, each (n, 3); the walk starts
            from 0.

        Raises
        ------
        InputError
            If the number of rows or the rate cannot be used.
        """
        n = whole_number("n", n, 1, MOST_ROWS)
        rate_hz = positive_number("rate_hz", rate_hz, "Hz")
        instance("rng", rng, np.random.Generator)
        for_white, for_flicker, for_walk = rng.spawn(3)
        white = np.asarray(self.white_raw_per_sqrt_hz) * np.sqrt(rate_hz)
        walk = np.asarray(self.walk_raw_per_sqrt_s) / np.sqrt(rate_hz)
        flicker = (
            _flicker(n, for_flicker) if np.any(self.flicker_raw) else np.zeros((n, 3))
        )
        return (
            white * for_white.standard_normal((n, 3)),
            np.asarray(self.flicker_raw) * flicker,
            walk * _walk(n, for_walk),
        )

    def draw(
        self, n: int, rate_hz: float, rng: np.random.Generator
    ) -> Float[Array, "n 3"]:
        """Noise of consecutive rows.

        Parameters
        ----------
        n : int
            Number of rows, from 1 to 1e8.
        rate_hz : float
            Rows per second, Hz.
        rng : numpy.random.Generator
            Source of the noise, see `parts`.

        Returns
        -------
        Array
            The sum of white noise, flicker and walk, raw units, (n, 3).

        Raises
        ------
        InputError
            If the number of rows or the rate cannot be used.
        """
        white, flicker, walk = self.parts(n, rate_hz, rng)
        return white + flicker + walk


def _flicker(n: int, rng: np.random.Generator) -> Float[Array, "n 3"]:
    # (C3) with B = 1: the second half of 2n rows; what wraps around a cyclic
    # convolution of 3n - 1 or more falls into the first half
    lags = np.arange(1.0, 2.0 * n)
    response = np.cumprod(np.concatenate(([1.0], (lags - 0.5) / lags)))
    size = scipy.fft.next_fast_len(3 * n - 1, real=True)
    spectrum = scipy.fft.rfft(response, size)
    rows = np.empty((n, 3))
    for axis, stream in enumerate(rng.spawn(3)):
        driven = scipy.fft.rfft(stream.standard_normal(2 * n), size) * spectrum
        rows[:, axis] = scipy.fft.irfft(driven, size)[n : 2 * n]
    return rows


def _walk(n: int, rng: np.random.Generator) -> Float[Array, "n 3"]:
    # (C2) with K = 1 and steps of one second
    steps = rng.standard_normal((n, 3))
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)
