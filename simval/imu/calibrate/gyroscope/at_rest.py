r"""Bias of a gyroscope at rest, and its dependence on temperature and force.

**Bias.** With the rests' white noise :math:`N^2/T_i` and a walk K of the bias, a
constant leaves the angle of a rotation of T seconds the variance
:math:`T^2 (N^2/\sum T_i + K^2 v)`, v that between the bias in it and its mean over
the rests; a line between the neighbouring rests
:math:`T^2 N^2 / 2 T_r + K^2 T^3/12`. The lesser is chosen, and the line only at
odds of a walk beside the noise of each axis (`rest_effects`), or where the rests do not
speak against a K that was given.

**Temperature.** Where it is known, the bias may owe a line or a parabola to it, each by
its odds (`rest_effects`) beside (1, f). A scale that depends on temperature is no part
of a rest's reading; the rotations tell it (`imu.scale_terms`).

**Sensitivity to force.** Judged by the odds of f beside 1 and the powers kept. Rests
tell it apart from M, which they do not show at all.
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly, physical_array
from simval.imu.calibrate.gyroscope.noise import walk_covariance
from simval.imu.calibrate.gyroscope.rest_effects import (
    FORCE_ODDS,
    ODDS,
    Rests,
    effect,
    walk_odds,
)
from simval.imu.calibrate.path_statistics import ramps
from simval.imu.calibrate.recording import Bias
from simval.imu.calibrate.rest_temperatures import LEAST_LEFT, RestTemperatures
from simval.imu.calibrate.thermal import Term
from simval.shapes import Float

_SHARES: Final = 31  # of the walk in the scatter that are tried, a factor 1.6 apart
_COPLANAR: Final = 1e-3  # least singular value of (1, f/g) over the greatest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity(ReadOnly):
    """Sensitivity of a gyroscope to force, as its rests show it."""

    kept: bool
    G: Float[Array, "3 3"]  # raw units per m/s^2; zero where not kept
    sd: Float[Array, "3 3"]  # of its entries, as wide as the rests scatter
    # of B and of the coefficients of an axis, over the variance N^2 of that axis
    shape: Float[Array, "q q"]
    reason: str


def choose_bias(
    rests: Rests, walk: Float[Array, "3"], drift: float | None
) -> tuple[Bias, float, str]:
    """Choose a model of the bias; return it with the walk K used, and the reason."""
    N2 = (walk**2).mean()
    K = walk_of(rests, np.ones((len(rests.times), 1)))[1] if drift is None else drift
    w = rests.seconds / rests.seconds.sum()
    middle = 0.5 * (rests.times[rests.after] + rests.times[rests.before])
    away = np.diagonal(walk_covariance(middle, w, rests.times))
    T2 = rests.rotation_seconds**2
    constant = np.mean(T2 * (N2 / rests.seconds.sum() + K * K * away))
    each = 1.0 / rests.seconds
    pairs = 0.25 * (each[rests.after] + each[rests.before])
    line = np.mean(T2 * N2 * pairs + K * K * rests.rotation_seconds**3 / 12.0)
    odds = walk_odds(rests, walk, drift) if len(rests.times) > 2 else -np.inf
    needed = ODDS if drift is None else 1.0 / ODDS
    walks = odds > np.log(needed)
    chosen: Bias = "line" if line < constant and walks else "constant"
    said = (
        f"bias: {chosen}; N {np.sqrt(N2):.3g} and K {K:.3g} raw units "
        f"({'measured between rests' if drift is None else 'given'}) leave a "
        f"rotation {np.sqrt(constant):.2g} raw units s with a constant and "
        f"{np.sqrt(line):.2g} with lines between rests; odds of a walk "
        f"{np.exp(min(odds, 700.0)):.2g} ({needed:g} needed)"
    )
    return chosen, K, said


def walk_of(rests: Rests, X: Float[Array, "n p"]) -> tuple[float, float]:
    """White noise and random walk K of the rests, by restricted likelihood.

    Most likely for what is left of the rests' means without X (restricted likelihood):
    a scatter that does not grow with the time between rests is no walk.
    """
    n, p = X.shape
    if n - p < 2:
        return 0.0, 0.0
    Z = np.linalg.qr(X, mode="complete")[0][:, p:]
    y = Z.T @ rests.rates
    times = rests.times - rests.times[0]
    white = Z.T @ np.diag(1.0 / rests.seconds) @ Z
    walk = Z.T @ np.minimum(times[:, None], times) @ Z
    unit = np.trace(white) / np.trace(walk)
    best = (-np.inf, 0.0, 0.0)
    for share in (0.0, *np.geomspace(1e-3, 1e3, _SHARES)):
        L = np.linalg.cholesky(white + share * unit * walk)
        square = (np.linalg.solve(L, y) ** 2).mean()
        if not square > 0.0:
            return 0.0, 0.0
        likely = -0.5 * y.size * np.log(square) - 3.0 * np.log(L.diagonal()).sum()
        best = max(best, (likely, square, share * unit * square))
    return np.sqrt(best[1]), np.sqrt(best[2])


MOVES: Final = 1e-3
"""Chance that rests in which nothing turns are taken for moving."""


def rest_motion(
    time: Any, rates: Any, intervals: Any, rests: Rests, walk: Float[Array, "3"],
    drift: float,
) -> tuple[float, float]:  # fmt: skip
    r"""Chance of the scatter and slopes within rests if all are still; of the slopes.

    The slopes :math:`\int (2s - 1)\, n\, dt` have the variance :math:`N^2 T_r/3`, and
    the means scatter by N and K about the bias.
    """
    step, y = np.diff(time, prepend=2 * time[0] - time[1]), np.asarray(rates)
    N = np.maximum(walk, np.finfo(float).tiny)
    white = _whitening(rests, np.ones((len(rests.times), 1)), N, drift)
    X, mean = white.sum(axis=1, keepdims=True), white @ rests.rates / N
    mean = mean - X @ np.linalg.lstsq(X, mean)[0]
    weights = 2.0 * step * ramps(len(y), intervals)
    slopes = np.array([weights[a:b] @ (y[a:b] - y[a:b].mean(0)) for a, b in intervals])
    slopes = slopes / N
    within = 3.0 * (slopes**2 / rests.seconds[:, None]).sum()
    both = scipy.special.chdtrc(mean.size + slopes.size - 3, (mean**2).sum() + within)
    return float(both), float(scipy.special.chdtrc(slopes.size, within))


def choose_sensitivity(
    rests: Rests,
    force: Float[Array, "n 3"],
    walk: Float[Array, "3"],
    drift: float | None = None,
    *,
    asked: bool | None = None,
    powers: Float[Array, "n d"] | None = None,
) -> Sensitivity:
    """Decide by the odds, or as asked, whether to fit a g-sensitivity.

    `powers` of the temperature are fitted beside it, and come before it in `shape`.
    """
    n = len(force)
    g = np.linalg.norm(force, axis=1).mean()
    warm = np.zeros((n, 0)) if powers is None else powers
    lead = 1 + warm.shape[1]
    X = np.column_stack([np.ones(n), warm, force / g])
    values = np.linalg.svd(X, compute_uv=False)
    if asked is False:
        return _none("as asked")
    values = values if lead == 1 else np.linalg.svd(X / np.abs(X).max(axis=0))[1]
    if n < 5 + lead or values[-1] < _COPLANAR * values[0]:
        why = f"{n} rests" if n < 5 + lead else "rests whose directions lie in a plane"
        return _none(f"{why} cannot show it")
    found = effect(rests, X[:, :lead], X[:, lead:], walk, drift, FORCE_ODDS)
    if not (found.kept if asked is None else asked):
        return _none(found.reason)
    scale = np.diag([1.0] * lead + [1.0 / g] * 3)
    each = np.sqrt(np.linalg.diagonal(found.covariance))
    return Sensitivity(
        kept=True,
        G=found.coefficients[lead:].T / g,
        sd=each[:, lead:] / g,
        shape=scale @ _shape(rests, X, walk, drift) @ scale,
        reason=f"sensitivity to force: kept; {found.reason}",
    )


class BiasTerms(NamedTuple):
    """Dependence of the bias on temperature, as columns for the rests and the rows."""

    thermal: Term | None
    reason: str
    shape: Float[Array, "c c"]  # covariance of B and the terms over N^2
    at_rest: Float[Array, "n d"]  # powers of the temperature, no column without terms
    rows: Float[Array, "r d"]
    seen: RestTemperatures | None = None
    temperature: Any = None  # of each row

    @property
    def coefficients(self) -> Float[Array, "d 3"]:
        """Coefficients, raw units per kelvin to the power."""
        if self.thermal is None:
            return np.zeros((0, 3))
        return self.thermal.coefficients


def bias_terms(
    temperature: Any, time: Any, intervals: Any, rests: Rests,
    force: Float[Array, "n 3"], walk: Float[Array, "3"], drift: float | None,
) -> BiasTerms:  # fmt: skip
    """Choose the temperature terms of the bias by their odds against none."""
    n = len(force)
    none = BiasTerms(None, "", np.zeros((4, 4)), np.zeros((n, 0)), np.zeros((0, 0)))
    if temperature is None:
        return none
    warm = physical_array("temperature", temperature, (len(time),))
    seen = RestTemperatures.of(warm, time, intervals)
    none = none._replace(seen=seen, temperature=warm)
    if seen.span < seen.least_span or n - 5 < LEAST_LEFT:
        need = (
            f"{seen.least_span:g} K between rests and {5 + LEAST_LEFT} rests are needed"
        )
        said = seen.not_modelled(need)
        return none._replace(reason=said and f"gyroscope: {said}")
    g, size = np.linalg.norm(force, axis=1).mean(), np.abs(seen.powers).max(axis=0)
    steady, columns = np.column_stack([np.ones(n), force / g]), seen.powers / size
    kept, fit = 0, None
    for degree in (1, 2):
        X = np.column_stack([steady, columns[:, :degree]])
        if n - X.shape[1] < LEAST_LEFT or np.linalg.cond(X) > 1.0 / _COPLANAR:
            break
        tried = effect(rests, X[:, :-1], X[:, -1:], walk, drift)
        if not tried.kept:
            break
        kept, fit = degree, tried
    if fit is None:
        why = f"the odds of a term are below {ODDS:g}"
        return none._replace(reason=f"gyroscope: {seen.not_modelled(why)}")
    own, unit = np.r_[0, 4 : 4 + kept], np.r_[1.0, size[:kept]]
    X = np.column_stack([steady, columns[:, :kept]])
    shape = _shape(rests, X, walk, drift)[np.ix_(own, own)] / np.outer(unit, unit)
    each = fit.covariance[:, 4:, 4:] / np.outer(size[:kept], size[:kept])
    covariance = np.einsum("ajk,ab->jakb", each, np.eye(3))
    thermal = Term(
        reference=seen.reference, low=seen.low, high=seen.high,
        terms=(("bias", 1), ("bias", 2))[:kept],
        coefficients=fit.coefficients[4:] / size[:kept, None],
        covariance=covariance.reshape(3 * kept, -1), centre=np.zeros(3),
        dof=n - 4 - kept,
    )  # fmt: skip
    said = (
        f"bias of the gyroscope in temperature: {'line' if kept == 1 else 'parabola'}; "
        f"of the last term {fit.reason}"
    )
    return BiasTerms(
        thermal, said, shape, seen.powers[:, :kept], thermal.powers(warm)[:, :kept],
        seen, warm,
    )  # fmt: skip


def _shape(
    rests: Rests, X: Float[Array, "n p"], walk: Float[Array, "3"], drift: float | None
) -> Float[Array, "p p"]:
    # covariance of coefficients over N^2, by one walk of all axes
    white = _whitening(rests, X, walk, drift) @ X
    return np.linalg.inv(white.T @ white)


def _whitening(
    rests: Rests, X: Float[Array, "n p"], walk: Float[Array, "3"], drift: float | None
) -> Float[Array, "n n"]:
    # inverse root of the rests' covariance over N^2; what forces would explain is no
    # drift
    N2 = max((walk**2).mean(), np.finfo(float).tiny)
    if drift is None:
        scatter, drift = walk_of(rests, X)
        N2 = max(N2, scatter**2)
    times = rests.times - rests.times[0]
    walked = np.minimum(times[:, None], times)
    S = np.diag(1.0 / rests.seconds) + drift**2 / N2 * walked
    return np.linalg.inv(np.linalg.cholesky(S))


def _none(reason: str) -> Sensitivity:
    return Sensitivity(
        kept=False,
        G=np.zeros((3, 3)),
        sd=np.zeros((3, 3)),
        shape=np.zeros((4, 4)),
        reason=f"sensitivity to force: none; {reason}",
    )
