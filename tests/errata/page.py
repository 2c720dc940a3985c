"""The table of every claim for docs/errata.md.

    PYTHONPATH=tests python -m errata.page

prints the counts and the tables, which `test_errata.py` holds the page to.
"""

import sys
from collections import Counter

from errata.claim import CLAIMS, FALSE, ILLEGIBLE, MISPRINTED, RIGHT, WORDING

VERDICTS = (RIGHT, MISPRINTED, FALSE, WORDING, ILLEGIBLE)
SOURCES = {
    "imu-tk": "IMU-TK LM derivation",
    "scalar": "Scalar chain-rule derivation",
    "symmetric": "Symmetric Gauss-Newton derivation",
    "quaternion": "Two-vector quaternion paper",
}


def counts() -> list[str]:
    """How many claims of each verdict a source has, as a table."""
    found = Counter((claim.source, claim.verdict) for claim in CLAIMS.values())
    rows = [f"| source | {' | '.join(VERDICTS)} |", "| --- " * 6 + "|"]
    for source, title in SOURCES.items():
        numbers = " | ".join(str(found[source, verdict]) for verdict in VERDICTS)
        rows.append(f"| {title} | {numbers} |")
    return rows


def table(source: str) -> list[str]:
    """Every claim of a source in the order of its text: place, verdict, name."""
    rows = ["| place | verdict | claim |", "| --- | --- | --- |"]
    for claim in CLAIMS.values():
        if claim.source == source:
            name = f"`{claim.name}`" if claim.name else ""
            rows.append(f"| {claim.place} | {claim.verdict} | {name} |")
    return rows


def text() -> str:
    """All tables, as the page ends with them."""
    lines = counts()
    for source, title in SOURCES.items():
        lines += ["", f"### {title}: all", "", *table(source)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(text())
