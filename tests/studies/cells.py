"""Cells of studies for tests: each is computed once."""

from functools import cache

from rows_by_name import named

from simval.studies import STUDIES
from simval.studies.study import Cell
from simval.verdict import judge


@cache
def outcome(study, seed=1, **parameters):
    """What a cell leaves."""
    made = STUDIES[study].parameters(**parameters)
    return STUDIES[study].run(made, Cell(study, made, seed).streams)


def rows_of(study, seed=1, **parameters):
    """Rows of a cell by the spelling of their statistics; of several theories one."""
    rows = outcome(study, seed, **parameters).rows
    return {str(row.statistic): row for row in rows}


def of_family(rows, *families):
    """Rows of some families."""
    return [row for row in rows if row.statistic.family in families]


def answers(rows, alpha=1e-3):
    """What the judge answers, and whether there is anything to judge."""
    return {verdict.answer for verdict in judge(named(rows), alpha)}


def excess(row):
    """Standard errors by which a row is beyond what its prediction may be off by."""
    return (abs(row.value - row.prediction) - row.remainder) / row.standard_error
