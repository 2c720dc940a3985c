"""The gate's power, measured on fresh seeds.

One cell at the default size of the accuracy suite, with a fault in its prediction (or
in its noise), judged among as many sound rows as a large run has. One cell is the
harder case: a fault in all cells is detected by any of them. How often the gate is
wrong about sound runs is counted in `power.tails`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any

from power.attitude import by_noise, second_order_alone
from power.fault import changed, replaced, result
from power.tails import Rate
from simval.montecarlo import simulate
from simval.montecarlo.reduction import simulate_reduced
from simval.results import CellName, Check, Row, plain
from simval.statistics import EXACT, RMS
from simval.streams import Streams, cell_key
from simval.studies import attitude
from simval.verdict import ALPHA, judge, overall

DEFAULT_SAMPLES = 4_000_000
"""Samples of a cell of the accuracy suite."""
SOUND_ROWS: dict[Check, int] = {"plain": 2000, "control": 200, "nees": 100}
"""Rows with p = 1 beside a fault: more than the accuracy suite has."""

Rows = list[tuple[CellName, Row]]
"""Name of a cell and one of its rows."""


def formula_faults() -> dict[str, tuple[float, Callable[..., Any]]]:
    """Faults in a prediction: noise level of the cell that has it, and the change."""
    return {
        "covariance 1 % too large": (
            0.003,
            result(covariance=lambda m: 1.01 * m.covariance),
        ),
        "covariance 1 % too small": (
            0.003,
            result(covariance=lambda m: 0.99 * m.covariance),
        ),
        "sign of the bias": (0.003, result(bias=lambda m: -m.bias)),
        # every prediction that claims more than the second order keeps the second only
        "fourth-order term missing": (0.05, by_noise(second_order_alone)),
    }


def powers(runs: int, seed: int) -> list[Rate]:
    """Judge one cell of default size with each fault."""
    faults = formula_faults()
    counts = dict.fromkeys([*faults, "noise 1 % larger"], 0)
    sound = list(_sound())
    for number in range(runs):
        for noise in sorted({noise for noise, _ in faults.values()}):
            with drawn_once():
                for name, (where, change) in faults.items():
                    if where == noise:
                        with claimed(change):
                            rows = _rows(noise, DEFAULT_SAMPLES, seed + number)
                        counts[name] += _caught([*rows, *sound])
        with claimed(lambda o, *given, order: o(*given[:3], 0.003, order=order)):
            rows = _rows(0.00303, DEFAULT_SAMPLES, seed + number)
        counts["noise 1 % larger"] += _caught([*rows, *sound])
    return [
        Rate(name=name, nominal=0.99, count=count, runs=runs)
        for name, count in counts.items()
    ]


@contextmanager
def drawn_once() -> Iterator[None]:
    """Draw the samples of the attitude study only once, for several claims."""
    with (
        replaced(attitude, "simulate", _once(simulate)),
        replaced(attitude, "simulate_reduced", _once(simulate_reduced)),
    ):
        yield


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    kept: list[Any] = []

    def once(*arguments: Any, **options: Any) -> Any:
        if not kept:
            kept.append(function(*arguments, **options))
        return kept[0]

    return once


def claimed(change: Callable[..., Any]) -> AbstractContextManager[None]:
    """Inject a fault into the predictions of the attitude study."""
    return changed(attitude, "attitude_moments", change)


def _rows(noise: float, samples: int, seed: int) -> Rows:
    parameters = attitude.Parameters(geometry=3, noise_std=noise, samples=samples)
    name = f"attitude(geometry=3,noise_std={noise},samples={samples})"
    outcome = attitude.run(parameters, Streams(seed, cell_key(name)))
    return [(CellName("attitude", name), row) for row in outcome.rows]


def _sound() -> Iterator[tuple[CellName, Row]]:
    (row,) = plain(RMS(), 1.0, 1e-3, DEFAULT_SAMPLES, 1.0, EXACT)
    for check, count in SOUND_ROWS.items():
        for number in range(count):
            yield CellName(f"sound{number}", check), replace(row, check=check)


def _caught(rows: Sequence[tuple[CellName, Row]]) -> bool:
    return overall(judge(rows, ALPHA)) == "fail"
