r"""Recorded quaternions: what they mean, attitudes between rows, turns in a stretch.

Four numbers can be read scalar first or last, and as taking the world to the body or
the body to the world. A quaternion read in another order is the same one under an
orthogonal map of four dimensions, which is :math:`q \to a\,q\,b` or
:math:`q \to a\,q^*\,b` with constant a and b. These turn the world and the body once
for all, and both turns are estimated; so a motion can only tell *two* classes apart, q
and :math:`q^*`, and within a class every reading gives the same aligned truth. Of these
the one is named whose body axes are nearest to the sensor's.

**Turns.** A stretch is a tenth of a second. In it the gyroscope's rows, averages over
the steps that end with them, sum to :math:`y_j = \sum y_k \Delta t_k`, whatever their
unit, and the recorded attitudes to the integral of the rate in body axes,

.. math:: x_j(\tau) = \sum_k d_k - \tfrac{1}{24}(d_{k-1} \times d_k + d_k \times
   d_{k+1}), \quad d_k = \log A(t_{k-1} + \tau) A(t_k + \tau)'. \tag{R1}

Both are sums, so that a matrix between them is linear, and the noise of a recorded
attitude counts at the two ends of a stretch only (to first order).
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.geometry import axial, compose, conjugate
from simval.imu.logs.truth import Scalar
from simval.shapes import Float, Int

HOLE: Final = 2.5
"""Median steps between measurements beyond which nothing is drawn between them."""

NEIGHBOURS: Final = 6  # of a polynomial of the fifth degree


@dataclass(frozen=True, slots=True)
class Meaning:
    """Order and direction of a recorded quaternion."""

    scalar: Literal["first", "last"]
    # what the rotation of these numbers, as SciPy has it, takes to what
    takes: Literal["body to world", "world to body"]

    def __str__(self) -> str:
        return f"scalar {self.scalar}, takes {self.takes}"


def meanings(scalar: Scalar) -> tuple[Meaning, ...]:
    """All meanings that the names of the columns allow."""
    orders: tuple[Literal["first", "last"], ...] = (
        ("first", "last") if scalar == "unstated" else (scalar,)
    )
    return tuple(
        Meaning(order, takes)
        for order in orders
        for takes in ("body to world", "world to body")
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attitudes(ReadOnly):
    """Attitudes world to body at recorded times, with holes."""

    time: Float[Array, " n"]  # s
    q: Float[Array, "n 4"]  # signs continuous
    step: float  # median between rows, s

    def at(self, wanted: Float[Array, " m"]) -> Float[Array, "m 4"]:
        """Attitudes at other times by a polynomial of six neighbours; NaN in holes.

        The first neglected term is of sixth order in the step.
        """
        half = NEIGHBOURS // 2
        last = np.searchsorted(self.time, wanted, side="right") + half - 1
        place = np.clip(last, NEIGHBOURS - 1, len(self.time) - 1)
        rows = place[:, None] + np.arange(1 - NEIGHBOURS, 1)
        knots, values = self.time[rows], self.q[rows]
        weights = np.ones_like(knots)
        for j in range(NEIGHBOURS):
            for k in range(NEIGHBOURS):
                if j != k:
                    weights[:, j] *= (wanted - knots[:, k]) / (
                        knots[:, j] - knots[:, k]
                    )
        between = np.einsum("mj,mjc->mc", weights, values)
        whole = np.all(np.diff(knots, axis=1) <= HOLE * self.step, axis=1)
        inside = (wanted >= knots[:, 0]) & (wanted <= knots[:, -1])
        length = np.linalg.norm(between, axis=1)
        good = whole & inside & (length > 0.5)
        return np.where(
            good[:, None], between / np.where(good, length, 1.0)[:, None], np.nan
        )


def meant(components: Float[Array, "n 4"], meaning: Meaning) -> Float[Array, "n 4"]:
    """Attitudes world to body from recorded numbers, for a meaning."""
    q = np.roll(components, -1, axis=1) if meaning.scalar == "first" else components
    return conjugate(q) if meaning.takes == "world to body" else q


def attitudes(
    time: Float[Array, " n"], components: Float[Array, "n 4"], meaning: Meaning
) -> Attitudes:
    """Attitudes world to body for a meaning, without rows that are missing."""
    there = np.isfinite(components).all(axis=1)
    q = meant(components[there], meaning)
    flips = np.where(np.vecdot(q[1:], q[:-1]) < 0.0, -1.0, 1.0)
    q = q * np.cumprod(np.concatenate([[1.0], flips]))[:, None]
    return Attitudes(time=time[there], q=q, step=float(np.median(np.diff(time))))


def rotation_vector(q: Float[Array, "... 4"]) -> Float[Array, "... 3"]:
    """Rotation vector of unit quaternions, rad, at most pi long; NaN stays NaN."""
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    half = np.arctan2(sine, q[..., 3])
    small = sine < 1e-9  # half / sine = 1 + sine^2 / 6
    ratio = np.where(small, 1.0, half / np.where(small, 1.0, sine))
    return 2.0 * ratio[..., None] * q[..., :3]


def turned(first: Float[Array, "... 4"], then: Float[Array, "... 4"]) -> Array:
    """Rotation vector from one attitude to the next, in body axes, rad."""
    e1, s1 = first[..., :3], first[..., 3:]
    e2, s2 = then[..., :3], then[..., 3:]
    vector = s1 * e2 - s2 * e1 - np.cross(e1, e2)
    scalar = s1 * s2 + np.sum(e1 * e2, axis=-1, keepdims=True)
    return rotation_vector(np.concatenate([vector, scalar], axis=-1))


def of_matrix(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Unit quaternion q with A(q) equal to a rotation matrix."""
    # the greatest eigenvector of Davenport's matrix, for A = sum_i b_i r_i'
    B = matrix
    K = np.empty((4, 4))
    K[:3, :3] = B + B.T - np.trace(B) * np.eye(3)
    K[:3, 3] = K[3, :3] = axial(B.T)
    K[3, 3] = np.trace(B)
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[3] >= 0.0 else -q


