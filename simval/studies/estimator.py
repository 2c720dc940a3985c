r"""A user's attitude estimator: its errors against cubature and the bound.

The plug-in's conventions are probed without noise first, at generic attitudes. At the
classes of attitudes where estimators break (`simval.plugins.attitudes`) the share of
exact cases that fail must be 0, unless the plug-in declares that class. Then each trial
adds noise to the body vectors, or what `noise` says (`simval.plugins.noise`); the
references are exact by default. The error is the rotation vector from the truth to the
estimate, on the side that the plug-in declares. Its bias and covariance are set against
Gaussian cubature of the plug-in itself: no theory of it is needed, and the two share
nothing but its code. The remainder is twice the difference between cubature of degree 7
and of degree 5.

**No agreement with itself.** Such a comparison alone would let a wrong plug-in agree
with itself. An error without first-order bias, :math:`e = Jn + \tfrac12 n^T H n`, has
the mean :math:`\tfrac12\,\mathrm{tr}(H\Sigma)`: products of two first-order errors, as
:math:`\tfrac12\,e' \times e''` is of two turns. So the bias by cubature must be within
the trace of the covariance, up to the error of cubature itself. At a noise of `SMALL`,
where that error is negligible, it must be within the trace of the Cramer-Rao bound, up
to rounding: a constant error does not shrink with the noise and fails. Of 400
geometries with the same noise on all four vectors the two-vector estimator takes at
most 0.17 of that trace; orthogonal frames and least squares have no such bias there.

**Leading terms.** By cubature at a noise h and at half of it, with
:math:`E[\theta] = l h + m h^2 + O(h^4)` and :math:`C = P h^2 + Q h^4 + O(h^6)`,

.. math:: l h = 4\,\bar\theta_{h/2} - \bar\theta_h, \quad
   m h^2 = \frac{16\,\bar\theta_{h/2} - \bar\theta_h}{3}, \quad
   P h^2 = \frac{16\,C_{h/2} - C_h}{3}.

An estimate that is right without noise is unbiased to first order: l is zero, and
nothing is below the Cramer-Rao bound. One whose attitudes depend on the noise that it
reads has no greater trace of P than least squares with equal weights, where noise is
the same in every direction. An estimator that declares its class has the m and P of
that class as well, and one that works with power series those of its own second order
(`simval.studies.estimator_series`): order 2 leaves out what order 4 adds and what order
4 leaves out, which is at most twice what cubature differs from it by. The rest of the
sums are of relative order :math:`h^4`. The two-vector formula in its best frame has
these terms where h does not reach another frame. Where it does, noise chooses between
formulas that differ to first order, so its bias is of first order: it may be greater by
what the choice adds to that of the truth's frame at the nodes of cubature
(`Attitudes.choice`), which does not resolve it either. The sums are of no formula then:
h is the first of `NEARER` that reaches no other frame.

Where the noise of two vectors differs by more than `simval.plugins.noise.EXTREME`, as
in some named geometries, neither leading terms, nor the classes of attitudes, nor a
stated covariance of first order are judged.

Simulated moments against cubature, the efficiency, unit length and a stated covariance
are in `simval.studies.estimator_errors`; operations in `estimator_operations`.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, model_validator

from simval import statistics as stat
from simval.arrays import Array
from simval.consistency import normalised_squares, rotation_error
from simval.errors import InputError, PluginError
from simval.geometry import attitude_matrix, normalize
from simval.imu.attitude import wahba_quaternion
from simval.imu.attitude.kernel import column_matrix
from simval.moments import Moments
from simval.montecarlo import Sums, moments_of, simulate
from simval.plugins import Estimator, probe_estimator
from simval.plugins.answers import covariances_of, quaternions_of, raw_attitudes
from simval.plugins.attitudes import COUNT
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.probe import (
    TOLERANCE,
    allowed,
    depends_on_noise,
    failure_shares,
)
from simval.results import Rows, limit, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import random_geometry
from simval.studies.estimator_errors import (
    EPS,
    MeanAndCovariance,
    claim_off,
    claim_rows,
    moment_rows,
    series_rows,
    size_rows,
    unit_rows,
)
from simval.studies.estimator_operations import operation_rows, rounding_rows
from simval.studies.estimator_series import series_of
from simval.studies.named_geometries import GEOMETRIES, GeometryName, named_geometry
from simval.studies.plugin import (
    Again,
    AlgorithmParameters,
    Call,
    PluginName,
    Problem,
    Seconds,
    compute,
    outcome,
    run,
)
from simval.studies.study import LEAST_NOISE, Geometry, described, ranged
from simval.text import shown
from simval.theory import wahba_bound
from simval.theory.cubature import cubature_moments, smolyak_hermite
from simval.theory.estimators import OF_TWO_VECTORS, class_moments

__all__ = ["SECTION", "TITLE", "Parameters", "compute", "outcome", "run"]

TITLE = "User-supplied attitude estimator: bias, spread and stated covariance"
SECTION = "algorithms"

BLOCK = 1024  # samples; part of the promise of equal bits, as is `BATCH`
BATCH = 8
MOST_NOISE = 0.1
"""Of any vector, per axis."""

DEGREE = 7
"""Of cubature; its own error is twice what degree 5 differs by."""

WIDE = 0.5
"""Rad; where the Cramer-Rao bound is greater, a formula may jump at any node, and no
cubature says what trials are."""

HEEDED = 24
"""Trials by which it is seen whether it uses what it reads."""

SQUARE_APART = 0.01
"""By which a normalised square may differ in another order, relative to it and 1."""

SMALL = 1e-5
"""Noise at which a second-order bias and the error of cubature are negligible."""

SMALL_ROUNDING = 2.0 * TOLERANCE
"""Rad; the root of rounding, 1.5e-8, times the sum of the weights' sizes, `WEIGHTS`;
where cubature has greater weights, as many times more."""

WEIGHTS = 107.0
"""Of cubature with two body and two reference vectors."""

NOISE = 1e-3
"""The noise h: far above rounding, and its fourth power is nothing."""

NEARER = (1e-4, 1e-5, 1e-6, 1e-7)
"""Of 400 random geometries four have another frame within 1e-3 of their best one."""

LEADING_TOLERANCE = 1e-3
"""Relative, as of the leading term of a claimed covariance: the package's estimators
are within 2e-8 in 60 random geometries, and a bias of less is 1e-3 of a standard
deviation."""

Trials = tuple[Sums, Float[Array, "n p"]]
"""Sums of the errors of all trials, and the errors of the first block."""


class Attitudes(Problem[Estimator, float, Trials]):
    """Attitudes from noisy vectors: one geometry with one shape of noise."""

    kind = Estimator

    def __init__(
        self, plugin: Estimator, parameters: "Parameters", streams: Streams
    ) -> None:
        super().__init__(plugin, parameters, streams)
        self.noise_std, vectors = parameters.noise_std, parameters.vectors
        self.noise = vector_noise(parameters.noise, vectors)
        require_fitting(plugin, vectors, self.noise)
        geometry = parameters.geometry
        number = geometry if isinstance(geometry, int) else 0
        self.q, *pairs = random_geometry(number)
        rng = np.random.default_rng([20_271, number])
        if plugin.fixed is not None:
            self.references = np.concatenate(plugin.fixed.draw(1, rng))
        elif isinstance(geometry, str):
            self.q, self.references = named_geometry(geometry)
        else:
            more = normalize(rng.standard_normal((vectors - 2, 3)))
            self.references = np.concatenate([pairs, more])
        body = self.references @ attitude_matrix(self.q).T
        self.truth = np.concatenate([body, self.references])
        self.roots = self.noise.roots([v[None] for v in self.truth])[0]

    @property
    def size(self) -> tuple[int, str]:
        """Number of samples."""
        return self.parameters.samples, "samples"

    def probe(self) -> float:
        """Largest error without noise, rad."""
        asked = self.plugin if self.claims else replace(self.plugin, covariance=None)
        return probe_estimator(asked, self.parameters.vectors, self.noise)

    def trials(self, probed: float) -> Trials:
        """Errors of all trials, and of the first block."""
        first: list[Float[Array, "n p"]] = []

        def sampled(rng: np.random.Generator, count: int) -> Float[Array, "p n"]:
            errors = self.errors(self.drawn(count, rng), self.noise_std)
            first.extend([] if first else [errors])
            return errors.T

        count = self.parameters.samples
        sums = simulate(sampled, self.streams, samples=count, block=BLOCK, batch=BATCH)
        return sums, first[0]

    def again(self, answers: Trials) -> Again:
        """The first block, to be repeated, and how far it may differ."""
        _, first = answers
        vectors, most = self.first_block(), np.full(first.shape, np.inf)
        most[:, :3] = TOLERANCE / self.sine
        if self.claims:
            most[:, 3] = SQUARE_APART * (1.0 + first[:, 3])
        return first, lambda k: self.errors(vectors[k], self.noise_std), most

    def rows(self, probed: float, answers: Trials) -> Rows:
        """All rows of the cell."""
        plugin, noise, sums = self.plugin, self.noise_std, answers[0]
        measured, rounding = moments_of(sums), probed / self.sine
        cubatures = self.cubature(noise, DEGREE), self.cubature(noise, DEGREE - 2)
        fine, coarse = cubatures
        # to twice what the next lower degree of cubature differs by
        mean, covariance = (
            2.0 * np.abs(a - b) for a, b in zip(fine, coarse, strict=True)
        )
        chosen = self.choice(noise, DEGREE) + self.choice(noise, DEGREE - 2)
        left = mean[:3].max() + chosen[0], covariance[:3, :3].max() + chosen[1]
        least = np.trace(self.bound(noise))
        rows = [
            *limit(stat.PROBE(unit="rad"), probed, TOLERANCE, stat.TRUTH, n=1),
            *failure_rows(self),
            *bias_rows(self, fine, coarse),
            *(() if self.noise.extreme else leading_rows(self, rounding)),
            *moment_rows(measured, *fine, stat.CUBATURE, left),
            *size_rows(sums, cubatures, least, (rounding, self.weights), chosen[1]),
            *unit_rows(self.q, self.first_attitudes()),
            *operation_rows(plugin, len(self.references)),
            *rounding_rows(plugin, len(self.references), self.noise),
        ]
        if plugin.series:
            series = (self.series(noise, order) for order in (2, 4))
            rows += series_rows(measured, fine, *series)
        if self.claims:
            half = self.cubature(noise / 2.0, DEGREE)
            off, at_half, other = map(claim_off, (fine, half, coarse))
            spread, grown = fine[1][:3, :3], self.scatter * max(rounding, EPS)
            rows += claim_rows(
                plugin.claim, measured, off, at_half, abs(off - other), spread, grown
            )
        if least > WIDE**2:
            rows = [replace(r, check="record") if r.standard_error else r for r in rows]
        return tuple(rows)

    def call(self) -> Call:
        """Attitudes of the first block, to be timed."""
        vectors = list(np.moveaxis(self.first_block(), 1, 0))
        return raw_attitudes, (vectors, self.noise.at(self.noise_std)), BLOCK

    @property
    def sine(self) -> float:
        """Sine between the references, by which rounding grows."""
        return TOLERANCE / allowed([v[None] for v in self.truth])[0]

    @property
    def weighs(self) -> bool:
        """True if the attitudes depend on the stated noise."""
        given = [np.repeat(v[None], HEEDED, axis=0) for v in self.truth]
        return bool(self.plugin.reads) and depends_on_noise(
            self.plugin, given, covariance=False
        )

    @property
    def claims(self) -> bool:
        """True if it states a covariance and knows the noise needed for that."""
        knows = bool(self.plugin.reads) or self.noise.one_number
        return not self.noise.extreme and self.plugin.covariance is not None and knows

    @property
    def coupling(self) -> float:
        r"""Relative effect of noise along the vectors on the second-order bias.

        Noise along a vector weighs it, and turns the estimate as far as it moves with
        the noise across. With c_i the covariance of both and l_i the least variance
        across, an estimate of the covariance P is off by at most the sum of |c_i|/l_i
        times trace(P): none of noise that is the same in every direction, or across.
        """
        total = 0.0
        for i in self.noise.noisy:
            C, along = self.roots[i] @ self.roots[i], self.truth[i]
            plane = np.linalg.svd(along[None])[2][1:]  # two directions across
            least = np.linalg.eigvalsh(plane @ C @ plane.T)[0]
            total += np.linalg.norm(plane @ C @ along) / least
        return total

    def covariances(self, noise_std: float) -> Float[Array, "m 3 3"]:
        """Covariance of each vector's noise."""
        return noise_std**2 * self.roots @ self.roots

    def bound(self, noise_std: float) -> Float[Array, "3 3"]:
        """Cramer-Rao bound of the rotation error, body side, rad^2.

        Noise along a vector does not move it, so tangent noise has the bound of
        noise of the same size in every direction.
        """
        noise = noise_std**2 * self.noise.unit
        return wahba_bound(self.q, self.references, noise).rotation

    def drawn(self, count: int, rng: np.random.Generator) -> Float[Array, "count m 3"]:
        """Draw the vectors of some trials."""
        normal = rng.standard_normal((count, *self.truth.shape))
        noise = np.einsum("mij,nmj->nmi", self.noise_std * self.roots, normal)
        return self.truth + noise

    def first_block(self) -> Float[Array, "n m 3"]:
        """Vectors of the first block."""
        return self.drawn(BLOCK, self.streams.block(0))

    def first_attitudes(self) -> Float[Array, "n 4"]:
        """Attitudes of the first block."""
        vectors = list(np.moveaxis(self.first_block(), 1, 0))
        return quaternions_of(self.plugin, vectors, self.noise.at(self.noise_std))

    def errors(
        self, vectors: Float[Array, "n m 3"], noise_std: float
    ) -> Float[Array, "n p"]:
        """Errors of some trials, their NEES if claimed, and `SQUARES`."""
        rows, noise = list(np.moveaxis(vectors, 1, 0)), self.noise.at(noise_std)
        q = quaternions_of(self.plugin, rows, noise)
        error = rotation_error(q, self.q, self.plugin.side)
        columns = [error]
        if self.claims:
            P = covariances_of(self.plugin, rows, noise)
            columns.append(normalised_squares(error, P)[:, None])
        k = len(self.references)
        best = wahba_quaternion(vectors[:, :k], vectors[:, k:], noise.weights)
        for other in (error, rotation_error(best, self.q)):
            columns.append(np.sum(other * other, axis=1, keepdims=True))
        return np.concatenate(columns, axis=1)

    def cubature(self, noise_std: float, degree: int) -> MeanAndCovariance:
        """Mean and covariance of `errors` by cubature."""
        noisy = self.noise.noisy

        def errors(*vectors: Float[Array, "n 3"]) -> Float[Array, "n p"]:
            every = np.repeat(self.truth[None], len(vectors[0]), axis=0)
            every[:, noisy] = np.stack(vectors, axis=1)
            return self.errors(every, noise_std)

        moments = cubature_moments(
            errors,
            self.truth[noisy],
            self.covariances(noise_std)[noisy],
            np.zeros(6 if self.claims else 5),
            degree,
        )
        return -moments.bias, moments.covariance

    def nodes(self, noise_std: float, degree: int) -> Float[Array, "n m 3"]:
        """Vectors at the nodes of the cubature."""
        noisy = self.noise.noisy
        points = smolyak_hermite(3 * len(noisy), degree)[0].reshape(-1, len(noisy), 3)
        every = np.repeat(self.truth[None], len(points), axis=0)
        every[:, noisy] += np.einsum(
            "mij,nmj->nmi", noise_std * self.roots[noisy], points
        )
        return every

    def frames(
        self, noise_std: float, degree: int
    ) -> tuple[Float[Array, "n 4"], Float[Array, "n 4"]]:
        """Closed form at the nodes, in the truth's best frame and in each node's."""
        vectors = np.concatenate([self.truth[None], self.nodes(noise_std, degree)])
        columns = column_matrix(np.moveaxis(vectors, 0, 2), symmetric=False)
        best = np.argmax(np.einsum("kin,kin->kn", columns, columns), axis=0)
        return columns[best[0]].T[1:], columns[best, :, np.arange(len(best))][1:]

    def choice(self, noise_std: float, degree: int) -> Float[Array, "2"]:
        """Effect of choosing a frame at each node on the closed form's moments."""
        if self.plugin.kind != "closed form":
            return np.zeros(2)
        weights = smolyak_hermite(3 * len(self.noise.noisy), degree)[1]
        fixed, chosen = (
            rotation_error(normalize(each), self.q)
            for each in self.frames(noise_std, degree)
        )
        mean = weights @ (chosen - fixed)
        square = (weights * chosen.T) @ chosen - (weights * fixed.T) @ fixed
        return np.array([np.linalg.norm(mean), np.linalg.norm(square, "nuc")])

    @property
    def weights(self) -> float:
        """Sum of the absolute weights of the cubature, which amplifies rounding."""
        _, weights = smolyak_hermite(3 * len(self.noise.noisy), DEGREE)
        return np.abs(weights).sum()

    @property
    def scatter(self) -> float:
        """Two deviations of the cubature's mean of nodes times rounding of size one."""
        points, weights = smolyak_hermite(3 * len(self.noise.noisy), DEGREE)
        return 2.0 * float(np.linalg.norm(weights[:, None] * points))

    def series(self, noise_std: float, order: Literal[2, 4]) -> Moments:
        """Mean and covariance of the rotation error by power series."""
        covariances, told = self.covariances(noise_std), self.noise.at(noise_std)
        return series_of(self.plugin, self.q, self.truth, covariances, told, order)


