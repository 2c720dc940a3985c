"""Faults of the attitude chain: noise, estimator, and the formulas beside it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, everywhere, replaced, wrapped
from simval.arrays import Array
from simval.montecarlo import fused
from simval.montecarlo import fused as pairs
from simval.streams import Streams
from simval.studies import attitude, attitude_order
from simval.theory.attitude import AttitudeMoments, attitude_moments


class _Generator:
    """A generator whose normals are changed on their way."""

    def __init__(self, generator: np.random.Generator, change: Any) -> None:
        self._generator = generator
        self._change = change

    def standard_normal(self, shape: Any) -> Array:
        return self._change(self._generator, shape)


def attitude_faults() -> list[Fault]:
    """All faults of the attitude chain."""
    return [*_estimator(), *_formula(), *_order(), *_noise()]


_fault = partial(Fault, "attitude")


def _estimator() -> list[Fault]:
    def raw(change: Any) -> Any:
        return after(attitude, "raw_quaternion", change)

    def swap(original: Any, vectors: Array, frame: str) -> Array:
        b1, b2, r1, r2 = vectors.reshape(4, 3, -1)
        return original(np.stack([b2, b1, r1, r2]), frame)

    def another(original: Any, vectors: Array, frame: str) -> Array:
        return original(vectors, "x" if frame != "x" else "y")

    conjugate = np.array([[-1.0], [-1.0], [-1.0], [1.0]])
    estimator = partial(_fault, "estimator")
    return [
        estimator("scalar first", raw(lambda q: np.roll(q, 1, axis=0))),
        estimator("inverse rotation", raw(lambda q: conjugate * q)),
        estimator("sign of the quaternion", raw(np.negative)),
        estimator("one vector sign", raw(lambda q: conjugate[::-1] * q)),
        estimator("body vectors swapped", _wrap("raw_quaternion", swap)),
        estimator("another frame than stated", _wrap("raw_quaternion", another)),
        estimator(
            "not normalised", _wrap("normalize_columns", lambda original, q: 2.4 * q)
        ),
        estimator(
            "NaN on one trial in a million",
            after(attitude, "normalize_columns", _one_nan),
            crash=True,
        ),
        estimator(
            "attitude matrix transposed",
            after(attitude, "attitude_matrix", np.transpose),
        ),
    ]


def _formula() -> list[Fault]:
    def claim(name: str, change: Any) -> Fault:
        def broken(
            original: Any, q: Any, r1: Any, r2: Any, s: float, *, order: Any
        ) -> Any:
            return change(original(q, r1, r2, s, order=order), order, s)

        return _fault("formula", name, _wrap("attitude_moments", broken))

    def in_one(m: AttitudeMoments, order: Any, s: float) -> AttitudeMoments:
        return replace(m, covariance=(1.01 if s == 0.05 else 1.0) * m.covariance)

    def second(m: AttitudeMoments, order: Any, s: float) -> AttitudeMoments:
        geometry = attitude.random_geometry(3)
        return m if order == 2 else attitude_moments(*geometry, s, order=2)

    def degrees(m: AttitudeMoments, order: Any, s: float) -> AttitudeMoments:
        geometry = attitude.random_geometry(3)
        return attitude_moments(*geometry, float(np.radians(s)), order=order)

    return [
        claim(
            "covariance + 1 %",
            lambda m, o, s: replace(m, covariance=1.01 * m.covariance),
        ),
        claim("covariance + 1 % in one cell", in_one),
        claim("covariance of one pair transposed in sign", _one_element),
        claim("bias of the wrong sign", lambda m, o, s: replace(m, bias=-m.bias)),
        claim("bias times 1.5", lambda m, o, s: replace(m, bias=1.5 * m.bias)),
        claim("no bias at all", lambda m, o, s: replace(m, bias=0.0 * m.bias)),
        claim("fourth-order term missing", second),
        claim("variance taken for standard deviation", _variance),
        claim("degrees for radians", degrees),
        claim(
            "second moment for covariance",
            lambda m, o, s: replace(m, covariance=m.second_moment),
        ),
        claim(
            "NaN in a prediction", lambda m, o, s: replace(m, bias=np.full(4, np.nan))
        ),
    ]


def _order() -> list[Fault]:
    # deterministic: how fast a formula's error falls shows a term that is 1 % off
    def off(name: str, change: Any) -> Fault:
        def broken(
            original: Any, q: Any, r1: Any, r2: Any, noise: Any, order: Any = 2
        ) -> Any:
            moments = original(q, r1, r2, noise, order)
            return change(moments, original(q, r1, r2, noise, 2), order)

        inject = wrapped(attitude_order, "attitude_moments", broken)
        return Fault("order", "formula", name, inject)

    def second(m: AttitudeMoments, lower: AttitudeMoments, order: Any) -> Any:
        return replace(m, covariance=1.001 * m.covariance) if order == 2 else m

    def fourth(m: AttitudeMoments, lower: AttitudeMoments, order: Any) -> Any:
        more = m.covariance + 0.01 * (m.covariance - lower.covariance)
        return replace(m, covariance=more) if order == 4 else m

    return [
        off("second-order covariance 0.1 % off", second),
        off("fourth-order term 1 % off", fourth),
    ]


def _noise() -> list[Fault]:
    def normals(name: str, change: Any) -> Fault:
        def broken(original: Any, streams: Streams, number: int) -> Any:
            return _Generator(original(streams, number), change)

        inject = wrapped(Streams, "block", broken)
        return _fault("noise", name, inject)

    def shared(generator: np.random.Generator, shape: Any) -> Array:
        noise = generator.standard_normal(shape)
        noise[3:6] = noise[:3]
        return noise

    def bodies_only(generator: np.random.Generator, shape: Any) -> Array:
        noise = generator.standard_normal(shape)
        noise[6:] = 0.0
        return noise

    # control variates, whose moments are known, would take such a fault out again
    def louder(
        original: Any, vectors: Any, frame: Any, q: Any, s: float, *o: Any, **k: Any
    ) -> Any:
        return original(vectors, frame, q, 1.01 * s, *o, **k)

    def first_block(original: Any, streams: Streams, number: int) -> Any:
        return original(streams, 0)

    def no_cell(original: Any, streams: Streams, number: int) -> Any:
        return original(Streams(streams.seed, (0,)), number)

    return [
        _fault("noise", "noise + 1 %", _wrap("simulate_closed_form", louder)),
        normals("two sensors share a stream", shared),
        normals("no noise on the references", bodies_only),
        _fault(
            "noise", "every block the same", wrapped(Streams, "sequence", first_block)
        ),
        Fault(
            "streams", "noise", "all cells share a stream",
            wrapped(Streams, "sequence", no_cell),
        ),
        Fault(
            "streams", "noise", "normals with a sine for a cosine", _sines_alone,
        ),
    ]  # fmt: skip


@contextmanager
def _sines_alone() -> Iterator[None]:
    """As if both forms had it, which must have equal bits."""

    def twice(original: Any, words: Any) -> Array:
        return np.hstack(2 * [np.hsplit(original(words), 2)[1]])

    with (
        everywhere(pairs, "normals", twice)(),
        replaced(fused, "_compiled", lambda: None),
    ):
        yield


def _wrap(name: str, change: Any) -> Any:
    return wrapped(attitude, name, change)


def _one_nan(q: Array) -> Array:
    q[:, 0] = np.nan
    return q


def _one_element(m: AttitudeMoments, order: Any, s: float) -> AttitudeMoments:
    C = m.covariance.copy()
    C[0, 1] = C[1, 0] = -C[0, 1]
    return replace(m, covariance=C)


def _variance(m: AttitudeMoments, order: Any, s: float) -> AttitudeMoments:
    return replace(m, covariance=s * m.covariance)
