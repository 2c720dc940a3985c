r"""Covariance of the inter-rest residuals from the noise of gyroscope and rests.

**What is known of a gyroscope's noise, and what the rests say of its bias.**

White noise N leaves the angle a random walk of variance :math:`N^2 t`, and the mean of
a rest of :math:`T_r` seconds the variance :math:`N^2/T_r`; the bias walks by
:math:`K^2 t`. A constant bias from rests of cumulative weights W(s), in moves of G(s),
is off by :math:`N^2 \sum w_i^2/T_i + K^2 \int (W - G)^2 ds`. A line between the
neighbouring rests leaves a move, for the walk, the noise of a Brownian bridge,
:math:`K^2 T^3/12` in the angle, and for the white noise that of the two rests. Time
stamps with the standard deviation :math:`s_t` leave
:math:`s_t^2 \sum_j |\mathrm{d}\omega_j|^2`, rates from row to row.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arguments import choice
from simval.arrays import (
    Array,
    ReadOnly,
    noise_levels,
    nonnegative_number,
    physical_array,
)
from simval.errors import InputError
from simval.imu.calibrate.gyroscope.moves import Moves
from simval.imu.calibrate.gyroscope.turn import Turn, bias_slopes, wander
from simval.shapes import Float

# Of the readings' own size: below it noise is rounding, and V is still positive.
_FLOOR = 1e-11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gaps:
    """Rows of the gaps alone at some parameters of the gyroscope."""

    e: Float[Array, "t r"]
    by_turn: Float[Array, "t k a 3"]  # of each gap, by theta
    by_gyroscope: Float[Array, "t r 12"]


def walk_blocks(
    rows: Gaps, theta_covariance: Float[Array, "t k 3 3"]
) -> Float[Array, "t k a a"]:
    """Covariance that the angle's own noise leaves in each gap."""
    back = np.swapaxes(rows.by_turn, -1, -2)
    return rows.by_turn @ theta_covariance @ back


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeNoise(ReadOnly):
    """Noise of the gyroscope and of the accelerometer's pose means.

    Attributes
    ----------
    angle_random_walk : Array
        White noise N of each axis, raw units per root hertz, (3,).
    bias_random_walk : float
        K, raw units times root hertz.
    clock_jitter : float
        Standard deviation of each time stamp, s.
    pose_std : Array
        Noise of each axis of each pose mean, raw units of the accelerometer, (n, 3).
    """

    angle_random_walk: Float[Array, "3"]
    bias_random_walk: float
    clock_jitter: float
    pose_std: Float[Array, "n 3"]


def checked_walk(value: Any) -> Float[Array, "3"]:
    """Require white noise of each axis.

    Raises
    ------
    InputError
        If it is not one number or three, 0 or more.
    """
    N = physical_array("angle_random_walk", value, ())
    if N.shape not in ((), (3,)) or not np.all(N >= 0.0):
        msg = (
            f"`angle_random_walk` has shape {N.shape}, least {N.min(initial=0.0):g}; "
            "give one number, or one of each axis (3,), 0 or more"
        )
        raise InputError(msg)
    return np.array(np.broadcast_to(N, (3,)))


def checked_pose_std(
    value: Any, count: int, name: str = "pose_std"
) -> Float[Array, "n 3"]:
    """Require the noise of pose means, of all, each pose, or each of its axes.

    Raises
    ------
    InputError
        If the shape is another, or one is negative.
    """
    std = physical_array(name, value, ())
    if std.shape == (count,):
        std = std[:, None]
    fits = std.shape in ((), (count, 1), (count, 3))
    if not fits or not np.all(std >= 0.0):
        msg = (
            f"`{name}` has shape {std.shape}, least value {std.min(initial=0.0):g}; "
            f"give one number, or one of each pose ({count},) or axis ({count}, 3), 0 "
            "or more"
        )
        raise InputError(msg)
    return np.array(np.broadcast_to(std, (count, 3)))


