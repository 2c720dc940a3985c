"""`simval report`."""

from pathlib import Path

import click

from simval.cli.options import PATH, alpha_option, refuse_if
from simval.errors import InputError
from simval.gate import BASELINE, read_baseline
from simval.report import csv_text, drawings, png, render, svg_file, tables
from simval.report.panels import Drawing
from simval.sweep import Run, load_run


@click.command(name="report")
@click.argument("run")
@click.option(
    "--out", type=PATH, help="File to write.  [default: report.html in the run folder]"
)
@click.option(
    "--figures",
    "pictures",
    type=PATH,
    help="Write each figure to this folder, as SVG and PNG.",
)
@click.option(
    "--only",
    "names",
    multiple=True,
    metavar="NAME",
    help="With --figures: only this figure; may be repeated.",
)
@click.option(
    "--tables",
    "lists",
    type=PATH,
    help="Write each table, whole, to this folder as CSV.",
)
@click.option(
    "--baseline",
    type=PATH,
    is_flag=False,
    flag_value=str(BASELINE),
    metavar="[FILE]",
    help="Say what changed from the stored statistics.  [default file: "
    f"{BASELINE}; give it after RUN]",
)
@click.option(
    "--against", metavar="RUN", help="Say what changed from this other run folder."
)
@click.option(
    "--open", "opened", is_flag=True, help="Write every fold open, as for print."
)
@alpha_option
def command(
    run: str,
    out: Path | None,
    pictures: Path | None,
    names: tuple[str, ...],
    lists: Path | None,
    baseline: Path | None,
    against: str | None,
    opened: bool,
    alpha: float,
) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    Its first screen says how wrong the algorithms are, whether that is as theory says
    and, with --baseline or --against, whether it is worse than before.

    The last line printed is the path of the file.
    """
    refuse_if(
        bool(names) and pictures is None,
        "`--only` selects figures of `--figures`; give that folder too",
    )
    loaded = load_run(run)
    stored = None if baseline is None else read_baseline(baseline)
    other = None if against is None else load_run(against)
    chosen = _chosen(loaded, names) if pictures is not None else {}
    path = out or loaded.folder / "report.html"
    try:
        page = render(loaded, alpha, baseline=stored, against=other, opened=opened)
        path.write_text(page, encoding="utf-8")
        if pictures is not None:
            _write_figures(chosen, pictures)
        if lists is not None:
            _write_tables(loaded, lists)
    except OSError as error:
        msg = f"cannot write {error.filename}: {error.strerror}; choose another place"
        raise InputError(msg) from None
    click.echo(str(path))
    return 0


def _chosen(run: Run, names: tuple[str, ...]) -> dict[str, Drawing]:
    known = {drawing.name: drawing for drawing in drawings(run)}
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f"there is no figure `{unknown[0]}`; there are {', '.join(known)}"
        raise InputError(msg)
    return {name: known[name] for name in names or known}


def _write_figures(chosen: dict[str, Drawing], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, drawing in chosen.items():
        file = folder / f"{name}.svg"
        file.write_text(svg_file(drawing), encoding="utf-8")
        file.with_suffix(".png").write_bytes(png(drawing))


def _write_tables(run: Run, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for table in tables(run):
        file = folder / f"{table.name}.csv"
        file.write_text(csv_text(table), encoding="utf-8")
