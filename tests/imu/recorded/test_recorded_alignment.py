"""Recorded truth on a log's clock: simulated, and that of BROAD."""

from dataclasses import replace

import numpy as np
import pytest
from places import recording
from recorded_logs import G, made
from scipy.stats import binom, f, t

from simval.errors import InputError, RefusedError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    compose,
    conjugate,
    from_rotation_vector,
)
from simval.imu.filters.signals import FilterOutput
from simval.imu.logs import read_log, read_truth
from simval.imu.recorded import align, evaluate
from simval.imu.recorded.alignment import likely_offsets, prepared, stated_axes
from simval.imu.recorded.attitudes import (
    Meaning,
    attitudes,
    meanings,
    of_matrix,
    rotation_vector,
    turned,
)
from simval.imu.recorded.errors import quantile
from simval.imu.recorded.evaluation import FilterRun
from simval.imu.recorded.filter_account import filters_account, north
from simval.imu.recorded.settings import Signals
from simval.imu.recorded.world import find_world


def readings(log):
    """Signals of a made log."""
    return Signals(
        time=log.time, gyro=log.gyro, force=log.force, field=log.field, rate=50.0,
        rests=np.array(log.rests), gyro_unit="rad/s", force_unit="m/s^2",
        field_unit="T",
    )  # fmt: skip


def aligned(log, world="estimated", **changes):
    return align(replace(log.truth, **changes), readings(log), world)


@pytest.mark.slow
def test_error_bars_hold():
    # offset, axes and north: coverage of 95 % intervals, and NEES of the axes
    trials = 60
    inside, squares, errors = np.zeros((trials, 8), bool), np.zeros(trials), []
    how = {"seconds": 60.0, "rate": 50.0, "truth_noise": 1e-3, "scale": 0.01}
    for k in range(trials):
        log = made(1000 + k, drift=3e-5, **how)
        found = aligned(log)
        own, other = map(from_rotation_vector, (log.axes, found.rotation))
        off = turned(own[None], other[None])[0]
        world = rotation_vector(of_matrix(found.world.matrix @ log.world))
        north = found.world.heading_sd * quantile(found.world.heading_dof)
        late = found.offset.value - log.offset
        values = [late, found.drift.value - 3e-5, *off, *world]
        halves = [each.half for each in (found.offset, found.drift, *found.axes)]
        halves += [found.world.half("tilt")] * 2 + [north]
        inside[k] = np.abs(values) <= halves
        squares[k] = off @ np.linalg.solve(found.errors.rotation, off)
        errors.append(late)
    # at a false-alarm rate of 1e-4 for each of eight; error bars that are too wide are
    # allowed for the world, whose sum holds a part twice
    low = binom.ppf(1e-4, trials, 0.95)
    assert (inside.sum(axis=0) >= low).all(), inside.mean(axis=0)
    # Hotelling's T^2 of 23 degrees of freedom: 3 * 23 / 21 F(3, 21)
    mean, spread = 3 * 23 / 21 * f(3, 21).mean(), 3 * 23 / 21 * f(3, 21).std()
    assert abs(squares.mean() - mean) < 4.0 * spread / np.sqrt(trials)
    # power: error bars of half the size would be refused
    assert 4.0 * squares.mean() - mean > 4.0 * spread / np.sqrt(trials)
    # no bias: without the gyroscope's own change of rate it is 3 standard errors
    errors = np.array(errors)
    assert abs(errors.mean()) < 4.0 * errors.std() / np.sqrt(trials)


