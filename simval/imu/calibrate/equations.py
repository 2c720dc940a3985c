r"""The calibration core: residuals of sensors that share rests, linearised.

**Blocks.** A triad of axes that reads :math:`y_i` in rest i tells the vector

.. math:: w_i = M(\theta)\,(y_i - b),  \tag{M1}

u of an accelerometer and v of a magnetometer, in units where gravity and the strength
of the field are 1. The *equations* of a sensor say what the vectors of a rest fulfil in
any attitude: :math:`|u|^2 - 1 = 0` of an accelerometer, and of a magnetometer beside it
:math:`|v|^2 - 1 = 0` and :math:`u^T v + s = 0, s = \sin(\mathrm{dip})`, because the
specific force points up and the field below the horizon by the dip. A gyroscope
compares the vectors of neighbouring rests (`gyroscope.residuals`). By the chain rule
through the vectors every row c has a derivative J by all parameters and a map L from
the unit noises :math:`\xi` of each sensor s,

.. math:: c \approx J\,\mathrm{d}\theta + \sum_s L_s \xi_s, \qquad
   V = \sum_s L_s L_s^T.  \tag{M4}

A mean stands in all rows of its rest, and of the turns before and after it, with the
same noise, so it is counted once. Knowledge from elsewhere enters as rows of a prior.
A sensor that is left out leaves its columns and its equations out; nothing else
changes.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from simval.arrays import Array, outer
from simval.imu.calibrate.goodness_of_fit import Beside
from simval.imu.calibrate.solver import Trials
from simval.imu.sensor import forms
from simval.moments import deviations
from simval.shapes import Float
from simval.vocabulary import Model

FIELD_NAMES = (*(f"M_{a}{b}" for a in "xyz" for b in "xyz"), "b_x", "b_y", "b_z", "dip")
"""Of a magnetometer's parameters: M row by row, b, and the dip."""


Variances = Mapping[tuple[str, str], float]
"""Variances of errors beside the stated noise, by cause and kind."""


def _products(u: Array, v: Array) -> Array:
    # scalar products, of complex numbers without a conjugate
    return np.einsum("...i,...i", u, v)


