"""Study filter: its scenarios, its draws, and what it says of the reference filter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.filters.signals import FilterOutput
from simval.geometry import attitude_matrix, compose, random_quaternions
from simval.statistics import (
    BOUND_AT,
    BUDGET_AT,
    DIVERGED,
    INNOVATION_PAIRS,
    NEES,
    NIS,
    RMS,
    SETTLING_TRIALS,
    WORST_INSTANT,
)
from simval.studies import filter as study
from simval.studies.filter import Answers
from simval.studies.filter_scenarios import NAMES, course, drawn
from simval.sweep.suite import expand


def cells(**settings):
    """Cells of the study."""
    return expand("test", {"seed": 1, "filter": settings}).cells


def measured(**settings):
    """Rows of one cell, by statistic and predictor."""
    (cell,) = cells(**settings)
    rows = study.compute(cell.parameters, cell.streams).rows
    return {(str(row.statistic), row.predictor): row for row in rows}


@pytest.mark.parametrize("name", NAMES)
def test_rates_of_a_course_turn_its_attitudes_into_each_other(name):
    # what the coning's next order leaves of a step: 1e-4 rad at 940 degrees/s, 100 Hz
    way = course(name, 100.0, 8.0)
    turn = Rotation.from_rotvec(way.rate * way.dt[:, None])
    A = attitude_matrix(way.attitude)
    off = turn.inv().as_matrix() @ A[:-1] @ A[1:].swapaxes(1, 2)
    angle = np.linalg.norm(Rotation.from_matrix(off).as_rotvec(), axis=1)
    fastest = np.linalg.norm(way.rate, axis=1).max() * 0.01
    assert angle.max() < fastest**2 / 4.0 + 1e-9
    up = A[1:].swapaxes(1, 2) @ way.up[..., None]
    assert np.abs(up[..., 0] - [0.0, 0.0, way.g]).max() < 1e-9
    field = A[1:].swapaxes(1, 2) @ way.field[..., None]
    assert np.abs(field[..., 0] - way.magnetic).max() < 1e-18
    assert way.magnetic[0] > 0.0
    assert way.magnetic[1] == 0.0
    assert way.magnetic[2] < 0.0, "north and down, in NWU"


def test_which_scenarios_read_what_no_filter_is_told_of():
    found = {name for name in NAMES if course(name, 100.0, 8.0).disturbed}
    felt = {"lever arm", "handheld", "pivot", "vibration"}
    assert found == {*felt, "magnetic disturbance"}
    assert {n for n in NAMES if np.any(course(n, 100.0, 8.0).acceleration)} == felt
    iron = np.linalg.norm(course("magnetic disturbance", 100.0, 9.0).iron, axis=1)
    third = len(iron) // 3
    assert not iron[: third - 1].any()
    assert not iron[2 * third + 1 :].any(), "it goes again"
    assert iron.max() == pytest.approx(0.5 * np.linalg.norm([2e-5, 4e-5]), rel=1e-3)


def test_the_acceleration_of_a_lever_arm_is_that_of_a_turning_arm():
    # second differences of an arm that turns, beside what the scene says; 500 Hz
    way = course("pivot", 500.0, 8.0)
    A = attitude_matrix(way.attitude)
    arm = np.array(_least_arm(way))
    path = A.swapaxes(1, 2) @ arm
    acceleration = (path[2:] - 2.0 * path[1:-1] + path[:-2]) * 500.0**2
    body = np.vecdot(A[1:-1], acceleration[:, None, :])
    assert np.abs(body - way.acceleration[:-1]).max() < 2e-3
    assert 0.01 < np.linalg.norm(arm) < 0.1, "27 mm"


def _least_arm(way):
    # least squares over the whole course: linear in the arm
    A = attitude_matrix(way.attitude)
    columns = []
    for axis in np.eye(3):
        path = A.swapaxes(1, 2) @ axis
        acceleration = (path[2:] - 2.0 * path[1:-1] + path[:-2]) * 500.0**2
        columns.append(np.vecdot(A[1:-1], acceleration[:, None, :]).ravel())
    return np.linalg.lstsq(
        np.stack(columns, axis=1), way.acceleration[:-1].ravel(), rcond=None
    )[0]


def test_a_course_that_is_not_to_be_had_is_refused():
    with pytest.raises(InputError, match="ask for less"):
        course("gimbal slow", 100.0, 100.0)
    with pytest.raises(InputError, match="divided by a whole number"):
        course("gimbal slow", 99.0, 8.0)


def test_the_bias_walks_as_white_noise_integrated_finely_does():
    # joint covariance of the bias's step and its average over it, from 200 substeps
    rng = np.random.default_rng(3)
    h, K, fine = 0.02, 0.5, 200
    walk = np.cumsum(
        K * np.sqrt(h / fine) * rng.standard_normal((20_000, fine)), axis=1
    )
    expected = np.cov(walk[:, -1], walk.mean(axis=1))
    way = course("long rest", 50.0, 8.0)
    (cell,) = cells(scenario="long rest", rate=50.0, seconds=8.0, trials=8)
    sensors = replace(
        study.sensors_of(cell.parameters, way),
        gyroscope_noise=0.0,
        gyroscope_walk=K,
        bias_std=0.0,
    )
    told = study.told_of(cell.parameters, way)
    given, bias = drawn(way, sensors, told, 64, np.random.default_rng(4))
    before = np.concatenate([np.zeros((64, 1, 3)), bias[:, :-1]], axis=1)
    step, inside = bias - before, given.gyroscope - way.rate - before
    found = np.cov(step.ravel(), inside.ravel())
    # 76 800 and 20 000 samples: 5 standard errors of a variance, and of the sum's bias
    assert np.abs(found / expected - 1.0).max() < 5.0 * np.sqrt(2.0 / 20_000) + 0.01


def test_noise_is_of_the_stated_size_and_the_start_of_the_stated_spread():
    way = course("long rest", 100.0, 8.0)
    (cell,) = cells(scenario="long rest", seconds=8.0, trials=8)
    sensors = study.sensors_of(cell.parameters, way)
    told = study.told_of(cell.parameters, way)
    given, bias = drawn(way, sensors, told, 200, np.random.default_rng(5))
    white = given.gyroscope - bias  # the walk within a step is 1e-3 of it
    assert white.std() == pytest.approx(np.radians(0.01) * 10.0, rel=0.01)
    assert (given.accelerometer - way.up).std() == pytest.approx(2e-3 * way.g, rel=0.01)
    field = np.linalg.norm(way.magnetic)
    assert (given.magnetometer - way.field).std() == pytest.approx(
        5e-3 * field, rel=0.01
    )
    turn = 2.0 * compose(
        np.broadcast_to(way.attitude[0] * [-1, -1, -1, 1], (200, 4)), given.start
    )
    assert turn[:, :3].std() == pytest.approx(5e-3, rel=0.2)
    assert bias[:, 0].std() == pytest.approx(1e-3, rel=0.2)


def test_what_is_wrong_changes_no_draw():
    names = ["gimbal slow", "gimbal slow, scale 1e-3", "gimbal slow, calibration 1e-3"]
    right, *others = cells(scenario=names, algorithm=["simval:mekf"])
    assert all(other.streams == right.streams for other in others)
    way = course("gimbal slow", 100.0, 8.0)
    draws = []
    for cell in (right, *others):
        sensors = study.sensors_of(cell.parameters, way)
        told = study.told_of(cell.parameters, way)
        draws.append(drawn(way, sensors, told, 8, cell.streams.block(0))[0])
    for other in draws[1:]:
        assert np.array_equal(other.accelerometer, draws[0].accelerometer)
        assert np.array_equal(other.magnetometer, draws[0].magnetometer)
        assert np.array_equal(other.start, draws[0].start)
        assert not np.array_equal(other.gyroscope, draws[0].gyroscope)


@pytest.mark.parametrize("steps", [100, 101, 150, 200, 2000, 50_000])
def test_instants_are_spread_with_the_row_before_each(steps):
    kept, late = study.instants(steps)
    assert kept[0] >= 0
    assert kept[-1] == steps - 1
    assert (np.diff(kept) > 0).all()
    assert (kept[late] - kept[late - 1] == 1).all()
    assert len(late) >= 99


def test_headings_of_a_filter_without_a_compass_count_from_its_first():
    rng = np.random.default_rng(6)
    truth = random_quaternions(6, rng)
    about_up = np.array([0.0, 0.0, np.sin(0.7), np.cos(0.7)])
    off = compose(
        np.broadcast_to(about_up, (2, 6, 4)), np.broadcast_to(truth, (2, 6, 4))
    )
    found = FilterOutput(
        kept=np.arange(6), attitude=off, covariance=None, bias=None, innovation=None,
        innovation_covariance=None, seconds=np.ones(1),
    )  # fmt: skip
    answers = Answers(
        found=found, truth=truth, bias=np.zeros((2, 6, 3)), time=np.arange(6.0),
        late=np.arange(1, 6),
    )  # fmt: skip
    assert np.linalg.norm(answers.error, axis=-1).min() > 1.39
    shifted = answers.from_its_own_heading()
    assert np.abs(shifted.error).max() < 1e-12
    assert shifted.shifted


@pytest.mark.ci
def test_the_reference_filter_is_consistent_and_reaches_the_bound():
    rows = measured(seconds=8.0, trials=128)
    for name, mean in (("nees", 3.0), ("nees[attitude and bias]", 6.0), ("nis", 6.0)):
        row = rows[name, "chi-square"]
        assert row.prediction == mean
        assert abs(row.value - mean) < 4.0 * row.standard_error
    pairs = rows[str(INNOVATION_PAIRS()), "white"]
    assert abs(pairs.value - 1.0) < 4.0 * pairs.standard_error
    rms = rows["rms", "Cramer-Rao"]
    assert abs(rms.value - rms.prediction) < 4.0 * rms.standard_error
    assert rows[str(DIVERGED()), "normal"].value == 0.0
    assert rows[str(SETTLING_TRIALS()), ""].value == 1.0
    worst = rows[str(WORST_INSTANT("attitude")), "chi-square"]
    assert worst.value < worst.prediction
    # the budget's parts add up to the bound, instant by instant
    at = [n.partition(",")[2] for n, _ in rows if n.startswith(f"{BOUND_AT.name}[")]
    for t in at:
        parts = [
            row.value**2
            for (name, _), row in rows.items()
            if name.startswith(f"{BUDGET_AT.name}[") and name.endswith(f",{t}")
        ]
        bound = rows[f"{BOUND_AT.name}[attitude,{t}", ""].value
        assert sum(parts) == pytest.approx(bound**2, rel=1e-6)


@pytest.mark.ci
@pytest.mark.parametrize(
    "wrong",
    [
        "gyroscope noise 0.333",
        "turned 1e-3",
        # of the same two kinds, each three seconds: by night
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("accelerometer noise 2", "scale 1e-3", "calibration 1e-3")
        ),
    ],
)
def test_theory_says_what_the_reference_filter_does_when_it_is_told_wrongly(wrong):
    rows = measured(scenario=f"gimbal slow, {wrong}", seconds=8.0, trials=128)
    for name in (str(NEES()), str(NIS()), str(RMS())):
        row = rows[name, "first order, carried through"]
        assert row.check in ("plain", "nees")
        allowed = 4.0 * row.standard_error + row.remainder
        assert abs(row.value - row.prediction) < allowed, name
    # power: it is told from a filter that is told the truth
    row = rows[str(NEES()), "first order, carried through"]
    assert abs(row.value - 3.0) > 4.0 * row.standard_error
