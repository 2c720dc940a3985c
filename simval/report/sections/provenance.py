"""What the numbers depend on, and the command that reproduces them."""

import json
import shlex
from collections.abc import Mapping
from typing import Any

from simval.errors import InputError
from simval.report.section import Context, Section, made
from simval.sweep import load_suite

FILE = "simval sweep suite.toml"


def section(context: Context) -> Section | None:
    """Make the section."""
    manifest = context.run.manifest
    git = manifest["git"]
    return made(
        "provenance",
        "Provenance",
        manifest=manifest,
        timing=context.run.timing,
        command=command(manifest),
        suite=suite_text(manifest),
        commit=git["commit"] or "not from a checkout",
        dirty=bool(git["dirty"]),
    )


def command(manifest: Mapping[str, Any]) -> str:
    """Command that reproduces the run."""
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
    """Words of the command line for what differs from the built-in suite."""
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
    """Spell the whole grid as a suite file."""
    grid = manifest["grid"]
    lines = [f"title = {_toml(manifest['title'])}", f"seed = {_toml(grid['seed'])}"]
    for study, table in grid.items():
        if study != "seed":
            lines += ["", f"[{study}]"]
            lines += [
                f"{key} = {_toml(value)}"
                for key, value in table.items()
                if value is not None  # left out is what the default None means
            ]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """Spell a boolean, number, text or list as TOML (JSON's spelling fits all)."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
