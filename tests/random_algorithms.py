"""Algorithms with one fault of random size each, and sound ones of unusual style.

`BAD` and `SOUND` hold for each family its kind and what makes a member of random
numbers: ``make(rng)`` gives the function and what it declares. With a bad family stand
the words by which a check names the fault.
"""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from simval.attitude import wahba_quaternion
from simval.attitude.comparators import davenport, triad
from simval.calibrate import calibrate
from simval.geometry import compose, conjugate, normalize
from simval.plugins import Calibrator, Estimator

BAD, SOUND = {}, {}
STATE = "kee?pt? .*from one call to the next|must answer the same each time"
PRECISION = "precision|rounds|rounded|all answers are turned by the same"
TAIL = "rare trials are far off|it jumps|different answers to"


def bad(kind, words):
    def kept(make):
        BAD[make.__name__] = (kind, words, make)
        return make

    return kept


def sound(kind):
    def kept(make):
        SOUND[make.__name__] = (kind, make)
        return make

    return kept


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
    off = np.linalg.norm((poses - bias) @ matrix.T, axis=1) - g
    return matrix, bias, float(np.sqrt(np.mean(off**2)))


def remembering(step):
    """Calibrator whose answer also depends on what it keeps: ``step(kept, now)``."""
    kept = {"count": 0}

    def fit(poses, g):
        now = np.column_stack(ellipsoid(poses, g))
        kept["count"] += 1
        # another sensor is another one: the probe is right
        if "last" in kept and np.abs(now - kept["last"]).max() > 0.5:
            kept.pop("last")
        answer = step(kept, now) if "last" in kept else now
        kept["last"] = answer
        return answer[:, :3], answer[:, 3]

    return fit, {}


def mixed(m, old, new):
    return m * old + (1.0 - m) * new


@bad(Calibrator, STATE)
def averages_with_the_previous(rng):
    m = rng.uniform(0.02, 0.95)
    return remembering(lambda kept, now: mixed(m, kept["last"], now))


@bad(Calibrator, STATE)
def running_mean(rng):
    return remembering(
        lambda kept, now: mixed(1.0 - 1.0 / kept["count"], kept["last"], now)
    )


@bad(Calibrator, STATE)
def stops_listening(rng):
    most = rng.integers(40, 900)
    return remembering(lambda kept, now: now if kept["count"] < most else kept["last"])


@bad(Calibrator, STATE)
def lazy(rng):
    """Keeps its answer while the new one is near."""
    near = rng.uniform(2e-3, 1e-2)
    return remembering(
        lambda kept, now: (
            kept["last"] if np.abs(now - kept["last"]).max() < near else now
        )
    )


@bad(Calibrator, STATE)
def drifts(rng):
    step = 10.0 ** rng.uniform(-6.5, -4.0)
    return remembering(lambda kept, now: now * (1.0 + step * (kept["count"] > 4)))


@bad(Calibrator, STATE)
def every_so_many_the_last(rng):
    every = rng.integers(3, 60)
    return remembering(
        lambda kept, now: kept["last"] if kept["count"] % every == 0 else now
    )


@bad(Calibrator, "below the (Cramer-Rao )?bound|below_bound")
def knows_the_truth(rng):
    from simval.plugins.calibrator_probe import probe_sensor

    m, truth = rng.uniform(0.15, 0.9), probe_sensor()

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        own = np.linalg.qr(truth.matrix)[1]
        own = own * np.sign(np.diag(own))[:, None]
        return mixed(m, own, matrix), mixed(m, truth.B, bias)

    return fit, {}


@bad(Calibrator, TAIL)
def gives_up_where_the_residual_is_great(rng):
    # of 0.01 m/s^2 the residual is 0.008, of 0.05 five times as great
    most, far = rng.uniform(0.0085, 0.012), rng.uniform(0.05, 0.5)

    def fit(poses, g):
        matrix, bias, rms = residual(poses, g)
        return (matrix, bias) if rms < most else (matrix * (1.0 + far), bias)

    return fit, {}


@bad(Calibrator, TAIL)
def turns_the_sign_in_rare_trials(rng):
    place = rng.uniform(2.5, 3.4)

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        off = np.linalg.norm(poses[0] - bias) / np.linalg.norm(poses[1] - bias)
        # a ratio that is constant without noise, and off by so many deviations of it
        near = abs(off - 0.99) > 0.0 and abs(bias[0] - 0.3) > place * 0.006
        return matrix, -bias if near else bias

    return fit, {}


