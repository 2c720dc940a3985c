r"""Singular cases: how each remedy does near attitudes where the plain formula fails.

Without noise :math:`\bar q = (e^T n) q`, :math:`n = r_1 \times r_2`, so the formula is
singular where the axis lies in the plane of the references: the source's cases A to D
(`simval.imu.attitude.singular`). A cell is an attitude of one case, with the scalar
part :math:`s_0`, turned about n until :math:`|\bar q|` is `distance` times the noise,

.. math:: \varphi = 2 \arcsin \frac{|\bar q|}{|n|\, s_0}.  \tag{SC1}

Every remedy estimates from the same noisy vectors. The error is the chord
:math:`2 \sin(\theta/2)` of its angle, blind to the sign of a quaternion, with the mean
square :math:`4 (1 - q^T E[\hat q \hat q^T] q)`. Of a fixed frame this is exact
(`simval.theory.exact`), however near the singular set; best of four and sequential
rotations have a fixed frame where it leads by `MARGIN` deviations. The others are
predicted to first order, Table 1 on the singular set alone, and cubature at the noise
and at half of it says what that leaves out.

The noise is of one of the kinds of `simval.studies.noise_kinds`, and the vectors are
taken as they are or normalised. To first order normalised vectors have the noise across
them alone. A fixed frame has no exact answer then, nor under heavy tails: it is
predicted to first order as the others are, from `2 RANGE` deviations on. Of heavy tails
cubature needs the fourth moments. With :math:`F(s)` the mean square where vector k has
the variance :math:`s_k`,

.. math:: \sum_k \tfrac12 [F(1 + h e_k) + F(1 - h e_k)] - F(1), \quad
   h^2 = T - 1,  \tag{SC2}

is what they add to the order that it ends with, T being `TAILS`, their mean fourth
power over a normal's.

Table 1's answer steps by :math:`\varphi` where it gives way to the plain formula,
because the direct solution has no turn about n, and at the border of case A by the
angle at which neither d1 nor d2 counts; B, C and D share one formula up to right
angles. The mean of :math:`\nu - 1`, :math:`\nu = |\bar q^t|/|\bar q|`, and that of the
multiplicative error less the identity are held to eqs. (51) and (53). Of
:math:`1/|q - x| = \sum_k |x|^k P_k` the fourth order is at most
:math:`E|x|^4 \le 3 (\mathrm{tr} P)^2`; one more is for the bilinear part.

Both means are of second order in the noise, a thousandth of their scatter, and that of
a square is to a hundredth of itself what the first order makes it. So each stands also
as a control row, less its first and second order of the same trials
(`simval.studies.response`), except that of the plain formula within `MARGIN`
deviations, which noise takes across the singular set.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, Final, Literal, Self

import numpy as np
from pydantic import model_validator

from simval import statistics as stat
from simval.arrays import Array
from simval.errors import RefusedError
from simval.figures import Figure, Headline, Listing, Quote, entry, family_words
from simval.geometry import (
    attitude_error,
    compose,
    conjugate,
    normalize,
)
from simval.imu.attitude import (
    case_quaternion,
    sequential_quaternion,
    turn_is_singular,
    two_vector_quaternion,
)
from simval.imu.attitude.comparators import davenport, triad
from simval.imu.attitude.kernel import raw_quaternion
from simval.results import Outcome, Row, exact, limit, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import Truth
from simval.studies.noise_kinds import (
    TAILS,
    NoiseKind,
    noise_covariances,
    noise_roots,
    tails,
)
from simval.studies.response import Expanded, beside, curved
from simval.studies.study import Cost, Geometry, StudyParameters, described, ranged
from simval.studies.trials import (
    Block,
    Trials,
    drawn_rows,
    mean_of,
    root,
    trials_of,
)
from simval.theory.attitude import (
    Order,
    attitude_moments,
    multiplicative_moments,
)
from simval.theory.cramer_rao import attitude_bound
from simval.theory.cubature import cubature_moments
from simval.theory.estimators import class_moments, direct_covariance
from simval.theory.exact import exact_moments
from simval.theory.expansion import (
    scaled_error_moments,
    second_order_covariance,
    second_order_length,
)
from simval.theory.orders import RANGE, expansion_remainders
from simval.theory.two_vector import (
    FRAMES,
    MIN_NORM,
    Column,
    TwoVectorGeometry,
    column_norms,
    normalized_noise,
    turned_geometry,
    vectors_of,
)
from simval.units import DEGREE

TITLE = "Singular cases: cost of every remedy near the singular set"
SECTION = "singular"

BLOCK = 1024  # trials; part of the promise of equal bits
MARGIN: Final = 8.0
"""Of the noise, by which a frame must lead: a length deviates by at most 1."""
ROUNDING: Final = 4.0 * float(np.finfo(float).eps)
"""Of a mean quaternion: its entries are a dozen operations on numbers of 1 at most."""
QUICK: Final = 8.0
"""Distance from which the exact answer of cases A and B takes 2 ms, not 1 s, and that
under tangent noise a tenth of a second, not 13."""
FARTHEST: Final = {"distance": 0.25, "border": 0.1}
"""Of |qbar|: every case reaches 0.36, and has one of d1 and d2 above 0.19."""
LEAST_SINE, ANGLES = 0.5, (0.8, 1.5)
"""Of the angle between the references; angles of the singular attitudes, rad."""
GEOMETRIES: Final = 100
"""Attitudes of a case over which costs are predicted."""
SAME: Final = 1e-9
"""Rad, of answers without noise."""
NEVER: Final = 1e-200
"""Border within which no noisy sample is: the plain formula refuses none either."""
IDENTITY: Final = (0.0, 0.0, 0.0, 1.0)
SEQUENCE: Final = [3, 0, 1, 2]
"""Frames of the sequential rotations, by their places: plain, x, y, z."""


class Parameters(StudyParameters):
    """One cell: a case, a distance from it, and a noise level."""

    case: Literal["A", "B", "C", "D"] = described(
        "D", "Singular case of the source's Table 1."
    )
    distance: float = ranged(
        0.0, "|qbar| of the plain formula over the noise; 0 is singular.", 0.0, 1e6
    )
    noise_std: float = ranged(0.01, "Noise per axis of each unit vector.", 1e-6, 0.01)
    noise: NoiseKind = described("isotropic", "Noise of the four vectors.")
    normalized: bool = described(False, "Normalise the vectors before they are used.")
    border: float = ranged(10.0, "Distance up to which Table 1 is direct.", 1.0, 1e6)
    geometry: Geometry = 0
    samples: int = ranged(2048, "Trials; rounded up to whole blocks of 1024.", BLOCK)

    # the same draws for each kind of noise, so that cells compare
    no_noise = ("noise", "normalized")

    @model_validator(mode="after")
    def _require_near(self) -> Self:
        """Check that the distance and the border are possible."""
        for name, farthest in FARTHEST.items():
            most = farthest / self.noise_std * (1.0 + SAME)
            if not getattr(self, name) <= most:
                msg = (
                    f"`{name}` is {getattr(self, name):g} times the noise of "
                    f"{self.noise_std:g}; at most {most:.4g} is near the singular set, "
                    "so lower one of them"
                )
                raise ValueError(msg)
        return self

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1 + 1.5e-5 * self.samples, 50)


def turn(axis: Float[Array, "3"], half_sine: float) -> Float[Array, "4"]:
    """Turn about an axis, from the sine of half its angle."""
    return np.append(half_sine * normalize(axis), np.sqrt(1.0 - half_sine**2))


def singular_attitude(case: str, rng: np.random.Generator) -> Truth:
    """A random attitude of a singular case."""
    angle = rng.uniform(np.arcsin(LEAST_SINE), np.pi - np.arcsin(LEAST_SINE))
    r1, other = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
    r2 = np.cos(angle) * r1 + np.sin(angle) * other
    # near a bisector, so that neither d1 nor d2 vanishes
    share = rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.4)
    axis = {"B": r1, "C": r2}.get(case, r1 + share * r2)
    half = np.sin(rng.uniform(*ANGLES) / 2.0)
    return turn(axis, 0.0 if case == "A" else half), r1, r2


def seen_noise(
    parameters: Parameters,
    vectors: Float[Array, "... 4 3"],
    noise: Float[Array, "... 4 3 3"],
) -> Float[Array, "... 4 3 3"]:
    """Noise that the remedies see to first order: across, of normalised vectors."""
    return normalized_noise(vectors, noise)[1] if parameters.normalized else noise


class Setting:
    """One attitude near a singular one, with its remedies and predicted errors."""

    def __init__(self, parameters: Parameters) -> None:
        p = self.parameters = parameters
        rng = np.random.default_rng([p.geometry, 35])
        self.singular, self.r1, self.r2 = singular_attitude(p.case, rng)
        self.n = np.cross(self.r1, self.r2)
        self.sigma, self.border = p.noise_std, p.border * p.noise_std
        self.share = p.distance * self.sigma / float(np.linalg.norm(self.n))
        self.q = self.beside(self.share)
        self.truth = vectors_of(self.q, self.r1, self.r2)
        self.roots = noise_roots(p.noise, self.truth)
        self.noise = self.sigma**2 * noise_covariances(p.noise, self.truth)
        # of first order
        self.seen = seen_noise(p, self.truth, self.noise)
        self.gaussian = p.noise != "heavy tails"
        self.margin = MARGIN if self.gaussian else 2.0 * MARGIN
        self.norms = np.abs(column_norms(self.q, self.r1, self.r2))
        self.best = FRAMES[int(np.argmax(self.norms))]
        # of frames whose lengths are held to (51)
        self.lengths = {
            name: self.turned(frame, self.share)
            for name, frame in (("best", self.best), ("plain", "plain"))
            if (frame != "plain" or p.distance >= 2.0 * RANGE) and not p.normalized
        }
        bound = attitude_bound(self.q, self.r1, self.r2, self.noise)
        self.bound = float(np.sqrt(np.trace(bound.rotation)))
        self.remedies: dict[str, Callable[..., Array]] = {
            "best of four": partial(two_vector_quaternion, frame="best"),
            "sequential": lambda *v: sequential_quaternion(*v).q,
            "Table 1": partial(case_quaternion, tolerance=self.border),
            "combined": partial(two_vector_quaternion, frame="combined"),
            "TRIAD": triad,
            "q-method": davenport,
            "plain": partial(case_quaternion, tolerance=NEVER),
            "plain, normalised": lambda *v: self.remedies["plain"](*map(normalize, v)),
            "optimal": two_vector_quaternion,
        }

    def beside(self, share: float) -> Float[Array, "4"]:
        """The singular attitude turned about n to have this |qbar| over |n|, (SC1)."""
        return compose(turn(self.n, share / self.singular[3]), self.singular)

    def chords(self, name: str, *vectors: Array) -> Float[Array, "n 3"]:
        """Errors of a remedy as twice the vector part, sign of the scalar made plus."""
        if self.parameters.normalized:
            vectors = tuple(map(normalize, vectors))
        error = compose(conjugate(self.q), self.remedies[name](*vectors))
        return np.copysign(2.0, error[:, 3:]) * error[:, :3]

    def errors(self, names: Iterable[str], x: Float[Array, "n 12"]) -> dict[str, Array]:
        """Errors of some remedies under given noise, and effects of normalisation."""
        noise = x.reshape(-1, 4, 3).swapaxes(0, 1) @ self.roots
        vectors = self.truth[:, None] + self.sigma * noise
        found = {name: self.chords(name, *vectors) for name in names}
        block = vectors.mT.reshape(12, -1)
        for name, geometry in self.lengths.items():
            raw = raw_quaternion(block, self.best if name == "best" else name).T
            lengths = np.linalg.norm(raw, axis=1, keepdims=True)
            found[f"length {name}"] = geometry.norm / lengths - 1.0
            if name == "best":
                back = conjugate(geometry.q_true)
                found["turn"] = compose(back, raw / lengths) - IDENTITY
        return found

    def expanded(
        self, names: Iterable[str], x: Float[Array, "n 12"]
    ) -> dict[str, Expanded]:
        """These errors expanded to first and second order."""
        names, nothing = list(names), np.zeros((1, 12))
        widths = {k: v.shape[1] for k, v in self.errors(names, nothing).items()}
        ends = np.cumsum([0, *widths.values()]).tolist()
        whole = curved(lambda y: np.hstack([*self.errors(names, y).values()]), x)
        return {
            name: whole.take(slice(*part))
            for name, part in zip(widths, pairwise(ends), strict=True)
        }

    def turned(self, frame: str, share: float) -> TwoVectorGeometry:
        """Noise-free vectors in a frame."""
        column = np.array(FRAMES.index(frame))
        return turned_geometry(column, self.beside(share), self.r1, self.r2)

    def exact_square(self, frame: str) -> float:
        """Exact mean square error in a fixed frame."""
        # a qbar of 0 has no sign; the square of its frame is even and smooth in it
        least = 1e-3 * self.sigma if frame == "plain" else 0.0
        geometry = self.turned(frame, max(self.share, least))
        bias, C = exact_moments(geometry, self.noise)
        second = C + np.outer(bias, bias)
        return 4.0 * float(np.trace(second) - geometry.q @ second @ geometry.q)

    @property
    def expands(self) -> bool:
        """True if a fixed frame has no exact answer and must be expanded."""
        return self.parameters.normalized or not self.gaussian

    @property
    def plain_expands(self) -> bool:
        """True if the plain frame can be expanded here."""
        far = self.parameters.distance >= 2.0 * RANGE
        return bool(far and self.norms[3] >= MIN_NORM)

    def frames(self) -> dict[str, Column]:
        """Frame of each remedy that uses a fixed frame here."""
        found, p = {}, self.parameters
        lengths = np.sort(self.norms)
        if lengths[3] - lengths[2] >= self.margin * self.sigma:
            found["best of four"] = self.best
        over = self.norms[SEQUENCE] - 0.5 * np.linalg.norm(self.n)
        first = int(np.argmax(over >= 0.0))
        if np.all(np.abs(over[: first + 1]) >= self.margin * self.sigma):
            found["sequential"] = FRAMES[SEQUENCE[first]]
        quick = p.case in "CD" and p.noise != "tangent"
        near = not quick and p.distance < QUICK
        if self.plain_expands if self.expands else not near:
            found["plain"] = "plain"
            if p.distance >= p.border + self.margin:
                found["Table 1"] = "plain"
        return found

    def predicted(self) -> dict[str, tuple[float, str, float]]:
        """Mean squares of each remedy, the theory they are from, and remainders."""
        found: dict[str, tuple[float, str, float]] = {}
        frames = self.frames()
        first: dict[str, Array] = {}
        for frame in dict.fromkeys(frames.values()):
            same = [name for name, own in frames.items() if own == frame]
            if self.expands:
                first |= dict.fromkeys(same, self.turns_of(frame))
                continue
            try:
                square = self.exact_square(frame)
            except RefusedError:  # not resolved so near: reported, not judged
                continue
            found |= dict.fromkeys(same, (square, stat.EXACT, 0.0))
        if self.plain_expands:
            first["plain, normalised"] = self.turns_of("plain", normalized=True)
        given = self.q, np.stack([self.r1, self.r2]), self.seen
        kinds = {
            "q-method": "wahba",
            "optimal": "wahba",
            "TRIAD": "triad",
            "combined": "combined",
        }
        first |= {name: class_moments(kind, *given)[1] for name, kind in kinds.items()}
        near = self.parameters.border < self.margin  # noise takes it across the border
        if self.parameters.distance == 0.0 and self.parameters.case != "A" and not near:
            first["Table 1"] = direct_covariance(self.q, self.r1, self.r2, self.seen)
        # twice what is of higher order, found by halving the noise
        whole, half = (self.by_cubature(first, level) for level in (1.0, 0.5))
        left = 2.0 * np.abs(whole - 4.0 * half) / 0.75
        for (name, C), rest in zip(first.items(), left, strict=True):
            found[name] = np.trace(C), stat.FIRST_ORDER, float(rest)
        return found

    def turns_of(self, frame: Column, normalized: bool = False) -> Array:
        """Covariance of the turn in a fixed frame, to first order."""
        given = self.q, self.r1, self.r2, self.seen
        return (
            4.0 * attitude_moments(*given, 2, frame, normalized=normalized).covariance
        )

    def by_cubature(self, names: Mapping[str, Array], level: float) -> Array:
        """Mean squares of some remedies with the noise scaled, eq. (SC2)."""

        def squares(scales: Float[Array, "4"]) -> Array:
            noise = scales[:, None, None] * self.noise * level**2
            return -cubature_moments(
                lambda *v: np.stack(
                    [np.sum(self.chords(k, *v) ** 2, axis=1) for k in names], axis=1
                ),
                self.truth, noise, np.zeros(len(names)), 5,
            ).bias  # fmt: skip

        one, steps = np.ones(4), np.sqrt(TAILS - 1.0) * np.eye(4)
        middle = squares(one)
        if self.gaussian:
            return middle
        pairs = [(squares(one + h) + squares(one - h)) / 2.0 for h in steps]
        return np.sum(pairs, axis=0) - 3.0 * middle

    def trial(self, rng: np.random.Generator) -> Block:
        """Simulate a block of trials: the errors of all remedies, and their noise."""
        noise = rng.standard_normal((4, BLOCK, 3))
        drawn = noise * tails(self.parameters.noise, (4, BLOCK, 1), rng)
        x = drawn.swapaxes(0, 1).reshape(BLOCK, 12)
        return {**self.errors(self.remedies, x), "noise": x}, {"vectors": noise}


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate and predict one cell."""
    setting = Setting(parameters)
    trials = trials_of(streams, parameters.samples, BLOCK, setting.trial)
    rows = [*drawn_rows(trials.noise)]
    theory, frames = setting.predicted(), setting.frames()
    smooth = (
        name
        for name in theory
        if frames.get(name) != "plain" or parameters.distance >= MARGIN
    )
    known = setting.expanded(smooth, trials["noise"])
    for name in setting.remedies:
        rows += _remedy_rows(setting, name, trials[name], theory.get(name), known)
    if not parameters.normalized:
        rows += _normalisation_rows(setting, trials, known)
    rows += _border_rows(setting)
    if parameters.distance == 0.0:
        rows += [*_cost_rows(parameters), *_table_rows()]
    return Outcome(rows=tuple(rows))


