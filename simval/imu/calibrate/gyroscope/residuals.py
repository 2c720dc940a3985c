r"""Inter-rest residuals: a gyroscope's block of the calibration core.

Turn k takes the direction of gravity :math:`u_k = h_k/|h_k|, h = M_a(\bar y - b_a)`
into :math:`u_{k+1}`; along it nothing is seen, so with :math:`E_k` two unit vectors
across :math:`u_{k+1}`

.. math:: e_k = E_k^T (C_k^T u_k - u_{k+1}) \tag{N5}

and, :math:`\epsilon_k` the angle random walk of the move,

.. math:: \mathrm{d}e_k = E_k^T C_k^T [u_k\times](\theta_k + \epsilon_k)
   + E_k^T (C_k^T \mathrm{d}u_k - \mathrm{d}u_{k+1}),\quad
   \mathrm{cov}\,\epsilon_k = N^2 \sum_j \tau_j (D_j M)(D_j M)^T. \tag{N6}

A magnetometer adds a third row, eq. (J1) of `nine_axis`. The bias B has rows where it
is estimated: what the rests say of it, over the mean rate of the moves.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from simval.arrays import Array
from simval.geometry import normalize
from simval.imu.calibrate.equations import Between, Corrected
from simval.imu.calibrate.gyroscope.covariance import (
    Gaps,
    Setting,
    own_covariance,
    spread,
)
from simval.imu.calibrate.gyroscope.moves import Moves, taken
from simval.imu.calibrate.gyroscope.turn import Turn, end_of, turn
from simval.shapes import Float


def across(u: Float[Array, "t k 3"]) -> Float[Array, "t k 2 3"]:
    """Two unit vectors across each direction, as rows (Duff and others, 2017)."""
    x, y, z = np.moveaxis(u, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=-2)


def gap_values(
    C: Float[Array, "t k 3 3"],
    u: Float[Array, "t n 3"],
    E: Float[Array, "t k 2 3"],
) -> Float[Array, "t r"]:
    """Rows of the gaps, eq. (N5)."""
    arrived = (u[:, :-1, None, :] @ C)[..., 0, :]  # C'u
    e = (E @ (arrived - u[:, 1:])[..., None])[..., 0]
    return e.reshape(len(u), -1)


@dataclass(frozen=True, kw_only=True, eq=False)
class InterRest:
    """A gyroscope read between rests: M row by row, and B where it is estimated.

    Each of its turns has two rows of gravity (N5), and a third of the field beside a
    magnetometer (J1); the bias is what the rests say of it, to its noise.
    """

    moves: Moves
    setting: Setting
    each: int  # rows of a turn

    name: ClassVar[str] = "gyroscope"

    @property
    def size(self) -> int:
        """Parameters."""
        return self.setting.free

    @property
    def item(self) -> tuple[int, int]:
        """Moves, and rows of each."""
        return self.moves.statistics.shape[1], self.each

    @cached_property
    def rate(self) -> Float[Array, "t 1"]:
        """Mean rate of the moves, raw units: the unit of the bias's rows."""
        S, seconds = self.moves.statistics[:, :, :3], self.moves.seconds
        way = np.sqrt((S * S).sum(axis=2)).sum(axis=-1)
        return (way / seconds).mean(axis=1)[:, None]

    def take(self, trials: Any) -> Self:
        """Some of the trials."""
        setting = replace(self.setting, bias_value=self.setting.bias_value[trials])
        return replace(self, moves=taken(self.moves, trials), setting=setting)

    def noisier(self, factor: float) -> Self:
        """The same with so many times the noise."""
        return replace(self, setting=self.setting.noisier(factor))

    def split(self, theta: Array) -> tuple[Float[Array, "t 3 3"], Float[Array, "t 3"]]:
        """M, and B less the centre of the moves."""
        B = theta[:, 9:] if self.size == 12 else self.setting.bias_value
        return theta[:, :9].reshape(-1, 3, 3), B

    def gaps(
        self, at: dict[str, Corrected], theta: Array
    ) -> tuple[Gaps, Turn, Float[Array, "t k a 3"]]:
        """Rows of the turns alone, the turns, and the axes in which they compare."""
        M, B = self.split(theta)
        moved = turn(self.moves.statistics, M, B)
        w = self._compared(at)
        E = across(w[:, 1:, 0])
        if self.each == 3:
            sideways = normalize(np.cross(w[:, 1:, 0], w[:, 1:, 2]))
            E = np.concatenate([E, sideways[:, :, None]], axis=2)
        EC = E @ np.swapaxes(moved.C, -1, -2)
        by_turn = np.cross(EC, w[:, :-1])
        t, k, a, _ = E.shape
        e = np.vecdot(EC, w[:, :-1]) - np.vecdot(E, w[:, 1:])
        slopes = (by_turn @ moved.slopes).reshape(t, k * a, 12)
        gaps = Gaps(e=e.reshape(t, k * a), by_turn=by_turn, by_gyroscope=slopes)
        return gaps, moved, E

    def rows(self, at: dict[str, Corrected], theta: Array) -> Between:
        """Linearised rows of the turns, eq. (N6), and of the bias over the rate."""
        gaps, moved, E = self.gaps(at, theta)
        M, B = self.split(theta)
        noise = spread(gaps, moved, self.moves, self.setting, M, B)
        t, rows = gaps.e.shape
        ends = 3 if self.size == 12 else 0
        own = np.zeros((t, rows + ends, self.size))
        own[:, :rows] = gaps.by_gyroscope[..., : self.size]
        EC = E @ np.swapaxes(moved.C, -1, -2)
        by = {}
        for name, mine in (("accelerometer", slice(0, 2)), ("magnetometer", [2])):
            if name not in at:
                continue
            first, last = np.zeros(E.shape), np.zeros(E.shape)
            first[:, :, mine], last[:, :, mine] = EC[:, :, mine], -E[:, :, mine]
            if name == "accelerometer":  # whose direction is compared
                length = np.linalg.norm(at[name].w, axis=-1)[..., None, None]
                u = at[name].w[..., None, :] / length
                flat = (np.eye(3) - np.swapaxes(u, -1, -2) * u) / length
                first, last = first @ flat[:, :-1], last @ flat[:, 1:]
            by[name] = _pulled(at[name], first, last, ends)
        r, unit = gaps.e, np.ones((t, rows + ends))
        if ends:
            own[:, -3:, 9:] = np.eye(3) / self.rate[:, None]
            r = np.concatenate([r, (B - self.setting.bias_value) / self.rate], axis=1)
            unit[:, -3:] = 1.0 / self.rate
        V = own_covariance(noise, self.setting.bias_std[:ends])
        V *= unit[:, :, None] * unit[:, None]
        return Between(r=r, own=own, by=by, V=V, axes=E, whole=gaps.by_gyroscope)

    def values(
        self, at: dict[str, Corrected], theta: Array, here: Array
    ) -> Float[Array, "t r"]:
        """Values of the rows, compared in the axes of a linearisation."""
        M, B = self.split(theta)
        C = end_of(self.moves.statistics, M, B)
        w = self._compared(at)
        EC = here @ np.swapaxes(C, -1, -2)
        e = np.vecdot(EC, w[:, :-1]) - np.vecdot(here, w[:, 1:])
        parts = [e.reshape(len(e), -1)]
        if self.size == 12:
            parts.append((B - self.setting.bias_value) / self.rate)
        return np.concatenate(parts, axis=1)

    def angles(self, at: dict[str, Corrected], theta: Array) -> Float[Array, "t k"]:
        """Between gravity as turned and as read at the end of each turn, rad."""
        u = normalize(at["accelerometer"].w)
        C = end_of(self.moves.statistics, *self.split(theta))
        turned = (u[:, :-1, None] @ C)[:, :, 0]
        sine = np.linalg.norm(np.cross(turned, u[:, 1:]), axis=-1)
        return np.asarray(np.arcsin(np.minimum(sine, 1.0)))

    def _compared(self, at: dict[str, Corrected]) -> Float[Array, "t n a 3"]:
        # vectors of each rest that the rows compare
        u = normalize(at["accelerometer"].w)
        field = [at["magnetometer"].w] if self.each == 3 else []
        return np.stack([u, u, *field], axis=2)


def _pulled(
    at: Corrected, first: Float[Array, "t k a 3"], last: Array, more: int
) -> tuple[Float[Array, "t r q"], Float[Array, "t r n 3"]]:
    # derivatives of the rows by a triad's parameters and unit noises, from those by its
    # vectors at the start and the end of each turn
    start, from_start = at.pull(first, slice(None, -1))
    end, from_end = at.pull(last, slice(1, None))
    t, k, a = first.shape[:3]
    gap = np.arange(k)
    L = np.zeros((t, k, a, k + 1, 3))
    L[:, gap, :, gap] = np.moveaxis(from_start, 1, 0)
    L[:, gap, :, gap + 1] = np.moveaxis(from_end, 1, 0)
    padded = ((0, 0), (0, more), (0, 0))
    J = np.pad((start + end).reshape(t, k * a, -1), padded)
    return J, np.pad(L.reshape(t, k * a, k + 1, 3), (*padded, (0, 0)))
