"""The frame finder: right declarations stand, wrong ones are told the right one."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sound_filters import (
    WORLDS,
    Complementary,
    cross,
    from_nwu,
    kalman,
    spelled,
    told,
)

from simval.errors import PluginError
from simval.geometry import attitude_matrix
from simval.plugins import Filter, find_world
from simval.plugins.runs import from_scene, own_quaternions, to_scene, written
from simval.plugins.worlds import STAYS, path

FORMS = list(itertools.product(("xyzs", "sxyz", "matrix"), ("active", "passive")))
MEANINGS = ("specific force", "gravity")
DECLARATIONS = list(itertools.product(WORLDS, FORMS, MEANINGS))
UPSIDE_DOWN = {"NWU": "NED", "ENU": "WND", "SEU": "SWD", "WSU": "ESD"}
UPSIDE_DOWN |= {down: up for up, down in UPSIDE_DOWN.items()}
RATE = 10.0
"""Hz, of the quick ones."""


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


def compass(true, declared):
    """A filter of the first declarations that declares the others."""
    world, form, meaning = true
    sign = 1.0 if meaning == "specific force" else -1.0
    return Filter(
        name="compass",
        make=lambda: Compass(world, form, sign),
        **words_of(declared),
    )


def words_of(declared):
    world, (components, matrix), meaning = declared
    return {
        "world": world,
        "components": components,
        "matrix": matrix,
        "accelerometer": meaning,
    }


def same(one, other):
    """Whether declarations are the same, or each other upside down."""
    if one[1] != other[1]:
        return False
    turned = one[0] != other[0]
    return (other[0] in (one[0], UPSIDE_DOWN[one[0]])) and (
        (one[2] != other[2]) == turned
    )


def advised(message, filter):
    """The filter as it is told to be declared."""
    advice = message.partition("; declare ")[2].partition(": so it")[0]
    pairs = dict(re.findall(r'(\w+)="([^"]+)"', advice))
    assert pairs, message
    return replace(filter, **pairs)


def check_declared(true, declared):
    filter = compass(true, declared)
    if same(true, declared):
        assert find_world(filter, told(), RATE).world == declared[0]
        return
    with pytest.raises(PluginError, match=r"compass (strays|fails)") as error:
        find_world(filter, told(), RATE)
    other = advised(str(error.value), filter)
    found = (other.world, (other.components, other.matrix), other.accelerometer)
    assert same(true, found), (true, declared, str(error.value))


def test_worlds_are_what_their_letters_say():
    for world in WORLDS:
        np.testing.assert_array_equal(from_scene(world), from_nwu(world))


def test_attitudes_are_written_and_read_as_scipy_does():
    rng = np.random.default_rng(1)
    q = Rotation.random(50, rng).as_quat()
    A = attitude_matrix(q)
    for world, (components, matrix) in itertools.product(WORLDS, FORMS):
        filter = compass(
            ("NWU", FORMS[0], MEANINGS[0]),
            (world, (components, matrix), MEANINGS[0]),
        )
        want = spelled(A @ from_nwu(world).T, components, matrix)
        own = written(filter, q, world)
        sign = 1.0
        if components != "matrix":  # q and -q are the same attitude
            sign = np.sign(np.sum(want * own, axis=1, keepdims=True))
        # a dozen products of numbers up to 1
        np.testing.assert_allclose(own, sign * want, rtol=0, atol=1e-14)
        back = to_scene(own_quaternions(filter, own), world)
        np.testing.assert_allclose(attitude_matrix(back), A, rtol=0, atol=1e-14)


def test_the_path_integrates_to_its_attitudes():
    """The rates, by SciPy's rotations, lead from row to row."""
    made = path(told(), 50.0, 3.0, 4.0)
    A, given = attitude_matrix(made.truth), made.given
    turns = Rotation.from_rotvec(-given.gyroscope[0] / 50.0).as_matrix()
    np.testing.assert_allclose(turns[1:] @ A[:-1], A[1:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        given.accelerometer[0], A @ [0, 0, 9.81], rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(given.magnetometer[0], A @ told().field, atol=1e-18)
    assert made.rest == 150
    rates = np.linalg.norm(given.gyroscope[0], axis=1)
    assert 0.0 < rates[:150].max() < 2e-4 < rates[150:].max() < 1.5


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_declaration_is_told_the_right_one(seed):
    rng = np.random.default_rng(seed)
    true, declared = (DECLARATIONS[i] for i in rng.integers(len(DECLARATIONS), size=2))
    check_declared(true, declared)


@pytest.mark.ci
@pytest.mark.parametrize("form", FORMS)
def test_no_right_declaration_is_refused(form):
    for world, meaning in itertools.product(WORLDS, MEANINGS):
        check_declared((world, form, meaning), (world, form, meaning))


def complementary(world, form, declared, **more):
    given = words_of(declared) | {"reads": ("start",)}
    return Filter(
        name="pulled",
        make=lambda start=None: Complementary(world, form, start=start),
        **{**given, **more},
    )


@pytest.mark.ci
@pytest.mark.parametrize("seed", range(3))
def test_a_filter_that_starts_from_the_truth_is_told_the_right_one(seed):
    rng = np.random.default_rng(seed)
    world, form = WORLDS[rng.integers(8)], FORMS[rng.integers(6)]
    right = (world, form, "specific force")
    filter = complementary(world, form, right)
    assert find_world(filter, told(), RATE).world == world
    other = DECLARATIONS[rng.integers(len(DECLARATIONS))]
    assert not same(right, other)
    wrong = complementary(world, form, other)
    with pytest.raises(PluginError) as error:
        find_world(wrong, told(), RATE)
    found = advised(str(error.value), wrong)
    named = (found.world, (found.components, found.matrix), found.accelerometer)
    assert same(right, named)
    assert find_world(found, told(), RATE).stray < STAYS


@pytest.mark.slow
@pytest.mark.parametrize(("world", "canonical"), [("NED", "NED"), ("SEU", "NWU")])
def test_a_kalman_filter_of_any_world_stays_and_is_found(world, canonical):
    """One that is handed the field and its start may have any north."""
    filter = kalman(world, "sxyz", "active")
    assert find_world(filter, told(), 50.0).world == world
    found = find_world(replace(filter, world=None), told(), 50.0)
    assert found.world == canonical
    assert len(found.alike) == 3


@pytest.mark.ci
def test_a_world_that_is_left_open_is_found():
    for world, (components, matrix) in zip(WORLDS, FORMS + FORMS, strict=False):
        true = (world, (components, matrix), "specific force")
        filter = compass(true, (None, (components, matrix), "specific force"))
        found = find_world(filter, told(), RATE)
        assert (found.world, found.alike) == (world, ())
        assert f"stays in {world} within" in found.words


@pytest.mark.ci
def test_without_a_magnetometer_the_inclination_is_judged():
    class Six(Complementary):
        def update(self, dt, w, f):
            return super().update(dt, w, f)

    def six(**more):
        form = ("xyzs", "passive")
        given = words_of((None, form, "specific force")) | more
        return Filter(
            name="six",
            make=lambda: Six("ENU", form, share=0.2),
            magnetometer=False,
            **given,
        )

    found = find_world(six(), told(), RATE)
    assert (found.world, found.alike) == ("NWU", ("ENU", "SEU", "WSU"))
    assert find_world(six(world="SEU"), told(), RATE).world == "SEU"
    with pytest.raises(PluginError, match=r'declare world="(NWU|ENU|SEU|WSU)"'):
        find_world(six(world="NED"), told(), RATE)


def test_one_that_stays_in_none_is_told_what_was_tried():
    class Still:
        def update(self, dt, w, f, m):
            return np.array([0.0, 0.0, 0.0, 1.0])

    still = Filter(name="still", make=Still, components="xyzs", matrix="active")
    with pytest.raises(PluginError) as error:
        find_world(still, told(), RATE)
    message = str(error.value)
    assert "stays in none of the 96 declarations that were tried" in message
    for world in WORLDS:
        assert re.search(rf"{world} \d+", message)


@pytest.mark.ci
def test_a_heading_that_is_not_of_the_field_is_named():
    class Declined(Compass):
        def update(self, dt, w, f, m):
            A = Rotation.from_quat(super().update(dt, w, f, m))
            return (Rotation.from_euler("z", 0.4) * A).as_quat()

    form = ("xyzs", "passive")  # b = R(q)' r: from the left is in the world
    filter = Filter(
        name="declined",
        make=lambda: Declined("NWU", form, 1.0),
        **words_of(("NWU", form, "specific force")),
    )
    with pytest.raises(PluginError, match=r"heading is off by 22\.9 degrees all along"):
        find_world(filter, told(), RATE)


def test_time_to_settle_is_given():
    """From 100 to 150 degrees off at a time constant of 8 s, and no start read."""
    share = 1.0 / (8.0 * RATE)
    form = ("sxyz", "active")
    filter = Filter(
        name="slow",
        make=lambda: Complementary("ENU", form, share=share),
        **words_of(("ENU", form, "specific force")),
    )
    assert find_world(filter, told(), RATE).stray < STAYS


def test_a_fault_of_the_filter_is_told_as_such():
    def make():
        raise OSError

    filter = Filter(name="gone", make=make, components="xyzs", matrix="active")
    with pytest.raises(PluginError, match="`make` of gone raised OSError"):
        find_world(filter, told(), RATE)
