r"""Check without noise the conventions that an estimator declares.

An estimator is given exact vectors of generic attitudes; what comes back must be the
truth, whatever the rounding. Where it is not, the probe says which other convention the
answers would fit. Large batches must hold what their rows are alone, for large batches
are what is measured. At half turns and the like (`simval.plugins.attitudes`) it is the
share of failures that is measured.

An estimate fails where it is not finite, not of unit length, or farther from the truth
than `TOLERANCE` over the sine of the angle between the vectors. A batch that raises,
or whose answer cannot be read, is tried in halves: what fails alone fails.

A covariance is probed by its leading term, with differences of the estimator itself, so
that no theory of ours stands behind the verdict.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from simval.arrays import Array, Mask
from simval.consistency import rotation_error
from simval.errors import CrashedPluginError, PluginError, SlowPluginError
from simval.geometry import FRAMES, attitude_error, rotation_vector
from simval.plugins.answers import (
    covariances_of,
    quaternions_of,
    raw_attitudes,
)
from simval.plugins.attitudes import (
    COUNT,
    VERTICALS,
    package_quaternion,
    sound_rows,
)
from simval.plugins.noise import VectorNoise, Vectors, vector_noise
from simval.plugins.protocol import Estimator, alternatives
from simval.shapes import Bool, Float

NEAR = 0.01
"""Rad, and relative to the parameters: another sign, order or frame is off by more."""

MOVED = 1e-10
"""By which entries are moved: more than rounding of doubles, less than any other."""

DIGITS = 8
"""Most decimals to which an answer is rounded on purpose."""


def moved(given: Float[Array, "..."]) -> Float[Array, "..."]:
    """Move numbers by so little that only coarse arithmetic does not notice."""
    rng = np.random.default_rng(20_274)
    return given + MOVED * rng.standard_normal(given.shape)


def imprecision(answers: Float[Array, "n ..."], of_moved: Float[Array, "n ..."]) -> str:
    """Say why answers are only nearly right, by comparing those to moved input."""
    flat, other = (each.reshape(len(answers), -1) for each in (answers, of_moved))
    cause = (
        "it rounds on its way, is off by a small constant, or stops before it has "
        "converged"
    )
    if np.mean(np.all(flat == other, axis=1)) > 0.5:
        cause = (
            f"it answers the same where what it is given is moved by {MOVED:g}, so it "
            "rounds that, or works in less than double precision"
        )
    if np.array_equal(flat, flat.astype(np.float32)):
        cause = "its answers are in single precision"
    for digits in range(DIGITS, 0, -1):
        scaled = flat * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-6):
            cause = f"its answers are rounded to {digits} decimals"
    return f"its conventions fit, its precision does not: {cause}"


OTHERWISE = "asked again it answers otherwise"

TOLERANCE = 1e-6
"""Rad, and relative to the parameters: the root of rounding is 1.5e-8, which is what a
sound but ill-conditioned algorithm may lose, times 64. A rounding of vectors turns
them about their own mean by its size over the sine between them, so it is allowed that
much more."""

BATCH_NOISE = 0.01
"""Of the vectors on which rows of a large batch are compared with themselves alone."""


class Exact(NamedTuple):
    """Cases without noise, and the noise that the estimator is told."""

    truth: Float[Array, "n 4"]
    vectors: Vectors
    noise: VectorNoise | None = None

    def rows(self, rows: slice) -> "Exact":
        """Select cases; arrays shared by the caller stay shared."""
        own = {id(v): v[rows] for v in self.vectors}
        return Exact(self.truth[rows], [own[id(v)] for v in self.vectors], self.noise)

    def noisy(self, rng: np.random.Generator) -> "Exact":
        """The same cases with noise on every vector."""
        sizes = [BATCH_NOISE * rng.standard_normal(v.shape) for v in self.vectors]
        noisy: list[Array] = [
            v + size for v, size in zip(self.vectors, sizes, strict=True)
        ]
        return Exact(self.truth, noisy, self.noise)

    def attitudes(self, estimator: Estimator) -> Float[Array, "n 4"]:
        """Attitudes that the estimator answers."""
        return quaternions_of(estimator, self.vectors, self.noise)

    def covariances(self, estimator: Estimator) -> Float[Array, "n 3 3"]:
        """Covariances that the estimator states; zeros if it states none."""
        if estimator.covariance is None:
            return np.zeros((len(self.truth), 3, 3))
        assert self.noise is not None
        return covariances_of(estimator, self.vectors, self.noise)

    def errors(self, estimator: Estimator) -> Float[Array, " n"]:
        """Angle of each answer from the truth, rad; infinite if it is no attitude."""
        try:
            raw = raw_attitudes(estimator, self.vectors, self.noise)
        except SlowPluginError:  # would be as slow in halves
            raise
        except PluginError:
            if len(self.truth) == 1:
                return np.array([np.inf])
            middle = len(self.truth) // 2
            halves = slice(0, middle), slice(middle, None)
            return np.concatenate([self.rows(own).errors(estimator) for own in halves])
        sound = sound_rows(raw, estimator.components)
        q = self.truth.copy()
        q[sound] = package_quaternion(
            raw[sound], estimator.components, estimator.matrix
        )
        return np.where(sound, attitude_error(self.truth, q), np.inf)

    def failing(self, estimator: Estimator) -> Bool[Mask, " n"]:
        """Mask of the cases in which the estimator fails."""
        return ~(self.errors(estimator) <= allowed(self.vectors))


def allowed(vectors: Vectors) -> Float[Array, " n"]:
    """Tolerance of an exact case, rad."""
    first, *others = vectors[len(vectors) // 2 :]
    sines = [np.linalg.norm(np.cross(first, r), axis=1) for r in others]
    return TOLERANCE / np.max(sines, axis=0)


def failure_shares(
    estimator: Estimator,
    count: int = COUNT,
    vectors: int = 2,
    noise: VectorNoise | None = None,
) -> dict[str, float]:
    """Share of each class's exact cases that an estimator fails, 0 to 1."""
    observed = estimator.observed(vectors)
    return {
        name: float(
            np.mean(Exact(*observed.cases(name, count), noise).failing(estimator))
        )
        for name in observed.classes
    }


