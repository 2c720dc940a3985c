r"""Trials of the two-vector closed form in one pass: draw, estimate, average.

With isotropic noise the estimate of a fixed frame depends on :math:`d_1 = b_1 - r_1`,
:math:`s_1 = b_1 + r_1` and :math:`d_2 = b_2 - r_2` alone
(`simval.imu.attitude.kernel`), and their noises are independent with
:math:`\sqrt2\,\sigma` for each axis: nine normals a trial instead of twelve.

A batch of eq. (M1) of `simval.montecarlo.plain` is `BATCH` trials, summed in eight
partial sums. `fused.c` does all of it in one pass through the processor's cache, with
the bits of the NumPy form here. It is used where it was compiled and reproduces the
first, the middle and the last of many batches, which is tried once in each process; so
neither its absence nor a careless compiler changes a number.

**Normals of many streams side by side.** `LANES` streams of SFC64, with states of three
words from one `SeedSequence` and a counter from 1, are moved on `WARM` times, as NumPy
moves one of its own, and stepped by turns. Two words of 64 bits make two normals by Box
and Muller: a radius :math:`\sqrt{-2 \ln u}`, u in (0, 1] by steps of 2^-52, and an
angle of 52 bits within an octant that three more bits choose. The logarithm is the
series of :math:`2\,\mathrm{artanh}\frac{f-1}{f+1}` for f from :math:`\sqrt{1/2}` to
:math:`\sqrt 2`, sine and cosine are Taylor's; what is left out of each is below 2^-53.

The greatest normal is :math:`\sqrt{104 \ln 2} = 8.5`. A moment of the radius is a sum
over u where the normal law has an integral. For the decreasing
:math:`f(u) = (-2 \ln u)^k` it is too small by at most
:math:`h f(h) + \int_0^h f\,du` with :math:`h = 2^{-52}`: 4e-11 of the eighth moment,
and less of the lower ones.

No function of a mathematical library is called: with additions, multiplications,
divisions and square roots, which IEEE 754 defines to the bit, `fused.c` gives the same
numbers.
"""

import warnings
from functools import cache
from importlib import import_module
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, instance, whole_number
from simval.arrays import Array, nonnegative_number, physical_array
from simval.errors import InputError
from simval.imu.attitude import kernel
from simval.montecarlo.plain import Sums, summed
from simval.shapes import Float
from simval.streams import Streams

Words = NDArray[np.uint64]

LANES: Final = 64
"""Streams of a block; part of the promise of equal bits."""
BATCH: Final = 256
"""Trials in a batch; also."""
NORMALS: Final = 9
WARM: Final = 12
"""Steps of a fresh stream that are thrown away, as NumPy does with one of its own."""

_ONE: Final = np.uint64(0x3FF0000000000000)
_SIGN: Final = np.uint64(0x8000000000000000)
_ROOT: Final = np.uint64(0x3FE6A09E667F3BCD)  # bits of the root of 1/2
_WHOLE: Final = np.uint64(0x4330000000000000)  # bits of 2^52
_LOG: Final = [1 / k for k in range(3, 20, 2)]
_SINE: Final = [-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800,
                1 / 6227020800, -1 / 1307674368000]  # fmt: skip
_COSINE: Final = [-1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800, 1 / 479001600,
                  -1 / 87178291200, 1 / 20922789888000]  # fmt: skip


def lanes(streams: Streams, block: int) -> Words:
    """Fresh states of the lanes of a block: three words and a counter, (4, LANES)."""
    words = streams.sequence(block).generate_state(3 * LANES, np.uint64)
    return np.vstack([words.reshape(3, LANES), np.ones((1, LANES), dtype=np.uint64)])


def draws(state: Words, batches: int) -> Words:
    """Words of some batches, those of all lanes by turns, (batches, NORMALS BATCH)."""
    steps = batches * NORMALS * BATCH // LANES
    generator = np.random.SFC64(0)
    words = np.empty((steps, LANES), dtype=np.uint64)
    for lane, own in enumerate(state.T):
        generator.state = {
            "bit_generator": "SFC64",
            "state": {"state": own},
            "has_uint32": 0,
            "uinteger": 0,
        }
        words[:, lane] = generator.random_raw(WARM + steps)[WARM:]
    return words.reshape(batches, NORMALS * BATCH)


