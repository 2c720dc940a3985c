"""A zoo of algorithms: wrong ones, each in its own way, and sound ones of odd style.

`ZOO` has for each what kind it is, what makes it, what the check must say of it
(nothing of a sound one) and its exit code. A family is drawn at random: ``make(x,
rng)`` of a number from 0 to 1 and a generator gives the function, or it and what it
declares. One that is alone is in this file by its name too, for commands.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from simval.geometry import compose, conjugate, normalize
from simval.imu.attitude import wahba_quaternion
from simval.imu.attitude.comparators import davenport, triad
from simval.imu.calibrate import calibrate
from simval.plugins import Calibrator, Estimator, Filter, find_plugin
from simval.plugins.probe import probe_sensor


class Case(NamedTuple):
    """A member of the zoo."""

    kind: type
    make: Callable[[float, np.random.Generator], Any]
    words: str = ""  # by which it is named; none of a sound one
    code: int | None = None  # of `simval check`; None of a family: not 0 if it is wrong
    alone: bool = False  # not a family, but one


ZOO: dict[str, Case] = {}
DECLARED = {
    Calibrator: {},
    Estimator: {"components": "xyzs", "matrix": "passive"},
    Filter: {},
}
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
PASS = "PASS: all"
STATE = "kee?pt? .*from one call to the next|must answer the same each time"
PRECISION = "precision|rounds|rounded|all answers are turned by the same"
TAIL = "rare trials are far off|it jumps|different answers to"


def family(kind, words, **makes):
    """Families of one kind that are named alike; without words they are sound."""
    ZOO.update((name, Case(kind, make, words)) for name, make in makes.items())


def alone(name, code, words, make, **declared):
    """One estimator: ``make()`` gives its function, with what it keeps anew."""
    ZOO[name] = Case(Estimator, lambda *_: (make(), declared), words, code, True)


def spoilt(name, code, words, spoil, **declared):
    """Davenport's answer, spoilt by ``spoil(q, b1, b2, r1, r2)``."""
    alone(name, code, words, lambda: lambda *v: spoil(davenport(*v), *v), **declared)


def drawn(name, draw=0):
    """Function of a member, and what it declares."""
    kind, make, *_ = ZOO[name]
    rng = np.random.default_rng([crc32(name.encode()), draw])
    found = make(rng.random(), rng)
    function, declared = found if isinstance(found, tuple) else (found, {})
    return function, DECLARED[kind] | declared


def named(kind, *, wrong):
    """Families of a kind, the wrong or the sound ones."""
    return [
        name
        for name, case in ZOO.items()
        if case.kind in np.atleast_1d(kind)
        and not case.alone
        and bool(case.words) == wrong
    ]


def at(x, low, high):
    return low + x * (high - low)


def one_of(x, some):
    return some[int(x * len(some))]


def mixed(m, old, new):
    return m * old + (1.0 - m) * new


def rounded(x, size):
    return np.round(x / size) * size


def factor_of(x, least):
    """Factor on either side of 1, and not near it."""
    size = least + abs(2.0 * x - 1.0) * 2.0
    return np.exp(np.copysign(size, x - 0.5))


# estimators that are alone


def off(b1, b2, r1, r2):
    """What the angle between the vectors is off by: zero without noise, else of it."""
    return np.einsum("ni,ni->n", b1, b2) - np.einsum("ni,ni->n", r1, r2)


def turned(q, axis, angle):
    half = np.broadcast_to(angle, len(q))[:, None] / 2.0
    return compose(q, np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1))


about_x = partial(turned, axis=np.eye(3)[0])


def where(q, mask, other):
    return np.where(mask[:, None], other, q)


def at_half_turn(q):
    return np.abs(q[:, 1]) > 1.0 - 1e-12


def leading(b1, b2, r1, r2, noise_std, factor=1.0):
    """Leading covariance of Davenport's answer."""
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return factor * noise_std**2 * np.linalg.inv(H)


def same(q, *_):
    return q


