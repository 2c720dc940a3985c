"""Noise that the moves leave in the rows of the gaps, whatever their number a gap."""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.calibrate.gyroscope.moves import Moves
from simval.calibrate.gyroscope.noise import (
    drift_noise,
    jitter_noise,
    line_noise,
    sensitivity_noise,
)
from simval.calibrate.gyroscope.rows import Rows, walk_blocks
from simval.calibrate.gyroscope.setting import Setting
from simval.calibrate.gyroscope.turn import Turn, wander
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """Noise of the gaps beside that of the poses."""

    blocks: Float[Array, "t k a a"]  # each gap's own covariance
    maps: list[Array]  # unit noises that gaps share, to their rows
    ends: Float[Array, "3 q"]  # those of the last map, to the rests' bias


def spread(
    rows: Rows,
    moved: Turn,
    moves: Moves,
    setting: Setting,
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
) -> Spread:
    """Noise by the walk of the angle, the bias, and a sensitivity taken out."""
    noise = setting.noise
    theta_noise: Array = wander(moved, moves.statistics, M * noise.angle_random_walk)
    maps = []
    if noise.clock_jitter > 0.0:
        theta_noise += jitter_noise(moved, moves, M, B, noise)
    if setting.bias == "line":
        rests, bridge = line_noise(rows, moved, moves, M, B, noise)
        maps.append(rests)
        theta_noise += bridge
    elif noise.bias_random_walk > 0.0:
        maps.append(drift_noise(rows, moves, noise, setting.weights))
    if setting.bias == "known":
        maps.append(rows.by_gyroscope[..., 9:] * setting.bias_std)
    ends: Array = np.zeros((3, 0))
    if moves.force.size:
        gaps, ends = sensitivity_noise(rows, moved, moves, M, noise)
        maps.append(gaps)
    return Spread(blocks=walk_blocks(rows, theta_noise), maps=maps, ends=ends)


def shared(V: Float[Array, "t r r"], found: Spread, ends: int) -> None:
    """Add to a covariance what the gaps, its first rows, share with each other.

    The rests' bias, its last rows where `ends` is not 0, shares a sensitivity's error.
    """
    gaps = found.blocks.shape[1] * found.blocks.shape[2]
    for other in found.maps:
        V[:, :gaps, :gaps] += other @ np.swapaxes(other, -1, -2)
    if ends and found.ends.size:  # the last of the maps
        V[:, -3:, -3:] += found.ends @ found.ends.T
        V[:, :gaps, -3:] = found.maps[-1] @ found.ends.T
        V[:, -3:, :gaps] = np.swapaxes(V[:, :gaps, -3:], -1, -2)
