r"""Odds that something acts on the rests of a gyroscope.

With :math:`X_0` what is there in any case and X the columns that are asked for, the
mean readings of the rests of one axis are

.. math:: y = X_0 c + X \beta + n, \quad \mathrm{cov}\, n = s^2 N^2
   (\mathrm{diag}(1/T_i) + q\, \min(t_i, t_j)),  \tag{RE1}

N its noise as measured, s by how much more the rests scatter, q its walk. The
coefficients c are free (restricted likelihood), :math:`\beta` is normal with k s times
the noise of one rest, k of `SIZES`; k and q are summed over, of each axis by itself.
On an axis without the columns q is the likeliest, with a belief of `_BEST`: beside a
mean over walks, one that is there would make effects of what is slow. The factor s is
with even odds one of all axes or one of each; with even odds again it is 1, or anything
from 0.5 to 100. The columns act on all axes, with even odds, or on any set of them. The
mean of likelihoods with columns over that without are the odds.

An axis with more noise, or with a walk in poses that follow one another, is then no
effect: a fit of all axes with one variance says so in up to 19 % of such logs.
"""

from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.shapes import Float

ODDS: Final = 5.0
"""At which a walk or a column of temperature is kept: one log of a hundred without an
effect exceeds them. Measured, `tests/imu/calibrate/test_rest_effects.py`."""
FORCE_ODDS: Final = 4.0
"""At which the three columns of a force are kept, as often where there is none."""
SIZES: Final = (0.5, 2.0)  # of effects; greater ones are seen whatever is believed
_WALKS: Final = np.r_[0.0, 10.0 ** np.arange(-2.0, 2.1, 0.5)]  # over the noise's square
_BEST: Final = 0.4  # share of its greatest that a likelihood has in the mean over walks
_FACTORS: Final = 10.0 ** np.arange(-0.3, 2.01, 0.02)
_MOST: Final = 30.0  # times the noise: a noise below it, as of a dead band, is none
_AXES: Final = np.array(list(product([False, True], repeat=3)))[1:]


class Rests(NamedTuple):
    """Mean readings of a gyroscope in its rests, with their times."""

    rates: Float[Array, "n 3"]  # mean readings, raw units
    times: Float[Array, " n"]  # s
    seconds: Float[Array, " n"]
    rotation_seconds: Float[Array, " k"]
    before: Any = slice(None, -1)  # the rest of each rotation that is before it
    after: Any = slice(1, None)


class RestEffect(NamedTuple):
    """Effect of some columns on the rests, with its odds."""

    odds: float  # natural logarithm
    needed: float  # for it to be kept
    coefficients: Float[Array, "p 3"]  # of all columns, those asked for last
    covariance: Float[Array, "3 p p"]  # of each axis, as wide as its rests scatter

    @property
    def kept(self) -> bool:
        """True if there is an effect."""
        return self.odds > np.log(self.needed)

    @property
    def reason(self) -> str:
        """Say the odds, and what odds are needed."""
        return (
            f"odds of an effect {np.exp(min(self.odds, 700.0)):.2g} ({self.needed:g} "
            "needed, which one log of a hundred without exceeds)"
        )


def effect(
    rests: Rests,
    steady: Float[Array, "n p"],
    columns: Float[Array, "n m"],
    walk: Float[Array, "3"],
    drift: float | None,
    needed: float = ODDS,
) -> RestEffect:
    """Odds and coefficients of columns, added to what is there in any case.

    By N of each axis, and K of all or what the rests say of each.
    """
    X = np.column_stack([steady, columns])
    (null, full), shares = _tables(rests, steady, columns, walk, drift)
    times = rests.times - rests.times[0]
    white, walked = np.diag(1.0 / rests.seconds), np.minimum(times[:, None], times)
    with_walk = full.reshape(len(SIZES), len(shares), -1, 3)
    most = scipy.special.logsumexp(with_walk, axis=(0, 2)).argmax(axis=0)
    coefficients, covariance = np.empty((X.shape[1], 3)), []
    for a, share in enumerate(shares[most, np.arange(3)]):
        L = np.linalg.cholesky(white + share * walked)
        own, r = np.linalg.solve(L, X), np.linalg.solve(L, rests.rates[:, a])
        coefficients[:, a] = np.linalg.lstsq(own, r, rcond=None)[0]
        rest = r - own @ coefficients[:, a]
        noise = max(rest @ rest / (len(X) - X.shape[1]), walk[a] ** 2)
        covariance.append(noise * np.linalg.inv(own.T @ own))
    without = null.max(axis=0) + (np.log(_BEST) if len(shares) > 1 else 0.0)
    odds = _odds(without, scipy.special.logsumexp(full, axis=0) - np.log(len(shares)))
    return RestEffect(odds, needed, coefficients, np.array(covariance))