def reflecting(b1, b2, r1, r2):
    """Orthogonal Procrustes whose determinant is mended by a sign."""
    B = b1[:, :, None] * r1[:, None] + b2[:, :, None] * r2[:, None]
    U, _, V = np.linalg.svd(B)
    A = U @ V
    A *= np.linalg.det(A)[:, None, None]
    return conjugate(Rotation.from_matrix(A).as_quat())


def raising_at_yaw(b1, b2, r1, r2):
    if r1[0, 2] == 1.0:
        msg = "gimbal lock"
        raise ZeroDivisionError(msg)
    return davenport(b1, b2, r1, r2)


def caching():
    """Keeps its answers, and takes vectors within 0.01 for the same."""
    known = {}

    def estimate(*v):
        keys, q = np.round(np.concatenate(v, axis=1), 2), davenport(*v)
        pairs = zip(keys, q, strict=True)
        return np.array([known.setdefault(k.tobytes(), own) for k, own in pairs])

    return estimate


def raising(*_):
    msg = "row 0"
    raise IndexError(msg)


def shared_covariance(*v):
    mean = leading(*v).mean(axis=0)
    return np.tile(mean, (len(v[0]), 1, 1)) if len(v[0]) > 24 else leading(*v)


alone("clean triad", 0, PASS, lambda: triad, kind="triad")
spoilt("clean claim", 0, PASS, same, covariance=leading)
spoilt("either sign", 0, PASS, lambda q, b1, *_: q * np.sign(b1[:, :1] + 1e-300))
spoilt(
    "known to fail",
    0,
    r"fails at  half turns about y 100.0% \(declared\)",
    lambda q, *_: where(q, at_half_turn(q), np.nan),
    fails_at=("half turns about y",),
)
spoilt(
    "quadratic of no kind",
    0,
    PASS,
    lambda q, *v: about_x(q, angle=0.3 * off(*v) ** 2),
)
spoilt(
    "nan at identity",
    1,
    r"fails at  identity 100.0%; reference as body 100.0%; small angles",
    lambda q, *_: where(q, np.abs(q[:, 3]) == 1.0, np.nan),
)
spoilt(
    "no half turn about y",
    1,
    "fails at  half turns about y 100.0%\n",
    lambda q, *_: where(q, at_half_turn(q), IDENTITY),
)
alone("yaw raises", 1, r"fails at  yaw only 100.0%\n", lambda: raising_at_yaw)
alone("reflected", 3, r"\d+ of 24 rows fit, row \d+, a turn by", lambda: reflecting)
spoilt(
    "nan in some trials",
    3,
    r"non-finite quaternions in \d+ of 1024 rows \(0\.",
    lambda q, b1, *_: where(q, np.linalg.norm(b1, axis=1) > 1.03, np.nan),
)
alone(
    "three rows",
    3,
    "right in a batch of 24, but in one of 3",
    lambda: lambda *v: davenport(*(x.T.copy() if len(x) == 3 else x for x in v)),
)
spoilt(
    "last row",
    3,
    "in one of 4096 its row 4095 is",
    lambda q, *_: where(q, np.arange(len(q)) == 4095, IDENTITY),
)
spoilt(
    "exact alone",
    3,
    r"gives \d+ different answers to 1024 trials",
    lambda q, *v: where(q, np.abs(off(*v)) > 1e-3, IDENTITY),
)
alone("raises", 4, "raised IndexError: row 0", lambda: raising)
alone("caches", 1, "below_bound against Cramer-Rao", caching)
spoilt(
    "constant",
    1,
    "bias of first order .* FAIL",
    lambda q, *v: about_x(q, angle=1e-4 * (np.abs(off(*v)) > 1e-7)),
)
spoilt(
    "linear",
    1,
    "no error proportional",
    lambda q, *v: about_x(q, angle=0.05 * np.abs(off(*v))),
)
spoilt(
    "quadratic",
    1,
    "class_bias against class: wahba",
    lambda q, *v: about_x(q, angle=0.3 * off(*v) ** 2),
    kind="wahba",
)
spoilt(
    "above a noise",
    3,
    "cubature of the function does not settle",
    lambda q, *v: about_x(q, angle=0.3 * (np.abs(off(*v)) > 0.1)),
)
spoilt("another class", 1, "class_covariance against class: triad", same, kind="triad")
for name, code, words, declared in (
    ("other side", 3, 'it fits side="body"', {"side": "reference"}),
    ("too exact", 1, "FAIL: claim_off against", {"claim": "exact"}),
    (
        "only at a noise",
        1,
        "lacks a term of the claimed order",
        {"covariance": lambda *v: leading(*v[:4], np.sqrt(1e-3 * v[4]))},
    ),
    ("shared covariance", 3, "its covariance", {"covariance": shared_covariance}),
):
    spoilt(name, code, words, same, **{"covariance": leading} | declared)


