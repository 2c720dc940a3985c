"""Identity of a computing process: source, versions, models, processor.

The driver states what its own numbers depend on, and each batch of cells carries the
statement. A process that differs refuses the batch in words: its rows would be those
of another program under the same manifest. Other processor kernels, which round
otherwise, may compute where that is asked for; the run then says how many cells each
kind of machine has computed.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from simval.errors import InputError
from simval.sweep import provenance
from simval.text import one_line

SHOWN = 12
"""Characters that a message shows of a SHA-256, or of a version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """All that a process's numbers depend on, apart from the cell."""

    code: Mapping[str, str]  # SHA-256 of source and models, versions, by their names
    machine: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """Identity of the driver, which each worker must share."""

    driver: Identity
    mixed: bool = False  # other processor kernels may compute

    @property
    def machine(self) -> str:
        """The driver's machine, as it is stored."""
        return machine_text(self.driver.machine)

    def require(self) -> str:
        """Check this process against the driver; return its machine.

        Raises
        ------
        StrangerError
            If it would compute other numbers than the driver.
        """
        lines = differing(self.driver, here(), mixed=self.mixed)
        if lines:
            raise StrangerError(lines)
        return machine_text(here().machine)


class StrangerError(InputError):
    """A process that would compute other numbers than the driver."""

    def __init__(self, lines: tuple[str, ...], worker: str = "") -> None:
        super().__init__(lines, worker)
        self.lines, self.worker = lines, worker

    def __str__(self) -> str:
        who = f"worker {self.worker}" if self.worker else "a worker process"
        return (
            f"{who} would give other numbers than the driver: {'; '.join(self.lines)}; "
            "finished cells are kept: start the sweep again with --resume"
        )


def refusal(answer: object) -> StrangerError | None:
    """The error in a worker's answer; None if it computed."""
    if not isinstance(answer, tuple):
        return None
    worker, why = answer
    if isinstance(why, str):
        why = (f"it cannot load this version of simval ({one_line(why)})",)
    return StrangerError(tuple(why), worker)


def require_as_read() -> None:
    """Refuse to compute if a source file changed before it was loaded."""
    names = provenance.loaded().changed()
    if names:
        words = f"{', '.join(names)} changed on the disk while it was at work"
        raise StrangerError((words,))


@cache
def here() -> Identity:
    """Identity of this process, as of the first call."""
    models = json.dumps(provenance.model_hashes(), sort_keys=True)
    return Identity(
        code={
            "source code": provenance.loaded().source,
            "set of model files": hashlib.sha256(models.encode()).hexdigest(),
            **provenance.versions(),
        },
        machine=provenance.machine(),
    )


def differing(
    driver: Identity, own: Identity, *, mixed: bool = False
) -> tuple[str, ...]:
    """Say how a process differs from the driver.

    Kernels of another processor round otherwise: `mixed` allows them.
    """
    lines = [
        f"its {name} is {own.code.get(name, 'absent')[:SHOWN]}, the driver's "
        f"{driver.code.get(name, 'absent')[:SHOWN]}"
        for name in sorted({*own.code, *driver.code})
        if own.code.get(name) != driver.code.get(name)
    ]
    if not mixed and machine_text(own.machine) != machine_text(driver.machine):
        words = provenance.differences(driver.machine, own.machine)
        lines.append(
            f"processor kernels ({'; '.join(words)}, the driver's first), so the last "
            "bits would differ: allow them with --mixed-kernels"
        )
    return tuple(lines)


def machine_text(machine: Mapping[str, Any]) -> str:
    """A machine as text, under which cells are counted."""
    return json.dumps(dict(machine), sort_keys=True)


def environments(kept: str | None) -> list[dict[str, Any]]:
    """Machines with their numbers of cells, the most first.

    Of the store's entry, which counts the finished cells of each machine.
    """
    counted = json.loads(kept or "{}").items()
    return [
        {"machine": json.loads(machine), "cells": cells}
        for machine, cells in sorted(counted, key=lambda item: (-item[1], item[0]))
    ]


def other_machines(manifest: Mapping[str, Any]) -> list[Any]:
    """Machines other than the driver's that computed cells of a run."""
    own = manifest.get("machine")
    found = [each["machine"] for each in manifest.get("environments", ())]
    return sorted((each for each in found if each != own), key=json.dumps)


def mixture(manifest: Mapping[str, Any]) -> str:
    """All machines that computed a run, as text; empty if it was the driver's alone."""
    others = other_machines(manifest)
    if not others:
        return ""
    own = manifest["machine"]
    cells = {
        machine_text(each["machine"]): each["cells"]
        for each in manifest["environments"]
    }
    counts = [cells.get(machine_text(machine), 0) for machine in (own, *others)]
    parts = [f"{counts[0]} of its cells by the driver's"]
    for count, other in zip(counts[1:], others, strict=True):
        words = ", ".join(provenance.differences(own, other))
        parts.append(f"{count} by one that differs ({words})")
    return (
        f"{len(parts)} kinds of machine computed this run, so the last bits may "
        f"differ: {'; '.join(parts)}"
    )
