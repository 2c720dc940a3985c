"""What computes a cell: source, versions, models, processor; and whether it may.

The driver states what its own numbers depend on, and each batch of cells carries the
statement. A process that differs refuses the batch in words: its rows would be those
of another program under the same manifest.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from simval.errors import InputError
from simval.sweep import provenance
from simval.sweep.source import loaded
from simval.text import one_line

SHOWN = 12
"""Characters of a SHA-256 that a message shows."""

KERNELS = "processor kernels"
"""What a difference begins with that `--mixed-kernels` allows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """What the numbers of a process depend on, beside the cell."""

    source: str  # SHA-256
    models: str  # SHA-256 of all model files
    versions: Mapping[str, str]
    machine: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """What the driver states: who computes its cells must be the same."""

    driver: Identity
    mixed: bool = False  # other processor kernels may compute

    @property
    def machine(self) -> str:
        """The driver's machine, as the store has it."""
        return machine_text(self.driver.machine)

    def require(self) -> str:
        """Check this process; return its machine, as the store has it.

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


def unable(words: str) -> tuple[str, ...]:
    """Say of a process that it has no such version."""
    return (f"it cannot load this version of simval ({one_line(words)})",)


def refusal(answer: object) -> StrangerError | None:
    """The refusal of a worker that may not even have the words for one."""
    if not isinstance(answer, tuple):
        return None
    worker, why = answer
    return StrangerError(unable(why) if isinstance(why, str) else tuple(why), worker)


def require_as_read() -> None:
    """Check that this process has loaded no file that was changed since it started.

    Raises
    ------
    StrangerError
        If it has.
    """
    names = loaded().changed()
    if names:
        words = f"{', '.join(names)} changed on the disk while it was at work"
        raise StrangerError((words,))


@cache
def here() -> Identity:
    """The identity of this process, from when it was first asked for."""
    models = json.dumps(provenance.model_hashes(), sort_keys=True)
    return Identity(
        source=loaded().source,
        models=hashlib.sha256(models.encode()).hexdigest(),
        versions=provenance.versions(),
        machine=provenance.machine(),
    )


def differing(
    driver: Identity, own: Identity, *, mixed: bool = False
) -> tuple[str, ...]:
    """Say in words how a process differs from the driver."""
    lines = [
        f"its {key} is {_short(there)}, the driver's {_short(needed)}"
        for key, there, needed in (
            ("source code", own.source, driver.source),
            ("set of model files", own.models, driver.models),
        )
        if there != needed
    ]
    lines += [
        f"{name} is {own.versions.get(name, 'absent')}, the driver's "
        f"{driver.versions.get(name, 'absent')}"
        for name in sorted({*own.versions, *driver.versions})
        if own.versions.get(name) != driver.versions.get(name)
    ]
    if not mixed and machine_text(own.machine) != machine_text(driver.machine):
        words = provenance.differences(driver.machine, own.machine)
        lines.append(
            f"{KERNELS} ({'; '.join(words)}, the driver's first), so the last bits "
            "would differ: allow them with --mixed-kernels"
        )
    return tuple(lines)


def machine_text(machine: Mapping[str, Any]) -> str:
    """A machine as the store counts its cells."""
    return json.dumps(dict(machine), sort_keys=True)


def _short(digest: str) -> str:
    return digest[:SHOWN] or "unknown"
