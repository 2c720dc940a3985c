"""Predictions: what the errors must be. Imports nothing that it predicts."""

from simval.theory.attitude import AttitudeMoments, attitude_moments

__all__ = ["AttitudeMoments", "attitude_moments"]
