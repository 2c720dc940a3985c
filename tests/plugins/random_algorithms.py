"""Algorithms with one fault of random size each, and sound ones of unusual style.

`BAD` and `SOUND` hold for each family its kind and what makes a member of a number
from 0 to 1 and a generator: ``make(x, rng)`` gives the function, or it and what it
declares beyond `DECLARED`. With a bad family stand the words by which a check names it.
"""

from functools import lru_cache

import numpy as np
from garbage_estimators import IDENTITY, leading, off
from scipy.spatial.transform import Rotation

from simval.attitude import wahba_quaternion
from simval.attitude.comparators import davenport, triad
from simval.calibrate import calibrate
from simval.geometry import compose, normalize
from simval.plugins import Calibrator, Estimator
from simval.plugins.probe import probe_sensor

BAD, SOUND = {}, {}
DECLARED = {
    Calibrator: {},
    Estimator: {"components": "xyzs", "matrix": "passive"},
}
STATE = "kee?pt? .*from one call to the next|must answer the same each time"
PRECISION = "precision|rounds|rounded|all answers are turned by the same"
TAIL = "rare trials are far off|it jumps|different answers to"
WEIGHTS = {"takes": "vectors", "reads": ("weights",)}


def bad(kind, words, **makes):
    BAD.update((name, (kind, words, make)) for name, make in makes.items())


def sound(kind, **makes):
    SOUND.update((name, (kind, make)) for name, make in makes.items())


def member(kind, make, rng):
    """Function of a family, and what it declares."""
    found = make(rng.random(), rng)
    function, declared = found if isinstance(found, tuple) else (found, {})
    return function, DECLARED[kind] | declared


def at(x, low, high):
    return low + x * (high - low)


def one_of(x, some):
    return some[int(x * len(some))]


def mixed(m, old, new):
    return m * old + (1.0 - m) * new


def rounded(x, size):
    return np.round(x / size) * size


# calibrators


def ellipsoid(poses, g):
    """Fit of docs/examples/ellipsoid.py."""
    D = np.column_stack([poses**2, 2 * poses * poses[:, [1, 2, 0]], poses])
    a, b, c, d, e, f, *v = np.linalg.lstsq(D, np.ones(len(D), D.dtype), rcond=None)[0]
    A = np.array([[a, d, f], [d, b, e], [f, e, c]])
    bias = -np.linalg.solve(A, v) / 2
    return np.linalg.cholesky(A / (1 + bias @ A @ bias)).T * g, bias


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


def six(by, eps, **declared):
    """docs/examples/six.py with its poses off by some."""

    def fit(poses, g):
        turned = np.roll(poses, by, axis=0)
        up, down = np.split(turned.reshape(-1, 6, 3).mean(axis=0), 2)
        up, down = np.diag(up), np.diag(down)
        return np.diag(2 * g / (up - down + eps)), (up + down) / 2

    return fit, {"estimates": ("scale", "bias"), "pose_set": "faces", **declared}


def leaning(m):
    truth = probe_sensor()
    own = np.linalg.qr(truth.matrix)[1]
    own = own * np.sign(np.diag(own))[:, None]
    return changed(lambda p, g, M, B: (mixed(m, own, M), mixed(m, truth.B, B)))


def gives_up(x, rng):
    # of 0.01 m/s^2 the residual is 0.008, of 0.05 five times as great
    most, far = at(x, 0.0085, 0.012), rng.uniform(0.05, 0.5)
    return changed(
        lambda p, g, M, B: (M * (1.0 + far * (residual(p, g) >= most)), B),
    )


def permuted(x, rng):
    orders = ([2, 0, 1], [2, 1, 0], [1, 0, 2], [0, 2, 1], [1, 2, 0])
    order = np.arange(9).reshape(3, 3)[one_of(x, orders)].ravel()
    return with_covariance(lambda C: C[np.ix_(order, order)], trials=512)


def factor_of(x, least):
    """Factor on either side of 1, and not near it."""
    size = least + abs(2.0 * x - 1.0) * 2.0
    return np.exp(np.copysign(size, x - 0.5))


def of_readings(change):
    return lambda poses, g: ellipsoid(change(poses), g)


