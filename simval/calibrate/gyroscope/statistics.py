r"""Path statistics: what a stretch of gyroscope readings says, without M or B in it.

Over a stretch of time :math:`\tau` with readings y, ten numbers

.. math:: S = \int y,\quad A = \tfrac12 \int_{s<t} y_s \times y_t,\quad
   m = \tfrac12 \int_{s<t} (y_t - y_s),\quad \tau

give its rotation vector for every matrix M and bias B, up to the third order of it:

.. math:: \phi = M (S - \tau B) + \mathrm{cof}(M)\,(A - B \times m), \tag{N1}

because :math:`Ma \times Mb = \mathrm{cof}(M)(a \times b)`. Stretches that follow each
other are merged by

.. math:: S = S_1 + S_2,\quad A = A_1 + A_2 + \tfrac12 S_1 \times S_2,\quad
   m = m_1 + m_2 + \tfrac12 (\tau_1 S_2 - \tau_2 S_1). \tag{N2}

They are to the gyroscope what the moment matrix is to the accelerometer: one pass over
the samples, and none after it. One step h of the clock has, with the value a at its
middle and b the slope times h, :math:`S = h\bar y`, :math:`A = h^2 a \times b/12`,
:math:`m = h^2 b/12`; the schemes differ in where these come from:

- ``averages``: each row is the mean over the step that ends at it, b half the
  difference of the two neighbours. Order 4;
- ``cubic``: rows are of one instant, through four of them goes a cubic. Order 4, and 3
  where the rate's curvature jumps, as at the ends of a minimum-jerk move;
- ``linear``: rows are of one instant, with straight lines between. Order 2. That is
  what a Runge-Kutta step on samples integrates (IMU-TK, INSLIB), of whatever order.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Float

SCHEMES: Final = ("averages", "cubic", "linear")
STATISTICS: Final = 10  # S, A, m, tau
_S, _A, _m, _tau = slice(0, 3), slice(3, 6), slice(6, 9), 9


def cross(a: Float[Array, "... 3 j"], b: Float[Array, "... 3 j"]) -> Array:
    """Cross product along the last axis but one."""
    result = np.zeros(np.broadcast_shapes(a.shape, b.shape))
    _add_cross(result, a, b)
    return result


def _add_cross(result: Array, a: Array, b: Array) -> None:
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        one = a[..., j, :] * b[..., k, :]
        one -= a[..., k, :] * b[..., j, :]
        result[..., i, :] += one


def path_statistics(
    rates: Float[Array, "t n 3"],
    step: Float[Array, " n"],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    scheme: str,
    chunk: int = 1,
    centre: Float[Array, "t 3"] | None = None,
) -> Float[Array, "t k 10 j"]:
    """Statistics of the steps between rows, merged by `chunk`, from row to row.

    Stretch k goes from the time of row ``first[k]`` to that of ``last[k]``; ``step[r]``
    is the time from row r - 1 to row r. Shorter stretches end in statistics of zero.
    With a `centre` they are those of the readings less it.
    """
    longest = int((last - first).max())
    inside = np.arange(longest) < (last - first)[:, None]
    follows = np.minimum(first[:, None] + np.arange(1, longest + 1), len(step) - 1)
    h = np.where(inside, step[follows], 0.0)
    y = _columns(rates, first, last, longest)
    if centre is not None:
        y -= centre[:, None, :, None]
    steps = _step(y, h[:, None, :], scheme)
    return merged(steps, chunk)


def _columns(
    rates: Float[Array, "t n 3"],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    longest: int,
) -> Float[Array, "t k 3 p"]:
    # rows of each stretch, with one before and one after it; at an end of the
    # recording that is the row there
    y = np.zeros((len(rates), len(first), 3, longest + 3))
    columns = np.swapaxes(rates, 1, 2)
    end = rates.shape[1]
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        y[:, k, :, 1 : b - a + 2] = columns[..., a : b + 1]
        y[:, k, :, 0] = columns[..., max(a - 1, 0)]
        y[:, k, :, b - a + 2] = columns[..., min(b + 1, end - 1)]
    return y


def _step(y: Float[Array, "t k 3 p"], h: Float[Array, "k 1 j"], scheme: str) -> Array:
    # statistics of each step; y holds a row before the first and one after the last
    before, start, end = y[..., :-3], y[..., 1:-2], y[..., 2:-1]
    after = y[..., 3:]
    if scheme == "averages":  # row r is the mean over the step that ends at it
        middle = mean = end
        rise = 0.5 * (after - start)
    elif scheme == "cubic":
        both, wide = start + end, before + after
        mean, middle = (13.0 * both - wide) / 24.0, (9.0 * both - wide) / 16.0
        rise = (27.0 * (end - start) - (after - before)) / 24.0
    else:
        middle = mean = 0.5 * (start + end)
        rise = end - start
    result = np.empty((*y.shape[:-2], STATISTICS, h.shape[-1]))
    np.multiply(rise, h * h / 12.0, out=result[..., _m, :])
    np.multiply(mean, h, out=result[..., _S, :])
    result[..., _A, :] = cross(middle, result[..., _m, :])
    result[..., _tau, :] = h[:, 0, :]
    return result


def merged(steps: Float[Array, "t k 10 j"], chunk: int) -> Float[Array, "t k 10 c"]:
    """Merge so many neighbours into one, eq. (N2)."""
    while chunk > 1:
        count = steps.shape[-1]
        if count % 2:
            zero = np.zeros((*steps.shape[:-1], 1))
            steps = np.concatenate([steps, zero], axis=-1)
        steps = _pairs(steps[..., 0::2], steps[..., 1::2])
        chunk //= 2
    return steps


def _pairs(one: Float[Array, "t k 10 j"], two: Float[Array, "t k 10 j"]) -> Array:
    both = one + two
    first, half = np.ascontiguousarray(one[..., _S, :]), 0.5 * two[..., _S, :]
    _add_cross(both[..., _A, :], first, half)
    both[..., _m, :] += one[..., [_tau], :] * half
    both[..., _m, :] -= 0.5 * two[..., [_tau], :] * first
    return both
