"""Attitude filters of simval, to compare others with; theory imports none of them."""

from simval.imu.filters.mekf import Mekf

__all__ = ["Mekf"]
