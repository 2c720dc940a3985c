"""Whittle's bound against the Fisher information of a normal likelihood."""

import numpy as np
from rounding import EPS

from simval.theory.coloured_noise import noise_bound

N, B, K = 0.02, 0.05, 0.3


def test_white_noise_alone_is_a_variance_of_a_variance():
    # two degrees of freedom for each of the frequencies between 0 and the half
    rate, rows = 50.0, 1001
    bound = noise_bound(rows, rate, white=N, flicker=1e-12, walk=1e-12)
    alone = noise_bound(rows, rate, white=N)
    np.testing.assert_allclose(bound, alone, rtol=1e-6)
    information = np.linalg.inv(alone / np.outer(*[np.sqrt(np.diagonal(alone))] * 2))
    # N^2 with the others known: the inverse of the information's corner
    known = alone[0, 0] / information[0, 0]
    np.testing.assert_allclose(known, 2.0 * N**4 / (rows - 1), rtol=1e-10)


def test_equal_to_the_information_of_a_cyclic_signal():
    """(N9) by traces: I_ij = tr(C^-1 C_i C^-1 C_j)/2, C a circulant matrix.

    A cyclic signal's covariance has the spectrum as its eigenvalues; frequency 0, which
    a mean takes off, is kept apart. No periodogram and no exponential law enters.
    """
    rate, rows = 20.0, 61
    places = np.fft.fftfreq(rows, 1.0 / rate)
    omega = 2.0 * np.pi * np.abs(places[1:])
    shapes = np.stack([np.ones(rows - 1), 1.0 / omega, 1.0 / omega**2])
    waves = np.exp(2j * np.pi * np.outer(np.arange(rows), np.arange(1, rows)) / rows)
    waves /= np.sqrt(rows)
    parts = [(waves * shape) @ waves.conj().T for shape in shapes]
    inverse = np.linalg.pinv(
        sum(s * p for s, p in zip((N**2, B**2, K**2), parts, strict=True))
    )
    whitened = [inverse @ part for part in parts]
    information = np.array(
        [[0.5 * np.trace(a @ b).real for b in whitened] for a in whitened]
    )
    size = np.sqrt(np.diagonal(information))
    bound = noise_bound(rows, rate, white=N, flicker=B, walk=K) * np.outer(size, size)
    condition = np.linalg.cond(information / np.outer(size, size))
    np.testing.assert_allclose(
        bound @ (information / np.outer(size, size)), np.eye(3),
        rtol=0, atol=1e4 * rows * condition * EPS,
    )  # fmt: skip


def test_units_only_scale():
    base = noise_bound(500, 10.0, white=N, flicker=B, walk=K)
    scaled = noise_bound(500, 10.0, white=1e-9 * N, flicker=1e-9 * B, walk=1e-9 * K)
    np.testing.assert_allclose(scaled, 1e-36 * base, rtol=1e-9)
    faster = noise_bound(500, 40.0, white=N / 2.0, flicker=B, walk=2.0 * K)
    unit = np.array([0.25, 1.0, 4.0])
    np.testing.assert_allclose(faster, np.outer(unit, unit) * base, rtol=1e-9)
