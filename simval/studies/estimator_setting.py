r"""A user-supplied estimator at one geometry and under one noise.

Beside its errors stand those of the built-in least squares, whose weights are the
inverse variances of the pairs, from the same vectors: what two estimators differ by is
seen under equal noise.

The plug-in itself is evaluated on truncated power series in the noise
(`simval.theory.series`). With :math:`R = R(\delta q)` of the error and :math:`w` the
vector of :math:`(R - R^T)/2`, whose length is the sine of the angle, the rotation
vector is to fourth order

.. math:: \theta = w\,(1 + |w|^2 / 6).

Order 2 leaves out what order 4 adds and what order 4 leaves out; that is at most twice
what cubature differs from it by.

By cubature at a noise h and at half of it. With
:math:`E[\theta] = l h + m h^2 + O(h^4)` and :math:`C = P h^2 + Q h^4 + O(h^6)`,

.. math:: l h = 4\,\bar\theta_{h/2} - \bar\theta_h, \quad
   m h^2 = \frac{16\,\bar\theta_{h/2} - \bar\theta_h}{3}, \quad
   P h^2 = \frac{16\,C_{h/2} - C_h}{3}.

One whose attitudes depend on the noise that it reads has no greater trace of P than
least squares with equal weights, where noise is the same in every direction.
An estimate that is right without noise is unbiased to first order: l is zero, and
nothing is below the Cramer-Rao bound. An estimator that declares its class has the m
and P of that class as well, and one that works with power series those of its own
second order. The rest of the sums are of relative order :math:`h^4`.

The two-vector formula in its best frame has these terms where h does not reach another
frame. Where it does, its errors have a kink there, and the sums are of no formula: h is
then the first of `NEARER` that reaches none.
"""

import traceback
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.attitude import wahba_quaternion
from simval.attitude.kernel import column_matrix
from simval.errors import PluginError
from simval.geometry import attitude_matrix, normalize
from simval.moments import Moments
from simval.plugins import Estimator, answers
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.attitudes import tail
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.probe import TOLERANCE, allowed, heeds, rotation_error
from simval.results import Row, limit, plain
from simval.shapes import Float
from simval.statistics import (
    BELOW_BOUND,
    BIAS,
    CLASS_BIAS,
    CLASS_COVARIANCE,
    COVARIANCE,
    CRAMER_RAO,
    EQUAL_WEIGHTS,
    FIRST_ORDER_BIAS,
    NO_BIAS,
    ORDER_2,
    ORDER_4,
    OVER_EQUAL_WEIGHTS,
    class_of,
)
from simval.studies.attitude import random_geometry
from simval.text import message_of
from simval.theory import wahba_bound
from simval.theory.cubature import cubature_moments, smolyak_hermite
from simval.theory.estimators import OF_TWO_VECTORS, class_moments
from simval.theory.series import Series, algebra, series_moments

MeanAndCovariance = tuple[Float[Array, " p"], Float[Array, "p p"]]

SQUARES = slice(-2, None)
"""Columns of the errors that are squares: of the plug-in, and of the least squares."""

HEEDED = 24
"""Trials by which it is seen whether it uses what it reads."""

DEGREE = 7
"""Of cubature; its own error is twice what degree 5 differs by."""


def geometry_of(
    number: int, plugin: Estimator, vectors: int
) -> tuple[Float[Array, "4"], Float[Array, "k 3"]]:
    """True quaternion and references of a numbered geometry."""
    q, r1, r2 = random_geometry(number)
    rng = np.random.default_rng([20_271, number])
    if plugin.fixed is not None:
        return q, np.concatenate(plugin.fixed.draw(1, rng))
    more = normalize(rng.standard_normal((vectors - 2, 3)))
    return q, np.concatenate([[r1, r2], more])


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
            f'{plugin.name} declares reference="{plugin.reference}", which it does not '
            "measure, and `noise` gives the references noise; take one that does not"
        )
        raise PluginError(msg)


