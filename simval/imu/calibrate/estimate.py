"""What every calibration result has in common, and its account."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import scipy

from simval.account import Account, Told
from simval.arrays import Array, ReadOnly, real_number
from simval.errors import ConvergenceError, InputError
from simval.notebooks import ShownFit
from simval.shapes import Float
from simval.spelling import counted
from simval.text import shown


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate(Told, ShownFit, ReadOnly):
    """A calibration, or a batch of them: leading axes ``...`` are empty or (trials,).

    A trial that was refused is NaN in every number.

    Attributes
    ----------
    parameters : Array
        In the order of `names`, (..., p).
    covariance : Array
        Their covariance, NaN where there is none; its last p axes are these.
    dof : int
        Rows less parameters.
    status : Array of str
        ``converged``, ``max iterations``, ``stalled``, or ``refused: ...``, (...).
    iterations : Array of int
        Steps of the solver, (...).
    """

    what: ClassVar[str]  # was calibrated
    states: ClassVar[Callable[[Any], Account]]  # what there is to say of one fit
    advice: ClassVar[str]  # what to look for where a fit did not converge
    ample: ClassVar[int] = 0  # steps below which more of them may help

    parameters: Float[Array, "... p"]
    covariance: Float[Array, "... q q"]
    dof: int
    status: Any
    iterations: Any

    @property
    def account(self) -> Account:
        """Everything that there is to say of the calibration."""
        if np.ndim(self.status) == 0:
            return type(self).states(self)
        endings, counts = np.unique(self.status, return_counts=True)
        said = ", ".join(f"{n} {end}" for end, n in zip(endings, counts, strict=True))
        return Account(
            title=counted(int(counts.sum()), "calibration"), source=f"of {self.what}",
            said=said,
        )  # fmt: skip

    @property
    def sd(self) -> Float[Array, "... p"]:
        """Standard deviation of each parameter, (..., p); NaN where it is not known."""
        variance = np.linalg.diagonal(self.covariance)
        return np.sqrt(variance[..., -self.parameters.shape[-1] :])

    @property
    def converged(self) -> Any:
        """True for each trial that converged, (...)."""
        return self.status == "converged"

    @property
    def intervals(self) -> Float[Array, "... p 2"]:
        """Confidence intervals at 95 percent, (..., p, 2)."""
        return self.confidence_intervals()

    def confidence_intervals(self, level: float = 0.95) -> Float[Array, "... p 2"]:
        """Confidence interval of each parameter at a level.

        Normal quantiles for a noise that was stated; Student's t with `dof` degrees of
        freedom where the scatter came from the residuals.

        Parameters
        ----------
        level : float, default 0.95
            Probability that an interval covers the truth, between 0 and 1.

        Returns
        -------
        Array
            Lower and upper limit, (..., p, 2); NaN where there is no covariance.

        Raises
        ------
        InputError
            If `level` is not between 0 and 1.
        """
        if not 0.0 < real_number("level", level, "") < 1.0:
            msg = f"`level` is {shown(level)}; it must be a probability between 0 and 1"
            raise InputError(msg)
        half = -self._quantile((1.0 - level) / 2.0) * self.sd
        return np.stack([self.parameters - half, self.parameters + half], axis=-1)

    def _quantile(self, tail: float) -> Any:
        return scipy.special.ndtri(tail)

    def require_converged(self) -> Self:
        """Return the calibration, or raise if a trial did not converge.

        Returns
        -------
        Estimate
            This fit.

        Raises
        ------
        ConvergenceError
            If a trial did not converge: says which, and what to look for.
        """
        bad = np.flatnonzero(~np.atleast_1d(self.converged))
        if bad.size:
            status = np.atleast_1d(self.status)[bad[0]]
            steps = int(np.atleast_1d(self.iterations)[bad[0]])
            few = status == "max iterations" and steps < self.ample
            msg = (
                f"{counted(bad.size, 'trial')} did not converge, the first is trial "
                f"{bad[0]} ({status}) after {steps} iterations"
            )
            do = self.advice + (" (or raise `max_iterations`)" if few else "")
            raise ConvergenceError(msg, do, iterations=steps)
        return self

    def _require_single(self) -> None:
        if self.parameters.ndim != 1:
            msg = (
                f"this is a batch of {self.parameters.shape[0]} trials; take one of "
                "them, or calibrate that one alone"
            )
            raise InputError(msg)
