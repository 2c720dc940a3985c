"""Attitude filters of simval, to compare others with; theory imports none of them."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.filters.mekf import Mekf
else:
    present(__name__, __file__)

__all__ = ["Mekf"]
