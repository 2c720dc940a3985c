"""Every cell of every shipped suite answers for any seed, with room.

The trials of a cell are shared between the seeds: together they are as many as in one
run, so what one trial in as many would refuse is met. Every other seed has a tenth more
noise than the suite.
"""

from collections import defaultdict
from dataclasses import replace

import pytest
from power.random_settings import compute, limits

from simval.change import EFFORT
from simval.results import CellName
from simval.studies import STUDIES
from simval.studies.study import Cell
from simval.sweep import load_suite
from simval.verdict import WEIGHTS, judge
from simval.vocabulary import builtin_suites

SEEDS, ROOM = 20, 1.1


def cut(cell, seed):
    """A cell with its part of the trials; and how many times more it has in a run."""
    fields, values, times = type(cell.parameters).model_fields, {}, 1.0
    for name, value in cell.parameters.model_dump().items():
        if name in EFFORT:
            values[name] = max(value // SEEDS, limits(fields[name])[0])
            times = max(times, value / values[name])
        elif "noise" in name and isinstance(value, float) and seed % 2:
            values[name] = min(ROOM * value, limits(fields[name])[1])
    parameters = cell.parameters.model_copy(update=values)
    return Cell(cell.study, parameters, seed), times


def room_of(verdict):
    """How many times as much as it takes there is: of samples, or of a limit."""
    row = verdict.row
    if row.check in WEIGHTS:
        return row.n / verdict.samples_needed
    off = row.value if row.check == "limit" else abs(row.value - row.prediction)
    most = row.prediction if row.check == "limit" else row.remainder
    return most / off if off > 0.0 else float("inf")


@pytest.mark.slow
@pytest.mark.parametrize("suite", sorted(builtin_suites()))
def test_every_cell_of_a_shipped_suite_answers_for_any_seed(suite):
    cells = {cell.key_name: cell for cell in load_suite(suite).cells}
    assert all(
        type(c.parameters) is STUDIES[c.study].parameters for c in cells.values()
    )
    worst = defaultdict(dict)  # of each row: its greatest spread, or its least room
    for seed in range(9000, 9000 + SEEDS):
        for key, cell in cells.items():
            own, times = cut(cell, seed)
            rows = compute(own.study, own.parameters, own.streams).rows  # none refused
            name = CellName(cell.study, key)
            failed = [
                v
                for v in judge([(name, row) for row in rows], 1e-6 / len(cells))
                if v.answer == "fail"
            ]
            assert not failed, [
                (seed, key, str(v.row.statistic), v.reason) for v in failed
            ]
            for row in rows:
                known = worst[name].setdefault(row.key, [])
                if row.check in WEIGHTS:  # as if all trials were there
                    error = row.standard_error / times**0.5
                    row = replace(
                        row,
                        value=row.prediction,
                        standard_error=error,
                        n=int(row.n * times),
                    )
                known.append(row)
    # the rows with the greatest spread together, as in a run of all of them
    members = [
        (name, max(rows, key=lambda row: row.standard_error))
        for name, kinds in worst.items()
        for rows in kinds.values()
    ]
    short = [
        (str(v.cell), str(v.row.statistic), v.answer, room_of(v))
        for v in judge(members)
        if v.row.check in WEIGHTS and not room_of(v) >= ROOM
    ]
    assert not short, "\n".join(map(str, short))
    # and what changes from seed to seed keeps off its limit
    for name, kinds in worst.items():
        for rows in kinds.values():
            if (
                rows[0].check in ("limit", "exact")
                and len({row.value for row in rows}) > 1
            ):
                least = min(map(room_of, judge([(name, row) for row in rows])))
                assert least >= ROOM, (name, rows[0].statistic, least)
