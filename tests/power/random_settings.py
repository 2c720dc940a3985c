"""Random legal settings of each study, drawn from the ranges that it declares.

Each field is drawn by itself: at an edge of its range or next to it, at its default, or
between, by its logarithm where that is the scale. Of trials there are few, which is the
harder case, and a cell is cheap. The studies of a user's code are given the package's
own, in this process: what is asked is whether the study's verdicts are right, and not
whether a process can be started.
"""

import math
import typing
from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import ValidationError

from simval.errors import InputError
from simval.plugins import Calibrator, find_plugin
from simval.streams import Streams
from simval.studies import STUDIES, calibrator, sampling
from simval.studies.named_geometries import GEOMETRIES

WITHOUT_CHANCE: Final[Mapping[str, str]] = MappingProxyType(
    {
        "scene": "draws nothing",
        "custom_scene": "draws nothing",
        "attitude_order": "draws nothing",
        "attitude_geometries": "draws nothing: its geometries are numbered",
        "attitude_map": "draws nothing: its geometries are numbered",
        "solvers": "draws one set of readings, on which all methods must agree",
    }
)
"""Studies without a judged row that has a standard error, each with the reason."""

DRAWN: Final = tuple(name for name in STUDIES if name != "custom_scene")
"""Studies whose cells can be drawn: that one's is a user's file."""

EDGE, PLAIN = 0.15, 0.25
"""Share of the values that are at an edge, and of those that are the default."""

FEW: Final = MappingProxyType(
    {"trials": 256, "samples": 4096, "cases": 64, "geometries": 20, "attitudes": 4}
)
"""Effort of a cell, or the least that is legal: as few as the gate judges."""

LIMITED: Final = MappingProxyType({"whole_log": 6, "diagnosis": 1, "audit": 2})
"""Studies that hold fewer trials to limits, and how many."""

SECONDS: Final = 3.0
"""Most that a cell says it costs."""

TEXTS: Final[Mapping[tuple[str, str], tuple[Any, ...]]] = MappingProxyType(
    {
        ("estimator", "algorithm"): tuple(
            f"simval:{name}"
            for name in ("wahba", "weighted-wahba", "triad", "closed-form", "combined")
        ),
        ("estimator", "noise"): ("body", "all", "tangent", "unequal", "general"),
        ("estimator", "geometry"): (*range(24), 12_345, 2**63 - 1, *GEOMETRIES),
        ("calibrator", "algorithm"): (
            "",  # `SIX`
            *(f"simval:{n}" for n in ("squared", "norm", "weighted", "sampson")),
        ),
        ("filter", "algorithm"): ("simval:mekf",),
        ("filter", "scenario"): (
            *("gimbal slow", "gimbal fast", "long rest", "magnetic disturbance"),
            *("anywhere", "gimbal slow, scale 1e-3", "gimbal slow, calibration 3e-4"),
            *("gimbal slow, gyroscope noise 2", "lever arm", "unknown start"),
        ),
    }
)
"""Values of fields that are text."""


def limits(info: Any) -> tuple[float, float]:
    """Least and greatest legal value of a number."""
    whole = info.annotation is int
    low, high = -math.inf, 2**200 if whole else 1e300
    for limit in info.metadata:
        match limit:
            case Ge(ge=value):
                low = value
            case Gt(gt=value):
                low = value + 1 if whole else math.nextafter(value, math.inf)
            case Le(le=value):
                high = value
            case Lt(lt=value):
                high = value - 1 if whole else math.nextafter(value, -math.inf)
    return low, high


def edges(info: Any) -> list[Any]:
    """Values of a number at its edges and next to them."""
    low, high = limits(info)
    if info.annotation is int:
        return [low, low + 1, high - 1, high]
    tiny = [1e-300, 1e-150, 1e-30, 1e-15, 1e-9] if 0.0 <= low < 1e-300 else []
    ends = [low, math.nextafter(low, high), high, math.nextafter(high, low)]
    return [float(each) for each in (*ends, *tiny)]


def between(info: Any, rng: np.random.Generator) -> Any:
    """A value between the edges, by its logarithm where that is the scale."""
    low, high = limits(info)
    high = min(high, 1e6 if info.annotation is float else 2**60)
    least = max(low, 1 if info.annotation is int else 1e-9 * high)
    if info.annotation is float and (rng.random() < 0.5 or low < 0.0):
        return float(rng.uniform(low, high))
    value = 10.0 ** rng.uniform(math.log10(least), math.log10(high))
    return info.annotation(min(max(value, least), high))


def values_of(study: str, rng: np.random.Generator) -> dict[str, Any]:
    """Values of all fields of a study, legal one by one."""
    values: dict[str, Any] = {}
    for name, info in STUDIES[study].parameters.model_fields.items():
        kind, choices = rng.random(), TEXTS.get((study, name))
        if typing.get_origin(info.annotation) is typing.Literal:
            choices = typing.get_args(info.annotation)
        if name == "time_limit":
            continue
        if choices is None and name in FEW:
            few = LIMITED.get(study, FEW[name])
            values[name] = int(min(max(few, limits(info)[0]), limits(info)[1]))
            continue
        if choices is None and kind < EDGE:
            choices = edges(info)
        if choices is not None:
            values[name] = choices[int(rng.integers(len(choices)))]
        elif kind < EDGE + PLAIN:
            values[name] = info.default
        else:
            values[name] = between(info, rng)
    return values


def made(study: str, values: dict[str, Any]) -> Any:
    """Parameters; None where they are refused, in words."""
    try:
        return STUDIES[study].parameters(**values)
    except (ValidationError, InputError):
        return None


def setting(study: str, rng: np.random.Generator) -> Any:
    """Legal parameters of a cheap cell."""
    while True:
        found = made(study, values_of(study, rng))
        if found is not None and found.cost().seconds <= SECONDS:
            return found


def compute(study: str, parameters: Any, streams: Streams) -> Any:
    """Outcome of a cell, in this process."""
    if study == "sampling":  # it draws the next seed's streams too, no other run's
        streams = Streams(2 * streams.seed, streams.key)
        return sampling.run(parameters, streams)
    if study == "calibrator":
        name = parameters.algorithm
        plugin = find_plugin(name, Calibrator) if name else SIX
        return calibrator.outcome(plugin, parameters, streams)
    module = import_module(f"simval.studies.{study}")
    return getattr(module, "compute", module.run)(parameters, streams)


def _faces(poses: Any, g: float) -> Any:
    up, down = np.split(poses.reshape(-1, 6, 3).mean(axis=0), 2)
    up, down = np.diag(up), np.diag(down)
    return np.diag(2.0 * g / (up - down)), (up + down) / 2.0


SIX: Final = Calibrator(name="six faces", calibrate=_faces, estimates=("scale", "bias"))
"""A calibrator of less than nine parameters, which the package has none of."""
