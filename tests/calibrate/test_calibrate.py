"""The solver: recovery, agreement of forms and methods, batches, stop rules."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from imu_tk import imu_tk_jacobian, imu_tk_residual
from rounding import EPS
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from true_sensor import MODEL, PARAMETERS, G

from simval.calibrate import calibrate
from simval.calibrate.residuals import RESIDUALS, unbiased_moment_matrix
from simval.calibrate.solver import METHODS
from simval.errors import ConvergenceError
from simval.poses import fibonacci_sphere, random_directions
from simval.sensor import MODELS, AccelerometerModel, convert

FIELDS = ("parameters", "covariance", "cost", "condition", "rms", "chi2_per_dof")


def noisy(trials, poses, sigma, seed=0):
    clean = MODEL.distort(G * fibonacci_sphere(poses), np.random.default_rng(0))
    noise = np.random.default_rng(seed).standard_normal((trials, poses, 3))
    return clean + sigma * noise


@pytest.mark.parametrize("residual", RESIDUALS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("model", MODELS)
def test_noise_free_recovery(model, method, residual):
    poses = noisy(1, 40, 0.0)[0]
    noise = 0.0 if residual == "adjusted" else None
    fit = calibrate(poses, G, model, method, residual, noise)
    truth, _ = convert(PARAMETERS, None, source="triangular", target=model)
    # a backward-stable solution of a problem of condition 2: some tens of roundings,
    # of readings of some 10 m/s^2
    np.testing.assert_allclose(fit.parameters, truth, rtol=0, atol=100 * EPS * G)
    assert fit.status == "converged"
    assert fit.rms < 10 * EPS * G


@pytest.mark.parametrize("residual", RESIDUALS)
def test_forms_and_methods_reach_one_ellipsoid(residual):
    """Gauss-Newton, LM and Newton in three forms: nine routes to one minimum."""
    poses = noisy(1, 25, 0.05, seed=1)[0]
    grams, biases = [], []
    for model in MODELS:
        for method in METHODS:
            fit = calibrate(poses, G, model, method, residual, 0.05)
            assert fit.status == "converged"
            grams.append(fit.matrix.T @ fit.matrix)
            biases.append(fit.B)
    # each stops within 1e-12 of its own fixed point, in units of g and K
    assert np.ptp(grams, axis=0).max() < 1e-11
    assert np.ptp(biases, axis=0).max() < 1e-11 * G


@pytest.mark.ci
@pytest.mark.parametrize("residual", ["squared", "norm", "sampson"])
def test_against_scipy_least_squares(residual):
    """scipy minimises the residual as defined, with its own solver, from the truth."""
    poses = noisy(20, 40, 0.05, seed=2)
    ours = calibrate(poses, G, residual=residual)

    def residuals(p, y):
        if residual == "squared":
            return imu_tk_residual(p, y, G)
        model = AccelerometerModel.from_parameters(p)
        h = model.correct(y)
        norm = np.linalg.norm(h, axis=1)
        if residual == "norm":
            return norm - G
        return (norm**2 - G**2) / (2 * np.linalg.norm(h @ model.matrix, axis=1))

    for y, found, cost in zip(poses, ours.parameters, ours.cost, strict=True):
        peer = least_squares(
            residuals, PARAMETERS, args=(y,), xtol=1e-15, ftol=1e-15, gtol=1e-15,
            method="lm",
        )  # fmt: skip
        # scipy's differences leave it 1e-8 of a standard deviation from the minimum
        np.testing.assert_allclose(found, peer.x, rtol=0, atol=1e-7)
        # at a minimum that shifts the cost by 1e-14 of itself
        np.testing.assert_allclose(cost, 2 * peer.cost, rtol=1e-10)
        assert cost <= 2 * peer.cost * (1 + 1e-12)


def test_squared_minimum_against_scipy_with_the_same_jacobian():
    """To 1e-9 relative: the same analytic Jacobian, scipy's own iteration."""
    poses = noisy(10, 40, 0.05, seed=3)
    ours = calibrate(poses, G)
    for y, found in zip(poses, ours.parameters, strict=True):
        peer = least_squares(
            lambda p, y=y: imu_tk_residual(p, y, G),
            PARAMETERS,
            jac=lambda p, y=y: imu_tk_jacobian(p, y),
            xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm",
        )  # fmt: skip
        np.testing.assert_allclose(found, peer.x, rtol=1e-9, atol=1e-11)