def _remedy_rows(
    setting: Setting,
    name: str,
    chords: Float[Array, "n 3"],
    theory: tuple[float, str, float] | None,
    known: Mapping[str, Expanded],
) -> Iterator[Row]:
    """RMS error, its ratio to the bound, and the mean square over theory's."""
    square, label, left = theory or (np.nan, "", 0.0)
    squares = np.sum(chords**2, axis=1)
    rms, error = root(*mean_of(squares)[:2]) if squares.any() else (0.0, 0.0)
    for family, unit in ((stat.RMS(name, unit="rad"), 1.0),
                         (stat.RMS_OVER_BOUND(name), setting.bound)):  # fmt: skip
        expected = None if theory is None else np.sqrt(square) / unit
        yield from unjudged(
            family, rms / unit, error / unit, len(chords), expected, label
        )
    if theory is None:
        return
    own = plain(
        stat.SQUARED_ERROR(name), *mean_of(squares / square), 1.0, label, left / square
    )
    yield from own
    if name in known:
        reduced = known[name].weighted_square(chords, np.eye(3) / square)
        # of a chord twice a quaternion's; of its square twice that over its root
        yield from beside(own, [reduced], 4.0 * ROUNDING / np.sqrt(square))


def _normalisation_rows(
    setting: Setting, trials: Trials, known: Mapping[str, Expanded]
) -> Iterator[Row]:
    """Mean length by (51) in two frames, and mean turn by (53) in the best."""
    more = 1.0 if setting.gaussian else TAILS
    for name, geometry in setting.lengths.items():
        moments = scaled_error_moments(geometry, setting.noise)
        values = trials[f"length {name}"]
        own = plain(
            stat.LENGTH_OFF(name), *mean_of(values[:, 0]),
            second_order_length(moments.q, moments.P), stat.ORDER_2,
            4.0 * more * np.trace(moments.P) ** 2,
        )  # fmt: skip
        yield from own
        yield from beside(own, [known[f"length {name}"].mean(values)], ROUNDING)
    given = setting.q, setting.r1, setting.r2, setting.noise
    orders: tuple[Order, ...] = (2, 4)
    found = {k: attitude_moments(*given, k, setting.best) for k in orders}
    left = expansion_remainders(found)[2].bias
    turns = trials["turn"]
    own = plain(
        stat.BIAS.each("xyzs"), *mean_of(turns),
        multiplicative_moments(found[2]).bias, stat.ORDER_2, 2.0 * more * left,
    )  # fmt: skip
    yield from own
    yield from beside(own, [known["turn"].mean(turns)], ROUNDING)