def of_bits(bits):
    """The fit of readings with so many bits of a fraction; half precision has 10."""

    def change(poses):
        fraction, exponent = np.frexp(poses)
        return np.ldexp(np.round(fraction * 2.0**bits), exponent - bits)

    return of_readings(change)


def another_meaning(x, rng):
    meanings = (
        lambda p, g, M, B: (M, -B),
        lambda p, g, M, B: (np.linalg.inv(M), B),
        lambda p, g, M, B: (M.T, B),
        lambda p, g, M, B: (M, M @ B),
        lambda p, g, M, B: (M / g, B),
    )
    return changed(one_of(x, meanings))


bad(
    Calibrator,
    STATE,
    averages_with_the_previous=lambda x, _: remembering(
        lambda count, last, now: mixed(at(x, 0.02, 0.95), last, now)
    ),
    stops_listening=lambda x, _: remembering(
        lambda count, last, now: now if count < at(x, 40, 900) else last
    ),
    drifts=lambda x, _: remembering(
        lambda count, last, now: now * (1.0 + 10.0 ** at(x, -6.5, -4) * (count > 4))
    ),
    every_so_many_the_last=lambda x, _: remembering(
        lambda count, last, now: now if count % int(at(x, 3, 60)) else last
    ),
)
bad(
    Calibrator,
    PRECISION,
    less_than_double_precision=lambda x, _: of_bits(int(at(x, 9, 14))),
    rounded_readings=lambda x, _: of_readings(
        lambda poses: rounded(poses, 10.0 ** at(x, -4.5, -2.5))
    ),
    rounded_answer=lambda x, _: changed(
        lambda p, g, *found: tuple(np.round(each, int(at(x, 3, 6))) for each in found)
    ),
)
bad(
    Calibrator,
    PRECISION + "|stops",  # with what is left of the way from its start
    stops_early=lambda x, _: changed(
        lambda p, g, M, B: (mixed(10.0 ** at(x, -4.5, -3.0), 2.0 * np.eye(3), M), B)
    ),
)
for words, name, make in (
    (
        "below the (Cramer-Rao )?bound|below_bound",
        "knows_the_truth",
        lambda x, _: leaning(at(x, 0.15, 0.9)),
    ),
    (TAIL, "gives_up_where_the_residual_is_great", gives_up),
    ("order", "covariance_in_another_order", permuted),
    (
        "nees|covariance",
        "covariance_of_another_size",
        lambda x, _: with_covariance(lambda C: C * factor_of(x, 0.3), trials=512),
    ),
    (
        "wrong sign|inverted|transposed|after the matrix|K_|bias|S_|T_",
        "another_meaning",
        another_meaning,
    ),
    (
        "bias|B_|B looks|B has|the worst is",
        "mean_removed",
        lambda *_: of_readings(lambda poses: poses - poses.mean(axis=0)),
    ),
    ("the worst is", "poses_off_by_one", lambda x, _: six(1 + int(5 * x), 1e-3)),
):
    bad(Calibrator, words, **{name: make})


# estimators


def turned(q, axis, angle):
    half = np.broadcast_to(angle, len(q))[:, None] / 2.0
    return compose(q, np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1))


def axis_of(rng):
    return normalize(rng.standard_normal(3))


def answers(change):
    """Davenport's answer, changed."""
    return lambda *v: change(davenport(*v))


def of_vectors(change):
    """Davenport's answer to changed vectors."""
    return lambda *v: davenport(*map(change, v))


def where(far, other):
    """Davenport's answer, and ``other`` than it where ``far(*vectors)``."""

    def estimate(*v):
        q = davenport(*v)
        return np.where(far(*v)[:, None], other(q), q)

    return estimate


def angle_is_off(most):
    return lambda *v: np.abs(off(*v)) > most


def length_is_off(most):
    return lambda b1, *_: np.abs(np.linalg.norm(b1, axis=1) - 1.0) > most


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

    return estimate, WEIGHTS


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
        return normalize(np.where(near[:, None], mixed(at(x, 0.05, 0.5), other, q), q))

    return answers(change)