def test_adjusted_by_brute_force_over_the_noise():
    """Averaging v'Gv over added imaginary noise is the inverse of adding noise: the
    corrected moments of degree 4 are matched by a quadrature that shares no formula.

    With y -> y + i sigma t, t standard normal, E[p(y + i sigma t)] undoes the mean
    of a Gaussian for every polynomial p; Gauss-Hermite with three points for each
    axis is exact to degree five.
    """

    z = np.random.default_rng(4).normal(size=(1, 6, 3))
    sigma = 0.3
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)
    total = np.zeros((10, 10))
    for i, wi in zip(nodes, weights, strict=True):
        for j, wj in zip(nodes, weights, strict=True):
            for k, wk in zip(nodes, weights, strict=True):
                y = z[0] + 1j * sigma * np.array([i, j, k])
                x, yy, zz = y.T
                m = np.stack(
                    [
                        *(x * x, yy * yy, zz * zz, x * yy, x * zz, yy * zz),
                        *(x, yy, zz, 1 + 0 * x),
                    ],
                    axis=-1,
                )
                total += (wi * wj * wk / (2 * np.pi) ** 1.5) * (m.T @ m).real
    found = unbiased_moment_matrix(z, np.full((1, 6), sigma))[0]
    # a sum of 40 products in two orders
    np.testing.assert_allclose(
        found, total, rtol=0, atol=40 * EPS * np.abs(total).max()
    )


@pytest.mark.parametrize("residual", RESIDUALS)
@pytest.mark.parametrize("method", ["lm", "newton"])
def test_a_row_of_a_batch_is_bit_equal_to_fitting_it_alone(residual, method):
    trials, poses = 37, 12
    batch = noisy(trials, poses, 0.3, seed=5)
    batch[3, 2, 1] = np.nan
    batch[8] = 0.0
    batch[8, :, 0] = np.arange(poses)
    options = {"method": method, "residual": residual, "noise_std": 0.3}
    many = calibrate(batch, G, **options)
    for start, stop in ((0, 2), (2, 11), (30, 37)):
        few = calibrate(batch[start:stop], G, **options)
        for name in (*FIELDS, "status", "iterations"):
            np.testing.assert_array_equal(
                getattr(few, name), getattr(many, name)[start:stop]
            )
    for row in (0, 17, 36):
        one = calibrate(batch[row], G, **options)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(one, name), getattr(many, name)[row])
    assert np.isnan(many.parameters[[3, 8]]).all()
    assert many.status[3] == "refused: non-finite poses"
    assert many.status[8].startswith("refused: rank")


@pytest.mark.ci
def test_robust_rows_are_independent_too():
    batch = noisy(9, 20, 0.05, seed=6)
    batch[::2, 4] += 2.0
    many = calibrate(batch, G, loss="cauchy")
    for row in range(9):
        one = calibrate(batch[row], G, loss="cauchy")
        np.testing.assert_array_equal(one.parameters, many.parameters[row])


@pytest.mark.parametrize(
    ("residual", "loss"), [*((r, "linear") for r in RESIDUALS), ("weighted", "huber")]
)
def test_the_last_gradient_is_that_of_the_last_step(residual, loss):
    """|J'J| times a last step below the tolerance, 1e-12; an early one is above."""
    batch = noisy(4, 20, 0.05, seed=9)
    options = {"residual": residual, "loss": loss, "noise_std": 0.05}
    # |y| is about one in the units of the fit: elements of J are at most some 2.2,
    # so |J'J| is below 20 * 9 * 4.9, and nine elements step
    at_most = 20 * 9 * 4.9 * 3 * 1e-12
    for method in METHODS:
        norm = calibrate(batch, G, method=method, **options).gradient_norm
        assert norm.shape == (4,)
        assert ((norm >= 0.0) & (norm < at_most)).all()
    early = calibrate(batch, G, tolerance=1e-2, **options).gradient_norm
    assert (early > at_most).any()  # a round of weights may start where it ends


def test_rows_do_not_depend_on_the_block():
    """More trials than one block of 2^16 poses holds."""
    poses = 12
    trials = 2**16 // poses + 5
    batch = noisy(trials, poses, 0.05, seed=7)
    many = calibrate(batch, G)
    tail = calibrate(batch[-7:], G)
    np.testing.assert_array_equal(tail.parameters, many.parameters[-7:])


