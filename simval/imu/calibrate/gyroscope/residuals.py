r"""Inter-rest residuals and their covariance: a gyroscope's block of the core.

**Residuals.** Rotation k takes the direction of gravity
:math:`u_k = h_k/|h_k|, h = M_a(\bar y - b_a)` into :math:`u_{k+1}`; along it nothing is
seen, so with :math:`E_k` two unit vectors across :math:`u_{k+1}`

.. math:: e_k = E_k^T (C_k^T u_k - u_{k+1}) \tag{N5}

and, :math:`\epsilon_k` the angle random walk,

.. math:: \mathrm{d}e_k = E_k^T C_k^T [u_k\times](\theta_k + \epsilon_k)
   + E_k^T (C_k^T \mathrm{d}u_k - \mathrm{d}u_{k+1}),\quad
   \mathrm{cov}\,\epsilon_k = N^2 \sum_j \tau_j (D_j M)(D_j M)^T. \tag{N6}

A magnetometer adds a third residual, eq. (J1) of `joint`. The bias B has rows where
it is estimated: what the rests say of it, over the mean rate of the rotations.

**Covariance.** Beside :math:`\epsilon`, a line for the bias between the neighbouring
rests leaves a rotation the noise of a Brownian bridge, :math:`K^2 T^3/12` in the angle,
and the white noise of the two rests. Time stamps with the standard deviation
:math:`s_t` leave :math:`s_t^2 \sum_j |\mathrm{d}\omega_j|^2`, rates from row to row. A
bias that is held, or walks, or a sensitivity that was taken out, is shared by all.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.equations import Between, Corrected, Variances, spread
from simval.imu.calibrate.goodness_of_fit import Beside
from simval.imu.calibrate.gyroscope.noise import GyroscopeNoise, walk_covariance
from simval.imu.calibrate.gyroscope.result import NAMES
from simval.imu.calibrate.gyroscope.rotation import (
    Rotations,
    final_rotations,
    rotations,
)
from simval.imu.calibrate.path_statistics import InterRestRotations, taken
from simval.shapes import Float, Int

HOLD: Final = "hold"
"""Name of the error of the direction in which a body rests."""


def across(u: Float[Array, "t k 3"]) -> Float[Array, "t k 2 3"]:
    """Two unit vectors at right angles to each direction (Duff et al., 2017)."""
    x, y, z = np.moveaxis(u, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=-2)


def _unit(v: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    # without a check: a trial that has gone astray is NaN, and its neighbours are not
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def inter_rest_residuals(
    C: Float[Array, "t k 3 3"],
    u: Float[Array, "s n 3"],
    E: Float[Array, "s k 2 3"],
    before: Int[np.ndarray, " k"],
) -> Float[Array, "t r"]:
    """Residuals (N5): gravity after each rotation, against the rest that follows.

    Directions may be one set for all trials.
    """
    arrived = (u[:, before, None, :] @ C)[..., 0, :]  # C'u
    e = (E @ (arrived - u[:, before + 1])[..., None])[..., 0]
    return e.reshape(len(C), -1)


class Linearised(NamedTuple):
    """Inter-rest residuals at some parameters of the gyroscope."""

    e: Float[Array, "t r"]
    rotations: Rotations
    by_angle: Float[Array, "t k a 3"]  # of each rotation's residuals, by theta
    by_gyroscope: Float[Array, "t r 12"]


@dataclass(frozen=True, kw_only=True, eq=False)
class InterRest:
    """A gyroscope read between rests: M row by row, and B where it is estimated.

    Each rotation has two residuals of gravity (N5), and a third of the field beside a
    magnetometer (J1); the bias is what the rests say of it, to its noise.
    """

    inter_rest: InterRestRotations
    noise: GyroscopeNoise
    each: int  # residuals of a rotation
    # beside the noise: of what the body turns between the mean of a rest and the
    # rotations that the gyroscope shows, about any axis, rad^2; and of M, relative
    hold: float = 0.0
    change: float = 0.0

    name: ClassVar[str] = "gyroscope"

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.noise.free

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return NAMES[: self.size]

    @property
    def item(self) -> tuple[int, int]:
        """Number of rotations, and of residuals for each."""
        return self.inter_rest.statistics.shape[1], self.each

    @cached_property
    def rate(self) -> Float[Array, "t 1"]:
        """Mean rate of the rotations, raw units: the unit of the bias's rows."""
        S, seconds = self.inter_rest.statistics[:, :, :3], self.inter_rest.seconds
        way = np.sqrt((S * S).sum(axis=2)).sum(axis=-1)
        return (way / seconds).mean(axis=1)[:, None]

    def take(self, trials: Any) -> Self:
        """Select trials."""
        inter_rest, noise = taken(self.inter_rest, trials), self.noise.take(trials)
        return replace(self, inter_rest=inter_rest, noise=noise)

    def errors(self, at: dict[str, Corrected], theta: Array) -> tuple[Beside, ...]:
        """Possible errors beyond the noise, each of variance 1, in the rows."""
        none = replace(self, noise=self.noise.none, hold=0.0, change=0.0)
        w, v = self._compared(at)
        E = self._axes(v)
        made, _ = self._linearised(w, v, E, theta)
        V = [
            each._noise(made, v, E)[0]
            for each in (
                replace(none, hold=1.0),
                replace(none, noise=none.noise.beside(1.0)),
                replace(none, change=1.0),
            )
        ]
        turned = math.prod(self.item)
        hold, white = (float(np.sqrt(np.diagonal(v)[:turned].mean())) for v in V[:2])
        return (
            Beside(HOLD, "rotations", V[0], hold),
            Beside(self.name, "rotations", V[1], white),
            Beside(self.name, "matrix", V[2]),
        )

    def beside(self, variances: Variances) -> Self:
        """The same gyroscope with such errors added to its noise."""
        return replace(
            self, noise=self.noise.beside(variances[self.name, "rotations"]),
            hold=variances[HOLD, "rotations"], change=variances[self.name, "matrix"],
        )  # fmt: skip

    def split(self, theta: Array) -> tuple[Float[Array, "t 3 3"], Float[Array, "t 3"]]:
        """Split the parameters into M, and B minus the centre of the readings."""
        B = theta[:, 9:] if self.size == 12 else self.noise.bias_value
        return theta[:, :9].reshape(-1, 3, 3), B

    def parameters(self, theta: Array) -> Float[Array, "t 12"]:
        """The parameters in raw units: M row by row, then B."""
        M, B = self.split(theta)
        return np.concatenate([M.reshape(-1, 9), B + self.inter_rest.centre], axis=1)

    def rows(self, at: dict[str, Corrected], theta: Array) -> Between:
        """Residuals linearised by eq. (N6), then the bias in units of the rate."""
        w, v = self._compared(at)
        E = self._axes(v)
        made, EC = self._linearised(w, v, E, theta)
        V, whole, (t, k, a, _) = self._noise(made, v, E), made.by_gyroscope, E.shape
        e, ends = made.e, V.shape[1] - k * a
        own = np.zeros((t, k * a + ends, self.size))
        own[:, : k * a] = whole[..., : self.size]
        by, before = {}, self.inter_rest.before
        for name, mine in (("accelerometer", slice(0, 2)), ("magnetometer", [2])):
            if name not in at:
                continue
            first, last = np.zeros(E.shape), np.zeros(E.shape)
            first[:, :, mine], last[:, :, mine] = EC[:, :, mine], -E[:, :, mine]
            if name == "accelerometer":  # whose direction is compared
                length = np.linalg.norm(at[name].w, axis=-1)[..., None, None]
                u = at[name].w[..., None, :] / length
                flat = (np.eye(3) - u.mT * u) / length
                first, last = first @ flat[:, before], last @ flat[:, before + 1]
            start, from_start = at[name].pull(first, before)
            end, from_end = at[name].pull(last, before + 1)
            J = np.zeros((t, k * a + ends, start.shape[-1]))
            J[:, : k * a] = (start + end).reshape(t, k * a, -1)
            by[name] = J, _at_rests(self.inter_rest, from_start, from_end, ends)
        if ends:
            own[:, -3:, 9:] = np.eye(3) / self.rate[:, None]
            off = self.split(theta)[1] - self.noise.bias_value
            e = np.concatenate([e, off / self.rate], axis=1)
        return Between(r=e, own=own, by=by, V=V, axes=E, whole=whole)

    def _linearised(
        self, w: Array, v: Array, E: Array, theta: Array
    ) -> tuple[Linearised, Float[Array, "t k a 3"]]:
        # and the axes of the end, turned to the start
        moved = rotations(self.inter_rest.statistics, *self.split(theta))
        EC = E @ moved.C.mT
        by_angle = np.cross(EC, w)
        t, k, a, _ = E.shape
        e = (np.vecdot(EC, w) - np.vecdot(E, v)).reshape(t, k * a)
        whole = (by_angle @ moved.slopes).reshape(t, k * a, 12)
        return Linearised(e, moved, by_angle, whole), EC

    def _noise(self, made: Linearised, v: Array, E: Array) -> Float[Array, "t r r"]:
        # covariance of the rows by the noise, and by additional errors
        ends = 3 if self.size == 12 else 0
        V, (t, k, a, _) = covariance(made, self.inter_rest, self.noise, ends), E.shape
        if self.hold > 0.0:
            L = _at_rests(self.inter_rest, -made.by_angle, np.cross(E, v), ends)
            L = L.reshape(t, k * a + ends, -1)
            V += self.hold * (L @ L.mT)
        if self.change > 0.0:
            L = change_noise(made, self.inter_rest)
            V[:, : k * a, : k * a] += self.change * (L @ L.mT)
        if ends:
            V[:, -3:] /= self.rate[:, None]
            V[:, :, -3:] /= self.rate[:, None]
        return V

    def values(
        self, at: dict[str, Corrected], theta: Array, here: Array
    ) -> Float[Array, "t r"]:
        """Residuals at other parameters, in the axes of a linearisation."""
        M, B = self.split(theta)
        C = final_rotations(self.inter_rest.statistics, M, B)
        w, v = self._compared(at)
        EC = here @ C.mT
        e = np.vecdot(EC, w) - np.vecdot(here, v)
        parts = [e.reshape(len(e), -1)]
        if self.size == 12:
            parts.append((B - self.noise.bias_value) / self.rate)
        return np.concatenate(parts, axis=1)

    def angles(self, at: dict[str, Corrected], theta: Array) -> Float[Array, "t k"]:
        """Angle between gravity as rotated and as read after each rotation, rad."""
        u = _unit(at["accelerometer"].w)
        C = final_rotations(self.inter_rest.statistics, *self.split(theta))
        before = self.inter_rest.before
        turned = (u[:, before, None] @ C)[:, :, 0]
        sine = np.linalg.norm(np.cross(turned, u[:, before + 1]), axis=-1)
        return np.arcsin(np.minimum(sine, 1.0))

    def _compared(
        self, at: dict[str, Corrected]
    ) -> tuple[Float[Array, "t k a 3"], Float[Array, "t k a 3"]]:
        # vectors that the residuals compare, of the rests before and after a rotation
        u = _unit(at["accelerometer"].w)
        field = [at["magnetometer"].w] if self.each == 3 else []
        w, before = np.stack([u, u, *field], axis=2), self.inter_rest.before
        return w[:, before], w[:, before + 1]

    def _axes(self, v: Array) -> Float[Array, "t k a 3"]:
        # in which the vectors after a rotation are compared
        E = across(v[:, :, 0])
        if self.each == 3:
            sideways = _unit(np.cross(v[:, :, 0], v[:, :, 2]))
            E = np.concatenate([E, sideways[:, :, None]], axis=2)
        return E


