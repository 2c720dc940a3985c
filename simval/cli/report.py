"""`simval report`."""

from pathlib import Path

import click

from simval.errors import InputError
from simval.report import render
from simval.sweep import load_run


@click.command(name="report")
@click.argument("run")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write; by default report.html in the run folder.",
)
def command(run: str, out: Path | None) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    The last line printed is the path of the file.
    """
    loaded = load_run(run)
    path = out or loaded.folder / "report.html"
    try:
        path.write_text(render(loaded), encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}; choose another file with --out"
        raise InputError(msg) from None
    click.echo(str(path))
    return 0
