"""Filters that are wrong, each family in its own way, drawn at random; and right ones.

`WRONG` holds for each family how one is drawn, and the words by which it is refused.
Each is a turned copy of one sound filter, which integrates the rate: from a row on, or
at that row alone, it answers with one of the family's options.
"""

import math

import numpy as np

from simval.plugins.protocol import Filter

ROWS = 40
"""Of the runs that they are drawn for."""

P3, P6 = 1e-4 * np.eye(3), 1e-4 * np.eye(6)


def compose(a, b):
    """Of the package's quaternions, in plain floats."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


class Rate:
    """Integrates the rate."""

    def __init__(self, start=None):
        self.q = (0.0, 0.0, 0.0, 1.0) if start is None else tuple(start.tolist())
        self.k = -1

    def step(self, dt, w):
        self.k += 1
        x, y, z = (dt * v / 2.0 for v in w.tolist())
        q = compose(self.q, (x, y, z, 1.0))
        size = math.sqrt(sum(v * v for v in q))
        self.q = tuple(v / size for v in q)
        return np.array(self.q)

    def update(self, dt, w, f, m):
        return self.step(dt, w)


class Batch:
    """The same of many trials, in closed form of each row."""

    def __init__(self, start):
        self.q, self.k = start.copy(), -1

    def step(self, dt, w):
        self.k += 1
        turn = np.concatenate([dt * w / 2.0, np.ones((len(w), 1))], axis=1)
        self.q = np.stack(compose(self.q.T, turn.T), axis=1)
        self.q /= np.linalg.norm(self.q, axis=1, keepdims=True)
        return self.q

    def update(self, dt, w, f, m):
        return self.step(dt, w)


def declared(make, **more):
    given = {"components": "xyzs", "matrix": "passive", "reads": ("start",)}
    return Filter(**{"name": "wrong", **given, "make": make, **more})


def family(
    said,
    *options,
    sound=lambda q: q,
    first=0,
    last=ROWS,
    once=False,
    base=Rate,
    **declares,
):
    """From a row on one of the options: ``option(q, rng, readings)``."""

    def drawn(rng):
        row, option = (
            int(rng.integers(first, last)),
            options[rng.integers(len(options))],
        )

        class Spoilt(base):
            def update(self, dt, *readings):
                q = self.step(dt, readings[0])
                wrong = self.k == row if once else self.k >= row
                return option(q, rng, readings) if wrong else sound(q)

        return declared(Spoilt, **declares)

    return drawn, said


def put(value):
    def option(q, rng, _):
        q[rng.integers(4)] = value
        return q

    return option


def with_P(change):
    """An attitude, and a covariance that is changed."""
    return lambda q, rng, _: (q, change(P3.copy(), rng))


def entry(value):
    def change(P, rng):
        P[0, 1] = P[1, 0] = value
        return P

    return change


def skewed(P, rng):
    P[0, 1] += 10.0 ** rng.uniform(-5.5, 0.0) * 1e-4
    return P


def indefinite(P, rng):
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    spoilt = (axes * [1e-4, 2e-4, -(10.0 ** rng.uniform(-6.0, -4.0))]) @ axes.T
    return (spoilt + spoilt.T) / 2.0


def all_words(q, **more):
    words = {"attitude": q, "covariance": P3, "bias": np.zeros(3)}
    words |= {"innovation": np.zeros(6), "innovation_covariance": np.eye(6)}
    return words | more


def changing(change):
    def option(q, rng, readings):
        change(readings[rng.integers(3)], rng)
        return q

    return option


def normalised(a, _):
    a /= np.linalg.norm(a)


def lost(a, rng):
    a[rng.integers(3)] = np.nan


def shifted(a, _):
    a -= 1e-9 * (1.0 + np.abs(a))


def diced(q, rng, _):
    size = 10.0 ** rng.uniform(-9.0, -2.0)
    turned = np.array(compose(q, (size * rng.standard_normal(), 0.0, 0.0, 1.0)))
    return turned / np.linalg.norm(turned)


def raising(*errors):
    def option(q, rng, _):
        raise errors[rng.integers(len(errors))]

    return option


def matrix(q):
    return np.eye(3)


def stateful(where):
    """A bias that is kept in the class, the module, or the one filter for all."""

    def drawn(rng):
        kept, share, made = np.zeros(3), rng.uniform(1e-6, 1e-2), []

        class Spoilt(Rate):
            def __init__(self, start):
                super().__init__(start)
                if where == "module":
                    kept[:] = 0.0  # each run begins well

            def update(self, dt, w, f, m):
                kept[:] += share * w
                return self.step(dt, w - kept)

        def one_for_all(start):
            made.append(Rate(start))
            return made[0]

        return declared(one_for_all if where == "filter" else Spoilt)

    return drawn


def no_model(start):
    raise OSError("no such model")


def unmade(rng):
    makes = [
        no_model,
        lambda: Rate(np.zeros(4)),
        lambda start: None,
        lambda start: {"q": start},
        lambda start: lambda dt, w: w,
        lambda start: Rate,
        lambda start, rate: Rate(start),
    ]
    return declared(makes[rng.integers(len(makes))])


def mixed(q, *_):
    other = q + 1e-4 * q.mean(axis=0)
    return other / np.linalg.norm(other, axis=1, keepdims=True)


FINITE = r"must be finite, at row \d+ \("
LENGTH = r"length is off by .* normalise them, at row \d+"
AGAIN = r"runs, or draws random numbers"
KIND = r"must answer each row, and as it answered the first|without|mapping of"
BATCH = {"base": Batch, "batch": True}

WRONG = {
    "not finite": family(FINITE, *map(put, (np.nan, np.inf, -np.inf)), once=True),
    "covariance not finite": family(
        FINITE,
        *(with_P(entry(value)) for value in (np.nan, np.inf)),
        sound=lambda q: (q, P3),
    ),
    "wrong length": family(
        LENGTH,
        lambda q, rng, _: q * (1.0 + 10.0 ** rng.uniform(-5.9, -0.1)),
        lambda q, rng, _: q * (1.0 - 10.0 ** rng.uniform(-5.9, -0.1)),
    ),
    "wrong shape": family(
        r"it must be an array of shape \(4,\).*at row \d+",
        lambda q, *_: q[:3],
        lambda q, *_: np.append(q, 0.0),
        lambda q, *_: q[None],
        lambda q, *_: q[0],
        lambda q, *_: [],
        lambda q, *_: [list(q)],
    ),
    "no numbers": family(
        r"plain number|one object|it must answer each row|is not an array",
        lambda q, *_: q + 0j,
        lambda q, *_: q.astype(str),
        lambda q, *_: [*q[:3], None],
        lambda q, *_: [*q[:3], True],
        lambda q, *_: np.array([*q[:3], object()], dtype=object),
        lambda q, *_: np.ma.masked_array(q, [True, False, False, False]),
        lambda q, *_: [[1.0, 2.0], 3.0, 4.0, 5.0],
        lambda q, *_: q.astype("M8[s]"),
    ),
    "nothing": family(r"returned nothing \(None\)", lambda *_: None, once=True),
    "skew": family(
        r"covariance` that is not symmetric, by .*at row \d+",
        with_P(skewed),
        sound=lambda q: (q, P3),
    ),
    "not positive": family(
        r"covariance` that is not positive definite.*at row \d+",
        *map(with_P, (indefinite, lambda P, _: 0.0 * P, lambda P, _: -P)),
        sound=lambda q: (q, P3),
    ),
    "changed input": family(
        r"changes its input: the \w+'s reading .*at row \d+.*work on a copy",
        *map(changing, (normalised, lost, shifted)),
        once=True,
    ),
    "state in the class": (stateful("class"), AGAIN),
    "one filter for all": (stateful("filter"), AGAIN),
    "state in the module": (
        stateful("module"),
        "stepped by turns change each other",
    ),
    "random answers": family(AGAIN, diced, last=30),
    "raises": family(
        r"wrong raised \w+.*, at row \d+ \(",
        raising(
            ValueError, KeyError("gain"), StopIteration, MemoryError, SystemExit(3)
        ),
    ),
    "another kind": family(
        KIND,
        lambda q, *_: (q, P3),
        lambda q, *_: {"attitude": q},
        lambda q, *_: {"attitude": q, "covariance": P3},
        first=1,
    ),
    "words of its own": family(
        r"must have 'attitude'|without the `innovation`|as it answered the first",
        lambda q, *_: {},
        lambda q, *_: {"quaternion": q},
        lambda q, *_: {"attitude": q, "P": np.eye(3)},
        lambda q, *_: {"attitude": q, "innovation_covariance": np.eye(6)},
    ),
    "another shape": family(
        r"`?(covariance|innovation\w*|bias)`? (as|that|with) ?.*at row \d+",
        lambda q, *_: all_words(q, covariance=P6),
        lambda q, *_: all_words(q, covariance=np.ones(3)),
        lambda q, *_: all_words(q, bias=0.0),
        lambda q, *_: all_words(q, innovation=np.zeros(3)),
        lambda q, *_: all_words(q, innovation_covariance=np.eye(3)),
        sound=all_words,
        first=1,
    ),
    "no rotation": family(
        r"no rotation: (it is a reflection|its columns)",
        lambda *_: -np.eye(3),
        lambda q, rng, _: (1.0 + 10.0 ** rng.uniform(-5.0, -0.5)) * np.eye(3),
        lambda q, rng, _: np.eye(3) + np.triu(10.0 ** rng.uniform(-5, -1, (3, 3)), 1),
        sound=matrix,
        components="matrix",
        reads=(),
    ),
    "cannot be made": (
        unmade,
        r"`make` of wrong (raised|returned)|wrong raised TypeError",
    ),
    "wrong number of trials": family(
        r"it must be an array of shape \(3, 4\)",
        lambda q, *_: q[0],
        lambda q, *_: q[:-1],
        lambda q, *_: np.vstack([q, q[:1]]),
        lambda q, *_: q.T,
        **BATCH,
    ),
    "trials that mix": family(
        "the first of 3 trials is not what it is alone", mixed, last=30, **BATCH
    ),
}


class Reused(Rate):
    """Answers with one array again and again, and closes."""

    def __init__(self, start):
        super().__init__(start)
        start[:] = np.nan  # its own
        self.answer, self.P = np.empty(4), P3.copy()

    def update(self, dt, w, f, m):
        self.answer[:] = self.step(dt, w)
        self.P *= 1.01
        return self.answer, self.P

    def close(self):
        self.q = None


class Seeded(Rate):
    """Draws the same random numbers in each run."""

    def __init__(self, start):
        super().__init__(start)
        self.rng = np.random.default_rng(7)

    def update(self, dt, w, f, m):
        return self.step(dt, w + 1e-3 * self.rng.standard_normal(3))


def answering(cast):
    class Other(Rate):
        def update(self, dt, w, f, m):
            return cast(self.step(dt, w))

    return declared(Other)


def function(start):
    held = Rate(start)
    return lambda dt, w, f, m: held.step(dt, w)


KNOWN = np.diag([1e-8, 2e-8, 3e-8, 0.0, 0.0, 0.0])  # the bias is known

RIGHT = {
    "plain": declared(Rate),
    "its own array": declared(Reused),
    "a function": declared(function),
    "seeded": declared(Seeded),
    "a batch": declared(Batch, batch=True),
    "a list": answering(list),
    "a tuple": answering(tuple),
    "single precision": answering(np.float32),
    "either sign": answering(lambda q: -q),
    "all words": answering(all_words),
    "some words": answering(lambda q: {"attitude": q, "innovation": np.zeros(2)}),
    "nearly singular": answering(lambda q: (q, KNOWN)),
    "a single singular": answering(lambda q: (q, KNOWN.astype(np.float32))),
}
