r"""Minimiser for a batch of trials, with the small linear systems of its steps.

**Elimination of small symmetric matrices, positive definite or not.**

The trials are on the last axis, so that each operation is one of NumPy's on the whole
batch, element by element: a trial's numbers do not depend on its neighbours, nor on the
machine's BLAS, and one that is not positive harms no other. LAPACK, which NumPy calls
for one matrix after the other, takes four times as long in a batch, and half for one.

**Levenberg-Marquardt, damped Gauss-Newton and Newton for a batch of trials.**

The three methods of the sources share one loop, over nine parameters or, where the
residual is a form in the moments, over the centre alone (H1); they differ in
the matrix of the step (:math:`J^TJ + \mu I`, :math:`J^TJ`, the full Hessian) and in
what is done when a step would raise the cost (more :math:`\mu`, a shorter step).

The stop rule is the symmetric Gauss-Newton derivation's, largest
:math:`|2 (X_k - X_{k-1}) / (X_k + X_{k-1})|` below a tolerance, made safe where a
parameter crosses zero: the mean of the two magnitudes counts as at least 1, the
size of a typical parameter in the scaled units of the fit  (L1). With `stop` "printed"
it is the rule as printed, without that bound. Each trial has its own rule and damping,
and leaves the batch when it stops, so no trial depends on its neighbours.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from simval import vocabulary
from simval.arrays import Array
from simval.shapes import Float

# A pivot that is below it, over its diagonal, is rounding.
_ROUNDING = 1e-15


def eliminate(n: Float[Array, "p q t"]) -> Float[Array, "p t"]:
    """Eliminate symmetric matrices in place (trials last); return the pivots D.

    Of N = LDL', L with a unit diagonal, a unit matrix right of N becomes the inverse
    of L.
    """
    size = len(n)
    for i in range(1, size):
        row = n[i - 1, i : size + i]
        n[i:, i : size + i] -= row[: size - i, None] * (row / n[i - 1, i - 1])
    return n.diagonal().T


def inverse_root(
    matrices: Float[Array, "t p p"],
) -> tuple[Float[Array, "t p p"], Float[Array, " t"]]:
    """Triangles R whose R'R is the inverse, and the least pivot over its diagonal.

    Where a matrix is not positive within rounding R is NaN, and the pivot 0.
    """
    count, size = matrices.shape[:2]
    n = np.empty((size, 2 * size, count))
    n[:, :size] = matrices.transpose(1, 2, 0)
    n[:, size:] = np.eye(size)[..., None]
    sizes = np.abs(n.diagonal().T)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pivots = eliminate(n)
        pivot = (pivots / sizes).min(axis=0)
        n[:, size:] /= np.sqrt(pivots)[:, None]
    root = n[:, size:].transpose(2, 0, 1).copy()
    bad = ~(pivot > _ROUNDING)
    if bad.any():
        root[bad], pivot[bad] = np.nan, 0.0
    return root, pivot


def negative_pivots(matrices: Float[Array, "t p p"]) -> Any:
    """Number of negative eigenvalues of each symmetric matrix."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pivots = eliminate(matrices.transpose(1, 2, 0).copy())
    return (~(pivots > 0.0)).sum(axis=0)


def trace(matrices: Float[Array, "t p p"]) -> Float[Array, " t"]:
    """Trace of each matrix, summed in the same order for any size of batch."""
    return np.add.accumulate(matrices.diagonal(0, -2, -1), axis=-1)[:, -1]


METHODS = vocabulary.METHODS

_FIRST_DAMPING = 1e-6  # of the mean diagonal: the start is within the noise
_LAST_DAMPING = 1e12  # of the mean diagonal: a step is then 1e-12 of a full one
_SHORTEST = 2.0**-40  # of a full step: 1e-12, the default tolerance
_ROUNDING_FLOOR = 1e-7  # below it a step that no longer shrinks is rounding


class Code:
    """Status of a trial, as an index into `STATUS_NAMES`."""

    CONVERGED, MAX_ITERATIONS, STALLED, NON_FINITE, DUPLICATES, RANK = range(6)
    CONDITION, NOT_ELLIPSOID, SATURATED, NOISE_RANK, WIDE = range(6, 11)


STATUS_NAMES = np.array(
    [
        "converged",
        "max iterations",
        "stalled",
        "refused: non-finite poses",
        "refused: duplicate poses",
        "refused: rank below nine",
        "refused: ill-conditioned",
        "refused: not an ellipsoid",
        "refused: saturated poses",
        "refused: rank below nine within the noise",
        "refused: error bars too wide",
    ]
)


