"""Filters that are wrong, each family in its own way, drawn at random; and right ones.

`WRONG` holds for each family how one is drawn, and the words by which it is refused.
Each is a turned copy of one sound filter, which integrates the rate and pulls at it.
"""

import itertools
import math

import numpy as np

from simval.plugins.protocol import Filter

WRONG = {}
RIGHT = {}

ROWS = 40
"""Of the runs that they are drawn for."""


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


def declared(make, **more):
    given = {"components": "xyzs", "matrix": "passive", "reads": ("start",)}
    return Filter(**{"name": "wrong", **given, "make": make, **more})


def wrong(said, **more):
    """Register a family: ``spoil(rng)`` gives ``answer(filter, q, dt, w, f, m)``."""

    def register(spoil):
        def drawn(rng):
            answer = spoil(rng)

            class Spoilt(Rate):
                def update(self, dt, w, f, m):
                    return answer(self, self.step(dt, w), dt, w, f, m)

            return declared(Spoilt, **more)

        WRONG[spoil.__name__] = (drawn, said)
        return spoil

    return register


def whole(said):
    """Register a family that draws the whole filter."""

    def register(drawn):
        WRONG[drawn.__name__] = (drawn, said)
        return drawn

    return register


def right(drawn):
    RIGHT[drawn.__name__] = drawn
    return drawn


def late(rng):
    """A row of the run."""
    return int(rng.integers(ROWS))


def covariance(rng, p=3):
    root = rng.standard_normal((p, p + 2))
    return 1e-4 * (root @ root.T + 0.1 * np.eye(p))


@wrong(r"must be finite, at row \d+ \(")
def not_finite(rng):
    row, place = late(rng), rng.integers(4)
    bad = rng.choice([np.nan, np.inf, -np.inf])

    def answer(self, q, *_):
        if self.k == row:
            q[place] = bad
        return q

    return answer


@wrong(r"must be finite, at row \d+ \(")
def covariance_not_finite(rng):
    row, P = late(rng), covariance(rng)
    spoilt = P.copy()
    i, j = rng.integers(3, size=2)
    spoilt[i, j] = spoilt[j, i] = rng.choice([np.nan, np.inf])
    return lambda self, q, *_: (q, spoilt if self.k == row else P)


@wrong(r"length is off by .* normalise them, at row \d+")
def wrong_length(rng):
    row, off = late(rng), rng.choice([-1, 1]) * 10.0 ** rng.uniform(-5.9, -0.1)
    return lambda self, q, *_: q * (1.0 + off) if self.k >= row else q


@wrong(r"length is off by .* normalise them, at row \d+")
def length_that_drifts(rng):
    rate = 10.0 ** rng.uniform(-6.0, -2.0)
    return lambda self, q, *_: q * (1.0 + rate * self.k)


@wrong(r"it must be an array of shape \(4,\).*at row \d+")
def wrong_shape(rng):
    row = late(rng)
    kind = rng.integers(7)

    def answer(self, q, *_):
        if self.k < row:
            return q
        cast = [q[:3], np.append(q, 0.0), q[None], q[:, None], q[0], [], [list(q)]]
        return cast[kind]

    return answer


@wrong(r"plain number|one object|it must answer each row|is not an array")
def no_numbers(rng):
    row, kind = late(rng), rng.integers(9)

    def answer(self, q, *_):
        if self.k < row:
            return q
        return [
            q + 0j,
            q.astype(str),
            [*q[:3], None],
            [*q[:3], "1.0"],
            [*q[:3], True],
            np.array([*q[:3], object()], dtype=object),
            np.ma.masked_array(q, [True, False, False, False]),
            [[1.0, 2.0], 3.0, 4.0, 5.0],
            q.astype("M8[s]"),
        ][kind]

    return answer


@wrong(r"returned nothing \(None\)")
def nothing(rng):
    row = late(rng)
    return lambda self, q, *_: None if self.k == row else q


@wrong(r"covariance` that is not symmetric, by .*at row \d+")
def skew(rng):
    row, P = late(rng), covariance(rng)
    i, j = rng.permutation(3)[:2]
    spoilt = P.copy()
    spoilt[i, j] += 10.0 ** rng.uniform(-5.5, 0.0) * math.sqrt(P[i, i] * P[j, j])
    return lambda self, q, *_: (q, spoilt if self.k >= row else P)


@wrong(r"covariance` that is not positive definite.*at row \d+")
def not_positive(rng):
    row, p = late(rng), int(rng.choice([3, 6]))
    P = covariance(rng, p)
    values, axes = np.linalg.eigh(P)
    values[rng.integers(p)] *= -(10.0 ** rng.uniform(-2.0, 0.0))
    spoilt = (axes * values) @ axes.T
    spoilt = [(spoilt + spoilt.T) / 2.0, np.zeros((p, p)), -P][rng.integers(3)]
    return lambda self, q, *_: (q, spoilt if self.k >= row else P)