def walk_odds(rests: Rests, walk: Float[Array, "3"], drift: float | None) -> float:
    """Odds of a bias that walks, against a constant one, natural logarithm."""
    steady, none = np.ones((len(rests.times), 1)), np.zeros((len(rests.times), 0))
    (without, _), _ = _tables(rests, steady, none, walk, 0.0)
    (by_walk, _), shares = _tables(rests, steady, none, walk, drift)
    walks = scipy.special.logsumexp(by_walk, axis=0) - np.log(len(shares))
    return _odds(without[0], walks)


def _tables(
    rests: Rests, steady: Float[Array, "n p"], columns: Float[Array, "n m"],
    walk: Float[Array, "3"], drift: float | None,
) -> tuple[tuple[Array, Array], Float[Array, "w 3"]]:  # fmt: skip
    # likelihoods, and the walks of each axis over N^2
    Z = np.linalg.qr(steady, mode="complete")[0][:, steady.shape[1] :]
    times = rests.times - rests.times[0]
    W = Z.T @ np.diag(1.0 / rests.seconds) @ Z
    S = Z.T @ np.minimum(times[:, None], times) @ Z
    y, x = Z.T @ rests.rates, Z.T @ columns
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    scatter = np.sqrt((left**2).sum(axis=0) / np.trace(W))
    rounding = np.finfo(float).eps * np.abs(rests.rates).max()
    N = np.max([walk, scatter / _MOST, np.full(3, rounding)], axis=0)
    N = np.maximum(N, np.finfo(float).tiny)
    shares = _WALKS[:, None] * np.full(3, np.trace(W) / np.trace(S))
    if drift is not None:
        shares = (drift / N)[None] ** 2
    return _likelihoods(y / N, x, W, S, shares), shares


def _likelihoods(
    y: Float[Array, "m 3"], x: Float[Array, "m p"], white: Float[Array, "m m"],
    walked: Float[Array, "m m"], shares: Float[Array, "w 3"],
) -> tuple[Float[Array, "w s 3"], Float[Array, "v s 3"]]:  # fmt: skip
    # of each walk, factor of the noise and axis, without and with the columns; those
    # of the sizes of an effect in turn
    S = white + shares[..., None, None] * walked
    L = np.linalg.cholesky(S)
    own = np.linalg.solve(L, np.broadcast_to(y.T[..., None], (*L.shape[:-1], 1)))
    X = np.linalg.solve(L, np.broadcast_to(x, (*L.shape[:-1], x.shape[1])))
    base = -np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)
    square = (own**2).sum(axis=(-2, -1))
    XX, Xy = np.swapaxes(X, -1, -2) @ X, np.swapaxes(X, -1, -2) @ own

    def likelihood(base: Array, square: Array) -> Array:
        s = _FACTORS[:, None]
        spread = -len(y) * np.log(s) - 0.5 * square[..., None, :] / s**2
        return np.asarray(base[..., None, :] + spread)

    full = []
    for size in SIZES:
        prior = size**2 * np.diagonal(white).mean()
        H = prior * XX + np.eye(x.shape[1])
        drop = prior * (np.swapaxes(Xy, -1, -2) @ np.linalg.solve(H, Xy))[..., 0, 0]
        cost = 0.5 * np.linalg.slogdet(H)[1] + np.log(len(SIZES))
        full.append(likelihood(base - cost, square - drop))
    return likelihood(base, square), np.concatenate(full)


def _odds(null: Float[Array, "s 3"], full: Float[Array, "s 3"]) -> float:
    # of all sets of axes together, the factor of the noise summed over
    prior = np.full((len(_FACTORS), 1), 0.5 / len(_FACTORS))
    prior[np.argmin(np.abs(_FACTORS - 1.0))] += 0.5

    def total(each: Array) -> Array:
        own = scipy.special.logsumexp(each, b=prior, axis=-2).sum(axis=-1)
        common = scipy.special.logsumexp(each.sum(axis=-1), b=prior[:, 0], axis=-1)
        return np.logaddexp(own, common)

    share = np.where(_AXES.all(axis=1), 0.5, 0.0) + 0.5 / len(_AXES)
    some = total(np.where(_AXES[:, None], full, null))
    return float(scipy.special.logsumexp(some, b=share) - total(null))
