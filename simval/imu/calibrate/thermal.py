r"""Bias and scale that depend on temperature, where the evidence shows it.

With :math:`\tau = T - T_0`, T_0 the mean temperature of the rests, a triad reads

.. math:: w = M\,\Bigl(1 + \sum_j \kappa_j \tau^j\Bigr) \circ
   \Bigl(y - b - \sum_j \beta_j \tau^j\Bigr), \quad j \le 2, \tag{TH1}

which is (M1) of `equations` with further columns: each property of each axis times a
regressor that is known of each rest, the mean of :math:`\tau^j` over it. So the nine
parameters are those at T_0, and a reading y at T is that of the sensor at T_0 where it
is :math:`y' = b + (1 + \kappa\tau) \circ (y - b - \beta\tau)`.

**Evidence.** Terms are added three at a time, one for each axis: bias or scale, linear
first, by the odds that judge all else (`temperature_effect` of
`simval.imu.explain.judgement`). A
sensor that does not depend on temperature is given a term in one log of a hundred at
most. Where something else explains as much, such as a drift in time or a rest that is
off, no term is added and that is said.

**Error bars.** The covariance is that of all parameters, by the scatter that is left
with as many degrees of freedom (Student's t). What is fitted afterwards to the
readings y' has, beside its own covariance C, that of the terms by its slope S to them,
:math:`C + S C_b S^T`, the slopes by refits; for
an efficient estimate of the rest at known terms is uncorrelated with their error. At a
temperature beyond the rests' nothing bears out the polynomial, whatever its bars say.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.imu.calibrate.equations import Accelerometer, Corrected, Problem
from simval.imu.calibrate.gauss_newton import minimize
from simval.imu.calibrate.rest_temperatures import (
    LEAST_LEFT,
    RestTemperatures,
    Within,
)
from simval.imu.explain import RestMeans
from simval.imu.explain.explanation import Kind
from simval.imu.explain.judgement import KEPT, Effect, temperature_effect
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.vocabulary import Model

TERMS: Final[tuple[Effect, ...]] = (
    ("bias", 1), ("scale", 1), ("bias", 2), ("scale", 2),
)  # fmt: skip


class Course(NamedTuple):
    """What is known of each row that a bias or a scale may follow."""

    name: str  # of the rows of a log
    unit: str  # of a change of it
    at: str  # of a value


TEMPERATURE: Final = Course("temperature", "K", "degC")
TIME: Final = Course("time", "s", "s")
EDGE: Final = 0.1
"""Of the span seen: so far beyond it a reading is corrected, and that is said."""
DRIFTS: Final[frozenset[Kind]] = frozenset({"bias drift", "scale drift"})
"""Kinds of explanations that terms in time take into the fit."""
_STEPS = 50
_FLOOR = 1e-11  # of the readings' size: a noise of zero is rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ThermalVector(Corrected):
    # vectors of a triad with terms, and the chain rule through them
    raw: Float[Array, "t n 3"]  # readings less the bias at their temperature
    stretch: Float[Array, "t n 3"]  # factor of the scale there
    terms: tuple[Effect, ...]
    powers: Float[Array, "n j"]

    def pull(
        self, a: Float[Array, "t k e 3"], rests: slice = slice(None)
    ) -> tuple[Float[Array, "t k e q"], Float[Array, "t k e 3"]]:
        """Derivatives of a'w at some rests by the parameters and by unit noises."""
        own, _ = Corrected.pull(self, a, rests)
        back = (a.reshape(len(a), -1, 3) @ self.matrix).reshape(a.shape)
        by_bias = back * self.stretch[:, rests, None]
        columns = by_terms(
            self.terms, -by_bias, back * self.raw[:, rests, None],
            self.powers[rests, None],
        )  # fmt: skip
        by_theta = np.concatenate([own[..., :6], -by_bias, *columns], axis=-1)
        return by_theta, by_bias * self.std[:, rests, None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalTriad(Accelerometer):
    """A triad with temperature terms (TH1) that reads a vector of known length."""

    terms: tuple[Effect, ...]
    powers: Float[Array, "n j"]  # means of tau and of its square over each rest

    size = property(lambda self: 9 + 3 * len(self.terms))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the form's parameters, then of the terms."""
        return (*forms.names(self.model), *names_of(self.terms))

    def corrected(self, theta: Float[Array, "t p"]) -> Corrected:
        """The corrected vector of each rest, over its known length."""
        plain = Accelerometer.corrected(self, theta[:, :9])
        values = theta[:, 9:].reshape(len(theta), -1, 3)
        raw, stretch = law(self.terms, values, self.powers, plain.x)
        x = stretch * raw
        return _ThermalVector(
            w=x @ plain.matrix.mT, x=x, matrix=plain.matrix,
            slopes=plain.slopes, std=plain.std, raw=raw, stretch=stretch,
            terms=self.terms, powers=self.powers,
        )  # fmt: skip


def names_of(terms: tuple[Effect, ...], over: Course = TEMPERATURE) -> tuple[str, ...]:
    """Names of the coefficients of some terms, axis by axis."""
    power = {1: over.unit, 2: f"{over.unit}^2"}
    return tuple(f"{what}_{a} per {power[j]}" for what, j in terms for a in "xyz")


def law(
    terms: tuple[Effect, ...],
    values: Float[Array, "... k 3"],
    powers: Float[Array, "n 2"],
    x: Float[Array, "... n 3"],
) -> tuple[Float[Array, "... n 3"], Float[Array, "... n 3"]]:
    """The two factors of (TH1): the reading less its bias, and the scale's factor.

    `values` are the coefficients of the terms, `powers` tau and its square.
    """
    shape = (*values.shape[:-2], 2, 3)
    parts = {"bias": np.zeros(shape), "scale": np.zeros(shape)}
    for k, (what, power) in enumerate(terms):
        parts[what][..., power - 1, :] = values[..., k, :]
    return x - powers @ parts["bias"], 1.0 + powers @ parts["scale"]


def by_terms(
    terms: tuple[Effect, ...], by_bias: Array, by_scale: Array, powers: Array
) -> list[Array]:
    """Derivatives by each term's coefficient."""
    by = {"bias": by_bias, "scale": by_scale}
    return [by[what] * powers[..., power - 1, None] for what, power in terms]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Term(ReadOnly):
    """Dependence of one sensor's bias and scale on temperature, or on time.

    Attributes
    ----------
    reference : float
        Temperature of the calibration, degrees Celsius, or its time, s.
    low, high : float
        Least and greatest of the rests, in that unit.
    terms : tuple of tuple
        What depends on it, ``bias`` or ``scale``, and its power.
    coefficients : Array
        Of each term and axis, (k, 3): raw units over K (s) to the power, and of a scale
        1 over K (s) to the power.
    covariance : Array
        Of the coefficients, axis by axis within term by term, (3 k, 3 k).
    centre : Array
        Reading about which a scale multiplies, raw units, (3,).
    dof : int
        Degrees of freedom that the covariance was estimated with.
    over : Course
        Temperature or time.
    """

    reference: float
    low: float
    high: float
    terms: tuple[Effect, ...]
    coefficients: Float[Array, "k 3"]
    covariance: Float[Array, "c c"]
    centre: Float[Array, "3"]
    dof: int
    over: Course = TEMPERATURE

    @property
    def sd(self) -> Float[Array, "k 3"]:
        """Standard deviation of each coefficient."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(-1, 3)

    def powers(self, temperature: Float[Array, " n"]) -> Float[Array, "n 2"]:
        """Tau, the temperature from the reference, and its square."""
        tau = temperature - self.reference
        return np.stack([tau, tau * tau], axis=-1)

    def compensated(
        self, readings: Float[Array, "n 3"], temperature: Float[Array, " n"]
    ) -> Float[Array, "n 3"]:
        """Readings as they would be at the reference temperature."""
        away, stretch = self._factors(readings, self.powers(temperature))
        return self.centre + stretch * away

    def _factors(
        self, readings: Float[Array, "n 3"], powers: Float[Array, "n 2"]
    ) -> tuple[Array, Array]:
        return law(self.terms, self.coefficients, powers, readings - self.centre)

    def shifts(
        self, readings: Float[Array, "n 3"], powers: Float[Array, "n 2"]
    ) -> Float[Array, "c n 3"]:
        """Change of the readings by each independent error of the coefficients.

        Of one standard deviation each, so that the sum of their outer products is the
        covariance that the coefficients leave in the compensated readings.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        errors = root.T.reshape(-1, len(self.terms), 3)
        away, stretch = self._factors(readings, powers)
        slopes = np.stack(by_terms(self.terms, -stretch, away, powers), axis=-1)
        return np.einsum("nak,cka->cna", slopes, errors)

    def outside(self, temperature: Float[Array, " n"]) -> tuple[int, float]:
        """Number of rows outside the calibrated range, and the largest excess, K."""
        off = np.maximum(self.low - temperature, temperature - self.high)
        return int(np.count_nonzero(off > 0.0)), float(max(off.max(), 0.0))

    def as_object(self) -> dict[str, Any]:
        """Return the terms as plain JSON values, with error bars over the range."""
        at, unit = np.linspace(self.low, self.high, 5), self.over.at
        return {
            f"reference_{unit}": self.reference,
            f"range_{unit}": [self.low, self.high],
            "terms": [list(term) for term in self.terms],
            "names": list(names_of(self.terms, self.over)),
            "coefficients": self.coefficients.tolist(),
            "sd": self.sd.tolist(),
            "covariance": self.covariance.tolist(),
            "centre": self.centre.tolist(),
            "dof": self.dof,
            "bars_over_range": [
                {unit: float(T)} | {k: v.tolist() for k, v in self.bars(T).items()}
                for T in at
            ],
        }

    def bars(self, temperature: float) -> dict[str, Float[Array, "3"]]:
        """Standard deviation that the terms add to bias and scale at a temperature."""
        powers = self.powers(np.array([temperature]))[0]
        k = len(self.terms)
        own = np.einsum("iaja->aij", self.covariance.reshape(k, 3, k, 3))
        found = {}
        for what in ("bias", "scale"):
            z = np.array([powers[j - 1] * (w == what) for w, j in self.terms])
            found[what] = np.sqrt(np.einsum("i,aij,j->a", z, own, z))
        return found


class ThermalFit(NamedTuple):
    """Fit of a triad with temperature terms."""

    theta: Float[Array, " p"]  # the nine at the reference, then the coefficients
    covariance: Float[Array, "p p"]  # by the noise as it stands
    square: float
    slopes: Float[Array, "n p"]  # of distances, in the unit of the noise


class ThermalChoice(NamedTuple):
    """The temperature terms that the evidence supports."""

    rests: RestTemperatures | None = None  # None without a temperature
    thermal: Term | None = None
    reason: str = ""
    tested: bool = True  # False where an effect may be left out
    fit: ThermalFit | None = None  # with the terms
    shifts: Any = ()  # `Term.shifts` of the poses
    within: Within | None = None


def choose_thermal(
    means: RestMeans,
    rests: RestTemperatures,
    *,
    start: Float[Array, "9"],
    model: Model,
    g: float,
    std: Float[Array, " n"],
    over: Course = TEMPERATURE,
) -> ThermalChoice:
    """Choose the temperature terms of a triad by their odds, and fit them.

    Parameters
    ----------
    means : RestMeans
        Mean reading of each rest and its noise.
    rests : RestTemperatures
        Of these, or their times in its place.
    start : Array
        Parameters without terms, (9,).
    model : str
        Form of the parameters.
    g : float
        Length of the vector, as corrected.
    std : Array
        Noise by which the poses are weighed, raw units, (n,).
    over : Course
        Temperature or time.

    Returns
    -------
    ThermalChoice
        The terms, or why there are none.
    """
    poses, not_modelled = means.readings, rests.not_modelled
    if over is TIME:
        not_modelled = "no drift is taken into the fit, because {}".format
    why = rests.refusal(len(poses) - 9)
    if why:
        return ThermalChoice(rests, reason=not_modelled(why), tested=False)
    most = (len(poses) - 9 - LEAST_LEFT) // 3
    # if it rises all the time, both are reported to fit
    drifts = DRIFTS if over is TIME or rests.monotone else frozenset[Kind]()
    found = temperature_effect(replace(means, temperature=rests.mean), most, drifts)
    size, terms = np.exp(min(found.odds, 700.0)), found.effects
    last = _fitted(poses, rests.powers, model, g, std, start, terms)
    if last is None or not terms:
        what = f"the odds of an effect are {size:.2g} ({KEPT:g} needed)"
        if found.rival is not None:
            what = f"{found.rival.sentence(means.time)}, which explains it as well"
        elif last is None:
            what = "the poses cannot separate the effect from the parameters"
        reason, tested = not_modelled(what), last is not None and not found.rival
        return ThermalChoice(rests, reason=reason, tested=tested)
    dof = len(poses) - last.theta.size
    thermal = Term(
        reference=rests.reference, low=rests.low, high=rests.high, terms=terms,
        coefficients=last.theta[9:].reshape(-1, 3),
        covariance=last.square / dof * last.covariance[9:, 9:],
        centre=last.theta[6:9], dof=dof, over=over,
    )  # fmt: skip
    kept = ", ".join(f"{what} {'linear' if j == 1 else 'square'}" for what, j in terms)
    reason = (
        f"terms in {over.name}: {kept}; odds of the last {size:.2g} ({KEPT:g} needed)"
    )
    return ThermalChoice(
        rests, thermal, reason, fit=last, shifts=thermal.shifts(poses, rests.powers)
    )


def thermal_problem(
    poses: Float[Array, "t n 3"],
    powers: Float[Array, "n 2"],
    model: Model,
    g: float,
    std: Float[Array, " n"],
    terms: tuple[Effect, ...],
) -> Problem:
    """The equations of one triad with some terms, or with none."""
    floor = _FLOOR * np.abs(poses).max()
    noise = np.broadcast_to(np.maximum(std, floor)[:, None], poses.shape)
    triad = ThermalTriad(
        readings=poses, std=noise, model=model, g=g, terms=terms, powers=powers
    )
    return Problem(sensors=(triad,))


def _fitted(
    poses: Float[Array, "n 3"], powers: Float[Array, "n 2"], model: Model, g: float,
    std: Float[Array, " n"], start: Float[Array, "9"], terms: tuple[Effect, ...],
) -> ThermalFit | None:  # fmt: skip
    # None where terms and parameters cannot be separated
    problem = thermal_problem(poses[None], powers, model, g, std, terms)
    first = np.concatenate([start, np.zeros(3 * len(terms))])
    found = minimize(problem, first[None], _STEPS)
    here = found.here
    covariance, pivot = here.covariance()
    if not (found.converged[0] and pivot[0] > 1e-10):  # of rounding: 1e-13
        return None
    return ThermalFit(
        found.theta[0], covariance[0], float(here.chi_square[0]), here.slopes[0]
    )
