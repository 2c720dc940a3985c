"""What `simval check` says of filters that are wrong, over a family drawn at random.

Each is the package's own filter with one fault; its trials are stepped here, so that a
case takes a second. What is said is held to the fault that was put in: a word of its
kind, never a word of another's. Sound filters of unusual style are accused of nothing.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.check.words import unjudged, why
from simval.errors import PluginError
from simval.filters.mekf import Mekf
from simval.filters.signals import FilterOutput
from simval.geometry import compose, from_rotation_vector
from simval.plugins import Filter, find_plugin, find_world
from simval.studies import filter as study
from simval.studies.filter_rows import Answers
from simval.studies.filter_scenarios import course, drawn
from simval.sweep.cells import CellResult

OWN = find_plugin("simval:mekf", Filter)
EXTRA = ("covariance", "bias", "innovation", "innovation_covariance")


class Faulty(Mekf):
    """The package's filter with a fault."""

    def __init__(self, fault, field, **reads):
        self.fault, self.held = fault, []
        told = {k: reads[k] * fault[k] for k in reads.keys() & fault.keys()}
        north = Rotation.from_rotvec([0.0, 0.0, fault.get("declination", 0.0)])
        super().__init__(**reads | told, field=north.apply(field))
        self.coning = "no coning" not in fault

    def update(self, dt, w, f, m):
        fault = self.fault
        found = dict(super().update(dt, w * (1.0 + fault.get("scale", 0.0)), f, m))
        q = found["attitude"]
        if "mounting" in fault:
            turn = np.broadcast_to(fault["mounting"], (*q.shape[:-1], 3))
            found["attitude"] = compose(q, from_rotation_vector(turn))
        if "inverse" in fault:
            found["attitude"] = q * [-1.0, -1.0, -1.0, 1.0]
        found["covariance"] = found["covariance"] * fault.get("factor", 1.0)
        self.held = [*self.held, found][-1 - fault.get("late", 0) :]
        found = self.held[0]
        return {k: found[k] for k in found if k not in fault.get("without", ())}

    def _step(self, h, rate):
        before, b = self.before, self.b
        super()._step(h, rate + 2.0 * b if "bias sign" in self.fault else rate)
        if "doubled" in self.fault:
            self.q = compose(
                self.q, from_rotation_vector(np.cross(before, self.before) / 12.0)
            )

    def _correct(self, some, y):
        b = self.b
        found = super()._correct(some, y)
        self.b = b + self.fault.get("bias gain", 1.0) * (self.b - b)
        return found


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either(rng, low, high):
    return log_uniform(rng, low, high) * rng.choice([-1, 1])


def low(name, most=100.0):
    return lambda rng: {name: 1.0 / log_uniform(rng, 3.0, most)}


def high(name, most=100.0):
    return lambda rng: {name: log_uniform(rng, 3.0, most)}


def axis(rng):
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)


FAULTS = {
    # how it is drawn, and words of which one must be said
    "declination": (
        lambda r: {"declination": either(r, 5e-3, 0.08)},
        "its heading is off",
    ),
    "late": (
        lambda r: {"late": round(log_uniform(r, 1, 4))},
        "its answers are late by",
    ),
    "mounting": (
        lambda r: {"mounting": either(r, 5e-3, 0.05) * axis(r)},
        "about an axis of the body",
    ),
    "scale": (lambda r: {"scale": either(r, 5e-3, 0.05)}, "of the motion"),
    "no coning": (lambda r: {"no coning": 1}, "coning"),
    "doubled": (lambda r: {"doubled": 1}, "coning"),
    "accelerometer low": (low("accelerometer_noise"), "the accelerometer .*too small"),
    "accelerometer high": (
        high("accelerometer_noise"),
        "the accelerometer .*too great",
    ),
    "magnetometer low": (low("magnetometer_noise"), "the magnetometer .*too small"),
    "magnetometer high": (high("magnetometer_noise"), "the magnetometer .*too great"),
    "gyroscope low": (
        low("gyroscope_noise", 20.0),
        "has for the gyroscope is too small|source of noise is missing",
    ),
    "gyroscope high": (
        high("gyroscope_noise", 20.0),
        "has for the gyroscope.* is too great",
    ),
    "bias gain": (
        lambda r: {"bias gain": log_uniform(r, 0.01, 0.3)},
        "has for the gyroscope is too small|source of noise is missing",
    ),
    "bias sign": (
        lambda r: {"bias sign": 1},
        "has for the gyroscope is too small|source of noise is missing",
    ),
    "start low": (low("start_std", 10.0), "at the start"),
    "factor low": (low("factor", 20.0), "look at what it states"),
    "factor high": (high("factor", 20.0), "look at what it states"),
}


