"""Races of the simulation of a scene, of Allan variances, noise and windows."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
import scipy

from benchmarks.race import Contender, race
from simval.imu.noise import allan_variance, averaging_counts, noise_of
from simval.imu.statics.detector import WINDOW, variance_magnitude
from simval.scene.physics import captured_messages, mujoco, roll_out
from simval.scene.run import plan_run

TOGETHER = 8  # as `many` takes
MOST_STEPS = 10_000  # for the time of a race
ROWS = 1_000_000
SIGNALS, READINGS = 12, 30_000
LENGTHS = 40  # averaging times, evenly on a log scale to a tenth of the rows
AGREEMENT = 1e-9
"""Relative. Chosen: the running sum of a million normals, some 1e3, has lost 1e-13 a
step at most, and the sums of squares average that."""


@race("scene", "Steps of the gimbal, eight runs together, one thread", "steps")
def simulation() -> list[Contender]:
    """List both ways to advance the gimbal; the reference is the bare loop in C.

    The loop cannot change its inputs, so both hold the scene's last ones.
    """
    plan = plan_run("gimbal")
    model, steps = plan.physics.model, min(len(plan.script.hold), MOST_STEPS)
    held = {
        field: np.repeat(value[-1:], steps, axis=0)
        for field, value in plan.script.inputs.items()
    }
    script = replace(plan.script, inputs=held, hold=plan.script.hold[:steps])
    data = mujoco.MjData(model)

    def bare():
        last = []
        with captured_messages():
            for _ in range(TOGETHER):
                mujoco.mj_resetData(model, data)
                for name in ("qpos", "qvel"):
                    if (start := getattr(script, name)) is not None:
                        getattr(data, name)[:] = start
                for field, value in held.items():
                    getattr(data, field).flat = value[-1]
                mujoco.mj_step(model, data, steps)
                last.append(np.array(data.sensordata))  # the scene's order is ours
        return np.array(last)

    def kept():
        return roll_out(model, [script] * TOGETHER).rows[:, -1]

    def seen(rows):  # the engine is the same, so the bits are
        return {"last rows of the sensors": (rows, 0.0)}

    count = TOGETHER * steps
    return [
        Contender("mj_step, nstep at once", count, bare, seen, other="keeps no row"),
        Contender("simulation, every row kept", count, kept, seen),
    ]


@race("allan", "Overlapping Allan variances of a million rows", "row averages")
def allan() -> list[Contender]:
    """List the ways to the Allan variance; the reference is its definition in NumPy."""
    signal = np.random.default_rng(0).standard_normal(ROWS)
    counts = np.unique(np.round(np.geomspace(1, ROWS // 10, LENGTHS)).astype(int))

    def seen(found):
        return {"Allan variances": (found, 0.5 * AGREEMENT * np.abs(found))}

    ways = {"second differences in NumPy, data unchecked": _second_differences}
    if find_spec("allantools") is not None:
        ways["allantools, data unchecked"] = _allantools
    ways["simval"] = allan_variance
    return [  # each averaging time takes all rows
        Contender(name, ROWS * len(counts), partial(run, signal, counts), seen)
        for name, run in ways.items()
    ]


def _second_differences(rate, counts):
    angle = np.concatenate([[0.0], np.cumsum(rate)])
    found = np.empty(len(counts))
    for i, m in enumerate(counts):
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        found[i] = np.mean(second * second) / (2.0 * m * m)
    return found


def _allantools(rate, counts):
    import allantools

    found = allantools.oadev(rate, rate=1.0, data_type="freq", taus=counts)
    return np.asarray(found[1]) ** 2


@race("noise", "Noise models of signals at rest", "signals")
def noise() -> list[Contender]:
    """List the ways to noise coefficients; the reference weighs three terms in SciPy.

    It has no covariance of the variances, intervals or choice of terms.
    """
    rng = np.random.default_rng(1)
    steps = rng.standard_normal((2, READINGS, SIGNALS))
    signals = steps[0] + 0.01 * np.cumsum(steps[1], axis=0)
    counts = averaging_counts(READINGS)
    law = np.stack(
        [1.0 / counts, np.full(len(counts), np.log(4.0) / np.pi), counts / 3]
    )

    def weighed():
        ones = np.ones(len(counts))
        variances = [_second_differences(each, counts) for each in signals.T]
        return [scipy.optimize.nnls((law / each).T, ones)[0] for each in variances]

    def alone():
        return [noise_of(each, 100.0)[0] for each in signals.T]

    def together():
        return noise_of(signals, 100.0)

    def seen(found):
        return {"squares": ([axis.squares for axis in found], AGREEMENT)}

    return [
        Contender(
            "NumPy and scipy nnls, data unchecked", SIGNALS, weighed,
            other="three terms, no intervals",
        ),
        Contender("simval, one signal at a time", SIGNALS, alone, seen),
        Contender("simval, all signals at once", SIGNALS, together, seen),
    ]  # fmt: skip


@race("windows", "Variances of the window around each reading of three axes", "rows")
def windows() -> list[Contender]:
    """List the ways to them; the reference is NumPy's variance of each window."""
    samples = np.random.default_rng(0).standard_normal((READINGS, 3))
    half = WINDOW // 2

    def view():
        each = np.lib.stride_tricks.sliding_window_view(samples, WINDOW, axis=0)
        return np.sqrt((each.var(axis=-1, ddof=1) ** 2).sum(axis=-1))

    def filtered():
        mean, square = (
            scipy.ndimage.uniform_filter1d(each, WINDOW, axis=0)[half:-half]
            for each in (samples, samples**2)
        )
        variance = (square - mean**2) * WINDOW / (WINDOW - 1)
        return np.sqrt((variance**2).sum(axis=-1))

    def simval():
        return variance_magnitude(samples)[half:-half]

    def seen(found):
        return {"variances": (found, 0.5 * AGREEMENT)}

    return [
        Contender(name, READINGS, run, seen)
        for name, run in {
            "numpy var of a view, data unchecked": view,
            "scipy uniform_filter1d, data unchecked": filtered,
            "simval": simval,
        }.items()
    ]
