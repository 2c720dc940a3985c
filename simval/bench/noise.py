"""Race of the overlapping Allan variance against the package allantools."""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from simval.bench.race import Contender
from simval.noise import allan_variance
from simval.streams import cell_key, stream

ROWS = 1_000_000
LENGTHS = 40  # averaging times, evenly on a log scale to a tenth of the rows


def allan() -> list[Contender]:
    """List both ways; the reference is allantools, where it is installed."""
    signal = stream(0, cell_key("bench allan"), 0).standard_normal(ROWS)
    counts = np.unique(np.round(np.geomspace(1, ROWS // 10, LENGTHS)).astype(int))

    def own() -> int:
        return ROWS * len(allan_variance(signal, counts))

    contenders = [Contender(name="simval", run=own)]
    if find_spec("allantools") is not None:
        contenders.insert(0, Contender(name="allantools", run=_peer(signal, counts)))
    return contenders


def _peer(signal: np.ndarray, counts: np.ndarray) -> Callable[[], int]:
    def run() -> int:
        import allantools

        found = allantools.oadev(signal, rate=1.0, data_type="freq", taus=counts)
        return ROWS * len(found[0])

    return run
