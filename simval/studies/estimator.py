r"""A user-supplied attitude estimator: its errors, beside cubature and the bound.

The plug-in's conventions are probed without noise first, at generic attitudes. At the
classes of attitudes where estimators break (`simval.plugins.attitudes`) the
share of exact cases that fail must be 0, unless the plug-in declares that class. Then
each trial adds noise to the body vectors, or what `noise` says
(`simval.plugins.noise`); the references are exact by default. The error is the rotation
vector from the truth to the estimate, on the side that the plug-in declares. Its bias
and covariance are set beside Gaussian cubature of the plug-in itself: no theory of it
is needed, and the two share nothing but its code. The remainder is twice the difference
between cubature of degree 7 and of degree 5.

Such a comparison alone would let a wrong plug-in agree with itself. An error without
first-order bias, :math:`e = Jn + \tfrac12 n^T H n`, has the mean
:math:`\tfrac12\,\mathrm{tr}(H\Sigma)`: products of two first-order errors, as
:math:`\tfrac12\,e' \times e''` is of two turns. So the bias by cubature must be within
the trace of the covariance, up to the error of cubature itself. At a noise of `SMALL`,
where that error is negligible, it must be within the trace of the Cramer-Rao bound, up
to rounding: a constant error does not shrink with the noise and fails. Of 400
geometries with the same noise on all four vectors the two-vector estimator takes at
most 0.17 of that trace; orthogonal frames and least squares have no such bias there.

`simval.studies.estimator_setting` asks more: no bias of first order, nothing below the
bound, and of an estimator that declares its class the bias and covariance of it.

Where the plug-in gives a covariance, and can know the noise that this is of, its
normalised squared error has the mean 3, up to what the claim leaves out. An exact claim
leaves out nothing: by cubature it may be off only by the error of cubature itself,
again twice the difference of the degrees. A claim of order k is allowed twice the error
that cubature finds in it, and its order must be true: halving the noise must reduce
that error by :math:`2^k`, and at least by :math:`2^{k - 1/2}`. So a wrong leading term
is never hidden by its own remainder. Nor is a covariance that is wrong at this noise
alone: its error is at most :math:`2^{k + 1/2}` times that at half the noise, and what
the next order brings, :math:`(c \lambda)^{k/2 + 1}` with the greatest variance
:math:`\lambda` of the error, rad^2, and c of `NEXT`.

Whatever the estimator, unit quaternions have :math:`E|q - \hat q|^2 = 2 q^T E[q - \hat
q]`. The first block is held to it within what the lengths that the plug-in returned
are off by (its own precision; `UNIT` at the most) and rounding.

With m the mean square of its errors and :math:`m_0` that of the built-in least squares
under the same noise, the efficiency is the trace of the Cramer-Rao bound over m, and
the difference :math:`\sqrt m - \sqrt{m_0}`. Cubature gives both without chance, to
twice what its next lower degree differs by. Simulated they are a check of that; since
both estimators see the same vectors the difference has a small standard error, by

.. math:: \frac12 \left(\frac{dm}{\sqrt m} - \frac{dm_0}{\sqrt{m_0}}\right), \tag{D1}

and at least by the rounding of one estimate.
"""

from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from simval.arrays import Array
from simval.errors import InputError
from simval.moments import Moments
from simval.montecarlo import Sums, mean_square, moments_of, simulate
from simval.plugins import Estimator, find_plugin, probe_estimator
from simval.plugins.attitudes import COUNT
from simval.plugins.noise import VectorNoise, vector_noise
from simval.plugins.probe import TOLERANCE, failure_shares
from simval.plugins.runs import require_no_memory
from simval.results import Outcome, Row, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.statistics import (
    CLAIM_OFF,
    CLAIM_OFF_FULL,
    CLAIM_OFF_HALF,
    CRAMER_RAO,
    CUBATURE,
    CUBATURE_BIAS,
    CUBATURE_BIAS_SMALL,
    CUBATURE_ERROR,
    EFFICIENCY,
    FAILURES,
    NEES,
    PROBE,
    RMS,
    RMS_DIFFERENCE,
    ROUNDING,
    SECOND_ORDER,
    SQUARED_ERROR,
    TRUTH,
    UNIT_LENGTH,
    claim_of,
    order,
)
from simval.streams import Streams
from simval.studies.estimator_setting import (
    DEGREE,
    SQUARES,
    MeanAndCovariance,
    Setting,
    leading_rows,
    moment_rows,
    series_rows,
)
from simval.studies.plugin import PluginName, PluginParameters, isolated
from simval.studies.refusing import LEAST_NOISE
from simval.theory.expansion import unit_length_defect, unit_length_rounding


