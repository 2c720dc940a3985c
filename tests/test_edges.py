"""Where a limit lies: on it, and one unit or one rounding on either side of it."""

import numpy as np
import pytest
import side_by_side
from rows_by_name import cell, row
from scipy.spatial.transform import Rotation
from written import written

from simval.errors import InputError
from simval.imu.logs import read_log
from simval.imu.logs.truth import read_truth
from simval.imu.recorded.attitudes import Attitudes, stretches
from simval.imu.sensor import AccelerometerModel, Effects, read_sensor
from simval.judge.gate import gaps_of
from simval.sweep.run import Run
from simval.theory import VectorSensor

UP, DOWN = np.inf, -np.inf


# --- a cell that states more samples than its rows rest on


@pytest.mark.parametrize("effort", ["samples", "trials"])
@pytest.mark.parametrize("stated", [1, 2, 3, 1000])
def test_a_gap_is_one_sample_fewer_than_stated(tmp_path, effort, stated):
    def gaps(*counts):
        rows = [
            row(f"bias[x{k}]", 0.0, n=n, standard_error=1.0, check="plain")
            for k, n in enumerate(counts)
        ]
        some = (cell(rows, **{effort: stated}),)
        manifest = {**side_by_side.MANIFEST, "cells": 1}
        run = Run(folder=tmp_path, cells=some, manifest=manifest, timing={})
        return [gap.reason for gap in gaps_of(run)]

    for found in range(max(0, stated - 4), stated + 4):
        said = f"its parameters say {effort}={stated}, its rows rest on {found}"
        assert gaps(found) == ([said] if found < stated else [])
        # of several rows the one that rests on most counts
        assert gaps(0, found, max(0, found - 1)) == gaps(found)


# --- rows at which a sensor measures


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


# --- the ends of a converter's range


@pytest.mark.parametrize("quantum", [0.0, 0.5])
def test_a_converter_stops_what_is_beyond_its_ends_and_nothing_at_them(quantum):
    low, high = -10.0, 25.0
    values = [-11.0, -10.5, low, -9.5, 0.0, 24.5, high, 25.5, 26.0]
    if not quantum:
        values += [np.nextafter(low, DOWN), np.nextafter(high, UP)]
        values += [np.nextafter(low, UP), np.nextafter(high, DOWN)]
    force = np.array(values)[:, None] * np.ones(3)
    found = read_sensor(
        AccelerometerModel(T=np.eye(3), K=np.eye(3), B=np.zeros(3)),
        Effects(limits_raw=(low, high), quantum_raw=quantum),
        0.01 * np.arange(len(force)),
        force,
        np.random.default_rng(1),
    )
    beyond = [x < low or x > high for x in values]
    assert np.array_equal(found.saturated, np.array([beyond] * 3).T)
    assert np.array_equal(found.raw, np.minimum(np.maximum(force, low), high))


# --- recorded attitudes


def truth_file(tmp_path, q, time=None):
    time = 0.01 * np.arange(len(q)) if time is None else time
    return str(written(tmp_path / "truth.txt", "t[s],qw,qx,qy,qz", time, q))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("place", [0, 37, 59])
def test_a_recorded_attitude_is_as_long_as_two_digits_round(tmp_path, side, place):
    q = Rotation.random(60, rng=5).as_quat()[:, [3, 0, 1, 2]]
    for length, good in ((0.01 - 1e-9, True), (0.01 + 1e-9, False)):
        given = q.copy()
        given[place] *= 1.0 + side * length
        path = truth_file(tmp_path, given)
        if good:
            found = read_truth(path).components
            np.testing.assert_allclose(found, q, rtol=0, atol=1e-15)
        else:
            with pytest.raises(InputError, match=r"1 such rows of 60\)"):
                read_truth(path)