def require_fitting(plugin: Estimator, vectors: int, noise: VectorNoise) -> None:
    """Check that a plug-in can be measured with these vectors and this noise."""
    if vectors != 2 and (plugin.takes == "pairs" or plugin.reference is not None):
        what = "two pairs" if plugin.takes == "pairs" else "the two fixed references"
        msg = (
            f"{plugin.name} takes {what} and `vectors` is {vectors}; set it to 2, or "
            'declare takes="vectors" without `reference` if it takes more'
        )
        raise PluginError(msg)
    if vectors != 2 and plugin.kind in OF_TWO_VECTORS:
        msg = (
            f'{plugin.name} declares kind="{plugin.kind}", whose theory is of two '
            f"vectors, and `vectors` is {vectors}; set it to 2"
        )
        raise PluginError(msg)
    if plugin.reference is not None and not noise.exact_references:
        msg = (
            f'{plugin.name} declares reference="{plugin.reference}", so its '
            "references are exact, but `noise` gives them noise; choose a "
            "noise that does not"
        )
        raise PluginError(msg)


Spaced = Annotated[str, AfterValidator(lambda text: " ".join(text.split()))]
"""A text, of single spaces."""


class Parameters(AlgorithmParameters):
    """One cell: a plug-in, a geometry and a noise level."""

    problem = Attitudes
    no_noise = ("algorithm", "cases", "time_limit")

    algorithm: PluginName = described(
        "", "FILE.py, FILE.py:NAME or the name of an entry point."
    )
    geometry: Geometry | GeometryName = described(
        3,
        "Number of a random attitude and vectors, or the name of a test "
        "case, which has its vectors and noise.",
    )
    noise_std: float = ranged(
        0.01, "Noise per axis of each body vector of length 1.", LEAST_NOISE, MOST_NOISE
    )
    noise: Spaced = described(
        "body",
        "Noise of each vector relative to `noise_std`: body, all, tangent, "
        'unequal, general, standard deviations such as "1 3 0 0" of b1, b2, r1, r2, '
        "or as many 3 x 3 covariances in JSON.",
    )
    vectors: int = ranged(2, "Vector pairs.", 2, 6)
    samples: int = ranged(16_384, "Trials; rounded up to whole blocks of 1024.", BLOCK)
    cases: int = ranged(COUNT, "Exact cases of each class of attitudes.", 64, 1 << 20)
    time_limit: Seconds = described(300.0, "Wall time after which the cell fails, s.")

    @model_validator(mode="before")
    @classmethod
    def _name_geometry(cls, given: Any) -> Any:
        """Take vectors and noise from a named geometry."""
        name = given.get("geometry") if isinstance(given, dict) else None
        if not isinstance(name, str) or name not in GEOMETRIES:
            return given
        settings = GEOMETRIES[name].settings
        for key, value in settings.items():
            other = given.get(key, value)
            if other not in (value, cls.model_fields[key].default):
                msg = (
                    f"`{key}` is {shown(other)} and the geometry {name} has {value}; "
                    f"leave `{key}` out"
                )
                raise InputError(msg)
        return given | settings

    @model_validator(mode="after")
    def _require_noise(self) -> Self:
        """Check that the noise fits the vectors, and that none is lost in it."""
        noise = vector_noise(self.noise, self.vectors, self.noise_std)
        if not noise.std.max() <= MOST_NOISE * (1.0 + 1e-12):
            msg = (
                f"`noise_std` is {self.noise_std:g} and `noise` {self.noise:.60}: that "
                f"makes {noise.std.max():.3g} of a vector of length 1; at most "
                f"{MOST_NOISE:g} is allowed, so lower one of them"
            )
            raise InputError(msg)
        return self


