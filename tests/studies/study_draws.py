"""Legal parameters of a study, drawn at their edges and between, at little cost.

A limit that is left open by a study is closed here for counts alone (trials, samples),
whose sizes change the time and not the kind of work.
"""

import math
import typing

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from simval.studies import STUDIES
from simval.studies.named_geometries import GEOMETRIES

SCENARIOS = ("gimbal slow", "gimbal fast", "magnetic disturbance", "anywhere")
WORDS = {  # of fields that are text
    ("estimator", "algorithm"): ("simval:wahba", "simval:triad", "simval:closed-form"),
    ("estimator", "noise"): ("body", "all", "tangent", "unequal", "general"),
    ("calibrator", "algorithm"): ("simval:squared", "simval:norm", "simval:weighted"),
    ("filter", "algorithm"): ("simval:mekf",),
    ("filter", "scenario"): SCENARIOS,
}
KEPT = ("time_limit",)
LARGEST = {"trials": 2.0, "samples": 2.0, "geometries": 1.2, "cases": 2.0}
"""Of a count of trials, beside the least that is legal."""


def limits(info):
    """Least and greatest value of a field, and whether each is itself legal."""
    low, high, closed = -math.inf, math.inf, [True, True]
    for limit in info.metadata:
        match limit:
            case Ge(ge=value):
                low = value
            case Gt(gt=value):
                low, closed[0] = value, False
            case Le(le=value):
                high = value
            case Lt(lt=value):
                high, closed[1] = value, False
    return low, high, closed


def edges(name, info):
    """Values of a number at its edges and next to them."""
    low, high, (from_low, to_high) = limits(info)
    if info.annotation is int:
        if name in LARGEST:
            return [low, low + 1]
        top = (high if to_high else high - 1) if high < math.inf else 2**200
        return [low, low + 1, top - 1, top]
    values = [low, np.nextafter(low, high)] if from_low else [np.nextafter(low, high)]
    top = high if high < math.inf else 1e300
    values += [top if to_high else np.nextafter(top, low)]
    if low == 0.0:
        values += [1e-300, 1e-150, 1e-30, 1e-15, 1e-9]
    return [float(v) for v in values]


def between(name, info, rng):
    """A value between the edges, by its logarithm where that is the scale."""
    low, high, _ = limits(info)
    if info.annotation is int:
        if name in LARGEST:
            return int(low * rng.uniform(1.0, LARGEST[name]))
        top = high if high < 2**60 else 2**60
        return int(min(max(10 ** rng.uniform(0.0, math.log10(top)), low), top - 1))
    high = high if high < math.inf else 1e6
    least = max(low, 1e-9 * high)
    if rng.random() < 0.5 or low < 0.0:
        return float(rng.uniform(low if low < 0 else least, high))
    return float(10.0 ** rng.uniform(math.log10(least), math.log10(high)))


def draw(study, rng, edge=0.4, plain=0.3):
    """Values of all fields: at an edge, by default or between, in these shares."""
    values = {}
    for name, info in STUDIES[study].parameters.model_fields.items():
        if name in KEPT:
            continue
        kind = rng.random()
        if typing.get_origin(info.annotation) is typing.Literal:
            values[name] = str(rng.choice(typing.get_args(info.annotation)))
        elif (study, name) == ("estimator", "geometry"):  # a number or a name
            numbers = [0, int(rng.integers(2**62)), 2**63 - 1]
            choices = [*GEOMETRIES] if rng.random() < 0.1 else numbers
            values[name] = choices[int(rng.integers(len(choices)))]
        elif info.annotation is str:
            values[name] = str(rng.choice(WORDS[study, name]))
        elif kind < edge:
            choices = edges(name, info)
            values[name] = choices[int(rng.integers(len(choices)))]
        elif kind < edge + plain and name not in LARGEST:
            values[name] = info.default
        else:
            values[name] = between(name, info, rng)
    return values