def failure_rows(
    plugin: Estimator,
    cases: int,
    vectors: int = 2,
    noise: VectorNoise | None = None,
) -> tuple[Row, ...]:
    """Share of failures of each class; one that is declared is not judged."""
    shares = failure_shares(plugin, cases, vectors, noise)
    declared = dict.fromkeys(name for name in plugin.fails_at if name in shares)
    known = {name: shares.pop(name) for name in declared}
    return (
        *limit(FAILURES.each(shares), tuple(shares.values()), 0.0, TRUTH, n=cases),
        *unjudged(FAILURES.each(known), tuple(known.values()), n=cases),
    )


_EPS = float(np.finfo(float).eps)

SAME = 1e-9
"""Relative difference of two RMS errors that may be rounding."""

_CLEARLY = 3.0
"""A spread of so many remainders is enough to judge: twice is required."""


def size_rows(
    setting: Setting,
    sums: Sums,
    noise: float,
    cubatures: tuple[MeanAndCovariance, MeanAndCovariance],
    rounding: float,
) -> tuple[Row, ...]:
    """Rows of sums, beside cubature and the next lower one; `rounding` in rad."""
    weight = np.zeros((sums.size, sums.size))
    weight[:3, :3] = np.eye(3)
    square, error = mean_square(sums, weight)
    least, n = float(np.trace(setting.bound(noise))), sums.samples
    rms = float(np.sqrt(square))
    fine, coarse = (moments[0][SQUARES] for moments in cubatures)
    efficiency = least / float(fine[0])
    left = 2.0 * abs(efficiency - least / float(coarse[0]))
    return (
        *unjudged(
            RMS(unit="rad"), rms, error / (2.0 * rms), n, np.sqrt(least), CRAMER_RAO
        ),
        *unjudged(EFFICIENCY(), efficiency, remainder=left),
        *_tail_row(square, n, cubatures),
        *plain(
            EFFICIENCY("simulated"), least / square, least * error / square**2, n,
            efficiency, CUBATURE, left,
        ),
        *_difference_rows(sums, fine, coarse, max(rounding, _EPS), setting.weights),
    )  # fmt: skip


def _tail_row(
    square: float, n: int, cubatures: tuple[MeanAndCovariance, MeanAndCovariance]
) -> tuple[Row, ...]:
    """Mean square over cubature's, with the standard error that cubature gives it.

    The trials' own is no measure: rare ones that are far off make both great.
    """
    (mean, covariance), (coarse, _) = cubatures
    fine = float(mean[SQUARES][0])
    gaussian = 2.0 * float(np.sum(covariance[:3, :3] ** 2))
    variance = max(gaussian, float(covariance[SQUARES, SQUARES][0, 0]))
    return plain(
        SQUARED_ERROR(), square / fine, np.sqrt(variance / n) / fine, n,
        1.0, CUBATURE, 2.0 * abs(1.0 - float(coarse[SQUARES][0]) / fine),
    )  # fmt: skip


def _difference_rows(
    sums: Sums,
    fine: Float[Array, "2"],
    coarse: Float[Array, "2"],
    rounding: float,
    weights: float,
) -> tuple[Row, ...]:
    measured = moments_of(sums)
    squares = measured.bias[SQUARES]
    slope = np.array([0.5, -0.5]) / np.sqrt(squares)
    variance = float(slope @ measured.covariance[SQUARES, SQUARES] @ slope)
    predicted = _difference(fine)
    unresolved, rounded = 2.0 * abs(predicted - _difference(coarse)), weights * rounding
    left = unresolved + rounded
    spread = max(variance, rounding**2 * sums.samples)
    # what differs by rounding, its own or of cubature, is judged by it
    if unresolved < max(rounded, SAME * np.sqrt(squares[1])):
        spread = max(spread, (_CLEARLY * left) ** 2)
    return plain(
        RMS_DIFFERENCE(), _difference(squares), np.sqrt(spread / sums.samples),
        sums.samples, predicted, CUBATURE, left,
    )  # fmt: skip


def _difference(squares: Float[Array, "2"]) -> float:
    own, other = np.sqrt(squares)
    return float(own - other)


TITLE = "User-supplied attitude estimator: bias, spread and stated covariance"
SECTION = "algorithms"

BLOCK = 1024  # samples; part of the promise of equal bits, as is `BATCH`
BATCH = 8
MOST_NOISE = 0.1
"""Of any vector, per axis."""

SQUARE_APART = 0.01
"""By which a normalised square may differ in another order, relative to it and 1."""

SMALL = 1e-5
"""Noise at which a second-order bias and the error of cubature are negligible."""

