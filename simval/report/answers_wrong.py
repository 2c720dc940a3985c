"""How wrong: for each study of a run the size of its errors in one chosen cell.

The cell is that of the middle noise level of its study (of two middle ones the
smaller) and the most poses, and of the algorithm that the suite names first; of several
such cells the one with the greatest error. Noise-free cells have no error to tell.
"""

from collections.abc import Sequence

from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.judge.findings import reproduce
from simval.report.answers import SHOWN, Block, Line, called, in_order
from simval.report.answers_algorithms import lines_of_algorithms
from simval.report.answers_readings import Reading, any_reading, of_headline
from simval.report.chapters import home
from simval.report.curves import varying
from simval.report.parameters import setting_words
from simval.report.section import Context
from simval.studies import STUDIES
from simval.sweep.run import CellResult

NOISES = (
    "noise_std",
    "accelerometer_noise_std",
    "accelerometer_noise",
    "magnetometer_noise_std",
    "field_noise",
    "angle_random_walk",
)
"""Parameters that say how noisy a sensor is."""

MIDDLE = (*NOISES, "multiplier")
"""Parameters of which the middle value is chosen: noise, and a detector's threshold."""

ALGORITHM = ("estimator", "residual", "estimate", "sigma", "trim")
"""Parameters that choose an algorithm or set it, not what it is given."""

RULE = (
    "Each in the cell of its study's middle noise level, most poses and first "
    "algorithm; of several such cells, in the one with the greatest error. "
    "\N{PLUS-MINUS SIGN}: standard error."
)


def how_wrong(context: Context) -> Block:
    """Answer how great the errors are."""
    lines = lines_of_algorithms(context)
    told = {line.what for line in lines}
    for study in in_order([cell.study for cell in context.run.cells]):
        if study in OF_ALGORITHMS and told:
            continue
        lines.append(_line(context, study))
    return Block(
        title="How wrong",
        answer="pass",
        headline="",
        lines=lines,
        note=RULE,
        fold="more algorithms" if len(told) > SHOWN else "more studies",
    )


def _line(context: Context, study: str) -> Line:
    cells = context.cells(study)
    found = chosen(study, cells)
    if found is None:
        left = [cell for cell in context.run.cells if cell.study == study]
        endings = dict.fromkeys(cell.ending for cell in left if cell not in cells)
        ended = {"pending": "never run", "done": "without numbers"}
        why = ", ".join(ended.get(word, word) for word in endings)
        said = f"not measured{f': {why}' if why else ''}"
        return Line(what=called(study), said=said, answer="inconclusive")
    cell, reading = found
    return Line(
        what=called(study),
        said=reading.said,
        where=where(cell, cells, reading.n),
        link=home(study),
        command=reproduce(cell.named, context.folder),
    )


def chosen(
    study: str, cells: Sequence[CellResult]
) -> tuple[CellResult, Reading] | None:
    """The cell that a study is told by, and what it says."""
    own = STUDIES[study].headline if study in STUDIES else None
    readings = [
        (cell, reading)
        for cell in typical(cells)
        if (reading := (own and of_headline(own, cell)) or any_reading(cell))
        is not None
    ]
    return max(readings, key=lambda pair: pair[1].size, default=None)


def typical(cells: Sequence[CellResult], *, poses: bool = True) -> Sequence[CellResult]:
    """Cells of the middle noise, the first algorithm and, if asked, the most poses."""
    for key in MIDDLE:
        levels = sorted({v for cell in cells if (v := cell.parameters.get(key))})
        if levels:
            middle = levels[(len(levels) - 1) // 2]
            cells = [cell for cell in cells if cell.parameters.get(key) == middle]
    for key in ALGORITHM:
        names = [cell.parameters.get(key) for cell in cells]
        cells = [c for c, own in zip(cells, names, strict=True) if own == names[0]]
    if not poses:
        return cells
    most = max((cell.parameters.get("poses", 0) for cell in cells), default=0)
    return [cell for cell in cells if cell.parameters.get("poses", 0) == most]


def where(cell: CellResult, cells: Sequence[CellResult], n: int) -> str:
    """Which cell of its study this is, in words."""
    values = cell.parameters
    skipped = ("samples", "trials")
    shown = [key for key in (*NOISES, "poses") if values.get(key)]
    shown += [key for key in varying(cells) if key not in (*NOISES, "poses", *skipped)]
    words = [setting_words(cell.study, key, values.get(key)) for key in shown]
    return ", ".join([*words, f"{n:,} trials"] if n > 1 else words)