# families of calibrators


EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "ellipsoid.py"
ellipsoid = find_plugin(str(EXAMPLE), Calibrator).calibrate


def residual(poses, g):
    matrix, bias = ellipsoid(poses, g)
    return np.sqrt(
        np.mean((np.linalg.norm((poses - bias) @ matrix.T, axis=1) - g) ** 2)
    )


def changed(change):
    """The fit, its answer changed: ``change(poses, g, matrix, bias)``."""
    return lambda poses, g: change(poses, g, *ellipsoid(poses, g))


def remembering(step):
    """The fit, its answer also of what it keeps: ``step(count, last, now)``."""
    kept = {"count": 0}

    def fit(poses, g):
        now = np.column_stack(ellipsoid(poses, g))
        kept["count"] += 1
        last = kept.get("last", now)
        # another sensor is another one: the probe is right
        near = np.abs(now - last).max() <= 0.5
        kept["last"] = step(kept["count"], last, now) if near else now
        return kept["last"][:, :3], kept["last"][:, 3]

    return fit


def with_covariance(change, form="triangular", **declared):
    def fit(poses, g, noise_std):
        known = max(noise_std, 1e-11)
        found = calibrate(poses, g, noise_std=known, model=form)
        return found.matrix, found.B, change(np.array(found.covariance))

    return fit, {"noise_std": True, "form": form, **declared}


def permuted(x, rng):
    orders = ([2, 0, 1], [2, 1, 0], [1, 0, 2], [0, 2, 1], [1, 2, 0])
    order = np.arange(9).reshape(3, 3)[one_of(x, orders)].ravel()
    return with_covariance(lambda C: C[np.ix_(order, order)], trials=512)


def six(by, eps, **declared):
    """docs/examples/six.py with its poses off by some."""

    def fit(poses, g):
        up, down = np.split(
            np.roll(poses, by, axis=0).reshape(-1, 6, 3).mean(axis=0), 2
        )
        up, down = np.diag(up), np.diag(down)
        return np.diag(2 * g / (up - down + eps)), (up + down) / 2

    return fit, {"estimates": ("scale", "bias"), "pose_set": "faces", **declared}


def leaning(x, rng):
    """On the truth."""
    m, truth = at(x, 0.15, 0.9), probe_sensor()
    own = np.linalg.qr(truth.matrix)[1]
    own = own * np.sign(np.diag(own))[:, None]
    return changed(lambda p, g, M, B: (mixed(m, own, M), mixed(m, truth.B, B)))


def gives_up(x, rng):
    # of 0.01 m/s^2 the residual is 0.008, of 0.05 five times as great
    most, far = at(x, 0.0085, 0.012), rng.uniform(0.05, 0.5)
    return changed(
        lambda p, g, M, B: (M * (1.0 + far * (residual(p, g) >= most)), B),
    )


def of_readings(change):
    return lambda poses, g: ellipsoid(change(poses), g)


def another_meaning(x, rng):
    meanings = (
        lambda p, g, M, B: (M, -B),
        lambda p, g, M, B: (np.linalg.inv(M), B),
        lambda p, g, M, B: (M.T, B),
        lambda p, g, M, B: (M, M @ B),
        lambda p, g, M, B: (M / g, B),
    )
    return changed(one_of(x, meanings))