@wrong(r"changes its input: the \w+'s reading .*at row \d+.*work on a copy")
def changed_input(rng):
    row, sensor, kind = late(rng), rng.integers(3), rng.integers(3)

    def answer(self, q, dt, *readings):
        a = readings[sensor]
        if self.k == row:
            if kind == 0:
                a /= np.linalg.norm(a)
            elif kind == 1:
                a[rng.integers(3)] = np.nan
            else:
                a -= 1e-9 * (1.0 + np.abs(a))
        return q

    return answer


@whole(r"runs, or draws random numbers")
def state_between_runs(rng):
    kept, share = np.zeros(3), rng.uniform(1e-6, 1e-2)
    kind = rng.integers(3)

    class Spoilt(Rate):
        bias = kept  # of the class

        def update(self, dt, w, f, m, held=kept):
            held += share * w
            return self.step(dt, w - held)

    if kind == 0:
        return declared(Spoilt)
    made = []

    def one_for_all(start):
        made.append(Spoilt(start) if kind == 1 else Rate(start))
        return made[0]

    return declared(one_for_all)


@whole(r"stepped by turns change each other")
def state_in_the_module(rng):
    kept, share = np.zeros(3), rng.uniform(1e-6, 1e-2)

    class Spoilt(Rate):
        def __init__(self, start):
            super().__init__(start)
            kept[:] = 0.0  # each run begins well

        def update(self, dt, w, f, m):
            kept[:] += share * w
            return self.step(dt, w - kept)

    return declared(Spoilt)


@wrong(r"runs, or draws random numbers")
def random_answers(rng):
    size = 10.0 ** rng.uniform(-9.0, -2.0)

    def answer(self, q, *_):
        turned = np.array(compose(q, (size * rng.standard_normal(), 0.0, 0.0, 1.0)))
        return turned / np.linalg.norm(turned)

    return answer


@wrong(r"wrong raised \w+.*, at row \d+ \(")
def raises(rng):
    row = late(rng)
    errors = (ValueError, KeyError("gain"), StopIteration, MemoryError, SystemExit(3))
    error = errors[rng.integers(len(errors))]

    def answer(self, q, *_):
        if self.k == row:
            raise error
        return np.linalg.inv(np.zeros((3, 3))) if self.k > row else q

    return answer


@wrong(r"must answer each row, and as it answered the first|without|mapping of")
def another_kind(rng):
    row = int(rng.integers(1, ROWS))
    P = covariance(rng)
    kinds = [
        lambda q: q,
        lambda q: (q, P),
        lambda q: {"attitude": q},
        lambda q: {"attitude": q, "covariance": P},
        lambda q: {"attitude": q, "bias": np.zeros(3), "covariance": P},
    ]
    first, second = (kinds[i] for i in rng.permutation(5)[:2])
    return lambda self, q, *_: (second if self.k >= row else first)(q)


@wrong(r"must have 'attitude'|without the `innovation`")
def words_of_its_own(rng):
    kind = rng.integers(4)

    def answer(self, q, *_):
        return [
            {},
            {"quaternion": q},
            {"attitude": q, "P": np.eye(3)},
            {"attitude": q, "innovation_covariance": np.eye(6)},
        ][kind]

    return answer


@wrong(r"`?(covariance|innovation\w*|bias)`? (as|that|with) ?.*at row \d+")
def another_shape(rng):
    row = int(rng.integers(1, ROWS))
    kind = rng.integers(5)
    P = covariance(rng)

    def answer(self, q, *_):
        now = {"attitude": q, "covariance": P, "bias": np.zeros(3)}
        now |= {"innovation": np.zeros(6), "innovation_covariance": np.eye(6)}
        if self.k >= row:
            now |= [
                {"covariance": covariance(rng, 6)},
                {"covariance": np.ones(3)},
                {"bias": 0.0},
                {"innovation": np.zeros(3)},
                {"innovation_covariance": np.eye(3)},
            ][kind]
        return now

    return answer


@wrong(r"no rotation: (it is a reflection|its columns)", components="matrix", reads=())
def no_rotation(rng):
    row, kind = late(rng), rng.integers(3)
    size = 10.0 ** rng.uniform(-5.0, -0.5)

    def answer(self, q, *_):
        M = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        M *= np.linalg.det(M)
        if self.k < row:
            return M
        return [-M, M * (1.0 + size), M + size * np.triu(np.ones((3, 3)))][kind]

    return answer


