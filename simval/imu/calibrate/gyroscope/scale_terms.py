"""Scale of a gyroscope that changes with temperature, seen in its rotations."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array, physical_array
from simval.geometry import normalize
from simval.imu.calibrate.equations import Problem
from simval.imu.calibrate.goodness_of_fit import FALSE_ALARM, Drop
from simval.imu.calibrate.gyroscope.at_rest import BiasTerms
from simval.imu.calibrate.gyroscope.calibration import (
    approach,
    first_matrix,
    held_of,
    sensor_of,
)
from simval.imu.calibrate.gyroscope.noise import noise_of
from simval.imu.calibrate.gyroscope.residuals import InterRest
from simval.imu.calibrate.path_statistics import inter_rest_rotations, taken
from simval.imu.calibrate.recording import Recording
from simval.imu.calibrate.rest_temperatures import LEAST_LEFT
from simval.imu.calibrate.thermal import TERMS, Term
from simval.shapes import Float
from simval.spelling import chance as p_words


class Gain(NamedTuple):
    """Dependence of a gyroscope's scale on temperature."""

    thermal: Term | None = None  # terms of its bias among them
    reason: str = ""
    rows: Any = None  # with the scale at the reference
    covariance: Any = None  # of M by that of the terms, (9, 9)


_STEP = 1e-3  # of a scale, 1/K: what it does is nearly linear in it


def scale_terms(
    recording: Recording, time: Any, gyroscope: Any, rests: Any, warm: BiasTerms,
    how: dict[str, Any], offset: Any,
) -> Gain:  # fmt: skip
    """Decide whether the rotations show a scale that is linear in temperature.

    By their residuals, weighed by the noise of both sensors, with M fitted anew for a
    small scale of each axis by turns, and the F test of `goodness_of_fit.Drop`.
    """
    acc = recording.accelerometer
    assert acc is not None
    forces = acc.sensor().correct(recording.poses)
    left, seen = 2 * (len(forces) - 1) - 12, warm.seen
    if seen is None or seen.span < seen.least_span or left < LEAST_LEFT:
        return Gain()
    tau = warm.temperature[:, None] - seen.reference
    away = physical_array("gyroscope", gyroscope, (None, 3)) - offset
    centre = np.mean([away[a:b].mean(axis=0) for a, b in rests], axis=0)
    away = away - centre
    u = np.broadcast_to(normalize(forces), (4, *forces.shape))
    tried, kappa = np.pad(_STEP * np.eye(3), ((1, 0), (0, 0))), np.zeros(3)
    M, square = np.full((4, 3, 3), np.nan), list[float]()
    white: Array = np.zeros((0, 0))
    for _ in range(2):  # the second time about the first answer
        rates = centre + (1.0 + (kappa + tried)[:, None] * tau) * away
        turned = inter_rest_rotations(time, rates, rests, **how)
        if not square:
            left = 2 * len(turned.before) - 12
            M[:] = first_matrix(turned.statistics[0], u[0], turned.before)
        if not (np.isfinite(M).all() and left >= LEAST_LEFT):
            return Gain()
        M, J, e = approach(turned, np.zeros((4, 3)), u, M)
        if not square:
            first = replace(recording, rotations=taken(turned, [0]))
            white = _whitening(first, M[:1])
        J, e = white @ J, np.matvec(white, e)
        q = np.linalg.qr(J[..., :9])[0]
        r = e - np.matvec(q, np.vecmat(e, q))
        square.append(r[0] @ r[0])
        D = (r[1:] - r[0]).T / _STEP
        inverse = np.linalg.pinv(D)
        rest = r[0] - D @ (inverse @ r[0])
        kappa = kappa - inverse @ r[0]
    scatter = rest @ rest
    chance = Drop(rest=scatter, dof=left, known=None).chance(square[0], 3)
    if not (chance < FALSE_ALARM and np.linalg.matrix_rank(D) == 3):
        return Gain()
    covariance = scatter / left * inverse @ inverse.T
    by = (M[1:] - M[0]).reshape(3, 9) / _STEP
    said = (
        "scale of the gyroscope: linear in temperature, as the rotations show an "
        f"effect ({p_words(chance)})"
    )
    return Gain(
        _with_scale(warm, kappa, covariance, centre, left), said,
        centre + (1.0 + kappa * tau) * away + offset, by.T @ covariance @ by,
    )  # fmt: skip


def _whitening(recording: Recording, M: Float[Array, "1 3 3"]) -> Float[Array, "r r"]:
    # inverse root of the covariance (N6) of residuals, the accelerometer held
    rotations, acc = recording.rotations, recording.accelerometer
    assert rotations is not None
    assert acc is not None
    held = held_of(sensor_of(recording), acc.parameters[None], acc.residual)
    noise = noise_of(recording, kept=True)
    turns = InterRest(inter_rest=rotations, noise=noise, each=2)
    return Problem(sensors=(held,), turns=turns).local(M.reshape(1, 9)).white[0]


def _with_scale(
    warm: BiasTerms, kappa: Float[Array, "3"], own: Float[Array, "3 3"],
    centre: Float[Array, "3"], dof: int,
) -> Term:  # fmt: skip
    # the terms of bias and scale, whose errors are independent: of rests and rotations
    bias, seen = warm.thermal, warm.seen
    assert seen is not None
    some = (("scale", 1), *(() if bias is None else bias.terms))
    terms = tuple(term for term in TERMS if term in some)
    scale = np.repeat([what == "scale" for what, _ in terms], 3)
    values, covariance = np.zeros(scale.size), np.zeros((scale.size, scale.size))
    values[scale], covariance[np.ix_(scale, scale)] = kappa, own
    if bias is not None:
        values[~scale] = bias.coefficients.ravel()
        covariance[np.ix_(~scale, ~scale)] = bias.covariance
    return Term(
        reference=seen.reference, low=seen.low, high=seen.high, terms=terms,
        coefficients=values.reshape(-1, 3), covariance=covariance, centre=centre,
        dof=dof if bias is None else min(dof, bias.dof),
    )  # fmt: skip
