"""The gate's line: the same in every output, and nothing in it that is not so."""

import re

import numpy as np
import pytest
import rows_by_name

from simval.judge import Gap, GateResult, headline
from simval.judge.comparison import Comparison
from simval.results import CellName
from simval.sweep.run import CellResult
from simval.verdict import Verdict

NUMBER = r"([\d,]+)"


def verdict(answer):
    row = rows_by_name.row("bias[x]", 0.0, prediction=0.0, check="exact")
    return Verdict(
        cell=CellName("a", "a()@1"),
        row=row,
        answer=answer,
        p_value=None,
        limit=0.0,
        reason="",
    )


def comparison(change):
    return Comparison(
        cell=CellName("a", "a()@1"),
        statistic="a",
        change=change,
        stored=0.0,
        value=0.0,
        standard_error=0.0,
    )


def unfinished(status):
    return CellResult(
        name="a()@1",
        study="a",
        seed=1,
        parameters={},
        status=status,
        error="",
        seconds=0.0,
        rows=(),
    )


def drawn(rng):
    """A result of any kind, often with none or one of something."""

    def some(words, weights=None):
        count = int(rng.choice([0, 1, 2, 5, 1200], p=[0.3, 0.2, 0.2, 0.25, 0.05]))
        chosen = rng.choice(words, size=rng.integers(1, len(words) + 1), replace=False)
        return [str(word) for word in rng.choice(chosen, size=count)]

    changes = ["same", "close", "changed", "missing", "unresolved", "new"]
    return GateResult(
        verdicts=tuple(map(verdict, some(["pass", "fail", "inconclusive"]))),
        comparisons=tuple(map(comparison, some(changes))),
        unfinished=tuple(map(unfinished, some(["failed", "pending"]))),
        gaps=tuple(Gap(cell="", reason="x") for _ in some(["x"])),
        environment=(),
        alpha=1e-3,
        first="x" if rng.random() < 0.1 else "",
    )


def told(pattern, text):
    """The number that the line gives; 0 where it does not speak of it."""
    found = re.search(pattern, text)
    return int(found[1].replace(",", "")) if found else 0


@pytest.mark.ci
def test_a_line_says_what_is_so_of_any_result():
    rng = np.random.default_rng(13)
    for _ in range(300):
        result = drawn(rng)
        line = headline(result)
        statuses = [cell.status for cell in result.unfinished]
        assert told(rf"{NUMBER} cells? crashed", line) == statuses.count("failed")
        assert told(rf"{NUMBER} cells? never run", line) == statuses.count("pending")
        assert told(rf"{NUMBER} things? not measured", line) == len(result.gaps)
        assert ("no baseline" in line) == bool(result.first)
        parts = line.split("; ")
        for words, answers in (
            ("against theory", [v.answer for v in result.verdicts]),
            (
                "with the baseline",
                [c.answer for c in result.comparisons if c.change != "new"],
            ),
        ):
            part = next((p for p in parts if words in p), "")
            assert bool(part) == bool(answers)
            assert told(rf"{NUMBER} failed", part) == answers.count("fail")
            assert told(rf"{NUMBER} w\w+ inconclusive", part) == answers.count(
                "inconclusive"
            )
            assert ("agree" in part) == (bool(answers) and set(answers) == {"pass"})
        if result.answer == "pass":
            assert all("agree" in part for part in parts)
        else:
            assert not all("agree" in part for part in parts)