def rotated(
    q: Float[Array, "n 4"], vectors: Float[Array, "n 3"]
) -> Float[Array, "n 3"]:
    """Vectors in body axes turned into the world, A(q)' v; NaN stays NaN."""
    e, s = q[..., :3], q[..., 3:]
    twice = 2.0 * np.cross(e, vectors)
    return vectors + s * twice + np.cross(e, twice)


def composed(
    first: Float[Array, "... 4"], then: Float[Array, "... 4"]
) -> Float[Array, "n 4"]:
    """Composition A(then) A(first); NaN where either is NaN."""
    there = np.isfinite(first + then).all(axis=1, keepdims=True)
    still = [0.0, 0.0, 0.0, 1.0]
    first, then = np.where(there, first, still), np.where(there, then, still)
    return np.where(there, compose(first, then), np.nan)


STRETCH: Final = 0.1
"""s. Shorter ones hear more of the noise at their ends, longer ones lose fast turns."""

STEP: Final = 0.01
"""s; longest between attitudes within a stretch, or one row: (R1) leaves the fourth
order in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretches(ReadOnly):
    """Stretches of a log, and the turn in each by its gyroscope."""

    time: Float[Array, "m s"]  # of the attitudes in each, the two ends among them, s
    turn: Float[Array, "m 3"]  # sums y_j, raw units times s
    # rate at the end less that at the start, by the gyroscope, raw units
    change: Float[Array, "m 3"]

    @property
    def seconds(self) -> Float[Array, " m"]:
        """Length of each stretch, s."""
        return self.time[:, -1] - self.time[:, 0]

    @property
    def middle(self) -> Float[Array, " m"]:
        """Middle of each stretch, s."""
        return 0.5 * (self.time[:, -1] + self.time[:, 0])

    def truth(
        self, attitudes: Attitudes, offset: Float[Array, " m"]
    ) -> Float[Array, "m 3"]:
        """Integral of the rate by eq. (R1), rad; NaN where an attitude is missing."""
        moved = self.time + offset[:, None]
        q = attitudes.at(moved.ravel()).reshape(*moved.shape, 4)
        d = turned(q[:, :-1], q[:, 1:])
        pairs = np.cross(d[:, :-1], d[:, 1:])
        # each inner pair counts for both its steps; beyond the ends as next to them
        ends = pairs[:, :1].sum(axis=1) + pairs[:, -1:].sum(axis=1)
        return d.sum(axis=1) - (2.0 * pairs.sum(axis=1) + ends) / 24.0


def stretches(
    time: Float[Array, " n"], gyro: Float[Array, "n 3"], *, coarse: bool = False
) -> Stretches:
    """Cut a log into stretches; coarse ones use the attitudes at their ends only."""
    step = float(np.median(np.diff(time)))
    inner = max(1, round(STEP / step))
    count = max(1, round(STRETCH / (inner * step)))
    rows = inner * count
    starts: Int[np.ndarray, " m"] = np.arange(inner, len(time) - rows - inner, rows)
    sums = np.cumsum(
        np.concatenate([np.zeros((1, 3)), gyro[1:] * np.diff(time)[:, None]]), axis=0
    )
    places = (0, rows) if coarse else range(0, rows + 1, inner)
    return Stretches(
        time=time[starts[:, None] + np.array(places)],
        turn=sums[starts + rows] - sums[starts],
        change=_about(sums, time, starts + rows, inner)
        - _about(sums, time, starts, inner),
    )


def _about(
    sums: Float[Array, "n 3"],
    time: Float[Array, " n"],
    rows: Int[np.ndarray, " m"],
    half: int,
) -> Float[Array, "m 3"]:
    # mean rate about the ends of some rows, over as many rows before as behind
    first, last = rows - half, rows + half
    return (sums[last] - sums[first]) / (time[last] - time[first])[:, None]
