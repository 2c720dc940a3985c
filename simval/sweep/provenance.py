"""Where a run's numbers come from: the manifest.

It holds suite, seeds, versions, commit, model files and processor kernels. Times, host
and dates are stored separately and never compared.

Modules are imported when they are used, so a process that works for hours can load a
file of the package that was changed since it started, beside others that were not; so
it keeps the digests of all files as they were (`Loaded`).
"""

import hashlib
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from simval import files
from simval.imu.filters.mekf import compiled
from simval.plugins.loading import sources
from simval.plugins.names import portable
from simval.scene import models_folder
from simval.studies import brought
from simval.sweep.suite import Grid, Suite, plugins_of, respelled
from simval.sweep.threads import linear_algebra

PACKAGE = Path(__file__).resolve().parents[1]
PACKAGES = ("simval", "numpy", "scipy", "mujoco-core", "pydantic")


def manifest(suite: Suite) -> dict[str, Any]:
    """All that the numbers of a suite depend on, and what it asks of them."""
    return {
        "suite": suite.name,
        "title": suite.title,
        **asked(suite),
        "grid": respelled(suite.grid, portable),  # file names instead of paths
        "cells": len(suite.cells),
        "versions": versions(),
        "git": git_state(),
        "source": loaded().source,
        "models": model_hashes(),
        "files": file_hashes(suite.grid),
        "machine": machine(),
    }


def asked(suite: Suite) -> dict[str, Any]:
    """The suite's question and needs, as in its file."""
    needs = [need.model_dump(exclude_defaults=True) for need in suite.needs]
    return {"question": suite.question, "need": needs}


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that the numbers depend on."""
    packages = {name: metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version(), **packages}


def machine() -> dict[str, Any]:
    """What the last bits depend on: processor kernels, linear algebra, C library."""
    return {
        "system": platform.system(),
        "processor": platform.machine(),
        "kernels": _kernels(),
        "linear_algebra": linear_algebra(),
        "filter": "compiled" if compiled() else "NumPy",
        "threads": 1,  # in it, while cells are computed
        "libc": _libc(),
    }


def git_state() -> dict[str, Any]:
    """Commit of the checkout that the package runs from, or nothing."""
    status = _git("status", "--porcelain", "--untracked-files=no")
    dirty = None if status is None else bool(status)
    return {"commit": _git("rev-parse", "HEAD"), "dirty": dirty}


def commit_date() -> str | None:
    """Date of that commit, ISO 8601, or nothing."""
    return _git("show", "--no-patch", "--format=%cI", "HEAD")


def model_hashes() -> dict[str, str]:
    """SHA-256 of each model file."""
    models = sorted(models_folder().glob("*.xml"))
    return {model.name: files.digest(model) for model in models}


def file_hashes(grid: Grid) -> dict[str, str]:
    """SHA-256 of the files that a suite names, and of those that they name."""
    named: dict[str, dict[str, set[str]]] = {}
    for study, _, texts in plugins_of(grid):
        for path, digest in chain.from_iterable(sources(t).items() for t in texts if t):
            if digest:
                by_study = named.setdefault(portable(path), {})
                by_study.setdefault(study, set()).add(digest)
    for study, file in _brought(grid).items():
        named.setdefault(file.name, {})[study] = {files.digest(file)}
    digests: dict[str, set[str]] = {}
    for name, by_study in named.items():
        alike = len(set().union(*by_study.values())) == 1
        for study, own in by_study.items():
            key = name if alike else f"{name} of {study}"
            digests.setdefault(key, set()).update(own)
    return {name: "+".join(sorted(digests[name])) for name in sorted(digests)}


def places(grid: Grid) -> dict[str, dict[str, str]]:
    """Paths of the plug-ins of a suite on this machine."""
    paths = {
        f"{study}.{field}": {portable(t): t for t in texts if portable(t) != t}
        for study, field, texts in plugins_of(grid)
    }
    paths["studies"] = {path.name: str(path) for path in _brought(grid).values()}
    return {key: known for key, known in paths.items() if known}


def _brought(grid: Grid) -> dict[str, Path]:
    # files of a user's studies that a suite has
    return {name: path for name, path in brought().items() if name in grid}


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List the differences of two manifests, one in a line."""
    lines = []
    for key in sorted({*old, *new}):
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            lines += [f"{key}.{line}" for line in differences(a, b)]
        elif a != b:
            lines.append(f"{key}: {a} -> {b}")
    return lines


def _kernels() -> list[str]:
    return list(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))


def _libc() -> str:
    # its logarithms and sines are chosen by processor, and differ between versions
    try:
        return os.confstr("CS_GNU_LIBC_VERSION") or "unknown"
    except (OSError, ValueError):  # another one than GNU's
        return "unknown"


def _git(*words: str) -> str | None:
    root = PACKAGE.parent
    if not (root / ".git").exists():  # an installed package
        return None
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *words],
            capture_output=True, text=True, check=True, timeout=10,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None  # git is not installed, or this is not a repository
    return done.stdout.strip()


def source_hash() -> str:
    """SHA-256 of the package's source on disk, Python and C."""
    return _whole(_digests())


def _digests() -> dict[str, bytes]:
    """SHA-256 of each source file."""
    files = sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.c")])
    return {
        str(file.relative_to(PACKAGE)): digest
        for file in files
        if (digest := _digest(file))
    }


def _digest(file: Path) -> bytes:
    try:
        return hashlib.sha256(file.read_bytes()).digest()
    except OSError:  # removed meanwhile
        return b""


def _whole(digests: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name, own in digests.items():
        digest.update(name.encode() + b"\0")
        digest.update(own)
    return digest.hexdigest()


class Loaded:
    """The package's source, as this process first saw it."""

    def __init__(self) -> None:
        self._digests = _digests()
        self._seen = set(_modules())
        self.source = _whole(self._digests)

    def changed(self) -> list[str]:
        """Files that changed on disk before this process loaded them."""
        own = _modules()
        fresh = own.keys() - self._seen
        self._seen |= fresh
        found = []
        for name in sorted(fresh):
            file = Path(str(own[name].__file__)).resolve()
            if file.is_relative_to(PACKAGE) and file.suffix == ".py":
                short = str(file.relative_to(PACKAGE))
                if _digest(file) != self._digests.get(short):
                    found.append(short)
        return found


def _modules() -> dict[str, ModuleType]:
    package = PACKAGE.name + "."
    return {
        name: module
        for name, module in sys.modules.copy().items()
        if name.startswith(package) and getattr(module, "__file__", None)
    }


@cache
def loaded() -> Loaded:
    """The package's source, as this process first saw it."""
    return Loaded()