def cell_of(scenario, make, trials=128, seconds=5.0):
    """Rows of a filter in a scenario, stepped here."""
    parameters = study.Parameters(
        algorithm="mine.py",
        scenario=scenario,
        rate=50.0,
        seconds=seconds,
        trials=trials,
    )
    way = course(scenario, 50.0, seconds)
    sensors = study.sensors_of(parameters, way)
    told = study.told_of(parameters, way)
    rng = np.random.default_rng(len(scenario))
    given, bias = drawn(way, sensors, told, trials, rng)
    filter = make(
        start=given.start, field=told.field, gravity=told.gravity,
        start_std=told.start_std, bias_std=told.bias_std,
        gyroscope_noise=told.gyroscope_noise, gyroscope_walk=told.gyroscope_walk,
        accelerometer_noise=told.accelerometer_noise,
        magnetometer_noise=told.magnetometer_noise,
    )  # fmt: skip
    kept, late = study.instants(len(way.dt))
    every = [
        filter.update(
            float(h),
            *(
                a[:, k]
                for a in (given.gyroscope, given.accelerometer, given.magnetometer)
            ),
        )
        for k, h in enumerate(way.dt)
    ]
    words = {
        w: np.stack([every[k][w] for k in kept], axis=1) if w in every[0] else None
        for w in ("attitude", *EXTRA)
    }
    answers = Answers(
        found=FilterOutput(kept=kept, seconds=np.zeros(1), **words),
        truth=way.attitude[kept + 1],
        bias=bias[:, kept],
        time=way.time[kept],
        late=late,
    )
    exact = study.prediction(way, sensors, told, kept[late])
    rows = study.measured_rows(parameters, way, answers, (exact, exact), way.rate[kept])
    return CellResult(
        position=0,
        name=scenario,
        study="filter",
        seed=1,
        parameters=parameters.named(),
        status="done",
        error="",
        seconds=1.0,
        rows=rows,
    )


def said_of(fault, scenarios=("gimbal slow", "gimbal fast")):
    return why([cell_of(s, lambda **r: Faulty(fault, **r)) for s in scenarios])


UNSEEN = "accelerometer high", "magnetometer high"
"""Faults that only innovations show: without them the covariance stays honest."""

WITHOUT = {
    "accelerometer low": "has for a sensor is too small",
    "magnetometer low": "has for a sensor is too small",
    "gyroscope high": "has for the gyroscope, or for another sensor, is too great",
}
"""What is said where a filter gives no innovations."""


def named(name, rng, without):
    """Whether a fault that is drawn is named, and what is said."""
    draw, words = FAULTS[name]
    fault = draw(rng)
    if without:
        fault["without"] = ("innovation", "innovation_covariance")
        words = WITHOUT.get(name, words)
    said = said_of(fault)
    return any(re.search(words, line) for line in said), fault, said


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", ["declination", "late", "no coning", "magnetometer low"]
)
def test_a_fault_is_named(name):
    found, fault, said = named(name, np.random.default_rng(3), without=False)
    assert found, (fault, said)


@pytest.mark.slow
def test_a_family_of_faults_is_named():
    rng, missed, count = np.random.default_rng(11), [], 0
    for turn in range(4):
        for name in FAULTS:
            without = turn % 3 == 2 and name not in UNSEEN
            found, fault, said = named(name, rng, without)
            count += 1
            if not found:
                missed.append((name, fault, said))
    # near a limit a small fault is within the noise
    assert count >= 50
    assert len(missed) <= 0.1 * count, missed


SOUND = {
    "no covariance": {"without": EXTRA},
    "no coning, no covariance": {"no coning": 1, "without": EXTRA},
    "low gain, no covariance": {"bias gain": 0.0, "without": EXTRA},
    "no innovation": {"without": EXTRA[1:]},
}


@pytest.mark.ci
@pytest.mark.parametrize("name", SOUND)
def test_a_sound_filter_is_accused_of_nothing(name):
    cell = cell_of("gimbal fast", lambda **r: Faulty(SOUND[name], **r))
    limits = [row for row in cell.rows if row.check == "limit"]
    assert limits
    assert all(row.value <= row.prediction for row in limits)
    said = unjudged("mine", [cell])
    assert ("not judged" in said) == ("covariance" in SOUND[name]["without"])
    # power: a constant of a degree, in the same style, is beyond them
    fault = SOUND[name] | {"declination": np.radians(1.0)}
    worse = cell_of("gimbal fast", lambda **r: Faulty(fault, **r))
    assert any(row.value > row.prediction for row in worse.rows if row.check == "limit")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"declination": -0.12}, r"its heading is off by -6\.\d+ degrees"),
        ({"late": 17}, "late by 17 rows, 0.34 s"),
        ({"inverse": 1}, "inverse of the attitude"),
    ],
)
def test_what_leaves_every_world_is_named(fault, words):
    parameters = study.Parameters(algorithm="mine.py", rate=50.0)
    told = study.told_of(parameters, course("gimbal slow", 50.0, 4.0))
    filter = replace(OWN, name="mine", make=lambda **r: Faulty(fault, **r))
    with pytest.raises(PluginError, match=words):
        find_world(filter, told, 50.0)
