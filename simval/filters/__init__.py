"""Attitude filters of our own, beside which others are set; theory knows none."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.filters.mekf import Mekf
else:
    present(__name__, __file__)

__all__ = ["Mekf"]
