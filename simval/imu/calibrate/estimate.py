"""The common part of every calibration result, and its printed form."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np
import scipy

from simval.arrays import Array, frozen, real_number
from simval.errors import ConvergenceError, InputError
from simval.imu.sensor import forms
from simval.notebooks import ShownFit
from simval.shapes import Float
from simval.text import interval_words, shown
from simval.units import OF_A_LOG
from simval.vocabulary import Model

G_NAMES = tuple(f"G_{a}{b}" for a in "xyz" for b in "xyz")
"""Of the sensitivity of a gyroscope to specific force, row by row."""
_NO_FORCE = np.zeros((3, 3))
NORMAL_95 = 1.959963984540054
"""Standard deviations from the middle to an end of a 95 % interval."""
NEAR = 1.2  # ratio of a scale to a unit's within which the readings are in that unit


def plain(value: Any) -> Any:
    """Lists of floats, what is not finite as None."""
    numbers = np.asarray(value, dtype=float)
    plain = numbers.astype(object)
    plain[~np.isfinite(numbers)] = None
    return plain.tolist()


def accelerometer_lines(fit: Any) -> list[str]:
    """Describe the calibration of an accelerometer."""
    chi2 = float(fit.chi2_per_dof)
    told = f"chi2 per dof      {chi2:.3g} with {fit.dof} degrees of freedom"
    return [
        status_line(fit),
        "",
        *parameter_lines(fit),
        "",
        *matrix_lines(fit),
        "",
        residual_line(fit),
        *([told] if np.isfinite(chi2) else []),
    ]


def calibration_lines(found: Any) -> list[str]:
    """Describe the calibration of several sensors in one fit."""
    gyroscope, compass = found.gyroscope, found.magnetometer
    both = gyroscope is not None and compass is not None
    others = "accelerometer" + " and the magnetometer" * both
    beside = "magnetometer" if gyroscope is None else "gyroscope"
    beside += " and the magnetometer" * both
    nine, model = slice(0, 9), found.recording.model
    intervals = found.confidence_intervals()
    lines = [
        f"accelerometer     {model} form, in one fit with the {beside}",
        f"status            {found.status} after {int(found.iterations)} iterations; "
        f"chi2 per dof {float(found.chi2_per_dof):.3g} with {found.dof}",
        "                  value           sd   95 % interval",
        *entry_lines(model, found.parameters[nine], found.sd[nine], intervals[nine]),
    ]
    if gyroscope is not None:
        G, G_sd = found.recording.taken.G, found.recording.taken.G_sd
        lines += ["", *gyroscope_lines(gyroscope, others, G, G_sd)]
        lines += [f"{'':18s}{each}" for each in found.recording.taken.reasons]
    if compass is not None:
        lines += ["", *magnetometer_lines(compass, together=both)]
    return lines


def status_line(fit: Any) -> str:
    """Status of the fit, in a line."""
    return (
        f"status            {fit.status} after {int(fit.iterations)} iterations, "
        f"condition of the poses {float(fit.condition):.3g}"
    )


def parameter_lines(fit: Any, bound: Float[Array, "9"] | None = None) -> list[str]:
    """T, K and B with their error bars, and the bound where it is known."""
    beside = "" if bound is None else f" {'bound':>12s}"
    return [
        f"{fit.model} form, 95 % intervals: {_kind(fit)}",
        f"                  value           sd{beside}   95 % interval",
        *entry_lines(fit.model, fit.parameters, fit.sd, fit.intervals, bound),
    ]


def entry_lines(
    model: Model,
    values: Float[Array, "9"],
    sd: Float[Array, "9"],
    intervals: Float[Array, "9 2"],
    bound: Float[Array, "9"] | None = None,
) -> list[str]:
    """Each entry of T, K and B with its error bars; S_zx is minus the entry of T."""
    lines = []
    for place, (name, sign) in enumerate(forms.entries(model)):
        low, high = sorted(sign * intervals[place])
        bar = f"{sd[place]:.3g}" if np.isfinite(sd[place]) else "-"
        numbers = f"{sign * values[place]:15.8g} {bar:>12s}"
        numbers += "" if bound is None else f" {bound[place]:12.3g}"
        lines.append(f"  {name:7s} {numbers}   {interval_words(low, high, 8)}")
    return lines


def residual_line(fit: Any) -> str:
    """Residuals of the fit, in a line."""
    return f"residual RMS      {float(fit.rms):.4g} m/s^2 of | |TK(y - B)| - g |"


def matrix_lines(fit: Any) -> list[str]:
    """The product in words, and T (or K where T is the identity) in it."""
    name, matrix = ("K", fit.K) if fit.model == "symmetric" else ("T", fit.T)
    product = "K (reading - b)" if name == "K" else "T diag(K) (reading - B)"
    rows = ["  ".join(f"{entry:15.8g}" for entry in row) for row in matrix]
    return [f"force = {product}, with {name} =", *(f"  {row}" for row in rows)] + [
        f"  where {note}" for note in forms.sign_notes(fit.model)
    ]


def _kind(fit: Any) -> str:
    if fit.covariance_kind == "type A":
        return f"Type A, Student's t, {fit.dof} dof"
    if fit.covariance_kind == "none":
        return "none: nine poses leave no degree of freedom"
    return fit.covariance_kind


def gyroscope_lines(
    fit: Any, others: str = "accelerometer", G: Array = _NO_FORCE, G_sd: Any = None
) -> list[str]:
    """M, B and G with their error bars."""
    felt = " - G f" if np.any(G) else ""
    lines = [
        f"gyroscope         rate = M (reading - B{felt}), axes of "
        f"the accelerometer's {fit.model} form, rad/s; readings "
        f"{rate_unit(fit.M)[1]}",
        f"                  fitted together with the {others}; chi2 per dof "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}",
        "                  value           sd",
    ]
    lines += _values(fit.names, fit.parameters, fit.sd)
    if np.any(G):
        lines.append("  G, raw units per m/s^2:")
        lines += _values(G_NAMES, G.ravel(), G_sd.ravel())
    return lines + fit.noise.lines


def magnetometer_lines(fit: Any, together: bool = False) -> list[str]:
    """M, b and the dip with their error bars, and the findings."""
    others, chi2 = "accelerometer", "chi2 per dof"
    if together:  # poses are judged without the moves
        others, chi2 = "accelerometer and the gyroscope", "chi2 per dof of its poses"
    lines = [
        f"magnetometer      field = M (reading - b), axes of the accelerometer's "
        f"{fit.model} form, of a field of {fit.field:g}",
        f"                  fitted together with the {others}; {chi2} "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}; {fit.assumption}",
        "                  value           sd",
    ]
    own = slice(9, 21)
    lines += _values(fit.names[own], fit.parameters[own], fit.sd[own])
    lines.append(
        f"  dip     {np.degrees(fit.dip):15.6f} {np.degrees(fit.sd[-1]):12.3g}   "
        "degrees below the horizon"
    )
    said = () if together else fit.noise.sentences
    lines += [f"finding           {each}" for each in (*fit.findings, *said)]
    return lines if together else lines + fit.noise.lines


def _values(names: tuple[str, ...], values: Array, sd: Array) -> list[str]:
    return [
        f"  {name:7s} {value:15.8g} {error:12.3g}"
        for name, value, error in zip(names, values, sd, strict=True)
    ]


def rate_unit(M: Float[Array, "3 3"]) -> tuple[float | None, str]:
    """Unit of a gyroscope's readings by their scale, rad/s, and what there is to say.

    None of counts, which come near the others.
    """
    scale = float(np.cbrt(abs(np.linalg.det(M))))
    for name in ("rad/s", "deg/s"):
        size = OF_A_LOG["gyro"][name]
        if 1.0 / NEAR < scale / size < NEAR:
            return size, f"are in {name} by their scale, {scale:.5g}"
    return None, f"are counts of {scale:.4g} rad/s"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate(ShownFit):
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
    lines: ClassVar[Callable[[Any], list[str]]]  # text of one fit
    advice: ClassVar[str]  # what to look for where a fit did not converge
    ample: ClassVar[int] = 0  # steps below which more of them may help

    parameters: Float[Array, "... p"]
    covariance: Float[Array, "... q q"]
    dof: int
    status: Any
    iterations: Any

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray | np.floating) and value.dtype.kind == "f":
                object.__setattr__(self, field.name, frozen(value))

    def __str__(self) -> str:
        if np.ndim(self.status) == 0:
            return "\n".join(type(self).lines(self))
        endings, counts = np.unique(np.asarray(self.status), return_counts=True)
        said = ", ".join(f"{n} {end}" for end, n in zip(endings, counts, strict=True))
        return f"{int(counts.sum())} calibrations of {self.what}: {said}"

    @property
    def sd(self) -> Float[Array, "... p"]:
        """Standard deviation of each parameter, (..., p); NaN where there is none."""
        variance = np.diagonal(self.covariance, axis1=-2, axis2=-1)
        return np.sqrt(variance[..., -self.parameters.shape[-1] :])

    @property
    def converged(self) -> Any:
        """True where a trial converged, (...)."""
        return self.status == "converged"

    @property
    def intervals(self) -> Float[Array, "... p 2"]:
        """Confidence intervals at 95 percent, (..., p, 2)."""
        return self.confidence_intervals()

    def confidence_intervals(self, level: float = 0.95) -> Float[Array, "... p 2"]:
        """Confidence interval of each parameter.

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
        """Return the fit if every trial converged.

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
                f"{bad.size} trial(s) did not converge, the first is trial {bad[0]} "
                f"({status}) after {steps} iterations: {self.advice}"
                + (" (or raise `max_iterations`)" if few else "")
            )
            raise ConvergenceError(msg)
        return self

    def _require_single(self) -> None:
        if self.parameters.ndim != 1:
            msg = (
                f"this is a batch of {self.parameters.shape[0]} trials; take one of "
                "them, or calibrate that one alone"
            )
            raise InputError(msg)
