"""Faults of the attitude chain: noise, estimator, and the formulas beside it."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, result, then, times
from simval.streams import Streams
from simval.studies import attitude, attitude_order, attitude_singular, attitude_vectors
from simval.theory.attitude import attitude_moments

CONJUGATE = np.array([[-1.0], [-1.0], [-1.0], [1.0]])
GEOMETRY = attitude.random_geometry(3)

estimator = partial(Fault, "attitude", "estimator", attitude)
raw = partial(estimator, "raw_quaternion")
unit = partial(estimator, "normalize_columns")


def swapped(original, vectors, frame):
    b1, b2, r1, r2 = vectors.reshape(4, 3, -1)
    return original(np.stack([b2, b1, r1, r2]), frame)


def one_nan(q):
    q[:, 0] = np.nan
    return q


ESTIMATOR = (
    raw("scalar first", then(lambda q: np.roll(q, 1, axis=0))),
    raw("inverse rotation", then(lambda q: CONJUGATE * q)),
    raw("sign of the quaternion", then(np.negative)),
    raw("one vector sign", then(lambda q: CONJUGATE[::-1] * q)),
    raw("body vectors swapped", swapped),
    raw(
        "another frame than stated",
        lambda o, v, frame: o(v, "x" if frame != "x" else "y"),
    ),
    unit("not normalised", lambda _, q: 2.4 * q),
    unit("NaN on one trial in a million", then(one_nan), crash=True),
    estimator("attitude_matrix", "attitude matrix transposed", then(np.transpose)),
)


def one_element(m):
    C = m.covariance.copy()
    C[0, 1] = C[1, 0] = -C[0, 1]
    return C


def by_noise(change):
    """Moments m that are changed by (m, order, noise)."""
    return lambda o, *given, order: change(o(*given, order=order), order, given[3])


def in_one_cell(m, _, s):
    return replace(m, covariance=(1.01 if s == 0.05 else 1.0) * m.covariance)


def second_order_alone(m, order, s):
    return m if order == 2 else attitude_moments(*GEOMETRY, s, order=2)


def in_degrees(_, order, s):
    return attitude_moments(*GEOMETRY, float(np.radians(s)), order=order)


claim = partial(Fault, "attitude", "formula", attitude, "attitude_moments")
FORMULA = (
    claim("covariance + 1 %", result(covariance=lambda m: 1.01 * m.covariance)),
    claim("covariance + 1 % in one cell", by_noise(in_one_cell)),
    claim("covariance of one pair transposed in sign", result(covariance=one_element)),
    claim("bias of the wrong sign", result(bias=lambda m: -m.bias)),
    claim("bias times 1.5", result(bias=lambda m: 1.5 * m.bias)),
    claim("no bias at all", result(bias=lambda m: 0.0 * m.bias)),
    claim("fourth-order term missing", by_noise(second_order_alone)),
    claim(
        "variance taken for standard deviation",
        by_noise(lambda m, _, s: replace(m, covariance=s * m.covariance)),
    ),
    claim("degrees for radians", by_noise(in_degrees)),
    claim("second moment for covariance", result(covariance=lambda m: m.second_moment)),
    claim("NaN in a prediction", result(bias=lambda m: np.full(4, np.nan))),
)


# deterministic: how fast a formula's error falls shows a term that is 1 % off
def off(changed_order, change):
    """The covariance of an order changed by (itself, that of second order)."""

    def broken(original, *given):
        moments = original(*given)
        if (*given, 2)[:5][-1] != changed_order:
            return moments
        lower = original(*given[:4], 2, *given[5:]).covariance
        return replace(moments, covariance=change(moments.covariance, lower))

    return broken


order = partial(Fault, "order", "formula", attitude_order, "attitude_moments")
ORDER = (
    order("second-order covariance 0.1 % off", off(2, lambda C, _: 1.001 * C)),
    order("fourth-order term 1 % off", off(4, lambda C, low: C + 0.01 * (C - low))),
)
vectors = partial(Fault, "vectors", "formula", attitude_vectors, "wahba_moments")
VECTORS = (
    vectors("second order of vectors 0.1 % off", off(2, lambda C, _: 1.001 * C)),
    vectors("fourth order of vectors 0.1 % off", off(4, lambda C, _: 1.001 * C)),
    vectors("its term 10 % off", off(4, lambda C, low: C + 0.1 * (C - low))),
)


singular = partial(Fault, "smoke attitude_singular", "formula", attitude_singular)
SINGULAR = (
    singular("second_order_length", "1 in place of eq. (51)", times(0.0)),
    singular(
        "multiplicative_moments", "ten times the vector part of eq. (53)",
        result(bias=lambda m: m.bias * [10.0, 10.0, 10.0, 1.0]),
    ),
    singular("direct_covariance", "covariance of Table 1 + 0.1 %", times(1.001)),
)  # fmt: skip


class ChangedNormals(np.random.Generator):
    """A generator whose normals are changed on their way."""

    def __init__(self, generator, change):
        super().__init__(generator.bit_generator)
        self.generator, self.change = generator, change

    def standard_normal(self, size=None):
        """Normals, changed."""
        return self.change(self.generator.standard_normal(size))


def normals(change):
    return then(lambda generator: ChangedNormals(generator, change))


def first_sensor_twice(noise):
    noise[3:6] = noise[:3]
    return noise


def bodies_only(noise):
    noise[6:] = 0.0
    return noise


stream = partial(Fault, "attitude", "noise", Streams)
block, sequence = partial(stream, "block"), partial(stream, "sequence")
NOISE = (
    block("noise + 1 %", normals(lambda x: 1.01 * x)),
    block("two sensors share a stream", normals(first_sensor_twice)),
    block("no noise on the references", normals(bodies_only)),
    sequence("every block the same", lambda o, streams, number: o(streams, 0)),
    replace(
        sequence(
            "all cells share a stream",
            lambda o, streams, number: o(Streams(streams.seed, (0,)), number),
        ),
        suite="streams",
    ),
)

FAULTS = (*ESTIMATOR, *FORMULA, *ORDER, *SINGULAR, *VECTORS, *NOISE)
