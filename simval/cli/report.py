"""What `simval report` does."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from simval.cli.options import refuse_if
from simval.cli.outputs import beside_store, require_free
from simval.errors import InputError
from simval.judge import read_baseline
from simval.report import csv_text, drawings, png, render, svg_file, tables
from simval.report.panels import Drawing
from simval.sweep import Run, load_run


def run(
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
    """Do what `simval report` is asked."""
    refuse_if(
        bool(names) and pictures is None,
        "`--only` selects figures of `--figures`; give that folder too",
    )
    loaded = load_run(run)
    stored = None if baseline is None else read_baseline(baseline)
    other = None if against is None else load_run(against)
    chosen = _chosen(loaded, names) if pictures is not None else {}
    path = out or beside_store(loaded.folder, "report.html")
    try:
        page = render(loaded, alpha, baseline=stored, against=other, opened=opened)
        with _named(path):
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


@contextmanager
def _named(file: Path) -> Iterator[Path]:
    # a full disk shows while a file is written, and such an error has no name
    try:
        yield file
    except OSError as error:
        error.filename = error.filename or str(file)
        raise


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
        require_free(file, "--figures")
        require_free(file.with_suffix(".png"), "--figures")
        with _named(file):
            file.write_text(svg_file(drawing), encoding="utf-8")
        with _named(file.with_suffix(".png")) as picture:
            picture.write_bytes(png(drawing))


def _write_tables(run: Run, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for table in tables(run):
        file = folder / f"{table.name}.csv"
        require_free(file, "--tables")
        with _named(file):
            file.write_text(csv_text(table), encoding="utf-8")
