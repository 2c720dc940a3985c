r"""Static intervals of an inertial log, by windowed variance magnitude.

The method of Tedaldi, Pretto and Menegatti (IMU-TK): a sample is static when the
variance of the readings in the window centred on it is below a multiple of the
variance of a known rest,

.. math:: \varsigma_k = \Vert (\mathrm{var}_x, \mathrm{var}_y, \mathrm{var}_z)\Vert
   _{|i-k| \le h} < m\, \varsigma_{rest}.  \tag{D1}

The window is :math:`w = 2h + 1` samples, so each interval ends about `h` samples
before the motion does anything in its window. The functions count samples; a log is put
on an even clock first (`evened`), where a window is one second and an interval a second
or longer at any rate: 101 and 100 samples at 100 Hz. All is relative to the rest's own
variance: raw counts and SI units give the same intervals.
"""

from simval.imu.statics.detector import (
    SLOWEST_NOISE,
    WHITE,
    WINDOWS,
    Intervals,
    Rest,
    evened,
    initial_rest,
    interval_counts,
    interval_means,
    intervals_below,
    variance_magnitude,
)
from simval.imu.statics.levels import Step, single_levels
from simval.imu.statics.rotating_rests import Cut, still_parts

__all__ = [
    "SLOWEST_NOISE",
    "WHITE",
    "WINDOWS",
    "Cut",
    "Intervals",
    "Rest",
    "Step",
    "evened",
    "initial_rest",
    "interval_counts",
    "interval_means",
    "intervals_below",
    "single_levels",
    "still_parts",
    "variance_magnitude",
]
