"""The house: the rows of the package from the layers that the linter holds."""

import re
from pathlib import Path

from docs.site.drawing import Drawing

ROOT = Path(__file__).parents[2]
ROW = re.compile(r'^  "([^"]+)",(?: # (.+))?$', re.MULTILINE)
WALL = "imu"
"""Below the line above it is what is tested, and it knows nothing of its tests."""
FLOORS = {  # the highest row of each, and what it is
    "__main__": "what a person calls",
    "studies": "experiments",
    "scene": "worlds, theory, plug-ins",
    WALL: "what is tested",
    "consistency": "what all share",
}
STEP, LEFT, WIDTH = 34.0, 195.0, 290.0


def rows() -> list[tuple[tuple[str, ...], str]]:
    """Names in each row of the package, the highest first, and its remark."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    _, _, layers = text.partition('name = "the rows of the design"')
    layers, _, _ = layers.partition("]\n[[")
    return [(tuple(names.split(" | ")), said) for names, said in ROW.findall(layers)]


def house() -> Drawing:
    """The rows as boxes, and the wall."""
    found = rows()
    title = "The layers of simval, each on those below it"
    d = Drawing(1000, int(STEP * len(found)) + 20, title)
    for k, (names, said) in enumerate(found):
        y = 10.0 + STEP * k
        floor = next((FLOORS[name] for name in names if name in FLOORS), "")
        own = "body" if WALL in names else "ink"
        if floor:
            d.words((10.0, y + 19.0), floor, "faint", "start")
        if WALL in names:
            d.line((10.0, y - 4.0), (990.0, y - 4.0), "sensor")
            d.words((990.0, y - 9.0), "the wall", "sensor", "end")
        d.box((LEFT, y), (WIDTH, STEP - 8.0), own)
        inside = ", ".join(names).replace("_", " ").strip()
        d.words((LEFT + WIDTH / 2.0, y + 18.0), inside, own)
        d.words((LEFT + WIDTH + 14.0, y + 18.0), said, "faint", "start")
    return d
