"""Where things lie: the checkout, its example plug-ins, the real recordings."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
RECORDINGS = ROOT.parent / "shared" / "data"  # not in the repository


def recording(name):
    """Path of a real recording; without it the test is skipped."""
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"the recording {path} is not on this machine")
    return path
