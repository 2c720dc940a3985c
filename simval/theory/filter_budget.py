r"""Error budget of a filter, source by source, even with wrong settings.

The filter's gains are those of the model it is told, P by eq. (F2), and the errors are
those of the true one. With :math:`U_i = P H_i^T R_i^{-1}` of the told noise and
:math:`M = I - \sum_i U_i H_i`, each source goes on by eq. (F5):

.. math:: A = M F, \quad N = M Q M^T,\ U_i R_i U_i^T \text{ (true noise)}, \quad
   D = M G B_\omega,\ -U_i B_i,  \tag{F7}

:math:`G = [L; 0]` and B the errors of eq. (F6), so that constant errors c leave the
mean S c and the covariance :math:`S \Sigma_c S^T`.

With the second moment
:math:`\Sigma` of the error and Z that of the innovation,

.. math:: E\,\mathrm{NEES} = \mathrm{tr}(P^{-1} \Sigma), \qquad
   E\,\mathrm{NIS} = \mathrm{tr}\bigl((H P^- H^T + R)^{-1} Z\bigr).  \tag{F8}

**A start that is far off.** The recursion is of first order of the error. An extended
filter whose start is off by the rotation :math:`\delta`, 17 degrees say, takes its
first measurement with H at the wrong attitude :math:`\hat A = e^{[\delta\times]} A`.
The correction is :math:`d = K z`, :math:`z = A r - \hat A r`, and it leaves exactly

.. math:: e^{-[e\times]} = e^{-[\delta\times]} e^{[d\times]}, \qquad
   P = P^- - K H P^-,  \tag{F12}

an error of second order beside a covariance that knows nothing of it, and that is along
wrong axes. Noise n of the readings moves d by K n and e by :math:`-J_e^{-1}
J(-d) K n`, with the left Jacobians at e and at -d. From there on the first order holds
again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, Mask, Places, ReadOnly, outer, physical_array
from simval.errors import InputError
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross_matrix,
    from_rotation_vector,
    rotation_vector,
)
from simval.moments import deviations
from simval.shapes import Float
from simval.theory.filter_model import (
    GYROSCOPE,
    CalibrationError,
    Error,
    FilterModel,
    FilterPath,
    Steps,
    by_parameters,
    channel,
    check_errors,
    left_jacobian,
    steps_of,
)
from simval.theory.filter_recursion import (
    apply_linear,
    carry_linear,
    chunks,
    covariances,
    kept_rows,
    predicted,
    scan,
)


class State(NamedTuple):
    """State before a row: what the filter states, and its real error by source."""

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
        """State before the first row."""
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


Answer = tuple[Array, Array, Array, Array, Array, Array]


class Part(NamedTuple):
    """A range of rows, linearised for the true and the assumed model."""

    truth: Steps
    told: Steps
    errors: tuple[Error, ...]
    names: tuple[str, ...]  # of the sensors
    B: list[Array]  # eq. (F6), (t, 3, p), by error, 0 where a sensor has no row

    @classmethod
    def of(
        cls, path: FilterPath, truth: FilterModel, told: FilterModel,
        active: Mask, rows: slice, errors: tuple[Error, ...],
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

    def run(self, state: State, some: Places) -> tuple[State, Answer]:
        """State after the last row, and results at some rows."""
        P = covariances(self.told, state.P)
        X, S = scan(self._maps(P[1:]), (state.X, state.S), carry_linear, apply_linear)
        last = State(P=P[-1], X=X[-1], S=S[-1])
        X = np.concatenate([state.X[None], X])
        S = np.concatenate([state.S[None], S])
        before, nis, size = self._innovations(P, X, S, some)
        return last, (P[1:][some], X[1:][some], S[1:][some], before, nis, size)

    def _gains(self, P: Float[Array, "t 6 6"]) -> Float[Array, "t s 6 3"]:
        weighted = self.told.H.mT * self.told.weight[:, None, :]
        return P[:, None, :, :3] @ weighted

    def _maps(self, P: Float[Array, "t 6 6"]) -> tuple[Array, Array, Array]:
        """A, N by source and D by column, eq. (F7), given the assumed P."""
        truth, U = self.truth, self._gains(P)
        M = np.tile(np.eye(6), (len(P), 1, 1))
        M[:, :, :3] -= P[:, :, :3] @ self.told.informations.sum(axis=1)
        Mt = M.mT
        noise = (U / truth.weight[:, None, :]) @ U.mT
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
        some: Places,
    ) -> tuple[Float[Array, "k 3 3"], Float[Array, " k"], Float[Array, " k"]]:
        """For some rows: second moment before the update, NIS and its size."""
        k, s = len(some), len(self.names)
        H = self.truth.H[some].reshape(k, 3 * s, 3)
        Ht = H.mT
        active = np.repeat(self.truth.active[some], 3, axis=1)
        stated = H @ predicted(self.told, P, some)[:, :3, :3] @ Ht
        stated += _diagonal(np.tile(1.0 / self.told.weight.ravel(), (k, 1)))
        before = predicted(self.truth, X.sum(axis=1), some)[:, :3, :3]
        seen = H @ before @ Ht + _diagonal(active / self.truth.weight.ravel())
        turned = self._before(S, some)
        columns, start = H @ turned, 0
        for each, B in zip(self.errors, self.B, strict=True):
            place = slice(start, start + each.parameters)
            if channel(each) != GYROSCOPE:
                own = 3 * self.names.index(each.of)
                columns[:, own : own + 3, place] += B[some]
            start += each.parameters
        seen += _of_columns(columns, self.errors)
        nis = np.linalg.trace(np.linalg.solve(stated, seen))
        moment = before + _of_columns(turned, self.errors)
        return moment, nis, active.sum(axis=1).astype(float)

    def _before(self, S: Float[Array, "n 6 p"], some: Places) -> Float[Array, "k 3 p"]:
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
    """Names and covariances of uncertain calibrations, and the known mean."""
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
            parts.append(own @ each.covariance @ own.mT)
    shape = (0, *S.shape[:-1], S.shape[-2])
    return names, np.stack(parts) if parts else np.zeros(shape), mean


def _of_columns(
    S: Float[Array, "k m p"], errors: tuple[Error, ...]
) -> Float[Array, "k m m"]:
    """Second moment that errors of the readings cause."""
    _, parts, mean = spread(S, errors)
    return parts.sum(axis=0) + outer(mean, mean)


def _diagonal(values: Float[Array, "k m"]) -> Float[Array, "k m m"]:
    return values[:, :, None] * np.eye(values.shape[1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterPrediction(ReadOnly):
    """Predicted error of a filter at some rows.

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
    before : Array
        Second moment of the attitude's error before the row's measurements, rad^2,
        (k, 3, 3).
    nis : Array
        Expected square of the normalised innovation, (k,).
    nis_size : Array
        What it is for a filter that is told the truth: readings of the row, (k,).
    """

    kept: Places
    names: tuple[str, ...]
    parts: Float[Array, "s k 6 6"]
    mean: Float[Array, "k 6"]
    told: Float[Array, "k 6 6"]
    before: Float[Array, "k 3 3"]
    nis: Float[Array, " k"]
    nis_size: Float[Array, " k"]

    @property
    def second_moment(self) -> Float[Array, "k 6 6"]:
        """Covariance by all sources plus the square of the mean, (k, 6, 6)."""
        return self.parts.sum(axis=0) + outer(self.mean, self.mean)

    def nees(self, size: int = 6) -> Float[Array, " k"]:
        """Expected normalised squared error, eq. (F8).

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
        return np.linalg.trace(np.linalg.solve(P, moment))

    def rms(self) -> Float[Array, " k"]:
        """RMS attitude error per axis.

        Returns
        -------
        Array
            rad, (k,).
        """
        return np.sqrt(np.linalg.trace(self.second_moment[:, :3, :3]) / 3.0)

    @property
    def second_order(self) -> Float[Array, " k"]:
        """Ratio of the second order to the stated deviation, eq. (F15).

        Returns
        -------
        Array
            (k,).
        """
        P = self.told
        b = deviations(P[:, 3:, 3:])
        cross = P[:, :3, 3:] / b[:, None]
        C = P[:, 3:, 3:] / outer(b, b)
        inside = P[:, :3, :3] - cross @ np.linalg.solve(C, cross.mT)
        trace = np.linalg.trace(P[:, :3, :3])
        # of what rounding takes from a difference nothing is known
        least = np.maximum(
            np.linalg.eigvalsh(inside)[:, 0], np.finfo(float).eps * trace
        )
        half = np.linalg.trace(self.before) / 2.0
        return half / np.sqrt(least)


