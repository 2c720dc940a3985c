"""Every number: value, standard error, sample size, unit and prediction."""

from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Table, numbers_of
from simval.report.words import sign_of_entries

MAX_ROWS = 500  # for the size of a page; the rest is counted


def section(context: Context) -> Section | None:
    """Make the section."""
    rows = [
        (cell.name, *numbers_of(row)) for cell in context.run.cells for row in cell.rows
    ]
    if not rows:
        return None
    table = Table(
        name="numbers",
        caption="Value ± standard error of each statistic"
        + sign_of_entries(
            row.statistic for cell in context.run.cells for row in cell.rows
        ),
        columns=(Column("cell", "code"), *NUMBERS),
        rows=rows,
        shown=MAX_ROWS,
    )
    return made(
        "numbers",
        "All numbers",
        tables=[table],
        folder=context.run.folder.name,
        found=f"{len(rows):,} statistics of {len(context.run.cells):,} cells.",
    )
