"""Faults of the magnetometer chain: sensor, equations, weights, and its theory."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, wrapped
from simval.arrays import Array
from simval.calibrate.magnetometer import equations
from simval.calibrate.magnetometer.calibration import Scaled
from simval.sensor import MagnetometerModel
from simval.studies import magnetometer
from simval.theory import magnetometer as theory


def magnetometer_faults() -> list[Fault]:
    """All faults of the magnetometer chain."""
    return [*_sensor(), *_calibrator(), *_formula()]


_fault = partial(Fault, "magnetometer")


def _sensor() -> list[Fault]:
    def sensor(name: str, change: Any) -> Fault:
        inject = wrapped(MagnetometerModel, "distort", change)
        return _fault("sensor", name, inject)

    def transposed(original: Any, model: Any, field: Array, rng: Any) -> Array:
        return original(replace(model, M=model.M.T), field, rng)

    def no_iron(original: Any, model: Any, field: Array, rng: Any) -> Array:
        return original(replace(model, b=0.0 * model.b), field, rng)

    return [
        sensor("M of the magnetometer transposed", transposed),
        sensor("hard iron dropped", no_iron),
    ]


def _calibrator() -> list[Fault]:
    def wrong_sign(original: Any, scaled: Any, theta: Array, spread: Array) -> Any:
        # u'v - s = 0 for u'v + s = 0, in all of its places: the sine changes its sign
        turned = np.array(theta)
        turned[:, equations.DIP] *= -1.0
        return original(scaled, turned, spread)

    def one_sign(original: Any, at: Any, sine: Array) -> Array:
        return original(at, -sine)

    def without_accelerometer(original: Any, at: Any, readings: Any) -> Array:
        # of the third equation, which both sensors' noise is in
        own = original(at, readings)
        quiet = replace(readings, accelerometer_std=1e-9 * readings.accelerometer_std)
        own[..., 2, :] = original(at, quiet)[..., 2, :]
        own[..., 2, 0] = 0.0
        return own

    def unweighted(original: Any, at: Any, readings: Any) -> Array:
        flat = np.zeros_like(original(at, readings))
        flat[..., range(3), range(3)] = 1.0 / readings.magnetometer_std.mean()
        return flat

    def twin(original: Any, *arguments: Any, **options: Any) -> Any:
        return original(*arguments, **(options | {"hemisphere": "south"}))

    def row_apart(original: Any, a: Array, m: Array, g: float, **options: Any) -> Any:
        return original(a, np.roll(m, 1, axis=-2), g, **options)

    def own(name: str, change: Any, owner: Any, function: str, **options: Any) -> Fault:
        inject = wrapped(owner, function, change)
        return _fault("calibrator", name, inject, **options)

    calibrate = (magnetometer, "calibrate_magnetometer")
    return [
        own("sign of the dip's term", wrong_sign, Scaled, "physical"),
        own(
            "dip's term, not its derivative",
            one_sign, equations, "residual", crash=True,
        ),
        own(
            "accelerometer's noise left out of the weights",
            without_accelerometer, equations, "whitener",
        ),
        own("all equations weighed alike", unweighted, equations, "whitener"),
        own("the twin of the other hemisphere", twin, *calibrate),
        own("poses of the two sensors a row apart", row_apart, *calibrate, crash=True),
    ]  # fmt: skip


def _formula() -> list[Fault]:
    def claim(name: str, change: Any) -> Fault:
        inject = after(magnetometer, "magnetometer_moments", change)
        return _fault("formula", name, inject)

    def known(original: Any, information: Array) -> Array:
        # the bound as if the accelerometer were known: its rows are not eliminated
        covariance = np.array(original(information))
        covariance[9:, 9:] = np.linalg.inv(information[9:, 9:])
        return covariance

    return [
        claim("recipe for the bound", lambda m: replace(m, covariance=m.recipe)),
        claim("bound for the recipe", lambda m: replace(m, recipe=m.covariance)),
        _fault(
            "formula",
            "bound with the accelerometer known",
            wrapped(theory, "inverse_of", known),
        ),
    ]
