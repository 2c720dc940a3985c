"""Race of the overlapping Allan variance against NumPy and the package allantools."""

from functools import partial
from importlib.util import find_spec

import numpy as np

from simval.arrays import Array
from simval.bench.in_numpy import allan_variances
from simval.bench.race import Answer, Contender, Done
from simval.noise import allan_variance
from simval.shapes import Float, Int
from simval.streams import cell_key, stream

ROWS = 1_000_000
LENGTHS = 40  # averaging times, evenly on a log scale to a tenth of the rows
AGREEMENT = 1e-9
"""Relative. Chosen: the running sum of a million normals, some 1e3, has lost 1e-13 a
step at most, and the sums of squares average that."""


def allan() -> list[Contender]:
    """List the ways; the reference is the definition in NumPy."""
    signal = stream(0, cell_key("bench allan"), 0).standard_normal(ROWS)
    counts = np.unique(np.round(np.geomspace(1, ROWS // 10, LENGTHS)).astype(int))

    def seen(found: Float[Array, " m"]) -> Done:
        # each averaging time takes all rows
        answer = Answer(values=found, within=0.5 * AGREEMENT * np.abs(found))
        return Done(items=ROWS * len(found), answers={"Allan variances": answer})

    peers = {"second differences in NumPy, data unchecked": allan_variances}
    if find_spec("allantools") is not None:
        peers["allantools, data unchecked"] = _peer
    return [
        *(
            Contender(
                name=name, run=partial(run, signal, counts), seen=seen, ours=False
            )
            for name, run in peers.items()
        ),
        Contender(
            name="simval",
            run=partial(allan_variance, signal, counts),
            seen=lambda found: seen(np.asarray(found)),
        ),
    ]


def _peer(rate: Float[Array, " n"], counts: Int[Array, " m"]) -> Array:
    import allantools

    found = allantools.oadev(rate, rate=1.0, data_type="freq", taus=counts)
    return np.asarray(found[1]) ** 2
