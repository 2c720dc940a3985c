"""The judge of every linearised fit: who is named, who is blamed, who is spared.

A false alarm of a test of many sets is one in 1e4, by the binomial of the rate that the
package states.
"""

from itertools import combinations, product

import numpy as np
import pytest
import scipy
from magnetometer_sets import FIELD, IRON_STD, squares
from nine_axes import ACC, GYRO, MAG, TRUTH, drawn
from scipy import stats
from tumbles import WALK, fitted, tumble

from simval.account.terminal import lines
from simval.errors import RefusedError
from simval.imu.calibrate import Recording, fit
from simval.imu.calibrate.factors import LEAST, MORE, MOST, judged
from simval.imu.calibrate.goodness_of_fit import (
    FALSE_ALARM,
    Beside,
    Deletion,
    Left,
    NoiseSource,
    Residuals,
    least_determined_of,
)
from simval.imu.calibrate.joint import together
from simval.imu.explain.judgement import CHANCE


def linear(rng, shift=None, size=0.0, factor=(1.0, 1.0, 1.0)):
    """Three sources in rows of their own and their neighbours', by their noise.

    One item is moved, or each source has so many times its noise.
    """
    maps = np.zeros((3, 40, 6, 3))
    for source, L in enumerate(maps):
        L[12 * source : 12 * source + 16] = rng.standard_normal((16, 6, 3))
    xi = np.array(factor)[:, None, None] * rng.standard_normal((3, 6, 3))
    if shift is not None:
        xi[shift] += size * np.array([0.6, -0.64, 0.48])
    J, r = rng.standard_normal((40, 8)), np.einsum("srim,sim->r", maps, xi)

    V = np.einsum("srim,stim->srt", maps, maps)
    return Residuals(
        r=r, J=J, names=tuple("abcdefgh"),
        sources=tuple(
            NoiseSource(name, V, np.moveaxis(L, 1, 0), "rest", slice(0, 8))
            for name, V, L in zip("abc", V, maps, strict=True)
        ),
        beside=tuple(
            Beside(name, "noise", V) for name, V in zip("abc", V, strict=True)
        ),
    )  # fmt: skip


def asked_for(rows):
    """What is found in a linear problem, which its noise leaves as it is."""
    return judged(rows, lambda _, more: rows, lambda _: rows)[1]


def named(told):
    return [(s, k) for s, each in enumerate(told) for k in each.outliers]


@pytest.mark.ci
def test_outliers_of_any_rows_at_their_level_and_power():
    """Correlated rows, items of three unknowns that share rows with each other."""
    rng, sets = np.random.default_rng(8), 150
    called = sum(bool(named(Left(linear(rng)).sensors())) for _ in range(sets))
    assert called <= stats.binom.isf(1e-4, sets, FALSE_ALARM)
    exact = 0
    for k in range(30):
        shift = (k % 3, k % 6)
        exact += named(Left(linear(rng, shift, 25.0)).sensors()) == [shift]
    assert exact >= 24


def test_residuals_without_several_items_are_those_of_a_new_fit():
    """Least squares by numpy on the rows and the columns of the items beside them."""
    rng = np.random.default_rng(3)
    J, r, items = (rng.standard_normal(n) for n in ((30, 5), 30, (8, 30, 2)))
    for given in (items, None):
        told = Deletion.of(J, r, given)
        U = np.eye(30)[:, :, None] if given is None else given
        for out in ([], [2], [1, 4, 6]):
            both = np.concatenate([J, *U[out]], axis=1)
            left = r - both @ np.linalg.lstsq(both, r, rcond=None)[0]
            np.testing.assert_allclose(told.without(out)[0], left, atol=1e-12)
            assert told.squares(out) == pytest.approx(left @ left)
        drop = told.squares([]) - told.squares([3])
        assert told.drops([])[3] == pytest.approx(drop)
        assert np.isnan(told.drops([1, 4])[[1, 4]]).all()
    hat = items.swapaxes(1, 2) @ J @ np.linalg.pinv(J) @ items
    share = np.trace(hat, axis1=1, axis2=2) / np.sum(items**2, axis=(1, 2))
    np.testing.assert_allclose(Deletion.of(J, r, items).leverage(), share)


