r"""Two or more vectors with weights: error, stated covariance, test of the loss.

One geometry of n vector pairs; the first pair has the noise `noise_std`, the others
`ratio` times as much. Four things are measured: the mean square error of each estimator
over the one that first-order theory predicts; its squared error, normalised by the
covariance that is computed from the measured vectors of each sample; how often the
chi-square test of the loss calls good samples inconsistent; and how often it finds a
second vector that is turned by `shift` standard deviations of its angle.

The same samples are averaged once more with their linear part as a control variate
(`simval.studies.vectors_controls`).

What the first order leaves out is computed: Gaussian cubature of the same quantities,
of degree 5, gives their means to the next order, at the noise and at half of it. Twice
what falls with the noise is the remainder.
"""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from simval.arrays import Array
from simval.attitude import (
    consistency,
    wahba_covariance,
)
from simval.figures import Figure, Listing, entry
from simval.results import Outcome, Row, exact, nees, plain, unjudged
from simval.statistics import (
    CHI_SQUARE_3,
    COVARIANCE_OFF,
    FIRST_ORDER,
    INCONSISTENT_RATE,
    NEES,
    RESPONSE,
    RMS_OVER_BOUND,
    SQUARED_ERROR,
)
from simval.streams import Streams
from simval.studies.drawn import correlation_row
from simval.studies.expanded import noise_row
from simval.studies.refusing import refusing
from simval.studies.response import MET, apart, response
from simval.studies.study import Cost, StudyParameters
from simval.studies.vectors_controls import (
    control_rows,
    linear_features,
    linear_losses,
    loss_rows,
)
from simval.studies.vectors_setting import Setting, turn_between

TITLE = "Two or more weighted vectors: error, covariance and test of the loss"
SECTION = "vectors"

MOST_LEFT_OUT = 0.3
"""Of a mean normalised square of 3: noise that is 10 % wrong makes it 0.6. Without the
right weights the second order of a noisy vector swamps the first of a good one."""


MOST_SAMPLES = 4_000_000
"""They are held all at once: 8 GB with six vectors."""

MOST_NOISE = 0.1
"""Of any vector, per axis: beyond it a vector may turn round."""

STATED_STEP = 2e-3
"""Of unit vectors: what fourth order leaves, 2e-9, and rounding are alike."""
UNEQUAL = 100.0
"""Ratio of the deviations from which its square enlarges rounding: 8e-9 was the worst
seen at 100, and 1.1e-6 at 1000, on processors of two kinds."""


class Parameters(StudyParameters):
    """One cell: how many vectors, and how unequal their noise is."""

    vectors: Annotated[int, Field(ge=2, le=6)] = Field(
        default=2, description="Vector pairs."
    )
    noise_std: Annotated[float, Field(ge=1e-5, le=1e-2)] = Field(
        default=1e-4, description="Noise per axis of the body vector of the first pair."
    )
    ratio: Annotated[float, Field(ge=1.0, le=1e3)] = Field(
        default=1.0, description="Noise of the other pairs over that of the first."
    )
    shift: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=3.0, description="Turn of the wrong vector, in standard deviations."
    )
    geometry: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        default=0, description="Number of the random geometry."
    )
    samples: Annotated[int, Field(ge=4096, le=MOST_SAMPLES)] = Field(
        default=65_536, description="Trials."
    )

    @model_validator(mode="after")
    def _require_vectors(self) -> Self:
        """Check that no vector drowns in its noise."""
        most = self.noise_std * self.ratio
        if not most <= MOST_NOISE:
            msg = (
                f"`noise_std` is {self.noise_std:g} and `ratio` {self.ratio:g}: that "
                f"makes {most:.3g} of a vector of length 1; at most {MOST_NOISE:g} is "
                "allowed, so lower one of them"
            )
            raise ValueError(msg)
        return self

    def cost(self) -> Cost:
        """Cost of a cell."""
        closed_forms = 2e-5 * self.samples * (self.vectors == 2)
        return Cost(0.3 + 3e-6 * self.samples * self.vectors + closed_forms, 50)


def left_out(parameters: Parameters, shift: float = 0.0) -> Array:
    """Twice what the first order leaves out of the means of `features`.

    Only what falls with the noise counts, found by halving it: by its square, or by its
    first power where a vector is turned. A formula that is wrong at any noise does not
    become its own remainder.
    """
    lower = {"noise_std": parameters.noise_std / 2.0}
    halved = Setting(parameters.model_copy(update=lower))
    change = Setting(parameters).off(shift) - halved.off(shift)
    return 2.0 * np.abs(change) / (0.5 if shift else 0.75)


