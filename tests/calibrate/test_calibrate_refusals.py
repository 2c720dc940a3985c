"""Pose sets and arguments that are refused: which, where, and what to do."""

import numpy as np
import pytest
from rounding import EPS
from true_sensor import MODEL, G

from simval.calibrate import calibrate
from simval.errors import GeometryError, InputError, RefusedError
from simval.poses import cube_corners, cube_edges, cube_faces, fibonacci_sphere


def poses_of(directions, sigma=0.0, seed=0):
    rng = np.random.default_rng(seed)
    clean = MODEL.distort(G * np.asarray(directions), rng)
    return clean + sigma * rng.standard_normal(clean.shape)


def cap(degrees, count=40):
    low = np.cos(np.radians(degrees))
    z = 1 - (1 - low) * (np.arange(count) + 0.5) / count
    angle, radius = np.pi * (1 + 5**0.5) * np.arange(count), np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def test_fewer_than_nine():
    with pytest.raises(
        GeometryError, match=r"8 pose\(s\) given; nine parameters need 9"
    ):
        calibrate(poses_of(fibonacci_sphere(8)), G)


def test_six_faces_are_named_with_the_pose_that_helps():
    tripled = np.tile(cube_faces(), (3, 1))
    with pytest.raises(GeometryError) as caught:
        calibrate(poses_of(tripled), G)  # that poses repeat matters less
    words = str(caught.value)
    assert "the six faces of a cube" in words
    assert "rank 6 of 9" in words
    assert "0.58, 0.58, 0.58" in words  # a corner
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("sigma", [1e-6, 1e-4, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("seed", range(8))
def test_six_faces_hidden_by_noise_are_still_refused(sigma, seed):
    """Noise makes the rank nine; what it would report is made of noise."""
    tripled = np.tile(cube_faces(), (3, 1))
    for noise_std in (None, sigma):
        with pytest.raises(RefusedError, match="the six faces of a cube"):
            calibrate(poses_of(tripled, sigma, seed), G, noise_std=noise_std)


def test_corners_alone():
    corners = np.concatenate([cube_corners(), cube_corners()[:4]])
    with pytest.raises(GeometryError, match="rank 7 of 9"):
        calibrate(poses_of(corners), G, repeats=True)


T = np.arange(12.0)
CIRCLE = np.stack([np.cos(T), np.sin(T), 0 * T], axis=-1)


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


@pytest.mark.parametrize("directions", [cube_edges(), cap(90), fibonacci_sphere(9)])
def test_sets_that_are_enough(directions):
    fit = calibrate(poses_of(directions), G)
    # without noise: eps times the condition, 1e2, over g
    np.testing.assert_allclose(fit.parameters, MODEL.parameters, rtol=0, atol=1e3 * EPS)


def test_a_small_cap_is_ill_conditioned():
    """A tilt under 20 degrees: sd(B) is a thousand sigma."""
    with pytest.raises(
        GeometryError,
        match=r"ill-conditioned: 1.77e\+03, at most 1000.*too little of the sphere",
    ):
        calibrate(poses_of(cap(20)), G)
    fit = calibrate(poses_of(cap(20)), G, condition_limit=1e6)
    # six faces and three poses nearby: far worse than the 1e2 of a sphere
    assert fit.condition > 1e3
    # eps times the condition, 1.8e3, squared: the moments are used
    np.testing.assert_allclose(
        fit.parameters, MODEL.parameters, rtol=0, atol=10 * EPS * fit.condition**2
    )


@pytest.mark.ci
def test_a_cap_that_noise_fills_is_never_a_success():
    """Tilts under 40 degrees at 20 mm/s^2: noise bends the cap as much as its shape."""
    clean = poses_of(cap(40))
    noise = np.random.default_rng(1).standard_normal((300, *clean.shape))
    fit = calibrate(clean + 0.02 * noise, G)
    assert not fit.converged.any()
    assert calibrate(clean + 0.002 * noise, G).converged.all()  # that can be done


def test_one_place_only():
    same = poses_of(np.tile([0.0, 0.0, 1.0], (12, 1)))
    with pytest.raises(GeometryError, match="all 12 poses read the same"):
        calibrate(same, G)
    with pytest.raises(RefusedError):
        calibrate(same + 1e-3 * np.random.default_rng(0).normal(size=same.shape), G)


def test_non_finite_says_where():
    poses = poses_of(fibonacci_sphere(12))
    poses[5, 2] = np.inf
    with pytest.raises(InputError, match=r"\(inf\) in pose 5, axis z"):
        calibrate(poses, G)


def test_duplicates_say_which():
    poses = poses_of(fibonacci_sphere(12))
    poses[9] = poses[4]
    with pytest.raises(RefusedError, match="poses 4 and 9 are identical"):
        calibrate(poses, G)
    assert calibrate(poses, G, repeats=True).status == "converged"
    batch = np.stack([poses_of(fibonacci_sphere(12)), poses])
    assert calibrate(batch, G).status[1] == "refused: duplicate poses"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_saturation_says_where(sign):
    poses = sign * poses_of(fibonacci_sphere(12))
    worst, axis = np.unravel_index(np.argmax(np.abs(poses)), poses.shape)
    limit = np.abs(poses[worst, axis])
    words = f"pose {worst} reads .* on axis {'xyz'[axis]}, at or beyond full scale"
    with pytest.raises(RefusedError, match=words):
        calibrate(poses, G, full_scale=limit)
    assert calibrate(poses, G, full_scale=limit * 1.001).status == "converged"


def test_points_on_no_ellipsoid():
    t = np.linspace(0.5, 6.0, 40)
    poses = np.stack([np.cosh(t / 3) * np.cos(t), np.cosh(t / 3) * np.sin(t), t**2], -1)
    with pytest.raises(RefusedError):
        calibrate(poses, G)


def test_random_numbers_are_not_a_calibration():
    """Never success with garbage: uniform noise in a cube is refused or poor, and
    its residual says so."""
    rng = np.random.default_rng(0)
    batch = rng.uniform(-1, 1, (300, 12, 3))
    fit = calibrate(batch, G)
    taken = fit.converged
    # seen: not one of the 300 is taken; one that is has a residual of 1/20 of g or more
    assert taken.mean() < 0.2
    assert np.all(fit.rms[taken] > 0.05 * G)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"loss": "huber", "residual": "norm"}, "a robust loss goes with"),
        ({"residual": "adjusted"}, "`noise_std` is not given"),
        ({"noise_std": [0.1, 0.2]}, "one for each of the 12 poses"),
    ],
)
def test_options_that_do_not_go_together(options, words):
    """What is wrong by itself is `test_public_faces`'s."""
    with pytest.raises(InputError, match=words):
        calibrate(poses_of(fibonacci_sphere(12), 1e-3), G, **options)


