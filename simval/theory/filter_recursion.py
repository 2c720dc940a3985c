r"""Bound on attitude filters, by recursions over many rows.

**Blocks of rows that advance together.** The rows are cut into about as many blocks as
a block has rows. For all blocks at once, the map from the block's start to each of its
rows is carried on, row after row; then the state is carried from block to block, and
each map is applied to its block's start. T rows so take some :math:`2\sqrt T`
operations on arrays instead of T.

For the Riccati recursion a map is

.. math:: P \mapsto A (P^{-1} + J)^{-1} A^T + C,  \tag{F3}

C the covariance from a start without error, A what is left of the start's error, and J
the information on the start. A row, the step F, Q and then measurements that add the
information :math:`\Omega` on the attitude, whose columns of a matrix are p, carries
it on from I, 0, 0 by

.. math:: P^- = F C F^T + Q, \quad A^- = F A, \quad
   G = (I + \Omega P^-_{pp})^{-1} \Omega, \\
   C = P^- - P^-_{\cdot p} G P^-_{p \cdot}, \quad
   A = A^- - P^-_{\cdot p} G A^-_{p \cdot}, \quad
   J \leftarrow J + A^{-T}_{p \cdot} G A^-_{p \cdot}.  \tag{F4}

(S. Särkkä and A. F. García-Fernández, Temporal parallelization of Bayesian smoothers,
IEEE Trans. Automatic Control 66 (2021), give such maps for estimates with their means.)
Once the gains are known, covariances X of one source of error each and columns S of
means and sensitivities go linearly,

.. math:: X \mapsto A X A^T + N, \qquad S \mapsto A S + D.  \tag{F5}

**The bound: the error's covariance along the truth.** No estimate from the readings up
to a row has a smaller covariance of the attitude's error and of the gyroscope bias than
the inverse of the Bayesian information, which the Riccati recursion gives for a linear
problem. Along the true path, eq. (F1), it is

.. math:: P^- = F P F^T + Q, \qquad P = (P^{-1}_- + \textstyle\sum_i \Omega_i)^{-1},
   \tag{F2}

and that is the posterior Cramer-Rao bound up to second order of the error: what the
first order leaves out is the error's square over the standard deviation, which a start
that is known to 0.05 rad with sensors of 0.002 rad forgets in ten rows. A reading bends
by half the square of the attitude's error before it, whose second moment is
:math:`\Sigma^-`, and what that does to the estimate after k rows has, in stated
standard deviations of the best known direction, the size

.. math:: e_k = \frac{\operatorname{tr} \Sigma^-_{k,\theta\theta}}{2}\,
   \lambda_{\max}^{1/2}\bigl((P_k^{-1})_{\theta\theta}\bigr), \qquad
   e_k^2 \leftarrow e_k^2 + e_1^2/k,  \tag{F15}

as that of the first row, the start's, is one reading of k. A normalised square grows by
:math:`E|e|^2 \le 3 e_k^2`: an error's fourth power is up to three squares of its
second.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any, Final

import numpy as np

from simval.arguments import instance, whole_number
from simval.arrays import Array, Places, ReadOnly, outer
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_model import (
    FilterModel,
    FilterPath,
    Steps,
    scales,
    steps_of,
)

Matrices = tuple[Array, ...]
"""Of a map, a row or a state; all of a kind have the same leading axes."""

SIZE: Final = 6
"""States: rotation vector of the attitude's error, and error of the bias."""


def scan(
    rows: Matrices,
    start: Matrices,
    carry: Callable[[Matrices | None, Matrices], Matrices],
    apply: Callable[[Matrices, Matrices], Matrices],
) -> Matrices:
    """States after each of T rows, whose matrices have the leading axis T.

    ``carry(map, row)`` is the map after one row more, of none at first.
    """
    T = len(rows[0])
    length = ceil(sqrt(T))
    first = np.arange(0, T, length)
    carried: Matrices | None = None
    steps = []
    for k in range(length):
        # the last block goes on with copies of its last row
        place = np.minimum(first + k, T - 1)
        carried = carry(carried, tuple(each[place] for each in rows))
        steps.append(carried)
    maps = tuple(np.stack(each) for each in zip(*steps, strict=True))
    starts = [start]
    for b in range(len(first) - 1):
        starts.append(apply(starts[-1], tuple(each[-1, b] for each in maps)))
    states = apply(tuple(np.stack(each) for each in zip(*starts, strict=True)), maps)
    # row of a block, block -> row
    return tuple(
        each.swapaxes(0, 1).reshape(-1, *each.shape[2:])[:T] for each in states
    )


def carry_riccati(map_: Matrices | None, row: Matrices) -> Matrices:
    """Extend a map A, C, J by a row, eq. (F4)."""
    F, Q, information = row
    if map_ is None:
        P, M, J = Q, F, np.zeros_like(F)
    else:
        A, C, J = map_
        P, M = F @ C @ F.mT + Q, F @ A
    top = M[..., :3, :]
    G = np.linalg.inv(np.eye(3) + information @ P[..., :3, :3]) @ information
    gain = P[..., :3] @ G
    C = P - gain @ P[..., :3, :]
    return M - gain @ top, C, J + top.mT @ (G @ top)