def _at_rests(
    inter_rest: InterRestRotations, start: Float[Array, "t k a 3"], end: Array,
    more: int = 0,
) -> Float[Array, "t r n 3"]:  # fmt: skip
    # slopes of the rows by what belongs to the rests before and after each rotation
    t, k, a, _ = start.shape
    i, before, n = np.arange(k), inter_rest.before, len(inter_rest.rest_times)
    L, each = np.zeros((t, k * a + more, n, 3)), np.zeros((t, k, a, n, 3))
    each[:, i, :, before] = np.moveaxis(start, 1, 0)
    each[:, i, :, before + 1] = np.moveaxis(end, 1, 0)
    L[:, : k * a] = each.reshape(t, k * a, n, 3)
    return L


def covariance(
    rows: Linearised, inter_rest: InterRestRotations, noise: GyroscopeNoise, ends: int
) -> Float[Array, "t q q"]:
    """Covariance of the residuals, and of rows of the bias, by gyroscope noise."""
    t, k, a, _ = rows.by_angle.shape
    count = k * a
    chunks = slice(1, -1) if inter_rest.means else slice(None)
    angle = angle_covariance(rows.rotations, noise, chunks)
    shared, bias = list[Array](), np.zeros((ends, ends))
    if noise.clock_jitter > 0.0:
        angle += jitter_covariance(rows.rotations, inter_rest, noise)
    if noise.bias == "line":
        angle += bridge_covariance(rows.rotations, inter_rest, noise)
    elif noise.bias_random_walk > 0.0:
        shared.append(walk_noise(rows, inter_rest, noise))
    if inter_rest.means or noise.bias == "line":
        shared.append(rest_noise(rows, inter_rest, noise, ends))
        bias = shared[-1][:, count:] @ shared[-1][:, count:].mT
    if noise.bias == "known":
        shared.append(rows.by_gyroscope[..., 9:] * noise.bias_std)
    if inter_rest.force.size:
        shared.append(sensitivity_noise(rows, inter_rest, noise)[:, : count + ends])
    blocks = rows.by_angle @ angle @ rows.by_angle.mT
    V = np.zeros((t, count + ends, count + ends))
    V[:, :count, :count] = spread(blocks).reshape(t, count, count)
    V[:, count:, count:] = np.diag(noise.bias_std[:ends] ** 2) - bias
    for L in shared:
        V[:, : L.shape[1], : L.shape[1]] += L @ L.mT
    return V


