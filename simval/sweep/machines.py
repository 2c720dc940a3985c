"""How many cells each machine has computed: what the last bits of a run depend on."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from simval.sweep.documents import DamagedError, checked_environment, read_json
from simval.sweep.entries import Done
from simval.sweep.identity import machine_text
from simval.sweep.provenance import differences

NAME = "the number of cells by machine"


def counted(kept: str | None, batch: Sequence[Done]) -> str:
    """Entry of the store with some more finished cells."""
    cells = _read(kept)
    cells.update(
        done.machine
        for done in batch
        if done.machine and done.ending not in ("failed", "refused")
    )
    return json.dumps(cells)


def environments(kept: str | None) -> list[dict[str, Any]]:
    """Machines with the number of their cells, most cells first."""
    order = sorted(_read(kept).items(), key=lambda item: (-item[1], item[0]))
    return [
        checked_environment({"machine": read_json(NAME, machine), "cells": cells})
        for machine, cells in order
    ]


def other_machines(manifest: Mapping[str, Any]) -> list[Any]:
    """Machines that computed cells of a run beside the driver's, in a fixed order."""
    own = manifest.get("machine")
    found = [each["machine"] for each in manifest.get("environments", ())]
    return sorted((each for each in found if each != own), key=json.dumps)


def mixture(manifest: Mapping[str, Any]) -> str:
    """Which machines computed a run, in words; empty if only the driver's did."""
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
    parts += [
        f"{count} by one that differs ({', '.join(differences(own, machine))})"
        for count, machine in zip(counts[1:], others, strict=True)
    ]
    return (
        f"{len(parts)} kinds of machine computed this run, so the last bits may "
        f"differ: {'; '.join(parts)}"
    )


def _read(kept: str | None) -> Counter[str]:
    cells = read_json(NAME, kept) if kept else {}
    counted = isinstance(cells, dict) and all(type(n) is int for n in cells.values())
    if not counted:
        msg = f"{NAME} is {cells!r:.60}, not whole numbers by name"
        raise DamagedError(msg)
    return Counter(cells)
