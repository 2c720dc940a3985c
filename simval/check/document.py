"""A check for machines: one JSON object."""

import json
from collections.abc import Mapping
from math import isfinite
from typing import Any

from simval.check.measure import Checked
from simval.judge import Finding, findings, headline
from simval.plugins.names import located, portable
from simval.sweep.cells import CellResult
from simval.text import one_line

VERSION = 1
"""Version of this format."""


def to_json(checked: Checked) -> str:
    """Write a check as JSON: the answer, and of each plug-in every number judged."""
    result = checked.result
    judged = findings(result)
    answers = {(f.cell.name, f.statistic, f.against): f for f in judged}
    document = {
        "schema_version": VERSION,
        "answer": result.answer,
        "headline": headline(result),
        "exit_code": result.exit_code,
        "alpha": result.alpha,
        "plugins": [
            {
                "plugin": portable(located(plugin.word)),
                "name": plugin.name,
                "study": plugin.field.partition(".")[0],
                "declares": dict(plugin.declared),
                "cells": [_cell(cell, answers) for cell in checked.of(plugin)],
            }
            for plugin in checked.plugins
        ],
        "findings": [
            {"cell": str(f.cell), "statistic": f.what, "check": f.check}
            | {"answer": f.answer, "reason": f.reason}
            for f in judged
            if f.answer != "pass"
        ],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _cell(
    cell: CellResult, answers: Mapping[tuple[str, str, str], Finding]
) -> dict[str, Any]:
    rows = []
    for row in cell.rows:
        key = (one_line(cell.name), one_line(str(row.statistic)))
        judged = answers.get((*key, one_line(row.predictor)))
        numbers = {name: _number(value) for name, value in row.tidy.items()}
        rows.append(numbers | {"answer": judged.answer if judged else None})
    return {
        "cell": cell.name,
        "parameters": dict(cell.parameters),
        "ending": cell.ending,
        "reason": one_line(cell.reason) if cell.status == "failed" else "",
        "rows": rows,
    }


def _number(value: Any) -> Any:
    """A value that JSON has: what is not finite is null."""
    return None if isinstance(value, float) and not isfinite(value) else value