def angle_covariance(
    moved: Rotations, noise: GyroscopeNoise, chunks: slice
) -> Float[Array, "t k 3 3"]:
    """Covariance of theta by white noise, the integral of N^2 D M (D M)'."""
    t, k = moved.D.shape[:2]
    shared, D = moved.statistics[:1, :, 9:, chunks], moved.D[..., chunks]  # one clock
    squares = (D * shared) @ D.mT
    MN = moved.M * noise.angle_random_walk
    by = (MN @ MN.mT).reshape(t, 1, 9, 1)
    pairs = squares.reshape(t, k, 3, 3, 3, 3).swapaxes(3, 4).reshape(t, k, 9, 9)
    return (pairs @ by).reshape(t, k, 3, 3)


def walk_noise(
    rows: Linearised, inter_rest: InterRestRotations, noise: GyroscopeNoise
) -> Float[Array, "t r m"]:
    """Change of the residuals by a bias that walks but is fitted as constant.

    A rotation is off by its mean, whose variance is that in the middle less T/6.
    """
    t, k = inter_rest.statistics.shape[:2]
    walked = walk_covariance(inter_rest.middles, noise.weights, inter_rest.rest_times)
    walked -= np.diag(inter_rest.seconds / 6.0)
    # a walk that has been seen at fewer times than rotations leaves roots of zero
    values, vectors = np.linalg.eigh(walked)
    root = noise.bias_random_walk * vectors * np.sqrt(np.maximum(values, 0.0))
    by_bias = rows.by_gyroscope[..., 9:].reshape(t, k, -1, 1, 3)
    return (by_bias * root[:, None, :, None]).reshape(t, rows.e.shape[1], -1)