SMALL_ROUNDING = 2.0 * TOLERANCE
"""Rad; the root of rounding, 1.5e-8, times the sum of the weights' sizes, `WEIGHTS`;
where cubature has greater weights, as many times more."""

WEIGHTS = 107.0
"""Of cubature with two body and two reference vectors."""

NEXT = 4.0
"""1/rad^2; over 20 geometries, five kinds of noise and levels to 0.1, sound claims of
least squares and of the information matrix need 0.43 of the greatest variance."""

RESOLVED = 1e-6
"""Relative error of a claim below which its order cannot be told from rounding."""


class Parameters(PluginParameters):
    """One cell: a plug-in, a geometry and a noise level."""

    plugin = "algorithm"
    no_noise = ("algorithm", "cases", "time_limit")

    algorithm: PluginName = Field(
        default="", description="FILE.py, FILE.py:NAME or the name of an entry point."
    )
    geometry: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        default=3, description="Number of the random attitude and vectors, a seed."
    )
    noise_std: Annotated[float, Field(ge=LEAST_NOISE, le=MOST_NOISE)] = Field(
        default=0.01, description="Noise per axis of each body vector of length 1."
    )
    noise: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = Field(
        default="body",
        description="Noise of each vector relative to `noise_std`: body, all, tangent, "
        'unequal, general, standard deviations such as "1 3 0 0" of b1, b2, r1, r2, '
        "or as many 3 x 3 covariances in JSON.",
    )
    vectors: Annotated[int, Field(ge=2, le=6)] = Field(
        default=2, description="Vector pairs."
    )
    samples: Annotated[int, Field(ge=BLOCK)] = Field(
        default=16_384, description="Trials; rounded up to whole blocks of 1024."
    )
    cases: Annotated[int, Field(ge=64, le=1 << 20)] = Field(
        default=COUNT, description="Exact cases of each class of attitudes."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        default=300.0, description="Wall time after which the cell fails, s."
    )

    @model_validator(mode="after")
    def _require_noise(self) -> Self:
        """Check that the noise is of as many vectors, and no vector drowns in it."""
        noise = vector_noise(self.noise, self.vectors, self.noise_std)
        if not noise.std.max() <= MOST_NOISE * (1.0 + 1e-12):
            msg = (
                f"`noise_std` is {self.noise_std:g} and `noise` {self.noise:.60}: that "
                f"makes {noise.std.max():.3g} of a vector of length 1; at most "
                f"{MOST_NOISE:g} is allowed, so lower one of them"
            )
            raise InputError(msg)
        return self


def claim_off(moments: tuple[Array, Array]) -> float:
    """Relative error of the mean normalised square, whose true value is 3."""
    return float(moments[0][3]) / 3.0 - 1.0


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in a child process."""
    return isolated(outcome, parameters, streams, parameters.time_limit, Estimator)


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in this process."""
    return outcome(find_plugin(parameters.algorithm, Estimator), parameters, streams)


def outcome(plugin: Estimator, parameters: Parameters, streams: Streams) -> Outcome:
    """Measure an estimator that this process holds."""
    noise, vectors = parameters.noise_std, parameters.vectors
    setting = Setting(plugin, parameters.geometry, vectors, parameters.noise)
    asked = plugin if setting.claims else replace(plugin, covariance=None)
    off = probe_estimator(asked, vectors, setting.noise)
    first: list[Float[Array, "n p"]] = []

    def sampled(rng: np.random.Generator, count: int) -> Float[Array, "p n"]:
        errors = setting.errors(setting.drawn(count, noise, rng), noise)
        first.extend([] if first else [errors])
        return errors.T

    sums = simulate(
        sampled,
        streams,
        samples=parameters.samples,
        block=BLOCK,
        batch=BATCH,
    )
    _require_no_memory(setting, noise, streams, first[0])
    cubature = setting.cubature(noise, DEGREE)
    coarser = setting.cubature(noise, DEGREE - 2)
    rows = [
        *limit(PROBE(unit="rad"), off, TOLERANCE, TRUTH, n=1),
        *failure_rows(plugin, parameters.cases, vectors, setting.noise),
        *_bias_rows(setting, cubature, coarser),
        *leading_rows(setting, off / setting.sine),
        *_beside_cubature(moments_of(sums), cubature, coarser),
        *size_rows(setting, sums, noise, (cubature, coarser), off / setting.sine),
        *_unit_rows(setting, noise, streams),
    ]
    if plugin.series:
        rows += series_rows(setting, noise, moments_of(sums), cubature)
    if setting.claims:
        off, other = claim_off(cubature), claim_off(coarser)
        half = setting.cubature(noise / 2.0, DEGREE)
        rows += _claim_rows(
            plugin.claim, moments_of(sums), off, claim_off(half), abs(off - other)
        )
        rows += _full_rows(plugin.claim, off, claim_off(half), cubature[1][:3, :3])
    return Outcome(rows=tuple(rows))


