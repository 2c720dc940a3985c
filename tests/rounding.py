"""Differences, and what float64 rounding makes of them."""

import numpy as np

EPS = np.finfo(float).eps


def relative(value, exact):
    return np.linalg.norm(value - exact) / np.linalg.norm(exact)
