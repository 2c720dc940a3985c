"""Faults of the filter's chain: rates, draws, the reference filter, and its theory."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, wrapped
from simval.arrays import Array
from simval.filters import Mekf
from simval.filters import mekf as reference
from simval.studies import filter, filter_prediction, filter_scenarios
from simval.theory import filter_model


def filter_faults() -> list[Fault]:
    """All faults of the filter's chain."""
    return [*_scene(), *_sensor(), *_filter(), *_stated(), *_formula()]


_fault = partial(Fault, "filter")


def _scene() -> list[Fault]:
    def instant(_: Any, run: Any, every: int = 1) -> Array:
        return np.asarray(run.angular_velocity[::every])

    def late(original: Any, run: Any, every: int = 1) -> Array:
        return np.roll(original(run, every), 1, axis=0)

    def rates(name: str, change: Any) -> Fault:
        return _fault("scene", name, lambda: _recorded_anew(change))

    return [
        rates("rates of an instant under a filter", instant),
        rates("rates a row late under a filter", late),
    ]


@contextmanager
def _recorded_anew(change: Any) -> Iterator[None]:
    """Other rates, in courses that are made with them and kept no longer."""
    filter_scenarios.course.cache_clear()
    try:
        with wrapped(filter_scenarios, "average_rates", change)():
            yield
    finally:
        filter_scenarios.course.cache_clear()


def _sensor() -> list[Fault]:
    def drawn(name: str, change: Any) -> Fault:
        return _fault("noise", name, wrapped(filter, "drawn", change))

    def other(original: Any, course: Any, sensors: Any, *more: Any) -> Any:
        return original(course, replace(sensors, bias_std=2 * sensors.bias_std), *more)

    def density(original: Any, course: Any, sensors: Any, *more: Any) -> Any:
        # of a row and not of a root hertz
        own = sensors.gyroscope_noise * np.sqrt(course.dt[0])
        return original(course, replace(sensors, gyroscope_noise=own), *more)

    def held(original: Any, *given: Any) -> Any:
        found, bias = original(*given)
        rows = np.array(found.accelerometer)
        rows[:, 1:] = found.accelerometer[:, :-1]
        return replace(found, accelerometer=rows), bias

    return [
        drawn("bias of the gyroscope twice as great", other),
        drawn("density of the gyroscope taken for a row's noise", density),
        drawn("accelerometer a row late", held),
    ]


def _filter() -> list[Fault]:  # noqa: C901, a fault each
    def step(name: str, change: Any) -> Fault:
        return _fault("estimator", name, wrapped(Mekf, "_step", change))

    def made(name: str, change: Any) -> Fault:
        return _fault("estimator", name, wrapped(Mekf, "__init__", change))

    def no_coning(original: Any, own: Any, h: float, rate: Array) -> None:
        own.before = 0.0 * own.before
        original(own, h, rate)

    def other_coning(original: Any, own: Any, h: float, rate: Array) -> None:
        own.before = -own.before
        original(own, h, rate)

    def unturned(original: Any, phi: Array, h: float) -> Array:
        F = original(phi, h)
        F[..., :3, :3] = np.eye(3)
        return F

    def declined(original: Any, own: Any, **words: Any) -> None:
        original(own, **words)
        north, _, down = own.references[1]
        own.references[1] = north * np.cos(0.01), north * np.sin(0.01), down

    def per_row(original: Any, own: Any, **words: Any) -> None:
        original(own, **words)
        own.N2 = own.N2 / 100.0  # as if the density were of a row at 100 Hz

    def no_bias(original: Any, own: Any, *given: Any) -> Any:
        before = own.b
        answer = original(own, *given)
        own.b = before
        return answer

    def twice_coning(original: Any, own: Any, h: float, rate: Array) -> None:
        own.before = 2.0 * own.before
        original(own, h, rate)

    def half_of_what_both_share(original: Any, own: Any, h: float, rate: Array) -> None:
        original(own, h, rate)
        i = np.arange(6)
        own.P[..., i, (i + 3) % 6] += own.K2 * h**2 / 4.0

    def small_gain(original: Any, own: Any, *given: Any) -> Any:
        before = own.b
        answer = original(own, *given)
        own.b = before + 0.9 * (own.b - before)
        return answer

    return [
        step("coning term lost in the filter", no_coning),
        step("coning term doubled in the filter", twice_coning),
        step("half of the covariance of turn and bias in Q", half_of_what_both_share),
        _fault(
            "estimator",
            "gain of the bias 10 % small",
            wrapped(Mekf, "_correct", small_gain),
        ),
        step("sign of the coning term in the filter", other_coning),
        _fault(
            "estimator",
            "covariance that does not turn with the body",
            wrapped(reference, "_transition", unturned),
        ),
        made("declination of half a degree", declined),
        made("density of the filter's noise taken for a row's", per_row),
        _fault("estimator", "bias never corrected", wrapped(Mekf, "_correct", no_bias)),
    ]


def _stated() -> list[Fault]:
    def answer(name: str, change: Any) -> Fault:
        return _fault("estimator", name, wrapped(Mekf, "update", change))

    def half(original: Any, own: Any, *given: Any) -> Any:
        # of the quaternion's vector part, which is half of the turn
        found = original(own, *given)
        halves = np.repeat([0.5, 1.0], 3)
        return found | {"covariance": found["covariance"] * np.outer(halves, halves)}

    def other_side(original: Any, own: Any, *given: Any) -> Any:
        found = original(own, *given)
        A = reference._matrix(found["attitude"]).swapaxes(-1, -2)
        P = np.array(found["covariance"])
        P[..., :3, :] = A @ P[..., :3, :]
        P[..., :, :3] = P[..., :, :3] @ A.swapaxes(-1, -2)
        return found | {"covariance": P}

    def without_noise(original: Any, own: Any, *given: Any) -> Any:
        found = original(own, *given)
        S = np.array(found["innovation_covariance"])
        if S.size:  # a step without vectors has none
            S[..., range(6), range(6)] -= own.R / 4.0
        return found | {"innovation_covariance": S}

    return [
        answer("covariance of the quaternion's vector part", half),
        answer("covariance of the reference side", other_side),
        answer("a quarter of the noise left out of the innovations'", without_noise),
    ]


def _formula() -> list[Fault]:
    def predicted(name: str, change: Any) -> Fault:
        inject = wrapped(filter_prediction, "filter_prediction", change)
        return _fault("formula", name, inject)

    def honest(original: Any, *given: Any, told: Any, **words: Any) -> Any:
        return original(*given, **words)

    def no_magnetometer(original: Any, path: Any, truth: Any, **words: Any) -> Any:
        words["told"] = _first(words["told"])
        return original(path, _first(truth), **words | {"errors": ()})

    def _first(model: Any) -> Any:
        return replace(model, sensors=model.sensors[:1])

    def small(L: Array) -> Array:
        return 0.5 * L

    def no_start(M: Any) -> Any:
        return replace(M, parts=M.parts[1:], names=M.names[1:])

    return [
        predicted("gains of the truth for those that are told", honest),
        predicted("bound without the magnetometer", no_magnetometer),
        _fault(
            "formula",
            "half of the gyroscope's noise in the bound",
            after(filter_model, "left_jacobian", small),
        ),
        _fault(
            "formula",
            "error of the start left out of the prediction",
            after(filter_prediction, "filter_prediction", no_start),
        ),
    ]