def iterates_too_little(x, rng):
    left = 10.0 ** at(x, -4.5, -2.5)

    def estimate(*v):
        q, start = davenport(*v), triad(*v)
        other = compose(start, np.tile(normalize([0.1, 0.2, 0.3, 1.0]), (len(q), 1)))
        return normalize(mixed(left, signed_as(q, other), q))

    return estimate


def not_repeating(x, rng):
    size, axis = 10.0 ** at(x, -5.0, -1.5), np.eye(3)[0]
    return answers(lambda q: turned(q, axis, size * rng.standard_normal(len(q))))


bad(
    Estimator,
    TAIL,
    identity_where_the_angle_is_off=lambda x, _: where(
        angle_is_off(at(x, 0.03, 0.055)), lambda q: IDENTITY
    ),
    turned_where_a_length_is_off=lambda x, r: where(
        length_is_off(at(x, 0.03, 0.05)), turn(r.uniform(0.3, 3.0), axis_of(r))
    ),
)
bad(
    Estimator,
    "does not use|ignores|the same whatever",
    ignores_what_it_reads=lambda x, _: (
        lambda *v, **_: davenport(*v),
        {"reads": (one_of(x, ("weights", "noise_std", "covariances")),)},
    ),
)
bad(
    Estimator,
    "row|batch|order|alone",
    mixes_neighbours=mixes_neighbours,
    one_place_of_a_batch=lambda x, r: where(
        rows(lambda place: place == int(at(x, 24, 1023))),
        turn(r.uniform(0.1, 1.0), axis_of(r)),
    ),
    small_batches_only=lambda x, r: where(
        rows(lambda place: place >= at(x, 100, 1000)),
        turn(10.0 ** r.uniform(-3.0, -2.0), np.eye(3)[0]),
    ),
)
bad(
    Estimator,
    PRECISION,
    rounded_quaternion=lambda x, _: answers(
        lambda q: normalize(np.round(q, int(at(x, 2, 6))))
    ),
    rounded_vectors=lambda x, _: of_vectors(
        lambda v: rounded(v, 10.0 ** at(x, -5.0, -2.5))
    ),
    always_turned=always_turned,
)
for words, name, make in (
    (
        "equal weights",
        "weights_the_wrong_way",
        lambda x, _: weighing(one_of(x, (np.reciprocal, np.flip))),
    ),
    (
        STATE + "|when alone",
        "averages_with_the_last_batch",
        averages_with_the_last_batch,
    ),
    (PRECISION + "|stops", "iterates_too_little", iterates_too_little),
    ("each time", "not_repeating", not_repeating),
    (
        "trace is|covariance of",
        "covariance_of_the_wrong_size",
        lambda x, _: (
            davenport,
            {"covariance": lambda *v: factor_of(x, 0.02) * leading(*v)},
        ),
    ),
):
    bad(Estimator, words, **{name: make})


# sound ones of unusual style


def answers_in_one_buffer(x, rng):
    buffer = np.empty((1 << 16, 4))

    def estimate(*v):
        buffer[: len(v[0])] = davenport(*v)
        return buffer[: len(v[0])]

    return estimate


class _Callable:
    """An object that is called, and counts its calls."""

    calls = 0

    def __call__(self, b1, b2, r1, r2):
        self.calls += 1
        return davenport(b1, b2, r1, r2)


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
        return np.where(far.any(axis=1)[:, None], normalize(q + 1e-3), q)

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


sound(
    Estimator,
    answers_in_lists=lambda *_: answers(np.ndarray.tolist),
    answers_in_one_buffer=answers_in_one_buffer,
    works_in_single_precision=lambda *_: (
        lambda *v: triad(*(each.astype(np.float32) for each in v))
    ),
    an_object=lambda *_: _Callable(),
    one_at_a_time_in_matrices=one_at_a_time_in_matrices,
    seeds_the_global_generator=seeds_the_global_generator,
    remembers_equal_calls=remembers_equal_calls,
    weighs_as_it_should=lambda x, _: weighing(lambda w: at(x, 0.1, 10.0) * w),
    takes_the_better_first=takes_the_better_first,
    reads_for_its_covariance_alone=reads_for_its_covariance_alone,
    guards_by_its_noise=guards_by_its_noise,
)
sound(
    Calibrator,
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
