"""How many cells each machine has computed: what the last bits of a run depend on."""

import json
import sqlite3
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from simval.sweep import store
from simval.sweep.documents import read_json
from simval.sweep.entries import Done


class Machines:
    """Finished cells by the machine that computed them, as the store keeps them."""

    def __init__(self, database: sqlite3.Connection) -> None:
        text = store.entry(database, store.MACHINES)
        kept = read_json("the number of cells by machine", text) if text else {}
        self._cells: Counter[str] = Counter(kept)

    def count(self, batch: Sequence[Done]) -> str:
        """Count some more cells; return the entry of the store."""
        self._cells.update(
            done.machine
            for done in batch
            if done.machine and done.ending not in ("failed", "refused")
        )
        return json.dumps(self._cells)

    def environments(self) -> list[dict[str, Any]]:
        """Machines with the number of their cells, most cells first."""
        order = sorted(self._cells.items(), key=lambda item: (-item[1], item[0]))
        return [
            {"machine": json.loads(machine), "cells": cells} for machine, cells in order
        ]


def other_machines(manifest: Mapping[str, Any]) -> list[Any]:
    """Machines that computed cells of a run beside the driver's."""
    own = manifest.get("machine")
    found = [each["machine"] for each in manifest.get("environments", ())]
    return [machine for machine in found if machine != own]
