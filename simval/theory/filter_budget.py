r"""What a filter's error really is, source by source, where it is told otherwise.

The filter's gains are those of the model that it is told, and its errors are those of
the true one (`simval.theory.filter_carried`, F7). With the second moment
:math:`\Sigma` of the error and Z that of the innovation,

.. math:: E\,\mathrm{NEES} = \mathrm{tr}(P^{-1} \Sigma), \qquad
   E\,\mathrm{NIS} = \mathrm{tr}\bigl((H P^- H^T + R)^{-1} Z\bigr).  \tag{F8}
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import choice, instance
from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_carried import Part, State, spread
from simval.theory.filter_errors import Error, check_errors
from simval.theory.filter_model import FilterModel, FilterPath
from simval.theory.filtering import chunks, kept_rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterPrediction:
    """Error of a filter at some rows, after their measurements.

    Attributes
    ----------
    kept : Array
        The rows, (k,).
    names : tuple of str
        Sources of error: start, white noise and walk of the gyroscope, noise of each
        sensor, then each uncertain calibration.
    parts : Array
        Covariance by source, rotation vector, body side, rad, then bias, rad/s,
        (s, k, 6, 6).
    mean : Array
        Mean error, of the known errors, (k, 6).
    told : Array
        Covariance that the filter states, (k, 6, 6).
    nis : Array
        Expected square of the normalised innovation, (k,).
    nis_size : Array
        What it is for a filter that is told the truth: readings of the row, (k,).
    """

    kept: NDArray[np.intp]
    names: tuple[str, ...]
    parts: Float[Array, "s k 6 6"]
    mean: Float[Array, "k 6"]
    told: Float[Array, "k 6 6"]
    nis: Float[Array, " k"]
    nis_size: Float[Array, " k"]

    def __post_init__(self) -> None:
        for name in ("parts", "mean", "told", "nis", "nis_size"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def second_moment(self) -> Float[Array, "k 6 6"]:
        """Covariance of all sources and the square of the mean, (k, 6, 6)."""
        return self.parts.sum(axis=0) + self.mean[:, :, None] * self.mean[:, None, :]

    def nees(self, size: int = 6) -> Float[Array, " k"]:
        """Expected square of the normalised error, eq. (F8).

        Parameters
        ----------
        size : {3, 6}
            Of the attitude, or with the bias.

        Returns
        -------
        Array
            (k,); `size` for a filter that is told the truth.
        """
        d = choice("size", size, (3, 6))
        P, moment = self.told[:, :d, :d], self.second_moment[:, :d, :d]
        return np.trace(np.linalg.solve(P, moment), axis1=1, axis2=2)

    def rms(self) -> Float[Array, " k"]:
        """Root of the mean square of the attitude's error per axis.

        Returns
        -------
        Array
            rad, (k,).
        """
        return np.sqrt(np.trace(self.second_moment[:, :3, :3], axis1=1, axis2=2) / 3.0)


def filter_prediction(
    path: FilterPath,
    truth: FilterModel,
    *,
    told: FilterModel | None = None,
    errors: Sequence[Error] = (),
    start_error: Any = None,
    keep: Any = 1,
) -> FilterPrediction:
    """Predict a filter's error, NEES and NIS, to first order of the error.

    Parameters
    ----------
    path : FilterPath
        The true motion.
    truth : FilterModel
        The true noise, sensors and start.
    told : FilterModel, optional
        What the filter is told; the truth if not given. Its sensors have the same
        names and references; the rows that it uses are its own.
    errors : sequence of CalibrationError and RowError
        What the readings are off by and the filter does not know.
    start_error : array_like, optional
        Known error of the start, rotation vector and bias, (6,).
    keep : int or array_like, default 1
        Rows to give: every so many, as of a sensor, or their indices, increasing.

    Returns
    -------
    FilterPrediction
        The error by source, NEES and NIS.

    Raises
    ------
    InputError
        If an argument is not usable, or the two models have different sensors.
    """
    instance("path", path, FilterPath)
    instance("truth", truth, FilterModel)
    told = truth if told is None else _told(told, truth)
    T = len(path.dt)
    names = tuple(each.name for each in truth.sensors)
    errors = check_errors(errors, names, T)
    kept = kept_rows(keep, T)
    active = np.stack([each.active(T) for each in told.sensors], axis=1)
    state = State.first(told, truth, errors, start_error)
    found = []
    for rows in chunks(T):
        part = Part.of(path, truth, told, active, rows, errors)
        some = kept[(kept >= rows.start) & (kept < rows.stop)] - rows.start
        state, answer = part.run(state, some)
        found.append(answer)
    P, X, S, nis, size = (np.concatenate(each) for each in zip(*found, strict=True))
    uncertain, parts, mean = spread(S, errors)
    return FilterPrediction(
        kept=kept,
        names=("start", "gyroscope white noise", "gyroscope walk",
               *(f"{name} noise" for name in names), *uncertain),
        parts=np.concatenate([X.swapaxes(0, 1), parts]),
        mean=mean, told=P, nis=nis, nis_size=size,
    )  # fmt: skip


def _told(told: FilterModel, truth: FilterModel) -> FilterModel:
    instance("told", told, FilterModel)
    ours, theirs = ([(s.name, *s.reference) for s in m.sensors] for m in (told, truth))
    if ours != theirs:
        msg = (
            f"`told` has the sensors {[each[0] for each in ours]} and `truth` "
            f"{[each[0] for each in theirs]}; names and references must be the same"
        )
        raise InputError(msg)
    return told