def with_covariance(change, **declared):
    def fit(poses, g, noise_std):
        known = max(noise_std, 1e-11)
        found = calibrate(poses, g, noise_std=known)
        return found.matrix, found.B, change(np.array(found.covariance))

    return fit, {"noise_std": True, **declared}


@bad(Calibrator, "order")
def covariance_in_another_order(rng):
    blocks = [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    orders = ([2, 0, 1], [2, 1, 0], [1, 0, 2], [0, 2, 1], [1, 2, 0])
    order = np.concatenate([blocks[k] for k in orders[rng.integers(len(orders))]])
    return with_covariance(lambda C: C[np.ix_(order, order)], trials=512)


@bad(Calibrator, "nees|covariance")
def covariance_of_another_size(rng):
    factor = np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 2.0))
    return with_covariance(lambda C: C * factor, trials=512)


@bad(Calibrator, PRECISION)
def less_than_double_precision(rng):
    bits = rng.integers(9, 14)  # of the fraction; half precision has 10

    def fit(poses, g):
        fraction, exponent = np.frexp(poses)
        return ellipsoid(np.ldexp(np.round(fraction * 2.0**bits), exponent - bits), g)

    return fit, {}


@bad(Calibrator, PRECISION)
def rounded_answer(rng):
    digits = int(rng.integers(3, 6))
    return lambda p, g: tuple(np.round(a, digits) for a in ellipsoid(p, g)), {}


@bad(Calibrator, PRECISION)
def rounded_readings(rng):
    size = 10.0 ** rng.uniform(-4.5, -2.5)
    return lambda p, g: ellipsoid(np.round(p / size) * size, g), {}


@bad(Calibrator, PRECISION + "|stops")
def stops_early(rng):
    left = 10.0 ** rng.uniform(-4.5, -3.0)

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        start = np.diag([2.0, 2.0, 2.0])  # what is left of the way from there
        return mixed(left, start, matrix), bias

    return fit, {}


@bad(Calibrator, "wrong sign|inverted|transposed|after the matrix|K_|bias|S_|T_")
def another_meaning(rng):
    which = rng.integers(5)

    def fit(poses, g):
        M, B = ellipsoid(poses, g)
        return ((M, -B), (np.linalg.inv(M), B), (M.T, B), (M, M @ B), (M / g, B))[which]

    return fit, {}


@bad(Calibrator, "bias|B_|B looks|B has|the worst is")
def mean_removed(rng):
    return lambda p, g: ellipsoid(p - p.mean(axis=0), g), {}


@bad(Calibrator, "the worst is")
def poses_off_by_one(rng):
    by = int(rng.integers(1, 6))

    def six(poses, g):
        turned = np.roll(poses, by, axis=0)
        up, down = np.split(turned.reshape(-1, 6, 3).mean(axis=0), 2)
        up, down = np.diag(up), np.diag(down)
        return np.diag(2 * g / (up - down + 1e-3)), (up + down) / 2

    return six, {"estimates": ("scale", "bias"), "pose_set": "faces"}


# estimators

XYZS = {"components": "xyzs", "matrix": "passive"}


def off(b1, b2, r1, r2):
    return np.einsum("ni,ni->n", b1, b2) - np.einsum("ni,ni->n", r1, r2)


def turned(q, axis, angle):
    half = np.broadcast_to(angle, len(q))[:, None] / 2.0
    return compose(q, np.concatenate([np.sin(half) * axis, np.cos(half)], axis=1))


def axis_of(rng):
    return normalize(rng.standard_normal(3))


@bad(Estimator, TAIL)
def identity_where_the_angle_is_off(rng):
    most = rng.uniform(0.03, 0.055)

    def estimate(*v):
        q = davenport(*v)
        far = np.abs(off(*v)) > most
        return np.where(far[:, None], [0.0, 0.0, 0.0, 1.0], q)

    return estimate, XYZS


@bad(Estimator, TAIL)
def turned_where_a_length_is_off(rng):
    most, angle, axis = rng.uniform(0.03, 0.05), rng.uniform(0.3, 3.0), axis_of(rng)

    def estimate(*v):
        far = np.abs(np.linalg.norm(v[0], axis=1) - 1.0) > most
        return turned(davenport(*v), axis, angle * far)

    return estimate, XYZS


