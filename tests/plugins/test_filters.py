"""A user's filter: run, its frame found, its signs asked; wrong ones are told so."""

import itertools
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from places import EXAMPLES
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sound_filters import (
    KALMAN_READS,
    WORLDS,
    Complementary,
    Kalman,
    cross,
    from_nwu,
    kalman,
    spelled,
    told,
    tumbling,
)
from zoo import ROWS, ZOO, Rate, drawn, filtering, named

from simval.errors import CrashedPluginError, PluginError
from simval.geometry import attitude_error, attitude_matrix
from simval.plugins import Filter, find_plugin, find_world, run_filter
from simval.plugins.protocol import ANSWERS, READS

GIVEN, TRUTH = tumbling(3, ROWS)
KEEP = np.arange(0, ROWS, 7)
FORMS = list(itertools.product(("xyzs", "sxyz", "matrix"), ("active", "passive")))
MEANINGS = ("specific force", "gravity")
DECLARATIONS = list(itertools.product(WORLDS, FORMS, MEANINGS))
UPSIDE_DOWN = {"NWU": "NED", "ENU": "WND", "SEU": "SWD", "WSU": "ESD"}
UPSIDE_DOWN |= {down: up for up, down in UPSIDE_DOWN.items()}
RATE = 10.0
"""Hz, of a quick search for a world."""


def message_of(filter, given=GIVEN):
    with np.errstate(all="ignore"), pytest.raises(PluginError) as refused:
        run_filter(filter, given, KEEP, "NWU")
    return str(refused.value)


@pytest.mark.parametrize("name", named(Filter, wrong=True))
def test_wrong_filters_are_refused_in_words(name):
    for draw in range(4):
        filter, _ = drawn(name, draw)
        message = message_of(filter)
        assert re.search(ZOO[name].words, message), (draw, message)
        assert message.startswith(("wrong", "`make` of wrong", "two of wrong"))


@pytest.mark.parametrize("name", named(Filter, wrong=False))
def test_sound_filters_are_accepted(name):
    found = run_filter(drawn(name)[0], GIVEN, KEEP, "NWU")
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

    given, _ = tumbling(2, 1040, noise=False)
    filter, keep = filtering(Batch, batch=True), np.arange(first, 1040, 3)
    with pytest.raises(PluginError, match=f"at row {first} .*random numbers"):
        run_filter(filter, given, keep, "NWU")


@pytest.mark.parametrize("crashes", [False, True])
def test_the_row_and_the_trial_are_told(crashes):
    """One that breaks a rule is refused, one that raises has crashed."""
    made = []

    class Late(Rate):
        def __init__(self, start):
            super().__init__(start)
            made.append(self)

        def update(self, dt, w, f, m):
            q = self.step(dt, w)
            if self.k == 5 and len(made) == 2:
                if crashes:
                    raise ValueError
                return np.full(4, np.nan)
            return q

    with pytest.raises(PluginError, match=r"at row 5 \(0\.06 s\) of trial 1") as error:
        run_filter(filtering(Late), GIVEN, KEEP, "NWU")
    assert isinstance(error.value, CrashedPluginError) is crashes


def test_an_attitude_of_another_form_is_told_its_declaration():
    class Matrix(Rate):
        def update(self, dt, w, f, m):
            return np.eye(3)

    assert 'declare components="matrix"' in message_of(filtering(Matrix))
    quaternion = filtering(Rate, components="matrix", reads=())
    assert "declare the order of the `components`" in message_of(quaternion)


def test_a_reading_that_is_missing_is_not_taken_for_a_change():
    m = GIVEN.magnetometer.copy()
    m[:, 3::4] = np.nan
    found = run_filter(filtering(Rate), replace(GIVEN, magnetometer=m), KEEP, "NWU")
    assert np.isfinite(found.attitude).all()


