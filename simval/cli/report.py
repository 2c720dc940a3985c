"""`simval report`."""

from pathlib import Path

import click

from simval.cli.options import alpha_option
from simval.errors import InputError
from simval.report import csv_text, drawings, png, render, svg_file, tables
from simval.sweep import Run, load_run


@click.command(name="report")
@click.argument("run")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; by default report.html in the run folder.",
)
@click.option(
    "--figures",
    "pictures",
    type=click.Path(path_type=Path),
    help="Folder to write each figure to, as SVG and as PNG.",
)
@click.option(
    "--only",
    "names",
    multiple=True,
    metavar="NAME",
    help="With --figures: this figure only; may be given again.",
)
@click.option(
    "--tables",
    "lists",
    type=click.Path(path_type=Path),
    help="Folder to write each table to, whole, as CSV.",
)
@alpha_option
def command(
    run: str,
    out: Path | None,
    pictures: Path | None,
    names: tuple[str, ...],
    lists: Path | None,
    alpha: float,
) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    The last line printed is the path of the file.
    """
    loaded = load_run(run)
    path = out or loaded.folder / "report.html"
    try:
        path.write_text(render(loaded, alpha), encoding="utf-8")
        if pictures is not None:
            _write_figures(loaded, pictures, names)
        if lists is not None:
            _write_tables(loaded, lists)
    except OSError as error:
        msg = f"cannot write {error.filename}: {error.strerror}; choose another place"
        raise InputError(msg) from None
    click.echo(str(path))
    return 0


def _write_figures(run: Run, folder: Path, names: tuple[str, ...]) -> None:
    found = {drawing.name: drawing for drawing in drawings(run)}
    unknown = [name for name in names if name not in found]
    if unknown:
        msg = f"there is no figure `{unknown[0]}`; there are {', '.join(found)}"
        raise InputError(msg)
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or found:
        file = folder / f"{name}.svg"
        file.write_text(svg_file(found[name]), encoding="utf-8")
        file.with_suffix(".png").write_bytes(png(found[name]))


def _write_tables(run: Run, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for table in tables(run):
        file = folder / f"{table.name}.csv"
        file.write_text(csv_text(table), encoding="utf-8")
