r"""Which model of the bias, and whether forces act on the gyroscope: by evidence.

**Bias.** With the rests' white noise :math:`N^2/T_i` and a walk K of the bias, a
constant leaves the angle of a move of T seconds the variance
:math:`T^2 (N^2/\sum T_i + K^2 v)`, v that between the bias in the move and its mean
over the rests; a line between the neighbouring rests
:math:`T^2 N^2 / 2 T_r + K^2 T^3/12`. The lesser is chosen, and the line only where it
tells a rest that was left out better than the others' mean does.

**Sensitivity to force.** The rests' mean readings are regressed on 1 and on (1, f); the
drop in the sum of squares is judged by the F test. Rests tell it apart from M, which
they do not show at all.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from simval.arrays import Array, frozen
from simval.calibrate.gyroscope.noise import walk_covariance
from simval.shapes import Float

CHANCE: Final = 0.01
"""Of keeping a sensitivity where there is none. Chosen: nine entries are given out
then, each with its error bar."""
_SHARES: Final = 31  # of the walk in the scatter that are tried, a factor 1.6 apart
_COPLANAR: Final = 1e-3  # least singular value of (1, f/g) over the greatest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rests:
    """What the rests say of a gyroscope."""

    rates: Float[Array, "n 3"]  # mean readings, raw units
    times: Float[Array, " n"]  # s
    seconds: Float[Array, " n"]
    moves: Float[Array, " k"]  # time of each move, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Sensitivity to force as the rests show it."""

    kept: bool
    G: Float[Array, "3 3"]  # raw units per m/s^2; zero where not kept
    sd: Float[Array, "3 3"]  # of its entries, as wide as the rests scatter
    # of B and of the rows of G of an axis, over the variance N^2 of that axis
    shape: Float[Array, "4 4"]
    reason: str

    def __post_init__(self) -> None:
        for name in ("G", "sd", "shape"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def choose_bias(
    rests: Rests, walk: Float[Array, "3"], drift: float | None
) -> tuple[str, float, str]:
    """Model of the bias, the walk K it was chosen with, and the reason."""
    N2 = float((walk**2).mean())
    K = walk_of(rests, np.ones((len(rests.times), 1)))[1] if drift is None else drift
    w = rests.seconds / rests.seconds.sum()
    middle = 0.5 * (rests.times[1:] + rests.times[:-1])
    away = np.diagonal(walk_covariance(middle, w, rests.times))
    T2 = rests.moves**2
    constant = float(np.mean(T2 * (N2 / rests.seconds.sum() + K * K * away)))
    pairs = 0.25 * (1.0 / rests.seconds[1:] + 1.0 / rests.seconds[:-1])
    line = float(np.mean(T2 * N2 * pairs + K * K * rests.moves**3 / 12.0))
    told_c, told_l = _left_out(rests)
    chosen = "line" if line < constant and told_l < told_c else "constant"
    said = (
        f"bias: {chosen}; N {np.sqrt(N2):.3g} and K {K:.3g} raw units "
        f"({'measured between rests' if drift is None else 'given'}) leave a move "
        f"{np.sqrt(constant):.2g} raw units s with a constant and {np.sqrt(line):.2g} "
        f"with lines between rests; a rest that is left out is told within "
        f"{told_c:.3g} raw units by the mean of the others and {told_l:.3g} by lines"
    )
    return chosen, K, said


def walk_of(rests: Rests, X: Float[Array, "n p"]) -> tuple[float, float]:
    """White scatter and walk of the rests, raw units per root hertz and times it.

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
    unit = float(np.trace(white) / np.trace(walk))
    best = (-np.inf, 0.0, 0.0)
    for share in (0.0, *np.geomspace(1e-3, 1e3, _SHARES)):
        L = np.linalg.cholesky(white + share * unit * walk)
        square = float((np.linalg.solve(L, y) ** 2).mean())
        if not square > 0.0:
            return 0.0, 0.0
        likely = -0.5 * y.size * np.log(square) - 3.0 * np.log(L.diagonal()).sum()
        best = max(best, (float(likely), square, share * unit * square))
    return float(np.sqrt(best[1])), float(np.sqrt(best[2]))


def _left_out(rests: Rests) -> tuple[float, float]:
    # root mean square of how wrong a rest is told: by the mean of the others, by a line
    y, t, w = rests.rates, rests.times, rests.seconds
    if len(y) < 3:
        return 0.0, float(np.inf)
    total, weight = (w[:, None] * y).sum(axis=0), w.sum()
    others = (total - w[:, None] * y) / (weight - w)[:, None]
    along = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    lines = (1.0 - along) * y[:-2] + along * y[2:]
    off = (y - others)[1:-1], y[1:-1] - lines
    constant, line = (float(np.sqrt((each**2).mean())) for each in off)
    return constant, line


def choose_sensitivity(
    rests: Rests,
    force: Float[Array, "n 3"],
    walk: Float[Array, "3"],
    drift: float | None = None,
    *,
    asked: bool | None = None,
) -> Sensitivity:
    """Whether forces act on the gyroscope, by the F test; or as it was asked.

    Poses in a regular order and a bias that walks both change slowly: the rests are
    whitened by N and K first, or three of four walks would pass for a sensitivity.
    """
    n = len(force)
    g = float(np.linalg.norm(force, axis=1).mean())
    X = np.column_stack([np.ones(n), force / g])
    values = np.linalg.svd(X, compute_uv=False)
    if asked is False:
        return _none("as asked")
    if n < 6 or values[-1] < _COPLANAR * values[0]:
        why = f"{n} rests" if n < 6 else "rests whose directions lie in a plane"
        return _none(f"{why} do not tell it")
    white, K2 = _whitening(rests, X, walk, drift)
    Xw, y = white @ X, white @ rests.rates
    found, *_ = np.linalg.lstsq(Xw, y, rcond=None)
    alone, *_ = np.linalg.lstsq(Xw[:, :1], y, rcond=None)
    without = float(((y - Xw[:, :1] @ alone) ** 2).sum())
    each = ((y - Xw @ found) ** 2).sum(axis=0)
    left = float(each.sum())
    dof = 3 * n - 12
    least = np.finfo(float).eps ** 2 * float((y * y).sum())
    F = (without - left) / 9.0 / (max(left, least) / dof) if without > least else 0.0
    chance = float(scipy.special.fdtrc(9, dof, F))
    kept = chance < CHANCE if asked is None else asked
    reason = (
        f"F = {F:.3g} with 9 and {dof} degrees of freedom, as great by chance in "
        f"{chance:.2g} of logs ({CHANCE:g} allowed); rests whitened for K of "
        f"{K2**0.5:.2g} raw units"
    )
    if not kept:
        return _none(reason)
    scale = np.diag([1.0, 1.0 / g, 1.0 / g, 1.0 / g])
    shape = scale @ np.linalg.inv(Xw.T @ Xw) @ scale
    seen = float(np.sum(each / np.maximum(walk**2, np.finfo(float).tiny))) / dof
    N = (
        walk * np.sqrt(max(1.0, seen))
        if np.all(walk > 0.0)
        else np.sqrt(each / (n - 4))
    )
    return Sensitivity(
        kept=True,
        G=found[1:].T / g,
        sd=np.multiply.outer(N, np.sqrt(np.diagonal(shape)[1:])),
        shape=shape,
        reason=f"sensitivity to force: kept; {reason}",
    )


def _whitening(
    rests: Rests, X: Float[Array, "n 4"], walk: Float[Array, "3"], drift: float | None
) -> tuple[Float[Array, "n n"], float]:
    # inverse root of the rests' covariance over N^2, and K^2; what forces would explain
    # is no drift
    N2 = max(float((walk**2).mean()), np.finfo(float).tiny)
    if drift is None:
        scatter, drift = walk_of(rests, X)
        N2 = max(N2, scatter**2)
    times = rests.times - rests.times[0]
    walked = np.minimum(times[:, None], times)
    S = np.diag(1.0 / rests.seconds) + drift**2 / N2 * walked
    return np.linalg.inv(np.linalg.cholesky(S)), drift**2


def _none(reason: str) -> Sensitivity:
    return Sensitivity(
        kept=False,
        G=np.zeros((3, 3)),
        sd=np.zeros((3, 3)),
        shape=np.zeros((4, 4)),
        reason=f"sensitivity to force: none; {reason}",
    )
