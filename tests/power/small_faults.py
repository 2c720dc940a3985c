"""Small faults of code, in the smoke suite's own cells.

A derivative that is off by a thousandth, a detector that is off by a sample.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from power.fault import Fault, Part, after, everywhere, wrapped
from simval.arrays import Array
from simval.calibrate import evidence
from simval.calibrate.gyroscope import turn
from simval.calibrate.magnetometer import equations
from simval.calibrate.minimization import Leverage
from simval.filters import mekf
from simval.statics import detector, intervals, variance
from simval.studies import (
    attitude_vectors,
    calibration,
    gyroscope,
    noise_model,
    scene,
)
from simval.studies import detector as study_of_detector
from simval.theory import calibration as calibration_theory
from simval.theory import filter_model
from simval.theory import gyroscope as gyroscope_theory
from simval.theory import magnetometer as magnetometer_theory

OFF = 1.001


def small_code_faults() -> list[Fault]:
    """All of them."""
    return [*_theory(), *_algorithm(), *_rests(), *_detector(), *_means()]


def _smoke(study: str, part: Part, name: str, inject: Any) -> Fault:
    return Fault(f"smoke {study}", part, f"{name}, {study}", inject)


def _scaled(index: Any) -> Any:
    def change(values: Array) -> Array:
        result = np.array(values)
        result[index] *= OFF
        return result

    return change


def _theory() -> list[Fault]:
    def part(name: str) -> Any:
        def change(x: Any) -> Any:
            values = np.array(getattr(x, name))
            values[:, 4] *= OFF
            return replace(x, **{name: values})

        return after(calibration_theory, "_geometry", change)

    def rows(given: Any) -> Any:
        moves, C = given
        return _scaled((slice(None), slice(None), 4))(moves), C

    def formula(study: str, name: str, inject: Any) -> Fault:
        return _smoke(study, "formula", name, inject)

    one = "a derivative of theory 0.1 % off"
    return [
        formula("calibration", one, part("d")),
        formula("ladder", one, part("d")),
        formula("ladder", "a second derivative 0.1 % off", part("bend")),
        formula(
            "magnetometer", one,
            after(magnetometer_theory, "jacobian", _scaled((slice(None), 1, 10))),
        ),
        formula("gyroscope", one, after(gyroscope_theory, "move_rows", rows)),
        formula(
            "filter", one, after(filter_model, "left_jacobian", lambda L: OFF * L)
        ),
        formula(
            "noise_model", "a covariance 0.2 % off",
            after(noise_model, "allan_covariance", lambda v: OFF**2 * v),
        ),
    ]  # fmt: skip


def _algorithm() -> list[Fault]:
    def calibrator(study: str, name: str, inject: Any) -> Fault:
        return _smoke(study, "calibrator", name, inject)

    def pulled(original: Any, leverage: Any, bias: Array, *, newton: bool) -> Any:
        local = original(leverage, bias, newton=newton)
        # of the leverage's slope, a term of what the start left
        return replace(
            local, gradient=local.gradient + 1e-3 * leverage.start_cost[:, None]
        )

    one = "a derivative 0.1 % off"
    everywhere = slice(None)
    entry = _scaled((everywhere, everywhere, 2, 10))
    return [
        calibrator(
            "coverage", "a derivative 0.1 % off in the error bars",
            after(evidence, "value_derivatives", _scaled((..., 4))),
        ),
        calibrator(
            "calibration", "a gradient 0.1 % off", wrapped(Leverage, "local", pulled)
        ),
        calibrator("magnetometer", one, after(equations, "jacobian", entry)),
        calibrator(
            "gyroscope", one,
            after(turn, "map_slopes", _scaled((..., 4))),
        ),
        _smoke(
            "filter", "estimator", one,
            after(mekf, "_transition", _scaled((..., slice(0, 3), slice(3, 6)))),
        ),
        _smoke(
            "attitude_vectors", "estimator", "a covariance 0.2 % off",
            after(attitude_vectors, "wahba_covariance", lambda v: OFF**2 * v),
        ),
    ]  # fmt: skip


def _rests() -> list[Fault]:
    def late(hold: Array) -> Any:
        return np.roll(hold, 1)

    def moved(original: Any, *given: Any) -> Any:
        rests = original(*given)
        forces = np.roll(np.array(rests.forces).reshape(-1, 3), -1, axis=0)
        return replace(rests, forces=forces.reshape(rests.forces.shape))

    def longer(original: Any, *given: Any) -> Any:
        rests = np.array(original(*given))
        rests[:-1, 1] += 1
        return rests

    return [
        _smoke(
            "scene", "scene", "rests a row late",
            after(scene, "simulate", lambda r: replace(r, hold=late(r.hold))),
        ),
        _smoke(
            "calibration", "scene", "rests a row late",
            wrapped(calibration, "simulated_rests", moved),
        ),
        _smoke(
            "gyroscope", "scene", "rests end a row late",
            wrapped(gyroscope, "_rests", longer),
        ),
    ]  # fmt: skip


def _detector() -> list[Fault]:
    def shifted(start: int, stop: int) -> Any:
        def change(original: Any, *given: Any) -> Any:
            return original(*given) + np.array([start, stop])

        return change

    def untrimmed(
        original: Any, raw: Array, many: float, window: int, trim: int
    ) -> Any:
        return original(raw, many, window, 0)

    def late(original: Any, *given: Any) -> Any:
        return np.roll(original(*given), 1)

    below = (detector, "intervals_below")
    return [
        _found("detector a sample early", *below, shifted(-1, 0)),
        _found("detector a sample late", *below, shifted(0, 1)),
        _found("detector shifted by a sample", *below, shifted(1, 1)),
        _found("detector untrimmed", study_of_detector, "detect", untrimmed),
        _found("detector's window a sample late", variance, "variance_magnitude", late),
    ]


def _means() -> list[Fault]:
    def by_n(original: Any, samples: Array, window: int) -> Any:
        return original(samples, window) * ((window - 1) / window)

    def rest(original: Any, *given: Any, **named: Any) -> Any:
        found = original(*given, **named)
        n = found.stop - found.start
        return replace(found, variance=found.variance * (n - 1) / n)

    def without_last(original: Any, samples: Array, rests: Any) -> Any:
        return original(samples, rests - np.array([0, 1]))

    def counted(original: Any, rests: Any) -> Any:
        return original(rests) + 1

    return [
        _found(
            "a window's variance by n for n - 1", variance, "variance_magnitude", by_n
        ),
        _found("a rest's variance by n for n - 1", detector, "initial_rest", rest),
        _found(
            "means without the last sample", intervals, "interval_means", without_last
        ),
        _found("a sample too many counted", intervals, "interval_counts", counted),
    ]


def _found(name: str, owner: Any, function: str, change: Any) -> Fault:
    inject = everywhere(owner, function, change)
    return _smoke("end_to_end", "estimator", name, inject)
