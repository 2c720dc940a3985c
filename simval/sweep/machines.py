"""How many cells each machine has computed: what the last bits of a run depend on."""

import json
from collections.abc import Mapping
from typing import Any

from simval.sweep.identity import machine_text
from simval.sweep.provenance import differences


def environments(kept: str | None) -> list[dict[str, Any]]:
    """Machines with the number of their cells, most cells first.

    Of the store's entry, which counts the finished cells of each machine.
    """
    counted = json.loads(kept or "{}").items()
    return [
        {"machine": json.loads(machine), "cells": cells}
        for machine, cells in sorted(counted, key=lambda item: (-item[1], item[0]))
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
