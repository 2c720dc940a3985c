"""Bound and prediction of attitude filters, against routes that share no step.

Tolerances: relative to the standard deviations. Rounding of 200 rows of a recursion
whose state contracts leaves 1e-13; a covariance that falls from 0.05 rad to 1e-3 in the
first row loses the square of that ratio, 2.5e3.
"""

from dataclasses import replace

import numpy as np
import pytest
from filter_paths import (
    FIELD,
    UP,
    Plain,
    corrected,
    model,
    propagated,
    sensors,
    step,
    wobble,
)
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.theory import (
    CalibrationError,
    FilterPath,
    RowError,
    VectorSensor,
    filter_bound,
    filter_prediction,
    filter_recursion,
    first_update,
)
from simval.theory.filter_model import left_jacobian

ROUNDING = 1e-10


def off(found, wanted):
    """Greatest difference of covariances by the wanted standard deviations."""
    sd = np.sqrt(np.einsum("...ii->...i", wanted))
    return np.abs((found - wanted) / (sd[..., :, None] * sd[..., None, :])).max()


@pytest.mark.parametrize("T", [1, 2, 3, 10, 90])
def test_blocks_are_the_plain_recursion(T):
    path, truth = wobble(T), model(every=3)
    found = filter_bound(path, truth)
    after, before = Plain(path).covariances(truth)
    assert off(found.covariance, after) < ROUNDING
    assert off(found.before, before) < ROUNDING
    np.testing.assert_array_equal(found.kept, np.arange(T))


def test_the_second_order_of_a_reading_beside_what_is_stated():
    """(F15) of one row by hand, and of a bias that readings tell from the attitude."""
    path, s, r = wobble(1), 0.05, 0.002
    field = np.linalg.norm(UP) * np.array([1.0, 0.0, 0.0])
    two = tuple(
        VectorSensor(name=name, reference=v, std=r * float(np.linalg.norm(UP)))
        for name, v in (("a", UP), ("m", field))
    )
    truth = replace(
        model(), sensors=two, start=np.diag(np.repeat([s**2, 1e-20], 3)),
        gyroscope_noise=1e-12, gyroscope_walk=0.0,
    )  # fmt: skip
    (found,) = filter_prediction(path, truth).second_order
    # the axis across both vectors is seen by both
    by_hand = 1.5 * s**2 * np.sqrt(2.0 / r**2 + 1.0 / s**2)
    assert found == pytest.approx(by_hand, rel=1e-9)
    path, truth = wobble(30), model(bias=0.3)
    bound = filter_bound(path, truth)
    half = np.trace(bound.before[:, :3, :3], axis1=1, axis2=2) / 2.0
    metric = np.linalg.inv(bound.covariance)[:, :3, :3]
    expected = half * np.sqrt(np.linalg.eigvalsh(metric)[:, -1])
    found = filter_prediction(path, truth)
    np.testing.assert_allclose(found.second_order, expected, rtol=1e-6)
    np.testing.assert_allclose(found.before, bound.before[:, :3, :3], rtol=1e-6)
    # a known error of the rates is an error of the attitude before the first reading
    errors = [RowError(of="gyroscope", rows=np.ones((30, 3)))]
    more = filter_prediction(path, truth, errors=errors).before[0] - found.before[0]
    first, second = Rotation.from_quat(path.attitude[:2])
    F, *_ = step((first.inv() * second).as_rotvec(), path.dt[0], truth)
    turn = F[:3, 3:].sum(axis=1)
    np.testing.assert_allclose(more, np.outer(turn, turn), rtol=1e-9)
    # power: the attitude's covariance alone says less
    alone = np.linalg.inv(bound.covariance[:, :3, :3])
    less = half * np.sqrt(np.linalg.eigvalsh(alone)[:, -1])
    assert (less < 0.9 * expected).any()


def test_parts_of_a_long_path_join(monkeypatch):
    path, truth = wobble(50), model(every=4)
    whole = filter_bound(path, truth, keep=7)
    apart = filter_prediction(path, truth, keep=7)
    monkeypatch.setattr(filter_recursion, "TOGETHER", 8)
    found = filter_bound(path, truth, keep=7)
    np.testing.assert_array_equal(found.kept, np.arange(6, 50, 7))
    assert off(found.covariance, whole.covariance) < ROUNDING
    assert off(found.before, whole.before) < ROUNDING
    again = filter_prediction(path, truth, keep=7)
    np.testing.assert_allclose(again.parts, apart.parts, rtol=0, atol=1e-13)
    np.testing.assert_allclose(again.nis, apart.nis, rtol=1e-9)


