r"""Variance reduction: the same moments from fewer samples, each under its name.

The errors are a function :math:`e(x)` of standard normal noise :math:`x`, and the
features :math:`m(e) = (e, \mathrm{vech}\,ee^T)` are averaged over

========== ===================================================================
plain      :math:`m(e(x))`
antithetic :math:`\frac12 [m(e(x)) + m(e(-x))]`: odd terms cancel
control    :math:`m(e(x)) - m(c(x)) + E\,m(c)` with the Taylor polynomial
           :math:`c_i = (Jx)_i + \frac12 x^T H_i x`, whose moments are known:
           :math:`E c_i = \frac12 \mathrm{tr} H_i`,
           :math:`E c_i c_j = (JJ^T)_{ij} + E c_i\,E c_j
           + \frac12 \mathrm{tr} H_i H_j`  (R1)
both       the control variate on the antithetic pair
sobol      :math:`m(e(x))` over scrambled Sobol points mapped to normals; the
           standard error is that of independent scramblings
========== ===================================================================

J and H are taken by central differences. Their error costs efficiency and never
correctness, because the known mean is that of the polynomial that was subtracted.

All but plain are blind to a fault of the noise generator, in part (antithetic, Sobol)
or altogether (control): what is not sampled is not tested. A verdict that rests on
one of them needs a plain row beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from simval.arguments import choice, function, instance, whole_number
from simval.arrays import Array, ReadOnly, shaped_array
from simval.errors import InputError
from simval.montecarlo.plain import Sums, batch_means, sums_of
from simval.shapes import Float
from simval.streams import Streams

Method = Literal["plain", "antithetic", "control", "both", "sobol"]
PAIRED = ("antithetic", "both")
METHODS: tuple[Method, ...] = ("plain", "antithetic", "control", "both", "sobol")

Errors = Callable[[Array], Array]
"""``errors(x)`` of standard normal noise (d, n) gives the errors (p, n)."""

STEP = 0.03
"""Step of the central differences, in standard deviations: rounding leaves about
1e-16/STEP^2 = 1e-13 of a second derivative, truncation STEP^2 of the next term."""

BATCH = 256
"""Evaluations in a batch of eq. (M1); part of the promise of equal bits."""
MOST = 21201
"""Most noise variables: those of SciPy's Sobol points."""
MOST_BENT = 300
"""Most noise variables of a Taylor polynomial: its nodes take 8 d^3 / 2 bytes."""
MIN_POWER = 6
"""Fewest Sobol points in a scrambling, as a power of two."""

SCRAMBLINGS = 32
"""Independent scramblings of the Sobol points: enough for a standard error that is
itself known to 1/sqrt(62) = 13 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Taylor(ReadOnly):
    """Second-order Taylor polynomial of the errors without their value at zero noise.

    Attributes
    ----------
    slope : Array
        Jacobian J, (p, d).
    bend : Array
        Second derivatives H, (p, d, d).
    """

    slope: Float[Array, "p d"]
    bend: Float[Array, "p d d"]

    def __call__(self, x: Float[Array, "d n"]) -> Float[Array, "p n"]:
        """Value of the polynomial."""
        p, d, _ = self.bend.shape
        bent = (self.bend.reshape(p * d, d) @ x).reshape(p, d, -1)
        return self.slope @ x + 0.5 * np.einsum("pdn,dn->pn", bent, x)

    def features(self) -> Float[Array, " m"]:
        """Means of its features for standard normal noise, eq. (R1), (p (p + 3) / 2,).

        Returns
        -------
        Array
            Mean of c, then of the upper triangle of c c'.
        """
        mean = 0.5 * np.trace(self.bend, axis1=1, axis2=2)
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
        Slope and bend at zero noise.
    """
    dimension = whole_number("dimension", dimension, 1, MOST_BENT)
    errors = _checked(errors)
    eye = STEP * np.eye(dimension)
    rows, columns = np.triu_indices(dimension, 1)
    pairs = eye[:, rows] + eye[:, columns]
    zero = errors(np.zeros((dimension, 1)))
    plus, minus = errors(eye), errors(-eye)
    cross = errors(pairs) + errors(-pairs) - 2.0 * zero
    alone = plus + minus - 2.0 * zero
    bend = np.zeros((len(zero), dimension, dimension))
    bend[:, np.arange(dimension), np.arange(dimension)] = alone
    bend[:, rows, columns] = (cross - alone[:, rows] - alone[:, columns]) / 2.0
    bend[:, columns, rows] = bend[:, rows, columns]
    return Taylor(slope=(plus - minus) / (2.0 * STEP), bend=bend / STEP**2)


