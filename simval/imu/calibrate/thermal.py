r"""Bias and scale of a sensor that depend on its temperature, chosen by evidence.

With :math:`\tau = T - T_0`, T_0 the mean temperature of the rests, a triad reads

.. math:: w = M\,\Bigl(1 + \sum_j \kappa_j \tau^j\Bigr) \circ
   \Bigl(y - b - \sum_j \beta_j \tau^j\Bigr), \quad j \le 2, \tag{TH1}

which is (M1) of `equations` with further columns: each property of each axis times a
regressor that is known of each rest, the mean of :math:`\tau^j` over it. So the nine
parameters are those at T_0, and a reading y at T is that of the sensor at T_0 where it
is :math:`y' = b + (1 + \kappa\tau) \circ (y - b - \beta\tau)`.

**Evidence.** Terms are added three at a time, one for each axis: bias or scale, linear
first. Of those that may follow, the one that explains most is kept if chance gives as
much in less than `FALSE_ALARM` over their number (the F test of `goodness_of_fit.Drop`,
by the residuals' own scatter or by a noise that explains them), and so on. A sensor
that does not depend on temperature is given a term with that chance at most.

**Error bars.** The covariance is that of all parameters, by the scatter that is left
with as many degrees of freedom (Student's t). What is fitted afterwards to the
readings y' has, beside its own covariance C, that of the terms by its slope S to them,
:math:`C + S C_b S^T`, the slopes by refits; for
an efficient estimate of the rest at known terms is uncorrelated with their error. At a
temperature beyond the rests' nothing bears out the polynomial, whatever its bars say.

**Temperature and time.** What rises all the time is a drift as well: where the order of
the rests' temperatures is that of their times, or nearly (Spearman's correlation beyond
`MONOTONE`), the terms fit either, and that is said.
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.imu.calibrate.equations import Accelerometer, Corrected, Problem
from simval.imu.calibrate.gauss_newton import minimize
from simval.imu.calibrate.goodness_of_fit import FALSE_ALARM, Drop
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.text import chance_words

Term = tuple[str, int]  # bias or scale, and the power of the temperature
TERMS: Final[tuple[Term, ...]] = (
    ("bias", 1), ("scale", 1), ("bias", 2), ("scale", 2),
)  # fmt: skip
LEAST_SPAN: Final = 2.0  # K over the rests
LEAST_STEPS: Final = 7.0
"""Of the thermometer, over the rests: uniform errors of the regressor weaken a slope by
2 % there (their variance over that of the temperatures)."""
LEAST_LEFT: Final = 3  # degrees of freedom; two make a t of 4.3, and one of 12.7
MONOTONE: Final = 0.95
"""Of 12 rests in an order of chance one set in 500 000 has such a correlation."""
FOLLOWS: Final = 0.9
"""Share of their variance; three axes explain as much of 24 by chance in 4e-10."""
_AROUND = 5  # rows of a running median
EDGE: Final = 0.1
"""Of the span seen: so far beyond it a reading is corrected, and that is said."""
_STEPS = 50
_FLOOR = 1e-11  # of the readings' size: a noise of zero is rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ThermalVector(Corrected):
    # vectors of a triad with terms, and the chain rule through them
    raw: Float[Array, "t n 3"]  # readings less the bias at their temperature
    stretch: Float[Array, "t n 3"]  # factor of the scale there
    terms: tuple[Term, ...]
    powers: Float[Array, "n j"]

    def pull(
        self, a: Float[Array, "t k e 3"], rests: slice = slice(None)
    ) -> tuple[Float[Array, "t k e q"], Float[Array, "t k e 3"]]:
        """Derivative of a'w of some rests by the parameters, and by unit noises."""
        own, _ = Corrected.pull(self, a, rests)
        back = (a.reshape(len(a), -1, 3) @ self.matrix).reshape(a.shape)
        by_bias = back * self.stretch[:, rests, None]
        by = {"bias": -by_bias, "scale": back * self.raw[:, rests, None]}
        columns = [
            by[what] * self.powers[rests, power - 1][:, None, None]
            for what, power in self.terms
        ]
        by_theta = np.concatenate([own[..., :6], -by_bias, *columns], axis=-1)
        return by_theta, by_bias * self.std[:, rests, None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalTriad(Accelerometer):
    """A triad of a vector of known length, its parameters those of (TH1)."""

    terms: tuple[Term, ...]
    powers: Float[Array, "n j"]  # means of tau and of its square over each rest

    size = property(lambda self: 9 + 3 * len(self.terms))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the form's parameters and the terms."""
        return (*forms.names(self.model), *names_of(self.terms))

    def corrected(self, theta: Float[Array, "t p"]) -> Corrected:
        """The vector of each rest over its length."""
        plain = Accelerometer.corrected(self, theta[:, :9])
        parts = split(self.terms, theta[:, 9:].reshape(len(theta), -1, 3))
        raw = plain.x - self.powers @ parts["bias"]
        stretch = 1.0 + self.powers @ parts["scale"]
        x = stretch * raw
        return _ThermalVector(
            w=x @ np.swapaxes(plain.matrix, -1, -2), x=x, matrix=plain.matrix,
            slopes=plain.slopes, std=plain.std, raw=raw, stretch=stretch,
            terms=self.terms, powers=self.powers,
        )  # fmt: skip


def names_of(terms: tuple[Term, ...]) -> tuple[str, ...]:
    """Names of the coefficients of some terms, axis by axis."""
    power = {1: "K", 2: "K^2"}
    return tuple(f"{what}_{a} per {power[j]}" for what, j in terms for a in "xyz")


def split(
    terms: tuple[Term, ...], values: Float[Array, "... k 3"]
) -> dict[str, Float[Array, "... 2 3"]]:
    """Coefficients of bias and scale by power, zero where there is no term."""
    found = {
        what: np.zeros((*values.shape[:-2], 2, 3)) for what in ("bias", "scale")
    }  # fmt: skip
    for k, (what, power) in enumerate(terms):
        found[what][..., power - 1, :] = values[..., k, :]
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thermal(ReadOnly):
    """Terms of one sensor in temperature.

    Attributes
    ----------
    reference : float
        Temperature of the calibration, degrees Celsius.
    low, high : float
        Least and greatest temperature of the rests, degrees Celsius.
    terms : tuple of tuple
        What depends on temperature, ``bias`` or ``scale``, and its power.
    coefficients : Array
        Of each term and axis, (k, 3): raw units over K to the power, and of a scale 1
        over K to the power.
    covariance : Array
        Of the coefficients, axis by axis within term by term, (3 k, 3 k).
    centre : Array
        Reading about which a scale multiplies, raw units, (3,).
    dof : int
        Degrees of freedom that the covariance was estimated with.
    """

    reference: float
    low: float
    high: float
    terms: tuple[Term, ...]
    coefficients: Float[Array, "k 3"]
    covariance: Float[Array, "c c"]
    centre: Float[Array, "3"]
    dof: int

    @property
    def sd(self) -> Float[Array, "k 3"]:
        """Standard deviation of each coefficient."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(-1, 3)

    def confidence_intervals(self, level: float = 0.95) -> Float[Array, "k 3 2"]:
        """Interval of each coefficient, by Student's t."""
        half = scipy.special.stdtrit(self.dof, 0.5 + level / 2.0) * self.sd
        return np.stack([self.coefficients - half, self.coefficients + half], axis=-1)

    def powers(self, temperature: Float[Array, " n"]) -> Float[Array, "n 2"]:
        """Tau and its square."""
        tau = temperature - self.reference
        return np.stack([tau, tau * tau], axis=-1)

    def compensated(
        self, readings: Float[Array, "n 3"], temperature: Float[Array, " n"]
    ) -> Float[Array, "n 3"]:
        """Readings as the sensor would give them at the reference temperature."""
        parts, powers = split(self.terms, self.coefficients), self.powers(temperature)
        away = readings - self.centre - powers @ parts["bias"]
        return np.asarray(self.centre + (1.0 + powers @ parts["scale"]) * away)

    def slopes(
        self, readings: Float[Array, "n 3"], powers: Float[Array, "n 2"]
    ) -> Float[Array, "n 3 k"]:
        """Derivative of each compensated reading by the coefficients of its axis."""
        parts = split(self.terms, self.coefficients)
        by = {
            "bias": -(1.0 + powers @ parts["scale"]),
            "scale": readings - self.centre - powers @ parts["bias"],
        }
        each = [by[what] * powers[:, j - 1, None] for what, j in self.terms]
        return np.stack(each, axis=-1)

    def shifts(
        self, readings: Float[Array, "n 3"], powers: Float[Array, "n 2"]
    ) -> Float[Array, "c n 3"]:
        """What each of c independent errors of the coefficients does to readings.

        Of one standard deviation each, so that the sum of their outer products is the
        covariance that the coefficients leave in the compensated readings.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        errors = root.T.reshape(-1, len(self.terms), 3)
        return np.einsum("nak,cka->cna", self.slopes(readings, powers), errors)

    def outside(self, temperature: Float[Array, " n"]) -> tuple[int, float]:
        """Rows beyond the temperatures seen, and by how many kelvin at most."""
        off = np.maximum(self.low - temperature, temperature - self.high)
        return int(np.count_nonzero(off > 0.0)), float(max(off.max(), 0.0))

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values, the bars over the range beside it."""
        at = np.linspace(self.low, self.high, 5)
        return {
            "reference_degC": self.reference,
            "range_degC": [self.low, self.high],
            "terms": [list(term) for term in self.terms],
            "names": list(names_of(self.terms)),
            "coefficients": self.coefficients.tolist(),
            "sd": self.sd.tolist(),
            "covariance": self.covariance.tolist(),
            "centre": self.centre.tolist(),
            "dof": self.dof,
            "bars_over_range": [
                {"degC": float(T)} | {k: v.tolist() for k, v in self.bars(T).items()}
                for T in at
            ],
        }

    def bars(self, temperature: float) -> dict[str, Float[Array, "3"]]:
        """Standard deviation of bias and scale at a temperature beside T_0's own."""
        powers = self.powers(np.array([temperature]))[0]
        k = len(self.terms)
        own = np.einsum("iaja->aij", self.covariance.reshape(k, 3, k, 3))
        found = {}
        for what in ("bias", "scale"):
            z = np.array([powers[j - 1] * (w == what) for w, j in self.terms])
            found[what] = np.sqrt(np.einsum("i,aij,j->a", z, own, z))
        return found

    def lines(self, size: Float[Array, "3"], unit: str) -> list[str]:
        """Describe the coefficients, a bias in `unit`, of which a raw unit has `size`.

        Of a scale in parts per million.
        """
        said = [
            f"in temperature    at {self.reference:.2f} degC, and in the difference "
            f"from it, seen from {self.low:.2f} to {self.high:.2f} degC:",
            "                  value           sd",
        ]
        for k, (what, power) in enumerate(self.terms):
            per = "K" if power == 1 else f"K^{power}"
            factor = np.full(3, 1e6) if what == "scale" else size
            of = f"{'ppm' if what == 'scale' else unit}/{per}"
            said += [
                f"  {what}_{a:4s} {factor[i] * self.coefficients[k, i]:12.6g} "
                f"{factor[i] * self.sd[k, i]:12.3g}   {of}"
                for i, a in enumerate("xyz")
            ]
        low, high = self.bars(self.low), self.bars(self.high)
        ends = max(float((x["bias"] * size).max()) for x in (low, high))
        said.append(
            f"                  a bias at either end is off by {ends:.2g} {unit} (sd) "
            "more than at the reference"
        )
        return said


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestTemperatures(ReadOnly):
    """Temperature of each rest.

    Attributes
    ----------
    mean : Array
        Degrees Celsius, (m,).
    change : Array
        From the first to the last row, by a line, K, (m,).
    spread : Array
        Variance within each, K^2, (m,).
    time : Array
        Middle of each rest, s, (m,).
    low, high : float
        Of all their rows, degrees Celsius.
    step : float
        Least difference between two values of the thermometer, K.
    by_force : float
        Share of their variance that follows the mean readings, 0 to 1.
    """

    mean: Float[Array, " m"]
    change: Float[Array, " m"]
    spread: Float[Array, " m"]
    time: Float[Array, " m"]
    low: float
    high: float
    step: float = 0.0
    by_force: float = 0.0

    @classmethod
    def of(
        cls,
        temperature: Float[Array, " n"],
        time: Float[Array, " n"],
        rests: Any,
        poses: Float[Array, "m 3"] | None = None,
    ) -> "RestTemperatures":
        """From the rows and the rests among them, and the mean readings in these.

        One or two wrong rows in a row (a bus that fails reads 85 or 0) are passed over.
        """
        rows = [
            scipy.ndimage.median_filter(temperature[a:b], _AROUND) for a, b in rests
        ]
        change = []
        for (a, b), own in zip(rests, rows, strict=True):
            x = time[a:b] - time[a:b].mean()
            square = float(x @ x)
            slope = x @ (own - own.mean()) / square if square > 0.0 else 0.0
            change.append(slope * np.ptp(time[a:b]))
        return cls(
            mean=np.array([own.mean() for own in rows]),
            change=np.array(change),
            spread=np.array([own.var() for own in rows]),
            time=np.array([time[a:b].mean() for a, b in rests]),
            low=float(min(own.min() for own in rows)),
            high=float(max(own.max() for own in rows)),
            step=float(np.diff(np.unique(np.concatenate(rows))).min(initial=np.inf)),
            by_force=_share([own.mean() for own in rows], poses),
        )

    @property
    def span(self) -> float:
        """Greatest less least mean, K."""
        return float(np.ptp(self.mean))

    @property
    def least_span(self) -> float:
        """Least span from which an effect can be told, K."""
        step = self.step if np.isfinite(self.step) else 0.0  # of one value
        return max(LEAST_SPAN, LEAST_STEPS * step)

    @property
    def reference(self) -> float:
        """Their mean, degrees Celsius."""
        return float(self.mean.mean())

    @property
    def powers(self) -> Float[Array, "m 2"]:
        """Means of tau and of its square over each rest."""
        tau = self.mean - self.reference
        return np.stack([tau, tau * tau + self.spread], axis=-1)

    @property
    def line(self) -> str:
        """The range, and how much it changes within a rest."""
        return (
            f"rests from {self.mean.min():.2f} to {self.mean.max():.2f} degC, within a "
            f"rest by {np.abs(self.change).max():.2g} K at most"
        )

    @property
    def monotone(self) -> str:
        """Say that it rises or falls with time, or nothing."""
        if len(self.mean) < 3 or not self.span > 0.0:
            return ""
        ranks = [scipy.stats.rankdata(x) for x in (self.mean, self.time)]
        found = float(np.corrcoef(*ranks)[0, 1])
        if not abs(found) > MONOTONE:
            return ""
        return (
            f"the temperature {'rises' if found > 0.0 else 'falls'} with time "
            f"(rank correlation {found:.2f}), so that a drift in time looks the same "
            "and cannot be told apart: cool down again in the same recording"
        )

    @property
    def confounded(self) -> str:
        """Say what else looks the same as an effect of temperature, or nothing."""
        if self.monotone or self.by_force < FOLLOWS:
            return self.monotone
        return (
            f"the temperature follows the direction of the force (R^2 "
            f"{self.by_force:.2f}), so that bias and scale in it hide each other and "
            "the parameters: take the poses in another order"
        )

    def refusal(self, left: int) -> str:
        """Say why no term can be told with so many degrees of freedom, or nothing."""
        if self.span < self.least_span:
            return (
                f"{self.least_span:g} K or more between rests are needed to tell an "
                "effect"
            )
        if left - 3 < LEAST_LEFT:
            return (
                f"{len(self.mean)} rests leave {left} degree(s) of freedom, and three "
                f"terms with {LEAST_LEFT} to spare need {3 + LEAST_LEFT}: add rests"
            )
        return ""


def _share(mean: Any, poses: Float[Array, "m 3"] | None) -> float:
    # of the variance of the temperatures, by a plane through the mean readings
    away = np.asarray(mean) - np.mean(mean)
    if poses is None or len(poses) < 8 or not away.any():
        return 0.0
    X = np.column_stack([np.ones(len(poses)), poses - poses.mean(axis=0)])
    left = away - X @ np.linalg.lstsq(X, away, rcond=None)[0]
    return float(1.0 - (left @ left) / (away @ away))


class ThermalChoice(NamedTuple):
    """Terms that the evidence bears, if any, and the fit with them."""

    thermal: Thermal | None
    reason: str
    theta: Float[Array, "9"]  # at the reference
    covariance: Float[Array, "9 9"]
    chi_square: float
    slopes: Float[Array, "n k"]  # of the distance of each pose by the coefficients


def following(terms: tuple[Term, ...]) -> list[tuple[Term, ...]]:
    """Sets of terms that may come next: a square only after its linear term.

    Bias and scale together as well, since each hides what the other explains.
    """
    free = [
        term
        for term in TERMS
        if term not in terms and (term[1] == 1 or (term[0], 1) in terms)
    ]
    pairs = [pair for pair in (TERMS[:2], TERMS[2:]) if set(pair) <= set(free)]
    more = [*((term,) for term in free), *pairs]
    return [tuple(t for t in TERMS if t in (*terms, *each)) for each in more]


def not_modelled(rests: RestTemperatures, why: str) -> str:
    """Sentence that the temperature changed and nothing is made of it, if it did."""
    if not rests.span > 0.0:
        return ""
    return f"temperature changed by {rests.span:.2f} K; not modelled because {why}"


def choose_thermal(
    poses: Float[Array, "n 3"],
    rests: RestTemperatures,
    *,
    start: Float[Array, "9"],
    model: str,
    g: float,
    std: Float[Array, " n"],
    known: bool,
) -> ThermalChoice:
    """Choose terms of a triad by the F test, and fit them with its parameters.

    Parameters
    ----------
    poses : Array
        Mean reading of each rest, raw units, (n, 3).
    rests : RestTemperatures
        Of these.
    start : Array
        Parameters without terms, (9,).
    model : str
        Form of the parameters.
    g : float
        Length of the vector, as corrected.
    std : Array
        Noise of each pose mean, raw units, (n,): its relative size where not known.
    known : bool
        Whether the noise is that, or has to be taken from the residuals.

    Returns
    -------
    ThermalChoice
        The terms, or why there are none.
    """
    count = len(poses)
    none = np.zeros((count, 0))
    empty = ThermalChoice(None, "", start, np.full((9, 9), np.nan), np.nan, none)
    why = rests.refusal(count - 9)
    if why:
        return empty._replace(reason=not_modelled(rests, why))
    terms, last, chance = _selected(poses, rests, start, model, g, std, known)
    if last is None or not terms:
        what = f"no term passes the F test ({FALSE_ALARM:g} by chance allowed)"
        what = what if last is not None else "a fit without terms does not converge"
        return empty._replace(reason=not_modelled(rests, what))
    dof = count - last.theta.size
    scale = last.square / dof
    thermal = Thermal(
        reference=rests.reference, low=rests.low, high=rests.high, terms=terms,
        coefficients=last.theta[9:].reshape(-1, 3),
        covariance=scale * last.covariance[9:, 9:], centre=last.theta[6:9], dof=dof,
    )  # fmt: skip
    kept = ", ".join(f"{what} {'linear' if j == 1 else 'square'}" for what, j in terms)
    reason = (
        f"terms in temperature: {kept}; without an effect the chance of the last is "
        f"{chance_words(chance, 2)} ({FALSE_ALARM:g} allowed)"
    )
    return ThermalChoice(
        thermal=thermal, reason=reason, theta=last.theta[:9],
        covariance=scale * last.covariance[:9, :9], chi_square=last.square,
        slopes=last.slopes[:, 9:],
    )  # fmt: skip


def _selected(
    poses: Float[Array, "n 3"],
    rests: RestTemperatures,
    start: Float[Array, "9"],
    model: str,
    g: float,
    std: Float[Array, " n"],
    known: bool,
) -> tuple[tuple[Term, ...], "_Fit | None", float]:
    # the terms that the F tests add, the fit with them, and the chance of the last
    terms: tuple[Term, ...] = ()
    last, said = _fitted(poses, rests, start, model, g, std, terms), 1.0
    while last is not None:
        tried: list[tuple[float, tuple[Term, ...], _Fit]] = []
        for wider in following(terms):
            more = 3 * (len(wider) - len(terms))
            free = len(poses) - last.theta.size - more
            if free < LEAST_LEFT:
                continue
            begin = _widened(last.theta, terms, wider)
            found = _fitted(poses, rests, begin, model, g, std, wider)
            if found is not None:
                drop = Drop(rest=found.square, dof=free, known=1.0 if known else None)
                tried.append((drop.chance(last.square, more), wider, found))
        if not tried:
            break
        chance, wider, best = min(tried, key=lambda each: each[0])
        if not chance < FALSE_ALARM / len(tried):
            break
        terms, last, said = wider, best, chance * len(tried)
    return terms, last, said


def _widened(
    theta: Float[Array, " p"], terms: tuple[Term, ...], wider: tuple[Term, ...]
) -> Float[Array, " q"]:
    # parameters with further terms of zero
    own = dict(zip(terms, theta[9:].reshape(-1, 3), strict=True))
    return np.concatenate([theta[:9], *(own.get(t, np.zeros(3)) for t in wider)])


class _Fit(NamedTuple):
    theta: Float[Array, " p"]
    covariance: Float[Array, "p p"]  # by the noise as it stands
    square: float
    slopes: Float[Array, "n p"]  # of distances, in the unit of the noise


def thermal_problem(
    poses: Float[Array, "t n 3"],
    powers: Float[Array, "n 2"],
    model: str,
    g: float,
    std: Float[Array, " n"],
    terms: tuple[Term, ...],
) -> Problem:
    """The equations of one triad with terms; without any those of `Accelerometer`."""
    floor = _FLOOR * float(np.abs(poses).max())
    noise = np.broadcast_to(np.maximum(std, floor)[:, None], poses.shape)
    return Problem(
        sensors=(
            ThermalTriad(
                readings=poses, std=noise, model=model, g=g, terms=terms, powers=powers
            ),
        )
    )


def _fitted(
    poses: Float[Array, "n 3"],
    rests: RestTemperatures,
    start: Float[Array, " p"],
    model: str,
    g: float,
    std: Float[Array, " n"],
    terms: tuple[Term, ...],
) -> _Fit | None:
    # None where the terms cannot be told from the parameters
    problem = thermal_problem(poses[None], rests.powers, model, g, std, terms)
    found = minimize(problem, start[None], _STEPS)
    covariance, pivot = found.here.covariance()
    if not (found.converged[0] and pivot[0] > 1e-10):  # of rounding: 1e-13
        return None
    return _Fit(
        found.theta[0], covariance[0], float(found.here.chi_square[0]),
        found.here.slopes[0],
    )  # fmt: skip