def failure_rows(problem: Attitudes) -> Rows:
    """Share of failures in each class; a declared one is not judged.

    None is where weights differ so much that they lose the digits of all estimators.
    """
    plugin, cases = problem.plugin, problem.parameters.cases
    shares = failure_shares(plugin, cases, problem.parameters.vectors, problem.noise)
    given = tuple(shares) if problem.noise.extreme else plugin.fails_at
    declared = dict.fromkeys(name for name in given if name in shares)
    known = {name: shares.pop(name) for name in declared}
    return (
        *limit(
            stat.FAILURES.each(shares), tuple(shares.values()), 0.0, stat.TRUTH, n=cases
        ),
        *unjudged(stat.FAILURES.each(known), tuple(known.values()), n=cases),
    )


def bias_rows(
    problem: Attitudes, predicted: MeanAndCovariance, coarser: MeanAndCovariance
) -> Rows:
    """Bias by cubature, against a bound of second order."""
    mean, covariance = predicted
    unresolved = 2.0 * np.linalg.norm((mean - coarser[0])[:3])
    small = problem.noise.small(SMALL).noise_std
    rounding = SMALL_ROUNDING * max(1.0, problem.weights / WEIGHTS)
    longer = 1.0 + problem.coupling
    chosen = [problem.choice(h, DEGREE)[0] for h in (problem.noise_std, small)]
    most = (
        longer * np.trace(covariance[:3, :3]) + unresolved + TOLERANCE,
        longer * np.trace(problem.bound(small)) + rounding,
    )
    biases = [
        np.linalg.norm(bias[:3]) for bias in (mean, problem.cubature(small, DEGREE)[0])
    ]
    families = (stat.CUBATURE_BIAS(), stat.CUBATURE_BIAS_SMALL())
    return limit(families, biases, np.add(most, chosen), stat.SECOND_ORDER, n=1)


