"""Faults of the attitude chain: noise, estimator, and the formulas beside it."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, then
from simval.streams import Streams
from simval.studies import attitude, attitude_order
from simval.theory.attitude import attitude_moments

CONJUGATE = np.array([[-1.0], [-1.0], [-1.0], [1.0]])
GEOMETRY = attitude.random_geometry(3)

raw = partial(Fault, "attitude", "estimator", owner=attitude, function="raw_quaternion")
unit = replace(raw("NaN on one trial in a million"), function="normalize_columns")


def swapped(original, vectors, frame):
    b1, b2, r1, r2 = vectors.reshape(4, 3, -1)
    return original(np.stack([b2, b1, r1, r2]), frame)


def one_nan(q):
    q[:, 0] = np.nan
    return q


ESTIMATOR = (
    raw("scalar first", change=then(lambda q: np.roll(q, 1, axis=0))),
    raw("inverse rotation", change=then(lambda q: CONJUGATE * q)),
    raw("sign of the quaternion", change=then(np.negative)),
    raw("one vector sign", change=then(lambda q: CONJUGATE[::-1] * q)),
    raw("body vectors swapped", change=swapped),
    raw(
        "another frame than stated",
        change=lambda o, v, frame: o(v, "x" if frame != "x" else "y"),
    ),
    replace(unit, name="not normalised", change=lambda _, q: 2.4 * q),
    replace(unit, change=then(one_nan), crash=True),
    replace(
        raw("attitude matrix transposed"),
        function="attitude_matrix",
        change=then(np.transpose),
    ),
)


def one_element(m):
    C = m.covariance.copy()
    C[0, 1] = C[1, 0] = -C[0, 1]
    return replace(m, covariance=C)


def claim(name, change):
    """A prediction of moments m that is changed: by (m, order, noise)."""
    return Fault(
        "attitude", "formula", name, attitude, "attitude_moments",
        lambda o, *given, order: change(o(*given, order=order), order, given[3]),
    )  # fmt: skip


def second_order_alone(m, order, s):
    return m if order == 2 else attitude_moments(*GEOMETRY, s, order=2)


FORMULA = (
    claim("covariance + 1 %", lambda m, *_: replace(m, covariance=1.01 * m.covariance)),
    claim(
        "covariance + 1 % in one cell",
        lambda m, _, s: replace(
            m, covariance=(1.01 if s == 0.05 else 1.0) * m.covariance
        ),
    ),
    claim("covariance of one pair transposed in sign", lambda m, *_: one_element(m)),
    claim("bias of the wrong sign", lambda m, *_: replace(m, bias=-m.bias)),
    claim("bias times 1.5", lambda m, *_: replace(m, bias=1.5 * m.bias)),
    claim("no bias at all", lambda m, *_: replace(m, bias=0.0 * m.bias)),
    claim("fourth-order term missing", second_order_alone),
    claim(
        "variance taken for standard deviation",
        lambda m, _, s: replace(m, covariance=s * m.covariance),
    ),
    claim(
        "degrees for radians",
        lambda _, order, s: attitude_moments(
            *GEOMETRY, float(np.radians(s)), order=order
        ),
    ),
    claim(
        "second moment for covariance",
        lambda m, *_: replace(m, covariance=m.second_moment),
    ),
    claim("NaN in a prediction", lambda m, *_: replace(m, bias=np.full(4, np.nan))),
)


# deterministic: how fast a formula's error falls shows a term that is 1 % off
def off(name, change):
    def broken(original, q, r1, r2, noise, order=2):
        moments = original(q, r1, r2, noise, order)
        more = change(
            moments.covariance, original(q, r1, r2, noise, 2).covariance, order
        )
        return replace(moments, covariance=more)

    return Fault("order", "formula", name, attitude_order, "attitude_moments", broken)


ORDER = (
    off(
        "second-order covariance 0.1 % off",
        lambda C, _, order: 1.001 * C if order == 2 else C,
    ),
    off(
        "fourth-order term 1 % off",
        lambda C, lower, order: C + 0.01 * (C - lower) if order == 4 else C,
    ),
)


class Generator:
    """A generator whose normals are changed on their way."""

    def __init__(self, generator, change):
        self.generator, self.change = generator, change

    def standard_normal(self, shape):
        """Normals, changed."""
        return self.change(self.generator.standard_normal(shape))


def first_sensor_twice(noise):
    noise[3:6] = noise[:3]
    return noise


def bodies_only(noise):
    noise[6:] = 0.0
    return noise


stream = partial(Fault, "attitude", "noise", owner=Streams, function="sequence")
normals = partial(stream, function="block")
NOISE = (
    normals("noise + 1 %", change=lambda o, *a: Generator(o(*a), lambda x: 1.01 * x)),
    normals(
        "two sensors share a stream",
        change=lambda o, *a: Generator(o(*a), first_sensor_twice),
    ),
    normals(
        "no noise on the references",
        change=lambda o, *a: Generator(o(*a), bodies_only),
    ),
    stream("every block the same", change=lambda o, streams, number: o(streams, 0)),
    replace(
        stream("all cells share a stream"),
        suite="streams",
        change=lambda o, streams, number: o(Streams(streams.seed, (0,)), number),
    ),
)  # fmt: skip

FAULTS = (*ESTIMATOR, *FORMULA, *ORDER, *NOISE)
