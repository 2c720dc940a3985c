"""The reference filter: its equations by other routes, and its trials."""

import numpy as np
import pytest
from filter_paths import FIELD, UP, G, corrected, cross, propagated, step
from filter_trials import FAULTS, NOISE, SKIP, expected, gimbal, model_of, trials
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.imu.filters import Mekf, mekf
from simval.theory import FilterPath, filter_bound, first_update

TOLD = {**NOISE, "gravity": G, "field": FIELD}


def filter_of(n=3, seed=0, **options):
    q = np.random.default_rng(seed).standard_normal((n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return Mekf(start=q, **{**TOLD, **options}), q


def readings(rng, n=3):
    return (
        rng.standard_normal((n, 3)),
        UP + rng.standard_normal((n, 3)),
        FIELD * (1.0 + 0.1 * rng.standard_normal((n, 3))),
    )


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.00999, 0.01001, 1.0, 3.0])
def test_steps_by_scipy(size):
    """Three rows from rotations and (F10), turns of these sizes, the first two blind.

    Without a reading the covariance shows the transition to rounding, on both sides of
    where its series ends.
    """
    ours, q = filter_of(bias_std=0.02)
    rng, h = np.random.default_rng(1), 0.05
    A = [Rotation.from_quat(each) for each in q]
    b, before = np.zeros((3, 3)), np.zeros((3, 3))
    P = np.tile(np.diag(np.repeat([0.05**2, 0.02**2], 3)), (3, 1, 1))
    R = np.diag(np.concatenate([np.square(s.std) for s in model_of().sensors]))
    _, *noise = step(np.zeros(3), h, model_of())  # the filter takes J for 1 in Q alone
    for blind in (True, True, False, False):
        w, f, m = readings(rng)
        w *= size / h / np.linalg.norm(w, axis=1, keepdims=True)
        answer = ours.update(h, w, *((None, None) if blind else (f, m)))
        for i in range(3):
            S = h * (w[i] - b[i])
            phi = S + np.cross(before[i], S) / 12.0
            before[i] = S
            A[i] = A[i] * Rotation.from_rotvec(phi)
            P[i] = propagated(P[i], step(phi, h, model_of())[0], *noise)
            limit = 1e-12
            if not blind:
                v = A[i].inv().apply(np.stack([UP, FIELD]))
                H = np.zeros((6, 6))
                H[:3, :3], H[3:, :3] = cross(v[0]), cross(v[1])
                z = np.concatenate([f[i] - v[0], m[i] - v[1]])
                np.testing.assert_allclose(
                    answer["innovation_covariance"][i], H @ P[i] @ H.T + R,
                    rtol=1e-11, atol=1e-22,
                )  # fmt: skip
                P[i], _, K = corrected(P[i], H, R)
                d = K @ z
                A[i], b[i] = A[i] * Rotation.from_rotvec(d[:3]), b[i] + d[3:]
                np.testing.assert_allclose(
                    answer["innovation"][i], z, rtol=0, atol=1e-12
                )
                # 1 - K H loses the square of the prior's sd over the posterior's: 1e3
                limit = 1e-10
            off = A[i].inv() * Rotation.from_quat(answer["attitude"][i])
            assert off.magnitude() < 1e-12
            np.testing.assert_allclose(answer["bias"][i], b[i], rtol=0, atol=1e-12)
            root = np.sqrt(np.diagonal(P[i]))
            apart = (answer["covariance"][i] - P[i]) / np.outer(root, root)
            assert np.abs(apart).max() < limit


@pytest.mark.ci
def test_coning_term():
    """Without noise the averages of 100 Hz integrate to the attitude, or do not."""
    truth = gimbal().part(320)  # the first move is over
    off = {}
    for coning in (True, False):
        sure = dict(TOLD, start_std=0.0, bias_std=0.0, accelerometer_noise=1e6,
                    magnetometer_noise=1e6, coning=coning)  # fmt: skip
        ours = Mekf(start=truth.path.attitude[0], **sure)
        for k, h in enumerate(truth.path.dt):
            rows = (truth.rate[k], truth.force[k], truth.field[k])
            answer = ours.update(h, *rows)
        left = Rotation.from_quat(answer["attitude"]).inv()
        left = left * Rotation.from_quat(truth.path.attitude[-1])
        off[coning] = left.magnitude()
    # 2.7e-7 and 2.7e-5 rad: the term of the step before leaves a sum that telescopes
    assert off[True] < 1e-6
    assert off[False] > 2e-5


