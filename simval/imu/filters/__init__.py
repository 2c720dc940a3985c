"""Attitude filters of simval, a reference for others; theory imports none of them."""

from simval.imu.filters.mekf import Mekf

__all__ = ["Mekf"]