SPREAD_NOISE = 1e-3
"""At which a covariance is asked for."""

STEP = 1e-5
"""Of the differences: central, so their own error is about STEP^2."""

SPREAD_TOLERANCE = 1e-3
"""Relative, of the leading term; differences are good to 1e-9, and a wrong factor, side
or unit is off by far more."""


def probe_covariance(estimator: Estimator, exact: Exact, noise: VectorNoise) -> None:
    """Check the leading term of a stated covariance by central differences."""
    small = noise.small(SPREAD_NOISE)
    exact, roots = exact._replace(noise=small), noise.at(1.0).roots(exact.vectors)
    claimed = exact.covariances(estimator)
    ends = []
    for which, axis in product(noise.noisy, range(3)):
        for step in (STEP * roots[:, which, :, axis], -STEP * roots[:, which, :, axis]):
            moved = list(exact.vectors)
            moved[which] = moved[which] + step
            ends.append(exact._replace(vectors=moved).attitudes(estimator))
    off, factor = {}, {}
    for side in ("body", "reference"):
        errors = np.array([rotation_error(q, exact.truth, side) for q in ends])
        J = (errors[0::2] - errors[1::2]) / (2.0 * STEP)
        seen = small.noise_std**2 * np.einsum("dni,dnj->nij", J, J)
        apart = np.linalg.norm(claimed - seen, axis=(-2, -1))
        off[side] = np.max(apart / np.linalg.norm(seen, axis=(-2, -1)))
        traces = (np.linalg.trace(each) for each in (claimed, seen))
        factor[side] = np.median(np.divide(*traces))
    side, other = estimator.side, "reference" if estimator.side == "body" else "body"
    most = SPREAD_TOLERANCE + SPREAD_NOISE
    if not off[side] <= most:
        hint = f"its trace is {factor[side]:.4g} times what it should be"
        if off[other] <= most:
            hint = f'it fits side="{other}": declare that'
        msg = (
            f"the covariance of {estimator.name} is {off[side]:.3g} off, "
            "relative, from the covariance of its own errors at a noise of "
            f"{SPREAD_NOISE:g}; {hint}"
        )
        raise PluginError(msg)


ALIKE = 1e-2
"""Of an angle, by which turns about one axis may differ and be the same."""

CASES = 64
"""Exact cases of each class behind the words."""


