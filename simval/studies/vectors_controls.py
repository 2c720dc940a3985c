r"""What weighted vectors would give if their estimators were linear.

The turn of each estimator by the noise x is :math:`Jx` to first order, J by differences
of the estimator (`simval.studies.expanded`). The loss of the best attitude is, to first
order, the square of what is left of the noise when the directions are taken out along
which it cannot be seen: each vector along itself, and all together under a turn
:math:`\omega` of the attitude, which changes them by
:math:`(b_i \times \omega) / \sigma_i`. With P the projection onto the rest,

.. math:: \mathrm{loss} \approx |P(x + d)|^2

is chi-square with 2 n - 3 degrees of freedom and the non-centrality :math:`|Pd|^2`, for
a displacement d of the vectors in units of their noise.
"""

from collections.abc import Callable, Sequence

import numpy as np
import scipy

from simval.arrays import Array
from simval.results import Row, plain
from simval.shapes import Float
from simval.statistics import CHI_SQUARE, INCONSISTENT_RATE
from simval.studies.expanded import beside, linearized, reduced_mean, reduced_share

FALSE_ALARM = 1e-2
"""Of the chi-square test: rare, and seen 655 times in 65 536 samples."""


def linear_features(
    errors: Callable[[Array], Array],
    x: Float[Array, "t n 3"],
    predicted: Sequence[float],
) -> tuple[Float[Array, "t k"], Float[Array, " k"]]:
    """Squared turns over predicted, then normalised ones, and the means of both."""
    known = linearized(errors, x.reshape(len(x), -1))
    parts, means = [], []
    normal = []
    for k, size in enumerate(predicted):
        own = known.take(slice(3 * k, 3 * k + 3))
        parts.append(np.sum(own.first**2, axis=1) / size)
        means.append(float(np.trace(own.covariance)) / size)
        solved = np.linalg.solve(own.covariance, own.first.T).T
        normal.append(np.vecdot(own.first, solved))
    return np.stack([*parts, *normal], axis=1), np.array([*means, *[3.0] * len(normal)])


def linear_losses(
    body: Float[Array, "n 3"],
    std: Float[Array, " n"],
    x: Float[Array, "t n 3"],
    displaced: Float[Array, "n 3"],
) -> tuple[Float[Array, " t"], float]:
    """Loss to first order of each sample, and its non-centrality."""
    n = len(body)
    unseen = np.zeros((n, 3, n + 3))
    unseen[np.arange(n), :, np.arange(n)] = body
    unseen[:, :, n:] = np.cross(body[:, None], np.eye(3)).transpose(0, 2, 1)
    unseen[:, :, n:] /= std[:, None, None]
    basis = np.linalg.qr(unseen.reshape(3 * n, -1))[0]

    def left(v: Float[Array, "... d"]) -> Float[Array, "..."]:
        return np.sum(v * v, axis=-1) - np.sum((v @ basis) ** 2, axis=-1)

    shifted = (x + displaced).reshape(len(x), -1)
    return left(shifted), float(left(displaced.reshape(-1)))


def control_rows(
    rows: Sequence[Row],
    values: Float[Array, "t m"],
    known: Float[Array, "t k"],
    means: Float[Array, " k"],
) -> tuple[Row, ...]:
    """The judged ones of the rows of some features, with control variates."""
    return tuple(
        each
        for k, row in enumerate(rows)
        if row.check != "record"
        for each in beside([row], [reduced_mean(values[:, k], known[:, k], means[k])])
    )


def loss_rows(
    name: str,
    losses: Float[Array, " t"],
    law: tuple[int, float],
    off: float,
    linear: tuple[Float[Array, " t"], float],
) -> tuple[Row, ...]:
    """Share of samples whose loss is above the threshold, also with control variates.

    `law` are the degrees of freedom and the non-centrality that theory predicts, `off`
    what its first order leaves out of the mean loss, `linear` as of `linear_losses`.
    """
    (freedom, apart), n = law, len(losses)
    threshold = float(scipy.special.chdtri(freedom, FALSE_ALARM))
    chance, steeper = (_share(threshold, k, apart) for k in (freedom, freedom + 2))
    share, error = np.mean(losses > threshold), np.sqrt(chance * (1 - chance) / n)
    left = 0.5 * (steeper - chance) * off  # the derivative by the non-centrality
    rows = plain(INCONSISTENT_RATE(name), share, error, n, chance, CHI_SQUARE, left)
    known = _share(threshold, freedom, linear[1])
    reduced = reduced_share(losses > threshold, linear[0] > threshold, known)
    return (*rows, *beside(rows, [reduced]))


def _share(threshold: float, freedom: int, apart: float) -> float:
    # share of a chi-square law above the threshold, its centre `apart` from 0
    return 1.0 - float(scipy.special.chndtr(threshold, freedom, apart))