def _border_rows(setting: Setting) -> Iterator[Row]:
    """Jump of Table 1's answer across the borders of a case, without noise."""
    tau, r1, r2 = setting.border, setting.r1, setting.r2
    direct = partial(case_quaternion, tolerance=tau)
    sines = {"to regular": tau / setting.singular[3]}
    if setting.parameters.case == "A":
        # the longer difference is the half angle's sine times the sine to the axis
        axis = normalize(r1 + r2)
        sines["to D"] = tau / np.linalg.norm(np.cross(axis, [r1, r2]), axis=1)[0]
    for name, sine in sines.items():
        sides = (
            turn(axis, k * sine) if name == "to D" else setting.beside(k * tau)
            for k in (1.0 - 1e-6, 1.0 + 1e-6)
        )
        answers = [direct(*vectors_of(q, r1, r2)) for q in sides]
        yield from exact(
            stat.STEP(name), attitude_error(*answers), 2.0 * np.arcsin(sine),
            stat.EXACT, 1e-5 * sine + SAME,
        )  # fmt: skip


def _cost_rows(parameters: Parameters) -> Iterator[Row]:
    """First-order RMS error over the bound, for many attitudes of the case."""
    rng = np.random.default_rng(GEOMETRIES)
    truths = [singular_attitude(parameters.case, rng) for _ in range(GEOMETRIES)]
    q, r1, r2 = (np.stack(each) for each in zip(*truths, strict=True))
    vectors = vectors_of(q, r1, r2)
    noise = noise_covariances(parameters.noise, vectors)
    bound = np.linalg.trace(attitude_bound(q, r1, r2, noise).rotation)
    noise = seen_noise(parameters, vectors, noise)
    norms = np.abs(column_norms(q, r1, r2))
    least = 0.5 * np.linalg.norm(norms, axis=1, keepdims=True)
    first = np.argmax(norms[:, SEQUENCE] >= least, axis=1)
    columns = {"best of four": np.argmax(norms, axis=1),
               "sequential": np.array(SEQUENCE)[first]}  # fmt: skip
    squares = {}
    for name, column in columns.items():
        moments = scaled_error_moments(turned_geometry(column, q, r1, r2), noise)
        squares[name] = 4.0 * second_order_covariance(moments.q, moments.P)
    combined = attitude_moments(q, r1, r2, noise, 2, "combined")
    squares["combined"] = 4.0 * combined.covariance
    if parameters.case != "A":
        each = zip(q, r1, r2, noise, strict=True)
        squares["Table 1"] = np.stack([direct_covariance(*one) for one in each])
    for name, C in squares.items():
        ratios = np.sqrt(np.linalg.trace(C) / bound)
        values = np.quantile(ratios, [0.0, 0.5, 1.0])
        statistics = [stat.RMS_RATIO(name, k) for k in ("least", "median", "most")]
        yield from unjudged(
            statistics, values, n=GEOMETRIES, predictor=stat.FIRST_ORDER
        )