def what_fits(
    estimator: Estimator, exact: Exact, first: Float[Array, "n 4"]
) -> Iterator[str]:
    """Say which conventions would make the answers right, the best first.

    `first` is what it answered to these vectors before.
    """
    apart = attitude_error(exact.attitudes(estimator), first)
    if not np.all(apart <= allowed(exact.vectors)):
        off = apart.max()
        yield f"{OTHERWISE}, by {off:.3g} rad: it must answer the same each time"
    fits = {each: ~exact.failing(each) for each in _alike(estimator)}
    right = [other.spelled() for other, fit in fits.items() if fit.all()]
    yield from (f"declare {words} instead" for words in right)
    for other in fits:
        declare = f"declare {other.spelled()} instead; "
        if words := nearly_right(other, exact):
            yield f"{declare if other.spelled(estimator) else ''}{words}"
    number, count = len(exact.truth), len(exact.vectors) // 2
    yield from _fitting_frames(estimator, exact)
    # among equals the declared one, which needs no mention
    best = max(fits, key=lambda each: (fits[each].sum(), not each.spelled(estimator)))
    fitting = int(fits[best].sum())
    shares = failure_shares(best if fitting else estimator, CASES, count, exact.noise)
    whole = [name for name, share in shares.items() if share == 0.0]
    classes = f"(all cases fit of: {'; '.join(whole)})"
    if not whole:
        classes = "(and no class of attitudes)"
    if fitting:
        wrong = int(np.argmin(fits[best]))
        off = attitude_error(exact.truth[wrong], exact.attitudes(best)[wrong])
        turn = np.degrees(np.linalg.norm(rotation_vector(exact.truth[wrong])))
        declared = f"with {best.spelled()} " * bool(best.spelled(estimator))
        yield (
            f"{declared}{fitting} of {number} rows fit, row {wrong}, a turn by "
            f"{turn:.0f} degrees, does not, by {off:.3g} rad {classes}"
        )
    dip = "any `dip`" if estimator.dip is None else f"a `dip` of {estimator.dip:g} rad"
    fixed = f" It was tried with {dip}: declare the dip that it was written for"
    if estimator.reference is None:
        fixed = " Are its references fixed? Then declare `reference`"
    yield (
        f"no order or direction of the components fits any of {number} rows "
        f"{classes}: is it b = A r, with body vectors first?{fixed}"
    )


def nearly_right(estimator: Estimator, exact: Exact) -> str:
    """Say what is wrong if all answers are off alike or by little; else nothing."""
    truth, q = exact.truth, exact.attitudes(estimator)
    for side in () if estimator.reference else ("body", "reference"):
        error = rotation_error(q, truth, side)
        mean = error.mean(axis=0)
        angle = np.linalg.norm(mean)
        if np.all(np.linalg.norm(error - mean, axis=1) <= ALIKE * angle):
            axis = ", ".join(f"{x:.3f}" for x in mean / angle)
            return (
                f"its conventions fit, but all answers are turned by the same "
                f"{angle:.3g} rad about the axis ({axis}) of the {side}"
            )
    off = attitude_error(truth, q) * (TOLERANCE / allowed(exact.vectors))
    if not off.max() <= NEAR:
        return ""
    vectors = exact.vectors, [moved(v) for v in exact.vectors]
    return imprecision(*(raw_attitudes(estimator, v, exact.noise) for v in vectors))


def _fitting_frames(estimator: Estimator, exact: Exact) -> Iterator[str]:
    """Say which fixed references an estimator was written for, if any fit."""
    pairs = len(exact.vectors) == 4
    for frame, vertical in product(FRAMES, VERTICALS) if pairs else ():
        for dip in dict.fromkeys((None, estimator.dip)):
            fixed = replace(estimator, reference=frame, vertical=vertical, dip=dip)
            drawn = fixed.observed().generic(len(exact.truth), np.random.default_rng(1))
            for other in _alike(fixed):
                if not Exact(*drawn, exact.noise).failing(other).any():
                    words = f'declare reference="{frame}", vertical="{vertical}"'
                    yield f"{words} and {other.spelled()} instead"


def _alike(estimator: Estimator) -> list[Estimator]:
    """The estimator in each convention that has the same form of answer."""
    matrix = estimator.components == "matrix"
    every = alternatives(estimator)
    return [each for each in every if (each.components == "matrix") == matrix]


FIRST = 24
"""Rows of the first batch; a fast path starts later."""

BATCHES = (3, 4, 1024, 4096)
"""Rows of the other batches: as many as a vector or a quaternion has entries, so that
rows may be taken for columns, what the study simulates at once, and more than its
cubature evaluates at once."""


