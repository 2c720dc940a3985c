"""Attitude filter of simval, a reference for others; no theory imports it."""

from simval.imu.filters.mekf import Mekf

__all__ = ["Mekf"]
