"""Attitude filters of our own, beside which others are set; theory knows none."""

from simval.filters.mekf import Mekf

__all__ = ["Mekf"]