def floored(noise: GyroscopeNoise, moves: Moves, poses: Array) -> GyroscopeNoise:
    """Noise that is at least rounding, so that a covariance can be factorised."""
    way = np.sqrt((moves.statistics[:, :, :3] ** 2).sum(axis=2)).sum(axis=-1)
    typical = float(np.median(way)) / float(np.median(moves.seconds)) ** 0.5
    size = float(np.sqrt((poses**2).mean()))
    return GyroscopeNoise(
        angle_random_walk=np.maximum(noise.angle_random_walk, _FLOOR * typical),
        bias_random_walk=noise.bias_random_walk,
        clock_jitter=noise.clock_jitter,
        pose_std=np.maximum(noise.pose_std, _FLOOR * size),
    )


def rest_weights(moves: Moves, *, first: bool = False) -> Float[Array, " n"]:
    """Weight of each rest in the bias: by its time, or all for the first."""
    if first:
        return np.eye(len(moves.rest_seconds))[0]
    return moves.rest_seconds / moves.rest_seconds.sum()


def rest_bias(
    moves: Moves, noise: GyroscopeNoise, w: Float[Array, " n"]
) -> tuple[Float[Array, "t 3"], Float[Array, "3"]]:
    """Mean bias of the rests, less the centre, and what white noise leaves in it."""
    mean = np.einsum("n,tni->ti", w, moves.rest_rates)
    white = float(np.sum(w * w / moves.rest_seconds))
    return mean - moves.centre, noise.angle_random_walk * np.sqrt(white)


def walk_covariance(
    times: Float[Array, " m"], w: Float[Array, " n"], rests: Float[Array, " n"]
) -> Float[Array, "m m"]:
    """Covariance of a unit walk at some times, less its mean over the rests."""
    every = np.concatenate([times, rests])
    walk = np.minimum(every[:, None], every) - every.min()
    less = np.concatenate([np.eye(len(times)), -np.tile(w, (len(times), 1))], axis=1)
    return less @ walk @ less.T


def drift_noise(
    rows: Gaps, moves: Moves, noise: GyroscopeNoise, w: Float[Array, " n"]
) -> Float[Array, "t r m"]:
    """Noise of the gaps by a bias that walks, where it is held for constant.

    A move is turned by its mean, whose variance is that in the middle less T/6.
    """
    t, k = moves.statistics.shape[:2]
    middle = moves.times[:, 0] + 0.5 * moves.seconds
    covariance = walk_covariance(middle, w, moves.rest_times)
    covariance -= np.diag(moves.seconds / 6.0)
    # a walk that has been seen at fewer times than moves leaves roots of zero
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    by_bias = rows.by_gyroscope[..., 9:].reshape(t, k, -1, 3)
    L = np.einsum("tkeb,km->tkemb", by_bias, noise.bias_random_walk * root)
    return L.reshape(t, rows.e.shape[1], -1)


def line_noise(
    rows: Gaps,
    moved: Turn,
    moves: Moves,
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
    noise: GyroscopeNoise,
) -> tuple[Float[Array, "t r m"], Float[Array, "t k 3 3"]]:
    """Noise of a line between rests: of each rest's mean, and of the walk in a move.

    Returns the map of unit noises of the rests' means to the rows, and the covariance
    of the moves' turns.
    """
    t, k = moves.statistics.shape[:2]
    start, end = moves.rest_times[:-1, None], moves.rest_times[1:, None]
    along = (moves.times - start) / (end - start)
    std = noise.angle_random_walk / np.sqrt(moves.rest_seconds)[:, None]
    L = np.zeros((*rows.by_turn.shape[:3], k + 1, 3))
    gap = np.arange(k)
    for weights, rest in ((1.0 - along, gap), (along, gap + 1)):
        turned = bias_slopes(moved, moves.statistics, M, B, weights)
        pull = rows.by_turn @ turned * std[rest][:, None]
        L[:, gap, :, rest] = np.moveaxis(pull, 1, 0)
    return L.reshape(t, rows.e.shape[1], -1), _bridge(moved, moves, M, noise)