def test_trials_are_their_own():
    """A batch is its trials one by one; nothing that was given or answered changes."""
    rng = np.random.default_rng(3)
    ours, q = filter_of()
    single = [Mekf(start=each, **TOLD) for each in q]
    kept, copies = [], []
    for _ in range(3):
        rows = readings(rng)
        given = [row.copy() for row in rows]
        answer = ours.update(0.02, *rows)
        for row, copy in zip(rows, given, strict=True):
            np.testing.assert_array_equal(row, copy)
        kept.append(answer)
        copies.append({name: value.copy() for name, value in answer.items()})
        for i, one in enumerate(single):
            alone = one.update(0.02, *(row[i] for row in rows))
            for name, value in alone.items():
                # sums of other lengths in BLAS: rounding, of the largest entries
                atol = 1e-12 * max(np.abs(value).max(), 1e-12)
                np.testing.assert_allclose(answer[name][i], value, rtol=0, atol=atol)
    for answer, copy in zip(kept, copies, strict=True):
        for name, value in answer.items():
            np.testing.assert_array_equal(value, copy[name])


def test_a_row_may_lack_a_sensor():
    ours, q = filter_of()
    A = Rotation.from_quat(q).inv()
    w, f, m = np.zeros((3, 3)), A.apply(UP), A.apply(FIELD)  # as the estimate has them
    answer = ours.update(0.02, w, f)
    assert answer["innovation"].shape == (3, 3)
    assert answer["innovation_covariance"].shape == (3, 3, 3)
    blind = ours.update(0.02, w, None, None)
    assert blind["innovation"].shape == (3, 0)
    assert np.all(np.trace(blind["covariance"], axis1=1, axis2=2)
                  > np.trace(answer["covariance"], axis1=1, axis2=2))  # fmt: skip
    # the two sensors in one row are the same as both apart, in a step of no time
    other, _ = filter_of()
    both, _ = filter_of()
    whole = both.update(0.02, w, f, m)["covariance"]
    other.update(0.02, w, f, None)
    nearly = other.update(1e-12, w, None, m)["covariance"]
    sd = np.sqrt(np.einsum("nii->ni", whole))
    # rounding: 1 - K H loses the square of the prior's sd over the posterior's, 1e3
    assert np.abs((nearly - whole) / (sd[:, :, None] * sd[:, None])).max() < 1e-9


def test_first_update_from_a_far_start():
    """Theory's one update is this filter's, and its spread that of its derivatives."""
    h, turn = 0.01, np.array([0.25, -0.1, 0.15])
    q = np.array([0.1, -0.5, 0.3, 0.8])
    q /= np.linalg.norm(q)
    path = FilterPath(dt=np.full(2, h), attitude=np.tile(q, (3, 1)))
    told = model_of({**NOISE, "start_std": 0.3})
    truth = model_of({**NOISE, "start_std": 0.01})
    first = first_update(path, truth, turn, told=told)
    start = (Rotation.from_quat(q) * Rotation.from_rotvec(-turn)).as_quat()
    true = Rotation.from_quat(q)

    def error(x):
        """Error after a row: truth turned by x, bias x, noise of the readings."""
        A = true * Rotation.from_rotvec(x[:3])
        ours = Mekf(start=start, **{**TOLD, "start_std": 0.3})
        f, m = (A.inv().apply(each) for each in (UP, FIELD))
        got = ours.update(h, np.zeros(3), f + x[6:9], m + x[9:])
        left = Rotation.from_quat(got["attitude"]).inv() * A
        return np.r_[left.as_rotvec(), x[3:6] - got["bias"]], got

    left, got = error(np.zeros(12))
    np.testing.assert_allclose(first.error, left, rtol=0, atol=1e-12)
    assert 0.003 < np.linalg.norm(left[:3]) < 0.05
    sd = np.sqrt(np.diagonal(got["covariance"]))
    # 1 - K H loses the square of 0.3 rad over 2 mrad, 2e4, and half of it
    assert (
        np.abs((first.told.start - got["covariance"]) / np.outer(sd, sd)).max() < 1e-9
    )
    size = np.r_[np.full(6, 1e-5), np.full(3, 1e-4), np.full(3, 1e-9)]
    J = np.stack(
        [(error(s * e)[0] - error(-s * e)[0]) / (2 * s)
         for s, e in zip(size, np.eye(12), strict=True)], axis=1,
    )  # fmt: skip
    noise = [NOISE["accelerometer_noise"], NOISE["magnetometer_noise"]]
    whole = np.zeros((12, 12))
    whole[:6, :6] = propagated(truth.start, *step(np.zeros(3), h, truth))
    whole[6:, 6:] = np.diag(np.repeat(np.square(noise), 3))
    wanted = J @ whole @ J.T
    sd = np.sqrt(np.diagonal(wanted))
    # differences: 1e-10 of third derivatives, and 1e-16/1e-5 of J's entries, by 10
    assert np.abs((first.truth.start - wanted) / np.outer(sd, sd)).max() < 1e-6
    assert len(first.path.dt) == 1
    np.testing.assert_array_equal(first.truth.sensors[0].rows, [True])