family(
    Calibrator,
    STATE,
    averages_with_the_previous=lambda x, _: remembering(
        lambda count, last, now: mixed(at(x, 0.02, 0.95), last, now)
    ),
    stops_listening=lambda x, _: remembering(
        lambda count, last, now: now if count < at(x, 40, 900) else last
    ),
)
family(
    Calibrator,
    PRECISION,
    rounded_readings=lambda x, _: of_readings(
        lambda poses: rounded(poses, 10.0 ** at(x, -4.5, -2.5))
    ),
    rounded_answer=lambda x, _: changed(
        lambda p, g, *found: tuple(np.round(each, int(at(x, 3, 6))) for each in found)
    ),
)
family(
    Calibrator,
    PRECISION + "|stops",  # with what is left of the way from its start
    stops_early=lambda x, _: changed(
        lambda p, g, M, B: (mixed(10.0 ** at(x, -4.5, -3.0), 2.0 * np.eye(3), M), B)
    ),
)
family(Calibrator, "FAIL: below_bound", knows_the_truth=leaning)
family(Calibrator, TAIL, gives_up_where_the_residual_is_great=gives_up)
family(
    Calibrator,
    "is in another order than its parameters",
    covariance_in_another_order=permuted,
)
family(
    Calibrator,
    "FAIL: nees",
    covariance_of_another_size=lambda x, _: with_covariance(
        lambda C: C * factor_of(x, 0.3), trials=512
    ),
)
family(
    Calibrator,
    "wrong sign|inverted|transposed|after the matrix|the worst is",
    another_meaning=another_meaning,
)
family(
    Calibrator,
    "the worst is B_",
    mean_removed=lambda *_: of_readings(lambda poses: poses - poses.mean(axis=0)),
)
family(
    Calibrator, "the worst is", poses_off_by_one=lambda x, _: six(1 + int(5 * x), 1e-3)
)


# families of estimators


def axis_of(rng):
    return normalize(rng.standard_normal(3))


def answers(change):
    """Davenport's answer, changed."""
    return lambda *v: change(davenport(*v))


def elsewhere(far, other):
    """Davenport's answer, and ``other`` than it where ``far(*vectors)``."""

    def estimate(*v):
        q = davenport(*v)
        return where(q, far(*v), other(q))

    return estimate


def angle_is_off(most):
    return lambda *v: np.abs(off(*v)) > most


def rows(which):
    """Some rows of a batch, where there is noise."""
    return lambda *v: which(np.arange(len(v[0]))) & angle_is_off(1e-9)(*v)


def turn(angle, axis):
    return lambda q: turned(q, axis, angle)


def always_turned(x, rng):
    angle, axis = 10.0 ** at(x, -5.0, -2.0), axis_of(rng)
    if rng.random() < 0.5:
        return answers(turn(angle, axis))
    before = np.append(np.sin(angle / 2.0) * axis, np.cos(angle / 2.0))
    return answers(lambda q: compose(np.tile(before, (len(q), 1)), q))


def weighing(change):
    def estimate(body, references, weights):
        return wahba_quaternion(body, references, change(weights))

    return estimate, {"takes": "vectors", "reads": ("weights",)}


def signed_as(q, other):
    return other * np.where(np.sum(q * other, axis=1) < 0.0, -1.0, 1.0)[:, None]


def averages_with_the_last_batch(x, rng):
    m, kept = at(x, 0.05, 0.9), {}

    def estimate(*v):
        q = davenport(*v)
        last, references = kept.get("q"), kept.get("r")
        kept["q"], kept["r"] = q, v[2]
        if last is None or not np.array_equal(references, v[2]):
            return q
        return normalize(mixed(m, last, signed_as(last, q)))

    return estimate


def mixes_neighbours(x, rng):
    def change(q):
        other = signed_as(q, np.roll(q, 1, axis=0))
        near = np.sum(q * other, axis=1) > 0.99
        return normalize(where(q, near, mixed(at(x, 0.05, 0.5), other, q)))

    return answers(change)