@pytest.mark.ci
def test_500_sensors_from_no_start_at_all():
    """Scales within a factor of 3, biases to 5 g, in m/s^2 and in raw counts."""
    rng = np.random.default_rng(8)
    failures = []
    for k in range(500):
        shape = rng.uniform(-0.1, 0.1, 3)
        scale = np.exp(rng.uniform(-np.log(3), np.log(3), 3))
        bias = rng.uniform(-5 * G, 5 * G, 3)
        counts = 1.0 if k % 2 else 2000.0
        truth = np.concatenate([shape, scale / counts, bias * counts])
        sensor = AccelerometerModel.from_parameters(truth)
        poses = sensor.distort(G * random_directions(40, rng), rng)
        fit = calibrate(poses, G, model=MODELS[k % 3]).to_form("triangular")
        error = np.abs(fit.parameters - truth)
        size = np.concatenate([np.ones(3), truth[3:6], G / truth[3:6]])
        if not (fit.status == "converged" and np.all(error <= 1e-9 * size)):
            failures.append((k, fit.status, error / size))
    assert failures == []


def test_scaling_of_readings_is_exact():
    """Powers of two change no bit: counts and m/s^2 are one problem."""
    poses = noisy(1, 20, 0.05, seed=9)[0]
    si = calibrate(poses, G)
    counts = calibrate(poses * 4096.0, G)
    np.testing.assert_array_equal(counts.T, si.T)
    np.testing.assert_array_equal(counts.K * 4096.0, si.K)
    np.testing.assert_array_equal(counts.B, si.B * 4096.0)


def test_a_wrong_g_is_a_wrong_scale():
    poses = noisy(1, 20, 0.05, seed=10)[0]
    right, wrong = calibrate(poses, G), calibrate(poses, G * 1.001)
    # the same fit in scaled numbers: rounding of a well-conditioned Newton step
    np.testing.assert_allclose(wrong.K, right.K * 1.001, rtol=40 * EPS)
    np.testing.assert_allclose(wrong.T, right.T, rtol=0, atol=40 * EPS)
    np.testing.assert_allclose(wrong.B, right.B, rtol=0, atol=40 * EPS)


@pytest.mark.parametrize("step", [0.3, 0.7])
def test_damped_steps_reach_the_same_minimum_in_the_stated_time(step):
    """What is left falls by 1 - step each time, and a step is step/(1-step) of what
    it leaves; the rule stops at 1e-12 of it."""
    poses = noisy(1, 20, 0.05, seed=11)[0]
    options = {"method": "gauss-newton", "step": step}
    full = calibrate(poses, G, method="gauss-newton")
    damped = calibrate(poses, G, **options)
    once = calibrate(poses, G, max_iterations=1, **options)
    assert damped.status == "converged"
    left = np.abs(once.parameters - full.parameters).max() / G * step / (1 - step)
    expected = 1 + np.log(1e-12 / left) / np.log(1 - step)
    # left is in units of g, the rule's in radii and K: a factor of 3 at most
    slip = np.log(3) / -np.log(1 - step) + 1
    assert abs(damped.iterations - expected) < slip
    np.testing.assert_allclose(
        damped.parameters, full.parameters, rtol=0, atol=3e-12 * G * (1 - step) / step
    )


def test_a_parameter_that_is_zero_does_not_upset_the_stop_rule():
    sensor = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    poses = sensor.distort(G * fibonacci_sphere(20), np.random.default_rng(0))
    for method in METHODS:
        fit = calibrate(poses, G, method=method)
        assert fit.status == "converged"
        assert fit.iterations <= 3


def test_too_few_iterations_are_a_status_not_a_success():
    poses = noisy(4, 20, 0.3, seed=12)
    fit = calibrate(poses, G, max_iterations=1)
    assert list(fit.status) == ["max iterations"] * 4
    with pytest.raises(
        ConvergenceError, match=r"4 trial\(s\) did not converge.*trial 0"
    ):
        fit.require_converged()
    assert calibrate(poses, G).require_converged().converged.all()


def test_newton_converges_quadratically():
    """Steps shrink as a square: fewer iterations than Gauss-Newton in strong noise."""
    poses = noisy(200, 12, 0.4, seed=13)
    newton = calibrate(poses, G, method="newton")
    plain = calibrate(poses, G, method="gauss-newton")
    both = newton.converged & plain.converged
    # measured: 0.99 converge in both; three of 100 fewer would be news
    assert both.mean() > 0.95
    # second order against a linear rate: 3.0 steps to 4.4 here
    assert newton.iterations[both].mean() < 0.8 * plain.iterations[both].mean()
    # linear convergence stops at 1e-12 r/(1-r) with r below 0.9 or so
    np.testing.assert_allclose(
        newton.parameters[both], plain.parameters[both], rtol=0, atol=1e-10 * G
    )


