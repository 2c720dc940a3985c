"""Where things lie: the checkout, its example plug-ins, the real recordings."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"
RECORDINGS = ROOT.parent / "shared" / "data"  # not in the repository
