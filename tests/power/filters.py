"""Faults of the filter's chain: rates, draws, the reference filter, and its theory."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from power.calibration import instant
from power.fault import Fault, changed, result, then, times
from simval.imu.filters import Mekf, mekf
from simval.studies import filter, filter_prediction, filter_scenarios
from simval.theory import filter_model


def recorded_anew(change):
    """Other rates, in courses that are made with them and kept no longer."""

    @contextmanager
    def context():
        filter_scenarios.course.cache_clear()
        try:
            with changed(filter_scenarios, "average_rates", change):
                yield
        finally:
            filter_scenarios.course.cache_clear()

    return context


def row_density(original, course, sensors, *more):
    # of a row and not of a root hertz
    own = sensors.gyroscope_noise * np.sqrt(course.dt[0])
    return original(course, replace(sensors, gyroscope_noise=own), *more)


def bias_twice(original, course, sensors, *more):
    return original(course, replace(sensors, bias_std=2 * sensors.bias_std), *more)


def held(given):
    found, bias = given
    rows = np.array(found.accelerometer)
    rows[:, 1:] = found.accelerometer[:, :-1]
    return replace(found, accelerometer=rows), bias


def coning_times(factor):
    def change(original, own, h, rate):
        own.before = factor * own.before
        original(own, h, rate)

    return change


def half_of_what_both_share(original, own, h, rate):
    original(own, h, rate)
    i = np.arange(6)
    own.P[..., i, (i + 3) % 6] += own.K2 * h**2 / 4.0


def bias_by(gain):
    def change(original, own, *given):
        before = own.b
        found = original(own, *given)
        own.b = before + gain * (own.b - before)
        return found

    return change


def unturned(F):
    F[..., :3, :3] = np.eye(3)
    return F


def declined(original, own, **words):
    original(own, **words)
    north, _, down = own.references[1]
    own.references[1] = north * np.cos(0.01), north * np.sin(0.01), down


def per_row(original, own, **words):
    original(own, **words)
    own.N2 = own.N2 / 100.0  # as if the density were of a row at 100 Hz


def of_the_vector_part(found):
    # of the quaternion, which is half of the turn
    halves = np.repeat([0.5, 1.0], 3)
    return found | {"covariance": found["covariance"] * np.outer(halves, halves)}


def other_side(found):
    A = mekf._matrix(found["attitude"]).swapaxes(-1, -2)
    P = np.array(found["covariance"])
    P[..., :3, :] = A @ P[..., :3, :]
    P[..., :, :3] = P[..., :, :3] @ A.swapaxes(-1, -2)
    return found | {"covariance": P}


def without_noise(original, own, *given):
    found = original(own, *given)
    S = np.array(found["innovation_covariance"])
    if S.size:  # a step without vectors has none
        S[..., range(6), range(6)] -= own.R / 4.0
    return found | {"innovation_covariance": S}


def no_magnetometer(original, path, truth, told, **words):
    first, other = (replace(m, sensors=m.sensors[:1]) for m in (truth, told))
    return original(path, first, **words | {"told": other, "errors": ()})


scene = partial(Fault, "filter", "scene", filter_scenarios, "average_rates")
drawn = partial(Fault, "filter", "noise", filter, "drawn")
estimator = partial(Fault, "filter", "estimator")
step, made, correct, answer = (
    partial(estimator, Mekf, name) for name in ("_step", "__init__", "_correct", "_row")
)
formula = partial(Fault, "filter", "formula")
predicted = partial(formula, filter_prediction, "filter_prediction")
FAULTS = (
    scene("rates of an instant under a filter", context=recorded_anew(instant)),
    scene(
        "rates a row late under a filter",
        context=recorded_anew(then(lambda rates: np.roll(rates, 1, axis=0))),
    ),
    drawn("bias of the gyroscope twice as great", bias_twice),
    drawn("density of the gyroscope taken for a row's noise", row_density),
    drawn("accelerometer a row late", then(held)),
    step("coning term lost in the filter", coning_times(0.0)),
    step("coning term doubled in the filter", coning_times(2.0)),
    step("half of the covariance of turn and bias in Q", half_of_what_both_share),
    correct("gain of the bias 10 % small", bias_by(0.9)),
    step("sign of the coning term in the filter", coning_times(-1.0)),
    estimator(
        mekf, "_transition", "covariance that does not turn with the body",
        then(unturned),
    ),
    made("declination of half a degree", declined),
    made("density of the filter's noise taken for a row's", per_row),
    correct("bias never corrected", bias_by(0.0)),
    answer("covariance of the quaternion's vector part", then(of_the_vector_part)),
    answer("covariance of the reference side", then(other_side)),
    answer("a quarter of the noise left out of the innovations'", without_noise),
    predicted(
        "gains of the truth for those that are told",
        lambda o, *a, told, **words: o(*a, **words),
    ),
    predicted("bound without the magnetometer", no_magnetometer),
    formula(
        filter_model, "left_jacobian", "half of the gyroscope's noise in the bound",
        times(0.5),
    ),
    predicted(
        "error of the start left out of the prediction",
        result(parts=lambda M: M.parts[1:], names=lambda M: M.names[1:]),
    ),
)  # fmt: skip
