"""Running a user's filter: what comes out of a sound one, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from filters_that_are_wrong import RIGHT, ROWS, WRONG, Rate, declared
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sound_filters import WORLDS, kalman, told, tumbling

from simval.errors import CrashedPluginError, PluginError
from simval.geometry import attitude_matrix
from simval.plugins import run_filter
from simval.plugins.protocol import READS

GIVEN, TRUTH = tumbling(3, ROWS)
KEEP = np.arange(0, ROWS, 7)


def message_of(filter, given=GIVEN):
    with np.errstate(all="ignore"), pytest.raises(PluginError) as refused:
        run_filter(filter, given, KEEP, "NWU")
    return str(refused.value)


def check_refused(name, seeds):
    drawn, said = WRONG[name]
    for seed in seeds:
        message = message_of(drawn(np.random.default_rng(seed)))
        assert re.search(said, message), (name, seed, message)
        assert message.startswith(("wrong", "`make` of wrong", "two of wrong"))


@pytest.mark.parametrize("name", WRONG)
def test_wrong_filters_are_refused_in_words(name):
    check_refused(name, range(8))


@pytest.mark.parametrize("name", RIGHT)
def test_right_filters_are_accepted(name):
    found = run_filter(RIGHT[name], GIVEN, KEEP, "NWU")
    assert found.attitude.shape == (3, len(KEEP), 4)


@pytest.mark.parametrize("first", [0, 1030])
def test_a_batch_that_keeps_state_is_refused(first):
    """It is run again to its first kept row at the least, and 1000 rows."""
    past = []

    class Batch:
        def __init__(self, start):
            past.append(None)
            self.q = start

        def update(self, dt, w, f, m):
            q = self.q + 1e-9 * len(past)
            return q / np.linalg.norm(q, axis=1, keepdims=True)

    filter = declared(Batch, batch=True)
    given, _ = tumbling(2, 1040, noise=False)
    with pytest.raises(PluginError, match=f"at row {first} .*random numbers"):
        run_filter(filter, given, np.arange(first, 1040, 3), "NWU")


def test_what_raises_has_crashed():
    """A filter that breaks a rule is refused, one that raises has crashed."""
    drawn, _ = WRONG["raises"]
    with pytest.raises(CrashedPluginError):
        run_filter(drawn(np.random.default_rng(0)), GIVEN, KEEP, "NWU")


@pytest.mark.parametrize("name", ["not_finite", "raises"])
def test_the_row_and_the_trial_are_told(name):
    row = next(r for r in range(ROWS) if r % 2)

    class Late(Rate):
        def update(self, dt, w, f, m):
            q = self.step(dt, w)
            if self.k == row and self.trial == 1:
                if name == "raises":
                    raise ValueError
                return np.full(4, np.nan)
            return q

    made = []

    def make(start):
        made.append(None)
        filter = Late(start)
        filter.trial = len(made) - 1
        return filter

    message = message_of(declared(make))
    assert f"at row {row} ({(row + 1) / 100:g} s) of trial 1" in message


def test_an_attitude_of_another_form_is_told_its_declaration():
    class Matrix(Rate):
        def update(self, dt, w, f, m):
            self.step(dt, w)
            return np.eye(3)

    assert 'declare components="matrix"' in message_of(declared(Matrix))
    quaternion = declared(Rate, components="matrix", reads=())
    assert "declare the order of the `components`" in message_of(quaternion)


def test_a_reading_that_is_missing_is_not_taken_for_a_change():
    m = GIVEN.magnetometer.copy()
    m[:, 3::4] = np.nan
    found = run_filter(declared(Rate), replace(GIVEN, magnetometer=m), KEEP, "NWU")
    assert np.isfinite(found.attitude).all()


def test_takes_no_magnetometer_unless_declared():
    class Six(Rate):
        def update(self, dt, w, f):
            return self.step(dt, w)

    six = declared(Six, magnetometer=False)
    assert run_filter(six, GIVEN, KEEP, "NWU").attitude.shape == (3, len(KEEP), 4)
    assert "raised TypeError" in message_of(replace(six, magnetometer=True))


def test_handed_what_it_reads_in_its_own_words():
    seen = {}

    def make(**reads):
        seen.update(reads)
        return Rate()

    run_filter(declared(make, reads=READS), GIVEN, KEEP, "ENU")
    known = told()
    east, north, up = seen["field"]
    assert (north, -east, up) == pytest.approx(tuple(known.field), rel=1e-15)
    assert seen["rate"] == pytest.approx(100.0, rel=1e-12)
    for word in set(READS) - {"start", "field", "rate"}:
        assert seen[word] == getattr(known, word)
        assert type(seen[word]) is float


CONVENTIONS = [
    (world, components, matrix, side, force)
    for i, world in enumerate(WORLDS)
    for components, matrix, side, force in [
        (
            ("xyzs", "sxyz", "matrix")[i % 3],
            ("active", "passive")[i % 2],
            ("reference", "body")[i // 2 % 2],
            (1.0, -1.0)[i // 4],
        )
    ]
]


def errors_of(filter, given, truth, keep, world):
    """What a filter answers, and its errors, estimate less truth, on the body side."""
    found = run_filter(filter, given, keep, world)
    off = truth[:, keep] @ np.swapaxes(attitude_matrix(found.attitude), -1, -2)
    angles = Rotation.from_matrix(off.reshape(-1, 3, 3)).as_rotvec()
    return found, angles.reshape(*found.attitude.shape[:2], 3)


@pytest.mark.ci
def test_every_convention_gives_the_same_answer():
    """Conversions of the filter are SciPy's and those of the test: 8 of all 192."""
    given, truth = tumbling(2, ROWS)
    first, errors = errors_of(kalman(), given, truth, KEEP, "NWU")
    eps = np.finfo(float).eps
    for world, components, matrix, side, force in CONVENTIONS:
        other = kalman(world, components, matrix, side, force)
        found, own = errors_of(other, given, truth, KEEP, world)
        # rounding of some 1e3 operations of size 1, and of a covariance 6 to a side
        assert np.abs(own - errors).max() < 1e3 * eps
        scale = np.abs(first.covariance).max(axis=(-2, -1), keepdims=True)
        apart = np.abs(found.covariance - first.covariance) / scale
        assert apart.max() < 1e4 * eps * 6
        np.testing.assert_allclose(found.bias, first.bias, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors():
    """NEES of 3 and 6 over independent trials at the last row: one run in 1e4 fails.

    The start is drawn, so that the filter's own belief is true; power: on the wrong
    side, or with the bias' sign turned, the same errors are refused.
    """
    trials, limit = 60, 1e-4 / 4
    given, truth = tumbling(trials, 100, seed=5)
    rng = np.random.default_rng(6)
    known = given.told
    off = rng.normal(0.0, known.start_std, (trials, 3))
    started = Rotation.from_quat(given.start) * Rotation.from_rotvec(off)
    bias = rng.normal(0.0, known.bias_std, (trials, 3))
    drawn = replace(
        given, start=started.as_quat(), gyroscope=given.gyroscope + bias[:, None]
    )
    last = np.array([99])
    filter = kalman("ENU", "matrix", "active", "reference")
    found, angles = errors_of(filter, drawn, truth, last, "ENU")
    errors = np.concatenate([angles, found.bias - bias[:, None]], axis=2)[:, 0]
    P = found.covariance[:, 0]
    for p in (3, 6):
        nees = [
            e[:p] @ np.linalg.solve(C[:p, :p], e[:p])
            for e, C in zip(errors, P, strict=True)
        ]
        low, high = chi2.ppf([limit, 1.0 - limit], p * trials)
        assert low < np.sum(nees) < high
    turned = errors * [1, 1, 1, -1, -1, -1]
    wrong = [e @ np.linalg.solve(C, e) for e, C in zip(turned, P, strict=True)]
    assert np.sum(wrong) > chi2.ppf(1.0 - limit, 6 * trials)


class Slow(Rate):
    """Its step goes through all rows so far, or not."""

    grows = True

    def __init__(self, start):
        super().__init__(start)
        self.past = []

    def update(self, dt, w, f, m):
        self.past.append(w if self.grows else w * 0.0)
        np.sum(np.array(self.past if self.grows else self.past[-1:]), axis=0)
        return self.step(dt, w)


@pytest.mark.ci
def test_a_step_that_takes_longer_and_longer_is_refused():
    given, _ = tumbling(1, 640, noise=False)
    with pytest.raises(PluginError, match="takes longer and longer: a row takes"):
        run_filter(declared(Slow), given, KEEP, "NWU")
    even = declared(type("Even", (Slow,), {"grows": False}))
    assert len(run_filter(even, given, KEEP, "NWU").seconds) == 5