def filter_prediction(
    path: FilterPath,
    truth: FilterModel,
    *,
    told: FilterModel | None = None,
    errors: Sequence[Error] = (),
    start_error: Any = None,
    keep: Any = 1,
) -> FilterPrediction:
    """Predict a filter's error, NEES and NIS, to first order.

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
    P, X, S, before, nis, size = (
        np.concatenate(each) for each in zip(*found, strict=True)
    )
    uncertain, parts, mean = spread(S, errors)
    return FilterPrediction(
        kept=kept,
        names=("start", "gyroscope white noise", "gyroscope walk",
               *(f"{name} noise" for name in names), *uncertain),
        parts=np.concatenate([X.swapaxes(0, 1), parts]),
        mean=mean, told=P, before=before, nis=nis, nis_size=size,
    )  # fmt: skip


def _told(told: FilterModel, truth: FilterModel) -> FilterModel:
    instance("told", told, FilterModel)
    ours, theirs = ([(s.name, *s.reference) for s in m.sensors] for m in (told, truth))
    if ours != theirs:
        msg = (
            f"`told` has the sensors {[each[0] for each in ours]} but `truth` "
            f"has {[each[0] for each in theirs]}; names and references must be "
            "the same"
        )
        raise InputError(msg)
    return told


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirstUpdate(ReadOnly):
    """A filter after its first row, from which `filter_prediction` can start.

    Attributes
    ----------
    path : FilterPath
        The path from the second row on.
    truth, told : FilterModel
        The models of these rows, whose start is after the first one: the covariance of
        the noise so far, and what the filter states.
    error : Array
        What is left of the start, rotation vector, rad, and bias, rad/s, (6,).
    """

    path: FilterPath
    truth: FilterModel
    told: FilterModel
    error: Float[Array, "6"]


def first_update(
    path: FilterPath, truth: FilterModel, turn: Any, *, told: FilterModel | None = None
) -> FirstUpdate:
    """First-order update from a start with a known error, eq. (F12).

    Parameters
    ----------
    path : FilterPath
        The true motion, two steps or more.
    truth : FilterModel
        The true noise and sensors; of the start, what is uncertain besides the turn.
    turn : array_like
        Truth against the start that is told, rotation vector, body side, rad, (3,).
    told : FilterModel, optional
        What the filter is told; the truth if not given.

    Returns
    -------
    FirstUpdate
        The filter after its first row.

    Raises
    ------
    InputError
        If the turn is no vector, or nothing is left of the path.
    """
    instance("path", path, FilterPath)
    instance("truth", truth, FilterModel)
    told = instance("told", truth if told is None else told, FilterModel)
    delta = physical_array("turn", turn, (3,))
    T = len(path.dt)
    if delta.shape != (3,) or T < 2:
        msg = (
            f"`turn` has shape {delta.shape} and the path {T} steps; give one rotation "
            "vector, (3,), and two steps or more"
        )
        raise InputError(msg)
    active = np.stack([each.active(T) for each in told.sensors], axis=1)
    true, ours = (steps_of(path, m, active, slice(0, 1)) for m in (truth, told))
    error, P, spread = _updated(true, ours, delta, truth, told)
    return FirstUpdate(
        path=FilterPath(dt=path.dt[1:], attitude=path.attitude[1:]),
        truth=_later(truth, active, spread),
        told=_later(told, active, P),
        error=error,
    )


def _updated(
    true: Steps,
    ours: Steps,
    delta: Float[Array, "3"],
    truth: FilterModel,
    told: FilterModel,
) -> tuple[Float[Array, "6"], Float[Array, "6 6"], Float[Array, "6 6"]]:
    # error that is left, what is stated, and the covariance of the noise so far
    F = true.F[0]
    q = from_rotation_vector(F[:3, :3] @ delta)  # at the end of the step
    some = ours.active[0, :, None, None]
    v = true.v[0] @ attitude_matrix(q)  # by rows: exp([delta x]) A r
    H = np.zeros((3 * len(v), 6))
    H[:, :3] = (cross_matrix(v) * some).reshape(-1, 3)
    z = ((true.v[0] - v) * some[..., 0]).ravel()
    before = F @ told.start @ F.T + ours.Q[0]
    R, actual = (np.diag(1.0 / each.weight.ravel()) for each in (ours, true))
    K = np.linalg.solve(H @ before @ H.T + R, H @ before).T
    d = K @ z
    left = rotation_vector(compose(conjugate(from_rotation_vector(d[:3])), q))
    # noise in d, then in the truth: derivatives of q(left) = q(d)^-1 * q
    by_d, by_truth, seen = np.eye(6), np.eye(6), np.zeros_like(H)
    by_d[:3, :3] = np.linalg.solve(left_jacobian(left), left_jacobian(-d[:3]))
    by_truth[:3, :3] = np.linalg.inv(left_jacobian(-left))
    seen[:, :3] = (true.H[0]).reshape(-1, 3)
    gain = by_d @ K
    W = by_truth - gain @ seen
    spread = W @ (F @ truth.start @ F.T + true.Q[0]) @ W.T + gain @ actual @ gain.T
    return np.concatenate([left, -d[3:]]), before - K @ H @ before, spread


def _later(model: FilterModel, active: Mask, start: Float[Array, "6 6"]) -> FilterModel:
    sensors = tuple(
        replace(each, rows=active[1:, s]) for s, each in enumerate(model.sensors)
    )
    return replace(model, sensors=sensors, start=(start + start.T) / 2.0)
