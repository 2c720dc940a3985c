"""Madgwick's filter as his released program has it, which BROAD's table is of.

The report's step of gradient descent (S. Madgwick 2010, eqs. 25 to 30) on what the two
sensors should read, but with half the field: the program's `_2bx` is b_x itself. So the
gradient is not zero at the true attitude, and a step is normalised by a length that is
mostly along the quaternion. It is told its start; its gain is that of the table.
"""

from functools import partial
from math import hypot, sqrt

from simval.plugins import Filter


def descent(q, read, x, z):
    """Half the gradient of the squared error of a reading of (x, 0, z) of the world."""
    s, i, j, k = q
    a = x * (1 - 2 * j * j - 2 * k * k) + 2 * z * (i * k - s * j) - read[0]
    b = 2 * x * (i * j - s * k) + 2 * z * (s * i + j * k) - read[1]
    c = 2 * x * (s * j + i * k) + z * (1 - 2 * i * i - 2 * j * j) - read[2]
    return (
        -2 * z * j * a + 2 * (z * i - x * k) * b + 2 * x * j * c,
        2 * z * k * a + 2 * (x * j + z * s) * b + 2 * (x * k - 2 * z * i) * c,
        -2 * (2 * x * j + z * s) * a
        + 2 * (x * i + z * k) * b
        + 2 * (x * s - 2 * z * j) * c,
        2 * (z * i - 2 * x * k) * a + 2 * (z * j - x * s) * b + 2 * x * i * c,
    )


def unit(values):
    """The same of length 1."""
    length = sqrt(sum(value * value for value in values)) or 1.0
    return [value / length for value in values]


class Madgwick:
    """Body to world, scalar first; without a magnetometer, of gravity alone."""

    def __init__(self, start, gain=0.12):
        self.q, self.gain = start.tolist(), gain

    def update(self, dt, gyroscope, accelerometer, magnetometer=None):
        """Turn by the rate, and step down the gradient."""
        q = s, i, j, k = self.q
        step = descent(q, unit(accelerometer.tolist()), 0.0, 1.0)
        if magnetometer is not None:
            x, y, z = field = unit(magnetometer.tolist())
            north = x * (1 - 2 * (j * j + k * k))
            north += 2 * (y * (i * j - s * k) + z * (i * k + s * j))
            west = y * (1 - 2 * (i * i + k * k))
            west += 2 * (x * (i * j + s * k) + z * (j * k - s * i))
            up = z * (1 - 2 * (i * i + j * j))
            up += 2 * (x * (i * k - s * j) + y * (j * k + s * i))
            other = descent(q, field, hypot(north, west) / 2, up / 2)
            step = [one + two for one, two in zip(step, other, strict=True)]
        a, b, c = (rate / 2 for rate in gyroscope.tolist())
        turn = (
            -i * a - j * b - k * c,
            s * a + j * c - k * b,
            s * b - i * c + k * a,
            s * c + i * b - j * a,
        )
        rows = zip(q, turn, unit(step), strict=True)
        self.q = unit([old + dt * (rate - self.gain * d) for old, rate, d in rows])
        return self.q


filter_of = partial(
    Filter,
    make=Madgwick,
    components="sxyz",
    matrix="passive",
    world="NWU",
    reads=("start",),
)
madgwick = filter_of(name="madgwick")
six = filter_of(name="madgwick-six", magnetometer=False)
