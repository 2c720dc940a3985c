"""The tables of docs/errata.md and of its pages.

    PYTHONPATH=tests python -m errata.page

prints the counts and every claim, which `test_errata.py` holds the pages to.
"""

import sys
from collections import Counter

from errata.claim import CLAIMS, FALSE, ILLEGIBLE, MISPRINTED, RIGHT, WORDING

VERDICTS = (RIGHT, MISPRINTED, FALSE, WORDING, ILLEGIBLE)
SOURCES = {
    "imu_tk": "IMU-TK LM derivation",
    "scalar": "Scalar chain-rule derivation",
    "symmetric": "Symmetric Gauss-Newton derivation",
    "quaternion": "Two-vector quaternion paper",
}
"""By the names of their pages."""


def counts() -> str:
    """How many claims of each verdict a source has, as a table."""
    found = Counter((claim.source, claim.verdict) for claim in CLAIMS.values())
    rows = [f"| source | {' | '.join(VERDICTS)} |", "| --- " * 6 + "|"]
    for source, title in SOURCES.items():
        numbers = " | ".join(str(found[source, verdict]) for verdict in VERDICTS)
        rows.append(f"| [{title}](errata/{source}.md) | {numbers} |")
    return "\n".join([*rows, ""])


def table(source: str) -> str:
    """Every claim of a source in the order of its text: place, verdict, name."""
    rows = ["| place | verdict | claim |", "| --- | --- | --- |"]
    for claim in CLAIMS.values():
        if claim.source == source:
            name = f"`{claim.name}`" if claim.name else ""
            rows.append(f"| {claim.place} | {claim.verdict} | {name} |")
    return "\n".join([*rows, ""])


if __name__ == "__main__":
    sys.stdout.write("\n".join([counts(), *map(table, SOURCES)]))
