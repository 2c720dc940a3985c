"""What a filter is told of a log: noise, gravity, field, and where it starts.

From a noise file, else from the log's own rests: N and K of the longest one, the
scatter of a row in all of them. Nothing of it is from the truth.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.noise import AxisNoise, noise_of
from simval.noise.model import NoiseFile
from simval.plugins.runs import Told
from simval.recorded.attitudes import of_matrix
from simval.recorded.signals import Signals
from simval.shapes import Float

START_STD: Final = 0.02
"""rad; told of the start from one rest: an accelerometer that is off by 0.02 g, and a
magnetometer off by as much of its field, are usual without a calibration."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """The first row that a filter is given, and the attitude it is told there."""

    row: int
    attitude: Float[Array, "4"]  # north-west-up to sensor
    told: Told
    said: tuple[str, ...]  # where the numbers are from


def start_of(
    found: Signals, known: NoiseFile | None = None, source: str = "the noise file"
) -> Start:
    """Start at the first rest, by two vectors, and say what a filter is told.

    Without known noise the log's longest rest is measured.

    Raises
    ------
    InputError
        If the noise file has no gyroscope in rad/s.
    """
    parts = [slice(a, b) for a, b in found.rests]
    first = parts[0]
    longest = max(parts, key=lambda each: each.stop - each.start)
    up, north = _directions(found, first)
    N, K, words = _gyro_noise(found, longest, known, source)
    gravity = float(
        np.mean([np.linalg.norm(found.force[part].mean(axis=0)) for part in parts])
    )
    sine = [_sine(found, part) for part in parts]
    length = float(
        np.mean([np.linalg.norm(found.field[part].mean(axis=0)) for part in parts])
    )
    dip = float(np.arcsin(np.mean(sine)))
    field = length * np.array([np.cos(dip), 0.0, -np.sin(dip)])
    bias = float(np.sqrt(np.mean(found.gyro[first].mean(axis=0) ** 2)))
    told = Told(
        gyroscope_noise=N,
        gyroscope_walk=K,
        accelerometer_noise=_scatter(found.force, parts),
        magnetometer_noise=_scatter(found.field, parts),
        gravity=gravity,
        field=field,
        start_std=START_STD,
        bias_std=max(bias, N / np.sqrt((first.stop - first.start) / found.rate)),
    )
    unit = "T" if found.field_unit else "in its unit"
    return Start(
        row=int(first.start),
        attitude=of_matrix(np.stack([north, np.cross(up, north), up], axis=1)),
        told=told,
        said=(
            f"told              gyroscope N {N:.3g} rad/s/sqrt(Hz), K {K:.3g} "
            f"rad/s/sqrt(s): {words}",
            f"                  accelerometer {told.accelerometer_noise:.3g} m/s^2, "
            f"magnetometer {told.magnetometer_noise:.3g} {unit} a row: scatter in "
            f"{len(parts)} rest(s)",
            f"                  gravity {gravity:.5g} m/s^2, field {length:.4g} {unit},"
            f" dip {np.degrees(dip):.2f} degrees: means of the rests",
            f"                  start at {found.time[first.start]:.2f} s by two vectors"
            f" of the first rest, sd {np.degrees(START_STD):.2g} degrees; bias 0, sd "
            f"{told.bias_std:.2g} rad/s (what that rest reads)",
        ),
    )


def _sine(found: Signals, part: slice) -> float:
    # of the dip: down against the field
    force, field = found.force[part].mean(axis=0), found.field[part].mean(axis=0)
    return -float(force @ field / np.linalg.norm(force) / np.linalg.norm(field))


def _directions(
    found: Signals, part: slice
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    # up and north in sensor axes
    up = found.force[part].mean(axis=0)
    up /= np.linalg.norm(up)
    field = found.field[part].mean(axis=0)
    flat = field - (field @ up) * up
    if not np.linalg.norm(flat) > 0.02 * np.linalg.norm(field):
        msg = (
            "at the first rest the magnetic field is vertical, so it has no north; "
            "look at the magnetometer, or calibrate it (--calibration)"
        )
        raise RefusedError(msg)
    return up, flat / np.linalg.norm(flat)


def _scatter(rows: Float[Array, "n 3"], parts: list[slice]) -> float:
    return float(np.sqrt(np.mean([rows[part].var(axis=0).mean() for part in parts])))


def _gyro_noise(
    found: Signals, part: slice, known: NoiseFile | None, source: str
) -> tuple[float, float, str]:
    # N and K, and where they are from
    axes, scale, words = _axes(found, part, known, source)
    seconds = (part.stop - part.start) / found.rate
    if known is not None:
        seconds = min(axis.rows / axis.rate_hz for axis in axes)
    N = _coefficient(axes, "N", scale)
    K = _coefficient(axes, "K", scale)
    if N is None:
        # no model: the scatter from row to row
        steps = np.diff(found.gyro[part], axis=0)
        N = float(np.sqrt(0.5 * np.mean(steps**2) / found.rate))
        words = "no model fits the rest; N is by the steps from row to row"
    if K is None:
        # what would double the variance of an average over the rest, N^2/T + K^2 T/3
        K = np.sqrt(3.0) * N / seconds
        words += f"; K is not seen: what doubles the variance of {seconds:.0f} s"
    return N, K, words


def _axes(
    found: Signals, part: slice, known: NoiseFile | None, source: str
) -> tuple[tuple[AxisNoise, ...], float, str]:
    if known is None:
        seconds = (part.stop - part.start) / found.rate
        words = f"Allan variances of a rest of {seconds:.0f} s"
        try:
            return noise_of(found.gyro[part], found.rate), 1.0, words
        except RefusedError:  # a short rest
            return (), 1.0, words
    if not known.gyro or known.gyro_si_per_raw is None:
        msg = (
            f"{source} has no gyroscope with a known unit, and a filter is told of its "
            "noise in rad/s; write it by `simval noise LOG --gyro-unit rad/s --json`"
        )
        raise InputError(msg)
    return known.gyro, known.gyro_si_per_raw, source


def _coefficient(axes: tuple[AxisNoise, ...], kind: str, scale: float) -> float | None:
    # root of the mean square over the axes; one that is not seen counts as nothing
    values = [c.value for axis in axes for c in axis.coefficients if c.kind == kind]
    seen = [value for value in values if value is not None]
    if not seen or (kind == "N" and len(seen) < len(axes)):
        return None
    return scale * float(np.sqrt(np.sum(np.square(seen)) / len(axes)))
