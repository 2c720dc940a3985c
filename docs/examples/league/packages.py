"""How the league's adapters ask for a public package."""

from importlib import import_module
from typing import Any

import numpy as np

from simval.plugins import PluginError


def package(name: str) -> Any:
    """Import a module of a public package, or say what installs it."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        msg = (
            f"the module {error.name} is not installed; install the packages of the "
            "league: pip install 'simval[league]', or make league in a checkout"
        )
        raise PluginError(msg) from None


def mirrored(vectors: np.ndarray) -> np.ndarray:
    """Vectors and their opposites: points whose centroid is the origin.

    For packages that superimpose points, and so subtract their centroid first. Their
    correlation matrix is twice that of the vectors, and the best rotation is the same.
    """
    return np.concatenate([vectors, -vectors])