def simulate_reduced(
    errors: Errors,
    streams: Streams,
    *,
    dimension: int,
    method: Method,
    samples: int,
    block: int = 4096,
) -> Sums:
    """Run seeded trials with one of the variance reductions.

    Parameters
    ----------
    errors : callable
        ``errors(x)`` of standard normal noise (d, n) gives the errors (p, n).
    streams : Streams
        The cell's random streams.
    dimension : int
        Number of noise variables, d.
    method : {"plain", "antithetic", "control", "both", "sobol"}
        Which reduction.
    samples : int
        Evaluations of `errors` (an antithetic pair is two), rounded up to whole
        blocks; for ``sobol`` to `SCRAMBLINGS` times a power of two, 2048 at least.
    block : int, default 4096
        Evaluations in a block; part of the promise of equal bits.

    Returns
    -------
    Sums
        For `moments_of` and `mean_square`, with honest standard errors. For ``sobol``
        a batch is a scrambling.

    Raises
    ------
    InputError
        If the method is unknown, a number is not usable, or an error is not finite.
    """
    instance("streams", streams, Streams)
    method = choice("method", method, METHODS)
    errors = _checked(errors)
    dimension = whole_number("dimension", dimension, 1, MOST)
    samples = whole_number("samples", samples, 1)
    block = whole_number("block", block, 1)
    if block % BATCH:
        msg = f"`block` is {block}; it must be a multiple of {BATCH}"
        raise InputError(msg)
    if method == "sobol":
        means, batch = _sobol_means(errors, streams, dimension, samples)
    else:
        means = _random_means(errors, streams, dimension, method, samples, block)
        # a pair is one independent sample
        batch = BATCH // 2 if method in PAIRED else BATCH
    if not np.isfinite(means).all():
        msg = "the estimator gave a non-finite error; it must be finite on every trial"
        raise InputError(msg)
    return sums_of(means, batch)


def _checked(errors: Errors) -> Errors:
    # the callable, what it returns required to be (p, n) of real numbers
    function("errors", errors)

    def of(x: Array) -> Array:
        return shaped_array("the errors", errors(x), (None, x.shape[1]))

    return of


def _random_means(
    errors: Errors,
    streams: Streams,
    dimension: int,
    method: Method,
    samples: int,
    block: int,
) -> Float[Array, "batches m"]:
    controlled = method in ("control", "both")
    paired = method in PAIRED
    polynomial = taylor(errors, dimension) if controlled else None
    zero = errors(np.zeros((dimension, 1))) if controlled else 0.0
    batch = BATCH // 2 if paired else BATCH  # evaluations in a batch stay BATCH
    blocks = []
    for number in range(-(-samples // block)):
        rng = streams.block(number)
        x = rng.standard_normal((dimension, block // 2 if paired else block))
        signs = (x, -x) if paired else (x,)
        means = sum(batch_means(errors(s), batch) for s in signs) / len(signs)
        if polynomial is not None:
            # the errors at zero noise are rounding; the polynomial leaves them out
            minus = sum(batch_means(polynomial(s) + zero, batch) for s in signs)
            known = _shifted(polynomial, zero)
            blocks.append(means - minus / len(signs) + known)
        else:
            blocks.append(np.asarray(means))
    return np.concatenate(blocks)


def _shifted(polynomial: Taylor, zero: Array | float) -> Float[Array, " m"]:
    """Means of the features of the polynomial plus a constant."""
    known = polynomial.features()
    p = len(polynomial.slope)
    shift = np.broadcast_to(np.asarray(zero, dtype=float).reshape(-1), (p,))
    rows, columns = np.triu_indices(p)
    mean = known[:p]
    second = known[p:] + mean[rows] * shift[columns] + shift[rows] * mean[columns]
    return np.concatenate([mean + shift, second + shift[rows] * shift[columns]])


def _sobol_means(
    errors: Errors, streams: Streams, dimension: int, samples: int
) -> tuple[Float[Array, "batches m"], int]:
    # powers of two keep the points balanced
    power = max(MIN_POWER, int(np.ceil(np.log2(samples / SCRAMBLINGS))))
    means = []
    for number in range(SCRAMBLINGS):
        from scipy.stats import qmc  # half a second that only this rule needs

        engine = qmc.Sobol(dimension, scramble=True, rng=streams.block(number))
        points = engine.random_base2(power)
        # the points are multiples of 2^-bits, 0 among them, whose normal is infinite:
        # take the middle of each step instead
        x = scipy.special.ndtri(points.T + 2.0 ** -(engine.bits + 1))
        means.append(batch_means(errors(np.ascontiguousarray(x)), 2**power))
    return np.concatenate(means), 2**power