@pytest.mark.parametrize(("size", "most"), [(1, 6), (2, 3)])
def test_an_outlier_is_called_from_the_level_that_is_stated(size, most):
    """One item of otherwise clean rows, its chance just below (O1) and just above."""
    rng = np.random.default_rng(12)
    J, r = rng.standard_normal((30, 5)), rng.standard_normal(30)
    items = None if size == 1 else rng.standard_normal((8, 30, size))
    U = np.eye(30)[:, [3]] if items is None else items[3]
    told = Deletion.of(J, r, items)
    clean, own = told.without([3])[0], U[:, 0] - J @ np.linalg.lstsq(J, U[:, 0])[0]
    for share, named in ((0.95, [3]), (1.05, [])):
        level = share * FALSE_ALARM / most / told.count
        F = stats.f.isf(level, size, 25 - size)  # by the scatter of the others
        drop = F * size * (clean @ clean) / (25 - size)
        moved = clean + np.sqrt(drop / (own @ own)) * own
        assert Deletion.of(J, moved, items).outliers(None) == named


@pytest.mark.parametrize("count", [1, 2, 3])
def test_as_many_rows_as_may_leave_are_found_together(count):
    """Far off, of noise that is known; one more would leave too little to judge."""
    rng = np.random.default_rng(7)
    J, r = rng.standard_normal((10 + count, 8)), rng.standard_normal(10 + count)
    off = sorted(rng.choice(len(r), count, replace=False).tolist())
    r[off] += 1e3 * rng.choice([-1.0, 1.0], count)
    assert Deletion.of(J, r).outliers(1.0) == off


def test_chances_are_those_of_chi_squares():
    """Of one sensor, and of three whose rows together are the least likely."""
    rng = np.random.default_rng(6)
    rows = linear(rng)
    one = rows._replace(
        sources=(rows.sources[0]._replace(covariance=4.0 * np.eye(40)),),
        beside=(Beside("a", "noise", 4.0 * np.eye(40)),),
    )
    squares = Deletion.of(one.J, one.r / 2.0).squares([])
    expected = stats.chi2.sf(squares, 32)
    assert Left(one).sensors()[0].p_value == pytest.approx(expected)
    assert Left(one).p_value() == pytest.approx(2.0 * expected)
    more = Left(rows._replace(r=2.0 * rows.r))
    told = more.sensors()
    whole = stats.chi2.sf(sum(each.chi_square for each in told), 32)
    assert whole < min(each.p_value for each in told)
    assert more.p_value() == pytest.approx(4.0 * whole)


def test_the_least_determined_combination_is_named():
    rng = np.random.default_rng(4)
    J = rng.standard_normal((30, 5)) * [1.0, 1e6, 1e-6, 3.0, 2.0]
    J[:, 3] = 7.0 * J[:, 1] + 1e4 * rng.standard_normal(30)  # 1e6 beside 1e4
    found = least_determined_of(J, tuple("abcde"))
    assert (found.rank, found.parameters) == (5, 5)
    assert found.words in ("0.71 b -0.71 d", "0.71 d -0.71 b")
    # a hundredth of their size apart, by seven: their difference, normalised
    whole = np.linalg.inv(J.T @ J)
    unit = np.array([0.0, 1.0, 0.0, -1.0, 0.0]) / np.sqrt(2.0)
    own = unit * np.linalg.norm(J, axis=0)
    assert found.widening == pytest.approx(np.sqrt(own @ whole @ own), rel=1e-2)
    J[:, 3] = 7.0 * J[:, 1]
    found = least_determined_of(J, tuple("abcde"))
    assert found.rank == 4
    assert "undetermined" in found.sentence


@pytest.mark.ci
def test_noise_as_stated_is_asked_for_more_no_oftener_than_stated():
    """The chance that is told is at least that, whatever the correlations of rows; and
    odds of R, of any log that is asked, are as Markov's bound has them."""
    rng, count = np.random.default_rng(5), 400
    told = [asked_for(linear(rng)) for _ in range(count)]
    for level in (CHANCE, 0.02, 0.2):
        seen = np.count_nonzero([each.p_value < level for each in told])
        assert seen <= stats.binom.isf(1e-5, count, level)
    # power: three sources in rows mostly of their own have 0.05 each, and so it is used
    seen = np.count_nonzero([each.p_value < 0.2 for each in told])
    assert seen >= stats.binom.ppf(1e-3, count, 1.0 - 0.95**3)
    assert all(each.borne == (each.p_value >= CHANCE) for each in told)
    assert not any(each.blamed for each in told)


