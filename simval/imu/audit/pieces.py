"""Smooth pieces of a recording, each with three versions of its true path.

By splines of the seventh degree; of the fifth, for what the degree changes bounds the
error of the higher one; and of the seventh through poses with their rounding again.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import RefusedError
from simval.geometry import normalize
from simval.imu.audit.simulated import LEAST, SENSORS, SimulatedImu
from simval.path import Kinematics, PosePath
from simval.shapes import Bool, Float

LONGEST: Final = 1 << 15  # rows of a piece
MOST: Final = 8  # pieces
HOLE: Final = 3.0  # steps without a row
ENDS: Final = 6  # poses at an end of a path, where a spline is poor
BESIDE: Final = 10  # rows next to a place where the truth is not smooth
ROUGH: Final = 20.0  # times the usual change by the degree of the spline
ROUGH_SHARE: Final = 0.01  # of the specific force
COARSE: Final = 5
RowFlags = Bool[np.ndarray, " n"]
TrueMotion = Callable[[float], Kinematics]
_EIGHTH: Final = np.sqrt(12870.0)  # of white noise in its eighth difference


class Piece(NamedTuple):
    """A stretch of readings, and the true path along it."""

    time: Float[Array, " n"]
    readings: dict[str, Float[Array, "n 3"]]
    step: float
    path: PosePath
    coarse: PosePath
    rounded: PosePath

    def rows(self, some: slice | RowFlags) -> "Piece":
        """Select some of the rows."""
        kept = {name: value[some] for name, value in self.readings.items()}
        return self._replace(time=self.time[some], readings=kept)

    def truth(self, path: PosePath) -> TrueMotion:
        """Function that gives the truth at the rows, taken so many seconds earlier."""
        return cache(lambda late: path.at(self.time - late))


class Pieces(NamedTuple):
    """A recording, cut into smooth pieces."""

    smooth: list[Piece]
    start: Piece  # the first rows, where a path's end is poor
    rough: Float[Array, " r"]  # times where the truth is not smooth


def pieces_of(imu: SimulatedImu) -> Pieces:
    """Cut a recording into pieces along which the truth is smooth.

    Raises
    ------
    RefusedError
        If there is none.
    """
    smooth: list[Piece] = []
    starts: list[Piece] = []
    rough = [np.zeros(0)]
    for whole in _windows(imu):
        reach = ENDS * whole.path.step
        time, path = whole.time, whole.path
        inner = whole.rows((time >= path.start + reach) & (time <= path.stop - reach))
        if len(inner.time) < LEAST // 2:
            continue
        starts.append(whole.rows(slice(0, ENDS)))
        off = _rough(inner)
        rough.append(inner.time[off])
        good = np.convolve(off, np.ones(2 * BESIDE + 1), "same") == 0.0
        edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).tolist()
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if last - first >= LEAST // 2:
                smooth.append(inner.rows(slice(first, last)))
    if not smooth:
        msg = (
            "no part of the recording has a smooth truth with readings beside it; look "
            "at the clocks of both, or record longer between contacts"
        )
        raise RefusedError(msg)
    return Pieces(smooth, starts[0], np.concatenate(rough))


def _windows(imu: SimulatedImu) -> Iterator[Piece]:
    # rows without a hole, of a length that fits, with poses about them
    time, poses = imu.time, imu.poses
    step = float(np.median(np.diff(poses)))
    holes = np.flatnonzero(np.diff(time) > HOLE * imu.step) + 1
    parts = [
        part
        for run in np.split(np.arange(len(time)), holes)
        for part in np.array_split(run, -(-len(run) // LONGEST))
        if len(part) >= LEAST
    ]
    readings = {name: getattr(imu, name) for name in SENSORS}
    for rows in parts[:: max(1, -(-len(parts) // MOST))]:
        reach = 2.0 * ENDS * step
        about = (poses >= time[rows[0]] - reach) & (poses < time[rows[-1]] + reach)
        own = poses[about]
        if len(own) < LEAST // 2 or np.diff(own).max() > HOLE * step:
            continue
        pose = own, imu.position[about], imu.attitude[about]
        path = PosePath(*pose)
        yield Piece(
            time[rows], {k: v[rows] for k, v in readings.items() if v is not None},
            imu.step, path, PosePath(*pose, COARSE),
            _rounded(own, path.poses),
        )  # fmt: skip


def _rounded(time: Float[Array, " n"], poses: Float[Array, "n 7"]) -> PosePath:
    # with white noise as large as theirs, by what a polynomial of the seventh degree
    # leaves of a smooth course
    left = np.sort(np.diff(poses, 8, axis=0) ** 2, axis=0)
    sd = np.sqrt(left[: int(0.95 * len(left)) + 1].mean(axis=0)) / _EIGHTH
    rng = np.random.Generator(np.random.SFC64(len(poses)))
    again = poses + sd * rng.standard_normal(poses.shape)
    return PosePath(time, again[:, :3], normalize(again[:, 3:]))


def _rough(piece: Piece) -> RowFlags:
    zero, g = np.zeros(3), np.array([0.0, 0.0, -9.8])
    fine, coarse = (
        each.at(piece.time).specific_force(zero, g)
        for each in (piece.path, piece.coarse)
    )
    change = np.linalg.norm(fine - coarse, axis=1)
    size = float(np.sqrt(np.median(fine**2, axis=0).sum()))
    return change > np.maximum(ROUGH * np.median(change), ROUGH_SHARE * size)