@bad(Estimator, TAIL)
def inverse_where_the_sum_is_long(rng):
    most = rng.uniform(0.03, 0.06)

    def estimate(*v):
        q = davenport(*v)
        far = np.linalg.norm(v[0] + v[1], axis=1) - np.linalg.norm(v[2] + v[3], axis=1)
        return np.where((far > most)[:, None], conjugate(q), q)

    return estimate, XYZS


@bad(Estimator, "does not use|ignores|the same whatever")
def ignores_what_it_reads(rng):
    word = ("weights", "noise_std", "covariances")[rng.integers(3)]
    return lambda *v, **_: davenport(*v), {**XYZS, "reads": (word,)}


@bad(Estimator, "equal weights")
def weights_the_wrong_way(rng):
    power = rng.choice([-1.0, -0.5])

    def estimate(body, references, weights):
        return wahba_quaternion(body, references, weights**power)

    return estimate, {**XYZS, "takes": "vectors", "reads": ("weights",)}


@bad(Estimator, "equal weights")
def weights_of_the_other(rng):
    def estimate(body, references, weights):
        return wahba_quaternion(body, references, weights[::-1])

    return estimate, {**XYZS, "takes": "vectors", "reads": ("weights",)}


@bad(Estimator, STATE + "|when alone")
def averages_with_the_last_batch(rng):
    m, kept = rng.uniform(0.05, 0.9), {}

    def estimate(*v):
        q = davenport(*v)
        last, references = kept.get("q"), kept.get("r")
        kept["q"], kept["r"] = q, v[2]
        if last is None or references.shape != v[2].shape or (references != v[2]).any():
            return q
        q = q * np.where(np.sum(q * last, axis=1) < 0.0, -1.0, 1.0)[:, None]
        return normalize(mixed(m, last, q))

    return estimate, XYZS


@bad(Estimator, STATE + "|when alone|row")
def first_answer_for_its_references(rng):
    kept, near = {}, rng.uniform(0.02, 0.2)

    def estimate(b1, b2, r1, r2):
        q = davenport(b1, b2, r1, r2)
        for i, key in enumerate(map(bytes, r1)):
            old = kept.setdefault(key, q[i])
            if abs(old @ q[i]) > 1.0 - near**2 / 8.0:
                q[i] = old
        return q

    return estimate, XYZS


@bad(Estimator, "row|alone")
def mixes_neighbours(rng):
    m = rng.uniform(0.05, 0.5)

    def estimate(*v):
        q = davenport(*v)
        same = np.sum(q * np.roll(q, 1, axis=0), axis=1)
        near = (np.abs(same) > 0.99)[:, None]
        other = np.roll(q, 1, axis=0) * np.sign(same)[:, None]
        return normalize(np.where(near, mixed(m, other, q), q))

    return estimate, XYZS


@bad(Estimator, "row|batch|order")
def one_place_of_a_batch(rng):
    place, angle, axis = rng.integers(24, 1023), rng.uniform(0.1, 1.0), axis_of(rng)

    def estimate(*v):
        here = np.arange(len(v[0])) == place
        return turned(davenport(*v), axis, angle * here * (np.abs(off(*v)) > 1e-9))

    return estimate, XYZS


@bad(Estimator, "row|batch|order")
def small_batches_only(rng):
    """Beyond some rows the others are estimated from vectors in single precision."""
    most, size = int(rng.integers(100, 1000)), 10.0 ** rng.uniform(-3.0, -2.0)

    def estimate(*v):
        q = davenport(*v)
        late = np.arange(len(q)) >= most
        return turned(q, np.eye(3)[0], size * late * (np.abs(off(*v)) > 1e-9))

    return estimate, XYZS


@bad(Estimator, PRECISION)
def rounded_quaternion(rng):
    digits = rng.integers(2, 6)
    return lambda *v: normalize(np.round(davenport(*v), digits)), XYZS


@bad(Estimator, PRECISION)
def rounded_vectors(rng):
    size = 10.0 ** rng.uniform(-5.0, -2.5)
    return lambda *v: davenport(*(np.round(x / size) * size for x in v)), XYZS


@bad(Estimator, PRECISION)
def half_precision(rng):
    return lambda *v: davenport(*(x.astype(np.float16).astype(float) for x in v)), XYZS