def change_noise(rows: Linearised, inter_rest: InterRestRotations) -> Array:
    """Change of the residuals by an M that varies with time, (t, r, m).

    Each entry, relative to the scale of M, has the variance 1 at any time and the
    correlation 1 - |dt|/T over T, from the first rotation to the last: it walks.
    """
    t, k = inter_rest.statistics.shape[:2]
    time = inter_rest.middles
    away = np.abs(time[:, None] - time) / max(np.ptp(time), inter_rest.seconds[0])
    values, vectors = np.linalg.eigh(1.0 - away)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    size = np.cbrt(np.abs(np.linalg.det(rows.rotations.M)))[:, None, None]
    by_M = (rows.by_gyroscope[..., :9] * size).reshape(t, k, -1, 1, 9)
    return (by_M * root[:, None, :, None]).reshape(t, rows.e.shape[1], -1)


def rest_noise(
    rows: Linearised, inter_rest: InterRestRotations, noise: GyroscopeNoise, more: int
) -> Float[Array, "t r m"]:
    r"""Change of residuals and rows of the bias by the white noise in each rest.

    Two unit noises of an axis say all: that of the mean reading, of
    :math:`N/\sqrt{T_r}`, and that of its slope, :math:`\int (2s - 1) n\, dt` of
    :math:`N \sqrt{T_r/3}`. A ramp of eq. (N12) has half of each, and the two ramps of
    one rest the slope with opposite signs, which leaves them :math:`N^2 T_r/3` each
    and :math:`N^2 T_r/6` together. A line between rests goes through their means.
    """
    N, T = noise.angle_random_walk, inter_rest.rest_seconds[:, None, None]
    t, r = rows.e.shape
    moved, std, both = rows.rotations, N / np.sqrt(T), list[Array]()
    before, after = np.zeros((2, *rows.by_angle.shape))
    ends = inter_rest.before, inter_rest.before + 1
    if noise.bias == "line":
        start, end = (inter_rest.rest_times[rests, None] for rests in ends)
        along = (inter_rest.times - start) / (end - start)
        before, after = (
            rows.by_angle @ moved.by_line(weights) * std[rests]
            for weights, rests in (
                (1.0 - along, ends[0]),
                (along, ends[1]),
            )
        )
    if inter_rest.means:
        ramp = 0.5 * np.sqrt(T) * N
        by = rows.by_angle[:, :, None] @ np.moveaxis(
            moved.by_rate()[..., (0, -1), :], 3, 2
        )
        start, end = by[:, :, 0] * ramp[ends[0]], by[:, :, 1] * ramp[ends[1]]
        before, after = before + start, after + end
        both.append(_at_rests(inter_rest, start, -end, more) / np.sqrt(3.0))
    mean = _at_rests(inter_rest, before, after, more)
    mean[:, r:] = -np.eye(3)[:more, None] * (noise.weights[:, None] * std[:, 0])
    return np.concatenate([x.reshape(t, r + more, -1) for x in (mean, *both)], axis=2)