class Setting:
    """A plug-in at one geometry."""

    def __init__(
        self, plugin: Estimator, geometry: int, vectors: int = 2, noise: str = "body"
    ) -> None:
        self.plugin = plugin
        self.noise = vector_noise(noise, vectors)
        require_fitting(plugin, vectors, self.noise)
        self.q, self.references = geometry_of(geometry, plugin, vectors)
        body = self.references @ attitude_matrix(self.q).T
        self.truth = np.concatenate([body, self.references])
        rows = [v[None] for v in self.truth]
        self.roots = self.noise.roots(rows)[0]

    @property
    def sine(self) -> float:
        """Sine between its references, by which rounding turns an estimate more."""
        return TOLERANCE / float(allowed([v[None] for v in self.truth])[0])

    @property
    def weighs(self) -> bool:
        """Whether its attitudes depend on what it reads of the noise."""
        given = [np.repeat(v[None], HEEDED, axis=0) for v in self.truth]
        return bool(self.plugin.reads) and heeds(self.plugin, given, covariance=False)

    @property
    def claims(self) -> bool:
        """Whether it gives a covariance, and can know the noise that this is of."""
        knows = bool(self.plugin.reads) or self.noise.one_number
        return self.plugin.covariance is not None and knows

    def covariances(self, noise_std: float) -> Float[Array, "m 3 3"]:
        """Covariance of each vector's noise."""
        scaled: Array = noise_std**2 * self.roots @ self.roots
        return scaled

    @property
    def coupling(self) -> float:
        r"""By how much noise along the vectors may add to a second-order bias.

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
            total += float(np.linalg.norm(plane @ C @ along) / least)
        return total

    def bound(self, noise_std: float) -> Float[Array, "3 3"]:
        """Cramer-Rao bound of the rotation error, body side, rad^2.

        Noise along a vector does not move it, so tangent noise has the bound of
        noise of the same size in every direction.
        """
        noise = noise_std**2 * self.noise.unit
        return wahba_bound(self.q, self.references, noise).rotation

    def drawn(
        self, count: int, noise_std: float, rng: np.random.Generator
    ) -> Float[Array, "count m 3"]:
        """Vectors of some trials."""
        normal = rng.standard_normal((count, *self.truth.shape))
        noise: Array = np.einsum("mij,nmj->nmi", noise_std * self.roots, normal)
        return self.truth + noise

    def errors(
        self, vectors: Float[Array, "n m 3"], noise_std: float
    ) -> Float[Array, "n p"]:
        """Errors of some trials, their normalised squares if claimed, and `SQUARES`."""
        rows, noise = list(np.moveaxis(vectors, 1, 0)), self.noise.at(noise_std)
        q = quaternions_of(self.plugin, rows, noise)
        error = rotation_error(self.q, q, self.plugin.side)
        columns = [error]
        if self.claims:
            P = covariances_of(self.plugin, rows, noise)
            solved = np.linalg.solve(P, error[..., None])[..., 0]
            columns.append(np.sum(error * solved, axis=1, keepdims=True))
        k = len(self.references)
        best = wahba_quaternion(vectors[:, :k], vectors[:, k:], noise.weights)
        for other in (error, rotation_error(self.q, best, "body")):
            columns.append(np.sum(other * other, axis=1, keepdims=True))
        return np.concatenate(columns, axis=1)

    def additive(self, vectors: Float[Array, "n m 3"]) -> Float[Array, "n 4"]:
        """Truth minus estimate as quaternions, the estimate with the truth's sign."""
        q = quaternions_of(self.plugin, list(np.moveaxis(vectors, 1, 0)), self.noise)
        return self.q - np.copysign(1.0, q @ self.q)[:, None] * q

    def cubature(self, noise_std: float, degree: int) -> MeanAndCovariance:
        """Mean and covariance of `errors` under the noise."""
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
        """The vectors that this cubature tries, by the same symmetric roots."""
        noisy = self.noise.noisy
        points = smolyak_hermite(3 * len(noisy), degree)[0].reshape(-1, len(noisy), 3)
        every = np.repeat(self.truth[None], len(points), axis=0)
        every[:, noisy] += np.einsum(
            "mij,nmj->nmi", noise_std * self.roots[noisy], points
        )
        return every

    @property
    def weights(self) -> float:
        """Sum of the sizes of the weights of cubature: what rounding grows by."""
        return float(
            np.abs(smolyak_hermite(3 * len(self.noise.noisy), DEGREE)[1]).sum()
        )


