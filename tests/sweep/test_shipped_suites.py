"""Every cell of every shipped suite answers for any seed, with room.

The trials of a cell are shared between the seeds: together they are as many as in one
run, so what one trial in as many would refuse is met. Every other seed has a tenth more
noise than the suite. A standard error from few trials scatters more than a run's, so it
is not the greatest that is asked for room, but what one run in a thousand exceeds.
"""

from collections import defaultdict
from dataclasses import replace
from math import ceil

import numpy as np
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


def widest(rows, times):
    """A row with the standard error that one run in a thousand exceeds."""
    errors = np.array([row.standard_error for row in rows]) / times**0.5
    # of either noise: a run has as many times more trials, and scatters less by so much
    most = max(
        own.mean() + 3.1 * own.std(ddof=1) / times**0.5
        for own in (errors[::2], errors[1::2])
        if len(own) > 1
    )
    # upwards: a standard error that is a floor is one by the number of samples
    count = ceil(rows[0].n * times)
    return replace(rows[0], standard_error=float(most), n=count)


@pytest.mark.slow
@pytest.mark.parametrize("suite", sorted(builtin_suites()))
def test_every_cell_of_a_shipped_suite_answers_for_any_seed(suite):
    cells = {cell.key_name: cell for cell in load_suite(suite).cells}
    assert all(
        type(c.parameters) is STUDIES[c.study].parameters for c in cells.values()
    )
    found, more = defaultdict(dict), {}
    for seed in range(9000, 9000 + SEEDS):
        for key, cell in cells.items():
            own, times = cut(cell, seed)
            rows = compute(own.study, own.parameters, own.streams).rows  # none refused
            name = CellName(cell.study, key)
            more[name] = times
            failed = [
                v
                for v in judge([(name, row) for row in rows], 1e-6 / len(cells))
                if v.answer == "fail"
            ]
            assert not failed, [
                (seed, key, str(v.row.statistic), v.reason) for v in failed
            ]
            for row in rows:
                if row.check in WEIGHTS:
                    row = replace(row, value=row.prediction)
                found[name].setdefault(row.key, []).append(row)
    # the rows with the greatest spread together, as in a run of all of them
    members = [
        (name, widest(rows, more[name]))
        for name, kinds in found.items()
        for rows in kinds.values()
        if rows[0].check in WEIGHTS and len(rows) > 2
    ]
    short = [
        (str(v.cell), str(v.row.statistic), v.answer, room_of(v))
        for v in judge(members)
        if not room_of(v) >= ROOM
    ]
    assert not short, "\n".join(map(str, short))
    # and what changes from seed to seed keeps off its limit
    for name, kinds in found.items():
        for rows in kinds.values():
            if (
                rows[0].check in ("limit", "exact")
                and len({row.value for row in rows}) > 1
            ):
                least = min(map(room_of, judge([(name, row) for row in rows])))
                assert least >= ROOM, (name, rows[0].statistic, least)