@pytest.mark.ci
def test_what_was_put_in_is_found():
    clocks = {"rate": 50.0, "truth_rate": 60.0, "offset": -7.25, "drift": 1e-4}
    log = made(5, seconds=40.0, scale=0.02, **clocks)
    found = aligned(log)
    assert abs(found.offset.value + 7.25) < 6.0 * found.offset.sd < 1e-3
    assert abs(found.drift.value - 1e-4) < 6.0 * found.drift.sd < 3e-5
    assert found.meaning == Meaning("last", "body to world")
    assert found.same == (Meaning("first", "world to body"),)
    assert found.better > 20.0
    there = np.isfinite(found.attitude).all(axis=1)
    error = attitude_error(found.attitude[there], log.attitude[there])
    # the alignment's own: 6 standard deviations of axes and world, and the noise
    own = np.trace(found.errors.rotation) + np.trace(found.world.covariance)
    assert np.sqrt(np.mean(error**2)) < 6.0 * np.sqrt(own + 3 * 2e-4**2)
    # noise at rest by second differences: 4 standard errors of 3 x 1500 of them
    assert found.noise.mean() == pytest.approx(2e-4, rel=0.1)


@pytest.mark.ci
@pytest.mark.parametrize("meaning", meanings("unstated"), ids=str)
def test_every_order_and_direction_gives_the_same_truth(meaning):
    log = made(7, seconds=30.0, rate=50.0)
    components = log.truth.components
    if meaning.takes == "world to body":
        components = conjugate(components)
    if meaning.scalar == "first":
        components = np.roll(components, 1, axis=1)
    found = aligned(log, components=components)
    assert found.meaning == meaning
    plain = aligned(log)
    np.testing.assert_allclose(
        attitude_matrix(found.attitude[50:-50]),
        attitude_matrix(plain.attitude[50:-50]),
        rtol=0,
        atol=1e-9,  # the offset of both is found to a 1e-4 of a quarter of a step
    )


def test_holes_are_left_out_and_not_bridged():
    log = made(8, seconds=40.0, rate=50.0)
    components = log.truth.components.copy()
    components[400:900] = np.nan
    components[::7] = np.nan  # single rows: within reach of their neighbours
    found = aligned(log, components=components)
    there = np.isfinite(found.attitude).all(axis=1)
    assert not there[405:895].any()
    assert there[20:380].all()
    error = attitude_error(found.attitude[there], log.attitude[there])
    assert np.sqrt(np.mean(error**2)) < 3e-3


def test_a_log_is_found_anywhere_in_a_longer_truth():
    log = made(9, seconds=80.0, rate=50.0, offset=2.0)
    part = slice(1000, 3000)
    read = attitudes(
        log.truth.time, log.truth.components, Meaning("last", "body to world")
    )
    rows = {x: getattr(log, x)[part] for x in ("gyro", "force", "field")}
    piece = replace(readings(log), time=log.time[part] - 1000.0, **rows)
    first = likely_offsets(piece, read)[0]
    assert first == pytest.approx(1002.0, abs=0.1)  # a tick


@pytest.mark.ci
@pytest.mark.parametrize(
    ("world", "angle"), [("NWU", 0.0), ("ENU", np.pi / 2.0), ("NED", np.pi)]
)
def test_a_world_that_is_stated_is_taken_as_it_is(world, angle):
    """Right or wrong: the truth's is north-west-up."""
    log = made(3, seconds=30.0, rate=50.0, world=[0.0, 0.0, 0.0])
    stated = aligned(log, world)
    there = np.isfinite(stated.attitude).all(axis=1)
    off = attitude_error(stated.attitude[there], log.attitude[there])
    # axes and noise leave some tenths of a degree
    assert np.abs(off - angle).max() < np.radians(0.5)
    assert stated.world.taken == "stated"
    assert np.linalg.norm(stated.world.off) == pytest.approx(angle, abs=1e-2)
    assert not stated.world.covariance.any()