class Equation(NamedTuple):
    """One equation for each rest, whose value is zero but for errors."""

    value: Array  # (t, n)
    by: dict[str, Array]  # slopes by the vector of each triad, (t, n, 3)
    own: Any = None  # by parameters of the sensor that are not in its vector, (t, n, q)
    noise: Any = None  # by unit noises that are not in its vector, (t, n, m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrected:
    """Corrected vectors of a triad, with what the chain rule needs."""

    w: Float[Array, "t n 3"]
    x: Float[Array, "t n 3"]  # readings less the bias
    matrix: Float[Array, "t 3 3"]
    # derivatives by the parameters of a form; None: by each entry of the matrix
    slopes: Callable[[], Float[Array, "t 6 3 3"]] | None
    std: Float[Array, "t n 3"]

    def pull(
        self, a: Float[Array, "t k e 3"], rests: Any = slice(None)
    ) -> tuple[Float[Array, "t k e q"], Float[Array, "t k e 3"]]:
        """Derivatives of a'w at some rests by the parameters and by unit noises."""
        x, t = self.x[:, rests], len(a)
        back = (a.reshape(t, -1, 3) @ self.matrix).reshape(a.shape)
        own = 9 if self.slopes is None else 6
        by = np.empty((*a.shape[:-1], own + 3))
        by[..., own:] = -back
        if self.slopes is None:
            for k in range(3):
                by[..., k:own:3] = a * x[:, :, None, k : k + 1]
        else:
            turned = self.slopes().reshape(t, 18, 3).mT
            moved = (x @ turned).reshape(*x.shape[:2], 6, 3)
            by[..., :own] = a @ moved.mT
        return by, back * self.std[:, rests, None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensor:
    """A sensor read at rest, with its block of parameters and its equations."""

    readings: Float[Array, "t n m"]  # means over the rests
    std: Float[Array, "t n m"]  # noise of each

    name: ClassVar[str]
    size: ClassVar[int]  # parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(f"parameter {k}" for k in range(self.size))

    def corrected(self, theta: Array) -> "Corrected | None":
        """Corrected vectors of a triad; None for a sensor that is not a triad."""
        return None

    def equations(self, w: dict[str, Array], theta: Array) -> list[Equation]:
        """Equations that the vectors of a rest fulfil in every attitude."""
        raise NotImplementedError

    def take(self, trials: Any, rests: Any = slice(None)) -> Self:
        """Select trials, and rests of them."""
        readings, std = self.readings[trials][:, rests], self.std[trials][:, rests]
        return replace(self, readings=readings, std=std)

    def beside(self, variances: Variances) -> Self:
        """The same sensor with extra noise, in multiples of its own variance."""
        more = variances[self.name, "noise"]
        return replace(self, std=self.std * np.sqrt(1.0 + more))

    def _triad(self, matrix: Array, bias: Array, slopes: Any = None) -> Corrected:
        x = self.readings - bias[:, None]
        w = x @ matrix.mT
        return Corrected(w=w, x=x, matrix=matrix, slopes=slopes, std=self.std)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accelerometer(Sensor):
    """The accelerometer; the form of its matrix fixes the axes of all sensors."""

    model: Model
    g: float = 1.0

    name: ClassVar[str] = "accelerometer"
    size: ClassVar[int] = 9

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the form's parameters."""
        return forms.names(self.model)

    def corrected(self, theta: Float[Array, "t 9"]) -> Corrected:
        """The specific force of each rest over gravity."""
        matrix = forms.matrix(self.model, theta) / self.g
        return self._triad(
            matrix,
            theta[:, 6:],
            lambda: forms.matrix_derivatives(self.model, theta) / self.g,
        )

    def equations(self, w: dict[str, Array], theta: Array) -> list[Equation]:
        """One equation: the specific force has the length of gravity."""
        u = w[self.name]
        return [Equation(_products(u, u) - 1.0, {self.name: 2.0 * u})]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldAccelerometer(Accelerometer):
    """An accelerometer whose parameters are taken, with errors, from its own fit."""

    theta: Float[Array, "t 9"]
    error: Float[Array, "t 9 x"]  # of theta, by the unit noises of all rests

    size: ClassVar[int] = 0

    def corrected(self, theta: Array) -> Corrected:
        """The specific force of each rest over gravity."""
        return Accelerometer.corrected(self, self.theta)

    def equations(self, w: dict[str, Array], theta: Array) -> list[Equation]:
        """No equations, as the accelerometer's own fit has used them."""
        return []

    def take(self, trials: Any, rests: Any = slice(None)) -> Self:
        """Select trials; all rests stay, as their noise is in the parameters."""
        return replace(
            self, readings=self.readings[trials], std=self.std[trials],
            theta=self.theta[trials], error=self.error[trials],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Magnetometer(Sensor):
    """M row by row and b, on the accelerometer's axes, and the sine of the dip."""

    name: ClassVar[str] = "magnetometer"
    size: ClassVar[int] = 13

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries of M row by row, of b, and of the dip."""
        return FIELD_NAMES

    def corrected(self, theta: Float[Array, "t 13"]) -> Corrected:
        """The field of each rest over its strength."""
        return self._triad(theta[:, :9].reshape(-1, 3, 3), theta[:, 9:12])

    def equations(self, w: dict[str, Array], theta: Array) -> list[Equation]:
        """Two equations: the length of the field, and its angle with gravity."""
        up, v = w["accelerometer"], w[self.name]
        dip = _products(up, v) + theta[:, -1:]
        return [
            Equation(_products(v, v) - 1.0, {self.name: 2.0 * v}),
            Equation(dip, {"accelerometer": v, self.name: up}, own=np.eye(13)[-1]),
        ]


@runtime_checkable
class Turns(Protocol):
    """A sensor that is read between rests: rows that connect their vectors."""

    name: ClassVar[str]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""

    @property
    def size(self) -> int:
        """Number of parameters."""

    @property
    def item(self) -> tuple[int, int]:
        """Number of rotations, and of rows for each; they come first of all rows."""

    def rows(self, at: dict[str, Corrected], theta: Array) -> "Between":
        """Rows of the rotations, linearised at some parameters."""

    def values(self, at: dict[str, Corrected], theta: Array, here: Any) -> Array:
        """Values of the rows at other parameters, in the axes of a linearisation."""

    def take(self, trials: Any) -> Self:
        """Select trials."""

    def errors(self, at: dict[str, Corrected], theta: Array) -> tuple[Beside, ...]:
        """Possible errors beyond the noise, each of variance 1, in the rows."""

    def beside(self, variances: Variances) -> Self:
        """The same sensor with such errors added to its noise."""


class Between(NamedTuple):
    """Rows of the rotations between rests, linearised at some parameters."""

    r: Float[Array, "t r"]
    own: Float[Array, "t r q"]  # by the parameters of the sensor itself
    by: dict[str, tuple[Array, Array]]  # of each triad: J (t, r, q) and L (t, r, n, 3)
    V: Float[Array, "t r r"]  # of its own noise
    axes: Any  # in which vectors are compared
    whole: Array  # by what the sensor could have as parameters, (t, r, q)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior(Trials):
    """Prior knowledge of the parameters: R (theta - theta_0) is standard normal."""

    theta: Float[Array, "t p"]  # theta_0
    root: Float[Array, "t k p"]  # R


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Sensors that are fitted to the same rests, the accelerometer first."""

    sensors: tuple[Sensor, ...]
    turns: Turns | None = None
    prior: Prior | None = None
    weighted: bool = True  # by the noise; else rows of turns count alike

    @property
    def accelerometer(self) -> Accelerometer:
        """The first of the sensors."""
        assert isinstance(self.sensors[0], Accelerometer)
        return self.sensors[0]

    @property
    def magnetometer(self) -> Magnetometer:
        """The second of the sensors, if it is a magnetometer."""
        assert isinstance(self.sensors[1], Magnetometer)
        return self.sensors[1]

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Indices of the parameters of each sensor."""
        sizes = {each.name: each.size for each in self.sensors}
        if self.turns is not None:
            sizes[self.turns.name] = self.turns.size
        return _slices(sizes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, prefixed by the sensor from the second one on."""
        named = [(each.name, each.names) for each in self.sensors[1:]]
        if self.turns is not None:
            named.append((self.turns.name, self.turns.names))
        told = (f"{sensor} {name}" for sensor, names in named for name in names)
        return (*self.sensors[0].names, *told)

    @cached_property
    def noises(self) -> dict[str, slice]:
        """Indices of each sensor's unit noises among those of a rest."""
        return _slices({each.name: each.std.shape[-1] for each in self.sensors})

    def take(self, trials: Any, rests: Any = slice(None)) -> "Problem":
        """Select trials; rests as well where there are no rotations."""
        return replace(
            self,
            sensors=tuple(each.take(trials, rests) for each in self.sensors),
            turns=None if self.turns is None else self.turns.take(trials),
            prior=None if self.prior is None else self.prior.take(trials),
        )

    def beside(self, variances: Variances) -> "Problem":
        """The same problem with errors of such variances added to the noise."""
        sensors = tuple(each.beside(variances) for each in self.sensors)
        turns = None if self.turns is None else self.turns.beside(variances)
        return replace(self, sensors=sensors, turns=turns)

    def corrected(self, theta: Float[Array, "t p"]) -> dict[str, Corrected]:
        """Corrected vectors of each triad, by its name."""
        at = self.columns
        seen = {s.name: s.corrected(theta[:, at[s.name]]) for s in self.sensors}
        return {name: each for name, each in seen.items() if each is not None}

    def equations(
        self, at: dict[str, Corrected], theta: Float[Array, "t p"]
    ) -> list[tuple[Sensor, Equation]]:
        """The equations of a rest, each with its sensor."""
        w, columns = {name: each.w for name, each in at.items()}, self.columns
        return [
            (sensor, each)
            for sensor in self.sensors
            for each in sensor.equations(w, theta[:, columns[sensor.name]])
        ]

    def local(self, theta: Float[Array, "t p"]) -> "Whitened":
        """The whitened rows and their derivatives at some parameters."""
        at = self.corrected(theta)
        c, J, L = self.rests(at, theta)
        t, p = theta.shape
        axes: Array = np.zeros((t, 0, 0))
        own = whole = axes
        if self.turns is None:
            white = _whitener(L)
        else:
            between = self.turns.rows(at, theta[:, self.columns[self.turns.name]])
            axes, own, whole = between.axes, between.V, between.whole
            c, J, L = self._joined(between, c, J, L)
            V = _own_added(L, own)
            if self.weighted:
                white = _inverse_root(V)
            else:
                scale = np.sqrt(np.linalg.diagonal(V).mean(axis=1))
                white = np.eye(V.shape[1]) / scale[:, None, None]
        slopes = (white @ J).reshape(t, -1, p)
        if self.prior is not None:
            slopes = np.concatenate([slopes, self.prior.root], axis=1)
        rows = self._whitened(c, theta, white)
        return Whitened(
            at=at, rows=rows, slopes=slopes, L=L, white=white, axes=axes, own=own,
            whole=whole,
        )  # fmt: skip

    def values(
        self, theta: Float[Array, "t p"], here: "Whitened"
    ) -> Float[Array, "t r"]:
        """The rows at other parameters, whitened as in a linearisation."""
        at = self.corrected(theta)
        c = self._stacked(self.equations(at, theta), len(theta))
        if self.turns is not None:
            own = theta[:, self.columns[self.turns.name]]
            turned = self.turns.values(at, own, here.axes)
            c = np.concatenate([turned, c.reshape(len(c), c[0].size)], axis=1)
        return self._whitened(c, theta, here.white)

    def _stacked(self, told: list[Any], trials: int) -> Float[Array, "t n e"]:
        if not told:
            return np.zeros((trials, self.sensors[0].readings.shape[1], 0))
        return np.stack([each.value for _, each in told], axis=-1)

    def _whitened(self, c: Array, theta: Array, white: Array) -> Float[Array, "t r"]:
        rows = np.matvec(white, c).reshape(len(theta), -1)
        if self.prior is None:
            return rows
        off = np.matvec(self.prior.root, theta - self.prior.theta)
        return np.concatenate([rows, off], axis=1)

    def rests(
        self, at: dict[str, Corrected], theta: Array
    ) -> tuple[Array, Array, Array]:
        """Values, derivatives and noise of the rests' equations, before whitening."""
        told = self.equations(at, theta)
        c = self._stacked(told, len(theta))
        J = np.zeros((*c.shape, theta.shape[1]))
        L = np.zeros((*c.shape, sum(each.std.shape[-1] for each in self.sensors)))
        for name, own in at.items():
            rows = [k for k, (_, each) in enumerate(told) if name in each.by]
            if not rows:
                continue
            a = np.stack([told[k][1].by[name] for k in rows], axis=2)
            by_theta, by_noise = own.pull(a)
            first = self.columns[name].start
            last = first + by_theta.shape[-1]
            for i, k in enumerate(rows):
                J[:, :, k, first:last] = by_theta[:, :, i]
                L[:, :, k, self.noises[name]] = by_noise[:, :, i]
        for k, (sensor, row) in enumerate(told):
            if row.own is not None:
                J[:, :, k, self.columns[sensor.name]] += row.own
            if row.noise is not None:
                L[:, :, k, self.noises[sensor.name]] += row.noise
        return c, J, L

    def _joined(
        self, between: Between, c: Array, J: Array, L: Array
    ) -> tuple[Array, Array, Array]:
        # rows of the turns, then those of all rests
        t, n, e, m = L.shape
        first = between.r.shape[1]
        slopes = np.zeros((t, first + n * e, J.shape[-1]))
        slopes[:, :first, -between.own.shape[-1] :] = between.own  # they come last
        slopes[:, first:] = J.reshape(t, n * e, J.shape[-1])
        noise = np.zeros((t, first + n * e, n, m))
        noise[:, first:] = spread(L)
        for sensor in self.sensors:
            if sensor.name not in between.by:
                continue
            by_theta, by_noise = between.by[sensor.name]
            if isinstance(sensor, HeldAccelerometer):
                by_noise = by_noise + (by_theta @ sensor.error).reshape(by_noise.shape)
            else:
                start = self.columns[sensor.name].start
                slopes[:, :first, start : start + by_theta.shape[-1]] = by_theta
            noise[:, :first, :, self.noises[sensor.name]] = by_noise
        rows = np.concatenate([between.r, c.reshape(t, n * e)], axis=1)
        return rows, slopes, noise


def _slices(sizes: dict[str, int]) -> dict[str, slice]:
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return dict(zip(sizes, map(slice, ends[:-1], ends[1:]), strict=True))


def spread(blocks: Float[Array, "t n e m"]) -> Float[Array, "t r n m"]:
    """Rows by the noises of all, from those of each rest or rotation by its own."""
    t, n, e, m = blocks.shape
    result, each = np.zeros((t, n, e, n, m)), np.arange(n)
    result[:, each, :, each] = np.moveaxis(blocks, 1, 0)
    return result.reshape(t, n * e, n, m)


class Whitened(NamedTuple):
    """Whitened rows at some parameters: of rotations, rests and the prior."""

    at: dict[str, Corrected]
    rows: Float[Array, "t r"]
    slopes: Float[Array, "t r p"]
    # by unit noises, not whitened: of each rest, (t, n, e, m), or with turns of all
    # rows, (t, r, n, m)
    L: Array
    white: Array  # of each rest, (t, n, e, e), or of all rows with turns, (t, r, r)
    # of the turns, and empty without: the axes in which vectors are compared, the
    # covariance of their own noise, and the rows by all that their sensor could have
    axes: Array
    own: Float[Array, "t b b"]
    whole: Float[Array, "t e q"]

    @property
    def normal(self) -> Float[Array, "t p p"]:
        """Fisher information of all rows, J'J."""
        return self.slopes.mT @ self.slopes

    @property
    def information(self) -> Float[Array, "n p p"]:
        """Information of each rest of the first trial, which a plan adds up."""
        _, n, e, _ = self.white.shape
        slopes = self.slopes[0, : n * e].reshape(n, e, -1)
        return slopes.mT @ slopes

    @property
    def sd(self) -> Float[Array, "t p"]:
        """Standard deviation of each parameter; without noise, its Cramér-Rao bound."""
        return deviations(self.covariance()[0])

    @property
    def chi_square(self) -> Float[Array, " t"]:
        """Weighted sum of the squared residuals."""
        return np.vecdot(self.rows, self.rows)

    def covariance(self) -> tuple[Float[Array, "t p p"], Float[Array, " t"]]:
        """Inverse of the information, and its least pivot: 0 without full rank."""
        normal, size = self._scaled()
        root = _inverse_root(normal)
        covariance = root.mT @ root / outer(size, size)
        with np.errstate(divide="ignore"):
            pivot = 1.0 / np.linalg.diagonal(root).max(axis=1) ** 2
        return covariance, np.where(np.isfinite(pivot), pivot, 0.0)

    def sandwich(self) -> tuple[Float[Array, "t p p"], Array, Float[Array, " t"]]:
        """Covariance of the estimate, its change by unit noises, and chi-square.

        Of rows with turns, whatever their weights.
        """
        V = _own_added(self.L, self.own)
        K = -self.covariance()[0] @ self.slopes.mT @ self.white
        raw = solved(self.white, self.rows)
        root = np.matvec(_inverse_root(V), raw)
        by_noise = K @ self.L.reshape(*self.L.shape[:2], -1)
        return K @ V @ K.mT, by_noise, np.vecdot(root, root)

    def ended(self, trials: Any, rows: Float[Array, "t r"]) -> dict[str, Array]:
        """Results of some trials that have ended, with the rows of their last step."""
        named = ("slopes", "L", "white", "axes", "own", "whole")
        return {"rows": rows[trials]} | {k: getattr(self, k)[trials] for k in named}

    def step(
        self, rows: Float[Array, "t r"], damping: Float[Array, " t"]
    ) -> Float[Array, "t p"]:
        """The Gauss-Newton step, damped on the diagonal; NaN without full rank."""
        normal, size = self._scaled()
        diagonal = np.einsum("tii->ti", normal)
        diagonal *= 1.0 + damping[:, None]
        gradient = np.vecmat(rows, self.slopes) / size
        return -solved(normal, gradient) / size

    def _scaled(self) -> tuple[Float[Array, "t p p"], Float[Array, "t p"]]:
        # the information with columns of equal length, and these
        normal = self.normal
        size = np.sqrt(np.linalg.diagonal(normal))
        return normal / outer(size, size), size


def _own_added(L: Float[Array, "t r n m"], own: Array) -> Float[Array, "t r r"]:
    # covariance of rows by unit noises, and of the noise of the first of them
    noise, first = L.reshape(*L.shape[:2], -1), own.shape[1]
    V = noise @ noise.mT
    V[:, :first, :first] += own
    return V


def _whitener(L: Float[Array, "t n e m"]) -> Float[Array, "t n e e"]:
    # lower triangular W that makes the noise of each rest one: the rows of WL are
    # those of L, each made orthogonal to the earlier ones; rests are next to each other
    # in memory
    rows, e = np.moveaxis(L, (2, 3), (0, 1)).copy(), L.shape[2]
    white = np.zeros((e, e, *L.shape[:2]))
    for i in range(e):
        white[i, i] = 1.0
        for j in range(i):
            share = (rows[i] * rows[j]).sum(axis=0)
            rows[i] -= share * rows[j]
            white[i] -= share * white[j]
        size = np.sqrt((rows[i] * rows[i]).sum(axis=0))
        rows[i] /= size
        white[i] /= size
    return np.ascontiguousarray(np.moveaxis(white, (0, 1), (2, 3)))


def _each(of: Callable[..., Array], *stacks: Array) -> Array:
    # a function of stacks of matrices, and NaN for those that it refuses
    try:
        return of(*stacks)
    except np.linalg.LinAlgError:
        results = np.full(stacks[-1].shape, np.nan)
    for k in range(len(results)):
        with suppress(np.linalg.LinAlgError):
            results[k] = of(*(stack[k : k + 1] for stack in stacks))[0]
    return results


def _inverse_root(matrices: Float[Array, "t r r"]) -> Float[Array, "t r r"]:
    # R of the inverses R'R, lower triangular; NaN where a matrix is not positive
    return _each(lambda N: _inverse_triangle(np.linalg.cholesky(N)), matrices)


def _inverse_triangle(lower: Float[Array, "t r r"]) -> Float[Array, "t r r"]:
    # by halves: products of matrices are most of the work, and four times as fast
    half = lower.shape[-1] // 2
    if half < 8:
        return np.linalg.inv(lower)
    result = np.zeros(lower.shape)
    first, last = slice(None, half), slice(half, None)
    for own in (first, last):
        result[:, own, own] = _inverse_triangle(lower[:, own, own])
    moved = lower[:, last, first] @ result[:, first, first]
    result[:, last, first] = -result[:, last, last] @ moved
    return result


def solved(
    matrices: Float[Array, "t p p"], right: Float[Array, "t p"]
) -> Float[Array, "t p"]:
    """Solutions of linear systems, NaN where a matrix is singular."""
    return _each(np.linalg.solve, matrices, right[..., None])[..., 0]
