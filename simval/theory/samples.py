"""Which sample of a batch is refused, and in what words."""

from collections.abc import Callable
from typing import Any

import numpy as np

from simval.errors import SimvalError


def refuse_samples(
    good: Any, message: Callable[[tuple[int, ...]], str], kind: type[SimvalError]
) -> None:
    """Raise the error of the first sample that is not good, if there is one.

    Raises
    ------
    SimvalError
        Of the `kind`, with the `message` of that sample's index.
    """
    bad = np.flatnonzero(~np.asarray(good))
    if not len(bad):
        return
    shape = np.shape(good)
    msg = message(tuple(np.unravel_index(bad[0], shape)))
    if shape:
        msg = (
            f"{len(bad)} of {np.size(good)} sample(s) cannot be used; the first is "
            f"{place(bad[0], shape)}: {msg}"
        )
    raise kind(msg)


def place(number: int, batch: tuple[int, ...]) -> str:
    """Name of a sample by its index in the batch."""
    index = tuple(int(i) for i in np.unravel_index(number, batch))
    return f"sample {index}"