def bridge_covariance(
    moved: Rotations, inter_rest: InterRestRotations, noise: GyroscopeNoise
) -> Float[Array, "t k 3 3"]:
    """Covariance of theta by a bias that walks about the line between two rests."""
    # theta = int A (b - line) dt = int g dW, g(s) = int_s A dt - int (t / T) A dt
    tau = inter_rest.statistics[0, :, 9]  # k j
    pulls = moved.by_rate() * tau[:, None, :, None]  # t k 3 j 3
    rests, before = inter_rest.rest_times, inter_rest.before
    length = (rests[before + 1] - rests[before])[:, None]
    along = (inter_rest.times - rests[before, None]) / length
    whole = (pulls * along[:, None, :, None]).sum(axis=3, keepdims=True)
    later = np.cumsum(pulls[..., ::-1, :], axis=3)[..., ::-1, :] - 0.5 * pulls
    g = later - whole
    # before the rotation the integral is whole, after it nothing is left of it
    total, whole = pulls.sum(axis=3) - whole[..., 0, :], whole[..., 0, :]
    begin = inter_rest.times[:, 0] - 0.5 * tau[:, 0] - rests[before]
    rest = length[:, 0] - begin - tau.sum(axis=1)
    square = np.einsum("tkajb,tkcjb,kj->tkac", g, g, tau)
    square += np.einsum("tkab,tkcb,k->tkac", total, total, begin)
    square += np.einsum("tkab,tkcb,k->tkac", whole, whole, rest)
    return noise.bias_random_walk**2 * square


def jitter_covariance(
    moved: Rotations, inter_rest: InterRestRotations, noise: GyroscopeNoise
) -> Float[Array, "t k 3 3"]:
    r"""Covariance of theta by independent errors of the time stamps.

    A stamp that is late by :math:`\delta` lengthens the step before it and shortens
    the next, so the rotation is off by :math:`\delta` times the difference of their
    rates. Over a chunk of c steps rates change evenly: the squares of their differences
    sum to that of the chunks' over c.
    """
    t, k, _, j = inter_rest.statistics.shape
    tau = inter_rest.statistics[:, :, 9]
    turned = (
        inter_rest.statistics[:, :, :3] - tau[:, :, None] * moved.B[:, None, :, None]
    )
    rate = moved.M[:, None] @ (turned / np.where(tau > 0.0, tau, 1.0)[:, :, None])
    seen = np.einsum("tkabj,tkbj->tkaj", moved.D.reshape(t, k, 3, 3, j), rate)
    change = np.diff(np.pad(seen, ((0, 0), (0, 0), (0, 0), (1, 1))), axis=-1)
    squares = change @ change.mT
    return noise.clock_jitter**2 / inter_rest.chunk * squares


def sensitivity_noise(
    rows: Linearised, inter_rest: InterRestRotations, noise: GyroscopeNoise
) -> Float[Array, "t r s"]:
    """Change of residuals and bias by the error of a g-sensitivity taken out.

    The regression on the rests gives each axis a row of G with the covariance
    :math:`N^2 C`; the mean reading less G times the mean force is the bias.
    """
    t, k = inter_rest.statistics.shape[:2]
    C, N = inter_rest.force_noise[1:, 1:], noise.angle_random_walk
    root = np.linalg.cholesky(C)
    mean = -np.linalg.solve(C, inter_rest.force_noise[1:, 0])
    by_G = np.einsum("tkija,kbj->tkiab", rows.rotations.by_rate(N), inter_rest.force)
    theta = np.einsum("tkiab,bq->tkiaq", by_G, root).reshape(t, k, 3, -1)
    bias = np.einsum("ac,q,a->acq", np.eye(3), mean @ root, N).reshape(1, 3, -1)
    own = (-rows.by_angle @ theta).reshape(t, -1, bias.shape[-1])
    return np.concatenate([own, np.broadcast_to(bias, (t, *bias.shape[1:]))], axis=1)