def _table_rows() -> Iterator[Row]:
    """Share of a lattice of attitudes that each table gets wrong without noise.

    The 24 attitudes of the cube with all pairs of 13 directions: most are singular,
    many of them in turned frames too.
    """
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 4, indexing="ij"), -1)
    grid = grid.reshape(-1, 4)[41:]  # one of each sign
    attitudes = normalize(grid[np.isin(np.abs(grid).sum(axis=1), (1, 2, 4))])
    directions = normalize(grid[grid[:, 0] == 0.0][:, 1:])
    pairs = directions[np.argwhere(~np.eye(13, dtype=bool))]
    q = np.repeat(attitudes, len(pairs), axis=0)
    r1, r2 = np.tile(pairs, (len(attitudes), 1, 1)).swapaxes(0, 1)
    vectors = [*np.moveaxis(vectors_of(q, r1, r2), 1, 0)]
    singular = np.abs(column_norms(q, r1, r2)) <= SAME
    turned = partial(turn_is_singular, tolerance=SAME)
    by_table = [partial(turned, axis=k)(*vectors) for k in range(3)]
    wrong = {
        "Table 1": attitude_error(case_quaternion(*vectors), q) > SAME,
        "Table 2": np.stack(by_table, axis=1) != singular[:, :3],
        "sequential": attitude_error(sequential_quaternion(*vectors).q, q) > SAME,
    }
    for name, each in wrong.items():
        share = np.mean(each)
        yield from limit(stat.FAILURES(name), share, 0.0, stat.TRUTH, n=each.size)


