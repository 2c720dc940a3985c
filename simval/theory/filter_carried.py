r"""Errors carried from row to row by gains that are told something else.

The filter's gains are those of the model it is told, P by eq. (F2), and the errors are
those of the true one. With :math:`U_i = P H_i^T R_i^{-1}` of the told noise and
:math:`M = I - \sum_i U_i H_i`, each source goes on by eq. (F5):

.. math:: A = M F, \quad N = M Q M^T,\ U_i R_i U_i^T \text{ (true noise)}, \quad
   D = M G B_\omega,\ -U_i B_i,  \tag{F7}

:math:`G = [L; 0]` and B the errors of eq. (F6), so that constant errors c leave the
mean S c and the covariance :math:`S \Sigma_c S^T`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, physical_array
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_errors import (
    GYROSCOPE,
    CalibrationError,
    Error,
    by_parameters,
    channel,
)
from simval.theory.filter_model import FilterModel, FilterPath, Steps, steps_of
from simval.theory.filter_scan import apply_linear, carry_linear, scan
from simval.theory.filtering import covariances, predicted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Before a row: what the filter states, covariances by source, columns."""

    P: Float[Array, "6 6"]
    X: Float[Array, "s 6 6"]
    S: Float[Array, "6 p"]  # the last column is the known error of the start

    @classmethod
    def first(
        cls,
        told: FilterModel,
        truth: FilterModel,
        errors: tuple[Error, ...],
        start_error: Any,
    ) -> "State":
        """Before the first row."""
        X = np.zeros((3 + len(truth.sensors), 6, 6))
        X[0] = truth.start
        S = np.zeros((6, sum(each.parameters for each in errors) + 1))
        if start_error is not None:
            given = physical_array("start_error", start_error, (6,))
            if given.shape != (6,):
                msg = f"`start_error` has shape {given.shape}; one start needs (6,)"
                raise InputError(msg)
            S[:, -1] = given
        return cls(P=told.start, X=X, S=S)


