"""The algorithms of one study of a run, and what each left in each setting."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simval.judge.algorithms import Measured, Share, algorithm_of, failures
from simval.report.curves import grouped
from simval.report.parameters import setting_words
from simval.results import CellName
from simval.sweep.run import CellResult
from simval.verdict import WORST_FIRST, Verdict

ENDED = ("crashed", "refused", "pending")
"""How a cell without a result is told, the worst first; then come the verdicts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contest:
    """Algorithms that were measured in the same settings."""

    algorithms: tuple[str, ...]  # in the order of the suite
    # what varies but for the algorithm, its seed and its effort, in words
    settings: tuple[str, ...]
    # of an algorithm in a setting, one for each seed; some may have no result
    cells: Mapping[tuple[str, str], tuple[CellResult, ...]]

    def of(self, algorithm: str) -> tuple[CellResult, ...]:
        """Cells of an algorithm."""
        found = (self.cells.get((algorithm, setting), ()) for setting in self.settings)
        return tuple(cell for cells in found for cell in cells)

    def measured(
        self, algorithm: str, setting: str, measure: Callable[..., Measured | None]
    ) -> Measured | None:
        """Mean over the seeds of what is measured of an algorithm in a setting."""
        found = [measure(cell) for cell in self.cells.get((algorithm, setting), ())]
        values = [each for each in found if each is not None]
        if not values:
            return None
        value, error = np.array(values).T
        return Measured(float(value.mean()), float(np.hypot.reduce(error)) / len(value))

    def failures(self, algorithm: str) -> Mapping[str, Share]:
        """Greatest share of failures by class; no noise is in them."""
        worst: dict[str, Share] = {}
        for cell in self.of(algorithm):
            for name, share in failures(cell).items():
                if name not in worst or share.value > worst[name].value:
                    worst[name] = share
        return worst


def contest_of(cells: Sequence[CellResult]) -> Contest:
    """Sort the cells of one study by algorithm and setting."""
    names = tuple(dict.fromkeys(map(algorithm_of, cells)))
    found: dict[tuple[str, str], tuple[CellResult, ...]] = {}
    settings: dict[str, None] = {}
    for label, members in grouped(cells, "algorithm").items():
        setting = label or _only(members[0])
        settings[setting] = None
        for name in names:
            own = tuple(c for c in members if algorithm_of(c) == name)
            if own:
                found[name, setting] = own
    return Contest(algorithms=names, settings=tuple(settings), cells=found)


def _only(cell: CellResult) -> str:
    noise = cell.parameters.get("noise_std")
    known = isinstance(noise, float)
    return setting_words(cell.study, "noise_std", noise) if known else _scenario(cell)


def _scenario(cell: CellResult) -> str:
    return str(cell.parameters.get("scenario") or "all")


def answer_of(cells: Iterable[CellResult], verdicts: Iterable[Verdict]) -> str:
    """Worst answer to the cells of an algorithm, or how one without a result ended."""
    names: set[CellName] = set()
    endings = set()
    for cell in cells:
        names.add(cell.named)
        endings.add(cell.ending)
    answers = {v.answer for v in verdicts if v.cell in names}
    ranked = (*ENDED, *WORST_FIRST)
    return next((word for word in ranked if word in endings | answers), "")