@pytest.mark.parametrize("blamed", [0, 1, 2])
def test_a_factor_is_that_of_the_noise(blamed):
    """Four times the noise of one source: blamed, no other, and by how much."""
    rng, found = np.random.default_rng(6 + blamed), []
    for _ in range(25):
        told = asked_for(linear(rng, factor=np.where(np.arange(3) == blamed, 4.0, 1.0)))
        assert told.p_value < CHANCE
        assert set(told.blamed) <= {"abc"[blamed]}
        found.append((told.errors[blamed].size, bool(told.blamed)))
    size, named = np.mean(found, axis=0)
    assert 3.4 < np.hypot(1.0, size) < 4.6  # 4 +- 0.2 by 25 of 10 freedoms
    assert named > 0.8


@pytest.mark.parametrize("factor", [(1.0, 3.5, 1.0), (3.0, 1.0, 3.0), (2.5, 1.0, 1.0)])
def test_odds_are_those_of_an_integral(factor):
    """Of one and two errors by quadrature over the density of contrasts (three at once
    are hundreds of times rarer here), each by its share before the rows are seen."""
    rng = np.random.default_rng(2)
    rows = linear(rng, factor=factor)
    while not (told := asked_for(rows)).p_value < CHANCE:
        rows = linear(rng, factor=factor)
    Z = scipy.linalg.null_space(rows.J.T)
    y, V = Z.T @ rows.r, np.array([Z.T @ each.covariance @ Z for each in rows.beside])
    base = np.linalg.solve(V.sum(axis=0), V)
    unit = np.trace(base, axis1=1, axis2=2) / np.einsum("sij,sji->s", base, base)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    ends = np.log([LEAST, MOST])
    more = np.exp(2.0 * (ends.mean() + np.ptp(ends) / 2.0 * nodes))

    def density(more):
        S = V.sum(axis=0) + np.einsum("ks,sij->kij", more, V)
        left = np.einsum("i,kij,j->k", y, np.linalg.inv(S), y)
        return -0.5 * (np.linalg.slogdet(S)[1] + left)

    none, sets = density(np.zeros((1, 3))), {}
    for k in (1, 2):
        at = np.array(list(product(range(len(nodes)), repeat=k)))
        for some in map(list, combinations(range(3), k)):
            given = np.zeros((len(at), 3))
            given[:, some] = more[at] * unit[some]
            likely = np.exp(density(given) - none) @ np.prod(weights[at] / 2.0, axis=1)
            sets[tuple(some)] = likely * MORE**k
    before = sum(MORE ** len(some) for some in sets)
    whole = sum(sets.values())
    assert abs(told.odds - np.log(whole / before)) < 0.5
    for s, each in enumerate(told.errors):
        share = sum(v for some, v in sets.items() if s in some) / (1.0 + whole)
        assert abs(each.share - share) < 0.1


# recordings with a fault in one sensor

PARTS = {"accelerometer": ACC, "gyroscope": GYRO, "magnetometer": MAG}


@pytest.fixture(scope="module")
def truth():
    return tumble(20, every=10, first_hold=10.0, hold_time=0.6, move_time=1.5)


def fits_of(truth, poses, rows, fields):
    """The fits of two sensors each, and that of all, of one recording."""
    _, inter_rest = fitted(truth, poses, rows, chunk=2)
    recording = Recording(
        poses=poses[0], pose_std=truth.pose_std, fields=fields[0], field_std=IRON_STD,
        rotations=inter_rest, angle_random_walk=WALK, g=truth.g, field=FIELD,
        hemisphere="north",
    )  # fmt: skip
    parts = {
        name: fit(recording, [name], start=np.eye(3)) for name in recording.sensors
    }
    return (*parts.values(), together(recording, parts))