@pytest.mark.ci
def test_a_field_that_deviates_does_not_turn_the_truth_over():
    # one filter is right, the other follows the field: who asks for the field's north
    # is told that its interval leaves the order of the two open
    deviation, half_turn = np.radians(4.0), [0.0, 0.0, -np.pi / 2.0]
    log = made(0, seconds=50.0, rate=50.0, world=half_turn, deviation=deviation)
    nearest, estimated = aligned(log, None), aligned(log)
    assert (nearest.world.name, nearest.world.taken) == ("ENU", "nearest")
    assert estimated.world.taken == "estimated"
    there = np.isfinite(nearest.attitude[:, 0])
    # of the axes 0.1 degrees are left; the field's mean is all in the estimate
    for found, off in ((nearest, 0.0), (estimated, abs(deviation))):
        error = attitude_error(found.attitude[there], log.attitude[there]).mean()
        assert abs(error - off) < np.radians(0.5)
    assert abs(deviation) < estimated.world.half("heading") < 6.0 * abs(deviation)
    turn = np.array([0.0, 0.0, np.sin(deviation / 2.0), np.cos(deviation / 2.0)])
    follows = compose(
        np.broadcast_to(conjugate(turn), log.attitude.shape), log.attitude
    )
    answers = {"right": log.attitude, "follows": follows}
    done = evaluated(answers, log, nearest)
    other = evaluated(answers, log, estimated)
    for each, first in ((done, "right"), (other, "follows")):
        assert min(each, key=total).run.name == first
    # what it says of the other north is what is measured there
    for each, there in zip(done, other, strict=True):
        assert each.truth.turned[1] == pytest.approx(total(there), abs=np.radians(0.2))
    assert north(done).exchanged == ("right and follows",)
    assert north(other).exchanged == ("follows and right",)
    assert "right and follows change places" in filters_account(done).replies[0].do
    assert "How wrong is right?" in str(done[0])
    assert "How wrong is right?" in done[0]._repr_html_()
    (wrong, _) = filters_account(other).replies
    assert wrong.answer == "inconclusive"
    assert "Cannot rank follows and right" in wrong.headline
    elsewhere = made(0, seconds=30.0, rate=50.0, world=[0.0, 0.0, 0.7])
    with pytest.raises(RefusedError, match=r"none of .* degrees off .*--truth-world"):
        aligned(elsewhere, None)


def test_the_tilt_of_a_world_is_known_by_the_scatter_of_its_rests():
    """Five rests, each tilted on its own: the pooled deviation of their mean."""
    tilts = 1e-3 * np.random.default_rng(4).standard_normal((5, 2))
    force = np.repeat(G * np.column_stack([tilts, np.ones(5)]), 60, axis=0)
    field = np.tile([20e-6, 0.0, -40e-6], (300, 1))
    still, rests = np.tile([0.0, 0.0, 0.0, 1.0], (300, 1)), 60 * np.arange(6)
    pairs = np.stack([rests[:-1], rests[1:]], axis=1)
    found = find_world(still, force, field, pairs, np.zeros((3, 3)))
    sd = np.sqrt(tilts.var(axis=0, ddof=1).mean() / 5)
    # the mean's own tilt and cosines: second order of 1e-3
    assert found.tilt_sd == pytest.approx(sd, rel=1e-5)
    assert found.half("tilt") == pytest.approx(sd * t(8).ppf(0.975), rel=1e-5)


def total(each):
    return each.truth.rms["all"]["total"].value


def evaluated(answers, log, found):
    """What is measured of filters that answer so."""

    def run(name, q):
        output = FilterOutput(
            kept=np.arange(len(q)), attitude=q[None], covariance=None, bias=None,
            innovation=None, innovation_covariance=None, seconds=np.zeros(1),
        )  # fmt: skip
        return FilterRun(name=name, world="NWU", how="", output=output, thinned=False)

    return [evaluate(run(name, q), readings(log), found) for name, q in answers.items()]


def test_a_drift_and_a_tilt_at_rest_are_those_that_were_put_in():
    log, drift, tilt = made(4, seconds=80.0, rate=50.0), 2e-3, 0.05
    # which begins with ten degrees that it loses within the first rest
    angle = drift * log.time + 0.2 * np.exp(-log.time)
    turn = from_rotation_vector(angle[:, None] * [0.0, 0.0, 1.0])
    leant = compose(from_rotation_vector(np.array([tilt, 0.0, 0.0])), log.attitude)
    q = compose(turn, leant)
    (found,) = evaluated({"drifts": q}, log, None)
    assert found.at_rest.rests == len(log.rests) == 4
    # of the second halves of the others: exact but for a sine
    assert found.at_rest.settled == 3
    assert found.at_rest.drift == pytest.approx(drift, rel=1e-6)
    assert found.at_rest.inclination == pytest.approx(tilt, abs=1e-3)  # noise of force
    # of the one other rest of a shorter log nothing is said
    short = made(4, seconds=40.0, rate=50.0)
    (found,) = evaluated({"drifts": q[: len(short.time)]}, short, None)
    assert (found.at_rest.rests, found.at_rest.settled) == (2, 1)
    assert np.isnan(found.at_rest.drift)


