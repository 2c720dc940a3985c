"""Record of a run: what is missing, every number, and how to repeat it."""

import json
import shlex
from collections.abc import Mapping
from typing import Any

from simval.errors import InputError
from simval.judge.findings import reproduce
from simval.report.formatting import sign_of_entries
from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Table, numbers_of
from simval.sweep import load_suite

# ---- what was not measured

MAX_FAILURES = 200  # for the size of a page; the rest is counted


def failures_section(context: Context) -> Section | None:
    """Make the section on cells without results."""
    unfinished, gaps = context.judged.unfinished, context.judged.gaps
    if not unfinished and not gaps:
        return None
    cells = [cell for cell in unfinished if cell.status == "failed"]
    return made(
        cells=cells[:MAX_FAILURES],
        commands=[
            reproduce(cell.named, context.folder) for cell in cells[:MAX_FAILURES]
        ],
        pending=[cell.name for cell in unfinished if cell.status == "pending"],
        folder=shlex.quote(context.folder),
        gaps=gaps[:MAX_FAILURES],
        hidden=max(0, len(cells) - MAX_FAILURES) + max(0, len(gaps) - MAX_FAILURES),
    )


# ---- all numbers

MAX_NUMBERS = 500  # for the size of a page; the rest is counted


def numbers_section(context: Context) -> Section | None:
    """Make the section with every number."""
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
        shown=MAX_NUMBERS,
    )
    return made(
        tables=[table],
        folder=context.run.folder.name,
    )


# ---- provenance

FILE = "simval sweep suite.toml"


def provenance_section(context: Context) -> Section | None:
    """Make the section on where the numbers come from."""
    manifest = context.run.manifest
    git = manifest["git"]
    return made(
        manifest=manifest,
        timing=context.run.timing,
        command=command(manifest),
        suite=suite_text(manifest),
        commit=git["commit"] or "not from a checkout",
        dirty=bool(git["dirty"]),
    )


def command(manifest: Mapping[str, Any]) -> str:
    """Command that repeats the run."""
    grid = manifest["grid"]
    try:
        known = load_suite(manifest["suite"]).grid
    except InputError:
        return FILE
    seeds = grid["seed"]
    if not set(known) <= set(grid) or (seeds != known["seed"] and len(seeds) > 1):
        return FILE
    words = ["simval", "sweep", manifest["suite"]]
    if seeds != known["seed"]:
        words += ["--seed", str(seeds[0])]
    return shlex.join([*words, *_settings(known, grid)])


def _settings(known: Mapping[str, Any], grid: Mapping[str, Any]) -> list[str]:
    """Options for whatever differs from the built-in suite."""
    words = []
    for study, table in grid.items():
        if study == "seed":
            continue
        for key, value in table.items():
            if value != known.get(study, {}).get(key):
                items = value if isinstance(value, list) else [value]
                words += ["--set", f"{study}.{key}={','.join(map(_toml, items))}"]
    return words


def suite_text(manifest: Mapping[str, Any]) -> str:
    """The whole grid as a suite file."""
    grid = manifest["grid"]
    own = {key: manifest[key] for key in ("title", "question") if manifest.get(key)}
    tables = [("", own | {"seed": grid["seed"]})]
    tables += [("[[need]]", need) for need in manifest.get("need", ())]
    tables += [(f"[{s}]", table) for s, table in grid.items() if s != "seed"]
    lines = [
        line
        for head, table in tables
        for line in (
            *((["", head]) if head else ()),
            *(
                f"{key} = {_toml(value)}"
                for key, value in table.items()
                if value is not None  # left out is what the default None means
            ),
        )
    ]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """Spell a boolean, number, text or list in TOML."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
