"""What a command took from a log."""

from typing import Any

from simval.logs import Log


def log_object(log: Log) -> dict[str, Any]:
    """Return which columns were taken and at what rate, as plain JSON values."""
    taken = {each.role: [each.place + 1, each.name] for each in log.columns}
    return {"columns": taken, "rate": log.rate, "clock_unit_seconds": log.second}
