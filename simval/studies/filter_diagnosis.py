r"""What a wrong filter is wrong by: the part of its error that all trials share.

Noise, start and bias are drawn anew for each trial, so the mean over trials of a sound
filter's error is 0 to first order. What is left of a mean :math:`m_k` at the instants k
is the filter's own, and each cause has a form, with the rate :math:`\omega_k` and the
attitude :math:`A_k`, world to body:

.. math:: m_k = A_k (c_w, c_n, 0)' \;\text{(tilt)}, \quad A_k (0, 0, c)' \;\text{
   (heading)}, \quad c \;\text{(mounting)}, \quad -\omega_k \tau \;\text{(delay)}.
   \tag{F14}

Each is fitted alone. What none of them explains is of the motion: coning, a scale.
"""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.consistency import mean_of_trials
from simval.geometry import attitude_matrix
from simval.results import Row, limit, unjudged
from simval.shapes import Float
from simval.statistics import (
    CONSTANT,
    CRAMER_RAO,
    NORMAL,
    PART_OF_INNOVATION,
    PART_OVER_STATED,
    RMS_BELOW_BOUND,
    STATED_OVER_BOUND,
    SYSTEMATIC,
)
from simval.studies.filter_rows import Answers, root_mean_square

FORMS: Final = ("tilt", "heading", "mounting", "delay")

ONE: Final = "one form"

MOST: Final = 0.8
"""Of what trials share, from which one form is the cause."""

SHARED: Final = 0.5
"""Of the squared error of a filter without a covariance that one form may be: no motion
and no gain makes a constant."""

FAR: Final = 6.5
"""Standard errors below the bound: by chance once in 10^10 cells."""

SLACK: Final = 0.02
"""Of the bound: what its first order leaves out."""


def diagnosis_rows(
    answers: Answers,
    rate: Float[Array, "k 3"],
    bound: Float[Array, "i 3 3"],
    judged: bool,
) -> tuple[Row, ...]:
    """What all trials share of the error, by its form, and what is stated of parts.

    Judged are an error below the bound and, without a covariance, a form that is most
    of the error.
    """
    e, A = answers.error, attitude_matrix(answers.truth[answers.late])
    n = len(e)
    mean, square = e.mean(axis=0), float(np.mean(np.sum(e**2, axis=-1)))
    # the mean of n has a share 1/n of the variance by chance
    chance = np.sum(e.var(axis=0, ddof=1), axis=-1) / n
    shared = max(float(np.mean(np.sum(mean**2, axis=-1) - chance)), 0.0)
    share = shared / square if square > 0.0 else 0.0
    rows = [*unjudged(SYSTEMATIC(), share, 0.0, n)]
    total, most = float(np.sum(mean**2)), 0.0
    for name, X in zip(FORMS, _forms(A, rate[answers.late]), strict=True):
        flat = X.reshape(-1, X.shape[-1])
        inverse = np.linalg.pinv(flat)
        each = e.reshape(n, -1) @ inverse.T
        value, left = each.mean(axis=0), mean.ravel() - flat @ each.mean(axis=0)
        explained = 1.0 - float(left @ left) / total if total > 0.0 else 0.0
        size = float(np.linalg.norm(value))
        signed = float(value[0]) if len(value) == 1 else size
        error = float(np.linalg.norm(each.std(axis=0, ddof=1)) / np.sqrt(n))
        rows += unjudged(SYSTEMATIC(name), share * max(explained, 0.0), 0.0, n)
        most = max(most, explained)
        unit = "s" if name == "delay" else "rad"
        rows += unjudged(CONSTANT(name, unit=unit), signed, error, n)
    whole = float(np.sqrt(np.trace(bound, axis1=1, axis2=2).mean()))
    rms, error, _ = root_mean_square(np.linalg.norm(e, axis=-1))
    if judged and answers.found.covariance is None:
        cause = share * most if most >= MOST else 0.0
        rows += limit(SYSTEMATIC(ONE), cause, SHARED + FAR / n, NORMAL, n)
    if judged:
        below = max(1.0 - (rms + FAR * error) / whole, 0.0)
        rows += limit(RMS_BELOW_BOUND(), below, SLACK, CRAMER_RAO, n)
    return (*rows, *_stated(answers, A, bound))


def _forms(
    A: Float[Array, "i 3 3"], rate: Float[Array, "i 3"]
) -> tuple[Float[Array, "i 3 p"], ...]:
    mounting = np.broadcast_to(np.eye(3), A.shape)
    return A[:, :, :2], A[:, :, 2:], mounting, -rate[:, :, None]


def _stated(
    answers: Answers, A: Float[Array, "i 3 3"], bound: Float[Array, "i 3 3"]
) -> tuple[Row, ...]:
    # heading and inclination apart, in the world, and each reading's innovation
    rows: list[Row] = []
    P = answers.found.covariance
    if P is not None:
        parts = np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
        own, least = (
            np.diagonal(A.swapaxes(-1, -2) @ each @ A, axis1=-2, axis2=-1)
            for each in (P[:, answers.late, :3, :3], bound)
        )
        error = (answers.error[..., None, :] @ A)[..., 0, :] ** 2
        for name, part in zip(("heading", "inclination"), parts, strict=True):
            squares = (error @ part) / (own @ part)
            rows += unjudged(PART_OVER_STATED(name), *mean_of_trials(squares), 1.0)
            ratio = np.sqrt((own @ part).mean() / (least @ part).mean())
            rows += unjudged(STATED_OVER_BOUND(name), float(ratio), 0.0, len(P))
    nu, S = answers.found.innovation, answers.found.innovation_covariance
    if nu is not None and S is not None:
        late = answers.late
        ratio = nu[:, late] ** 2 / np.diagonal(S[:, late], axis1=2, axis2=3)
        for j in range(ratio.shape[-1]):
            mean = mean_of_trials(ratio[..., j])
            rows += unjudged(PART_OF_INNOVATION(str(j + 1)), *mean, 1.0)
    return tuple(rows)
