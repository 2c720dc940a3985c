r"""Normals of many streams side by side, by IEEE arithmetic in one fixed order.

`LANES` streams of SFC64, with states of three words from one `SeedSequence` and a
counter from 1, are moved on `WARM` times, as NumPy moves one of its own, and stepped by
turns. Two words of 64 bits make two normals by Box and Muller: a radius
:math:`\sqrt{-2 \ln u}`, u in (0, 1] by steps of 2^-52, and an angle of 52 bits within
an octant that three more bits choose. The logarithm is the series of
:math:`2\,\mathrm{artanh}\frac{f-1}{f+1}` for f from :math:`\sqrt{1/2}` to
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

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
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