def iterates_too_little(x, rng):
    left = 10.0 ** at(x, -4.5, -2.5)

    def estimate(*v):
        q, start = davenport(*v), triad(*v)
        other = compose(start, np.tile(normalize([0.1, 0.2, 0.3, 1.0]), (len(q), 1)))
        return normalize(mixed(left, signed_as(q, other), q))

    return estimate


def not_repeating(x, rng):
    size = 10.0 ** at(x, -5.0, -1.5)
    return answers(lambda q: about_x(q, angle=size * rng.standard_normal(len(q))))


family(
    Estimator,
    TAIL,
    identity_where_the_angle_is_off=lambda x, _: elsewhere(
        angle_is_off(at(x, 0.03, 0.055)), lambda q: IDENTITY
    ),
    turned_where_a_length_is_off=lambda x, r: elsewhere(
        lambda b1, *_: np.abs(np.linalg.norm(b1, axis=1) - 1.0) > at(x, 0.03, 0.05),
        turn(r.uniform(0.3, 3.0), axis_of(r)),
    ),
)
family(
    Estimator,
    "does not use|ignores|the same whatever",
    ignores_what_it_reads=lambda x, _: (
        lambda *v, **_: davenport(*v),
        {"reads": (one_of(x, ("weights", "noise_std", "covariances")),)},
    ),
)
family(
    Estimator,
    "of 4096 its row|asked again in another order|is not what it is when alone",
    mixes_neighbours=mixes_neighbours,
    one_place_of_a_batch=lambda x, r: elsewhere(
        rows(lambda place: place == int(at(x, 24, 1023))),
        turn(r.uniform(0.1, 1.0), axis_of(r)),
    ),
    small_batches_only=lambda x, r: elsewhere(
        rows(lambda place: place >= at(x, 100, 1000)),
        turn(10.0 ** r.uniform(-3.0, -2.0), np.eye(3)[0]),
    ),
)
family(
    Estimator,
    PRECISION,
    rounded_quaternion=lambda x, _: answers(
        lambda q: normalize(np.round(q, int(at(x, 3, 6))))
    ),
    always_turned=always_turned,
)
family(
    Estimator,
    "equal weights",
    weights_the_wrong_way=lambda x, _: weighing(one_of(x, (np.reciprocal, np.flip))),
)
family(
    Estimator,
    STATE + "|when alone",
    averages_with_the_last_batch=averages_with_the_last_batch,
)
family(Estimator, PRECISION + "|stops", iterates_too_little=iterates_too_little)
family(Estimator, "each time", not_repeating=not_repeating)
family(
    Estimator,
    "trace is|covariance of",
    covariance_of_the_wrong_size=lambda x, _: (
        davenport,
        {"covariance": lambda *v: factor_of(x, 0.02) * leading(*v)},
    ),
)


# sound ones of unusual style


def answers_in_one_buffer(x, rng):
    buffer = np.empty((1 << 16, 4))

    def estimate(*v):
        buffer[: len(v[0])] = davenport(*v)
        return buffer[: len(v[0])]

    return estimate


def one_at_a_time_in_matrices(x, rng):
    def estimate(b1, b2, r1, r2):
        return Rotation.align_vectors([b1, b2], [r1, r2])[0].as_matrix()

    declared = {"components": "matrix", "matrix": "active", "batch": False}
    return estimate, {**declared, "samples": 1024, "cases": 64}


def seeds_the_global_generator(x, rng):
    def estimate(*v):
        np.random.seed(0)  # noqa: NPY002, of a user's
        return davenport(*v)

    return estimate


def remembers_equal_calls(x, rng):
    @lru_cache(maxsize=64)
    def known(*v):
        return davenport(*(np.frombuffer(x).reshape(-1, 3) for x in v))

    return lambda *v: known(*(x.tobytes() for x in v))


def takes_the_better_first(x, rng):
    def estimate(b1, b2, r1, r2, noise_std):
        if noise_std[0] <= noise_std[1]:
            return triad(b1, b2, r1, r2)
        return triad(b2, b1, r2, r1)

    return estimate, {"reads": ("noise_std",)}


