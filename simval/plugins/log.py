r"""The log that a command is given: a sensor that rests in pose after pose.

A study's poses are means whose noise is known, and a log must be what a sensor would
have recorded whose rests have those means. With white noise :math:`w_i` of standard
deviation :math:`\sigma\sqrt n` per sample, the samples of a rest of n are

.. math:: x_i = y + w_i - \bar w,  \tag{R1}

where :math:`y`, the given pose, is off by noise of :math:`\sigma`. The mean of white
noise is independent of the deviations from it, so :math:`x_i` is the true reading plus
white noise and nothing else: whatever part of a rest a detector keeps is as wrong as
the scatter of its samples says. All rests are equally long, for a longer one would be
less wrong than its pose is; and turns begin and end with a knock, so that detectors
agree where the rests are.
"""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

RATE = 100.0  # Hz
REST, MOVE = 10.0, 1.0  # s
QUIET = 1e-9
"""Least noise of a sample, of the greatest reading: a log without any has no rests."""


def log_of(poses: Float[Array, "n 3"], noise_std: float) -> Float[Array, "m 4"]:
    """Log of a sensor that is turned from pose to pose."""
    seed = np.ascontiguousarray(poses, dtype=np.float32).view(np.uint32)
    rng = np.random.default_rng(seed.ravel())
    rest, move = round(REST * RATE), round(MOVE * RATE)
    sigma = max(noise_std * np.sqrt(rest), QUIET * float(np.abs(poses).max()))
    s = np.linspace(0.0, 1.0, move)[:, None]
    rows = []
    for pose, following in zip(poses, [*poses[1:], poses[-1]], strict=True):
        noise = sigma * rng.standard_normal((rest, 3))
        rows.append(pose + noise - noise.mean(axis=0))
        # a turn begins and ends with a knock, and no part of it is at rest
        swing = np.linalg.norm(pose) * np.cos(9.0 * np.pi * s)
        turn = pose + (following - pose) * s + swing
        rows.append(turn + sigma * rng.standard_normal((move, 3)))
    samples = np.concatenate(rows)
    return np.column_stack([np.arange(len(samples)) / RATE, samples])
