"""What noise leaves in the mean of a rest of a magnetometer.

A magnetometer is often slower than its log: its own readings are what counts.
"""

import numpy as np

from simval.arrays import Array
from simval.errors import RefusedError
from simval.logs import Log
from simval.multiposition.pose_noise import (
    PoseNoise,
    longest_rest,
    mean_noise,
    require_one_unit,
)
from simval.noise import AxisNoise, NoiseFile
from simval.noise.fit import noise_of_readings, rows_to_a_reading
from simval.shapes import Float
from simval.statics import Intervals


def compass_pose_noise(
    log: Log,
    samples: Float[Array, "n 3"],
    intervals: Intervals,
    white: Float[Array, " m"],
    file: NoiseFile | None = None,
) -> PoseNoise:
    """Noise of the means of a magnetometer's rests, by Allan variance where known.

    White noise of rows counts each reading once, however many rows it stands in.

    Raises
    ------
    InputError
        If the noise file is that of another magnetometer's unit.
    """
    white = white * np.sqrt(rows_to_a_reading(samples))
    seconds = (intervals[:, 1] - intervals[:, 0]) / log.rate
    axes = () if file is None else file.magnetometer
    if axes:
        _require_this_unit(log, samples, intervals, axes)
    source = "file" if axes else "log"
    try:
        if not axes:
            start, stop = longest_rest(log, intervals)
            axes = noise_of_readings(samples[start:stop], log.rate)
        std = mean_noise(axes, seconds)
    except RefusedError as refusal:
        words = f"white noise alone: {refusal}; give --noise FILE of a longer one"
        return PoseNoise(std=white, white=white, source="white", words=words)
    where = "the noise file" if source == "file" else "the log's longest rest"
    words = f"the Allan variance at each rest's length, of {where}"
    return PoseNoise(std=std, white=white, source=source, words=words)


def _require_this_unit(
    log: Log,
    samples: Float[Array, "n 3"],
    intervals: Intervals,
    axes: tuple[AxisNoise, ...],
) -> None:
    # by the spread of the readings within rests, as neighbouring rows may repeat
    spread = [samples[a:b].var(axis=0, ddof=1) for a, b in intervals if b - a > 1]
    here = float(np.sqrt(np.median(spread)))
    there = float(np.sqrt(np.mean([axis.variances[0] for axis in axes])))
    require_one_unit(here, there, f"a reading of the magnetometer of {log.path}")