def apply_riccati(state: Matrices, maps: Matrices) -> Matrices:
    """Covariances after some maps, eq. (F3), from a root of the first."""
    A, C, J = maps
    R = _root(state[0])
    middle = np.linalg.inv(np.eye(SIZE) + R.mT @ J @ R)
    AR = A @ R
    P = AR @ middle @ AR.mT + C
    return ((P + P.mT) / 2.0,)


def _root(P: Float[Array, "... 6 6"]) -> Float[Array, "... 6 6"]:
    # R R' = P, which may be singular; of the correlations, whose units are one
    unit = scales(P)
    values, V = np.linalg.eigh(P / outer(unit, unit))
    return unit[..., :, None] * V * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def carry_linear(map_: Matrices | None, row: Matrices) -> Matrices:
    """Extend a linear map by a row, eq. (F5)."""
    if map_ is None:
        return row
    A_i, N_i, D_i = map_
    A, N, D = row
    return A @ A_i, _carried(A, N_i) + N, A @ D_i + D


def apply_linear(state: Matrices, maps: Matrices) -> Matrices:
    """Covariances by source and columns after linear maps, eq. (F5)."""
    X, S = state
    A, N, D = maps
    return _carried(A, X) + N, A @ S + D


def _carried(
    A: Float[Array, "... 6 6"], X: Float[Array, "... s 6 6"]
) -> Float[Array, "... s 6 6"]:
    A = A[..., None, :, :]
    return A @ X @ A.mT


TOGETHER: Final = 1 << 14
"""Rows at once: 50 MB, and blocks of 128 rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterBound(ReadOnly):
    """Least covariance of any filter's error at some rows.

    Attributes
    ----------
    kept : Array
        The rows, (k,).
    covariance : Array
        After the row's measurements: rotation vector, body side, rad, then bias, rad/s,
        (k, 6, 6).
    before : Array
        Before them, (k, 6, 6).
    """

    kept: Places
    covariance: Float[Array, "k 6 6"]
    before: Float[Array, "k 6 6"]

    @property
    def attitude_sd(self) -> Float[Array, " k"]:
        """Least attitude error, RMS over the axes, rad, (k,)."""
        return np.sqrt(np.linalg.trace(self.covariance[:, :3, :3]) / 3.0)


def filter_bound(path: FilterPath, model: FilterModel, *, keep: Any = 1) -> FilterBound:
    """Bound the error of any filter of these sensors on this path, eq. (F2).

    Parameters
    ----------
    path : FilterPath
        The true motion.
    model : FilterModel
        The true noise, sensors and start.
    keep : int or array_like, default 1
        Rows to give: every so many, as of a sensor, or their indices, increasing.

    Returns
    -------
    FilterBound
        The covariances at these rows.

    Raises
    ------
    InputError
        If the sensors do not fit the path, or a row is not there.
    """
    instance("path", path, FilterPath)
    instance("model", model, FilterModel)
    T = len(path.dt)
    kept = kept_rows(keep, T)
    active = np.stack([each.active(T) for each in model.sensors], axis=1)
    P, after, before = model.start, [], []
    for rows in chunks(T):
        steps = steps_of(path, model, active, rows)
        found = covariances(steps, P)
        some = kept[(kept >= rows.start) & (kept < rows.stop)] - rows.start
        after.append(found[1:][some])
        before.append(predicted(steps, found[:-1], some))
        P = found[-1]
    return FilterBound(
        kept=kept, covariance=np.concatenate(after), before=np.concatenate(before)
    )


def covariances(steps: Steps, start: Float[Array, "6 6"]) -> Float[Array, "n 6 6"]:
    """Covariance before the first row, and after each."""
    rows = steps.F, steps.Q, steps.informations.sum(axis=1)
    (P,) = scan(rows, (start,), carry_riccati, apply_riccati)
    return np.concatenate([start[None], P])


def predicted(
    steps: Steps, P: Float[Array, "T 6 6"], some: Places
) -> Float[Array, "k 6 6"]:
    """Covariance at some rows, before their measurements."""
    F = steps.F[some]
    return F @ P[some] @ F.mT + steps.Q[some]


def chunks(T: int) -> list[slice]:
    """Slices of rows that are processed together."""
    return [slice(a, min(a + TOGETHER, T)) for a in range(0, T, TOGETHER)]


def kept_rows(keep: Any, T: int) -> Places:
    """Rows to keep: the last of every so many.

    Raises
    ------
    InputError
        If a row is not one of the T, or they do not increase.
    """
    if not isinstance(keep, list | tuple | range | np.ndarray):
        every = whole_number("keep", keep, 1, T)
        return np.arange(every - 1, T, every)
    try:
        kept = np.asarray(keep)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        kept = np.array([])
    whole = kept.ndim == 1 and kept.size > 0 and kept.dtype.kind in "iu"
    if not (whole and kept[0] >= 0 and kept[-1] < T and np.all(np.diff(kept) > 0)):
        msg = (
            f"`keep` is not a list of rows: give indices from 0 to {T - 1} that "
            "increase, or a number, every so many rows"
        )
        raise InputError(msg)
    return kept.astype(np.intp)