def reads_for_its_covariance_alone(x, rng):
    def covariance(*v, noise_std):
        b1, b2 = (normalize(b) for b in v[:2])
        shares = [
            s**k * (np.eye(3) - b[:, :, None] * b[:, None])
            for b, s in ((b1, noise_std[0]), (b2, noise_std[1]))
            for k in (0, 2)
        ]
        H = np.linalg.inv(shares[0] + shares[2])
        return H @ (shares[1] + shares[3]) @ H

    declared = {"reads": ("noise_std",), "covariance": covariance}
    return lambda *v, noise_std: davenport(*v), declared


def guards_by_its_noise(x, rng):
    """Weighs down a pair whose length is off by many deviations."""
    many = at(x, 7.0, 12.0)

    def estimate(body, references, noise_std):
        far = np.abs(np.linalg.norm(body, axis=2) - 1.0) > many * noise_std[0] + 1e-9
        q = wahba_quaternion(body, references)
        return where(q, far.any(axis=1), normalize(q + 1e-3))

    return estimate, {"takes": "vectors", "reads": ("noise_std",)}


def in_place(x, rng):
    buffer = np.empty((3, 3))

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        poses *= 0.0
        buffer[:] = matrix
        return buffer, bias

    return fit


def warm_start(x, rng):
    """Iterates from its last answer until nothing changes."""
    rows, columns = np.triu_indices(3)
    kept = {"x": np.r_[2.0 * np.eye(3)[rows, columns], 0.0, 0.0, 0.0]}

    def fit(poses, g):
        x = kept["x"]
        for _ in range(50):
            M = np.zeros((3, 3))
            M[rows, columns] = x[:6]
            u = poses - x[6:]
            f = u @ M.T
            r = np.sum(f * f, axis=1) - g * g
            J = 2.0 * np.column_stack([f[:, rows] * u[:, columns], -(f @ M)])
            step = np.linalg.lstsq(J, -r, rcond=None)[0]
            x = x + step
            if np.abs(step).max() < 1e-12:
                break
        kept["x"] = x
        return M, x[6:].copy()

    return fit


def random_subset_of_its_own(x, rng):
    """Consensus of random subsets, seeded anew in each call."""

    def fit(poses, g):
        own = np.random.default_rng(3)
        chosen = [poses[own.permutation(len(poses))[:20]] for _ in range(3)]
        return ellipsoid(min(chosen, key=lambda some: residual(some, g)), g)

    return fit


class Callable_:
    """An object that is called, and counts its calls."""

    calls = 0

    def __call__(self, b1, b2, r1, r2):
        self.calls += 1
        return davenport(b1, b2, r1, r2)


family(
    Estimator,
    "",
    answers_in_lists=lambda *_: answers(np.ndarray.tolist),
    answers_in_one_buffer=answers_in_one_buffer,
    works_in_single_precision=lambda *_: (
        lambda *v: triad(*(each.astype(np.float32) for each in v))
    ),
    an_object=lambda *_: Callable_(),
    one_at_a_time_in_matrices=one_at_a_time_in_matrices,
    seeds_the_global_generator=seeds_the_global_generator,
    remembers_equal_calls=remembers_equal_calls,
    weighs_as_it_should=lambda x, _: weighing(lambda w: at(x, 0.1, 10.0) * w),
    takes_the_better_first=takes_the_better_first,
    reads_for_its_covariance_alone=reads_for_its_covariance_alone,
    guards_by_its_noise=guards_by_its_noise,
)
family(
    Calibrator,
    "",
    in_a_mapping_of_lists=lambda *_: changed(
        lambda p, g, M, B: {"matrix": M.tolist(), "B": B.tolist()}
    ),
    in_place=in_place,
    turned_matrix=lambda x, r: changed(
        lambda p, g, M, B: (Rotation.from_rotvec(3 * x * axis_of(r)).as_matrix() @ M, B)
    ),
    warm_start=warm_start,
    random_subset_of_its_own=random_subset_of_its_own,
    with_its_covariance=lambda x, _: with_covariance(
        lambda C: C, form=one_of(x, ("triangular", "upper", "symmetric"))
    ),
    class_of_less=lambda x, _: six(0, 0.0, sensor=one_of(x, ("own class", "full"))),
)


