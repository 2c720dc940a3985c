"""Faults of the gyroscope's chain and of the noise model."""

from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, replaced, wrapped
from simval.arrays import Array
from simval.calibrate.gyroscope import fit, moves
from simval.scene import simulate_cached
from simval.sensor import GyroscopeModel, NoiseModel
from simval.studies import gyroscope, noise_model


def gyroscope_faults() -> list[Fault]:
    """All faults of the gyroscope's chain."""
    return [*_scene(), *_sensor(), *_calibrator(), *_formula()]


_fault = partial(Fault, "gyroscope")


def _scene() -> list[Fault]:
    def instant(_: Any, run: Any, every: int = 1) -> Array:
        return np.asarray(run.angular_velocity[::every])

    def turned(original: Any, run: Any, every: int = 1) -> Array:
        quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(original(run, every) @ quarter.T)

    def averages(name: str, change: Any) -> Fault:
        inject = wrapped(gyroscope, "average_rates", change)
        return _fault("scene", name, inject, crash="sign" in name)

    return [
        averages("rates of an instant for averages", instant),
        averages("axes of the gyroscope turned", turned),
        averages("sign of the rates", lambda o, run, every=1: -o(run, every)),
    ]


def _sensor() -> list[Fault]:
    def transposed(original: Any, model: Any, *given: Any, **named: Any) -> Array:
        return original(replace(model, M=model.M.T), *given, **named)

    def force_felt() -> AbstractContextManager[None]:
        # 1e-3 rad/s for each g, which nobody takes out
        original = gyroscope.Tumble.__init__

        def broken(self: Any, parameters: Any) -> None:
            original(self, parameters)
            run = simulate_cached(
                "gimbal", poses=parameters.poses, first_hold=20.0,
                move_time=parameters.move_time,
            )  # fmt: skip
            self.rates = self.rates + 1e-4 * run.specific_force[:: parameters.every]

        return replaced(gyroscope.Tumble, "__init__", broken)

    return [
        _fault(
            "sensor", "M of the gyroscope transposed",
            wrapped(GyroscopeModel, "distort", transposed),
        ),
        _fault("sensor", "g-sensitivity dropped", force_felt),
    ]  # fmt: skip


def _calibrator() -> list[Fault]:
    def slow_clock(original: Any, time: Array, *given: Any, **named: Any) -> Any:
        return original(1.001 * time, *given, **named)

    def row_lost(
        original: Any, time: Array, rows: Array, *more: Any, **named: Any
    ) -> Any:
        late = np.array(rows)
        # one in twenty is the row before
        late[..., 1::20, :] = np.asarray(rows)[..., 0:-1:20, :]
        return original(time, late, *more, **named)

    def no_coning(original: Any, *given: Any) -> Array:
        steps = original(*given)
        steps[..., moves._A, :] = 0.0
        return np.asarray(steps)

    def apart(original: Any, L: Array, blocks: Array) -> Array:
        # the noise of a pose as if each gap had its own
        V = np.array(original(L, blocks))
        own = np.zeros_like(V)
        for k in range(0, V.shape[1] - 1, 2):
            own[:, k : k + 2, k : k + 2] = V[:, k : k + 2, k : k + 2]
        return own

    def quiet(original: Any, *given: Any, **named: Any) -> Any:
        named["angle_random_walk"] = 0.7 * named["angle_random_walk"]
        return original(*given, **named)

    def own(name: str, change: Any, owner: Any, function: str) -> Fault:
        return _fault("calibrator", name, wrapped(owner, function, change))

    return [
        own("a clock that is 0.1 % slow", slow_clock, gyroscope, "moves_between"),
        own("one row in twenty repeated", row_lost, gyroscope, "moves_between"),
        own("coning term lost", no_coning, moves, "_step"),
        own("covariance without the shared poses", apart, fit, "covariance_of"),
        own("told 0.7 of its noise", quiet, gyroscope, "calibrate_gyroscope"),
    ]


def _formula() -> list[Fault]:
    def still(original: Any, *given: Any, **named: Any) -> Any:
        named["pose_std"] = 0.3 * named["pose_std"]
        return original(*given, **named)

    return [
        _fault(
            "formula", "bound with poses of a third of their noise",
            wrapped(gyroscope, "gyroscope_moments", still),
        )
    ]  # fmt: skip


def noise_faults() -> list[Fault]:
    """All faults of the noise model."""
    made = partial(Fault, "noise")

    def louder(original: Any, model: NoiseModel, *given: Any) -> Array:
        white = 1.05 * np.asarray(model.white_raw_per_sqrt_hz)
        return original(replace(model, white_raw_per_sqrt_hz=white), *given)

    def pink_lost(original: Any, model: NoiseModel, *given: Any) -> Array:
        return original(replace(model, flicker_raw=0.0), *given)

    return [
        made("noise", "white noise 5 % louder", wrapped(NoiseModel, "draw", louder)),
        made("noise", "flicker noise dropped", wrapped(NoiseModel, "draw", pink_lost)),
        made(
            "estimator",
            "Allan variances 5 % too small",
            after(noise_model, "allan_variance", lambda v: 0.95 * v),
        ),
        made(
            "formula",
            "(V4) of half the averages",  # of `simval.noise.allan`
            after(noise_model, "allan_covariance", lambda v: 2.0 * v),
        ),
    ]