def test_a_batch_of_refused_trials_has_no_numbers():
    batch = np.stack([poses_of(np.tile(cube_faces(), (2, 1)))] * 3)
    fit = calibrate(batch, G, repeats=True)
    assert all(s.startswith("refused") for s in fit.status)
    for name in ("parameters", "covariance", "cost", "rms"):
        assert np.isnan(getattr(fit, name)).all()
    assert np.isinf(fit.condition).all()


@pytest.mark.parametrize("unit", [1e-60, 1e-20, 1e20, 1e58])
def test_any_unit_that_floats_can_square(unit):
    poses = poses_of(fibonacci_sphere(12), 1e-3) * unit
    fit = calibrate(poses, G)
    assert fit.status == "converged"
    assert np.isfinite(fit.covariance).all()
    # the fit works in scaled numbers: only the scaling itself rounds
    np.testing.assert_allclose(fit.K * unit, calibrate(poses / unit, G).K, rtol=8 * EPS)


@pytest.mark.parametrize("unit", [1e-320, 1e-200, 1e70, 1e200, 1e308])
def test_units_out_of_range_are_refused_without_a_warning(unit):
    poses = poses_of(fibonacci_sphere(12), 1e-3) / 20 * unit
    with pytest.raises((InputError, RefusedError)):
        calibrate(poses, G)


def test_a_huge_offset_is_only_a_loss_of_digits():
    poses = poses_of(fibonacci_sphere(12)) + 1e9
    fit = calibrate(poses, G)
    # readings of 1e9 are known to 1e-7
    np.testing.assert_allclose(fit.K, MODEL.K, rtol=1e-6)
