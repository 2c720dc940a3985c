"""What `simval filter` writes as JSON: SI units and radians."""

from dataclasses import asdict
from typing import Any

import numpy as np

from simval.logs import Truth
from simval.recorded import Alignment, Evaluation
from simval.recorded.errors import Consistency, Measured
from simval.recorded.evaluation import norths


def truth_object(alignment: Alignment, recorded: Truth) -> dict[str, Any]:
    """The truth and its alignment as plain JSON values; half widths are of 95 %."""
    world, fit, errors = alignment.world, alignment.fit, alignment.errors
    return {
        "columns": list(recorded.columns),
        "own_clock": recorded.own_clock,
        "scalar": alignment.meaning.scalar,
        "takes": alignment.meaning.takes,
        "same": [[each.scalar, each.takes] for each in alignment.same],
        "better": plain(alignment.better),
        "missing": 1.0 - float(np.mean(np.isfinite(alignment.attitude[:, 0]))),
        "noise": plain(alignment.noise),
        "offset": _measured(alignment.offset),
        "drift": _measured(alignment.drift),
        "axes": [_measured(each) for each in alignment.axes],
        "gyroscope": {
            "linear": plain(fit.linear),
            "own_sd": plain(errors.own),
            "bias": plain(fit.bias),
            "bias_sd": plain(errors.bias),
            "unexplained": fit.share,
        },
        "world": {
            "matrix": plain(world.matrix),
            "tilt_sd": plain(world.tilt_sd),
            "tilt_half": plain(world.half("tilt")),
            "heading_sd": world.heading_sd,
            "heading_half": plain(world.half("heading")),
            "rests": world.rests,
            "name": world.name or None,
            "off": plain(world.off),
            "heading_deviation": world.deviation,
            "taken": world.taken,
        },
    }


def _measured(each: Measured) -> dict[str, Any]:
    return {"value": each.value, "sd": each.sd, "half": each.half, "dof": each.dof}


def evaluation_object(each: Evaluation) -> dict[str, Any]:
    """One filter's measures as plain JSON values, in SI units and radians."""
    found: dict[str, Any] = {
        "filter": each.run.name,
        "world": each.run.world,
        "how": each.run.how,
        "rows": len(each.run.output.kept),
        "microseconds": each.microseconds,
        "at_rest": {
            "heading_drift": plain(each.at_rest.drift),
            "inclination": plain(each.at_rest.inclination),
            "rests": each.at_rest.rests,
        },
        "nis": _consistency(each.nis),
        "innovation_correlation": None if each.white is None else plain(each.white),
    }
    if each.truth is not None:
        found |= {
            "rms": {
                part: {
                    name: {"value": plain(rms.value), "sd": plain(rms.sd)}
                    for name, rms in own.items()
                }
                for part, own in each.truth.rms.items()
            },
            "total_at_norths": [
                {"turned": turn, "rms": value}
                for turn, value in zip(
                    norths(each.truth.world), each.truth.turned, strict=True
                )
            ],
            "rows_with_truth": len(each.truth.errors.time),
            "converged_after": plain(each.truth.settled),
            "nees": _consistency(each.truth.nees),
        }
    return found


def _consistency(each: Consistency | None) -> dict[str, Any] | None:
    if each is None:
        return None
    return {name: plain(value) for name, value in asdict(each).items()}


def plain(value: Any) -> Any:
    """Numbers as JSON has them; what is not finite is null."""
    if isinstance(value, str):
        return value
    array = np.asarray(value)
    if array.ndim:
        return [plain(each) for each in array]
    return array.item() if np.isfinite(array) else None
