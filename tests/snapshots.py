"""Texts of commands, kept in `tests/snapshots`.

`SIMVAL_SNAPSHOTS=write` writes them anew; look at the difference, then commit it.
"""

import os

from places import ROOT


def same(name, text):
    """Compare a text with the one that is kept."""
    path = ROOT / "tests" / "snapshots" / name
    if os.environ.get("SIMVAL_SNAPSHOTS") == "write":
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")
