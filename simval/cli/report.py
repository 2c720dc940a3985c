"""`simval report`."""

from pathlib import Path

import click

from simval.errors import InputError
from simval.report import figures, render
from simval.sweep import load_run


@click.command(name="report")
@click.argument("run")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; by default report.html in the run folder.",
)
@click.option(
    "--figures",
    "folder",
    type=click.Path(path_type=Path),
    help="Folder to write each figure to, as an SVG file of its own.",
)
def command(run: str, out: Path | None, folder: Path | None) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    The last line printed is the path of the file.
    """
    loaded = load_run(run)
    path = out or loaded.folder / "report.html"
    try:
        path.write_text(render(loaded), encoding="utf-8")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            for name, drawn in figures(loaded).items():
                (folder / f"{name}.svg").write_text(drawn, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {error.filename}: {error.strerror}; choose another place"
        raise InputError(msg) from None
    click.echo(str(path))
    return 0
