"""Pose sets that are no calibration: refused in words, and good ones that are not.

A family draws rank-deficient directions (in exact arithmetic, before noise); of its
sets at most one in a thousand may end as converged with a scale or bias that is wrong
by a tenth. Good families must lose none.
"""

import numpy as np
import pytest
from rounding import EPS
from true_sensor import MODEL, G

from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import normalize
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.solver import inverse_root
from simval.imu.sensor import AccelerometerModel
from simval.poses import (
    cube_corners,
    cube_edges,
    cube_faces,
    fibonacci_sphere,
    random_directions,
)

EACH = 20  # noisy sets of one geometry


def poses_of(directions, sigma=0.0, seed=0):
    rng = np.random.default_rng(seed)
    clean = MODEL.distort(G * np.asarray(directions), rng)
    return clean + sigma * rng.standard_normal(clean.shape)


def cap(degrees, count=40):
    low = np.cos(np.radians(degrees))
    z = 1 - (1 - low) * (np.arange(count) + 0.5) / count
    angle, radius = np.pi * (1 + 5**0.5) * np.arange(count), np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


T = np.arange(12.0)
CIRCLE = np.stack([np.cos(T), np.sin(T), 0 * T], axis=-1)
TWELVE = poses_of(fibonacci_sphere(12))
POSE, AXIS = np.unravel_index(np.argmax(np.abs(TWELVE)), TWELVE.shape)


def changed(*place, value):
    """Twelve even poses, one of them or one reading another."""
    poses = TWELVE.copy()
    poses[place] = value
    return poses


