r"""Two or more vectors with weights: error, stated covariance, test of the loss.

One geometry of n vector pairs; the first pair has the noise `noise_std`, the others
`ratio` times as much. Four things are measured: the mean square error of each estimator
over the one that first-order theory predicts; its squared error, normalised by the
covariance that is computed from the measured vectors of each sample; how often the
chi-square test of the loss calls good samples inconsistent; and how often it finds a
second vector that is turned by `shift` standard deviations of its angle.

The same samples are averaged once more with what the estimators would give if they were
linear (`simval.studies.response`). The turn of each by the noise x is :math:`Jx` to
first order. The loss of the best attitude is, to first order, the square of what is
left of the noise when the directions are taken out along which it cannot be seen: each
vector along itself, and all together under a turn :math:`\omega` of the attitude, which
changes them by :math:`(b_i \times \omega) / \sigma_i`. With P the projection onto the
rest,

.. math:: \mathrm{loss} \approx |P(x + d)|^2

is chi-square with 2 n - 3 degrees of freedom and the non-centrality :math:`|Pd|^2`, for
a displacement d of the vectors in units of their noise.

What the first order leaves out is computed: Gaussian cubature of the same quantities,
of degree 5, gives their means to the next order, of degree 7 to the one after it, at
the noise and at half of it. What falls with the noise to the next order, and the size
of the one after it, twice, is the remainder. Either alone may vanish in a geometry. Up
to a remainder of `MOST_LEFT_OUT` of a mean, theory's first order holds. Of the loss the
mean may be off by m and the variance by a share v: then the share beyond a threshold t
is that beyond t less or plus :math:`m + \tfrac12 v |t - \mu|`, to first order in both.

The noise is isotropic, tangent to each body vector or has heavy tails
(`simval.studies.noise_kinds`; unequal noise is `ratio`), and the vectors of the closed
forms are taken as they are or normalised; least squares normalises them. To first order
normalised vectors, and least squares, have the noise across the vectors alone, so that
what they state of isotropic noise holds of tangent noise, too. Heavy tails add (SC2) to
what the first order leaves out, and their loss is not chi-square: its test is recorded.

Second and fourth order of the least squares' covariance are set against cubature of
degree 7 besides, without chance. How much either may leave out is said by the powers of
the noise in that truth, and not by the distance of a formula from it. The first of them
is what the second order must be.
"""

from collections.abc import Iterator
from typing import Final, Literal, Self

import numpy as np
import scipy
from pydantic import model_validator