SIZES = {"attitude": 3.0, "whole": 6.0, "nis": 6.0}


def scores(found, skip=0):
    """Standard errors between the simulated means and what they should be."""
    means = {name: found.mean(name, skip) for name in SIZES}
    return {name: (m - SIZES[name]) / se for name, (m, se) in means.items()}


def consistent(found):
    """Whether no mean is more than three standard errors away."""
    return max(abs(z) for z in scores(found).values()) <= 3.0


def over_bound(found, truth):
    """Root mean square error over the bound."""
    bound = filter_bound(truth.path, model_of())
    square = bound.attitude_sd[SKIP:] ** 2
    return np.sqrt(found.square[SKIP:].sum() / square.sum())


@pytest.mark.ci
def test_consistent_in_short():
    """The first 3 s, 60 trials; a filter without the truth's walk of angle is seen."""
    truth = gimbal().part(320)
    found = trials(truth, 60, 31)
    assert consistent(found)
    assert over_bound(found, truth) < 1.05
    assert not consistent(trials(truth, 60, 31, told={"gyroscope_noise": 0.0}))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("every", "timestep", "rows", "seed"),
    [(5, 0.002, None, 11), (1, 0.001, 15_000, 21)],
)
def test_consistent_and_at_the_bound(every, timestep, rows, seed):
    """At 100 Hz and at 1 kHz."""
    truth = gimbal(every=every, timestep=timestep)
    truth = truth.part(rows) if rows else truth
    found = trials(truth, 350, seed)
    assert consistent(found)
    assert over_bound(found, truth) <= 1.02
    if every == 5:
        # power: what the coning term takes away is 0.13 of 3, four standard errors
        assert scores(trials(truth, 350, seed, coning=False))["attitude"] > 3.0


@pytest.mark.slow
def test_every_fault_as_predicted():
    """Forty trials each: the means, and beside the same trials without the fault."""
    truth, n, seed = gimbal(), 40, 41
    sound = FAULTS[0].run(truth, n, seed)
    for fault in FAULTS[1:]:
        found, wanted = fault.run(truth, n, seed), fault.predicted(truth)
        second = 0.05 if fault.lever else 0.02  # errors to 0.013 rad
        for name, theory in expected(wanted).items():
            each = (getattr(found, name) - getattr(sound, name))[SKIP:].mean(axis=0)
            change = theory[SKIP:].mean() - SIZES[name]
            room = 4.0 * each.std(ddof=1) / np.sqrt(n) + second * abs(change)
            assert abs(each.mean() - change) < room, (fault.name, name)
        # power: each fault is told from a sound filter, and NIS alone misses most
        assert abs(scores(found, skip=SKIP)["whole"]) > 3.0 or fault.name in SMALL


SMALL = ("no coning term", "scale wrong by 0.0001")
"""Below three standard errors of 40 trials, and seen beside the same draws."""


COMPILED = mekf._compiled()
needs_it = pytest.mark.skipif(
    COMPILED is None, reason="the filter is not compiled here: make .venv/installed"
)


def in_numpy(own, dt, y):
    return own._in_numpy(dt, y)