Answer = tuple[Array, Array, Array, Array, Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """Some rows, for the true model and for the told one."""

    truth: Steps
    told: Steps
    errors: tuple[Error, ...]
    names: tuple[str, ...]  # of the sensors
    B: list[Array]  # eq. (F6), (t, 3, p), by error, 0 where a sensor has no row

    @classmethod
    def of(
        cls, path: FilterPath, truth: FilterModel, told: FilterModel,
        active: NDArray[np.bool_], rows: slice, errors: tuple[Error, ...],
    ) -> "Part":  # fmt: skip
        """Linearise some rows of a path."""
        steps = steps_of(path, truth, active, rows)
        names, B = tuple(each.name for each in truth.sensors), []
        for each in errors:
            if channel(each) == GYROSCOPE:
                B.append(by_parameters(each, steps.rate, rows))
            else:
                s = names.index(each.of)
                some = steps.active[:, s, None, None]
                B.append(by_parameters(each, steps.v[:, s], rows) * some)
        other = steps if told is truth else steps_of(path, told, active, rows)
        return cls(truth=steps, told=other, errors=errors, names=names, B=B)

    def run(self, state: State, some: NDArray[np.intp]) -> tuple[State, Answer]:
        """State after the last row, and the answer at some rows."""
        P = covariances(self.told, state.P)
        maps = self._maps(P[1:])
        X, S = scan(maps, (state.X, state.S), carry_linear, apply_linear)
        last = State(P=P[-1], X=X[-1], S=S[-1])
        X = np.concatenate([state.X[None], X])
        S = np.concatenate([state.S[None], S])
        nis, size = self._innovations(P, X, S, some)
        return last, (P[1:][some], X[1:][some], S[1:][some], nis, size)

    def _gains(self, P: Float[Array, "t 6 6"]) -> Float[Array, "t s 6 3"]:
        weighted = self.told.H.swapaxes(-1, -2) * self.told.weight[:, None, :]
        return P[:, None, :, :3] @ weighted

    def _maps(self, P: Float[Array, "t 6 6"]) -> tuple[Array, Array, Array]:
        """A, N by source and D by column, eq. (F7), from the told P after each row."""
        truth, U = self.truth, self._gains(P)
        M = np.tile(np.eye(6), (len(P), 1, 1))
        M[:, :, :3] -= P[:, :, :3] @ self.told.informations.sum(axis=1)
        Mt = M.swapaxes(-1, -2)
        noise = (U / truth.weight[:, None, :]) @ U.swapaxes(-1, -2)
        N = np.concatenate(
            [np.zeros_like(M)[:, None], (M @ truth.white @ Mt)[:, None],
             (M @ truth.walk @ Mt)[:, None], noise], axis=1,
        )  # fmt: skip
        turned = M[:, :, :3] @ truth.L
        D = [
            turned @ B if channel(each) == GYROSCOPE
            else -U[:, self.names.index(each.of)] @ B
            for each, B in zip(self.errors, self.B, strict=True)
        ]  # fmt: skip
        return M @ truth.F, N, np.concatenate([*D, np.zeros((len(P), 6, 1))], axis=-1)

    def _innovations(
        self,
        P: Float[Array, "n 6 6"],
        X: Float[Array, "n s 6 6"],
        S: Float[Array, "n 6 p"],
        some: NDArray[np.intp],
    ) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
        """Expected NIS of some rows, eq. (F8), and their number of readings."""
        k, s = len(some), len(self.names)
        H = self.truth.H[some].reshape(k, 3 * s, 3)
        Ht = H.swapaxes(-1, -2)
        active = np.repeat(self.truth.active[some], 3, axis=1)
        stated = H @ predicted(self.told, P, some)[:, :3, :3] @ Ht
        stated += _diagonal(np.tile(1.0 / self.told.weight.ravel(), (k, 1)))
        seen = H @ predicted(self.truth, X.sum(axis=1), some)[:, :3, :3] @ Ht
        seen += _diagonal(active / self.truth.weight.ravel())
        columns = H @ self._before(S, some)
        start = 0
        for each, B in zip(self.errors, self.B, strict=True):
            place = slice(start, start + each.parameters)
            if channel(each) != GYROSCOPE:
                own = 3 * self.names.index(each.of)
                columns[:, own : own + 3, place] += B[some]
            start += each.parameters
        _, parts, mean = spread(columns, self.errors)
        seen += parts.sum(axis=0) + mean[:, :, None] * mean[:, None, :]
        nis = np.trace(np.linalg.solve(stated, seen), axis1=1, axis2=2)
        return nis, active.sum(axis=1).astype(float)

    def _before(
        self, S: Float[Array, "n 6 p"], some: NDArray[np.intp]
    ) -> Float[Array, "k 3 p"]:
        # columns of the attitude after the step, before the measurements
        D = [
            self.truth.L[some] @ B[some] * (channel(each) == GYROSCOPE)
            for each, B in zip(self.errors, self.B, strict=True)
        ]
        added = np.concatenate([*D, np.zeros((len(some), 3, 1))], axis=-1)
        return self.truth.F[some][:, :3] @ S[some] + added


def spread(
    S: Float[Array, "k m p"], errors: tuple[Error, ...]
) -> tuple[list[str], Float[Array, "c k m m"], Float[Array, "k m"]]:
    """Names and covariances of uncertain calibrations, and the mean of the known."""
    names, parts, start = [], [], 0
    mean = S[..., -1].copy()
    for each in errors:
        own = S[..., start : start + each.parameters]
        start += each.parameters
        if not isinstance(each, CalibrationError):
            mean += own[..., 0]
            continue
        if each.value is not None:
            mean += own @ each.value
        if each.covariance is not None:
            names.append(each.name)
            parts.append(own @ each.covariance @ own.swapaxes(-1, -2))
    shape = (0, *S.shape[:-1], S.shape[-2])
    return names, np.stack(parts) if parts else np.zeros(shape), mean


def _diagonal(values: Float[Array, "k m"]) -> Float[Array, "k m m"]:
    return values[:, :, None] * np.eye(values.shape[1])
