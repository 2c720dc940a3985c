"""What moved, for machines: JSON without a number that JSON does not know."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from math import isfinite
from typing import Any

from simval.compare.differences import RunComparison
from simval.compare.moves import Move, Step, moved
from simval.compare.origin import origin_of
from simval.compare.trend import WAYS, Trend
from simval.sweep.run import Run


def comparison_json(a: Run, b: Run, found: RunComparison) -> str:
    """Write the comparison of two runs: the runs, the counts, and what moved."""
    document = {
        "schema_version": 1,
        "a": asdict(origin_of(a)),
        "b": asdict(origin_of(b)),
        "alpha": found.alpha,
        "common": len(found.differences),
        "changed": {way: found.count(way) for way in WAYS},
        "moved_within_chance": len(found.of("moved")),
        "moves": moves_of(moved(found.steps)),
        "environment": list(found.environment),
        "only_a": list(found.only_a),
        "only_b": list(found.only_b),
    }
    return as_json(document)


def trend_json(trend: Trend) -> str:
    """Write a series of runs: the runs in order, and what moved since which."""
    document = {
        "schema_version": 1,
        "alpha": trend.alpha,
        "statistics": len(trend.lines),
        "with_a_step": trend.changed,
        "runs": [
            asdict(origin)
            | {way: trend.count(run, way) for way in WAYS}
            | {"moved_within_chance": trend.within[run]}
            for run, origin in enumerate(trend.origins)
        ],
        "moves": [
            {"since_run": trend.origins[run].name, "since": trend.origins[run].label}
            | moves_of([move])[0]
            for run, move in trend.moves
        ],
    }
    return as_json(document)


def moves_of(moves: Iterable[Move]) -> list[dict[str, Any]]:
    """Each move with all its values, largest first."""
    return [
        {
            "study": move.study,
            "what": move.what,
            "standing": move.standing,
            "size": move.size,
            "standard_errors": move.sigmas,
            "cells": move.cells,
            "of_cells": move.of,
            "values": [_value(step) for step in move.steps],
        }
        for move in moves
    ]


def _value(step: Step) -> dict[str, Any]:
    return {
        "cell": step.cell,
        "statistic": str(step.statistic),
        "unit": step.statistic.unit,
        "before": number(step.before),
        "after": number(step.after),
        "standard_error": number(step.error),
        "standard_errors": number(step.sigmas),
        "relative": number(step.relative),
    }


def number(value: float | None) -> float | None:
    """A number that JSON has; None of all others."""
    return None if value is None or not isfinite(value) else value


def as_json(document: Mapping[str, Any]) -> str:
    """Text of a document."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
