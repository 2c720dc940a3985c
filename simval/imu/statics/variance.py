"""Windowed variance magnitude of a log, eq. (D1) of `simval.imu.statics`."""

import numpy as np

from simval.arguments import whole_number
from simval.arrays import Array, physical_array
from simval.errors import InputError
from simval.shapes import Float

WINDOW = 101  # samples; one second at 100 Hz


def variance_magnitude(
    samples: Float[Array, "n 3"], window: int = WINDOW
) -> Float[Array, " n"]:
    """Variance magnitude of the window centred on each sample, eq. (D1).

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    window : int
        Samples in a window, odd, 3 or more.

    Returns
    -------
    Array
        (n,), unit of the readings squared; infinite within half a window of either
        end, where there is no full window, so that nothing there is static.

    Raises
    ------
    InputError
        If the window is not odd or does not fit into the log.

    Notes
    -----
    Each window spans at most two blocks of `window` samples. Sums run from the blocks'
    ends over data centred per block, and the two parts are merged (Chan, Golub and
    LeVeque 1983): no sum is longer than a window, so a rest late in a long log of
    large counts loses no digits.
    """
    samples = checked_samples(samples, window)
    n, half = len(samples), window // 2
    blocks = -(-n // window)
    padded = np.concatenate([samples, np.repeat(samples[-1:], blocks * window - n, 0)])
    cube = padded.reshape(blocks, window, 3)
    centre = cube.mean(axis=1, keepdims=True)
    cube = cube - centre
    mean_before, spread_before = _running(cube)
    mean_after, spread_after = _running(cube[:, ::-1])
    # a window that starts at offset o > 0 has window - o samples in its first block
    centres = centre[:, 0]
    tail_mean = (mean_after[:, ::-1] + centres[:, None]).reshape(-1, 3)
    tail_spread = spread_after[:, ::-1].reshape(-1, 3)
    head_mean = (mean_before + centres[:, None]).reshape(-1, 3)
    head_spread = spread_before.reshape(-1, 3)
    start = np.arange(n - window + 1)
    in_head = start % window  # samples in the second block
    last = start + window - 1
    merged = (
        tail_spread[start]
        + head_spread[last]
        + (in_head * (window - in_head) / window)[:, None]
        * (head_mean[last] - tail_mean[start]) ** 2
    )
    whole = in_head == 0
    merged[whole] = tail_spread[start[whole]]
    result = np.full(n, np.inf)
    result[half : n - half] = np.linalg.norm(merged / (window - 1), axis=1)
    return result


def _running(
    cube: Float[Array, "m k 3"],
) -> tuple[Float[Array, "m k 3"], Float[Array, "m k 3"]]:
    # running mean and sum of squared deviations along axis 1
    count = np.arange(1, cube.shape[1] + 1)[:, None]
    total = np.cumsum(cube, axis=1)
    spread = np.cumsum(cube * cube, axis=1) - total * total / count
    return total / count, np.maximum(spread, 0.0)


def checked_samples(samples: Float[Array, "n 3"], window: int) -> Float[Array, "n 3"]:
    """Check that a log is one of finite rows and longer than a window.

    Raises
    ------
    InputError
        If it is not.
    """
    samples = physical_array("samples", samples, (None, 3))
    if whole_number("window", window, 3) % 2 == 0:
        msg = f"`window` is {window}; it must be an odd number of samples, 3 or more"
        raise InputError(msg)
    if not (samples.ndim == 2 and len(samples) >= window):
        msg = (
            f"`samples` has shape {samples.shape}; one log of at least one window "
            f"({window} rows of 3) is needed: record longer or shorten the window"
        )
        raise InputError(msg)
    return samples
