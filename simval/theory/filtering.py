r"""Bound on attitude filters: the recursion of the error's covariance along the truth.

No estimate from the readings up to a row has a smaller covariance of the attitude's
error and of the gyroscope bias than the inverse of the Bayesian information, which the
Riccati recursion gives for a linear problem. Along the true path, eq. (F1), it is

.. math:: P^- = F P F^T + Q, \qquad P = (P^{-1}_- + \textstyle\sum_i \Omega_i)^{-1},
   \tag{F2}

and that is the posterior Cramer-Rao bound up to second order of the error: what the
first order leaves out is the error's square over the standard deviation, which a start
that is known to 0.05 rad beside sensors of 0.002 rad forgets in ten rows.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arguments import instance, whole_number
from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_model import FilterModel, FilterPath, Steps, steps_of
from simval.theory.filter_scan import apply_riccati, carry_riccati, scan

TOGETHER: Final = 1 << 14
"""Rows at once: 50 MB, and blocks of 128 rows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterBound:
    """Least covariance of a filter's error at some rows.

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

    kept: NDArray[np.intp]
    covariance: Float[Array, "k 6 6"]
    before: Float[Array, "k 6 6"]

    def __post_init__(self) -> None:
        for name in ("covariance", "before"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def attitude_sd(self) -> Float[Array, " k"]:
        """Root of the mean over the axes of the attitude's variance, rad, (k,)."""
        return np.sqrt(np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2) / 3.0)

    @property
    def bias_sd(self) -> Float[Array, " k"]:
        """The same of the bias, rad/s, (k,)."""
        return np.sqrt(np.trace(self.covariance[:, 3:, 3:], axis1=1, axis2=2) / 3.0)


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
    """Covariance before the first of some rows, and after each."""
    rows = steps.F, steps.Q, steps.informations.sum(axis=1)
    (P,) = scan(rows, (start,), carry_riccati, apply_riccati)
    return np.concatenate([start[None], P])


def predicted(
    steps: Steps, P: Float[Array, "T 6 6"], some: NDArray[np.intp]
) -> Float[Array, "k 6 6"]:
    """Covariance after the step of some rows, before their measurements."""
    F = steps.F[some]
    return F @ P[some] @ F.swapaxes(-1, -2) + steps.Q[some]


def chunks(T: int) -> list[slice]:
    """Rows that are worked on together."""
    return [slice(a, min(a + TOGETHER, T)) for a in range(0, T, TOGETHER)]


def kept_rows(keep: Any, T: int) -> NDArray[np.intp]:
    """Rows to keep, of every so many the last.

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
            f"`keep` is no list of rows: give indices from 0 to {T - 1} that increase, "
            "or a number, every so many rows"
        )
        raise InputError(msg)
    return kept.astype(np.intp)