@whole(r"`make` of wrong (raised|returned)|wrong raised TypeError")
def cannot_be_made(rng):
    def raising(start):
        raise OSError("no such model")

    makes = [
        raising,
        lambda: Rate(np.zeros(4)),
        lambda start: None,
        lambda start: {"q": start},
        lambda start: lambda dt, w: w,
        lambda start: Rate,
        lambda start, rate: Rate(start),
    ]
    return declared(makes[rng.integers(len(makes))])


def batch_of(answer):
    """A batch filter: closed form of each row, from the start's quaternions."""

    class Batch:
        def __init__(self, start):
            self.q, self.k = start.copy(), -1

        def update(self, dt, w, f, m):
            self.k += 1
            turn = np.concatenate([dt * w / 2.0, np.ones((len(w), 1))], axis=1)
            self.q = np.stack(compose(self.q.T, turn.T), axis=1)
            self.q /= np.linalg.norm(self.q, axis=1, keepdims=True)
            return answer(self, self.q, w)

    return declared(Batch, batch=True)


@whole(r"it must be an array of shape \(3, 4\)")
def wrong_number_of_trials(rng):
    row, kind = late(rng), rng.integers(4)
    return batch_of(
        lambda self, q, w: (
            q if self.k < row else [q[0], q[:-1], np.vstack([q, q[:1]]), q.T][kind]
        )
    )


@whole(r"the first of 3 trials is not what it is alone")
def trials_that_mix(rng):
    share = 10.0 ** rng.uniform(-6.0, -1.0)

    def answer(self, q, w):
        mixed = q + share * q.mean(axis=0)
        return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)

    return batch_of(answer)


@right
def plain(rng):
    return declared(Rate)


@right
def its_own_array(rng):
    P = covariance(rng)

    class Reused(Rate):
        def __init__(self, start):
            super().__init__(start)
            self.answer, self.P = np.empty(4), P.copy()

        def update(self, dt, w, f, m):
            self.answer[:] = self.step(dt, w)
            self.P *= 1.01
            return self.answer, self.P

    return declared(Reused)


@right
def any_sequence(rng):
    kind = rng.integers(6)

    class Other(Rate):
        def update(self, dt, w, f, m):
            q = self.step(dt, w)
            if kind == 1:  # of equal attitudes either sign will do
                return -q if self.k % 3 else q
            casts = [tuple, np.copy, list, np.float32, np.array, _read_only]
            return casts[kind](q)

    return declared(Other)


def _read_only(q):
    q.flags.writeable = False
    return q


@right
def function(rng):
    def make(start):
        held = Rate(start)
        return lambda dt, w, f, m: held.step(dt, w)

    return declared(make)


@right
def all_words(rng):
    p, m = int(rng.integers(3, 16)), int(rng.integers(1, 9))
    P, S = covariance(rng, p), covariance(rng, m)
    words = [
        {"covariance": P},
        {"bias": np.zeros(3)},
        {"innovation": np.zeros(m)},
        {"innovation": np.zeros(m), "innovation_covariance": S},
    ]
    chosen = [w for w in words if rng.random() < 0.6]

    class Words(Rate):
        def update(self, dt, w, f, m):
            answer = {"attitude": self.step(dt, w)}
            for each in chosen:
                answer |= each
            return answer

    return declared(Words)


@right
def nearly_singular(rng):
    P = np.zeros((6, 6))  # the bias is known
    P[:3, :3] = covariance(rng) * 10.0 ** rng.uniform(-8.0, 2.0)
    P32 = P.astype(np.float32)

    class Known(Rate):
        def update(self, dt, w, f, m):
            return self.step(dt, w), P32 if rng is None else P

    return declared(Known)


@right
def keeps_what_it_is_given(rng):
    class Keeps(Rate):
        def __init__(self, start):
            super().__init__(start)
            start[:] = np.nan  # its own
            self.before = None

        def update(self, dt, w, f, m):
            rate = w if self.before is None else (w + self.before) / 2.0
            self.before = w
            return self.step(dt, rate)

    return declared(Keeps)


@right
def seeded(rng):
    seed = int(rng.integers(1 << 30))

    class Random(Rate):
        def __init__(self, start):
            super().__init__(start)
            self.rng = np.random.default_rng(seed)

        def update(self, dt, w, f, m):
            return self.step(dt, w + 1e-3 * self.rng.standard_normal(3))

    return declared(Random)


@right
def batch(rng):
    return batch_of(lambda self, q, w: q)


@right
def closes(rng):
    opened = itertools.count()

    class Opened(Rate):
        def __init__(self, start):
            super().__init__(start)
            next(opened)

        def close(self):
            self.q = None

    return declared(Opened)
