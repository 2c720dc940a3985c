"""What a command of the program imports, and what the table lets it import."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

from places import ROOT

TABLE = tomllib.loads((ROOT / "tests" / "imports.toml").read_text())
# not by -X importtime, which leaves out what `importlib.import_module` imports
PROGRAM = """
import atexit, sys
atexit.register(lambda: print("loaded", *sys.modules, file=sys.stderr))
"""
COMMAND = PROGRAM + "from simval.cli import main; main()"


def imported(*words: str | Path, program: str = COMMAND) -> set[str]:
    """Modules beside Python's own that are loaded in a process of its own."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert done.returncode in (0, 1, 3), done.stderr[-2000:]
    loaded = set(done.stderr.splitlines()[-1].split()[1:])
    known = sys.stdlib_module_names | {"cython_runtime"}
    return {n for n in loaded if n[0] != "_" and n.split(".")[0] not in known}


def within(name: str, places: list[str]) -> bool:
    """Whether a module is one of some packages or modules, or lies in one."""
    return any(f"{name}.".startswith(f"{place}.") for place in places)


def parent(name: str, places: list[str]) -> bool:
    """Whether a module is a package that holds one of some packages or modules."""
    return any(place.startswith(f"{name}.") for place in places)


def strangers(command: str, loaded: set[str]) -> list[str]:
    """Modules that the table does not let a command import."""
    row, always = TABLE[command], TABLE["always"]
    may = [*always["may"], *row["may"]]
    never = [*always["never"], *row.get("never", [])]
    return sorted(
        name
        for name in loaded
        if not (within(name, may) or parent(name, may)) or within(name, never)
    )


def idle(command: str, loaded: set[str]) -> list[str]:
    """What the table lets a command import, and the command does not."""
    return [m for m in TABLE[command]["may"] if not any(within(n, [m]) for n in loaded)]
