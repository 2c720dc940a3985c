"""Faults of what judges a log, or a simulator: its priors, noise, and what it tries."""

from functools import partial

import numpy as np

from power.fault import Fault, replaced, then
from simval.imu.audit import ideal, pieces
from simval.imu.explain import catalogue, judgement, likelihood
from simval.path import PosePath


def across(original, rests, fit=None):
    # that across the vector, of which there are two directions
    total = np.trace(rests.covariance, axis1=1, axis2=2)
    return np.sqrt((total - original(rests, fit) ** 2) / 2.0)


def late(term):
    return term._replace(held=1.0) if term.held else term


def heavier(entries):
    return [each._replace(weight=each.weight + np.log(1000.0)) for each in entries]


sound = partial(Fault, "sound logs", "estimator")
faulty = partial(Fault, "faults", "estimator")
simulators = partial(Fault, "simulators", "estimator")
FAULTS = (
    sound(judgement, "along", "noise across gravity, not along it", across),
    sound(judgement, "_entries", "priors that add up to a thousand", then(heavier)),
    sound(
        likelihood.Fit, "chance", "as many degrees of freedom as rests",
        lambda original, fit, freedom: original(fit._replace(known=0.0), freedom),
    ),
    faulty(
        catalogue, "maps", "no sign is tried",
        then(lambda tried: [each for each in tried if each.kind != "sign"]),
    ),
    faulty(
        likelihood, "DECADES", "effects expected a thousand times smaller",
        context=lambda: replaced(likelihood, "DECADES", (1e-3,)),
    ),
    simulators(
        pieces, "_rounded", "poses are taken for exact",
        lambda original, time, poses: PosePath(time, poses[:, :3], poses[:, 3:]),
    ),
    simulators(
        ideal, "TERMS", "a step late is nobody's fault",
        context=lambda: replaced(ideal, "TERMS", tuple(map(late, ideal.TERMS))),
    ),
)  # fmt: skip
