"""Every number: value, standard error, sample size, unit and prediction."""

from simval.report.section import Context, Section, made
from simval.report.table import Column, Table
from simval.report.words import sign_of_entries

SHOWN = 500


def section(context: Context) -> Section | None:
    """Make the section."""
    rows = [
        (
            cell.name,
            str(row.statistic),
            (row.value, row.standard_error),
            row.unit,
            row.n,
            row.prediction,
            row.predictor,
        )
        for cell in context.run.cells
        for row in cell.rows
    ]
    if not rows:
        return None
    table = Table(
        name="numbers",
        caption="Value ± standard error of each statistic"
        + sign_of_entries(
            row.statistic for cell in context.run.cells for row in cell.rows
        ),
        columns=(
            Column("cell", "code"),
            Column("statistic"),
            Column("value", "measured"),
            Column("unit"),
            Column("n", "number", 12),
            Column("prediction", "number"),
            Column("by"),
        ),
        rows=rows,
        shown=SHOWN,
    )
    return made(
        "numbers", "All numbers", tables=[table], folder=context.run.folder.name
    )