def residuals(x, path, truth):
    """Whitened residuals of a whole trajectory: what a batch estimator minimises.

    The unknowns are the attitudes and biases before the first row and after each, as
    turns away from the truth. A step's rate is the rotation vector between the two
    attitudes, and the mean of a walk over it is half of its ends and a bridge.
    """
    x = x.reshape(-1, 2, 3)
    A = Rotation.from_quat(np.array(path.attitude)) * Rotation.from_rotvec(x[:, 0])
    true = Rotation.from_quat(np.array(path.attitude))
    h, N, K = path.dt[:, None], truth.gyroscope_noise, truth.gyroscope_walk
    turn = (A[:-1].inv() * A[1:]).as_rotvec() - (true[:-1].inv() * true[1:]).as_rotvec()
    b = x[:, 1]
    rate = turn / h + (b[:-1] + b[1:]) / 2.0
    rows = [x[0].ravel() / np.sqrt(np.diagonal(truth.start))]
    rows.append((rate / np.sqrt(N**2 / h + K**2 * h / 12.0)).ravel())
    rows.append((np.diff(b, axis=0) / (K * np.sqrt(h))).ravel())
    for each in truth.sensors:
        some = each.active(len(h))
        seen = A[1:].inv().apply(np.array(each.reference)) - true[1:].inv().apply(
            np.array(each.reference)
        )
        rows.append((seen[some] / each.std).ravel())
    return np.concatenate(rows)


def test_bound_is_the_inverse_of_the_information_of_a_whole_trajectory():
    """Bayesian information of all 6 (T + 1) unknowns by differences: its last block."""
    T = 12
    path = wobble(T, h=0.1, rate=2.0)  # turns of 0.3 rad a step: J is not 1
    truth = replace(
        model(every=2, bias=0.02), gyroscope_noise=[1e-2, 2e-2, 3e-2],
        gyroscope_walk=[1e-2, 3e-2, 2e-2],
        sensors=(VectorSensor(name="a", reference=UP, std=[0.1, 0.2, 0.3]),
                 VectorSensor(name="m", reference=FIELD, std=1e-6, rows=2)),
    )  # fmt: skip
    size, step = 6 * (T + 1), 1e-5
    J = np.stack(
        [
            (residuals(step * e, path, truth) - residuals(-step * e, path, truth))
            / (2.0 * step)
            for e in np.eye(size)
        ],
        axis=1,
    )
    whole = np.linalg.inv(J.T @ J)
    # differences: step^2/6 of third derivatives, which are of size 1, and 1e-16/step
    assert off(filter_bound(path, truth).covariance[-1], whole[-6:, -6:]) < 1e-7
    # power: a step without the coupling of turn and walk, or with J left out, is seen
    plain = Plain(path)
    exact = plain.step
    plain.step = lambda k, m: (exact(k, m)[0], *(x[:, :3] for x in exact(k, m)[1:]))
    assert off(plain.covariances(truth)[0][-1], whole[-6:, -6:]) > 1e-5


def test_between_fixes():
    r"""No turn, no sensor: P_0 + N^2 t + sd_b^2 t^2 + K^2 t^3/3."""
    T, h = 100, 0.1
    t = h * np.arange(1, T + 1)
    path = FilterPath(dt=np.full(T, h), attitude=np.tile([0.0, 0, 0, 1], (T + 1, 1)))
    blind = VectorSensor(name="none", reference=UP, std=1.0, rows=np.zeros(T, bool))
    truth = replace(model(), sensors=(blind,))
    wanted = 0.05**2 + 1.75e-4**2 * t + 5e-3**2 * t**2 + 2e-5**2 * t**3 / 3.0
    found = filter_bound(path, truth).covariance
    np.testing.assert_allclose(found[:, 0, 0], wanted, rtol=1e-12)
    # and with a calibration: (D alpha)^2 of a turn by alpha about one axis
    turned = Rotation.from_rotvec(np.outer(np.arange(T + 1) * 0.02, [0, 0, 1]))
    path = FilterPath(dt=path.dt, attitude=turned.as_quat())
    error = CalibrationError(of="gyroscope", covariance=1e-6 * np.eye(9))
    found = filter_prediction(path, truth, errors=[error])
    alpha = 0.02 * np.arange(1, T + 1)
    part = found.parts[found.names.index("gyroscope calibration")]
    np.testing.assert_allclose(part[:, 2, 2], 1e-6 * alpha**2, rtol=1e-11)
    np.testing.assert_allclose(
        found.parts.sum(axis=0)[:, 2, 2], wanted + 1e-6 * alpha**2, rtol=1e-11
    )