@refusing("lower `noise_std` or `ratio`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure and predict one cell."""
    setting, n = Setting(parameters), parameters.samples
    body = setting.draw(n, streams.block(0))
    values, x = setting.features(body), setting.noise(body)
    off = left_out(parameters)
    rows, ratios = _estimator_rows(setting, values, off)
    known = linear_features(setting.errors, x, list(setting.predicted.values()))
    tests = _test_rows(setting, 0.0, x, values[:, -1], off[-1])
    vectors = [*np.moveaxis(x, 1, 0)]
    shift = parameters.shift
    if shift > 0.0:
        again = setting.draw(n, streams.block(1))
        wrong = again + setting.displaced(shift)
        references = np.broadcast_to(setting.references, wrong.shape)
        losses = consistency(wrong, references, setting.noise_std).statistic
        off = left_out(parameters, shift)
        y = setting.noise(again)
        tests += _test_rows(setting, shift, y, losses, off[-1])
        vectors += [*np.moveaxis(y, 1, 0)]
    return Outcome(
        rows=(
            *noise_row(x.reshape(n, -1)),
            *rows,
            *ratios,
            *control_rows(rows, values, *known),
            *tests,
            *correlation_row(vectors),
            *_stated_rows(setting),
        )
    )


def _stated_rows(setting: Setting) -> tuple[Row, ...]:
    """Covariances that the least squares state, beside how their answers move."""
    body, references = setting.body, setting.references

    def errors(y: Array) -> Array:
        found = setting.estimates(y.reshape(-1, *body.shape))
        turns = [turn_between(setting.q, found[name]) for name in names]
        return np.concatenate(turns, axis=1)

    names = ("weighted", "equal weights")
    weights: tuple[tuple[Array, ...], ...] = ((), (np.ones(setting.n),))
    moved = response(errors, body.ravel(), STATED_STEP)
    noise = np.repeat(setting.std, 3)
    left = MET * max(1.0, (setting.std.max() / setting.std.min() / UNEQUAL) ** 2)
    rows: tuple[Row, ...] = ()
    for k, (name, given) in enumerate(zip(names, weights, strict=True)):
        own = slice(3 * k, 3 * k + 3)
        given = (body[None], references[None], setting.noise_std, *given)
        off = apart(wahba_covariance(*given)[0], moved.covariance(noise)[own, own])
        rows += exact(COVARIANCE_OFF(name), off, 0.0, RESPONSE, left)
    return rows


def _estimator_rows(
    setting: Setting, values: Array, off: Array
) -> tuple[list[Row], list[Row]]:
    # squared error and normalised square of each estimator, and its RMS over the bound
    n, count = len(values), len(setting.predicted)
    mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(n)
    squares: list[Row] = []
    own: list[Row] = []
    ratios: list[Row] = []
    for k, (name, predicted) in enumerate(setting.predicted.items()):
        squares += plain(
            SQUARED_ERROR(name), mean[k], error[k], n, 1.0, FIRST_ORDER, off[k]
        )
        ratio, root = np.sqrt(predicted / setting.bound), np.sqrt(mean[k])
        width = ratio * error[k] / (2.0 * root)
        ratios += unjudged(
            RMS_OVER_BOUND(name), ratio * root, width, n, ratio, FIRST_ORDER
        )
        j = k + count
        judged = nees if off[j] <= MOST_LEFT_OUT else unjudged
        own += judged(NEES(name), mean[j], error[j], n, 3.0, CHI_SQUARE_3, off[j])
    return squares + own, ratios


def _test_rows(
    setting: Setting, shift: float, x: Array, losses: Array, off: float
) -> tuple[Row, ...]:
    displaced = setting.displaced(shift) / setting.std[:, None]
    return loss_rows(
        "wrong vector" if shift else "good",
        losses,
        (2 * setting.n - 3, setting.apart(shift)),
        off,
        linear_losses(setting.body, setting.std, x, displaced),
    )


def _family(row: Row) -> str:
    return row.statistic.family.words


FIGURES = (
    Figure(
        name="vectors",
        asked="What does each estimator of weighted vectors cost?",
        what="The simulated error",
        says="The RMS error over the bound is at most {most_each}.",
        rows=[RMS_OVER_BOUND],
        by=FIRST_ORDER,
        along="ratio",
        lines=entry(0),
        value="RMS error / bound",
        level=1.0,
        log_y=False,
        ratio=False,
        caption=(
            "RMS error over the Cramér-Rao bound against how unequal the noise is: "
            "the first vector's is fixed, the others have so many times as much."
        ),
    ),
    Listing(
        name="vectors",
        caption="Error of each estimator in each setting, and its covariance",
        rows=[RMS_OVER_BOUND, SQUARED_ERROR, NEES],
        keys={"estimator": entry(0)},
        column=_family,
        predicted=True,
    ),
    Listing(
        name="vectors-test",
        caption=(
            "Chi-square test of the loss: share of good samples that it refuses, and "
            "of samples with a second vector turned by the shift that it finds"
        ),
        claim="Chi-square test of the loss: the share that it refuses",
        rows=[INCONSISTENT_RATE],
        keys={},
        column=entry(0),
        predicted=True,
    ),
)
