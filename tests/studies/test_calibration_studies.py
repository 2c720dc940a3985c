"""Studies of calibrations: what is claimed of each, beyond that it is as predicted."""

from functools import partial

import numpy as np
import pytest
from cells import of_family, outcome
from imu_tk import imu_tk_residual
from scipy import stats

from simval.geometry import normalize
from simval.imu.calibrate import calibrate
from simval.imu.sensor import forms
from simval.poses import fibonacci_sphere
from simval.statistics import RECOVERY
from simval.studies import coverage, gyroscope, ladder, solvers
from simval.studies.magnetometer import UNLIKE, Scenario, response_rows
from simval.sweep import load_run


@pytest.mark.slow
def test_ladder_is_the_ladder():
    """400 poses: each rung within 30/N and its sampling error of the large-N law."""
    for residual, rung in ladder.RUNGS.items():
        rows = outcome("ladder", residual=residual, poses=400, trials=512).rows
        (row,) = (row for row in rows if row.predictor == "many poses")
        assert row.prediction == rung
        assert abs(row.value - rung) < 30 / 400 + 5 * row.standard_error


def test_nees_quantiles_against_scipy():
    assert np.isclose(coverage.nees_quantile(0.95, None), stats.chi2(9).ppf(0.95))
    assert np.isclose(coverage.nees_quantile(0.95, 3), 9 * stats.f(9, 3).ppf(0.95))


@pytest.mark.parametrize(
    ("seed", "count"),
    [
        pytest.param(1, 4, marks=pytest.mark.ci),
        pytest.param(2, 200, marks=pytest.mark.slow),
    ],
)
def test_theory_meets_the_magnetometers_estimate_at_any_legal_cell(seed, count):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        first = 10 ** rng.uniform(-5.0, np.log10(0.02))
        second = np.clip(first * 10 ** rng.uniform(-2.0, 2.0), 1e-5, 0.02)
        noises = (first, second) if rng.random() < 0.5 else (second, first)
        cell = int(rng.integers(12, 30)), float(rng.uniform(-85.0, 85.0)), *noises
        rows = response_rows(*cell)
        assert len(rows) == 2, cell
        assert all(row.value < 0.2 * row.remainder for row in rows), cell
        # a thousandth of a covariance, and of a bias of 5e-4 deviations, is seen
        assert [row.remainder for row in rows] == pytest.approx([1e-5, 1e-7]), cell
    assert response_rows(20, 66.0, 1e-4, 1.01e-4 * UNLIKE) == ()


@pytest.mark.parametrize(
    ("count", "noises"), [(13, (1e-5, 1e-2)), (15, (1e-3, 1e-5)), (20, (1e-5, 1e-2))]
)
def test_a_sensor_of_little_noise_ends_as_soon_as_any(noises, count):
    # the last steps gain less of the cost than it is rounded by: before, a third of
    # these trials were damped there and took up to 100 steps, some without an end
    case = Scenario(count, -20.0, *noises)
    noise = np.random.default_rng(count).standard_normal((100, 6 * count))
    fit = case.fitted(*case.readings(noise)).require_converged()
    assert fit.iterations.max() <= 10


