r"""Overlapping Allan variance of a rate signal, by cumulative sums.

With :math:`x_k = y_1 + \dots + y_k` and averages over m of n rows,

.. math:: \sigma^2(m) = \frac{1}{2 m^2 (n - 2m + 1)}
   \sum_{j=0}^{n-2m} (x_{j+2m} - 2 x_{j+m} + x_j)^2.  \tag{V0}

The mean of the signal cancels in it, and is taken off first, so that the sums stay
small and lose no digits.
"""

from typing import Any, Final

import numpy as np

from simval.arguments import whole_number
from simval.arrays import physical_array
from simval.errors import InputError
from simval.shapes import Float, Int
from simval.text import shown

LEAST_ROWS: Final = 3  # one average of one row before, and one after: two differences
_BLOCK: Final = 1 << 14  # rows at a time, so that they stay in the processor's cache
PER_OCTAVE: Final = 3
LONGEST: Final = 10
"""Rows over the rows of the longest average: at least nine independent differences,
so that what theory says of their mean squares, a covariance, says enough of them."""


def averaging_counts(n: int, per_octave: int = PER_OCTAVE) -> Int[np.ndarray, " m"]:
    """Rows to an average, from 1 to a tenth of a signal, evenly on a log scale.

    Parameters
    ----------
    n : int
        Rows of the signal, 10 or more.
    per_octave : int
        Lengths in a factor of two.

    Returns
    -------
    Array
        Whole numbers that increase, (m,).

    Raises
    ------
    InputError
        If a number is out of its limits.
    """
    n = whole_number("n", n, LONGEST)
    per_octave = whole_number("per_octave", per_octave, 1, 100)
    last = np.log2(n // LONGEST)
    steps = np.arange(int(np.floor(last * per_octave + 1e-9)) + 1) / per_octave
    return np.unique(np.round(2.0**steps).astype(np.int64))


def allan_variance(
    rows: Float[np.ndarray, "n ..."], counts: Any
) -> Float[np.ndarray, "m ..."]:
    """Overlapping Allan variance of each signal, eq. (V0).

    Parameters
    ----------
    rows : Array
        Readings at equal steps of time, (n,) or (n, ...) for more signals, any unit.
    counts : array_like
        Rows to an average, whole numbers from 1 to half of n, (m,).

    Returns
    -------
    Array
        Variances, unit of the readings squared, (m,) or (m, ...).

    Raises
    ------
    InputError
        If a reading is not finite, or a count does not fit into the signal.
    """
    rows = physical_array("rows", rows, ())
    if rows.ndim == 0 or len(rows) < LEAST_ROWS:
        msg = (
            f"`rows` has shape {rows.shape}; an Allan variance needs {LEAST_ROWS} rows "
            "or more, (n,) or (n, signals)"
        )
        raise InputError(msg)
    lengths = checked_counts(counts, len(rows))
    signals = rows.reshape(len(rows), -1)
    found = [_of_one(signals[:, k], lengths) for k in range(signals.shape[1])]
    return np.stack(found, axis=1).reshape(len(lengths), *rows.shape[1:])


def checked_counts(counts: Any, n: int) -> Int[np.ndarray, " m"]:
    """Require whole numbers of rows that fit twice into a signal.

    Raises
    ------
    InputError
        If they are none.
    """
    array = physical_array("counts", counts, (None,))
    whole = array.astype(np.int64) if np.all(np.abs(array) < 2**53) else array
    if not (array.ndim == 1 and array.size and np.all(whole == array)):
        msg = f"`counts` is {shown(counts)}; give whole numbers of rows, (m,)"
        raise InputError(msg)
    if not (np.all(array >= 1) and np.all(array <= n // 2)):
        msg = (
            f"`counts` are from {array.min():g} to {array.max():g} rows; a signal of "
            f"{n} rows has averages of 1 to {n // 2}"
        )
        raise InputError(msg)
    return array.astype(np.int64)


def _of_one(
    signal: Float[np.ndarray, " n"], lengths: Int[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    sums = np.concatenate([[0.0], np.cumsum(signal - signal.mean())])
    twice = 2.0 * sums
    room = np.empty(_BLOCK)
    found = np.empty(len(lengths))
    for k, m in enumerate(lengths.tolist()):
        count = len(signal) - 2 * m + 1
        total = 0.0
        for start in range(0, count, _BLOCK):
            stop = min(start + _BLOCK, count)
            part = room[: stop - start]
            np.add(sums[start + 2 * m : stop + 2 * m], sums[start:stop], out=part)
            part -= twice[start + m : stop + m]
            total += float(part @ part)
        found[k] = total / (2.0 * m * m * count)
    return found
