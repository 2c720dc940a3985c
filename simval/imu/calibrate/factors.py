r"""Larger noise than stated in a joint fit: which sensor is to blame for a misfit.

The rows of a joint fit are :math:`r = J\,\mathrm{d}\theta + n`. Beside the noise that
is stated, of covariance V, each source may have errors of its own,

.. math:: \mathrm{cov}\,n = V + \sum_s \nu_s U_s, \tag{B1}

:math:`U_s` that of one of variance 1: of a sensor that is read at rest more of its own
noise; of a gyroscope an angle by which each rotation is off, which a factor on a stated
noise of zero would not reach, or a matrix that changes in the course of the log; of the
hold what the body turns beside the rotations. With :math:`S(\nu)` the covariance (B1)
of what J cannot explain, y, the likelihood is
:math:`\ell = -\tfrac12(\ln\det S + y^T S^{-1} y)`, of slope and information in the
logarithms of the standard deviations :math:`\phi_s = \tfrac12\ln\nu_s`

.. math:: \ell_s = \nu_s (y^T S^{-1} U_s S^{-1} y - \mathrm{tr}\,S^{-1} U_s), \qquad
   H_{st} = 2\,\nu_s \nu_t\,\mathrm{tr}\,S^{-1} U_s S^{-1} U_t.  \tag{B2}

Nothing is asked unless chi-square of all rows, or of the directions of an error, is
beyond the stated noise by chance below `CHANCE`. Then sets of errors are held against
the stated noise by their marginal likelihoods (Laplace's method), each :math:`\phi`
anywhere between `LEAST` and `MOST` times what doubles the variance of its rows, each
error at odds of `MORE` beforehand. By Markov's bound the weighted mean of these ratios
exceeds R by chance in at most 1/R of sound logs: odds and rule of naming are those of
`simval.imu.explain.judgement`. The variances that are used are means over the sets, so
no single rest flips the blame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.errors import RefusedError
from simval.imu.calibrate.goodness_of_fit import (
    LEAST_FREEDOM,
    Combination,
    ErrorKind,
    Left,
    Residuals,
    SensorResiduals,
    freedom,
)
from simval.imu.explain.judgement import CHANCE, LEADS, NAMED, REFUSED, REMARKED
from simval.shapes import Float
from simval.spelling import series

F = TypeVar("F")
MORE: Final = 0.2
"""Odds of each error, before the log is seen, against none."""
LEAST, MOST = 0.3, 1e4
"""Standard deviations of an error, of one that doubles the variance of its rows."""
WIDEST: Final = 10.0
"""Of the error bars of a sensor's own parameters. Beyond it the stated noise is less
than a hundredth of the variance that is seen: what governs the result is in no model,
and to the others the sensor tells less than a hundredth of what it was taken for, half
a percent of their error bars. It is left out."""
CHANGED: Final = 0.01
"""Of a matrix in the course of the log: such a calibration knows no more of the sensor
than its data sheet."""
_STILL: Final = 1e-3  # of a logarithm, between steps of its search
_MOST_STEPS: Final = 60
_ROUNDS: Final = 8  # of odds and fit; three are usual
_SAME: Final = 2e-2  # of a variance, between rounds: a hundredth of an error bar


class SourceError(NamedTuple):
    """An error that a joint fit assumes in addition to the stated noise."""

    cause: str  # sensor, or what else may be to blame
    kind: ErrorKind
    blame: float  # posterior share of the cause, by whatever error
    share: float  # of this error
    size: float  # standard deviation that was taken, in the unit of its kind
    widening: float  # by how much error bars of the cause have grown, their median

    @property
    def words(self) -> str:
        """Say which error it is, and how large."""
        if self.kind == "noise":
            times = np.hypot(1.0, self.size)
            return f"the {self.cause} scatters {times:.2g} times its noise"
        if self.kind == "matrix":
            size = 100.0 * self.size
            return (
                f"the matrix of the {self.cause} changes by {size:.2g} % over the log"
            )
        degrees = f"{np.degrees(self.size):.2g}°"
        if self.cause == "hold":
            return f"the body turns unseen by {degrees} in the holds"
        return (
            f"rotations of the {self.cause} are off by {degrees} in addition to "
            "its noise"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFactors(ReadOnly):
    """Judgement of a joint fit's residuals, sensor by sensor.

    A batch of trials is weighed by the noise that is stated: it has no sensors.
    """

    # chi-square, rests and moves of each sensor; empty where none was judged
    sensors: tuple[SensorResiduals, ...]
    errors: tuple[SourceError, ...]  # in addition to the stated noise
    # chance that noise as stated leaves as much, in all rows or in those of any error;
    # below `CHANCE` more is asked for. NaN where none was judged
    p_value: float
    odds: float  # of any error against none, natural logarithm
    least_determined: Combination | None  # what the fit determines worst

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(each.name for each in self.sensors)

    @property
    def borne(self) -> bool:
        """True if the stated noise explains the residuals."""
        return not self.p_value < CHANCE

    @property
    def blamed(self) -> tuple[str, ...]:
        """The causes of a misfit; none if they cannot be told apart."""
        if self.borne or self.odds < np.log(REMARKED):
            return ()
        causes = (each.cause for each in self.errors if each.blame >= NAMED)
        return tuple(dict.fromkeys(causes))

    @property
    def words(self) -> str:
        """Say which sensor scatters more than its noise, and how much; else empty."""
        if self.borne:
            return ""
        likely = [each for each in self.errors if each.share > 1.0 - NAMED]
        likely = [x for x in likely if x.cause in self.blamed] or likely
        likely.sort(key=lambda each: -each.share)
        said = " or ".join(each.words for each in likely)
        if self.blamed:
            return said
        names = f"{series(self.sources)} misfit beyond their noise"
        return f"{names}, and which is why is open" + (f": {said}" if said else "")

    @property
    def refusal(self) -> RefusedError | None:
        """Say why the fit is no calibration; None if it is one.

        An accelerometer's is not refused: its own fit has just such error bars.
        """
        if self.odds < np.log(REFUSED):
            return None
        for sensor in self.sensors[1:]:
            own = [each for each in self.errors if each.cause == sensor.name]
            worst = max(own, key=lambda each: each.share)
            sound = worst.widening <= WIDEST
            wider = f"for error bars {worst.widening:.3g} times as wide"
            beyond = f"{wider}, {WIDEST:g} at most"
            if worst.kind == "matrix":
                sound, beyond = worst.size <= CHANGED, f"{100.0 * CHANGED:g} % at most"
            if sensor.name in self.blamed and not sound:
                words = (
                    f"{worst.words}, {beyond}: it does not follow the model of one "
                    "calibration"
                )
                do = (
                    f"look at {sensor.item} {sensor.worst}, which is farthest off, at "
                    "a scale or a bias that changes with time, at the range and the "
                    "clock of the sensor, and at that noise"
                )
                return RefusedError(words, do, widening=worst.widening, size=worst.size)
        return None

    def as_object(self) -> dict[str, Any]:
        """Return the judgement of each sensor as plain JSON values."""
        found: dict[str, Any] = {each.name: each.as_object() for each in self.sensors}
        for each in self.errors:
            own = found.setdefault(each.cause, {})
            own |= {"share": each.blame, "widening": each.widening}
            own.setdefault("beside", {})[each.kind] = each.size
        return found


NOT_JUDGED: Final = NoiseFactors(
    sensors=(), errors=(), p_value=np.nan, odds=-np.inf, least_determined=None
)


def judged(
    found: F,
    fit: Callable[[F, dict[tuple[str, str], float]], F],
    residuals: Callable[[F], Residuals],
) -> tuple[F, NoiseFactors]:
    """Judge the residuals, and fit again with the errors that they require.

    `fit` takes a fit, and the variance of each error beside the noise, to the fit with
    those; `residuals` are the rows of a fit where it ended, as the stated noise weighs
    them. Of the last fit it is said what its residuals say.

    Raises
    ------
    RefusedError
        If no noise that is anywhere near the stated one could leave them.
    """
    left = Left(residuals(found))
    chance, odds = left.p_value(), _Odds.none(left)
    if not left.stated[:, 0].sum() <= MOST**2 * left.y.size:
        names = ", ".join(each.name for each in left.sources)
        msg = (
            f"the noises of these sensors, {names}, differ from what the residuals "
            f"show by more than {MOST:g} times, so rounding decides what these say; "
            "state a noise that each of them can have"
        )
        raise RefusedError(msg)
    for _ in range(_ROUNDS if chance < CHANCE else 0):
        odds = _Odds.of(left)
        more = left.covariance(odds.variances) - left.covariance(left.variances)
        if np.abs(np.diagonal(more)).max() < _SAME:
            break
        kinds = [(each.cause, each.kind) for each in left.rows.beside]
        found = fit(found, dict(zip(kinds, odds.variances.tolist(), strict=True)))
        left = Left(residuals(found), odds.variances)
    return found, NoiseFactors(
        sensors=left.sensors(),
        errors=_errors(left, odds),
        p_value=chance,
        odds=odds.log,
        least_determined=left.combination(),
    )


def _errors(left: Left, odds: "_Odds") -> tuple[SourceError, ...]:
    bars = [
        np.linalg.inv(left.J.T @ np.linalg.solve(S, left.J)).diagonal()
        for S in (np.eye(len(left.base)), left.base)
    ]
    wider = np.sqrt(bars[0] / bars[1])
    own = {each.name: each.parameters for each in left.sources}
    return tuple(
        SourceError(
            cause=each.cause,
            kind=each.kind,
            blame=odds.blame[each.cause],
            share=float(share),
            size=float(np.sqrt(variance) * each.size),
            widening=float(np.median(wider[own.get(each.cause, slice(None))])),
        )
        for each, share, variance in zip(
            left.rows.beside, odds.shares, left.variances, strict=True
        )
    )


class _Odds(NamedTuple):
    # of errors against the stated noise
    variances: Float[Array, " e"]  # means over the sets
    shares: Float[Array, " e"]  # posterior, that there is any
    blame: dict[str, float]  # the same of each cause
    log: float  # of any against none

    @classmethod
    def none(cls, left: Left) -> "_Odds":
        zero, causes = np.zeros(len(left.U)), [each.cause for each in left.rows.beside]
        return cls(zero, zero, dict.fromkeys(causes, 0.0), -np.inf)

    @classmethod
    def of(cls, left: Left) -> "_Odds":
        """Odds of sets of errors; the best sets so far are tried with one more."""
        zero = np.zeros(len(left.U))
        told = [s for s, each in enumerate(left.asked) if freedom(each) > LEAST_FREEDOM]
        every = {frozenset[int](): _Likely(_value(left, zero), zero)}
        lead = list(every)
        while lead:
            best = max(every[some].log for some in lead)
            new: dict[frozenset[int], _Likely] = {}
            for some in lead:
                for s in told:
                    if s not in some and (more := some | {s}) not in new:
                        new[more] = _likely(left, sorted(more), every[some].variances)
            every |= new
            lead = sorted(new, key=lambda some: -new[some].log)[:LEADS]
            lead = [some for some in lead if new[some].log > best]
        count = len(left.U)
        holds = np.array([np.isin(range(count), list(some)) for some in every])
        prior = np.log(MORE) * holds.sum(axis=1)
        log = np.array([each.log for each in every.values()])
        weight = np.exp(prior + log - scipy.special.logsumexp(prior + log))
        causes = np.array([each.cause for each in left.rows.beside])
        odds = scipy.special.logsumexp((prior + log)[1:]) - log[0]
        return cls(
            variances=weight @ np.array([each.variances for each in every.values()]),
            shares=weight @ holds,
            blame={
                str(c): float(weight @ holds[:, causes == c].any(axis=1))
                for c in causes
            },
            log=float(odds - np.log((1.0 + MORE) ** len(told) - 1.0)),
        )


class _Likely(NamedTuple):
    log: float  # marginal likelihood
    variances: Float[Array, " e"]  # the likeliest


def _value(left: Left, variances: Array) -> float:
    root = np.linalg.cholesky(left.covariance(variances))
    z = np.linalg.solve(root, left.y)
    return -np.log(root.diagonal()).sum() - 0.5 * z @ z


def _likely(left: Left, own: list[int], start: Array) -> _Likely:
    # of some errors, by Fisher's scoring with (B2)
    U = [left.U[s] for s in own]
    _, mean, variance = left.asked[own].T
    unit = 2.0 * mean / variance  # doubles the variance of the rows
    phi = 0.5 * np.log(np.where(start[own] > 0.0, start[own], unit))
    ends = 0.5 * np.log(unit) + np.log([[LEAST], [MOST]])
    at, H = np.zeros(len(start)), np.eye(len(own))
    for _ in range(_MOST_STEPS):
        at[own] = nu = np.exp(2.0 * phi)
        weight = np.linalg.inv(left.covariance(at))
        q, A = weight @ left.y, np.array([weight @ each for each in U])
        slope = nu * ([q @ each @ q for each in U] - np.linalg.trace(A))
        H = 2.0 * np.outer(nu, nu) * np.einsum("sij,tji->st", A, A)
        step = np.linalg.solve(H + 1e-9 * np.eye(len(own)), slope)
        last, phi = phi, np.clip(phi + np.clip(step, -1.0, 1.0), *ends)
        if np.abs(phi - last).max() < _STILL:
            break
    # as likely without one of them, or nowhere within bounds
    if np.any((phi <= ends[0]) | (phi >= ends[1])):
        return _Likely(-np.inf, at)
    spread = np.log(MOST / LEAST)
    H = H / (2.0 * np.pi) + np.eye(len(own)) / spread**2  # 1 where it is flat
    log = _value(left, at) - len(own) * np.log(spread) - 0.5 * np.linalg.slogdet(H)[1]
    return _Likely(float(log), at)


_SHARE = 0.1  # of a standard deviation, over which a fit is linear


def widened(
    covariance: Float[Array, "p p"],
    refitted: Callable[[dict[str, Array]], Array],
    shifts: Sequence[dict[str, Array]],
) -> Float[Array, "p p"]:
    """Add the covariance of errors that all rests share, each a shift of one sd.

    A shift is by sensor.
    """
    if not len(shifts):
        return covariance

    def at(share: float, shift: dict[str, Array]) -> Array:
        return refitted({name: share * own for name, own in shift.items()})

    still = at(0.0, shifts[0])
    moved = np.array([at(_SHARE, each) - still for each in shifts]) / _SHARE
    return covariance + moved.T @ moved