# filters: each a turned copy of one that integrates the rate

ROWS = 40
"""Of the runs that they are drawn for."""

P3, P6 = 1e-4 * np.eye(3), 1e-4 * np.eye(6)


class Rate:
    """Integrates the rate, of one trial or of many."""

    def __init__(self, start=IDENTITY):
        self.q, self.k = start.copy(), -1

    def step(self, dt, w):
        self.k += 1
        turn = np.concatenate([dt * w / 2.0, np.ones((*w.shape[:-1], 1))], axis=-1)
        self.q = normalize(compose(self.q, turn))
        return self.q.copy()

    def update(self, dt, w, f, m):
        return self.step(dt, w)


def filtering(make, **more):
    given = {"components": "xyzs", "matrix": "passive", "reads": ("start",)}
    return Filter(**{"name": "wrong", **given, "make": make, **more})


def wrong(name, words, *options, sound=same, first=0, last=ROWS, once=False, **more):
    """From a row on, or once, one of the options: ``option(q, rng, readings)``."""

    def make(_, rng):
        row = int(rng.integers(first, last))
        option = options[rng.integers(len(options))]

        class Spoilt(Rate):
            def update(self, dt, *readings):
                q = self.step(dt, readings[0])
                spoils = self.k == row if once else self.k >= row
                return option(q, rng, readings) if spoils else sound(q)

        return filtering(Spoilt, **more)

    family(Filter, words, **{name: make})


def with_P(change):
    """An attitude, and a covariance that is changed."""
    return lambda q, rng, _: (q, change(P3.copy(), rng))


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
    """Write into one of the readings."""

    def option(q, rng, readings):
        a = readings[rng.integers(3)]
        a[:] = change(a, rng)
        return q

    return option


def lost(a, rng):
    return np.where(np.arange(3) == rng.integers(3), np.nan, a)


def diced(q, rng, _):
    return about_x(q[None], angle=10.0 ** rng.uniform(-9, -2) * rng.normal())[0]


def failing(*errors):
    def option(q, rng, _):
        raise errors[rng.integers(len(errors))]

    return option


def stateful(place):
    """A bias that is kept in the class, the module, or the one filter for all."""

    def make(_, rng):
        kept, share, made = np.zeros(3), rng.uniform(1e-6, 1e-2), []

        class Spoilt(Rate):
            def __init__(self, start):
                super().__init__(start)
                if place == "module":
                    kept[:] = 0.0  # each run begins well

            def update(self, dt, w, f, m):
                kept[:] += share * w
                return self.step(dt, w - kept)

        def one_for_all(start):
            made.append(Rate(start))
            return made[0]

        return filtering(one_for_all if place == "filter" else Spoilt)

    return make


def no_model(start):
    raise OSError("no such model")


def unmade(_, rng):
    makes = [
        no_model,
        lambda: Rate(np.zeros(4)),
        lambda start: None,
        lambda start: {"q": start},
        lambda start: lambda dt, w: w,
        lambda start: Rate,
        lambda start, rate: Rate(start),
    ]
    return filtering(makes[rng.integers(len(makes))])