AXES = ("x", "y", "z")


def series_of(setting: Setting, noise_std: float, order: int) -> Moments:
    """Mean and covariance of the rotation error, on the plug-in's side."""
    plugin, told = setting.plugin, setting.noise.at(noise_std)
    truth = [v[None] for v in setting.truth]
    raised: list[Exception] = []

    def error(*vectors: NDArray[np.object_]) -> NDArray[np.object_]:
        try:
            return _rotation(setting, _answer(plugin, list(vectors), truth, told))
        except Exception as fault:  # whatever a user's function may raise
            raised.append(fault)
            raise

    try:
        moments = series_moments(
            error, setting.truth, setting.covariances(noise_std), order
        )
    except Exception as fault:  # of the plug-in, or of what it answered
        own = raised[0] if raised else fault
        unable = own if isinstance(own, PluginError) else _unable(plugin.name, own)
        raise unable from None
    return Moments(bias=-moments.bias, covariance=moments.covariance)


def _answer(
    plugin: Estimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Array],
    noise: VectorNoise,
) -> NDArray[np.object_]:
    """Answer to vectors of power series, (3,) each; their coefficients cross."""
    tables = vectors[0][0].algebra
    given = np.array([[each.coefficients for each in v] for v in vectors])
    size = (tables.dimension, tables.degree)
    terms, plain = _terms(plugin, size, given, truth, noise)
    answer = np.empty(plain.shape, dtype=object)
    for place in np.ndindex(plain.shape):
        own = terms[place]
        answer[place] = float(own[0]) if plain[place] else Series(own, tables)
    return answer


@where_it_lives
def _terms(
    plugin: Estimator,
    size: tuple[int, int],
    given: Float[Array, "m 3 t"],
    truth: list[Array],
    noise: VectorNoise,
) -> tuple[Float[Array, "... t"], NDArray[np.bool_]]:
    """Terms of its answer to power series, and which entries are plain numbers."""
    tables = algebra(*size)
    rows = [[Series(own, tables) for own in v] for v in given]
    vectors = [np.array([v], dtype=object) for v in rows]
    try:
        found = answers.one_answer(plugin, vectors, truth, noise)
        answer = np.asarray(found, dtype=object)
        one = rows[0][0] * 0.0
        plain = np.array([not isinstance(each, Series) for each in answer.flat])
        terms = [(one + each).coefficients for each in answer.flat]
    except Exception as fault:  # whatever a user's function may raise
        raise _unable(plugin.name, fault) from None
    return np.reshape(terms, (*answer.shape, -1)), plain.reshape(answer.shape)


def _unable(name: str, fault: Exception) -> PluginError:
    return PluginError(
        f"{name} declares series=True, and `estimate` cannot work with "
        f"power series{_place(fault)}: {message_of(fault)}; use + - * / **, abs, "
        "comparisons and numpy.sqrt, or do not declare it"
    )


