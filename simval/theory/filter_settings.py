r"""Settings for a filter whose readings have errors that it does not know.

A filter that is told the true noise states a covariance that knows nothing of what a
calibration left (`simval.theory.filter_budget`). Told more, it states more, and leans
on its sensors otherwise. With factors x of the told noise, N and K of the gyroscope and
R of each vector sensor, eq. (F7) and (F8) give the error and NEES without a trial, and
the settings sought are

.. math:: \min_x \max_m \mathrm{rms}_m(x) \quad\text{with}\quad
   \mathrm{NEES}_{mp}(x) \le h, \quad \tfrac1M\sum_m \mathrm{NEES}_{mp}(x) \ge l,
   \tag{F16}

over M motions and parts p of their time, each a mean over rows from where the start is
forgotten; NEES is that of the attitude, 3 where all is true. All x are 1 or more: a
filter is not told less noise than there is. A covariance is honest where its NEES is in
the band from l to h.

**The search** is one of few variables: N and R of one vector sensor, the one by which a
grid of whole decades is best, then a third where it lowers the error by more than
`GAIN`. From the grid's best, sequential quadratic programming (D. Kraft, DFVLR-FB
88-28, 1988) goes on in decades, with the error's logarithm as one more variable above
those of all motions. The rows of a long path are taken k at a time, with
:math:`R/\sqrt k`: the same information, and an error of the order of the turn between.
What is answered is of the path as it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.arguments import instance, whole_number
from simval.arrays import Array, finite_array
from simval.errors import InputError
from simval.shapes import Float
from simval.theory.filter_budget import FilterPrediction, filter_prediction
from simval.theory.filter_model import (
    Error,
    FilterModel,
    FilterPath,
    RowError,
    check_errors,
)

Factors = Mapping[str, float]
"""Of the noise that is told: ``N``, ``K``, vector sensors by name; 1 where absent."""
NOISE: Final = "N"
WALK: Final = "K"
BAND: Final = (1.5, 3.3)
"""Of an honest NEES: deviations stated 5 % too small to 41 % too large."""
QUIET: Final = 1e-15  # rad/s/sqrt(Hz); its square over rows must not vanish
FINE: Final = 1e-8
"""Noise of a row over the vector: with less, information times a covariance of 1 is
beyond what 16 digits invert."""
GAIN: Final = 0.05
MOST: Final = 4.0  # decades of a factor
KEPT: Final = 250  # rows of a motion whose mean is taken
COARSE: Final = 1000  # rows of all motions together in a search
NEAR: Final = 0.02
"""Logarithm of the error by which rows taken together may differ from those of the
path; else the search goes on there."""
INSIDE: Final = 1e-3
"""Logarithm of NEES by which a search stays inside of the band."""
DECADE: Final = 0.005
"""Logarithm of the error that a decade of a factor must gain."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterCase:
    """A motion, with its sensors and the errors of their readings.

    Attributes
    ----------
    path : FilterPath
        The true motion.
    truth : FilterModel
        The true noise, sensors and start.
    errors : tuple of CalibrationError and RowError
        What the readings are off by and the filter does not know.
    settle : float
        Time at the start of which nothing is asked, s.

    Raises
    ------
    InputError
        If the gyroscope has no noise, or the motion is over when the start is.
    """

    path: FilterPath
    truth: FilterModel
    errors: tuple[Error, ...] = ()
    settle: float = 2.0

    def __post_init__(self) -> None:
        dt = instance("path", self.path, FilterPath).dt
        truth = instance("truth", self.truth, FilterModel)
        check_errors(self.errors, tuple(s.name for s in truth.sensors), len(dt))
        if not (N := np.min(truth.gyroscope_noise)) >= QUIET:
            msg = (
                f"`gyroscope_noise` is {N:g} rad/s/sqrt(Hz); a factor of it needs "
                f"{QUIET:g} or more, so check its unit"
            )
            raise InputError(msg)
        if not 0.0 <= self.settle < dt[:-1].sum():
            msg = (
                f"`settle` is {self.settle:g} s and the motion lasts "
                f"{dt.sum():.4g} s; leave out less, or give a longer motion"
            )
            raise InputError(msg)

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the noises whose settings may be raised."""
        walk = (WALK,) * bool(np.all(self.truth.gyroscope_walk > 0.0))
        return (NOISE, *(each.name for each in self.truth.sensors), *walk)

    def told(self, factors: Factors) -> FilterModel:
        """The model that a filter is given."""
        truth = self.truth
        return replace(
            truth,
            gyroscope_noise=factors.get(NOISE, 1.0) * truth.gyroscope_noise,
            gyroscope_walk=factors.get(WALK, 1.0) * truth.gyroscope_walk,
            sensors=tuple(
                replace(s, std=factors.get(s.name, 1.0) * s.std) for s in truth.sensors
            ),
        )

    def prediction(self, factors: Factors) -> FilterPrediction:
        """Error and NEES with some settings, at rows spread over the time."""
        rows = np.flatnonzero(np.cumsum(self.path.dt) > self.settle)
        some = np.unique(np.linspace(0, len(rows) - 1, KEPT).round().astype(np.intp))
        return filter_prediction(
            self.path, self.truth, told=self.told(factors), errors=self.errors,
            keep=rows[some],
        )  # fmt: skip

    def scaled(self, by: Factors) -> "FilterCase":
        """The same case with noises or errors scaled, by name."""
        errors = tuple(each.times(by.get(each.name, 1.0)) for each in self.errors)
        return replace(self, truth=self.told(by), errors=errors)

    def coarse(self, rows: int) -> "FilterCase":
        """The same case with about so many rows, each worth several."""
        k = max(1, len(self.path.dt) // rows)
        T = len(self.path.dt) // k
        sensors = (replace(s, std=s.std / np.sqrt(k)) for s in self.truth.sensors)
        return replace(
            self,
            path=FilterPath(
                dt=self.path.dt[: T * k].reshape(T, k).sum(axis=1),
                attitude=self.path.attitude[: T * k + 1 : k],
            ),
            truth=replace(self.truth, sensors=tuple(sensors)),
            errors=tuple(
                replace(e, rows=e.rows[: T * k].reshape(T, k, 3).mean(axis=1))
                if isinstance(e, RowError)
                else e
                for e in self.errors
            ),
        )


class FilterEffect(NamedTuple):
    """What a filter achieves on some motions, each a mean over its rows."""

    rms: Float[Array, " m"]  # of the attitude's error per axis, rad, by motion
    nees: Float[Array, "m p"]  # by motion and part of its time; 3 where all is true
    # error over what is stated, about the axes where that is least and greatest
    axes: Float[Array, "m 2"]
    # error by source, rad per axis, over all motions; the squares add up
    sources: Mapping[str, float]

    @property
    def overstated(self) -> float:
        """Largest ratio of the stated to the real error about any axis."""
        return float(1.0 / self.axes[:, 0].min())

    @property
    def worst(self) -> float:
        """Largest error on any motion, rad."""
        return float(self.rms.max())

    def as_object(self) -> dict[str, Any]:
        """Return the effect as plain JSON values."""
        axes = [self.axes[:, 0].min(), self.axes[:, 1].max()]
        return {"rms": self.worst, "nees": self.nees.tolist(), "axes": axes}

    def excess(self, band: tuple[float, float]) -> Float[Array, " c"]:
        """How far NEES is outside a band, as logarithms; 0 or less is inside."""
        low, high = np.log(band)
        above = np.log(self.nees.ravel()) - high
        return np.append(above, low - np.log(self.nees.mean(axis=0)))


def effect(
    cases: Sequence[FilterCase], factors: Factors, parts: int = 1
) -> FilterEffect:
    """Predict what some settings achieve.

    Parameters
    ----------
    cases : sequence of FilterCase
        The motions.
    factors : mapping
        Of the noise that is told.
    parts : int, default 1
        Parts of a motion, equal in time, whose NEES is told apart.

    Returns
    -------
    FilterEffect
        Error and NEES by motion, and the error by source.

    Raises
    ------
    InputError
        If what the filter states has no inverse.
    """
    whole_number("parts", parts, 1, KEPT)
    rms, nees, axes = [], [], []
    squares: dict[str, float] = {}
    for case in cases:
        found = case.prediction(factors)
        try:
            white = np.linalg.inv(np.linalg.cholesky(found.told[:, :3, :3]))
        except np.linalg.LinAlgError:
            msg = (
                "the noises are so far apart that what the filter states has no "
                "inverse in 16 digits; check their units, and those of the log"
            )
            raise InputError(msg) from None
        seen = white @ found.second_moment[:, :3, :3] @ white.swapaxes(1, 2)
        axes.append(np.sqrt(np.linalg.eigvalsh(seen)[:, [0, 2]].mean(axis=0)))
        rms.append(np.sqrt(np.mean(found.rms() ** 2)))
        nees.append([each.mean() for each in np.array_split(found.nees(3), parts)])
        P = np.trace(found.parts[:, :, :3, :3], axis1=2, axis2=3).mean(axis=1) / 3.0
        own = [*P.tolist(), float(np.mean(found.mean[:, :3] ** 2))]
        for name, square in zip((*found.names, "disturbance"), own, strict=True):
            squares[name] = squares.get(name, 0.0) + square / len(cases)
    sources = {name: float(np.sqrt(square)) for name, square in squares.items()}
    return FilterEffect(np.array(rms), np.array(nees), np.array(axes), sources)


class FilterSettings(NamedTuple):
    """Settings that were found, and what they achieve."""

    factors: dict[str, float]
    effect: FilterEffect
    honest: bool


def honest_settings(
    cases: Sequence[FilterCase],
    *,
    band: tuple[float, float] = BAND,
    parts: int = 1,
    start: Factors | None = None,
) -> FilterSettings:
    """Find the settings of least error whose NEES is in a band, eq. (F16).

    Parameters
    ----------
    cases : sequence of FilterCase
        The motions, of the same sensors; the worst of them counts.
    band : (float, float)
        Least and greatest NEES of an honest covariance.
    parts : int, default 1
        Parts of each motion, equal in time, in each of which it must hold.
    start : mapping, optional
        Settings of a like case: their variables alone are then searched, from there.

    Returns
    -------
    FilterSettings
        If none is honest, those that are least out of the band.

    Raises
    ------
    InputError
        If there is no motion, the sensors differ or have no noise, or the band is none.
    """
    if not cases or len({instance("cases", c, FilterCase).factors for c in cases}) > 1:
        msg = "`cases` must be one motion or more, all of the same sensors"
        raise InputError(msg)
    low, high = finite_array("band", band, (2,)).tolist()
    if not 0.0 < low < high:
        msg = f"`band` is {low:g} to {high:g}; give a least NEES above 0 and a greatest"
        raise InputError(msg)
    for each in (sensor for case in cases for sensor in case.truth.sensors):
        ratio = np.min(each.std) / np.linalg.norm(each.reference)
        if not ratio >= FINE:
            msg = (
                f"the noise of the {each.name} is {ratio:.2g} of its reading; it "
                f"must be {FINE:g} or more, so check its unit"
            )
            raise InputError(msg)
    few = [case.coarse(max(1, COARSE // len(cases))) for case in cases]
    search, whole = (_Search(each, (low, high), parts) for each in (few, cases))
    rough = search.all() if start is None else search.local(search.at(start))
    best = whole.at(rough.factors)
    if best.excess.max() > 0.0 or np.abs(best.rms - rough.rms).max() > NEAR:
        best = whole.local(best)
    found = effect(cases, best.factors, parts)
    return FilterSettings(best.factors, found, bool(best.excess.max() <= 0.0))


class _Point(NamedTuple):
    factors: dict[str, float]
    rms: Float[Array, " m"]  # logarithms
    excess: Float[Array, " c"]

    def rank(self) -> tuple[float, float]:
        """Sort key: excess over the band, then the error plus a little for factors."""
        spread = sum(np.log10([*self.factors.values()]))
        return max(0.0, self.excess.max()), float(self.rms.max()) + DECADE * spread

    def penalty(self) -> float:
        """One number to minimise: the excess over the band, plus the error."""
        return sum(self.rank())


@dataclass(frozen=True)
class _Search:
    """Search for settings in a band, which computes nothing twice."""

    cases: Sequence[FilterCase]
    band: tuple[float, float]
    parts: int
    seen: dict[frozenset[tuple[str, float]], tuple[Array, Array]] = field(
        default_factory=dict
    )

    def at(self, factors: Factors) -> _Point:
        key = frozenset((n, f) for n, f in factors.items() if f != 1.0)
        if key not in self.seen:
            found = effect(self.cases, factors, self.parts)
            self.seen[key] = np.log(found.rms), found.excess(self.band)
        return _Point(dict(factors), *self.seen[key])

    def all(self) -> _Point:
        """Search a grid, then two noises, and a third if that helps."""
        _, *others = self.cases[0].factors
        grids = {s: self.grid(s) for s in others if s != WALK}
        sensor = min(grids, key=lambda s: grids[s][0].penalty())
        two = min(map(self.local, grids[sensor]), key=_Point.rank)
        thirds = []
        for third in (each for each in others if each != sensor):
            thirds.append(self.at(two.factors | {third: 2.0}))
            thirds += self.grid(sensor, third) if third != WALK else []
        best = min([two, *map(self.local, thirds)], key=_Point.rank)
        (out, error), (left, less) = two.rank(), best.rank()
        return best if left < out or less < error + np.log1p(-GAIN) else two

    def grid(self, *sensors: str) -> list[_Point]:
        """The best whole decades near the band, and the best within it."""
        whole = [10.0**a for a in np.arange(MOST)]
        pairs = ({NOISE: a} | dict.fromkeys(sensors, b) for a in whole for b in whole)
        points = [self.at(each) for each in pairs]
        near, within = (min(points, key=k) for k in (_Point.penalty, _Point.rank))
        return [near] if near.factors == within.factors else [near, within]

    def local(self, start: _Point) -> _Point:
        """Settings of least error within the band, or nearest to it, from a start."""
        names, n, mine = tuple(start.factors), len(start.factors), [start]

        def room(x: Float[Array, " n"], inward: bool) -> Float[Array, " c"]:
            factors = 10.0 ** np.clip(x[:n], 0.0, MOST)
            found = self.at(dict(zip(names, factors.tolist(), strict=True)))
            mine.append(found)
            if inward:
                return np.asarray(x[n] - found.excess)
            return np.append(-found.excess - INSIDE, x[n] - found.rms)

        for inward in (False, True, False):
            best = min(mine, key=_Point.rank)
            top = (best.excess if inward else best.rms).max()
            scipy.optimize.minimize(
                lambda x: x[n] + DECADE * x[:n].sum(),
                np.append(np.log10([*best.factors.values()]), top),
                method="SLSQP",
                bounds=[(0.0, MOST)] * n + [(None, None)],
                constraints={"type": "ineq", "fun": room, "args": (inward,)},
                options={"maxiter": 12, "ftol": 1e-3, "eps": 1e-3},
            )
            if (min(mine, key=_Point.rank).rank()[0] == 0.0) != inward:
                break
        return min(mine, key=_Point.rank)