def _bridge(
    moved: Turn, moves: Moves, M: Float[Array, "t 3 3"], noise: GyroscopeNoise
) -> Float[Array, "t k 3 3"]:
    # theta = int A (b - line) dt = int g dW, g(s) = int_s A dt - int (t / T) A dt
    t, k, _, j = moves.statistics.shape
    tau = moves.statistics[0, :, 9]  # k j
    A = np.moveaxis(moved.D.reshape(t, k, 3, 3, j), -1, 2) @ M[:, None, None]
    pulls = A * tau[:, :, None, None]  # t k j 3 3
    length = (moves.rest_times[1:] - moves.rest_times[:-1])[:, None]
    along = (moves.times - moves.rest_times[:-1, None]) / length
    whole = (pulls * along[:, :, None, None]).sum(axis=2, keepdims=True)
    later = np.cumsum(pulls[:, :, ::-1], axis=2)[:, :, ::-1] - 0.5 * pulls
    g = later - whole
    inside = np.einsum("tkjab,tkjcb,kj->tkac", g, g, tau)
    # before the move the integral is whole, after it nothing is left of it
    total = pulls.sum(axis=2) - whole[:, :, 0]
    begin = moves.times[:, 0] - 0.5 * tau[:, 0] - moves.rest_times[:-1]
    rest = length[:, 0] - begin - tau.sum(axis=1)
    square = np.einsum("tkab,tkcb,k->tkac", total, total, begin)
    square += np.einsum("tkab,tkcb,k->tkac", whole[:, :, 0], whole[:, :, 0], rest)
    return noise.bias_random_walk**2 * (inside + square)


def jitter_noise(
    moved: Turn,
    moves: Moves,
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
    noise: GyroscopeNoise,
) -> Float[Array, "t k 3 3"]:
    r"""Covariance of the moves' turns by time stamps that are off, each by itself.

    A stamp that is late by :math:`\delta` lengthens the step before it and shortens
    the next, so the turn is off by :math:`\delta` times the difference of their rates.
    Over a chunk of c steps rates change evenly: the squares of their differences sum to
    that of the chunks' over c.
    """
    t, k, _, j = moves.statistics.shape
    tau = moves.statistics[:, :, 9]
    turned = moves.statistics[:, :, :3] - tau[:, :, None] * B[:, None, :, None]
    rate = M[:, None] @ (turned / np.where(tau > 0.0, tau, 1.0)[:, :, None])
    seen = np.einsum("tkabj,tkbj->tkaj", moved.D.reshape(t, k, 3, 3, j), rate)
    change = np.diff(np.pad(seen, ((0, 0), (0, 0), (0, 0), (1, 1))), axis=-1)
    squares = change @ np.swapaxes(change, -1, -2)
    return np.asarray(noise.clock_jitter**2 / moves.chunk * squares)


def sensitivity_noise(
    rows: Gaps,
    moved: Turn,
    moves: Moves,
    M: Float[Array, "t 3 3"],
    noise: GyroscopeNoise,
) -> tuple[Float[Array, "t r 9"], Float[Array, "3 9"]]:
    """Noise of a sensitivity that was taken out: in the gaps, and in the rests' bias.

    The regression on the rests gives each axis a row of G with the covariance
    :math:`N^2 C`; the mean reading less G times the mean force is the bias.
    """
    t, k, _, j = moves.statistics.shape
    C = moves.force_noise[1:, 1:]
    root = np.linalg.cholesky(C)
    mean = -np.linalg.solve(C, moves.force_noise[1:, 0])
    DM = np.moveaxis(moved.D.reshape(t, k, 3, 3, j), -1, 2) @ M[:, None, None]
    by_G = np.einsum("tkjia,kbj->tkiab", DM, moves.force)
    unit = np.einsum("tkiab,bq,a->tkiaq", by_G, root, noise.angle_random_walk)
    gaps = -rows.by_turn @ unit.reshape(t, k, 3, 9)
    bias = np.einsum("ac,q,a->acq", np.eye(3), mean @ root, noise.angle_random_walk)
    return gaps.reshape(t, -1, 9), bias.reshape(3, 9)


