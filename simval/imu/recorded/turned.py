r"""A magnetometer turned by hand, with neither rests nor an accelerometer.

In a field of constant strength F all rows lie on the ellipsoid :math:`|M (y - b)| = F`,
in motion as at rest. The noise of rows adds to their moments, and is taken out of them
(`adjusted` of `simval.imu.calibrate.residuals`): its size is that of the residuals'
differences from row to row, of which what varies slowly is no part.

Rows of a sensor that turns slowly do not err independently: the field differs from
place to place, and a hand's pace is seconds. Error bars leave out a twelfth of the log
by turns, eq. (R2) of `errors`, each with as much of the information. What errs together
for a quarter of a twelfth or less costs them nothing (`test_recorded_turned.py`); for
longer they are too small, which is said where the residuals show it.

A turn of all three axes leaves M's ellipsoid as it is, so how the axes stand to those
of an accelerometer is not known, nor whether they are right-handed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from simval.account import Account, Fact, Reply, Told
from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.files import to_json
from simval.imu.calibrate.values import (
    how_good,
    matrix_note,
    status,
)
from simval.imu.logs import Log
from simval.imu.multiposition.description import log_object
from simval.imu.recorded.errors import block_of, jackknife
from simval.imu.sensor import forms
from simval.imu.sensor.readable import accelerometer_values
from simval.shapes import Float
from simval.spelling import counted
from simval.vocabulary import Model

BLOCKS: Final = 12
"""Student's t with one less is 12 % wider than the normal; see the module."""
FEWEST: Final = 20 * BLOCKS  # rows, so that a twelfth is no pose
ALIKE: Final = 0.5
"""Correlation of the mean residuals of neighbouring halves of twelfths: independent
ones exceed it in less than 1 % of logs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnedCalibration(Told):
    """Calibration of a magnetometer from rows in motion."""

    fit: FitResult
    rows: int  # that are not those before them again
    seconds: float  # of the shortest block
    white: float  # sd of a row's noise along the field, over the field
    alike: bool  # whether neighbouring blocks err together
    left_out: tuple[str, ...]

    @property
    def account(self) -> Account:
        """Everything that there is to say of the calibration."""
        fit, holds = self.fit, not self.alike
        rms = float(fit.rms) / fit.g
        told = "they are by how the parts of the log differ"
        if self.alike:
            told = "neighbouring parts of the log err together, so they are too small"
        return Account(
            title="Calibration from",
            source="a log",
            said=f"{counted(self.rows, 'row')} of the magnetometer alone, in motion",
            replies=(
                how_good(fit, force=False),
                Reply(
                    title="Can the error bars be trusted?",
                    headline=f"{'Yes' if holds else 'Cannot tell'}: {told}.",
                    answer="pass" if holds else "inconclusive",
                    do="" if holds else "Turn it for longer.",
                    lines=(
                        f"{BLOCKS} parts were left out by turns, each "
                        f"{self.seconds:.3g} s or longer; rows that err together for "
                        "more than a quarter of that make them too small.",
                        f"Residual {rms:.3g} of the field (RMS), {self.white:.3g} of "
                        "it from row to row.",
                    ),
                ),
            ),
            values=(accelerometer_values(fit, force=False),),
            notes=(matrix_note(fit, force=False),),
            facts=(
                *(Fact("left out", each, notable=True) for each in self.left_out),
                Fact(
                    "assumed",
                    f"a field of {fit.g:g} at all times; where it differs from place "
                    "to place, that is taken for the sensor's",
                    notable=True,
                ),
                Fact(
                    "not known",
                    "how its axes stand to an accelerometer's: one turn of all three, "
                    "and whether they are right-handed",
                    notable=True,
                ),
                status(fit),
            ),
        )

    def as_object(self, log: Log) -> dict[str, Any]:
        """Return it as one JSON object."""
        said = {
            "sensor": "magnetometer", "rows": self.rows, "blocks": BLOCKS,
            "block_s": self.seconds, "white": self.white, "alike": self.alike,
            "left_out": list(self.left_out),
        }  # fmt: skip
        return to_json(self.fit) | log_object(log) | said


def calibrate_turned(
    log: Log, fitted: Callable[..., FitResult], *, field: float
) -> TurnedCalibration:
    """Calibrate the magnetometer of a log without an accelerometer.

    Parameters
    ----------
    log : Log
        The log.
    fitted : callable
        As `simval.imu.calibrate.calibrate`, with its options but the residual's.
    field : float
        Strength of the field, in the unit that M is wanted in.

    Returns
    -------
    TurnedCalibration
        The calibration, with Type A error bars of `BLOCKS` - 1 degrees of freedom.

    Raises
    ------
    InputError
        If it has hardly any rows.
    RefusedError
        If its rows fix no ellipsoid, or a part of them alone does.
    """
    assert log.magnetometer is not None  # no other is read alone to be calibrated
    new = np.append(True, np.any(np.diff(log.magnetometer, axis=0) != 0.0, axis=1))
    y, time = log.magnetometer[new], log.time[new]
    if len(y) < FEWEST:
        msg = (
            f"{log.path} has {len(y)} readings of a magnetometer alone, and error bars "
            f"of rows in motion need {FEWEST} or more; record longer, or if each row "
            "is the mean of a pose, state so (--means)"
        )
        raise InputError(msg)
    rough = fitted(y[None], field, repeats=True)  # of a batch, which raises nothing
    if not rough.converged[0]:
        msg = (
            f"{log.path} has {len(y)} readings of a magnetometer alone, which "
            f"do not determine a calibration ({rough.status[0]}): turn it to "
            "all sides"
        )
        raise RefusedError(msg)
    error = _residuals(rough.model, rough.parameters[0], y, field)[0]
    white = float(np.sqrt(np.mean(np.diff(error) ** 2) / 2.0))
    raw = white / float(np.cbrt(abs(np.linalg.det(rough.matrix[0]))))
    fit = fitted(y, field, repeats=True, residual="adjusted", noise_std=raw)
    fit.require_converged()
    error, J = _residuals(fit.model, fit.parameters, y, field)
    factor = np.linalg.qr(J)[0]
    share = np.vecdot(factor, factor)  # of each row of the information
    block, count = block_of(share, BLOCKS)
    try:
        covariance = jackknife(J[:, None], J[:, None], error[:, None], block)
    except np.linalg.LinAlgError:
        msg = (
            f"{log.path} has {len(y)} readings of a magnetometer alone, and "
            f"they do not determine a calibration if a {BLOCKS}th of them is "
            "left out: turn it to all sides more than once"
        )
        raise RefusedError(msg) from None
    half = block_of(share, 2 * BLOCKS)[0]
    mean = np.bincount(half, error) / np.bincount(half)
    ends = np.flatnonzero(np.diff(block, prepend=-1, append=count))
    kind: Any = "type A"
    none: Any = np.float64(np.nan)
    return TurnedCalibration(
        fit=replace(
            fit, covariance=covariance, covariance_kind=kind, dof=count - 1,
            chi2_per_dof=none,
        ),
        rows=len(y),
        seconds=float(np.min(time[ends[1:] - 1] - time[ends[:-1]])),
        white=white / field,
        alike=bool(mean[1:] @ mean[:-1] > ALIKE * (mean @ mean)),
        left_out=()
        if log.gyro is None
        else ("the gyroscope: without an accelerometer its axes are not known",),
    )  # fmt: skip


def _residuals(
    model: Model, parameters: Float[Array, "9"], y: Float[Array, "n 3"], field: float
) -> tuple[Float[Array, " n"], Float[Array, "n 9"]]:
    # |M (y - b)| - F of each row, and its derivatives by the parameters
    M, away = forms.matrix(model, parameters), y - parameters[6:]
    seen = away @ M.T
    length = np.linalg.norm(seen, axis=1)
    unit = seen / length[:, None]
    slopes = forms.matrix_derivatives(model, parameters)
    by_matrix = np.einsum("ni,kij,nj->nk", unit, slopes, away)
    return length - field, np.concatenate([by_matrix, -unit @ M], axis=1)