def test_what_it_is_handed():
    class Six(Rate):
        def update(self, dt, w, f):
            return self.step(dt, w)

    six = filtering(Six, magnetometer=False)
    assert run_filter(six, GIVEN, KEEP, "NWU").attitude.shape == (3, len(KEEP), 4)
    assert "raised TypeError" in message_of(replace(six, magnetometer=True))
    seen = {}

    def make(**reads):
        seen.update(reads)
        return Rate()

    run_filter(filtering(make, reads=READS), GIVEN, KEEP, "ENU")
    known = told()
    east, north, up = seen["field"]
    assert (north, -east, up) == pytest.approx(tuple(known.field), rel=1e-15)
    assert seen["rate"] == pytest.approx(100.0, rel=1e-12)
    for word in set(READS) - {"start", "field", "rate"}:
        assert seen[word] == getattr(known, word)
        assert type(seen[word]) is float


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
    for i, world in enumerate(WORLDS):
        components, matrix = ("xyzs", "sxyz", "matrix")[i % 3], FORMS[i % 2][1]
        side = ("reference", "body")[i // 2 % 2]
        other = kalman(world, components, matrix, side, (1.0, -1.0)[i // 4])
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

    The start is drawn, so that the filter's own belief is true; power: with the bias'
    sign turned, the same errors are refused.
    """
    trials, limit = 60, 1e-4 / 4
    given, truth = tumbling(trials, 100, seed=5)
    rng = np.random.default_rng(6)
    known = given.told
    off = rng.normal(0.0, known.start_std, (trials, 3))
    started = Rotation.from_quat(given.start) * Rotation.from_rotvec(off)
    bias = rng.normal(0.0, known.bias_std, (trials, 3))
    moved = given.gyroscope + bias[:, None]
    made = replace(given, start=started.as_quat(), gyroscope=moved)
    filter = kalman("ENU", "matrix", "active", "reference")
    found, angles = errors_of(filter, made, truth, np.array([99]), "ENU")
    errors = np.concatenate([angles, found.bias - bias[:, None]], axis=2)[:, 0]

    def nees(errors, p):
        pairs = zip(errors, found.covariance[:, 0], strict=True)
        return sum(e[:p] @ np.linalg.solve(C[:p, :p], e[:p]) for e, C in pairs)

    for p in (3, 6):
        low, high = chi2.ppf([limit, 1.0 - limit], p * trials)
        assert low < nees(errors, p) < high
    assert nees(errors * [1, 1, 1, -1, -1, -1], 6) > high


@pytest.mark.ci
@pytest.mark.parametrize("grows", [False, True])
def test_a_step_that_takes_longer_and_longer_is_refused(grows):
    class Slow(Rate):
        def __init__(self, start):
            super().__init__(start)
            self.past = []

        def update(self, dt, w, f, m):
            self.past.append(np.tile(w, 20))
            np.sort(np.ravel(self.past if grows else self.past[-1:]))
            return self.step(dt, w)

    given, _ = tumbling(1, 640, noise=False)
    if grows:
        with pytest.raises(PluginError, match="takes longer and longer: a row takes"):
            run_filter(filtering(Slow), given, KEEP, "NWU")
    else:
        assert len(run_filter(filtering(Slow), given, KEEP, "NWU").seconds) == 5


# its world, and what it declares


class Compass:
    """Up and north of each row, with no memory: the rate is not asked."""

    def __init__(self, world, form, sign):
        self.C, self.form, self.sign = from_nwu(world), form, sign

    def update(self, dt, w, f, m):
        up = self.sign * f / np.linalg.norm(f)
        west = cross(up) @ m
        west /= np.linalg.norm(west)
        north = cross(west) @ up
        return spelled(np.stack([north, west, up], axis=1) @ self.C.T, *self.form)


def declaring(make, declared, **more):
    world, (components, matrix), meaning = declared
    words = {"components": components, "matrix": matrix, "accelerometer": meaning}
    return Filter(name="mine", make=make, world=world, **words, **more)


def compass(true, declared):
    """A filter of the first declarations that declares the others."""
    world, form, meaning = true
    sign = 1.0 if meaning == "specific force" else -1.0
    return declaring(lambda: Compass(world, form, sign), declared)


def pulled(true, declared, share=0.02):
    """One that starts from the truth, of a specific force."""
    world, form, _ = true
    return declaring(
        lambda start: Complementary(world, form, share, start),
        declared,
        reads=("start",),
    )


def same(one, other):
    """Whether declarations are the same, or each other upside down."""
    flipped = (one[0], one[2]) != (other[0], other[2])
    upside = (UPSIDE_DOWN[one[0]], *{*MEANINGS} - {one[2]})
    return one[1] == other[1] and (not flipped or (other[0], other[2]) == upside)


def require_found(made, true, declared):
    """A right declaration stands, a wrong one is told the right one."""
    filter = made(true, declared)
    if same(true, declared):
        assert find_world(filter, told(), RATE).world == declared[0]
        return
    with pytest.raises(PluginError, match=r"mine (strays|fails)") as error:
        find_world(filter, told(), RATE)
    advice = str(error.value).partition("; declare ")[2].partition(": so it")[0]
    right = replace(filter, **dict(re.findall(r'(\w+)="([^"]+)"', advice)))
    words = (right.world, (right.components, right.matrix), right.accelerometer)
    assert same(true, words), str(error.value)


@pytest.mark.ci
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_declaration_is_told_the_right_one(seed):
    rng = np.random.default_rng(seed)
    true, other = (DECLARATIONS[i] for i in rng.integers(len(DECLARATIONS), size=2))
    require_found(compass, true, other)
    right = (*true[:2], "specific force")
    require_found(pulled, right, right)
    require_found(pulled, right, other)


@pytest.mark.ci
@pytest.mark.parametrize("form", FORMS)
def test_no_right_declaration_is_refused(form):
    for world, meaning in itertools.product(WORLDS, MEANINGS):
        require_found(compass, *[(world, form, meaning)] * 2)


@pytest.mark.ci
def test_a_world_that_is_left_open_is_found():
    for world, form in zip(WORLDS, FORMS + FORMS, strict=False):
        true = (world, form, "specific force")
        found = find_world(compass(true, (None, *true[1:])), told(), RATE)
        assert (found.world, found.alike) == (world, ())
        assert f"stays in {world} within" in found.words
    # one that is handed the field and its start may have any north
    for world, canonical in (("NED", "NED"), ("SEU", "NWU")):
        filter = replace(kalman(world, "sxyz", "active"), world=None)
        found = find_world(filter, told(), RATE)
        assert (found.world, len(found.alike)) == (canonical, 3)


@pytest.mark.ci
def test_without_a_magnetometer_the_inclination_is_judged():
    class Six(Complementary):
        def update(self, dt, w, f):
            return super().update(dt, w, f)

    form = ("xyzs", "passive")

    def six(world):
        make = lambda: Six("ENU", form, share=0.2)  # noqa: E731
        return declaring(make, (world, form, MEANINGS[0]), magnetometer=False)

    found = find_world(six(None), told(), RATE)
    assert (found.world, found.alike) == ("NWU", ("ENU", "SEU", "WSU"))
    assert find_world(six("SEU"), told(), RATE).world == "SEU"
    with pytest.raises(PluginError, match=r'declare world="(NWU|ENU|SEU|WSU)"'):
        find_world(six("NED"), told(), RATE)


def test_one_that_stays_in_none_is_told_what_was_tried():
    form = ("xyzs", "active")
    make = lambda: lambda dt, w, f, m: np.array([0.0, 0.0, 0.0, 1.0])  # noqa: E731
    with pytest.raises(PluginError) as error:
        find_world(declaring(make, (None, form, MEANINGS[0])), told(), RATE)
    message = str(error.value)
    assert "stays in none of the 96 declarations that were tried" in message
    assert all(re.search(rf"{world} \d+", message) for world in WORLDS)


def test_time_to_settle_is_given():
    """From 100 to 150 degrees off at a time constant of 8 s, and no start read."""
    form, share = ("sxyz", "active"), 1.0 / (8.0 * RATE)
    make = lambda: Complementary("ENU", form, share=share)  # noqa: E731
    filter = declaring(make, ("ENU", form, "specific force"))
    assert find_world(filter, told(), RATE).stray < np.radians(5.0)


def test_a_fault_of_the_filter_is_told_as_such():
    def make():
        raise OSError

    filter = declaring(make, (None, ("xyzs", "active"), MEANINGS[0]))
    with pytest.raises(PluginError, match="`make` of mine raised OSError"):
        find_world(filter, told(), RATE)


# signs of the bias, and of its covariance with the attitude

BLOCKS = np.kron([[1, -1], [-1, 1]], np.ones((3, 3)))
SPOILT = {
    "": lambda answer: answer,
    "the rate is the reading less the bias": lambda answer: (
        answer | {"bias": -answer["bias"]}
    ),
    "attitude and bias are of opposite signs": lambda answer: (
        answer | {"covariance": answer["covariance"] * BLOCKS}
    ),
}


@pytest.mark.parametrize("words", SPOILT)
@pytest.mark.parametrize(("world", "side"), [("NWU", "body"), ("SWD", "reference")])
def test_signs_of_the_bias_are_asked(world, side, words):
    class Spoilt(Kalman):
        def update(self, dt, w, f, m):
            return SPOILT[words](super().update(dt, w, f, m))

    form = {"components": "sxyz", "matrix": "active", "world": world, "side": side}
    make = lambda **reads: Spoilt(**form, **reads)  # noqa: E731
    filter = Filter(name="mine", make=make, reads=KALMAN_READS, **form)
    if words:
        with pytest.raises(PluginError, match=words):
            find_world(filter, told(), RATE)
    else:
        assert find_world(filter, told(), RATE).world == world


def test_a_bias_that_is_told_to_be_none_is_no_fault():
    find_world(kalman(), told(bias_std=0.0, gyroscope_walk=0.0), RATE)


# what docs/plugins.md says of filters is so

SECTION = (EXAMPLES.parent / "plugins.md").read_text().partition("## A filter\n")[2]
SECTION = SECTION.partition("\n## ")[0]


def test_every_word_and_the_example_are_on_the_page():
    code = (EXAMPLES / "complementary.py").read_text().partition("\n\n")[2]
    assert f"```python\n{code}```" in SECTION
    declared = [field.name for field in fields(Filter) if field.name != "name"]
    for word in (*READS, *ANSWERS, *WORLDS, *declared):
        assert f"`{word}`" in SECTION, word


@pytest.mark.ci
def test_the_example_stays_in_its_world_and_near_the_truth():
    """A pull of 2 1/s towards vectors that are noisy by 2e-3 and 5e-3 rad."""
    example = find_plugin(str(EXAMPLES / "complementary.py"), Filter)
    assert find_world(example, told(), RATE).world == "NWU"
    given, truth = tumbling(1, 300)
    keep = np.arange(0, 300, 50)
    found, errors = errors_of(example, given, truth, keep, "NWU")
    # one row's two vectors alone are off by some 7e-3 rad, and 50 rows are averaged
    assert np.linalg.norm(errors, axis=-1).max() < 7e-3
    assert attitude_error(found.attitude[:, 0], given.start).max() < 0.1
