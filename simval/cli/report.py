"""`simval report`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from simval.cli.options import (
    Alpha,
    OutFile,
    OutFolder,
    RunName,
    declared,
    refuse_if,
)
from simval.cli.outputs import beside_store, require_free
from simval.cli.terminal import say
from simval.errors import InputError
from simval.extras import needing
from simval.vocabulary import ALPHA, BASELINE

if TYPE_CHECKING:
    from simval.report.panels import Drawing
    from simval.sweep import Run


@declared("report")
def command(
    run: RunName,
    out: Annotated[
        OutFile | None, "Page to write.  [default: report.html in the run folder]"
    ] = None,
    pictures: Annotated[
        OutFolder | None,
        "Write each figure to this folder too, as SVG and (extra `plots`) PNG.",
        dict(name="--figures"),
    ] = None,
    names: Annotated[
        tuple[str, ...],
        "With --figures, write only this figure; may be repeated.",
        dict(name="--only", metavar="NAME"),
    ] = (),
    lists: Annotated[
        OutFolder | None,
        "Write each table, with all its rows, to this folder as CSV.",
        dict(name="--tables"),
    ] = None,
    baseline: Annotated[
        Path | None,
        "Say on the page what changed since this baseline; put the option after RUN.  "
        f"[default file: {BASELINE}]",
        dict(is_flag=False, flag_value=str(BASELINE), metavar="[FILE]"),
    ] = None,
    against: Annotated[
        str | None,
        "Say on the page what changed since this other run.",
        dict(metavar="RUN"),
    ] = None,
    opened: Annotated[
        bool, "Write the page with every fold open, to print.", dict(name="--open")
    ] = False,
    alpha: Alpha = ALPHA,
) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    The first screen says how wrong the algorithms are, whether theory says so too and,
    with --baseline or --against, whether they are worse than before. The last line
    printed is the path of the page.
    """
    from simval.judge import read_baseline
    from simval.report import render
    from simval.sweep import load_run

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
    from simval.report import drawings

    known = {drawing.name: drawing for drawing in drawings(run)}
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f"there is no figure `{unknown[0]}`; there are {', '.join(known)}"
        raise InputError(msg)
    return {name: known[name] for name in names or known}


def _write_figures(chosen: dict[str, Drawing], folder: Path) -> None:
    from simval.report import png, svg_file

    pixels = find_spec("matplotlib") is not None
    folder.mkdir(parents=True, exist_ok=True)
    for name, drawing in chosen.items():
        file = folder / f"{name}.svg"
        require_free(file, "--figures")
        require_free(file.with_suffix(".png"), "--figures")
        with _named(file):
            file.write_text(svg_file(drawing), encoding="utf-8")
        if pixels:
            with _named(file.with_suffix(".png")) as picture:
                picture.write_bytes(png(drawing))
    if not pixels:
        say(
            [f"the figures are SVG alone; {needing('plots', 'writing .png')}"], err=True
        )


def _write_tables(run: Run, folder: Path) -> None:
    from simval.report import csv_text, tables

    folder.mkdir(parents=True, exist_ok=True)
    for table in tables(run):
        file = folder / f"{table.name}.csv"
        require_free(file, "--tables")
        with _named(file):
            file.write_text(csv_text(table), encoding="utf-8")