def test_left_jacobian():
    """Against its integral, and where its digits would go."""
    x, w = np.polynomial.legendre.leggauss(16)
    for size in (0.0, 1e-8, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0):
        v = size * np.array([0.6, 0.0, -0.8])
        nodes = Rotation.from_rotvec(v * (x + 1)[:, None] / 2).as_matrix()
        mean = np.einsum("n,nij->ij", w / 2, nodes)
        np.testing.assert_allclose(left_jacobian(v), mean, rtol=0, atol=1e-14)


def dense(path, truth, told):
    """The errors of a filter as a linear map of every number that was drawn.

    Columns are single draws of unit size; gains are those of the told model, one row
    and sensor after the other. Of each row the stated covariance, the columns, and the
    source of each.
    """
    plain, P = Plain(path), np.array(told.start)
    X, names = np.linalg.cholesky(truth.start), ["start"] * 6
    for k in range(len(plain.phi)):
        F, white, walk = plain.step(k, truth)
        X = np.concatenate([F @ X, white, walk], axis=1)
        names += ["gyroscope white noise"] * 3 + ["gyroscope walk"] * 6
        P = propagated(P, *plain.step(k, told))
        for (H, R, _), (_, _, each) in zip(
            plain.measured(k, told), plain.measured(k, truth), strict=True
        ):
            P, W, K = corrected(P, H, R)
            X = np.concatenate([W @ X, -K @ np.diag(each.std)], axis=1)
            names += [f"{each.name} noise"] * 3
        yield P, X, np.array(names)


def test_told_otherwise_source_by_source():
    path, truth = wobble(40, rate=2.0), model(every=3)
    told = model(every=3, N=5e-4, K=1e-5, start=0.1, bias=2e-3, force=0.06, field=1e-7)
    found = filter_prediction(path, truth, told=told)
    for k, (P, X, names) in enumerate(dense(path, truth, told)):
        assert off(found.told[k], P) < ROUNDING
        sources = [X[:, names == name] for name in found.names]
        wanted = np.stack([x @ x.T for x in sources])
        whole = np.sqrt(np.diagonal(wanted.sum(axis=0)))
        for ours, theirs in zip(found.parts[:, k], wanted, strict=True):
            assert np.abs((ours - theirs) / np.outer(whole, whole)).max() < ROUNDING
        for size in (3, 6):
            moment = wanted.sum(0)[:size, :size]
            nees = np.trace(np.linalg.solve(P[:size, :size], moment))
            np.testing.assert_allclose(found.nees(size)[k], nees, rtol=1e-8)


def test_told_the_truth_it_is_the_bound():
    path, truth = wobble(200), model(every=2)
    bound = filter_bound(path, truth, keep=9)
    found = filter_prediction(path, truth, keep=9)
    assert off(found.parts.sum(axis=0), bound.covariance) < ROUNDING
    np.testing.assert_allclose(found.nees(), 6.0, rtol=1e-8)
    np.testing.assert_allclose(found.nees(3), 3.0, rtol=1e-8)
    np.testing.assert_allclose(found.rms(), bound.attitude_sd, rtol=1e-8)
    active = 3.0 + 3.0 * truth.sensors[1].active(200)[found.kept]
    np.testing.assert_array_equal(found.nis_size, active)
    np.testing.assert_allclose(found.nis, active, rtol=1e-9)