@pytest.mark.ci
def test_averages_of_rates_are_of_fourth_order_and_straight_lines_of_second(smoke_run):
    (cell,) = load_run(smoke_run).of("gyroscope")
    recovery, *others = of_family(cell.rows, RECOVERY)
    assert abs(recovery.value - recovery.prediction) <= recovery.remainder
    assert recovery.remainder < 0.01 * recovery.prediction  # what it can tell
    off_by = {row.statistic.entries[1:]: row.value for row in others}
    # what chunks of two leave of averages at 500 Hz is not greater
    for kind, order in ((gyroscope.STRAIGHT, 2.0), (gyroscope.AVERAGES, 4.0)):
        values = [off_by[kind, rate] for rate in ("250 Hz", "100 Hz", "50 Hz")]
        slopes = np.diff(np.log(values)) / np.log([2.5, 2.0])
        assert np.all(np.abs(slopes - order) < 0.4), kind
    assert off_by[gyroscope.STRAIGHT, "100 Hz"] > 20.0 * off_by["averages", "100 Hz"]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("poses", "one", "mean"), [(14, 4.1e-3, 1.3e-4), (40, 3.1e-3, 4.4e-4)]
)
def test_what_segments_of_a_move_leave_out_is_what_is_stated(poses, one, mean):
    """Beside segments a fifth as long, extrapolated by their second order."""
    data = gyroscope.Tumble(gyroscope.Parameters(poses=poses, trials=256))
    coarse, fine = (np.diagonal(data.bound(pieces)) for pieces in (100, 200))
    limit = (4.0 * fine - coarse) / 3.0
    off = np.diagonal(data.bound()) / limit - 1.0
    # the next order leaves 6e-5 of a variance: beside 50 and 100 segments
    assert np.abs(off).max() == pytest.approx(one, abs=1e-4)
    assert abs(off.mean()) == pytest.approx(mean, abs=5e-5)
    # what a cell judges is the mean, and what it is allowed is above it
    assert abs(off.mean()) < gyroscope.RELATIVE


@pytest.mark.ci
@pytest.mark.parametrize("every", [1, 5, 10])
def test_the_joint_fit_states_the_bound_of_short_pieces(every):
    data = gyroscope.Tumble(gyroscope.Parameters(poses=14, trials=256, every=every))
    clean = data.clean()
    (row,) = gyroscope._stated_row(clean, data)
    assert row.value < 0.5 * row.remainder
    data.walk *= 1.01  # of the bound alone
    (row,) = gyroscope._stated_row(clean, data)
    assert row.value > row.remainder