def leading_rows(problem: Attitudes, rounding: float) -> Rows:
    """Moments at a small noise and at half of it."""
    near = min(1.0, 10.0 * problem.sine)  # the sums are in h over the sine
    sizes = [problem.noise.small(near * h).noise_std for h in (NOISE, *NEARER)]
    noise = next((h for h in sizes if of_one_formula(problem, h)), None)
    if noise is None:  # a tie of frames to the last digits
        return ()
    whole, half = (problem.cubature(noise / part, DEGREE) for part in (1.0, 2.0))
    plugin, weights = problem.plugin, problem.weights
    A = attitude_matrix(problem.q) if plugin.side == "reference" else np.eye(3)
    linear = A @ (4.0 * half[0] - whole[0])[:3]
    bias = A @ (16.0 * half[0] - whole[0])[:3] / 3.0
    covariance = A @ ((16.0 * half[1] - whole[1])[:3, :3] / 3.0) @ A.T
    bound = problem.bound(noise)
    size = np.trace(bound)
    most = LEADING_TOLERANCE + 5.0 * weights * rounding / np.sqrt(size)
    first = np.linalg.norm(linear) / np.sqrt(size)
    below = max(0.0, 1.0 - _least_ratio(covariance, bound))
    rows = limit(stat.FIRST_ORDER_BIAS(), first, most, stat.NO_BIAS, n=1)
    rows += limit(stat.BELOW_BOUND(), below, most, stat.CRAMER_RAO, n=1)
    if problem.noise.isotropic and np.ptp(problem.noise.weights) and problem.weighs:
        given = problem.q, problem.references, problem.covariances(noise)
        over = np.trace(covariance) / np.trace(class_moments("wahba", *given)[1])
        rows += limit(
            stat.OVER_EQUAL_WEIGHTS(), over, 1.0 + most, stat.EQUAL_WEIGHTS, n=1
        )
    slack = 6.0 * weights * rounding
    limits = (
        LEADING_TOLERANCE + slack / size,
        LEADING_TOLERANCE + 2.0 * slack / np.sqrt(size),
    )
    for predictor, mean, spread in _predictions(problem, noise, A):
        # which is the bound's size or more, where it is the theory of an estimator
        most_spread = max(np.linalg.norm(spread), np.linalg.norm(bound))
        off = np.linalg.norm(covariance - spread) / most_spread
        apart = np.linalg.norm(bias - mean) / size, off
        rows += limit(
            (stat.CLASS_BIAS(), stat.CLASS_COVARIANCE()), apart, limits, predictor, n=1
        )
    return rows


