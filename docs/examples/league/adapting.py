"""What the league's adapters share."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from simval.plugins import PluginError


@contextmanager
def needed() -> Iterator[None]:
    """Say what installs a package whose import fails for want of it."""
    try:
        yield
    except ModuleNotFoundError as error:
        msg = (
            f"the module {error.name} is not installed; install the packages of the "
            "league in a checkout: pip install -e '.[league]', or make league"
        )
        raise PluginError(msg) from None


def mirrored(vectors: np.ndarray) -> np.ndarray:
    """Vectors and their opposites: points whose centroid is the origin.

    For packages that superimpose points, and so subtract their centroid first. Their
    correlation matrix is twice that of the vectors, and the best rotation is the same.
    """
    return np.concatenate([vectors, -vectors])
