"""The bias ladder: what each residual of a calibration costs in bias."""

from collections.abc import Sequence

from simval.report.curves import Groups, bar_width, bars, curves, first, grouped
from simval.report.findings import Claim, claiming
from simval.report.measures import part
from simval.report.noise import (
    Fits,
    fits,
    panel,
    ratios_of,
    slope_fold,
    slope_words,
)
from simval.report.panels import BarPanel, Drawing, Panel
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.report.units import PPM
from simval.results import Row
from simval.statistics import BIAS, MANY_POSES, SCALE_BIAS, SECOND_ORDER
from simval.sweep.run import CellResult

NOISE = "noise of a pose mean, m/s²"
THEORY = SECOND_ORDER
MAX_SETTINGS = 4
"""Sensors and pose counts drawn, each a row of the figure with all its residuals."""
MAX_BARS = 16
"""Bars whose names still have a line each."""
SHOWN = Shown("ladder", (SCALE_BIAS, *BIAS.each(("K_x", "K_y", "K_z"))))


Rung = tuple[str, Row, CellResult]
"""A residual, its bias of the scale, and the cell that has it."""


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = [c for c in context.cells("ladder") if c.row(SCALE_BIAS(), THEORY)]
    if not cells:
        return None
    return made("ladder", "Bias ladder", [_drawing(cells)], [_table(cells)])


def _drawing(cells: Sequence[CellResult]) -> Drawing:
    settings, rest = first(grouped(cells, "noise_std", "residual"), MAX_SETTINGS)
    panels: list[BarPanel | Panel] = []
    left_out = list(rest)
    for setting, members in settings.items():
        rungs = _lowest(members)
        lines = _by_residual(members)
        biases = [c.scaled(PPM) for c in curves(lines, part(BIAS, "K", THEORY))]
        words = f": {setting}" if setting else ""
        names = [name for name, _, _ in rungs[:MAX_BARS]]
        title, z = f"bias of scale K{words}", bar_width(biases)
        label = "relative bias of the scale, σ²/g²"
        panels.append(
            bars(
                [(cell, row) for _, row, cell in rungs[:MAX_BARS]],
                names,
                f"the ladder{words}",
                label,
            )
        )
        panels.append(panel(title, NOISE, f"bias, {PPM.name}", biases, z=z))
        panels += ratios_of(f"bias of K{words}", NOISE, biases, [], z)
        left_out += [f"{name}{words}" for name, _, _ in rungs[MAX_BARS:]]
        drawn = {c.label for c in biases}
        left_out += [
            f"{name}{words}, in the middle, as theory has no bias of K at this order"
            for name in lines
            if name not in drawn
        ]
    drawing = Drawing(
        name="ladder",
        asked="What does each residual of a calibration cost in bias?",
        caption=(
            "A row for each sensor and number of poses. Left: bias of the scale in "
            "units of σ²/g², at the smallest noise of each residual (bars with 95 % "
            "intervals for all of the row together) and theory (diamonds); it does not "
            "fall with more poses. Middle: bias of K, RMS over the axes, against the "
            "noise; expected slope 2. Right: measured over predicted, where its band "
            "tells it from 0 and from 2. Hollow triangles: upper limits."
        ),
        alternative=(
            "Bias of the scale for each residual of the calibration beside theory, and "
            "bias against noise on logarithmic axes"
        ),
        panels=panels,
        left_out=left_out,
    )
    what = BIAS.each(("K_x", "K_y", "K_z"))
    claim = Claim(subject="The bias of K", cells=cells, what=what, by=THEORY)
    return claiming(drawing, claim, before=_cost(cells))


def _cost(cells: Sequence[CellResult]) -> str:
    """The greatest and the least bias of the scale in any cell."""
    found = [(row, c) for c in cells if (row := c.row(SCALE_BIAS(), THEORY))]
    ranked = sorted(found, key=lambda each: abs(each[0].value))
    names = [str(c.parameters["residual"]) for _, c in (ranked[0], ranked[-1])]
    if names[0] == names[1]:
        return ""
    (low, _), (high, _) = ranked[0], ranked[-1]
    return (
        f"The bias of the scale is greatest for {names[1]}, {high.value:.3g} σ²/g², "
        f"and least for {names[0]}, {low.value:.2g} σ²/g². "
    )


def _size(rung: Rung) -> float:
    return abs(rung[1].value)


def _by_residual(cells: Sequence[CellResult]) -> Groups:
    groups: dict[str, list[CellResult]] = {}
    for cell in cells:
        groups.setdefault(str(cell.parameters["residual"]), []).append(cell)
    return {name: tuple(members) for name, members in groups.items()}


def _lowest(cells: Sequence[CellResult]) -> list[Rung]:
    """Row of each residual at its smallest noise, one for each seed."""
    rungs = []
    for name, members in _by_residual(cells).items():
        least = min(float(c.parameters["noise_std"]) for c in members)
        chosen = [c for c in members if c.parameters["noise_std"] == least]
        for cell in chosen:
            row = cell.row(SCALE_BIAS(), THEORY)
            assert row is not None  # the section leaves out cells without it
            several = f", seed {cell.seed}" if len(chosen) > 1 else ""
            rungs.append((f"{name}{several}", row, cell))
    return rungs


def _table(cells: Sequence[CellResult]) -> Table:
    rows = []
    found: list[Fits] = []
    for label, members in grouped(cells, "noise_std").items():
        lines = curves({label: members}, part(BIAS, "K", THEORY))
        found += [fits(c) for c in lines]
        none: tuple[str, float | None] = ("no bias at this order", None)
        slopes = slope_words(lines[0], found[-1]) if lines else none
        for cell in members:
            row, many = (cell.row(SCALE_BIAS(), by) for by in (THEORY, MANY_POSES))
            assert row is not None  # the section leaves out cells without it
            rows.append(
                (
                    label or str(cell.parameters["residual"]),
                    (row.value, row.standard_error),
                    row.prediction,
                    None if many is None else many.prediction,
                    *slopes,
                    float(cell.parameters["noise_std"]),
                    cell.seed,
                )
            )
    return Table(
        name="ladder",
        fold=slope_fold(found),
        caption="Bias of the scale in units of σ²/g², and its slope in the noise",
        columns=(
            Column("residual"),
            Column("measured", "measured"),
            Column("theory", "number"),
            Column("for many poses", "number"),
            Column("slope of K's bias (95 %)"),
            Column("of theory's own line", "number"),
            Column("noise, m/s²", "number"),
            Column("seed", "number", 12),
        ),
        rows=rows,
        shown=120,
    )
