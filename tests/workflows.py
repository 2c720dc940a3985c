"""The documented workflows and install lines, run by bash as a runner does.

Two things stand in for what is not there: a checkout for the placeholder of a
repository's address, and, where nothing shall be installed, a `pip` that refuses what
the real one would have to ask an index for, and leaves this environment as it is.
"""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml
from packaging.utils import InvalidWheelFilename, parse_wheel_filename
from places import ROOT

FENCED = re.compile(r"```ya?ml\n(.*?)```", re.S)
INSTALL = re.compile(r"(?:\.venv/bin/)?pip (?:install|wheel) [^\n`#]*[^\s`#]")
EVEN_THEN = ("always()", "!cancelled()")
"""Conditions under which a step is run though one before it failed."""
WITH_VALUE = ("-w", "--wheel-dir", "-C", "-r", "-c", "--target")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]


def pages():
    """Every page and example that a reader may copy from."""
    docs = [path for path in (ROOT / "docs").rglob("*") if path.is_file()]
    return [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(
            path
            for path in sorted(docs)
            if path.suffix in {".md", ".sh", ".yml", ".yaml", ""}
            and "decisions" not in path.parts
            and not path.is_relative_to(ROOT / "docs" / "reference")
        ),
    ]


def jobs():
    """Name and content of each job of each workflow."""
    found = []
    for path in pages():
        text = path.read_text(encoding="utf-8")
        whole = path.suffix in {".yml", ".yaml"}
        for block in [text] if whole else FENCED.findall(text):
            for name, job in (yaml.safe_load(block) or {}).get("jobs", {}).items():
                found.append((f"{path.stem}-{name}", job))
    return found


def install_lines():
    """Page and text of each line that installs or builds a package."""
    return [
        (path.relative_to(ROOT), line)
        for path in pages()
        for line in dict.fromkeys(INSTALL.findall(path.read_text(encoding="utf-8")))
    ]


def runs(step, codes):
    """Whether a runner starts a step after these exit codes."""
    condition = str(step.get("if", "")).strip("${} ")
    return not any(codes) or condition in EVEN_THEN


def in_bash(line, folder, bins, **variables):
    """Run the text of a step as GitHub does; `bins` go before the path."""
    path = os.pathsep.join([*map(str, bins), os.environ["PATH"]])
    env = {**os.environ, "PATH": path, **variables}
    env.pop("PYTHONPATH", None)
    return subprocess.run(
        ["bash", "-e", "-c", line],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )


def stand_in(folder):
    """A folder with a `pip` that checks what it is given, and installs nothing."""
    place = folder / "stand_in"
    place.mkdir(exist_ok=True)
    script = (
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT / 'tests')!r})\n"
    )
    script += "import workflows\nsys.exit(workflows.refusal(sys.argv[1:]))\n"
    (place / "pip").write_text(script, encoding="utf-8")
    (place / "pip").chmod(0o755)
    return place


def refusal(words):
    """Why the real pip would fail with these words, or ask an index for simval."""
    left, wanted = iter(words[1:]), []
    for word in left:
        if word in WITH_VALUE:
            next(left)
        elif not word.startswith("-"):
            wanted.append(word)
    if words[0] not in {"install", "wheel"} or not wanted:
        return f"not a line that installs: {words}"
    if len(wanted) > 1:
        return f"several versions of one package: {wanted}"
    return _reason(wanted[0])


def _reason(word):
    what, listed = re.fullmatch(r"(.*?)(?:\[([\w,]*)\])?", word).groups()
    unknown = set((listed or "").split(",")) - {"", *PROJECT["optional-dependencies"]}
    if unknown:
        return f"no extra {sorted(unknown)} in pyproject.toml"
    if what.startswith("git+"):
        is_there = (Path(what.removeprefix("git+file://")) / ".git").exists()
        return None if is_there else f"{what} is no repository"
    if Path(what, "pyproject.toml").is_file():
        return None
    if not Path(what).is_file():
        return f"an index would be asked for {word}"
    try:
        name, version, *_ = parse_wheel_filename(Path(what).name)
    except InvalidWheelFilename as error:
        return str(error)
    ours = name == PROJECT["name"] and str(version) == PROJECT["version"]
    return None if ours else f"{what} is no wheel of this version"