def of_one_formula(problem: Attitudes, noise: float) -> bool:
    """True if the best frame is the same at every node of the cubature."""
    if problem.plugin.kind != "closed form":
        return True
    return np.array_equal(*problem.frames(noise, DEGREE))


def _predictions(
    problem: Attitudes, noise: float, A: Float[Array, "3 3"]
) -> Iterator[tuple[str, Float[Array, "3"], Float[Array, "3 3"]]]:
    """Second-order predictions: of the declared class, and of its own series.

    Each with its name, on the body side, to which A takes the plug-in's.
    """
    kind = problem.plugin.kind
    if kind is not None:
        covariances, weights = problem.covariances(noise), problem.noise.weights
        given = problem.q, problem.references, covariances, weights
        yield stat.class_of(kind), *class_moments(kind, *given)
    if problem.plugin.series:
        own = problem.series(noise, 2)
        yield stat.ORDER_2, A @ own.bias, A @ own.covariance @ A.T


def _least_ratio(covariance: Float[Array, "3 3"], bound: Float[Array, "3 3"]) -> float:
    """Smallest ratio of the variance in any direction to its bound."""
    root = np.linalg.cholesky(bound)
    half = np.linalg.solve(root, covariance)
    return np.linalg.eigvalsh(np.linalg.solve(root, half.T))[0]
