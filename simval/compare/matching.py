"""The statistics that two runs have in common.

A cell is matched by its study and parameters, without the seed and the number of
samples. Several equal ones are matched by seed or, without a common seed, in order.
"""

from simval.change import EXACT_BOUND, is_near, matched, question
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.run import CellResult, Run

Pair = tuple[CellResult, CellResult, Row, Row, tuple[str, ...]]
"""Both cells, a statistic in each, and the theories it is compared with."""


def match(
    a: Run, b: Run
) -> tuple[list[tuple[CellResult, CellResult]], list[str], list[str]]:
    """Find the finished cells that two runs have in common.

    Parameters
    ----------
    a, b : Run
        The runs.

    Returns
    -------
    pairs : list of (CellResult, CellResult)
        In the order of A.
    only_a, only_b : list of str
        Names of the cells without a partner.
    """
    pairs, only_a, only_b = matched(
        _finished(a),
        _finished(b),
        lambda cell: (cell.study, str(question(cell.parameters))),
        lambda cell: cell.seed,
    )
    return pairs, [cell.name for cell in only_a], [cell.name for cell in only_b]


def _finished(run: Run) -> list[CellResult]:
    return [cell for cell in run.cells if cell.status == "done"]


def pairs_of(old: CellResult, new: CellResult) -> list[Pair]:
    """Pair the statistics of two cells."""
    before, after = rows_of(old), rows_of(new)
    merged: dict[tuple[object, ...], tuple[Row, Row, list[str]]] = {}
    for key, a in before.items():
        b = after.get(key)
        if b is None:
            continue
        # apart where theory moved or a limit judges, so that neither is lost
        own = key[1] if a.check == "limit" or prediction_changed(a, b) else ""
        measured = (a.value, a.standard_error, b.value, b.standard_error)
        entry = merged.setdefault((key[0], own, *measured), (a, b, []))
        entry[2].append(key[1])
    return [(old, new, a, b, tuple(theories)) for a, b, theories in merged.values()]


def prediction_changed(a: Row, b: Row) -> bool:
    """Whether the prediction of a statistic changed."""
    if a.prediction is None or b.prediction is None:
        return a.prediction is not b.prediction
    return not is_near(a.prediction, b.prediction, EXACT_BOUND)


def rows_of(cell: CellResult) -> dict[tuple[Statistic, str], Row]:
    """Index the rows of a cell."""
    return {row.key: row for row in cell.rows}


def shared_words(a: Run, b: Run) -> str:
    """Say what two runs without a common cell do have in common."""
    studies = [list(dict.fromkeys(c.study for c in _finished(r))) for r in (a, b)]
    both = [study for study in studies[0] if study in studies[1]]
    suites = [str(run.manifest.get("suite", "unknown")) for run in (a, b)]
    of = f"both are of the suite {suites[0]}"
    if suites[0] != suites[1]:
        of = f"A is of the suite {suites[0]}, B of {suites[1]}"
    if both:
        return f"{of}; both have {', '.join(both)}, but at other parameters"
    listed = [", ".join(names) or "nothing" for names in studies]
    return f"{of}; A has measured {listed[0]}, B {listed[1]}"