BIASES = ("constant", "first rest", "line")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """What is fitted, and how."""

    model: str  # accelerometer's form
    residual: str  # of the accelerometer's own fit
    g: float
    joint: bool  # the norms are rows as well
    weighted: bool
    bias: str  # constant, known or line
    noise: GyroscopeNoise
    bias_value: Float[Array, "t 3"]  # from the rests, less the centre
    bias_std: Float[Array, "3"]
    weights: Float[Array, " n"]  # of the rests in that value

    @property
    def free(self) -> int:
        """Parameters of the gyroscope that are estimated."""
        return 12 if self.bias == "constant" else 9

    def noisier(self, factor: float) -> "Setting":
        """The same with so many times the gyroscope's noise."""
        own = self.noise
        return replace(
            self,
            bias_std=self.bias_std * factor,
            noise=replace(
                own,
                angle_random_walk=own.angle_random_walk * factor,
                bias_random_walk=own.bias_random_walk * factor,
                clock_jitter=own.clock_jitter * factor,
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Given:
    """What the caller says of the noise and the bias, as it came."""

    pose_std: Any
    angle_random_walk: Any
    bias_random_walk: float
    bias: str
    known_bias: Any
    bias_std: Any
    clock_jitter: Any = 0.0


def noise_of(moves: Moves, readings: Array, given: Given) -> GyroscopeNoise:
    """Noise that was given, or that the rests show.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    walk = given.angle_random_walk
    noise = GyroscopeNoise(
        angle_random_walk=checked_walk(
            moves.white.mean(axis=0) if walk is None else walk
        ),
        bias_random_walk=nonnegative_number(
            "bias_random_walk", given.bias_random_walk, "raw units"
        ),
        clock_jitter=nonnegative_number("clock_jitter", given.clock_jitter, "s"),
        pose_std=checked_pose_std(given.pose_std, readings.shape[1]),
    )
    return floored(noise, moves, readings)


def setting_of(
    moves: Moves,
    readings: Array,
    given: Given,
    *,
    model: str,
    residual: str,
    g: float,
    estimator: str,
) -> Setting:
    """What a fit takes for the bias, and how well that is known.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    noise = noise_of(moves, readings, given)
    bias = choice("bias", given.bias, BIASES)
    weights = rest_weights(moves, first=bias == "first rest")
    value, std = rest_bias(moves, noise, weights)
    if given.known_bias is not None and bias == "constant":
        msg = f"`known_bias` is given and `bias` is {bias}; ask for first rest"
        raise InputError(msg)
    kept = bias == "first rest" or (bias == "constant" and estimator == "unweighted")
    if given.known_bias is not None:
        value = physical_array("known_bias", given.known_bias, (3,)) - moves.centre
    setting = Setting(
        model=model,
        residual=residual,
        g=g,
        joint=estimator == "joint",
        weighted=estimator != "unweighted",
        bias="known" if kept else bias,
        noise=noise,
        bias_value=value,
        bias_std=std,
        weights=weights,
    )
    if given.bias_std is None:
        return setting
    level = noise_levels("bias_std", given.bias_std, 3)
    return replace(setting, bias_std=np.maximum(level, std))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """Noise of the gaps beside that of the poses."""

    blocks: Float[Array, "t k a a"]  # each gap's own covariance
    maps: list[Array]  # unit noises that gaps share, to their rows
    ends: Float[Array, "3 q"]  # those of the last map, to the rests' bias


def spread(
    rows: Gaps,
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


def own_covariance(
    found: Spread, bias_std: Float[Array, " b"]
) -> Float[Array, "t r r"]:
    """Covariance of the rows of the gaps, and of the rests' bias where it is a row."""
    t, k, size, _ = found.blocks.shape
    first, ends = size * np.arange(k), len(bias_std)
    V = np.zeros((t, size * k + ends, size * k + ends))
    for i in range(size):
        for j in range(size):
            V[:, first + i, first + j] = found.blocks[:, :, i, j]
    last = np.arange(size * k, size * k + ends)
    V[:, last, last] = bias_std**2
    shared(V, found, ends)
    return V