from simval import statistics as stat
from simval.arrays import Array
from simval.change import PAIRED_SHARE
from simval.consistency import normalised_squares, rotation_error
from simval.errors import RefusedError
from simval.figures import Figure, Listing, entry, family_words, predictor
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.imu.attitude import (
    consistency,
    two_vector_quaternion,
    wahba_covariance,
    wahba_quaternion,
)
from simval.results import Outcome, Row, Rows, beyond, exact, nees, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.noise_kinds import (
    TAILS,
    noise_covariances,
    noise_roots,
    tails,
)
from simval.studies.response import (
    MET,
    apart,
    beside,
    linearized,
    reduced_mean,
    reduced_share,
    response,
)
from simval.studies.study import (
    Cost,
    Geometry,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.studies.trials import (
    correlation_row,
    mean_of,
    noise_row,
    root,
    share_error,
)
from simval.theory import (
    attitude_moments,
    cubature_moments,
    loss_noncentrality,
    multiplicative_moments,
    wahba_bound,
    wahba_moments,
)
from simval.theory.two_vector import FRAMES, MIN_NORM, Frame, column_norms

TITLE = "Two or more weighted vectors: error, covariance and test of the loss"
SECTION = "vectors"

FALSE_ALARM = 1e-2
"""Of the chi-square test: rare, and seen 655 times in 65 536 samples."""

MOST_LEFT_OUT = 0.1
"""Of a mean: noise that is 10 % wrong makes it 0.2. Without the right weights the
second order of a noisy vector swamps the first of a good one."""


HEAVY: Final = (
    "the noise has heavy tails, and the loss is chi-square of normal noise alone"
)

MOST_SAMPLES = 4_000_000
"""They are held all at once: 8 GB with six vectors."""

MOST_NOISE = 0.1
"""Of any vector, per axis: beyond it a vector may turn round."""

STATED_STEP = 8e-3
"""Of unit vectors that fix every turn alike, else as much smaller as the least of them
is fixed worse. The fourth order leaves 6e-9; rounding is less the greater the step."""
ROUNDED = 20.0 / PAIRED_SHARE
"""Of eps times how unequal the weights are, over the step: 12 was the most seen in 200
settings with readings moved by up to two units of the last place, and another processor
may move a value by that share of its remainder."""

NEXT, NEXT_ROUNDED, MOST_NEXT = 2.0, 5e3, 0.1
"""What fourth order leaves out, over the truth's third power of the variance (1.003 was
the most seen in 200 settings); rounding of that power, over eps times how unequal the
weights are, over the sine and the error of a turn (2.5e3 was the most seen in 1,200
settings: the three noises magnify it 40 times); and the most that the truth may have
beyond its first power, because from 0.2 on the next orders count."""
LEVELS = np.array([1.0, 0.5, 0.25])
"""Of the noise, through which the truth's three powers of the variance go."""


class Parameters(StudyParameters):
    """One cell: how many vectors, and how unequal their noise is."""

    vectors: int = ranged(2, "Vector pairs.", 2, 6)
    noise_std: float = ranged(
        1e-4, "Noise per axis of the body vector of the first pair.", 1e-5, 1e-2
    )
    ratio: float = ranged(
        1.0, "Noise of the other pairs over that of the first.", 1.0, 1e3
    )
    shift: float = ranged(
        3.0, "Turn of the wrong vector, in standard deviations.", 0.0, 10.0
    )
    geometry: Geometry = 0
    samples: int = ranged(65_536, "Trials.", 4096, MOST_SAMPLES)
    noise: Literal["isotropic", "tangent", "heavy tails"] = described(
        "isotropic", "Noise of the body vectors."
    )
    normalized: bool = described(False, "Normalise the vectors of the closed forms.")

    # the same draws for each kind of noise, so that cells compare
    no_noise = ("noise", "normalized")

    @model_validator(mode="after")
    def _require_vectors(self) -> Self:
        """Check that no vector is lost in its noise."""
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
        closed_forms = 1.5e-5 * self.samples * (self.vectors == 2)
        orders = 0.01 * self.vectors**2
        orders *= 2.0 * self.vectors if self.noise == "heavy tails" else 1.0
        return Cost(
            0.05 + orders + 2e-6 * self.samples * self.vectors + closed_forms, 50
        )


class Setting:
    """One geometry with its noise, its estimators, and their first-order theory."""

    def __init__(self, parameters: Parameters) -> None:
        n = self.n = parameters.vectors
        rng = np.random.default_rng(parameters.geometry)
        self.q = random_quaternions(1, rng)[0]
        self.references = normalize(rng.standard_normal((n, 3)))
        self.body = self.references @ attitude_matrix(self.q).T
        self.std = parameters.noise_std * np.append(1.0, [parameters.ratio] * (n - 1))
        self.noise_std = np.stack([self.std, np.zeros(n)])
        self.kind, self.normalized = parameters.noise, parameters.normalized
        self.roots = noise_roots(self.kind, self.body)
        vectors = np.concatenate([self.body, self.references])
        sizes = self.noise_std.reshape(-1, 1, 1) ** 2
        noise = self.covariances = sizes * noise_covariances(self.kind, vectors)
        self.bound = np.trace(wahba_bound(self.q, self.references, noise).rotation)
        self.weights = {"weighted": 1.0 / self.std**2, "equal weights": np.ones(n)}
        moments = {
            name: wahba_moments(self.q, self.references, noise, weights)
            for name, weights in self.weights.items()
        }
        self.frames: dict[str, Frame] = {}
        if n == 2:
            r1, r2 = self.references
            best = attitude_moments(self.q, r1, r2, 0.0).frame  # at the truth
            self.frames = {"combined": "combined", "best of four": best}
            for name, frame in self.frames.items():
                moments[name] = attitude_moments(
                    self.q, r1, r2, noise, 2, frame, normalized=self.normalized
                )
        self.predicted = {
            name: 4.0 * np.trace(moment.covariance) for name, moment in moments.items()
        }

    def estimates(self, body: Float[Array, "t n 3"]) -> dict[str, Array]:
        """Attitudes of each estimator, in the order of `predicted`."""
        found = {
            name: wahba_quaternion(body, self.references, weights)
            for name, weights in self.weights.items()
        }
        for name, frame in self.frames.items():
            b1, b2, (r1, r2) = body[:, 0], body[:, 1], self.references
            found[name] = two_vector_quaternion(
                b1, b2, r1, r2, frame, normalized=self.normalized
            )
        return found

    def stated(self, name: str, body: Float[Array, "t n 3"]) -> Float[Array, "t 3 3"]:
        """Covariance that a least-squares estimator states for each sample."""
        given = body, self.references, self.noise_std
        weights = {"weighted": None}.get(name, self.weights[name])
        return wahba_covariance(*given, weights)

    def losses(self, body: Float[Array, "t n 3"]) -> Float[Array, " t"]:
        """Loss at the best attitude of each sample."""
        return consistency(body, self.references, self.noise_std).statistic

    def features(self, body: Float[Array, "t n 3"]) -> Float[Array, "t m"]:
        """Squared errors over prediction, normalised squares, loss and its square."""
        attitudes = self.estimates(body)
        errors = {name: rotation_error(q, self.q) for name, q in attitudes.items()}
        squares = [
            np.sum(errors[name] ** 2, axis=1) / predicted
            for name, predicted in self.predicted.items()
        ]
        own = [
            normalised_squares(errors[k], self.stated(k, body)) for k in self.weights
        ]
        for name, frame in self.frames.items():
            given = attitudes[name], errors[name], self.references
            across = self.normalized or self.kind == "tangent"
            noise = self.noise_std.reshape(-1)
            own.append(closed_form_square(*given, noise, frame, across))
        loss = self.losses(body)
        return np.stack([*squares, *own, loss, loss * loss], axis=1)

    def displaced(self, shift: float) -> Float[Array, "n 3"]:
        """Displacement of the second vector by `shift` standard deviations."""
        normal = np.cross(self.body[0], self.body[1])
        displacement = np.zeros((self.n, 3))
        displacement[1] = normalize(np.cross(normal, self.body[1]))
        return shift * np.hypot(*self.std[:2]) * displacement

    def apart(self, shift: float) -> float:
        """Non-centrality of the loss when a vector is displaced."""
        given = self.q, self.references, self.displaced(shift)
        return loss_noncentrality(*given, self.weights["weighted"])

    def means(self, shift: float) -> Float[Array, " m"]:
        """First-order means of `features`."""
        count = len(self.predicted)
        loss, variance = self.loss_moments(shift)
        return np.array([1.0] * count + [3.0] * count + [loss, loss * loss + variance])

    def loss_moments(self, shift: float) -> tuple[float, float]:
        """First-order mean and variance of the loss."""
        freedom, apart = 2.0 * self.n - 3.0, self.apart(shift)
        return freedom + apart, 2.0 * (freedom + 2.0 * apart)

    def off(self, shift: float, degree: int) -> Float[Array, " m"]:
        """First-order means minus those by cubature, with (SC2) under heavy tails."""

        def off(scales: Array) -> Array:
            return cubature_moments(
                lambda *body: self.features(np.stack(body, axis=1)),
                self.body + self.displaced(shift),
                scales[:, None, None] * self.covariances[: self.n],
                self.means(shift),
                degree,
            ).bias

        one = np.ones(self.n)
        middle = off(one)
        if self.kind != "heavy tails":
            return middle
        steps = np.sqrt(TAILS - 1.0) * np.eye(self.n)
        pairs = [(off(one + h) + off(one - h)) / 2.0 - middle for h in steps]
        return middle + np.sum(pairs, axis=0)

    @property
    def sine(self) -> float:
        """How well the vectors determine the worst direction; 1 if they are many."""
        seen = self.n * np.eye(3) - self.body.T @ self.body
        return np.sqrt(min(np.linalg.eigvalsh(seen)[0], 1.0))

    def draw(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[Array, "t n 3"], Float[Array, "t n 3"]]:
        """Draw normal numbers, and noise of variance 1 made of them."""
        normal = rng.standard_normal((count, self.n, 3))
        return normal, normal * tails(self.kind, (count, self.n, 1), rng)

    def noisy(self, x: Float[Array, "t n 3"]) -> Float[Array, "t n 3"]:
        """Body vectors with this noise."""
        turned = (self.roots @ x[..., None])[..., 0]
        return self.body + self.std[:, None] * turned

    def turns(self, body: Float[Array, "t n 3"]) -> Float[Array, "t p"]:
        """Turns of all estimators from the truth, side by side."""
        found = self.estimates(body).values()
        return np.concatenate([rotation_error(q, self.q) for q in found], axis=1)

    def errors(self, x: Float[Array, "t d"]) -> Float[Array, "t p"]:
        """Turns under this noise."""
        return self.turns(self.noisy(x.reshape(-1, self.n, 3)))

    def linear_losses(
        self, x: Float[Array, "t n 3"], shift: float
    ) -> tuple[Float[Array, " t"], float]:
        """Loss of each sample to first order, and its non-centrality."""
        n = self.n
        unseen = np.zeros((n, 3, n + 3))
        unseen[np.arange(n), :, np.arange(n)] = self.body
        unseen[:, :, n:] = np.cross(self.body[:, None], np.eye(3)).mT
        unseen[:, :, n:] /= self.std[:, None, None]
        basis = np.linalg.qr(unseen.reshape(3 * n, -1))[0]

        def left(v: Float[Array, "... d"]) -> Float[Array, "..."]:
            return np.sum(v * v, axis=-1) - np.sum((v @ basis) ** 2, axis=-1)

        displaced = self.displaced(shift) / self.std[:, None]
        shifted = (x + displaced).reshape(len(x), -1)
        return left(shifted), float(left(displaced.reshape(-1)))


def closed_form_square(
    q: Float[Array, "n 4"],
    error: Float[Array, "n 3"],
    references: Float[Array, "2 3"],
    noise_std: Float[Array, "4"],
    frame: Frame,
    normalized: bool = False,
) -> Float[Array, " n"]:
    """Squared turns, normalised by second-order theory at each estimate.

    Where a fixed frame is singular at an estimate, its covariance there has no bound,
    and the square is 0.
    """
    r1, r2 = references
    square, kept = np.zeros(len(q)), np.ones(len(q), dtype=bool)
    if frame != "combined":
        norms = np.abs(column_norms(q, r1, r2)[:, FRAMES.index(frame)])
        kept = norms >= MIN_NORM
    found = attitude_moments(
        q[kept], r1, r2, noise_std, 2, frame, normalized=normalized
    )
    # a turn is twice its sine
    covariance = 4.0 * multiplicative_moments(found).covariance[:, :3, :3]
    square[kept] = normalised_squares(error[kept], covariance)
    return square


def left_out(parameters: Parameters, shift: float = 0.0) -> Float[Array, " m"]:
    """Upper bound on what the first order leaves out of the features' means.

    Only what falls with the noise counts, found by halving it: by its square, or by its
    first power where a vector is turned. A formula that is wrong at any noise does not
    become its own remainder.
    """
    lower = {"noise_std": parameters.noise_std / 2.0}
    settings = Setting(parameters), Setting(parameters.model_copy(update=lower))
    next_order, after = (
        settings[0].off(shift, degree) - settings[1].off(shift, degree)
        for degree in (5, 7)
    )
    change = np.abs(next_order) + np.abs(after - next_order)
    return 2.0 * change / (0.5 if shift else 0.75)


def unequal(weights: Float[Array, " n"]) -> float:
    """Rounding of unit vectors, magnified by unequal weights."""
    return (weights.max() / weights.min()) * float(np.finfo(float).eps)


def why_outside(left: float, mean: float) -> str:
    """Say why first-order means do not hold here; empty if they do."""
    if left <= MOST_LEFT_OUT * mean:
        return ""
    return (
        f"the next orders may be {left / mean:.2g} of the first; theory holds up to "
        f"{MOST_LEFT_OUT:g}"
    )


@refusing("lower `noise_std` or `ratio`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure and predict one cell."""
    setting, n, shift = Setting(parameters), parameters.samples, parameters.shift
    normal, x = setting.draw(n, streams.block(0))
    values = setting.features(setting.noisy(x))
    off = left_out(parameters)
    rows = _estimator_rows(setting, values, x, off)
    tests = _test_rows("good", setting, 0.0, x, values[:, -2], off)
    vectors = [*np.moveaxis(normal, 1, 0)]
    if shift > 0.0:
        more, y = setting.draw(n, streams.block(1))
        losses = setting.losses(setting.noisy(y) + setting.displaced(shift))
        off = left_out(parameters, shift)
        tests += _test_rows("wrong vector", setting, shift, y, losses, off)
        vectors += [*np.moveaxis(more, 1, 0)]
    return Outcome(
        rows=(
            *noise_row(normal.reshape(n, -1)),
            *rows,
            *tests,
            *correlation_row(vectors),
            *_stated_rows(setting),
            *_order_rows(setting),
        )
    )


def _estimator_rows(
    setting: Setting, values: Array, x: Float[Array, "t n 3"], off: Array
) -> Rows:
    """Squared and normalised errors of each estimator, and RMS over the bound.

    Then the judged ones of them with the linear turns as control variates.
    """
    (mean, error, n), count = mean_of(values), len(setting.predicted)
    known = linearized(setting.errors, x.reshape(n, -1))
    squares: list[Row] = []
    own: list[Row] = []
    ratios: list[Row] = []
    linear: list[tuple[Array, float]] = []
    normal: list[tuple[Array, float]] = []
    for k, (name, predicted) in enumerate(setting.predicted.items()):
        row = plain(
            stat.SQUARED_ERROR(name), mean[k], error[k], n,
            1.0, stat.FIRST_ORDER, off[k],
        )  # fmt: skip
        squares += beyond(row, why_outside(off[k], 1.0))
        ratio = np.sqrt(predicted / setting.bound)
        rms, width = root(mean[k], ratio * error[k])
        ratios += unjudged(
            stat.RMS_OVER_BOUND(name), ratio * rms, width, n, ratio, stat.FIRST_ORDER
        )
        j = k + count
        row = nees(
            stat.NEES(name), mean[j], error[j], n, 3.0, stat.CHI_SQUARE_3, off[j]
        )
        own += beyond(row, why_outside(off[j], 3.0))
        turn = known.take(slice(3 * k, 3 * k + 3))
        variance = np.trace(turn.covariance) / predicted
        linear.append((np.sum(turn.first**2, axis=1) / predicted, variance))
        solved = np.linalg.solve(turn.covariance, turn.first.T).T
        normal.append((np.vecdot(turn.first, solved), 3.0))
    sharper = [
        each
        for k, row in enumerate(squares + own)
        if row.claimed
        for each in beside([row], [reduced_mean(values[:, k], *(linear + normal)[k])])
    ]
    return (*squares, *own, *ratios, *sharper)


def _test_rows(
    name: str,
    setting: Setting,
    shift: float,
    x: Float[Array, "t n 3"],
    losses: Float[Array, " t"],
    off: Float[Array, " m"],
) -> Rows:
    """Share of samples whose loss exceeds the threshold.

    The last two of `off` are what the first order leaves out of the loss and its
    square.
    """
    freedom, n = 2 * setting.n - 3, len(losses)
    threshold = scipy.special.chdtri(freedom, FALSE_ALARM)

    def share(apart: float, more: float = 0.0) -> float:
        return 1.0 - scipy.special.chndtr(threshold + more, freedom, apart)

    (mean, variance), (of_mean, of_square) = setting.loss_moments(shift), off[-2:]
    of_variance = (of_square + 2.0 * mean * of_mean) / variance
    far = of_mean + 0.5 * of_variance * abs(threshold - mean)
    apart = setting.apart(shift)
    chance = share(apart)
    ends = share(apart, -min(far, threshold)), share(apart, far)
    seen, (linear, known) = losses > threshold, setting.linear_losses(x, shift)
    rows = plain(
        stat.INCONSISTENT_RATE(name), np.mean(seen), share_error(chance, n), n,
        chance, stat.CHI_SQUARE, np.abs(np.array(ends) - chance).max(),
    )  # fmt: skip
    worst = max(of_mean / mean, 0.5 * of_variance)
    if setting.kind == "heavy tails":  # nor is its share beside a known one
        return beyond(rows, HEAVY)
    rows = beyond(rows, why_outside(worst, 1.0))
    sharper = reduced_share(seen, linear > threshold, share(known))
    return (*rows, *beside(rows, [sharper]))


def _stated_rows(setting: Setting) -> Rows:
    """Stated covariances of least squares, against the response to noise."""
    moved = response(
        lambda y: setting.turns(y.reshape(len(y), -1, 3)), setting.body.ravel(),
        STATED_STEP * setting.sine,
    )  # fmt: skip
    covariance = moved.covariance(np.repeat(setting.std, 3))
    rows: Rows = ()
    for k, (name, weights) in enumerate(setting.weights.items()):
        own = slice(3 * k, 3 * k + 3)
        left = max(MET, ROUNDED * unequal(weights) / (STATED_STEP * setting.sine))
        off = apart(setting.stated(name, setting.body[None])[0], covariance[own, own])
        rows += exact(stat.COVARIANCE_OFF(name), off, 0.0, stat.RESPONSE, left)
    return rows


def _order_rows(setting: Setting) -> Iterator[Row]:
    """Covariance of least squares to second and fourth order, against cubature.

    Both are of normal noise: under heavy tails they are those of the isotropic one.
    """
    names = [*setting.weights]

    def signed(*body: Array) -> Array:
        found = setting.estimates(np.stack(body, axis=1))
        turned = [found[k] * np.sign(found[k] @ setting.q)[:, None] for k in names]
        return np.concatenate(turned, axis=1)

    noise = setting.covariances[: setting.n]
    zero, squares = np.tile(setting.q, len(names)), LEVELS**2
    truths = np.array([
        cubature_moments(signed, setting.body, square * noise, zero, 7).covariance
        for square in squares
    ])  # fmt: skip
    powers = squares[:, None] ** np.arange(1, len(squares) + 1)
    terms = np.tensordot(np.linalg.inv(powers), truths, axes=1)
    for k, (name, weights) in enumerate(setting.weights.items()):
        own = np.s_[4 * k : 4 * k + 4, 4 * k : 4 * k + 4]
        true = truths[0][own]
        size = float(np.linalg.norm(true))
        given = setting.q, setting.references, setting.covariances, weights
        try:
            moments = [wahba_moments(*given, order) for order in (2, 4)]
        except RefusedError:  # rounding counts: not judged
            continue
        off = [np.linalg.norm(each.covariance - true) for each in moments]
        second, fourth = (float(each / size) for each in off)
        second = float(f"{second:.3g}")  # what is beyond is rounding of the estimates
        yield from unjudged(stat.LEFT_OUT(name), second, predictor=stat.ORDER_2)
        beyond_first = float(np.linalg.norm(terms[1][own] + terms[2][own])) / size
        third = float(np.linalg.norm(terms[2][own])) / size
        turned = setting.sine * 2.0 * np.sqrt(size)
        third += NEXT_ROUNDED * unequal(weights) / turned
        # the second order is the first power of the variance, and no more
        first = float(np.linalg.norm(moments[0].covariance - terms[0][own])) / size
        yield from exact(stat.LEFT_OUT(name), first, 0.0, stat.FIRST_POWER, third)
        rows = exact(stat.LEFT_OUT(name), fourth, 0.0, stat.ORDER_4, NEXT * third)
        out = (
            f"{beyond_first:.2g} of the covariance is beyond its first power of the "
            f"noise; what the fourth order leaves out is known up to {MOST_NEXT:g}"
        )
        yield from beyond(rows, out if beyond_first > MOST_NEXT else "")


FIGURES = (
    Figure(
        name="vectors",
        asked="What does each estimator of weighted vectors cost?",
        what="The simulated error",
        says="The RMS error over the bound is at most {most_each}.",
        rows=[stat.RMS_OVER_BOUND],
        by=stat.FIRST_ORDER,
        along="ratio",
        lines=entry(0),
        value="RMS error / bound",
        level=1.0,
        log_y=False,
        ratio=False,
        caption=(
            "RMS error over the Cramér-Rao bound against how unequal the noise is: "
            "the first vector's is fixed, the others are the given multiple of it."
        ),
    ),
    Listing(
        name="vectors",
        caption="Error of each estimator in each setting, and its covariance",
        rows=[stat.RMS_OVER_BOUND, stat.SQUARED_ERROR, stat.NEES],
        keys={"estimator": entry(0)},
        column=family_words,
        predicted=True,
    ),
    Listing(
        name="vectors-order",
        caption="Covariance of least squares by each order, against cubature",
        rows=[stat.LEFT_OUT],
        keys={"estimator": entry(0)},
        column=predictor,
    ),
    Listing(
        name="vectors-test",
        caption=(
            "Chi-square test of the loss: share of good samples that it rejects, and "
            "of samples with a displaced second vector that it detects"
        ),
        claim="Chi-square test of the loss: the share that it rejects",
        rows=[stat.INCONSISTENT_RATE],
        keys={},
        column=entry(0),
        predicted=True,
    ),
)