def probe_estimator(
    estimator: Estimator, vectors: int = 2, noise: VectorNoise | None = None
) -> float:
    """Check an estimator's conventions without noise.

    Parameters
    ----------
    estimator : Estimator
        As it declares itself.
    vectors : int, default 2
        Body vectors that it is given.
    noise : VectorNoise, optional
        Shape of the noise that its covariance is of, and that it is handed if it asks
        for it; default the same for each body vector and none for the references.

    Returns
    -------
    float
        Greatest attitude error of the first batch times the sine between its
        references, rad; it and those of the large batches are within `TOLERANCE`.

    Raises
    ------
    PluginError
        If an answer has a wrong shape or is not finite, an attitude is not the true
        one, it changes its input, its rows depend on each other or on how many there
        are, it does not use what it reads, or the covariance is not that of its errors.
    """
    noise = vector_noise("body", vectors) if noise is None else noise

    def drawn(count: int, rng: np.random.Generator) -> Exact:
        generic = estimator.observed(vectors).generic(count, rng)
        return Exact(*generic, noise.at(BATCH_NOISE))

    exact = drawn(FIRST, np.random.default_rng(20_268))
    try:
        q = exact.attitudes(estimator)
    except CrashedPluginError as error:
        alone = replace(estimator, batch=False)
        if estimator.batch and not exact.failing(alone).any():
            msg = f"{error}; it takes one sample at a time, so declare batch=False"
            raise CrashedPluginError(msg) from error
        raise
    greatest, far = _error(exact, q)
    if far:
        why = next(what_fits(estimator, exact, q))
        msg = f"{estimator.name}: {far}; {why}"
        raise PluginError(msg)
    _require_rows_alone(estimator, exact, q, [0])
    if estimator.reads and not depends_on_noise(
        estimator, exact.vectors, covariance=True
    ):
        words = ", ".join(f"`{word}`" for word in estimator.reads)
        msg = (
            f"{estimator.name} reads {words} and ignores it: its answers do not "
            "depend on it; use it, or leave it out of `reads`"
        )
        raise PluginError(msg)
    if estimator.covariance is not None:
        probe_covariance(estimator, exact, noise)
    for count in BATCHES:
        rng = np.random.default_rng(count)
        _probe_batch(estimator, drawn(count, rng), rng)
    return greatest


def _error(exact: Exact, q: Float[Array, "n 4"]) -> tuple[float, str]:
    """Largest error, scaled to one tolerance, and how far the worst is, if too far."""
    error, most = np.asarray(attitude_error(exact.truth, q)), allowed(exact.vectors)
    row = int(np.argmax(np.where(error <= most, 0.0, error)))
    far = (
        f"row {row} is {error[row]:.3g} rad from the truth without noise, "
        f"{most[row]:.2g} is allowed"
    )
    return float((error * (TOLERANCE / most)).max()), far * (not np.all(error <= most))


def _probe_batch(estimator: Estimator, exact: Exact, rng: np.random.Generator) -> None:
    """Check a large batch, and that its rows equal those computed alone."""
    count = len(exact.truth)
    _, far = _error(exact, exact.attitudes(estimator))
    if far:
        cause = nearly_right(estimator, exact)
        msg = (
            f"{estimator.name} is right in a batch of {FIRST}, but in one of "
            f"{count} its {far}{cause and f'; {cause}'}"
        )
        raise PluginError(msg)
    noisy = exact.noisy(rng)
    rows = np.linspace(0, count - 1, FIRST).astype(int).tolist()
    _require_rows_alone(estimator, noisy, noisy.attitudes(estimator), rows)


def _require_rows_alone(
    estimator: Estimator, exact: Exact, q: Float[Array, "n 4"], rows: list[int]
) -> None:
    """Require that rows of a batch, and their covariances, equal those alone."""
    claimed = exact.covariances(estimator)
    for row in rows:
        own = exact.rows(slice(row, row + 1))
        alone, spread = own.attitudes(estimator), own.covariances(estimator)
        off = attitude_error(alone, q[row : row + 1]).max()
        apart = np.linalg.norm(spread[0] - claimed[row])
        most = allowed(own.vectors)[0]
        if not (off <= most and apart <= most * np.linalg.norm(spread[0])):
            msg = (
                f"{estimator.name}: row {row} of a batch of {len(q)} differs from "
                f"the same row alone, by {off:.3g} rad and its covariance by "
                f"{apart:.3g} rad²; each row must be an estimate by itself"
            )
            raise PluginError(msg)


def depends_on_noise(
    estimator: Estimator, vectors: Vectors, *, covariance: bool
) -> bool:
    """True if attitudes (or covariances, if asked) depend on the stated noise.

    The second noise has the weights the other way round, and is tiny against what the
    vectors have, so that whoever leaves out what is too far off does so.
    """
    k = len(vectors) // 2
    rising = np.geomspace(0.1, 1.0, k)
    no_truth = np.zeros((len(vectors[0]), 4))
    noisy = Exact(no_truth, vectors).noisy(np.random.default_rng(20_273))
    read = [
        noisy._replace(
            noise=vector_noise(" ".join(map(str, [*sizes, *np.zeros(k)])), k, noise_std)
        )
        for sizes, noise_std in ((rising, BATCH_NOISE), (rising[::-1], 1e-9))
    ]
    try:
        q, other = (each.attitudes(estimator) for each in read)
        if not np.array_equal(q, other):
            return True
        P, another = (each.covariances(estimator) for each in read)
    except PluginError:  # which is an answer to the noise
        return True
    return covariance and not np.array_equal(P, another)