def in_c(own, dt, y):
    return own._in_c(COMPILED, dt, y)


@needs_it
@pytest.mark.parametrize("coning", [True, False])
@pytest.mark.parametrize("some", [(1, 1), (1, 0), (0, 1), (0, 0)])
@pytest.mark.parametrize("lead", [(), (3,)])
def test_the_compiled_form_is_the_numpy_form(coning, some, lead):
    """Slow and fast turns, either sensor, two stretches: 1e-12 of the greatest."""
    rng = np.random.default_rng(5)
    rate = rng.standard_normal((2, 40, *lead, 3)) * np.geomspace(
        1e-9, 300.0, 40
    ).reshape(40, *(1 for _ in lead), 1)
    force = UP + rng.standard_normal(rate.shape)
    field = FIELD * (1.0 + 0.1 * rng.standard_normal(rate.shape))
    given = [force if some[0] else None, field if some[1] else None]
    dt = rng.uniform(1e-3, 2e-2, (2, 40))
    found = []
    for form in (in_numpy, in_c):
        _, q = filter_of()
        told = TOLD | {"gyroscope_walk": 0.1, "coning": coning}
        own = Mekf(start=q if lead else q[0], **told)
        parts = [
            form(own, dt[k], [rate[k], *(a if a is None else a[k] for a in given)])
            for k in range(2)
        ]
        found.append({word: np.stack([p[word] for p in parts]) for word in mekf.WORDS})
    for word, wanted in found[0].items():
        off = np.abs(found[1][word] - wanted).max(initial=0.0)
        assert off <= 1e-12 * np.abs(wanted).max(initial=0.0), word


@needs_it
@pytest.mark.parametrize("shape", [(257, 2), (2, 257)])
def test_many_rows_and_many_trials_are_taken_whole(shape):
    """The first 99, 100, 101 and 257 of either are NumPy's, and so is what follows."""
    rng = np.random.default_rng(6)
    dt, (_, q) = rng.uniform(1e-3, 2e-2, shape[0]), filter_of(shape[1])
    each = [readings(rng, shape[1]) for _ in dt]
    y = [np.stack(column) for column in zip(*each, strict=True)]
    more = readings(rng, shape[1])
    wanted = in_numpy(Mekf(start=q, **TOLD), dt, y)
    for count in (99, 100, 101, 257):
        rows, trials = (slice(min(count, size)) for size in shape)
        own, other = (Mekf(start=q[trials], **TOLD) for _ in range(2))
        found = own.update_rows(dt[rows], *(each[rows, trials] for each in y))
        in_numpy(other, dt[rows], [each[rows, trials] for each in y])
        after = [
            form(each, dt[:1], [reading[None, trials] for reading in more])
            for form, each in ((in_c, own), (in_numpy, other))
        ]
        for word, value in wanted.items():
            for ours, its in (
                (found[word], value[rows, trials]),
                (after[0][word], after[1][word]),
            ):
                assert ours.shape == its.shape
                assert np.abs(ours - its).max() <= 1e-12 * np.abs(its).max(), word


def unaligned(rows):
    held = np.zeros(1 + rows.nbytes, dtype=np.uint8)[1:].view(float)
    held = held.reshape(rows.shape)
    held[:] = rows
    assert not held.flags.aligned
    return held


def read_only(rows):
    rows = rows.copy()
    rows.flags.writeable = False
    return rows