REFUSED = {
    "eight": (poses_of(fibonacci_sphere(8)), {}, r"8 poses .* parameters need 9"),
    "six faces": (
        poses_of(np.tile(cube_faces(), (3, 1))), {},
        r"(?s)six faces of a cube.*rank 6 of 9.*0\.5[78], -?0\.5[78], -?0\.5[78]",
    ),  # a corner, within a degree
    "corners": (
        poses_of(np.concatenate([cube_corners(), cube_corners()[:4]])),
        {"repeats": True}, "rank 7 of 9",
    ),
    "cap": (
        poses_of(cap(20)), {},
        r"ill-conditioned: 1.77e\+03, at most 1000.*too little of the sphere",
    ),  # a tilt under 20 degrees: sd(B) is a thousand sigma
    "one place": (poses_of(np.tile([0.0, 0.0, 1.0], (12, 1))), {}, "12 poses read the"),
    "infinite": (changed(5, 2, value=np.inf), {}, r"\(inf\) in pose 5, axis z"),
    "duplicate": (changed(9, value=TWELVE[4]), {}, "poses 4 and 9 are identical"),
    "robust norm": (TWELVE, {"loss": "huber", "residual": "norm"}, "robust loss goes"),
    "adjusted": (TWELVE, {"residual": "adjusted"}, "`noise_std` is missing"),
    "two noises": (TWELVE, {"noise_std": [0.1, 0.2]}, "one for each of the 12 poses"),
    "full scale": (
        -TWELVE, {"full_scale": np.abs(TWELVE).max()},
        f"pose {POSE} reads .* on axis {'xyz'[AXIS]}, at or beyond full scale",
    ),
    "no noise": (
        TWELVE, {"residual": "weighted", "noise_std": np.arange(12.0)},
        "0 for 1 of 12 poses, .*give every pose",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_set_that_is_no_calibration_is_refused_in_words(name):
    poses, options, words = REFUSED[name]
    with pytest.raises((InputError, RefusedError), match=words):
        calibrate(poses, G, **options)


@pytest.mark.parametrize(
    ("directions", "rank"),
    [
        (np.concatenate([cube_faces(), cube_faces()[:3]]), 6),
        (CIRCLE, 5),  # x2, xy, y2, x, y
        (np.concatenate([CIRCLE, CIRCLE[:, [0, 2, 1]]]), 8),  # yz is never seen
        (np.tile([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], (6, 1)), 2),
    ],
)
@pytest.mark.parametrize("counts", [1.0, 400.0])
def test_ranks_are_right_in_any_unit(directions, rank, counts):
    raw = poses_of(directions) * counts + (32768.0 if counts > 1.0 else 0.0)
    with pytest.raises(GeometryError, match=f"rank {rank} of 9"):
        calibrate(raw, G)
    # of a batch such a trial has no numbers
    fit = calibrate(np.stack([raw] * 2), G, repeats=True)
    assert all(status.startswith("refused") for status in fit.status)
    for name in ("parameters", "covariance", "cost", "rms"):
        assert np.isnan(getattr(fit, name)).all()
    assert np.isinf(fit.condition).all()


def test_what_the_caller_may_allow():
    fit = calibrate(poses_of(cap(20)), G, condition_limit=1e6)
    assert fit.condition > 1e3
    # eps times the condition, 1.8e3, squared: the moments are used
    room = 10 * EPS * fit.condition**2
    np.testing.assert_allclose(fit.parameters, MODEL.parameters, rtol=0, atol=room)
    twice = REFUSED["duplicate"][0]
    assert calibrate(twice, G, repeats=True).status == "converged"
    beyond = 1.001 * np.abs(TWELVE).max()
    assert calibrate(-TWELVE, G, full_scale=beyond).status == "converged"
    batch = calibrate(np.stack([TWELVE, twice]), G)
    assert list(batch.status) == ["converged", "refused: duplicate poses"]


# families


def rotation(rng):
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.diag(r))


def circle(count, height, rng):
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    radius = np.sqrt(1.0 - height * height)
    z = np.full(count, height)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def two_circles(count, rng, turn):
    half = rng.integers(4, count - 3)
    a, b = rng.uniform(-0.85, 0.85, 2)
    return np.concatenate([circle(half, a, rng), circle(count - half, b, rng) @ turn])


def repeated(count, rng):
    some = random_directions(int(rng.integers(3, 9)), rng)
    return some[np.arange(count) % len(some)]


def by_hand(count, rng):
    """Faces, edges and corners, each held within some 10 degrees."""
    wanted = np.concatenate([cube_faces(), cube_edges(), cube_corners()])
    return normalize(wanted + 0.17 * rng.standard_normal(wanted.shape))


DEFICIENT = {
    "one circle": lambda n, rng: circle(n, rng.uniform(-0.9, 0.9), rng),
    "parallel circles": lambda n, rng: two_circles(n, rng, np.eye(3)),
    "crossing circles": lambda n, rng: two_circles(n, rng, rotation(rng)),
    "repeated": repeated,
}  # fmt: skip
GOOD = {
    "even": lambda n, rng: fibonacci_sphere(n),
    "scattered": lambda n, rng: random_directions(max(n, 12), rng),
    "faces and edges": lambda n, rng: np.concatenate([cube_faces(), cube_edges()]),
    "by hand": by_hand,
}


def random_sensor(rng):
    """Axes within 5 %, or within a factor 4; or 417 counts for each m/s^2."""
    kind = rng.integers(3)
    scale, bias = rng.uniform(0.95, 1.05, 3), rng.uniform(-0.3, 0.3, 3)
    if kind == 1:
        scale, bias = 2.0 ** rng.uniform(-1.0, 1.0, 3), 10.0 * bias
    if kind == 2:
        scale, bias = scale / 417.0, 32768.0 + 2000.0 * bias
    values = np.concatenate([rng.uniform(-0.05, 0.05, 3), scale, bias])
    return AccelerometerModel.from_parameters(values)


def random_options(sigma, rng):
    options = {"model": str(rng.choice(["triangular", "upper", "symmetric"]))}
    options["covariance"] = bool(rng.random() < 0.5)
    residuals = ["squared", "norm", "sampson", "weighted"]
    if rng.random() < 0.5:
        options["noise_std"] = sigma
        residuals.append("adjusted")
    options["residual"] = str(rng.choice(residuals))
    if options["residual"] == "squared" and rng.random() < 0.3:
        options["loss"] = str(rng.choice(["huber", "soft_l1", "cauchy"]))
    return options


def wrong_and_refused(family, sets, seed, counts=(9, 60), noise=(1e-5, 0.3)):
    """Sets accepted that are wrong by a tenth, and sets that are not accepted."""
    rng = np.random.default_rng(seed)
    wrong = refused = 0
    for _ in range(sets // EACH):
        sensor = random_sensor(rng)
        force = G * family(int(rng.integers(counts[0], counts[1] + 1)), rng)
        clean = sensor.distort(force @ rotation(rng), rng)
        sigma = np.exp(rng.uniform(*np.log(noise))) / np.cbrt(np.prod(sensor.K))
        batch = clean + sigma * rng.standard_normal((EACH, *clean.shape))
        fit = calibrate(batch, G, **random_options(sigma, rng))
        truth = sensor.matrix
        stretch = np.linalg.svd(
            fit.matrix[fit.converged] @ np.linalg.inv(truth), compute_uv=False
        )
        bias = (fit.B[fit.converged] - sensor.B) @ truth.T / G
        error = np.maximum(
            np.abs(stretch - 1.0).max(axis=-1), np.linalg.norm(bias, axis=-1)
        )
        wrong += int(np.sum(~(error < 0.1)))
        refused += int(np.sum(~fit.converged))
    return wrong, refused


@pytest.mark.parametrize(
    "sets",
    [
        pytest.param(40, marks=pytest.mark.ci),
        pytest.param(1000, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("family", DEFICIENT)
def test_rank_deficient_poses_are_refused(family, sets):
    """One in seven of the circles was accepted; at most one in a thousand may be. The
    rate found is below 1e-4, a second in 1000 has a chance under 0.5 % a family."""
    counts = (12, 24) if sets == 40 else (9, 60)  # few poses are quick
    wrong, refused = wrong_and_refused(DEFICIENT[family], sets, 1, counts)
    assert wrong <= sets // 1000
    assert refused >= 0.9 * sets


@pytest.mark.parametrize("sets", [100, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("family", GOOD)
def test_good_sets_are_kept(family, sets):
    """At noise up to 0.03 m/s^2 for each mean, and none is wrong. `scattered` has sets
    of 12 that leave an error bar of a tenth by themselves: 1 in 500 is allowed."""
    wrong, refused = wrong_and_refused(GOOD[family], sets, 3, noise=(1e-5, 0.03))
    assert wrong == 0
    assert refused <= (2 if family == "scattered" and sets > 100 else 0)


def test_a_matrix_singular_within_rounding_harms_no_neighbour():
    rows = np.random.default_rng(1).integers(-3, 4, (2000, 6, 6)).astype(float)
    rows[::2, 5] = rows[::2, :5].sum(axis=1)
    stack = rows.mT @ rows
    stack[1::4] *= -1.0  # not positive, with pivots of the same relative size
    root, pivot = inverse_root(stack)
    sound = np.abs(np.linalg.det(rows)) > 0.5  # a whole number
    sound[1::4] = False
    assert np.isfinite(root[sound]).all()
    assert np.all(pivot[~sound] < 1e-9)
    alone = np.concatenate([inverse_root(N[None])[0] for N in stack])
    np.testing.assert_array_equal(root, alone)
    residual = stack @ (root.mT @ root) - np.eye(6)
    assert np.abs(residual[sound]).max() < 1e-6


def test_sets_that_only_rounding_tells_from_singular_ones_warn_of_nothing():
    # in about one of 1000 rounding leaves an inverse that is not positive
    rng = np.random.default_rng(3)
    z = 0.4 * np.where(rng.random((8000, 9)) < 0.5, 1.0, -1.0)
    angle = rng.uniform(0.0, 2.0 * np.pi, z.shape)
    circles = np.stack([np.cos(angle), np.sin(angle), z / np.sqrt(1 - z * z)], axis=-1)
    near = normalize(circles + 1e-8 * rng.standard_normal(circles.shape))
    assert not np.any(calibrate(near, G).status == "converged")


def test_axes_of_very_different_gains_are_no_second_quadric():
    gains = np.array([1e-5, 1.0, 1e5])
    sets = np.stack([poses_of(fibonacci_sphere(12), 1e-3, k) for k in range(20)])
    fit, skewed = calibrate(sets, G), calibrate(sets * gains, G)
    assert np.all(fit.status == "converged")
    assert np.all(skewed.status == "converged")
    biases = fit.parameters[:, 6:] * gains
    np.testing.assert_allclose(skewed.parameters[:, 6:], biases, rtol=1e-6)


def test_a_noise_stated_too_low_hides_nothing():
    rng = np.random.default_rng(4)
    poses = G * circle(16, 0.3, rng) + 0.01 * rng.standard_normal((200, 16, 3))
    assert not calibrate(poses, G, noise_std=1e-6).converged.any()
    poses = G * DEFICIENT["parallel circles"](24, rng) + 0.003 * rng.standard_normal(
        (24, 3)
    )
    words = r"noise of 0\.00\d+ raw units .* second quadric .*add poses between them"
    with pytest.raises(GeometryError, match=words):
        calibrate(poses, G, condition_limit=1e9)


def test_a_second_quadric_through_two_circles_is_seen_whatever_the_condition():
    """One quadric more than the ellipsoid fits them: both roots are below the noise."""
    rng = np.random.default_rng(8)
    endings = set()
    for _ in range(10):
        poses = G * DEFICIENT["crossing circles"](24, rng)
        sets = poses + 1e-3 * rng.standard_normal((20, 24, 3))
        fit = calibrate(sets, G, noise_std=1e-3, condition_limit=1e9)
        endings |= set(fit.status.tolist())
    rank = "refused: rank below nine within the noise"
    assert endings == {rank, "refused: not an ellipsoid"}


def test_nine_poses_need_shape_or_a_known_noise():
    """Nothing is left over to find the noise: only geometry far above any noise, or a
    noise that is stated, makes nine poses an answer."""
    rng = np.random.default_rng(5)
    thin = normalize(fibonacci_sphere(9) * [1.0, 1.0, 0.1])
    thin = G * thin + 1e-4 * rng.standard_normal((9, 3))
    with pytest.raises(GeometryError, match=r"0 degree.s. of freedom .* `noise_std`"):
        calibrate(thin, G)
    assert calibrate(thin, G, noise_std=1e-4).status == "converged"


def test_error_bars_that_are_too_wide():
    rng = np.random.default_rng(7)
    sets = G * fibonacci_sphere(12) + 0.6 * rng.standard_normal((40, 12, 3))
    wide = calibrate(sets, G, noise_std=0.6).status == "refused: error bars too wide"
    assert wide.any()
    with pytest.raises(RefusedError, match=r"uncertain by .* percent along some"):
        calibrate(sets[np.flatnonzero(wide)[0]], G, noise_std=0.6)
