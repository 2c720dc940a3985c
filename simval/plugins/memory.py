"""Whether a plug-in keeps anything from one trial to the next.

Some trials are asked again, in another order and then fewer of them: their answers must
be what they were. So it is found whatever is kept, a mean, a last answer or a count of
calls, and in a batch also what depends on a place or on what stands beside it. An
answer that is kept for good is the same again; but then it is that of other trials too.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.shapes import Float

Places = NDArray[np.intp]

FEWER = 3
"""Of the trials every third is asked in a batch of its own size."""


DISTINCT = 0.9
"""Least share of different answers: the noise of no two trials is the same."""


def require_no_memory(
    name: str,
    first: Float[Array, "n p"],
    again: Callable[[Places], Array],
    allowed: Float[Array, "n p"],
) -> None:
    """Check that trials have the same answers in another order.

    Raises
    ------
    PluginError
        If they have not: `first` and what ``again(places)`` gives differ by more than
        is allowed.
    """
    distinct = len(np.unique(first[:, np.isfinite(allowed).all(axis=0)], axis=0))
    if distinct < DISTINCT * len(first):
        msg = (
            f"{name} gives {distinct} different answers to {len(first)} trials of "
            "different noise: each must be estimated from its own readings, and be "
            "neither a constant nor kept from one call to the next"
        )
        raise PluginError(msg)
    order = np.random.default_rng(20_275).permutation(len(first))
    for places in (order, order[::FEWER]):
        apart = np.abs(again(places) - first[places]) / allowed[places]
        if not np.all(apart <= 1.0):
            count = int(np.sum(~np.all(apart <= 1.0, axis=1)))
            msg = (
                f"{name} answers {count} of {len(places)} trials otherwise when they "
                "are asked again in another order: keep nothing from one call to the "
                "next, and in a batch let no row depend on its place or on the others"
            )
            raise PluginError(msg)