FORMS = {
    "byte order stated": lambda rows: rows.astype(rows.dtype.newbyteorder("<")),
    "the other byte order": lambda rows: rows.astype(">f8"),
    "columns first": np.asfortranarray,
    "strides": lambda rows: np.repeat(rows, 2, axis=-1)[..., ::2],
    "backwards": lambda rows: rows[..., ::-1].copy()[..., ::-1],
    "read only": read_only,
    "from a file's middle": unaligned,
    "float32": lambda rows: rows.astype(np.float32),
    "int16": lambda rows: rows.astype(np.int16),
    "long doubles": lambda rows: rows.astype(np.longdouble),
    "objects": lambda rows: rows.astype(object),
    "a subclass": lambda rows: rows.view(np.recarray),
    "lists": lambda rows: rows.tolist(),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_rows_of_any_layout_are_taken(form):
    """As the same doubles to the bit, by `update_rows` and by `update`."""
    rows, dt = np.arange(18.0).reshape(2, 3, 3), np.array([1.0, 2.0])
    plain, other = (
        filter_of()[0].update_rows(make(dt), *[make(rows)] * 3)
        for make in (np.copy, form)
    )
    own = filter_of()[0]
    each = [own.update(h, *[form(row)] * 3) for h, row in zip(dt, rows, strict=True)]
    for word, value in plain.items():
        np.testing.assert_array_equal(other[word], value)
        np.testing.assert_array_equal([answer[word] for answer in each], value)


@needs_it
def test_buffers_that_are_not_doubles_are_refused():
    given = [np.ones(n) for n in (1, 3, 3, 3, 15, 46, 85)]
    COMPILED.rows(*given)
    for kind in (">f8", "f4", "i8", "?", "c16", "S8"):
        with pytest.raises(ValueError, match="`gyroscope` must be of doubles"):
            COMPILED.rows(given[0], np.zeros(3, kind), *given[2:])


@needs_it
@pytest.mark.parametrize("fault", ["rows lost", "a bit", "another source"])
def test_a_compiled_form_of_other_numbers_is_not_used(fault, monkeypatch):
    class Other:
        def rows(self, *given):
            if fault == "another source":
                msg = "it takes other arguments"
                raise TypeError(msg)
            COMPILED.rows(*given)
            state, answers = given[-2:]
            if fault == "a bit":
                answers *= 1.0 + 1e-11
            else:
                state[..., 7:10] = 0.0

    assert mekf.reproduces(COMPILED)
    monkeypatch.setattr(mekf, "import_module", lambda name: Other())
    with pytest.warns(RuntimeWarning, match="install simval again"):
        assert mekf._compiled.__wrapped__() is None


@pytest.mark.parametrize("form", [in_numpy, pytest.param(in_c, marks=needs_it)])
def test_noise_that_rounding_loses_is_refused_and_no_row_taken(form):
    """At 1e-9 m/s^2 the readings' covariance is singular; NaN came of it."""
    rows = np.ones((5, 3, 3))
    for noise, lost in ((1e-9, True), (1e-5, False)):
        q = filter_of()[1]
        own = Mekf(start=q, **TOLD | {"accelerometer_noise": noise})
        dt, y = np.full(5, 0.01), [0.1 * rows, 9.8 * rows, None]
        if lost:
            before = own.P.copy()
            with pytest.raises(InputError, match="`accelerometer_noise` is 1e-09"):
                form(own, dt, y)
            np.testing.assert_array_equal(own.P, before)
        else:
            assert all(np.isfinite(value).all() for value in form(own, dt, y).values())


def test_six_axes_are_nine_without_a_magnetometer():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((2, 6, 3, 3))
    nine, q = filter_of()
    told = {w: v for w, v in TOLD.items() if w not in ("field", "magnetometer_noise")}
    six = Mekf(start=q, **told)
    dt = np.full(6, 0.01)
    answers = six.update_rows(dt, *rows)
    for word, value in nine.update_rows(dt, *rows).items():
        np.testing.assert_array_equal(answers[word], value)
    with pytest.raises(InputError, match="six axes"):
        six.update(0.01, *rows[:, 0], rows[0, 0])
    with pytest.raises(InputError, match="both, or neither"):
        Mekf(start=q, **told, field=[2e-5, 0.0, -4e-5])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"dt": [0.01, 0.0]}, "above 0 s"),
        ({"dt": 0.01}, "`dt`"),
        ({"gyroscope": np.zeros((3, 3, 3))}, "`gyroscope` has shape"),
        ({"gyroscope": None}, "`gyroscope` is not an array"),
        ({"magnetometer": np.full((2, 3, 3), np.nan)}, "`magnetometer`"),
    ],
)
def test_rows_that_cannot_be_taken_are_refused(wrong, words):
    own, q = filter_of()
    rows = np.ones((2, 3, 3))
    given = {"dt": [0.01, 0.01], "gyroscope": rows, "accelerometer": rows} | wrong
    with pytest.raises(InputError, match=words):
        own.update_rows(**given)
    np.testing.assert_array_equal(own.q, q)