class Trials:
    """Base of a dataclass whose fields have a row for each trial, or are None."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def take(self, rows: Any) -> Self:
        """Select some trials."""

        def taken(value: Any) -> Any:
            if value is None:
                return None
            return value.take(rows) if isinstance(value, Trials) else value[rows]

        names = self.__dataclass_fields__
        return type(self)(**{name: taken(getattr(self, name)) for name in names})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Local(Trials):
    """Half the cost, with its derivatives, at a point."""

    cost: Float[Array, " t"]  # half the sum of squared residuals
    gradient: Float[Array, "t p"]  # its gradient
    normal: Float[Array, "t p p"]  # J'J
    hessian: Float[Array, "t p p"] | None = None  # in full; None: Newton is not asked


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rules:
    """Limits and tolerances of the iteration."""

    method: str  # one of `METHODS`
    step: float  # fraction of each step that is taken
    tolerance: float  # limit of the stop rule (L1)
    max_iterations: int  # most steps that are tried
    stop: str = "bounded"  # or "printed", without the bound of (L1)


class Solution(NamedTuple):
    """Solution of each trial, where the iteration ended."""

    theta: Float[Array, "t p"]  # parameters
    code: Any  # one of `Code` for each trial, (t,)
    iterations: Any  # steps tried, (t,)
    gradient_norm: Float[Array, " t"]  # norm of the last gradient that was needed


Objective = Callable[[Array, Any], Local]  # (parameters, rows of the batch)


def minimize(
    objective: Objective,
    theta: Float[Array, "t p"],
    rules: Rules,
    slack: float,
    origin: Float[Array, "t p"] | None = None,
) -> Solution:
    """Minimise each trial's cost from its own start.

    The stop rule looks at parameters and `origin` together.
    """
    count, least = len(theta), 0.0 if rules.stop == "printed" else 1.0
    twice = np.zeros_like(theta) if origin is None else 2.0 * origin
    ended = Solution(
        theta=theta.copy(),
        code=np.full(count, Code.MAX_ITERATIONS),
        iterations=np.zeros(count, dtype=int),
        gradient_norm=np.full(count, np.nan),
    )
    here = objective(theta, np.arange(count))
    mean = trace(here.normal) / theta.shape[-1]
    trials = _Active(
        rows=np.arange(count),
        theta=theta,
        here=here,
        mean=mean,
        damping=_FIRST_DAMPING * mean,
        length=np.ones(count),
        last=np.full(count, np.inf),
    )
    for iteration in range(1, rules.max_iterations + 1):
        step = _step(trials.here, rules.method, trials.damping)
        step *= rules.step * trials.length[:, None]
        there = trials.theta + step
        total = there + trials.theta + twice[trials.rows]
        middle = np.maximum(np.abs(total) / 2.0, least)
        with np.errstate(divide="ignore", invalid="ignore"):
            size = (np.abs(step) / middle).max(axis=-1)  # NaN is never done
        done = size <= rules.tolerance  # the cost there need not be known
        if done.any():
            trials.leave(ended, done, there, iteration, Code.CONVERGED)
            if done.all():
                break
            trials, there, size = trials.take(~done), there[~done], size[~done]
        trials = _advance(objective, trials, there, size, slack, ended, iteration)
        if trials.rows.size == 0:
            break
    else:
        last = rules.max_iterations
        trials.leave(ended, slice(None), trials.theta, last, Code.MAX_ITERATIONS)
    return ended


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Active(Trials):
    # the trials that still iterate, one row each
    rows: Any
    theta: Float[Array, "t p"]
    here: Local
    mean: Float[Array, " t"]  # of the diagonal of J'J at the start
    damping: Float[Array, " t"]
    length: Float[Array, " t"]
    last: Float[Array, " t"]  # size of the last step, eq. (L1)

    def leave(
        self,
        ended: Solution,
        which: Any,
        theta: Float[Array, "t p"],
        iteration: int,
        code: int,
    ) -> None:
        gone = self.rows[which]
        ended.theta[gone] = theta[which]
        ended.code[gone] = code
        ended.iterations[gone] = iteration
        norm = np.sqrt(np.vecdot(self.here.gradient, self.here.gradient))
        ended.gradient_norm[gone] = norm[which]


def _advance(
    objective: Objective,
    trials: _Active,
    there: Float[Array, "t p"],
    size: Float[Array, " t"],
    slack: float,
    ended: Solution,
    iteration: int,
) -> _Active:
    # accept the steps that do not raise the cost; damp or shorten the others
    local = objective(there, trials.rows)
    better = local.cost <= trials.here.cost + slack  # NaN is not better
    at_floor = better & (size <= _ROUNDING_FLOOR) & (size >= trials.last)
    damping = np.where(better, trials.damping / 10.0, trials.damping * 10.0)
    length = np.where(better, np.minimum(2.0 * trials.length, 1.0), trials.length / 2.0)
    dead = ~better & ((damping > _LAST_DAMPING * trials.mean) | (length < _SHORTEST))
    moved = replace(
        trials,
        theta=np.where(better[:, None], there, trials.theta),
        here=_choose(better, local, trials.here),
        damping=damping,
        length=length,
        last=np.where(better, size, trials.last),
    )
    stop = at_floor | dead
    if not stop.any():
        return moved
    moved.leave(ended, at_floor, moved.theta, iteration, Code.CONVERGED)
    moved.leave(ended, dead, moved.theta, iteration, Code.STALLED)
    return moved.take(~stop)


def _step(here: Local, method: str, damping: Float[Array, " t"]) -> Float[Array, "t p"]:
    # The full step of each trial.
    curved = here.normal if here.hessian is None else here.hessian
    if method == "lm":
        curved = here.normal + damping[:, None, None] * np.eye(curved.shape[-1])
    root, pivot = inverse_root(curved)
    if method == "newton" and not np.all(pivot > 0.0):  # not convex here: Gauss-Newton
        bad = ~(pivot > 0.0)
        root[bad] = inverse_root(here.normal[bad])[0]
    return -np.vecmat(np.matvec(root, here.gradient), root)


def _choose(better: Any, there: Local, here: Local) -> Local:
    if better.all():
        return there

    def chosen(name: str) -> Any:
        new, old = getattr(there, name), getattr(here, name)
        if old is None:
            return None
        return np.where(better.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return Local(**{name: chosen(name) for name in Local.__dataclass_fields__})