def test_fifty_recorded_attitudes_are_enough_and_49_are_not(tmp_path):
    q = Rotation.random(60, rng=5).as_quat()[:, [3, 0, 1, 2]]
    for missing in (np.nan, 0.0):
        q[::6] = missing
        assert np.isnan(read_truth(truth_file(tmp_path, q)).components[::6]).all()
        given = q.copy()
        given[1] = missing
        with pytest.raises(InputError, match="49 of 60 rows have"):
            read_truth(truth_file(tmp_path, given))


# --- the ticks of a clock without a unit, by the rate that is stated


@pytest.mark.parametrize("tick", [1.0, 1e-3, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("rate", [50.0, 100.0, 400.0])
def test_a_stated_rate_tells_the_tick_of_a_counter(tmp_path, tick, rate):
    """Seconds, milli-, micro-, nanoseconds, 0.1 ms of Xsens's SampleTimeFine."""
    rows = 40
    force = np.random.default_rng(1).standard_normal((rows, 3))
    for off, good in ((0.0, True), (0.09, True), (-0.09, True), (0.12, False)):
        time = np.arange(rows) / rate / tick
        path = written(tmp_path / "log.txt", "t,ax,ay,az", time, force, form="{:.15g}")
        if good:
            log = read_log(str(path), rate=rate * (1.0 + off))
            assert log.rate == pytest.approx(rate, rel=1e-9)
            assert log.time[-1] - log.time[0] == pytest.approx((rows - 1) / rate)
        else:
            with pytest.raises(InputError):
                read_log(str(path), rate=rate * (1.0 + off))


# --- the turns of recorded attitudes


def motion(kind, rng):
    """Rotation vector of the body in the world at some times."""
    if kind == "coning":
        angle, pace = rng.uniform(0.05, 0.3), 2.0 * np.pi * rng.uniform(2.0, 5.0)
        return lambda t: (
            angle * np.stack([np.cos(pace * t), np.sin(pace * t), 0.0 * t], axis=1)
        )
    size, phase = rng.uniform(0.1, 0.5, (2, 3, 1)), rng.uniform(0.0, 6.0, (2, 3, 1))
    pace = rng.uniform(5.0, 15.0, (2, 3, 1))
    return lambda t: (size * np.sin(pace * t + phase)).sum(axis=0).T


@pytest.mark.parametrize("kind", ["coning", "waves"])
@pytest.mark.parametrize("seed", range(3))
def test_recorded_attitudes_give_the_integral_of_the_rate(kind, seed):
    """Against the sum of turns a hundred times shorter, which no coning is left in."""
    turn, fine = motion(kind, np.random.default_rng(seed)), 100
    h, rows = 0.01, 220
    often = Rotation.from_rotvec(turn(np.arange(rows * fine) * h / fine))
    small = (often[:-1].inv() * often[1:]).as_rotvec()
    small = np.vstack([np.zeros((1, 3)), small])
    total = np.cumsum(small, axis=0)[::fine]
    time = h * np.arange(rows)
    gyro = np.vstack([np.zeros((1, 3)), np.diff(total, axis=0) / h])
    cut = stretches(time, gyro)
    at = Attitudes(time=time, q=often[::fine].as_quat(), step=h)
    places = np.round(cut.time[:, [0, -1]] / h).astype(int)
    exact = total[places[:, 1]] - total[places[:, 0]]
    np.testing.assert_allclose(cut.turn, exact, rtol=0, atol=1e-12)
    found = cut.truth(at, np.zeros(len(cut.time)))
    good = np.isfinite(found).all(axis=1)
    assert good.sum() >= len(good) - 1
    plain = Rotation.from_quat(at.q)
    turns = (plain[:-1].inv() * plain[1:]).as_rotvec()
    sums = np.vstack([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    without = sums[places[:, 1]] - sums[places[:, 0]]
    # (R1) leaves the fourth order: a hundredth of what coning adds at 10 ms
    added = np.abs(without - exact)[good].max()
    assert np.abs(found - exact)[good].max() < 0.04 * added