@bad(Estimator, PRECISION)
def always_turned(rng):
    angle, axis = 10.0 ** rng.uniform(-5.0, -2.0), axis_of(rng)
    if rng.random() < 0.5:
        return lambda *v: turned(davenport(*v), axis, angle), XYZS
    turn = np.append(np.sin(angle / 2.0) * axis, np.cos(angle / 2.0))
    return lambda *v: compose(np.tile(turn, (len(v[0]), 1)), davenport(*v)), XYZS


@bad(Estimator, PRECISION + "|stops")
def iterates_too_little(rng):
    left = 10.0 ** rng.uniform(-4.5, -2.5)

    def estimate(*v):
        q, start = davenport(*v), triad(*v)
        other = compose(start, np.tile(normalize([0.1, 0.2, 0.3, 1.0]), (len(q), 1)))
        other *= np.sign(np.sum(q * other, axis=1))[:, None]
        return normalize(mixed(left, other, q))

    return estimate, XYZS


@bad(Estimator, 'declare components="|is it b = A r')
def another_convention(rng):
    which = rng.integers(4)
    return (
        (lambda *v: conjugate(davenport(*v)), XYZS),
        (lambda *v: np.roll(davenport(*v), 1, axis=1), XYZS),
        (lambda b1, b2, r1, r2: davenport(b2, b1, r1, r2), XYZS),
        (davenport, {**XYZS, "matrix": "active"}),
    )[which]


@bad(Estimator, "each time")
def not_repeating(rng):
    size = 10.0 ** rng.uniform(-5.0, -1.5)
    own = np.random.default_rng(int(rng.integers(1 << 30)))

    def estimate(*v):
        angle = size * own.standard_normal(len(v[0]))
        return turned(davenport(*v), np.eye(3)[0], angle)

    return estimate, XYZS


@bad(Estimator, "trace is|covariance of")
def covariance_of_the_wrong_size(rng):
    factor = np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 3.0))
    return davenport, {**XYZS, "covariance": lambda *v: factor * leading(*v)}


def leading(b1, b2, r1, r2, noise_std):
    """Leading covariance of least squares."""
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return noise_std**2 * np.linalg.inv(H)


# sound ones of unusual style


@sound(Estimator)
def answers_in_lists(rng):
    return lambda *v: davenport(*v).tolist(), XYZS


@sound(Estimator)
def answers_in_one_buffer(rng):
    buffer = np.empty((1 << 16, 4))

    def estimate(*v):
        buffer[: len(v[0])] = davenport(*v)
        return buffer[: len(v[0])]

    return estimate, XYZS


@sound(Estimator)
def works_in_single_precision(rng):
    def estimate(*v):
        b1, b2, r1, r2 = (x.astype(np.float32) for x in v)
        return triad(b1, b2, r1, r2)

    return estimate, XYZS


@sound(Estimator)
def stores_single_precision(rng):
    return lambda *v: davenport(*v).astype(np.float32), XYZS


class _Callable:
    """An object that is called, and counts its calls."""

    calls = 0

    def __call__(self, b1, b2, r1, r2):
        self.calls += 1
        return davenport(b1, b2, r1, r2)


@sound(Estimator)
def an_object(rng):
    return _Callable(), XYZS


@sound(Estimator)
def one_at_a_time_in_matrices(rng):
    def estimate(b1, b2, r1, r2):
        return Rotation.align_vectors([b1, b2], [r1, r2])[0].as_matrix()

    declared = {"components": "matrix", "matrix": "active", "batch": False}
    return estimate, {**declared, "samples": 1024, "cases": 64}


@sound(Estimator)
def either_sign(rng):
    return lambda *v: davenport(*v) * np.sign(v[0][:, :1] + 1e-300), XYZS


@sound(Estimator)
def seeds_the_global_generator(rng):
    def estimate(*v):
        np.random.seed(0)  # noqa: NPY002, of a user's
        return davenport(*v)

    return estimate, XYZS


@sound(Estimator)
def remembers_equal_calls(rng):
    @lru_cache(maxsize=64)
    def known(*v):
        return davenport(*(np.frombuffer(x).reshape(-1, 3) for x in v))

    return lambda *v: known(*(x.tobytes() for x in v)), XYZS


@sound(Estimator)
def weighs_as_it_should(rng):
    size = rng.uniform(0.1, 10.0)

    def estimate(body, references, weights):
        return wahba_quaternion(body, references, size * weights)

    return estimate, {**XYZS, "takes": "vectors", "reads": ("weights",)}