def drawn_nis(path, truth, told, c, trials, seed):
    """NIS of a linear filter whose readings are off by c; both sensors in each row."""
    plain, rng = Plain(path), np.random.default_rng(seed)
    P = np.array(told.start)
    e = rng.standard_normal((trials, 6)) @ np.linalg.cholesky(truth.start).T
    nis = []
    for k in range(len(plain.phi)):
        F, white, walk = plain.step(k, truth)
        # what an error of the rate turns is what an error of the bias turns
        rate = c["gyroscope"].reshape(3, 3) @ plain.phi[k] / path.dt[k]
        e = e @ F.T + np.concatenate([F[:3, 3:] @ rate, np.zeros(3)])
        e = e + rng.standard_normal((trials, 3)) @ white.T
        e = e + rng.standard_normal((trials, 6)) @ walk.T
        P = propagated(P, *plain.step(k, told))
        H = np.concatenate([h for h, *_ in plain.measured(k, truth)])
        R = [np.concatenate([s.std for s in m.sensors]) for m in (truth, told)]
        z = e @ H.T + R[0] * rng.standard_normal((trials, 6))
        for s, each in enumerate(truth.sensors):
            v = plain.A[k + 1] @ each.reference
            own = c[each.name]
            z[:, 3 * s : 3 * s + 3] += own[:9].reshape(3, 3) @ v + own[9:]
        S = H @ P @ H.T + np.diag(R[1] ** 2)
        gain = np.linalg.solve(S, H @ P).T
        nis.append(np.vecdot(z, np.linalg.solve(S, z.T).T))
        e, P = e - z @ gain.T, P - gain @ H @ P
    return np.array(nis), e


def test_known_errors_of_readings_and_nis_as_drawn():
    """400 draws; z beyond 4.5 in 42 comparisons is one in 3000 seeds."""
    path, truth = wobble(30, rate=2.0), model(start=0.02)
    told = model(start=0.02, force=0.03, N=3e-4)
    rng = np.random.default_rng(4)
    c = {"gyroscope": 3e-3 * rng.standard_normal(9),
         "accelerometer": np.r_[1e-3 * rng.standard_normal(9), 0.02, 0.0, -0.02],
         "magnetometer": np.r_[1e-3 * rng.standard_normal(9), 2e-7, 0.0, 1e-7],
    }  # fmt: skip
    errors = [CalibrationError(of=name, value=value) for name, value in c.items()]
    found = filter_prediction(path, truth, told=told, errors=errors)
    nis, e = drawn_nis(path, truth, told, c, 400, 1)
    z = (nis.mean(axis=1) - found.nis) / (nis.std(axis=1) / 20.0)
    assert np.abs(z).max() < 4.5
    sd = np.sqrt(np.diagonal(found.parts[:, -1].sum(axis=0)))
    assert np.abs((e.mean(axis=0) - found.mean[-1]) / (sd / 20.0)).max() < 4.5
    # power: without the errors of the sensors
    fewer = filter_prediction(path, truth, told=told, errors=errors[:1])
    assert np.abs((nis.mean(axis=1) - fewer.nis) / (nis.std(axis=1) / 20.0)).max() > 4.5
    assert np.abs((e.mean(axis=0) - fewer.mean[-1]) / (sd / 20.0)).max() > 4.5


def test_a_known_error_is_its_columns_times_its_size():
    """A row error made from a matrix, and a covariance of one column, are that one."""
    path, truth = wobble(30), model()
    rng = np.random.default_rng(0)
    value, force = 1e-3 * rng.standard_normal(9), rng.standard_normal((30, 3))
    turns = Rotation.from_quat(np.array(path.attitude))
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / path.dt[:, None]
    affine = np.r_[value, 0.01, 0.02, 0.03]
    v = turns[1:].inv().apply(UP)
    for error, sensor, rows in (
        (CalibrationError(of="gyroscope", value=value), "gyroscope", rate),
        (
            CalibrationError(of="g-sensitivity", value=value, force=force),
            "gyroscope", force,
        ),
        (CalibrationError(of="accelerometer", value=affine), "accelerometer", v),
    ):  # fmt: skip
        found = filter_prediction(path, truth, errors=[error])
        rows = rows @ value.reshape(3, 3).T
        rows = rows + affine[9:] if sensor == "accelerometer" else rows
        row = RowError(of=sensor, rows=rows)
        again = filter_prediction(path, truth, errors=[row])
        np.testing.assert_allclose(again.mean, found.mean, rtol=1e-8, atol=1e-14)
        np.testing.assert_allclose(again.nis, found.nis, rtol=1e-12)
        spread = replace(
            error, value=None, covariance=np.outer(error.value, error.value)
        )
        uncertain = filter_prediction(path, truth, errors=[spread])
        assert uncertain.names[-1] == error.name
        np.testing.assert_allclose(uncertain.nis, found.nis, rtol=1e-12)
        np.testing.assert_allclose(uncertain.nees(), found.nees(), rtol=1e-9)