def test_a_source_s_step_is_that_of_its_derivatives():
    """Jacobian by complex step, and the fixed fraction of a step by hand."""
    rng = np.random.default_rng(5)
    readings = normalize(rng.standard_normal((12, 3)))
    for model in ("triangular", "symmetric"):
        start = forms.from_gram(model, np.eye(3), np.zeros(3))
        theta = start + 0.1 * rng.standard_normal(9)

        def residuals(theta, model=model):
            h = (readings - theta[6:]) @ forms.matrix(model, theta).T
            return np.sum(h * h, axis=1) - 1.0

        steps = 1e-30j * np.eye(9)
        J = np.stack([residuals(theta + h).imag / 1e-30 for h in steps], axis=1)
        local = solvers.nine_unknowns(model, readings)(theta[None], np.arange(1))
        np.testing.assert_allclose(local.normal[0], J.T @ J, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(
            local.gradient[0], J.T @ residuals(theta), rtol=1e-12, atol=1e-13
        )


def test_the_first_source_s_steps_are_damped_by_mu_times_the_identity():
    """The first three, each from where the last ended; mu falls tenfold each time."""
    readings = 0.1 + 1.3 * normalize(np.random.default_rng(6).standard_normal((20, 3)))
    readings *= [0.8, 1.0, 1.1]  # unlike diagonals: mu I is not mu times the diagonal
    source = solvers.SOURCES["triangular lm"]
    path = solvers.source_way(source, solvers.G * readings)[0][:3]
    at = np.array([0.0, 0, 0, 1, 1, 1, 0, 0, 0])
    for k, there in enumerate(path / np.repeat([1.0, solvers.G], [6, 3])):
        tilted = (imu_tk_residual(at + h, readings, 1.0) for h in 1e-30j * np.eye(9))
        J = np.stack([e.imag / 1e-30 for e in tilted], axis=1)
        N, e = J.T @ J, imu_tk_residual(at, readings, 1.0)
        if k == 0:
            first = 1e-6 * np.trace(N) / 9.0
        step = -np.linalg.solve(N + first / 10.0**k * np.eye(9), J.T @ e)
        # rounding is 1e-14; the damping is 1e-6, 1e-7 and 1e-8 of a diagonal
        np.testing.assert_allclose(there, at + step, rtol=0, atol=3e-13)
        assert np.sum(e * e) > np.sum(imu_tk_residual(there, readings, 1.0) ** 2)
        at = there


@pytest.mark.parametrize("name", [solvers.FULL_STEPS, solvers.HALF_STEPS])
def test_a_symmetric_source_stops_at_the_step_that_its_rule_says(name):
    """Found again from the path: means of magnitudes below 1 count as 1, and a step
    that no longer shrinks is rounding."""
    source, start = solvers.SOURCES[name], np.zeros((1, 9))
    start[0, [0, 3, 5]] = 1.0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        # the scales' means are beyond 1, and no step raises the cost
        readings = normalize(rng.standard_normal((24, 3))) / rng.uniform(1.4, 1.6, 3)
        readings += 0.01 * rng.standard_normal((24, 3)) + 0.05
        path, steps = solvers.source_way(source, solvers.G * readings)
        p = path / np.repeat([1.0, solvers.G], [6, 3])
        M = forms.matrix("triangular", p)
        ways = forms.from_gram("symmetric", M.swapaxes(1, 2) @ M, p[:, 6:])
        ways = np.concatenate([start, ways])
        total = np.maximum(np.abs(ways[1:] + ways[:-1]), 2.0)
        size = np.max(np.abs(2.0 * np.diff(ways, axis=0)) / total, axis=1)
        met = size <= 1e-11
        met[1:] |= (size[1:] <= 1e-7) & (size[1:] >= size[:-1])
        assert np.abs(ways[-1]).max() > 1.4
        assert list(np.flatnonzero(met) + 1) == [steps]
        assert len(path) == steps < solvers.MOST_STEPS


def symmetric_gradient(theta, readings, g=1.0):
    """Gradient and J'J of the symmetric source's residual, also of complex numbers."""
    rows, columns = np.triu_indices(3)
    K = np.zeros((3, 3), dtype=complex)
    K[rows, columns] = K[columns, rows] = theta[:6]
    x = readings - theta[6:]
    h = x @ K
    e = np.sum(h * h, axis=1) - g * g
    slopes = [
        2.0 * (h[:, i] * x[:, j] + (i != j) * h[:, j] * x[:, i])
        for i, j in zip(rows, columns, strict=True)
    ]
    J = np.stack([*slopes, *(-2.0 * h @ K).T], axis=1)
    return J.T @ e, J.T @ J


def test_the_printed_stop_rule_and_all_second_derivatives():
    """The path of the symmetric source's Newton by hand, to the step of its own rule.

    Its 45 second derivatives are complex steps of a gradient that is written here; the
    cost never rises on these sets, and the Hessian stays positive.
    """
    source = solvers.SOURCES["symmetric newton"]
    plain = solvers.SOURCES["symmetric printed stop"]
    assert (source.stop, plain.stop) == ("printed", "printed")
    rng = np.random.default_rng(8)
    readings = 1.05 * normalize(rng.standard_normal((24, 3))) + 0.04
    readings += 0.01 * rng.standard_normal((24, 3))

    for found, hessian in ((source, True), (plain, False)):
        path, steps = solvers.source_way(found, solvers.G * readings)
        p = path / np.repeat([1.0, solvers.G], [6, 3])
        M = forms.matrix("triangular", p)
        ways = forms.from_gram("symmetric", M.swapaxes(1, 2) @ M, p[:, 6:])
        at = np.array([1.0, 0, 0, 1, 0, 1, 0, 0, 0], dtype=complex)
        for k, there in enumerate(ways, 1):
            g, N = symmetric_gradient(at, readings)
            if hessian:
                tilted = (
                    symmetric_gradient(at + h, readings)[0] for h in 1e-30j * np.eye(9)
                )
                N = np.stack([t.imag / 1e-30 for t in tilted], axis=1)
            step = -np.linalg.solve(N.real, g.real)
            # rounding over the least eigenvalue of N, some hundredths of its greatest
            np.testing.assert_allclose(there, (at + step).real, rtol=0, atol=1e-12)
            size = np.max(np.abs(2.0 * step / (2.0 * at.real + step)))
            if k < steps and size < 1e-7:  # beyond it rounding decides
                assert size > 1e-11
            at = there.astype(complex)
        assert size < 1e-11
        assert len(ways) == steps < solvers.MOST_STEPS


@pytest.mark.parametrize("method", ["lm", "gauss-newton", "newton"])
@pytest.mark.parametrize("model", ["triangular", "symmetric"])
def test_the_sources_iteration_ends_where_the_three_unknowns_do(method, model):
    sensor = solvers.true_sensor(0.05)
    raw = sensor.distort(solvers.G * fibonacci_sphere(30), np.random.default_rng(3))
    ours = calibrate(raw, model=model, method=method)
    theirs = calibrate(raw, model=model, method=method, iteration="source")
    assert theirs.status == ours.status == "converged"
    assert theirs.parameters == pytest.approx(ours.parameters, rel=1e-9, abs=1e-10)
    damped = calibrate(raw, model=model, method=method, iteration="source", step=0.5)
    assert damped.iterations > 3 * theirs.iterations
    if method == "lm":  # mu I is felt while the step is long
        few = [
            calibrate(raw, model=model, method=m, iteration="source", max_iterations=1)
            for m in ("lm", "gauss-newton")
        ]
        apart = np.abs(few[0].parameters - few[1].parameters).max()
        assert 0.0 < apart < 1e-4


@pytest.mark.parametrize("method", ["gauss-newton", "newton"])
def test_the_path_of_the_source_s_iteration_on_poses(method):
    """Each step of the key `iteration`, from its first to that of the printed rule.

    The symmetric source's residual is written here, and differentiated by complex
    steps. A step of 1e-15 of itself shows where they start.
    """
    raw = solvers.true_sensor(0.3).distort(
        solvers.G * fibonacci_sphere(30), np.random.default_rng(5)
    )
    alpha = 0.5
    way = partial(calibrate, raw, model="symmetric", method=method, iteration="source")
    at = way(step=1e-15, max_iterations=1).parameters
    steps = int(way(step=alpha).iterations)
    for k in range(1, steps + 1):
        g, N = symmetric_gradient(at, raw, solvers.G)
        if method == "newton":
            widths = 1e-30 * np.repeat([1.0, solvers.G], [6, 3])
            tilted = [
                symmetric_gradient(at + 1j * h, raw, solvers.G)[0].imag / h.max()
                for h in np.diag(widths)
            ]
            N = np.stack(tilted, axis=1)
        step = -alpha * np.linalg.solve(N.real, g.real)
        there = way(step=alpha, max_iterations=k).parameters
        # of biases of 1, sixteen digits through a matrix of condition 1e3
        np.testing.assert_allclose(there, at + step, rtol=0, atol=1e-12)
        size = np.max(np.abs(2.0 * step / (2.0 * at + step)))
        assert (size <= 1e-12) == (k == steps)
        at = there


def test_newton_is_quadratic_and_the_others_are_linear():
    (ways,) = outcome("solvers", noise_std=1.0).artifacts.values()
    gauss, newton = ways["gauss-newton"], ways["newton"]
    # linear: the distance falls by one factor a step, within 20 % of itself
    factors = gauss[1:] / gauss[:-1]
    assert np.ptp(np.log(factors)) < 0.2
    # quadratic: three more digits in the first step
    assert newton[0] < 1e-3 * gauss[0]
    assert len(newton) < len(gauss)