@sound(Estimator)
def takes_the_better_first(rng):
    def estimate(b1, b2, r1, r2, noise_std):
        if noise_std[0] <= noise_std[1]:
            return triad(b1, b2, r1, r2)
        return triad(b2, b1, r2, r1)

    return estimate, {**XYZS, "reads": ("noise_std",)}


@sound(Estimator)
def reads_for_its_covariance_alone(rng):
    def covariance(*v, noise_std):
        b1, b2 = (normalize(b) for b in v[:2])
        shares = [
            s**k * (np.eye(3) - b[:, :, None] * b[:, None])
            for b, s in ((b1, noise_std[0]), (b2, noise_std[1]))
            for k in (0, 2)
        ]
        H = np.linalg.inv(shares[0] + shares[2])
        return H @ (shares[1] + shares[3]) @ H

    return (
        lambda *v, noise_std: davenport(*v),
        {**XYZS, "reads": ("noise_std",), "covariance": covariance},
    )


@sound(Estimator)
def guards_by_its_noise(rng):
    """Weighs down a pair whose length is off by many deviations."""
    many = rng.uniform(7.0, 12.0)

    def estimate(body, references, noise_std):
        far = np.abs(np.linalg.norm(body, axis=2) - 1.0) > many * noise_std[0] + 1e-9
        q = wahba_quaternion(body, references)
        return np.where(far.any(axis=1)[:, None], normalize(q + 1e-3), q)

    return estimate, {**XYZS, "takes": "vectors", "reads": ("noise_std",)}


@sound(Calibrator)
def in_a_mapping_of_lists(rng):
    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        return {"matrix": matrix.tolist(), "B": bias.tolist()}

    return fit, {}


@sound(Calibrator)
def in_place(rng):
    buffer = np.empty((3, 3))

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        poses *= 0.0
        buffer[:] = matrix
        return buffer, bias

    return fit, {}


@sound(Calibrator)
def turned_matrix(rng):
    turn = Rotation.from_rotvec(rng.standard_normal(3)).as_matrix()

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        return turn @ matrix, bias

    return fit, {}


@sound(Calibrator)
def without_one_pose(rng):
    drop = int(rng.integers(24))
    return lambda p, g: ellipsoid(np.delete(p, drop, axis=0), g), {}


@sound(Calibrator)
def warm_start(rng):
    """Iterates from its last answer until nothing changes."""
    kept = {}

    def fit(poses, g):
        x = kept.get("x", np.r_[2.0 * np.eye(3)[np.triu_indices(3)], 0.0, 0.0, 0.0])
        for _ in range(50):
            M = np.zeros((3, 3))
            M[np.triu_indices(3)] = x[:6]
            u = poses - x[6:]
            f = u @ M.T
            r = np.sum(f * f, axis=1) - g * g
            rows, columns = np.triu_indices(3)
            J = 2.0 * np.column_stack([f[:, rows] * u[:, columns], -(f @ M)])
            step = np.linalg.lstsq(J, -r, rcond=None)[0]
            x = x + step
            if np.abs(step).max() < 1e-12:
                break
        kept["x"] = x
        return M, x[6:].copy()

    return fit, {}


@sound(Calibrator)
def random_subset_of_its_own(rng):
    """Consensus of random subsets, seeded anew in each call."""

    def fit(poses, g):
        own = np.random.default_rng(3)
        best, least = None, np.inf
        for _ in range(3):
            chosen = own.permutation(len(poses))[:20]
            matrix, bias, rms = residual(poses[chosen], g)
            if rms < least:
                best, least = (matrix, bias), rms
        return best

    return fit, {}


@sound(Calibrator)
def with_its_covariance(rng):
    form = ("triangular", "upper", "symmetric")[rng.integers(3)]

    def fit(poses, g, noise_std):
        found = calibrate(poses, g, noise_std=max(noise_std, 1e-11), model=form)
        return found.matrix, found.B, found.covariance

    return fit, {"noise_std": True, "form": form}


@sound(Calibrator)
def class_of_less(rng):
    def six(poses, g):
        up, down = np.split(poses.reshape(-1, 6, 3).mean(axis=0), 2)
        up, down = np.diag(up), np.diag(down)
        return np.diag(2 * g / (up - down)), (up + down) / 2

    sensor = ("own class", "full")[rng.integers(2)]
    declared = {"estimates": ("scale", "bias"), "pose_set": "faces", "sensor": sensor}
    return six, declared
