r"""Variance reduction: the same moments from fewer trials.

The errors are a function :math:`e(x)` of standard normal noise :math:`x`. Their
features :math:`m(e) = (e, \mathrm{vech}\,ee^T)` are averaged over antithetic pairs, in
which odd terms cancel, with a control variate:

.. math:: \tfrac12 [m(e(x)) + m(e(-x)) - m(c(x)) - m(c(-x))] + E\,m(c),

the Taylor polynomial :math:`c_i = e_i(0) + (Jx)_i + \frac12 x^T H_i x`, whose moments
are known:

.. math:: E c_i = e_i(0) + \tfrac12 \mathrm{tr} H_i, \quad
   E c_i c_j = (JJ^T)_{ij} + E c_i\,E c_j + \tfrac12 \mathrm{tr} H_i H_j.  \tag{R1}

J and H are taken by central differences. Their error costs efficiency and never
correctness, because the known mean is that of the polynomial that was subtracted.

Such samples are blind to a fault of the noise generator: what is not sampled is not
tested. A verdict that rests on them needs a plain row as well.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simval.arguments import function, instance, whole_number
from simval.arrays import Array, ReadOnly, shaped_array
from simval.errors import InputError
from simval.montecarlo.plain import Sums, batch_means, sums_of
from simval.shapes import Float
from simval.streams import Streams

Errors = Callable[[Array], Array]
"""``errors(x)`` of standard normal noise (d, n) gives the errors (p, n)."""

STEP = 0.03
"""Step of the central differences, in standard deviations: rounding leaves about
1e-16/STEP^2 = 1e-13 of a second derivative, truncation STEP^2 of the next term."""

BATCH = 256
"""Evaluations in a batch of eq. (M1), half as many pairs; of the promise of bits."""
MOST = 300
"""Most noise variables: the nodes of the polynomial take 8 d^3 / 2 bytes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Taylor(ReadOnly):
    """Second-order Taylor polynomial of the errors in the noise.

    Attributes
    ----------
    value : Array
        Errors without noise, (p, 1).
    slope : Array
        Jacobian J, (p, d).
    bend : Array
        Second derivatives H, (p, d, d).
    """

    value: Float[Array, "p 1"]
    slope: Float[Array, "p d"]
    bend: Float[Array, "p d d"]

    def __call__(self, x: Float[Array, "d n"]) -> Float[Array, "p n"]:
        """Value of the polynomial."""
        p, d, _ = self.bend.shape
        bent = (self.bend.reshape(p * d, d) @ x).reshape(p, d, -1)
        return self.slope @ x + 0.5 * np.einsum("pdn,dn->pn", bent, x) + self.value

    def features(self) -> Float[Array, " m"]:
        """Means of the features for standard normal noise, eq. (R1), (p (p + 3) / 2,).

        Returns
        -------
        Array
            Mean of c, then of the upper triangle of c c'.
        """
        mean = 0.5 * np.linalg.trace(self.bend) + self.value[:, 0]
        second = self.slope @ self.slope.T + np.outer(mean, mean)
        second += 0.5 * np.einsum("ikl,jlk->ij", self.bend, self.bend)
        return np.concatenate([mean, second[np.triu_indices(len(mean))]])


def taylor(errors: Errors, dimension: int) -> Taylor:
    """Taylor polynomial of the errors by central differences.

    Parameters
    ----------
    errors : callable
        Of standard normal noise.
    dimension : int
        Number of noise variables, d.

    Returns
    -------
    Taylor
        About zero noise.
    """
    function("errors", errors)
    dimension = whole_number("dimension", dimension, 1, MOST)
    eye = STEP * np.eye(dimension)
    rows, columns = np.triu_indices(dimension, 1)
    pairs = eye[:, rows] + eye[:, columns]
    zero = _checked(errors, np.zeros((dimension, 1)))
    plus, minus = errors(eye), errors(-eye)
    cross = errors(pairs) + errors(-pairs) - 2.0 * zero
    alone = plus + minus - 2.0 * zero
    bend = np.zeros((len(zero), dimension, dimension))
    bend[:, np.arange(dimension), np.arange(dimension)] = alone
    bend[:, rows, columns] = (cross - alone[:, rows] - alone[:, columns]) / 2.0
    bend[:, columns, rows] = bend[:, rows, columns]
    slope = (plus - minus) / (2.0 * STEP)
    return Taylor(value=zero, slope=slope, bend=bend / STEP**2)


def simulate_reduced(
    errors: Errors,
    streams: Streams,
    *,
    dimension: int,
    samples: int,
    block: int = 4096,
) -> Sums:
    """Run trials in antithetic pairs, with the Taylor polynomial as control variate.

    Parameters
    ----------
    errors : callable
        ``errors(x)`` of standard normal noise (d, n) gives the errors (p, n).
    streams : Streams
        The cell's random streams.
    dimension : int
        Number of noise variables, d.
    samples : int
        Evaluations of `errors` (a pair is two), rounded up to whole blocks.
    block : int, default 4096
        Evaluations in a block; part of the promise of equal bits.

    Returns
    -------
    Sums
        For `moments_of` and `mean_square`, with honest standard errors.

    Raises
    ------
    InputError
        If a number is not usable, or an error is not finite.
    """
    instance("streams", streams, Streams)
    samples = whole_number("samples", samples, 1)
    block = whole_number("block", block, 1)
    if block % BATCH:
        msg = f"`block` is {block}; it must be a multiple of {BATCH}"
        raise InputError(msg)
    polynomial, batch = taylor(errors, dimension), BATCH // 2
    known, blocks = polynomial.features(), []
    for number in range(-(-samples // block)):
        x = streams.block(number).standard_normal((dimension, block // 2))
        pair = (x, -x)
        means = sum(batch_means(_checked(errors, each), batch) for each in pair) / 2
        control = sum(batch_means(polynomial(each), batch) for each in pair) / 2
        blocks.append(means - control + known)
    whole = np.concatenate(blocks)
    if not np.isfinite(whole).all():
        msg = "the estimator gave a non-finite error; it must be finite on every trial"
        raise InputError(msg)
    return sums_of(whole, batch)


def _checked(errors: Errors, x: Float[Array, "d n"]) -> Array:
    """Call the function, and check that it returns (p, n) real numbers."""
    return shaped_array("the errors", errors(x), (None, x.shape[1]))