def test_a_known_start_decays_as_the_state():
    path, truth = wobble(20), model()
    found = filter_prediction(path, truth, start_error=[0.01, 0, 0, 0, 2e-3, 0])
    plain, e, P = Plain(path), np.array([0.01, 0, 0, 0, 2e-3, 0]), truth.start
    for k in range(20):
        F, white, walk = plain.step(k, truth)
        P, e = propagated(P, F, white, walk), F @ e
        for H, R, _ in plain.measured(k, truth):
            P, W, _ = corrected(P, H, R)
            e = W @ e
        sd = np.sqrt(np.diagonal(P))
        assert np.abs((found.mean[k] - e) / sd).max() < ROUNDING


STILL = np.tile([0, 0, 0, 1.0], (3, 1))
FEW = VectorSensor(name="a", reference=UP, std=1.0, rows=np.ones(4, bool))
BAD = [
    lambda: FilterPath(dt=[0.1], attitude=STILL),
    lambda: FilterPath(dt=[0.1, 0.0], attitude=STILL),
    lambda: VectorSensor(name="a", reference=[0, 0, 0], std=1.0),
    lambda: VectorSensor(name="a", reference=UP, std=[1.0, 2.0]),
    lambda: VectorSensor(name="a", reference=UP, std=1.0, rows=np.ones(3)),
    lambda: replace(model(), sensors=()),
    lambda: replace(model(), sensors=sensors()[:1] * 2),
    lambda: replace(model(), start=np.diag([1, 1, 1, 1, 1, -1.0])),
    lambda: replace(model(), start=np.triu(np.ones((6, 6)))),
    lambda: replace(model(), start=np.eye(3)),
    *(lambda k=k: filter_bound(wobble(5), model(), keep=k) for k in (6, [1, 1], [5])),
    lambda: filter_bound(wobble(5), model(), keep="all"),
    lambda: filter_bound(wobble(5), replace(model(), sensors=(FEW,))),
    lambda: filter_prediction(
        wobble(5), model(), told=replace(model(), sensors=sensors()[:1])
    ),
    lambda: filter_prediction(wobble(5), model(), start_error=np.ones((2, 6))),
    *(
        lambda e=e: filter_prediction(wobble(5), model(), errors=[e])
        for e in (
            CalibrationError(of="barometer"),
            RowError(of="gyroscope", rows=np.ones((4, 3))),
            3,
        )
    ),
    lambda: CalibrationError(of="gyroscope", value=np.ones(12)),
    lambda: CalibrationError(of="g-sensitivity"),
    lambda: CalibrationError(of="gyroscope", force=np.ones((5, 3))),
    lambda: RowError(of="gyroscope", rows=[[0, 0, np.nan]]),
    lambda: filter_prediction(wobble(5), model()).nees(4),
    lambda: first_update(wobble(5), model(), np.ones((2, 3))),
    lambda: first_update(wobble(1), model(), np.ones(3)),
]


def test_what_cannot_be_predicted_is_refused():
    for make in BAD:
        with pytest.raises(InputError):
            make()


@pytest.mark.parametrize("every", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("count", [1, 4, 5, 6, 16])
def test_of_every_so_many_rows_the_last_one_measures(every, count):
    sensor = VectorSensor(
        name="x", reference=np.array([0.0, 0.0, 1.0]), std=1.0, rows=every
    )
    since, expected = 0, []
    for _ in range(count):
        since = (since + 1) % every
        expected.append(since == 0)
    assert sensor.active(count).tolist() == expected