def _plainly(parameters: Mapping[str, Any]) -> bool:
    """True for isotropic noise without normalisation; others appear in tables."""
    return not parameters["normalized"] and parameters["noise"] == "isotropic"


_NEAR = Figure(
    name="singular",
    asked="What does each remedy cost near the singular set?",
    what="The simulated error",
    claimed=[stat.SQUARED_ERROR],
    rows=[stat.RMS_OVER_BOUND],
    along="distance",
    axis="|q̄| / σ",
    lines=entry(0),
    value="RMS error / bound",
    level=1.0,
    where=lambda parameters: parameters["distance"] > 0.0 and _plainly(parameters),
    least=["noise_std", "geometry"],
    ratio=False,
    columns=2,
    caption=(
        "RMS error over the Cramér-Rao bound against the distance from the singular "
        "set, cases A to D. The plain formula is lost within some deviations. Table 1 "
        "holds on the set, leaves out a turn beside it, and is the plain formula past "
        "its border. Half turns cost a fixed share, all frames combined hardly any. "
        "Isotropic noise, vectors as they are; of several random geometries the first."
    ),
)
FIGURES = (
    _NEAR,
    replace(
        _NEAR,
        name="singular-noise",
        asked="How do the errors follow the noise on the singular set?",
        rows=[stat.RMS],
        along="noise_std",
        axis="noise of each unit vector, relative",
        value="RMS error",
        unit=DEGREE,
        level=None,
        where=lambda parameters: parameters["distance"] == 0.0 and _plainly(parameters),
        least=["geometry"],
        caption=(
            "RMS error on the singular set. In cases B to D the plain formula is wrong "
            "by as much whatever the noise, in case A by its root; remedies follow it. "
            "Of several random geometries the first is drawn."
        ),
    ),
    Listing(
        name="singular",
        caption="Error of each remedy, over the bound, and its square over theory's",
        rows=[stat.RMS, stat.RMS_OVER_BOUND, stat.SQUARED_ERROR],
        keys={"remedy": entry(0)},
        column=family_words,
    ),
    Listing(
        name="singular-costs",
        caption=(
            "Predicted RMS error over the bound: least, median and most of "
            f"{GEOMETRIES} attitudes of the case"
        ),
        rows=[stat.RMS_RATIO],
        keys={"remedy": entry(0)},
        column=entry(1),
    ),
    Listing(
        name="singular-borders",
        caption=(
            "Step of Table 1's answer across a border, mean length by eq. (51) less 1, "
            "and share of exact cases that each method gets wrong"
        ),
        rows=[stat.STEP, stat.LENGTH_OFF, stat.FAILURES],
        keys={"of": entry(0)},
        column=family_words,
        predicted=True,
    ),
)
HEADLINE = Headline(
    says="all frames combined {over} × the bound",
    quotes={"over": Quote(of=stat.RMS_OVER_BOUND("combined"), by=stat.FIRST_ORDER)},
)