RATE = 2000.0 / 7.0  # Hz, as their `sampling_rate` has it


@pytest.mark.ci
def test_what_the_authors_of_broad_state_is_found():
    path = str(recording("broad/05_undisturbed_slow_rotation_with_breaks_B.mat"))
    log = read_log(path, RATE)
    truth = read_truth(path, stem="opt_quat", clock=log.time)
    _, found = prepared(log, truth, None, (None, None))
    # scalar first, sensor to world, east-north-up, body axes those of the sensor
    assert found.meaning == Meaning("first", "body to world")
    assert found.same == (Meaning("last", "world to body"),)
    assert found.better > 10.0
    assert found.world.name == "ENU"
    assert found.world.taken == "standard"
    # north by the log holds that of the data set within its own deviation
    assert abs(found.world.off[2]) < found.world.half("heading") < np.radians(10.0)
    assert np.linalg.norm(found.world.off[:2]) < np.radians(0.6)
    assert np.linalg.norm(found.rotation) < np.radians(0.6)
    # unit rad/s, and a gyroscope within its data sheet
    assert found.fit.scale == pytest.approx(1.0, abs=0.01)
    assert found.fit.share < 2e-3
    # optical noise: hundredths of a degree
    assert 1e-5 < found.noise.mean() < 3e-4
    missing = 1.0 - np.isfinite(found.attitude[:, 0]).mean()
    assert missing == pytest.approx(0.034, abs=2e-3)


@pytest.mark.parametrize("words", ["x,y,z", "x,-y,-z", "-y,x,z", "y,z,x"])
@pytest.mark.parametrize("scalar", ["last", "unstated"])
def test_stated_axes_tell_two_readings_apart(words, scalar):
    """A body that hardly tips: the inverse turns alike, in left-handed axes."""
    log = made(21, seconds=30.0, rate=50.0)
    t, axes = log.time, stated_axes(words)
    angle = np.sin(t) + 0.3 * np.sin(2.7 * t)
    tips = 0.1 * np.stack([np.sin(1.3 * t + 1.0), np.sin(0.7 * t)], axis=1)
    q = from_rotation_vector(np.column_stack([tips, angle]))
    rate = np.concatenate([np.zeros((1, 3)), 50.0 * turned(q[:-1], q[1:])])
    rate += np.random.default_rng(0).normal(0.0, 0.1, rate.shape)
    log = replace(log, gyro=rate @ axes.T)
    with pytest.raises(RefusedError, match=r"in two ways.*--truth-axes"):
        aligned(log, components=q, scalar=scalar)
    truth = replace(log.truth, components=q, scalar=scalar)
    found = align(truth, readings(log), "estimated", axes)
    assert found.meaning == Meaning(scalar="last", takes="body to world")
    # known to 2 degrees a standard deviation at worst, `WIDEST`
    far = rotation_vector(of_matrix(attitude_matrix(
        from_rotation_vector(found.rotation)) @ axes.T))  # fmt: skip
    assert np.degrees(np.linalg.norm(far)) < 8.0
    with pytest.raises(RefusedError, match="by --truth-axes"):
        align(truth, readings(log), "estimated", axes @ stated_axes("y,z,x"))


@pytest.mark.parametrize("words", ["x,y", "x,y,-z", "x,x,z", "a,b,c", ""])
def test_axes_are_three_and_right_handed(words):
    with pytest.raises(InputError, match="--truth-axes"):
        stated_axes(words)