def _place(error: BaseException) -> str:
    """The line of the user's file at which it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [i for i, frame in enumerate(frames) if frame.filename == answers.__file__]
    theirs = frames[own[-1] + 1 :] if own else []
    lines = [f.line for f in theirs if f.filename == theirs[0].filename and f.line]
    return f" at `{lines[-1]}`" if lines else ""


def _rotation(setting: Setting, answer: NDArray[np.object_]) -> Any:
    """Rotation vector of an answer's error, to fourth order."""
    plugin = setting.plugin
    shape = tail(plugin.components)
    if answer.shape not in (shape, (1, *shape)):
        msg = f"it returned the shape {answer.shape} for one sample"
        raise ValueError(msg)
    found = answer.reshape(shape)
    M = found if plugin.components == "matrix" else _matrix(found, plugin.components)
    body_from_reference = M if plugin.matrix == "active" else M.T
    A = attitude_matrix(setting.q)
    if plugin.side == "body":
        R = A @ body_from_reference.T
    else:
        R = body_from_reference.T @ A
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) * 0.5
    return w * (1.0 + np.sum(w * w) * (1.0 / 6.0))


def _matrix(q: NDArray[np.object_], components: str) -> NDArray[np.object_]:
    """R(q) of Hamilton's product."""
    *vector, s = q if components == "xyzs" else np.roll(q, -1)
    x, y, z = vector
    xx, yy, zz, ss = x * x, y * y, z * z, s * s
    rows = [
        [ss + xx - yy - zz, 2.0 * (x * y - s * z), 2.0 * (x * z + s * y)],
        [2.0 * (x * y + s * z), ss - xx + yy - zz, 2.0 * (y * z - s * x)],
        [2.0 * (x * z - s * y), 2.0 * (y * z + s * x), ss - xx - yy + zz],
    ]
    return np.array(rows, dtype=object)


def moment_rows(
    measured: Moments,
    mean: Float[Array, " p"],
    covariance: Float[Array, "p p"],
    predictor: str,
    left: tuple[float, float],
) -> tuple[Row, ...]:
    """Bias and covariance beside a prediction, and what each of them leaves out."""
    n, upper = measured.samples, np.triu_indices(3)
    pairs = [
        COVARIANCE(AXES[i], AXES[j], unit="rad²") for i, j in zip(*upper, strict=True)
    ]
    return plain(
        BIAS.each(AXES, ["rad"] * 3), measured.bias[:3], measured.bias_error[:3], n,
        mean[:3], predictor, left[0],
    ) + plain(
        pairs, measured.covariance[upper], measured.covariance_error[upper], n,
        covariance[upper], predictor, left[1],
    )  # fmt: skip


def series_rows(
    setting: Setting,
    noise_std: float,
    measured: Moments,
    cubature: MeanAndCovariance,
) -> tuple[Row, ...]:
    """Rows of simulated moments beside theory of both orders."""
    found = {order: series_of(setting, noise_std, order) for order in (2, 4)}
    fourth = found[4]
    mean, covariance = cubature[0][:3], cubature[1][:3, :3]
    left = (
        2.0 * float(np.abs(mean - fourth.bias).max()),
        2.0 * float(np.abs(covariance - fourth.covariance).max()),
    )
    rows: tuple[Row, ...] = ()
    for order, name in ((2, ORDER_2), (4, ORDER_4)):
        theory = found[order]
        apart = (
            float(np.abs(theory.bias - fourth.bias).max()) + left[0],
            float(np.abs(theory.covariance - fourth.covariance).max()) + left[1],
        )
        rows += moment_rows(measured, theory.bias, theory.covariance, name, apart)
    return rows


NOISE = 1e-3
"""The noise h: far above rounding, and its fourth power is nothing."""

LEADING_TOLERANCE = 1e-3
"""Relative, as of the leading term of a claimed covariance: the package's estimators
are within 2e-8 in 60 random geometries, and a bias of less is 1e-3 of a standard
deviation."""

NEARER = (1e-4, 1e-5)
"""Of 400 random geometries four have another frame within 1e-3 of their best one."""