def normals(words: Words) -> Float[Array, "batches m"]:
    """Box and Muller: the first half of each row are radii, the second half angles."""
    half = words.shape[1] // 2
    angle = words[:, half:]
    radius = np.sqrt(
        -2.0 * _log(2.0 - _double((words[:, :half] >> np.uint64(12)) | _ONE))
    )
    within = _double(((angle << np.uint64(3)) >> np.uint64(12)) | _ONE) - 1.0
    x = within * 0.7853981633974483
    y = x * x
    sine = (x + x * (y * _series(_SINE, y))).view(np.uint64)
    cosine = (1.0 + y * _series(_COSINE, y)).view(np.uint64)
    change = (cosine ^ sine) & (np.uint64(0) - (angle >> np.uint64(63)))
    cosine = (cosine ^ change) ^ ((angle << np.uint64(1)) & _SIGN)
    sine = (sine ^ change) ^ ((angle << np.uint64(2)) & _SIGN)
    return np.hstack([radius * _double(cosine), radius * _double(sine)])


def _log(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """Natural logarithm of numbers in (0, 1]."""
    bits = u.view(np.uint64)
    e = (bits - _ROOT + _ONE) >> np.uint64(52)
    k = _double(e | _WHOLE) - 4503599627371519.0
    f = _double(bits - (e << np.uint64(52)) + _ONE)
    s = (f - 1.0) / (f + 1.0)
    z = s * s
    log: Array = k * 0.6931471805599453 + 2.0 * (s + s * (z * _series(_LOG, z)))
    return log


def _double(bits: Words) -> Array:
    return bits.view(np.float64)


def _series(terms: list[float], x: Array) -> Array:
    """Sum of terms x^k: a polynomial of even and one of odd powers, side by side."""
    square = x * x
    even, odd = _horner(terms[0::2], square), _horner(terms[1::2], square)
    return even + x * odd


def _horner(terms: list[float], x: Array) -> Array:
    total = np.full_like(x, terms[-1])
    for term in terms[-2::-1]:
        total *= x
        total += term
    return total


CHUNK: Final = 16
"""Batches whose arrays stay in the cache, in the NumPy form."""
TRIED: Final = 256
"""Batches of the trial: more than a block of the study of attitudes has."""
FEATURES: Final = 14
SUMS: Final = 8


def simulate_closed_form(
    vectors: Float[Array, "12 1"],
    frame: str,
    q: Float[Array, "4"],
    noise_std: float,
    streams: Streams,
    *,
    samples: int,
    block: int,
    threads: int = 1,
) -> Sums:
    """Errors of the two-vector closed form under isotropic noise of all four vectors.

    Parameters
    ----------
    vectors : Array
        True b1, b2, r1 and r2, (12, 1).
    frame : str
        A fixed frame: ``x``, ``y``, ``z`` or ``plain``.
    q : Array
        True quaternion with the sign that the formula gives, (4,).
    noise_std : float
        Noise of each component of each vector.
    streams : Streams
        The cell's random streams.
    samples : int
        How many trials; rounded up to whole blocks.
    block : int
        Trials in a block, a multiple of `BATCH`; part of the promise of equal bits.
    threads : int, default 1
        Threads that compute blocks; the bits do not depend on it.

    Returns
    -------
    Sums
        Of the errors, truth minus estimate.

    Raises
    ------
    InputError
        If an argument is not what is said above.
    """
    instance("streams", streams, Streams)
    samples = whole_number("samples", samples, 1)
    block = whole_number("block", block, 1)
    if block % BATCH:
        msg = f"`block` is {block}; it must be a multiple of {BATCH}"
        raise InputError(msg)
    choice("frame", frame, kernel.FRAMES)
    mean = kernel.sums_and_differences(_exact("vectors", vectors, (12, 1)), frame)
    # of a sum or a difference of two vectors
    noise = np.sqrt(2.0) * nonnegative_number("noise_std", noise_std, "")
    rows, signs = map(np.array, kernel.places(frame))
    turned = signs * _exact("q", q, (4,))[rows]
    places, factors = _features(rows, signs)

    def means(number: int) -> Array:
        found = batch_means_of(streams, number, block // BATCH, mean, noise, turned)
        if not np.isfinite(found).all():
            msg = (
                f"a trial in block {number} gave a quaternion of length zero in "
                f"frame {frame!r}; give `vectors` that are not parallel, of length "
                "about 1, and a frame in which they differ from their references"
            )
            raise InputError(msg)
        placed = np.empty(found.shape)  # in C's order, on which the sums' bits depend
        placed[:, places] = factors * found
        return placed

    threads = whole_number("threads", threads, 1, 1024)
    return summed(means, -(-samples // block), BATCH, threads)


def _exact(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    array = physical_array(name, value, shape)
    if array.shape != shape:
        msg = f"`{name}` has shape {array.shape}; {shape} is needed"
        raise InputError(msg)
    return array


def _features(
    rows: NDArray[np.intp], signs: Float[Array, "4"]
) -> tuple[NDArray[np.intp], Float[Array, "14"]]:
    """Indices and signs of the features of rotated components."""
    upper = np.triu_indices(4)
    number = np.zeros((4, 4), dtype=np.intp)
    number[upper] = number.T[upper] = np.arange(4, FEATURES)
    i, j = upper
    places = np.concatenate([rows, number[rows[i], rows[j]]])
    return places, np.concatenate([signs, signs[i] * signs[j]])


def compiled() -> bool:
    """True if the compiled block is available; no number depends on it."""
    return _compiled() is not None


@cache
def _compiled() -> Any:
    """Import the compiled block, if there is one and it has the NumPy form's bits."""
    try:
        block = import_module("_simval_fused")
    except ImportError:  # a wheel that was built without a compiler
        return None
    if reproduces(block):
        return block
    warnings.warn(
        "the compiled Monte Carlo pass has other bits than its NumPy form, which is "
        "used instead; install simval again, `pip install -e .` in a checkout",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


def reproduces(block: Any) -> bool:
    """True if a compiled block gives the batches of the NumPy form, to the bit."""
    streams, mean, q = Streams(1, (1,)), np.linspace(-1.0, 1.0, NORMALS), np.ones(4)
    out, at = np.empty((TRIED, FEATURES)), [0, TRIED // 2, TRIED - 1]
    try:
        block.batches(lanes(streams, 0), mean, 0.5, q, out)
    except (AttributeError, TypeError, ValueError):  # it was compiled from another file
        return False
    x = normals(draws(lanes(streams, 0), TRIED)[at])
    return np.array_equal(out[at], averages(x, mean, 0.5, q))


def batch_means_of(
    streams: Streams,
    block: int,
    batches: int,
    mean: Float[Array, "9"],
    noise: float,
    q: Float[Array, "4"],
) -> Float[Array, "batches 14"]:
    """Batch means of a block of trials: mean error and means of its products.

    With `mean` and `noise` of d1, s1 and d2, and `q` from which the normalised
    (d1 x d2; s1 . d2) is subtracted.
    """
    state, code = lanes(streams, block), _compiled()
    if code is None:
        return in_numpy(state, batches, mean, noise, q)
    out = np.empty((batches, FEATURES))
    code.batches(state, mean, noise, q, out)
    return out


def in_numpy(
    state: Words,
    batches: int,
    mean: Float[Array, "9"],
    noise: float,
    q: Float[Array, "4"],
) -> Float[Array, "batches 14"]:
    """Batch means by fresh streams, as `fused.c` computes them."""
    words, out = draws(state, batches), np.empty((batches, FEATURES))
    for k in range(0, batches, CHUNK):
        part = slice(k, k + CHUNK)
        out[part] = averages(normals(words[part]), mean, noise, q)
    return out


def averages(
    x: Float[Array, "batches m"],
    mean: Float[Array, "9"],
    noise: float,
    q: Float[Array, "4"],
) -> Float[Array, "batches 14"]:
    """Batch means of q - (d1 x d2; s1 . d2), normalised, and of its products."""
    v = mean[:, None, None] + noise * x.reshape(-1, NORMALS, BATCH).transpose(1, 0, 2)
    w = (
        v[1] * v[8] - v[2] * v[7],
        v[2] * v[6] - v[0] * v[8],
        v[0] * v[7] - v[1] * v[6],
        v[3] * v[6] + v[4] * v[7] + v[5] * v[8],
    )
    with np.errstate(divide="ignore", invalid="ignore"):  # judged by the caller
        n = 1.0 / np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2] + w[3] * w[3])
        e = [q[i] - w[i] * n for i in range(4)]
    products = [e[i] * e[j] for i in range(4) for j in range(i, 4)]
    # eight partial sums of a batch, each in the order of its trials
    steps = np.stack([*e, *products]).reshape(FEATURES, -1, BATCH // SUMS, SUMS)
    s = np.zeros_like(steps[:, :, 0])
    for step in np.ascontiguousarray(steps.transpose(2, 0, 1, 3)):
        s += step
    s = s.transpose(2, 1, 0)
    total: Array = ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]))
    return total / BATCH