@pytest.mark.ci
@pytest.mark.parametrize("sensor", [None, *PARTS])
def test_a_fault_in_each_sensor_is_named(truth, sensor):
    """One rest or one move is off; all three joint fits say which, and no other."""
    poses, rows, fields = drawn(truth, 1, np.random.default_rng(11))
    if sensor == "accelerometer":
        poses[0, 5, 1] += 0.05
    if sensor == "magnetometer":
        fields[0, 5, 1] += 12 * IRON_STD
    if sensor == "gyroscope":
        a, b = truth.intervals[5, 1], truth.intervals[6, 0]
        rows[0, a:b] += 0.01 / (b - a) / 0.02 * np.array([1.0, -1.0, 1.0])
    for found in fits_of(truth, poses, rows, fields):
        told = {each.name: each for each in found.noise.sensors}
        expected = {name: (5,) if name == sensor else () for name in told}
        assert {name: each.outliers for name, each in told.items()} == expected
        text = " ".join(str(found).split())  # the short view has what does not belong
        assert all(str(each.remark) in text for each in told.values() if each.outliers)
        every = " ".join(" ".join(lines(found.account, verbose=True)).split())
        assert every.count("farthest off") >= len(told)
        assert "least determined" in every
        if sensor in told:
            assert told[sensor].worst == 5
        if sensor is None:  # the parts are the whole, with turns as well
            whole = np.sum([(s.chi_square, s.dof) for s in told.values()], axis=0)
            chi_square = found.chi2_per_dof * found.dof
            np.testing.assert_allclose(whole, [chi_square, found.dof], rtol=1e-6)


def spoilt(truth, seed, sensor):
    """Noise of one 3 to 8 times what is stated, or a second off by 10 to 100 of it."""
    rng = np.random.default_rng([32, seed])
    data = dict(zip(PARTS, drawn(truth, 1, rng), strict=True))
    if sensor is None:
        return data.values()
    y, clock = data[sensor], truth.time[truth.intervals.sum(axis=1) // 2]
    std = truth.pose_std.max() if sensor == "accelerometer" else IRON_STD
    of_rows = 1.0
    if sensor == "gyroscope":
        clock, std, of_rows = truth.time, WALK, (truth.time[1] - truth.time[0]) ** -0.5
    if seed % 2:
        more = rng.uniform(3.0, 8.0) * std * of_rows
        y += more * rng.standard_normal(y.shape)
    else:
        late = clock - rng.uniform(0.2, 0.8) * clock[-1]
        inside = (late > 0) & (late <= max(1.0, np.diff(clock).min()))
        y[0, inside] += std * 10.0 ** rng.uniform(1.0, 2.0) * rng.choice([-1.0, 1.0], 3)
    return data.values()


SEEDS = [
    pytest.param(range(5), marks=pytest.mark.ci),
    pytest.param(range(100), marks=pytest.mark.slow),
]


@pytest.mark.parametrize("sensor", [None, *PARTS])
@pytest.mark.parametrize("seeds", SEEDS)
def test_a_fault_in_one_sensor_leaves_the_others_within_their_bars(
    truth, sensor, seeds
):
    asked_more, off = 0, {name: [] for name in PARTS if name != sensor}
    for seed in seeds:
        data = spoilt(truth, seed, sensor)
        try:
            *_, fit = fits_of(truth, *data)
        except RefusedError:
            assert sensor is not None
            continue
        asked_more += not fit.noise.borne
        for name, values in off.items():
            at, error = PARTS[name], fit.parameters - TRUTH
            nees = squares(error[at], fit.covariance[at, at])
            values.append((np.abs(error / fit.sd)[at].max(), nees))
    if sensor is None:
        assert asked_more <= stats.binom.isf(1e-5, len(seeds), CHANCE)
    else:
        assert asked_more >= len(seeds) // 3  # the others are too small to be seen
    for name, values in off.items():
        count, found = PARTS[name].stop - PARTS[name].start, np.array(values)
        assert found[:, 0].max() < 6.0
        # of as many parameters, one false alarm in 1e5
        beyond = np.count_nonzero(found[:, 0] > 3.0)
        chance = stats.binom.isf(1e-5, len(found), 1.0 - 0.9973**count)
        assert beyond <= max(chance, 1)
        if sensor is None:
            low, high = stats.chi2.ppf([5e-6, 1.0 - 5e-6], count * len(found))
            assert low < found[:, 1].sum() < high
