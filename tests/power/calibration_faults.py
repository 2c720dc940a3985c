"""Faults of the calibration chain: scene, sensor, calibrator, and its theory."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, wrapped
from simval.arrays import Array
from simval.calibrate.minimization import Leverage
from simval.sensor import AccelerometerModel, forms
from simval.studies import calibration, scene
from simval.theory import calibration as theory


def calibration_faults() -> list[Fault]:
    """All faults of the calibration chain."""
    return [*_scene(), *_sensor(), *_calibrator(), *_formula()]


_fault = partial(Fault, "calibration")


def _scene() -> list[Fault]:
    def trajectory(name: str, change: Any) -> Fault:
        return Fault("scene", "scene", name, after(scene, "simulate", change))

    def late(names: tuple[str, ...]) -> Any:
        def change(r: Any) -> Any:
            return replace(r, **{n: np.roll(getattr(r, n), 1, axis=0) for n in names})

        return change

    def six_faces(original: Any, name: str, poses: int) -> Any:
        return original(name, poses=np.vstack([np.eye(3), -np.eye(3)]))

    return [
        trajectory("attitude one step late", late(("attitude",))),
        trajectory("rates one step late", late(("angular_velocity",))),
        trajectory(
            "rates in degrees",
            lambda r: replace(r, angular_velocity=np.degrees(r.angular_velocity)),
        ),
        trajectory(
            "a detector a window late", lambda r: replace(r, hold=np.roll(r.hold, 200))
        ),
        trajectory(
            "a body that trembles",
            lambda r: replace(
                r,
                specific_force=r.specific_force
                + 1e-4 * np.sin(300.0 * r.time)[:, None],
            ),
        ),
        Fault(
            "scene", "scene", "six faces only", wrapped(scene, "simulate", six_faces)
        ),
        _fault(
            "scene",
            "rests cut a window late",
            after(calibration, "simulated_rests", _moving),
        ),
    ]


def _sensor() -> list[Fault]:
    def sensor(name: str, change: Any) -> Fault:
        return _fault("sensor", name, wrapped(AccelerometerModel, "distort", change))

    def transposed(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        return original(replace(model, T=model.T.T), f_s, rng)

    def bias_first(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        return original(
            replace(model, B=np.linalg.solve(model.matrix, model.B)), f_s, rng
        )

    def scale_last(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        turned = np.diag(model.K) @ model.T
        return original(replace(model, T=turned, K=np.ones(3)), f_s, rng)

    def bias_sign(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        return original(replace(model, B=-model.B), f_s, rng)

    def one_axis(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        raw = original(replace(model, noise_std=0.0), f_s, rng)
        common = rng.standard_normal((*raw.shape[:-1], 1))
        return raw + model.noise_std * (
            0.6 * common + 0.8 * rng.standard_normal(raw.shape)
        )

    def floor(original: Any, model: Any, f_s: Array, rng: Any) -> Array:
        return np.floor(original(model, f_s, rng) / 0.01) * 0.01

    return [
        sensor("T transposed", transposed),
        sensor("bias before scale", bias_first),
        sensor("scale after misalignment", scale_last),
        sensor("bias added, not subtracted", bias_sign),
        sensor("noise that the three axes share", one_axis),
        sensor("rounded down, not to nearest", floor),
    ]


def _calibrator() -> list[Fault]:
    def wrong_g(original: Any, poses: Any, **options: Any) -> Any:
        return original(poses, **(options | {"g": 1.0005 * options["g"]}))

    def dropped(original: Any, poses: Array, **options: Any) -> Any:
        return original(np.delete(poses, 0, axis=-2), **options)

    def unimproved(original: Any, leverage: Leverage, at: Array) -> Any:
        none = np.zeros_like(leverage.start_cost)
        return original(replace(leverage, start_cost=none), at)

    def another(original: Any, poses: Any, **options: Any) -> Any:
        return original(poses, **(options | {"residual": "norm"}))

    calibrator = partial(_fault, "calibrator")
    return [
        calibrator("wrong g", wrapped(calibration, "calibrate", wrong_g)),
        calibrator("a pose left out", wrapped(calibration, "calibrate", dropped)),
        # within a fraction of a standard error: paired noise shows it, and the response
        calibrator(
            "the closed-form start taken for the answer",
            wrapped(Leverage, "_best", unimproved),
        ),
        calibrator(
            "another residual than stated", wrapped(calibration, "calibrate", another)
        ),
        calibrator(
            "order of the parameters",
            after(forms, "from_gram", lambda p: np.roll(p, 3, axis=-1)),
            crash=True,  # the solver starts so far off that it refuses some trials
        ),
    ]


def _formula() -> list[Fault]:
    def geometry(name: str, change: Any) -> Fault:
        return _fault("formula", name, after(theory, "_geometry", change))

    def claim(name: str, change: Any) -> Fault:
        inject = after(calibration, "calibration_moments", change)
        return _fault("formula", name, inject)

    def no_root(
        original: Any, model: Any, u: Array, *, g: float, noise_std: Any
    ) -> Any:
        return original(model, u, g=g, noise_std=noise_std**2)

    return [
        geometry("Jacobian: one derivative 20 % off", _steeper),
        geometry("Hessian left out of the bias", lambda x: replace(x, bend=0 * x.bend)),
        claim("calibration bias of the wrong sign", lambda m: replace(m, bias=-m.bias)),
        claim("Cramer-Rao for the covariance, halved", _halved),
        _fault(
            "formula",
            "variance of a mean for its root",
            wrapped(calibration, "calibration_moments", no_root),
        ),
    ]


def _moving(rests: Any) -> Any:
    # the window reaches back into the turn before: a fifth of it is not at rest
    forces = rests.forces.copy()
    late = len(forces[0]) // 5
    forces[1:, :late] = (forces[:-1, :late] + forces[1:, :late]) / 2.0
    return replace(rests, forces=forces)


def _steeper(x: Any) -> Any:
    d = x.d.copy()
    d[:, 4] *= 1.2
    return replace(x, d=d)


def _halved(m: Any) -> Any:
    return replace(m, covariance=m.cramer_rao / 2.0)