def _require_no_memory(
    setting: Setting, noise: float, streams: Streams, first: Float[Array, "n p"]
) -> None:
    """Check that trials of the first block have the same errors in another order."""
    vectors = setting.drawn(len(first), noise, streams.block(0))
    allowed = np.full(first.shape, np.inf)
    allowed[:, :3] = TOLERANCE / setting.sine
    if setting.claims:
        allowed[:, 3] = SQUARE_APART * (1.0 + first[:, 3])
    require_no_memory(
        setting.plugin.name,
        first,
        lambda places: setting.errors(vectors[places], noise),
        allowed,
    )


def _unit_rows(setting: Setting, noise: float, streams: Streams) -> tuple[Row, ...]:
    """Whether mean and mean square of the first block are those of unit quaternions."""
    error = setting.additive(setting.drawn(BLOCK, noise, streams.block(0)))
    estimate = setting.q - error
    off = float(np.abs(np.sum(estimate * estimate, axis=1) - 1.0).max())
    square = float(np.mean(np.sum(error * error, axis=1)))
    defect = unit_length_defect(square, float(setting.q @ error.mean(axis=0)))
    most = unit_length_rounding(square, off)
    return limit(UNIT_LENGTH("simulated"), abs(defect), most, ROUNDING, BLOCK)


def _bias_rows(
    setting: Setting,
    predicted: tuple[Float[Array, " p"], Float[Array, "p p"]],
    coarser: tuple[Float[Array, " p"], Float[Array, "p p"]],
) -> tuple[Row, ...]:
    """Bias by cubature, and the most that is of second order."""
    mean, covariance = predicted
    unresolved = 2.0 * float(np.linalg.norm((mean - coarser[0])[:3]))
    small = setting.noise.small(SMALL).noise_std
    rounding = SMALL_ROUNDING * max(1.0, setting.weights / WEIGHTS)
    longer = 1.0 + setting.coupling
    most = (
        longer * float(np.trace(covariance[:3, :3])) + unresolved + TOLERANCE,
        longer * float(np.trace(setting.bound(small))) + rounding,
    )
    biases = [
        float(np.linalg.norm(bias[:3]))
        for bias in (mean, setting.cubature(small, DEGREE)[0])
    ]
    families = (CUBATURE_BIAS(), CUBATURE_BIAS_SMALL())
    return limit(families, biases, most, SECOND_ORDER, n=1)


def _beside_cubature(
    measured: Moments, cubature: MeanAndCovariance, coarser: MeanAndCovariance
) -> tuple[Row, ...]:
    """Moments beside cubature, to twice what its next lower degree differs by."""
    mean, covariance = (
        2.0 * np.abs(a - b) for a, b in zip(cubature, coarser, strict=True)
    )
    left = float(mean[:3].max()), float(covariance[:3, :3].max())
    return moment_rows(measured, *cubature, CUBATURE, left)


def _full_rows(
    claim: int | str, off: float, half: float, covariance: Float[Array, "3 3"]
) -> tuple[Row, ...]:
    """Whether the error of a claim is as much greater than at half the noise."""
    if isinstance(claim, str):
        return ()
    greatest = float(np.linalg.eigvalsh(covariance)[-1])
    following = (NEXT * greatest) ** (claim / 2.0 + 1.0)
    most = 2.0 ** (claim + 0.5) * abs(half) + following
    return limit(CLAIM_OFF_FULL(), abs(off), max(most, RESOLVED), order(claim), n=1)


def _claim_rows(
    claim: int | str, measured: Moments, off: float, half: float, unresolved: float
) -> tuple[Row, ...]:
    """Mean normalised square, and whether the claimed order is true."""
    if isinstance(claim, str):
        statistic, value, allowed = CLAIM_OFF(), abs(off), 0.0
        most, predictor = 2.0 * unresolved, CUBATURE_ERROR
    else:
        statistic, value, allowed = CLAIM_OFF_HALF(), abs(half), 6.0 * abs(off)
        most, predictor = abs(off) / 2.0 ** (claim - 0.5), order(claim)
    return nees(
        NEES(), measured.bias[3], measured.bias_error[3], measured.samples,
        3.0, claim_of(claim), allowed,
    ) + limit(statistic, value, max(most, RESOLVED), predictor, n=1)  # fmt: skip