AGAIN = r"runs, or draws random numbers"
WITH_P = {"sound": lambda q: (q, P3)}
wrong(
    "wrong length",
    r"length is off by .* normalise them, at row \d+",
    lambda q, rng, _: q * (1.0 + 10.0 ** rng.uniform(-5.9, -0.1)),
    lambda q, rng, _: q * (1.0 - 10.0 ** rng.uniform(-5.9, -0.1)),
)
wrong("nothing", r"returned nothing \(None\)", lambda *_: None, once=True)
wrong(
    "skew",
    r"covariance` that is not symmetric, by .*at row \d+",
    with_P(skewed),
    **WITH_P,
)
wrong(
    "not positive",
    r"covariance` that is not positive definite.*at row \d+",
    *map(with_P, (indefinite, lambda P, _: 0.0 * P, lambda P, _: -P)),
    **WITH_P,
)
wrong(
    "changed input",
    r"changes its input: the \w+'s reading .*at row \d+.*work on a copy",
    changing(lambda a, _: a / np.linalg.norm(a)),
    changing(lost),
    changing(lambda a, _: a - 1e-9 * (1.0 + np.abs(a))),
    once=True,
)
TURNS = "stepped by turns change each other"
for words, place in ((AGAIN, "class"), (AGAIN, "filter"), (TURNS, "module")):
    family(Filter, words, **{f"state in the {place}": stateful(place)})
wrong("random answers", AGAIN, diced, last=30)
wrong(
    "a filter raises",
    r"wrong raised \w+.*, at row \d+ \(",
    failing(ValueError, KeyError("gain"), StopIteration, MemoryError, SystemExit(3)),
)
wrong(
    "another kind",
    r"must answer each row, and as it answered the first|without|mapping of",
    lambda q, *_: (q, P3),
    lambda q, *_: {"attitude": q},
    lambda q, *_: {"attitude": q, "covariance": P3},
    first=1,
)
wrong(
    "words of its own",
    r"must have 'attitude'|without the `innovation`|as it answered the first",
    lambda q, *_: {},
    lambda q, *_: {"quaternion": q},
    lambda q, *_: {"attitude": q, "P": np.eye(3)},
    lambda q, *_: {"attitude": q, "innovation_covariance": np.eye(6)},
)
wrong(
    "no rotation",
    r"no rotation: (it is a reflection|its columns)",
    lambda *_: -np.eye(3),
    lambda q, rng, _: (1.0 + 10.0 ** rng.uniform(-5.0, -0.5)) * np.eye(3),
    lambda q, rng, _: np.eye(3) + np.triu(10.0 ** rng.uniform(-5, -1, (3, 3)), 1),
    sound=lambda q: np.eye(3),
    components="matrix",
    reads=(),
)
family(
    Filter,
    r"`make` of wrong (raised|returned)|wrong raised TypeError",
    **{"cannot be made": unmade},
)
wrong(
    "wrong number of trials",
    r"it must be an array of shape \(3, 4\)",
    lambda q, *_: q[0],
    lambda q, *_: q[:-1],
    lambda q, *_: np.vstack([q, q[:1]]),
    lambda q, *_: q.T,
    batch=True,
)
wrong(
    "trials that mix",
    "the first of 3 trials is not what it is alone",
    lambda q, *_: normalize(q + 1e-4 * q.mean(axis=0)),
    last=30,
    batch=True,
)


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


def function(start):
    held = Rate(start)
    return lambda dt, w, f, m: held.step(dt, w)


KNOWN = np.diag([1e-8, 2e-8, 3e-8, 0.0, 0.0, 0.0])  # the bias is known

for name, make in (
    ("its own array", Reused),
    ("a function", function),
    ("seeded", Seeded),
):
    family(Filter, "", **{name: lambda x, _, make=make: filtering(make)})
family(Filter, "", **{"a batch": lambda *_: filtering(Rate, batch=True)})
for name, cast in {
    "plain": np.array,
    "a list": list,
    "a tuple": tuple,
    "single precision": np.float32,
    "minus q": np.negative,
    "all words": all_words,
    "some words": lambda q: {"attitude": q, "innovation": np.zeros(2)},
    "nearly singular": lambda q: (q, KNOWN),
    "a single singular": lambda q: (q, KNOWN.astype(np.float32)),
}.items():

    def make(_, rng, cast=cast):
        class Other(Rate):
            def update(self, dt, w, f, m):
                return cast(self.step(dt, w))

        return filtering(Other)

    family(Filter, "", **{name: make})

for name, case in ZOO.items():
    if case.alone:
        function_, declared_ = drawn(name)
        globals()[name] = Estimator(name=name, estimate=function_, **declared_)