def leading_rows(setting: Setting, rounding: float) -> tuple[Row, ...]:
    """Rows of moments at a noise and at half of it; `rounding` of one estimate, rad."""
    sizes = [setting.noise.small(h).noise_std for h in (NOISE, *NEARER)]
    noise = next((h for h in sizes if _of_one_formula(setting, h)), sizes[-1])
    whole, half = (setting.cubature(noise / part, DEGREE) for part in (1.0, 2.0))
    plugin, weights = setting.plugin, setting.weights
    A = attitude_matrix(setting.q) if plugin.side == "reference" else np.eye(3)
    linear = A @ (4.0 * half[0] - whole[0])[:3]
    bias = A @ (16.0 * half[0] - whole[0])[:3] / 3.0
    covariance = A @ ((16.0 * half[1] - whole[1])[:3, :3] / 3.0) @ A.T
    bound = setting.bound(noise)
    size = float(np.trace(bound))
    most = LEADING_TOLERANCE + 5.0 * weights * rounding / np.sqrt(size)
    rows = limit(
        (FIRST_ORDER_BIAS(),), (float(np.linalg.norm(linear)) / np.sqrt(size),),
        most, NO_BIAS, n=1,
    ) + limit(
        (BELOW_BOUND(),), (max(0.0, 1.0 - _least_ratio(covariance, bound)),),
        most, CRAMER_RAO, n=1,
    )  # fmt: skip
    if setting.noise.isotropic and np.ptp(setting.noise.weights) and setting.weighs:
        given = setting.q, setting.references, setting.covariances(noise)
        plain = float(np.trace(class_moments("wahba", *given)[1]))
        rows += limit(
            (OVER_EQUAL_WEIGHTS(),), (float(np.trace(covariance)) / plain,),
            1.0 + most, EQUAL_WEIGHTS, n=1,
        )  # fmt: skip
    slack = 6.0 * weights * rounding
    limits = (
        LEADING_TOLERANCE + slack / size,
        LEADING_TOLERANCE + 2.0 * slack / np.sqrt(size),
    )
    for predictor, mean, spread in _predictions(setting, noise, A):
        # which is the bound's size or more, where it is the theory of an estimator
        most_spread = max(np.linalg.norm(spread), np.linalg.norm(bound))
        off = float(np.linalg.norm(covariance - spread) / most_spread)
        rows += limit(
            (CLASS_BIAS(), CLASS_COVARIANCE()),
            (float(np.linalg.norm(bias - mean)) / size, off), limits, predictor, n=1,
        )  # fmt: skip
    return rows


def _of_one_formula(setting: Setting, noise: float) -> bool:
    """Whether no node of cubature has another best frame than the truth."""
    if setting.plugin.kind != "closed form":
        return True
    vectors = np.concatenate([setting.truth[None], setting.nodes(noise, DEGREE)])
    columns = column_matrix(np.moveaxis(vectors, 0, 2), symmetric=False)
    best = np.argmax(np.einsum("kin,kin->kn", columns, columns), axis=0)
    return bool(np.all(best == best[0]))


def _predictions(
    setting: Setting, noise: float, A: Float[Array, "3 3"]
) -> Iterator[tuple[str, Float[Array, "3"], Float[Array, "3 3"]]]:
    """Theory of second order: of the declared class, and of the plug-in's own series.

    Each with its name, on the body side, to which A takes the plug-in's.
    """
    kind = setting.plugin.kind
    if kind is not None:
        covariances, weights = setting.covariances(noise), setting.noise.weights
        given = setting.q, setting.references, covariances, weights
        yield class_of(kind), *class_moments(kind, *given)
    if setting.plugin.series:
        own = series_of(setting, noise, 2)
        yield ORDER_2, A @ own.bias, A @ own.covariance @ A.T


def _least_ratio(covariance: Float[Array, "3 3"], bound: Float[Array, "3 3"]) -> float:
    """Least variance of any direction over the bound of its variance."""
    root = np.linalg.cholesky(bound)
    half = np.linalg.solve(root, covariance)
    return float(np.linalg.eigvalsh(np.linalg.solve(root, half.T))[0])
