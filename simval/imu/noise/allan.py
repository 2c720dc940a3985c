r"""Overlapping Allan variance of a rate signal: its expectation and its covariance.

With :math:`x_k = y_1 + \dots + y_k` and averages over m of n rows,

.. math:: \sigma^2(m) = \frac{1}{2 m^2 (n - 2m + 1)}
   \sum_{j=0}^{n-2m} (x_{j+2m} - 2 x_{j+m} + x_j)^2.  \tag{V0}

The mean of the signal cancels in it, and is taken off first, so that the sums stay
small and lose no digits.

**Covariance**, in closed form. The sum of a rate signal's rows has the generalised
covariance

.. math:: R(t) = -\tfrac12 N^2 |t| + \tfrac1{2\pi} B^2 t^2 \ln|t|
   + \tfrac1{12} K^2 |t|^3 + Q^2 [t = 0]  \tag{V1}

and its second differences over m and m' rows, weights w = (1, -2, 1), are correlated by

.. math:: c(t) = \sum_{a, b = -1}^{1} w_a w_b\, R(t + b m' - a m),\qquad
   \sigma^2(m) = \frac{c(0)}{2 m^2}
   = \frac{3 Q^2}{m^2} + \frac{N^2}{m} + \frac{2 \ln 2}{\pi} B^2 + \frac{K^2 m}{3}
   \tag{V2, V3}

t the distance of their middles. For normal noise the covariance of two Allan variances,
averages over n and n' such differences, is then

.. math:: \mathrm{cov}(m, m') = \frac{1}{2 m^2 m'^2 n n'} \sum_{j, k} c(t_j - t_k)^2.
   \tag{V4}

Markov noise adds to :math:`R`

.. math:: -\tfrac12 K^2\tau^3\,\bigl(e^{-|t|/\tau} - 1 + |t|/\tau\bigr).  \tag{V11}

A ramp and a sine are certain: their second differences d are no noise, and scatter the
mean squares only together with noise, by :math:`4 d_j d'_k c(t_j - t_k)` in place of
:math:`2 c^2`. That is (V4) with, for a ramp, :math:`d d' = R^2 m^2 m'^2` beside c and
no square of its own; for a sine, over all phases and for many periods,

.. math:: d d' = 2 A^2 \frac{\sin^2(\omega m/2)\,\sin^2(\omega m'/2)}
   {\sin^2(\omega/2)} \cos\omega t,\qquad
   \sum_{j,k} d d'\,c = \min(n, n')\,|d d'|\;\hat c(\omega)  \tag{V12}

with the spectrum of c, and the square that its phase leaves in a mean over n.

All is in rows: one row is the unit of time, so that each of the four is a variance in
the readings' unit squared. As c is linear in them, (V4) is a quadratic form
in the four whose matrix depends on the lengths alone: it is made once for all signals.
The law of :math:`B` and :math:`K` is that of averages of a continuous signal; that of
samples differs by a share of :math:`1/(2 m^2)` for the walk.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from simval.arguments import whole_number
from simval.arrays import outer, physical_array
from simval.errors import InputError
from simval.imu.noise.components import KINDS, Component
from simval.shapes import Float, Int
from simval.text import shown

LEAST_ROWS: Final = 3  # one average of one row before, and one after: two differences
_BLOCK: Final = 1 << 14  # rows at a time, so that they stay in the processor's cache
PER_OCTAVE: Final = 3
LONGEST: Final = 10
"""Rows over the rows of the longest average: at least nine independent differences,
so that what theory says of their mean squares, a covariance, says enough of them."""


def averaging_counts(n: int, per_octave: int = PER_OCTAVE) -> Int[np.ndarray, " m"]:
    """Numbers of rows to average, evenly spaced on a log scale.

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
    """Check numbers of rows that fit at least twice into a signal.

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


EDGE: Final = 6  # lags beside each of the nine at which c has a kink that are summed
NODES: Final = 36
"""Lags from one kink of c to the next: each one where there are no more; else those at
the edges, and the nodes of a quadrature between them, which leaves up to 6e-4 of a
variance of (V4) (`tests/studies/test_study_allowances.py`)."""
REACH: Final = 20.0  # lags over m + m' where c, flicker's alone, ends: 1e-5 of (V4)
_SIGNS: Final = np.array([-1.0, 0.0, 1.0])
_WEIGHTS: Final = np.array([1.0, -2.0, 1.0])


def allan_law(counts: Any) -> Float[np.ndarray, "m 4"]:
    """Allan variance for one unit of N^2, B^2, K^2 and Q^2 each, eq. (V3).

    Parameters
    ----------
    counts : array_like
        Rows in an average, (m,), above 0; they need not be whole.

    Returns
    -------
    Array
        One column for each of `KINDS`, in that order, with time in rows, (m, 4).

    Raises
    ------
    InputError
        If a count is not above 0.
    """
    m = physical_array("counts", counts, (None,))
    if not np.all(m > 0.0):
        msg = f"`counts` has {m.min():g}; rows to an average are above 0"
        raise InputError(msg)
    return np.stack([Component(kind).law(m) for kind in KINDS], axis=-1)


def covariance_forms(
    counts: Any, n: int, further: Sequence[Component] = ()
) -> Float[np.ndarray, "m m k k"]:
    """Matrices of the quadratic forms (V4) in N^2, B^2, K^2, Q^2 and others.

    Parameters
    ----------
    counts : array_like
        Rows to an average, (m,).
    n : int
        Rows of the signal.
    further : sequence of Component
        Markov noise, a ramp, a sine, in any number: (V11) and (V12).

    Returns
    -------
    Array
        For each pair of lengths, in the order of `KINDS`, then the further ones,
        (m, m, k, k).

    Raises
    ------
    InputError
        If a count does not fit into the signal.
    """
    forms = Forms(counts, n)
    every = [*map(Component, KINDS), *further]
    made = [[forms[one, other] for other in every] for one in every]
    return np.moveaxis(np.array(made), (0, 1), (2, 3))


def allan_covariance(
    forms: Float[np.ndarray, "... m m k k"], squares: Float[np.ndarray, "... k"]
) -> Float[np.ndarray, "... m m"]:
    """Covariance (V4) of the Allan variances of signals.

    Parameters
    ----------
    forms : Array
        From `covariance_forms`, (m, m, 4, 4), or for only some of the coefficients; or
        (s, m, m, k, k) with different ones for each signal.
    squares : Array
        N^2, B^2, K^2 and Q^2 in units of rows, (4,), or (..., 4) for more signals.

    Returns
    -------
    Array
        Unit of the readings to the fourth, (m, m) or (..., m, m).
    """
    pairs = outer(squares, squares)
    every = pairs.reshape(-1, pairs.shape[-1] ** 2)
    flat = forms.reshape(*forms.shape[:-4], -1, every.shape[1])
    made = every @ flat.T if flat.ndim == 2 else flat @ every[..., None]
    return made.reshape(*squares.shape[:-1], *forms.shape[-4:-2])


class Forms(dict[tuple[Component, Component], Float[np.ndarray, "m m"]]):
    """Terms of (V4) for each pair of components, computed when they are needed.

    So is what a component has at each lag, however many others it stands beside.
    """

    def __init__(self, counts: Any, n: int) -> None:
        n = whole_number("n", n, LEAST_ROWS)
        lengths = checked_counts(counts, n)
        self._size = len(lengths)
        self._pairs = np.triu_indices(len(lengths))
        m, other = (lengths[each][:, None] for each in self._pairs)
        self._one, self._two = one, two = m.astype(float), other.astype(float)
        self._many = many = n - 2 * m + 1, n - 2 * other + 1
        # lag of the middles = lag of the starts + m - m'
        low = -(many[1] - 1) + one - two
        high = many[0] - 1 + one - two
        kinks = one[..., None] * _SIGNS[:, None] + two[..., None] * _SIGNS
        lags, share = _lags(kinks.reshape(-1, 9), REACH * (one + two), low, high)
        share *= _pairs_at(lags, one, two, many)
        # of all pairs in turn, but for what stands for none
        pair, place = np.nonzero(share)
        self._lags, self._share = lags[pair, place], share[pair, place]
        self._first = np.searchsorted(pair, np.arange(len(share)))
        self._lengths = one[pair, 0], two[pair, 0]
        self._norm = (2.0 * one * one * two * two * many[0] * many[1])[:, 0]
        self._known: dict[Component, Float[np.ndarray, " l"]] = {}

    def __missing__(
        self, pair: tuple[Component, Component]
    ) -> Float[np.ndarray, "m m"]:
        """Compute the term of a pair as a sum over the lags."""
        one, other = pair
        if "A" in (one.kind, other.kind):
            sine, beside = pair if one.kind == "A" else (other, one)
            sums = self._beside_sine(sine.rows, beside)
        elif one.kind == other.kind == "R":  # what is certain has no square
            sums = np.zeros(len(self._norm))
        else:
            c, d = self._differences(one), self._differences(other)
            sums = np.add.reduceat(c * d * self._share, self._first)
        made = np.empty((self._size, self._size))
        made[self._pairs] = made.T[self._pairs] = sums / self._norm
        self[one, other] = self[other, one] = made
        return made

    def _differences(self, component: Component) -> Float[np.ndarray, " l"]:
        # c(t) of one unit: the shorter difference in closed form
        if component not in self._known:
            difference = component.process.difference
            assert difference is not None  # a sine's sums are in closed form
            c = np.zeros_like(self._lags)
            for start in range(0, len(c), _BLOCK):
                part = slice(start, start + _BLOCK)
                lags, m, other = (a[part] for a in (self._lags, *self._lengths))
                for sign, weight in zip(_SIGNS, _WEIGHTS, strict=True):
                    t = np.abs(lags + sign * other)
                    c[part] += weight * difference(t, m, component.rows)
            self._known[component] = c
        return self._known[component]

    def _beside_sine(self, period: float, other: Component) -> Float[np.ndarray, " p"]:
        # (V12): its product with a component, and its own at the end
        omega = 2.0 * np.pi / period
        one, two = (np.sin(0.5 * omega * each) ** 2 for each in (self._one, self._two))
        size = 2.0 * (one * two) / np.sin(0.5 * omega) ** 2  # of D D'/2
        density = other.process.spectrum
        if other.kind == "A" and other.rows == period:
            turned = [np.sin(omega * n) / np.sin(omega) for n in self._many]
            own = (0.5 * size) ** 2 * turned[0] * turned[1]
            return np.where(np.abs(np.sin(omega)) > 1e-9, own, 0.0)[:, 0]
        if density is None:
            return np.zeros(len(size))
        level = density(np.array(omega), other.rows)
        return (2.0 * size * size * level * np.minimum(*self._many))[:, 0]


def _lags(
    kinks: Float[np.ndarray, "p 9"],
    reach: Float[np.ndarray, "p 1"],
    low: Float[np.ndarray, "p 1"],
    high: Float[np.ndarray, "p 1"],
) -> tuple[Float[np.ndarray, "p l"], Float[np.ndarray, "p l"]]:
    # lags from end to end, and for how many of the whole ones each stands
    ends = np.concatenate([-reach, np.sort(kinks, axis=1), reach], axis=1)
    ends = np.clip(ends, low, high)
    start, length = ends[:, :-1, None], np.diff(ends, axis=1)[..., None]
    step = np.arange(NODES)
    few = length < NODES
    each = 1.0 * (step <= length) - 0.5 * (step == 0) - 0.5 * (step == length)
    inner, between = _thinned(length)
    lags = start + np.where(few, np.minimum(step, length), inner)
    share = np.where(few, each, between)
    count = len(ends)
    half = np.full((count, 2), 0.5)
    return (
        np.concatenate([lags.reshape(count, -1), ends[:, [0, -1]]], axis=1),
        np.concatenate([share.reshape(count, -1), half], axis=1),
    )


def _thinned(
    length: Float[np.ndarray, "p s 1"],
) -> tuple[Float[np.ndarray, "p s l"], Float[np.ndarray, "p s l"]]:
    # the edges one by one, and a quadrature, closer to its ends, of what is between
    x, weight = np.polynomial.legendre.leggauss(NODES - 2 * EDGE)
    angle = 0.5 * np.pi * (x + 1.0)
    wide = length - 2.0 * (EDGE - 1.0)
    inner = EDGE - 1.0 + wide * (0.5 - 0.5 * np.cos(angle))
    edge = np.broadcast_to(np.arange(EDGE), (*length.shape[:-1], EDGE))
    ones = np.ones(EDGE)
    ones[[0, -1]] = 0.5
    share = 0.25 * np.pi * wide * np.sin(angle) * weight
    ones = np.broadcast_to(ones, edge.shape)
    return (
        np.concatenate([edge, inner, length - edge], axis=-1),
        np.concatenate([ones, share, ones], axis=-1),
    )


def _pairs_at(
    lags: Float[np.ndarray, "p l"],
    one: Float[np.ndarray, "p 1"],
    two: Float[np.ndarray, "p 1"],
    many: tuple[Int[np.ndarray, "p 1"], Int[np.ndarray, "p 1"]],
) -> Float[np.ndarray, "p l"]:
    # pairs of differences whose middles are so far apart
    start = lags - one + two
    count = np.minimum(many[0], many[1] + start) - np.maximum(0.0, start)
    return np.maximum(count, 0.0)
