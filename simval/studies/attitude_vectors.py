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
    two_vector_quaternion,
    wahba_covariance,
    wahba_quaternion,
)
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.results import Outcome, Row, exact, nees, plain, unjudged
from simval.statistics import (
    CHI_SQUARE_3,
    COVARIANCE_OFF,
    FIRST_ORDER,
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
from simval.studies.stated_covariance import closed_form_square, normalized_square
from simval.studies.study import Cost, StudyParameters
from simval.studies.vectors_controls import (
    control_rows,
    linear_features,
    linear_losses,
    loss_rows,
)
from simval.theory import (
    attitude_moments,
    cubature_moments,
    loss_noncentrality,
    wahba_bound,
    wahba_moments,
)

TITLE = "Two or more weighted vectors: error, covariance and test of the loss"
SECTION = "vectors"

MOST_LEFT_OUT = 0.3
"""Of a mean normalised square of 3: noise that is 10 % wrong makes it 0.6. Without the
right weights the second order of a noisy vector swamps the first of a good one."""


MOST_NOISE = 0.1
"""Of any vector, per axis: beyond it a vector may turn round."""

STATED_STEP = 1e-3
"""Of unit vectors: 1e-12 is left of fourth order, and 1e-13 of rounding."""
UNEQUAL = 100.0
"""Ratio of the deviations from which its square enlarges rounding: 7e-9 was the worst
seen at 100, and 1.1e-6 at 1000."""


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
    samples: Annotated[int, Field(ge=4096)] = Field(
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


class Setting:
    """One geometry with its noise, and what first-order theory says of it."""

    def __init__(self, parameters: Parameters) -> None:
        n = self.n = parameters.vectors
        rng = np.random.default_rng(parameters.geometry)
        self.q = random_quaternions(1, rng)[0]
        self.references = normalize(rng.standard_normal((n, 3)))
        self.body = self.references @ attitude_matrix(self.q).T
        self.std = parameters.noise_std * np.append(1.0, [parameters.ratio] * (n - 1))
        self.noise_std = np.stack([self.std, np.zeros(n)])
        self.weights = 1.0 / self.std**2
        noise = self.noise_std.reshape(-1)
        self.bound = float(
            np.trace(wahba_bound(self.q, self.references, noise).rotation)
        )
        moments = {
            "weighted": wahba_moments(self.q, self.references, noise, self.weights),
            "equal weights": wahba_moments(self.q, self.references, noise),
        }
        if n == 2:
            r1, r2 = self.references
            for name, frame in (("combined", "combined"), ("best of four", None)):
                moments[name] = attitude_moments(self.q, r1, r2, noise, 2, frame)
        self.predicted = {
            name: 4.0 * float(np.trace(moment.covariance))
            for name, moment in moments.items()
        }

    def estimates(self, body: Array) -> dict[str, Array]:
        """Attitudes of each estimator, (n, 4), in the order of `predicted`."""
        references = np.broadcast_to(self.references, body.shape)
        found = {
            "weighted": wahba_quaternion(body, references, self.weights),
            "equal weights": wahba_quaternion(body, references),
        }
        if self.n == 2:
            b1, b2, (r1, r2) = body[:, 0], body[:, 1], self.references
            for name, frame in (("combined", "combined"), ("best of four", self.frame)):
                found[name] = two_vector_quaternion(b1, b2, r1, r2, frame)
        return found

    @property
    def frame(self) -> str:
        """The greatest column of the truth, which predictions hold for."""
        r1, r2 = self.references
        return str(attitude_moments(self.q, r1, r2, 0.0).frame)

    def features(self, body: Array) -> Array:
        """Squared errors over predicted, normalised square, and loss, by sample."""
        attitudes = self.estimates(body)
        errors = {name: turn_between(self.q, q) for name, q in attitudes.items()}
        squares = [
            np.sum(errors[name] ** 2, axis=1) / predicted
            for name, predicted in self.predicted.items()
        ]
        references = np.broadcast_to(self.references, body.shape)
        ones = np.ones(self.n)
        covariances = {
            "weighted": wahba_covariance(body, references, self.noise_std),
            "equal weights": wahba_covariance(body, references, self.noise_std, ones),
        }
        own = [normalized_square(errors[k], c) for k, c in covariances.items()]
        if self.n == 2:
            for name, frame in (("combined", "combined"), ("best of four", self.frame)):
                found = attitudes[name], errors[name]
                own.append(closed_form_square(*found, *self.closed_form_inputs, frame))
        loss = consistency(body, references, self.noise_std)
        return np.stack([*squares, *own, loss.statistic], axis=1)

    @property
    def closed_form_inputs(self) -> tuple[Array, Array]:
        """Measured references, which have no noise here, and the noise of b and r."""
        return self.references, self.noise_std.reshape(-1)

    def displaced(self, shift: float) -> Array:
        """What turns the second vector by so many standard deviations of its angle."""
        normal = np.cross(self.body[0], self.body[1])
        displacement = np.zeros((self.n, 3))
        displacement[1] = normalize(np.cross(normal, self.body[1]))
        return shift * float(np.hypot(*self.std[:2])) * displacement

    def apart(self, shift: float) -> float:
        """Non-centrality of the loss under such a turn."""
        given = self.q, self.references, self.displaced(shift), self.weights
        return loss_noncentrality(*given)

    def off(self, shift: float) -> Array:
        """Means of `features` to first order less those by cubature of degree 5."""
        count = len(self.predicted)
        loss = 2.0 * self.n - 3.0 + self.apart(shift)
        moments = cubature_moments(
            lambda *body: self.features(np.stack(body, axis=1)),
            self.body + self.displaced(shift),
            self.std[:, None, None] ** 2 * np.eye(3),
            np.array([1.0] * count + [3.0] * count + [loss]),
            degree=5,
        )
        return moments.bias

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Body vectors with noise, (count, n, 3)."""
        return self.body + self.std[:, None] * rng.standard_normal((count, self.n, 3))

    def noise(self, body: Array) -> Array:
        """Noise of body vectors, in units of its deviation."""
        return (body - self.body) / self.std[:, None]

    def errors(self, x: Array) -> Array:
        """Turn of each estimator by some noise, (count, d), side by side."""
        body = self.body + self.std[:, None] * x.reshape(len(x), self.n, 3)
        found = self.estimates(body).values()
        return np.concatenate([turn_between(self.q, q) for q in found], axis=1)


def turn_between(q: Array, estimate: Array) -> Array:
    """Rotation vector from the truth to each estimate, body axes, rad."""
    difference = compose(conjugate(q), estimate)
    sign = np.where(difference[:, 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(difference[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(difference[:, 3:]))
    per_sine = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    return sign * difference[:, :3] * per_sine


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