def test_a_million_samples_cost_no_more_iterations():
    few = calibrate(noisy(1, 40, 0.05, seed=14)[0], G)
    rng = np.random.default_rng(14)
    clean = MODEL.distort(G * random_directions(200_000, rng), rng)
    many = calibrate(clean + 0.05 * rng.standard_normal(clean.shape), G, repeats=True)
    assert many.status == "converged"
    assert many.iterations <= few.iterations + 1
    # sd falls as the root of the number; the bias of 3.5 sigma^2/g^2 stays
    assert np.abs(many.parameters - PARAMETERS)[3:6].max() < 3e-4


@pytest.mark.ci
@given(
    angles=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    offset=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
    stretch=st.floats(0.1, 10.0),
)
def test_ellipsoid_follows_a_change_of_axes(angles, offset, stretch):
    """Rotated, stretched and moved readings give the rotated, stretched, moved fit.

    The fit is a solution of the same least squares in other coordinates: equal to
    its own tolerance of 1e-12 and the rounding of offsets, times the condition.
    """
    poses = noisy(1, 15, 0.05, seed=20)[0]
    turn = Rotation.from_rotvec(angles).as_matrix()
    moved = stretch * poses @ turn.T + np.array(offset)
    before, after = calibrate(poses, G), calibrate(moved, G)
    gram = before.matrix.T @ before.matrix
    expected = turn @ gram @ turn.T / stretch**2
    found = after.matrix.T @ after.matrix
    np.testing.assert_allclose(
        # eps times the condition of the change of axes, 1e2, and of the fit, 1e2:
        # measured 2e-15 of the largest entry
        found,
        expected,
        rtol=0,
        atol=1e4 * EPS * np.abs(expected).max(),
    )
    bias = stretch * turn @ before.B + np.array(offset)
    np.testing.assert_allclose(after.B, bias, rtol=0, atol=1e4 * EPS * G * stretch)


@pytest.mark.ci
@given(order=st.permutations(range(15)))
def test_the_order_of_poses_does_not_matter(order):
    poses = noisy(1, 15, 0.05, seed=21)[0]
    np.testing.assert_allclose(
        calibrate(poses[order], G).parameters,
        calibrate(poses, G).parameters,
        rtol=0,
        # sums in another order: eps times the condition of the fit, 1e2, over a scale
        # of 10
        atol=1e3 * EPS * G,
    )


def test_result_is_read_only_and_named():
    fit = calibrate(noisy(1, 12, 0.01)[0], G)
    assert fit.names == (
        "S_yx", "S_zx", "S_zy", "K_x", "K_y", "K_z", "B_x", "B_y", "B_z",
    )  # fmt: skip
    with pytest.raises(ValueError, match="read-only"):
        fit.parameters[0] = 1.0
    np.testing.assert_array_equal(fit.matrix, fit.T @ np.diag(fit.K))
    np.testing.assert_array_equal(fit.sensor_scale, 1 / fit.K)
    symmetric = fit.to_form("symmetric")
    np.testing.assert_array_equal(symmetric.T, np.eye(3))
    assert symmetric.K.shape == (3, 3)
    np.testing.assert_allclose(
        # the off-diagonal entries, 0.02 of the largest, are differences: 50 eps each
        symmetric.matrix @ symmetric.matrix,
        fit.matrix.T @ fit.matrix,
        rtol=400 * EPS,
    )
    np.testing.assert_array_equal(fit.sensor().matrix, fit.matrix)


@pytest.mark.parametrize("first", ["", "import simval.calibrate as package; "])
def test_the_public_name_calibrates_in_every_order_of_imports(first):
    """`simval.calibrate` is a package too, and imports bind it over the function."""
    program = (
        f"{first}from simval import calibrate; import numpy as np; "
        "from simval.poses import fibonacci_sphere as f; "
        "from simval.calibrate import FitResult; "
        "fit = calibrate(9.8 * f(12), g=9.8); assert isinstance(fit, FitResult); "
        "from simval import calibrate; "
        "assert calibrate(9.8 * f(12), g=9.8).status == 'converged'"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
