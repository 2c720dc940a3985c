"""Predictions: what the errors must be. Imports nothing that it predicts."""
