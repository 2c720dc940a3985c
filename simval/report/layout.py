"""Room for the words of a figure: long words are broken into lines.

The size of a panel depends on how many stand side by side; titles, axis labels, names
of bars and legends are broken at their width, and the margins grow with the lines. A
legend is always below its axes, never over the curves. Widths are those of DejaVu Sans;
`SLACK` is for readers that show another font.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from simval.report.panels import (
    AnyPanel,
    BarPanel,
    DotPanel,
    Drawing,
    HeatPanel,
    Panel,
    SpherePanel,
)

# width of a panel by how many are side by side, height of its axes, least margins about
# them, inches
WIDTHS = {1: 6.6, 2: 4.9}
WIDTH, UP = 4.3, 2.2
DISC = 3.4  # height of a map of directions
# left: a tick of eight digits and a line; right: half of such a tick
LEFT, RIGHT, BOTTOM, TOP = 0.95, 0.35, 0.62, 0.35
NAMES, WIDE_NAMES = 1.6, 2.4  # at most, for the names of bars; of a panel alone
TICK = 0.15  # between a name and its axis
POINTS = 72.0  # in an inch
LINE = 0.18  # from one line of words to the next
SIZE, TITLE, SMALL = 10.0, 11.0, 8.5  # of labels, titles and legends, points
HANDLE = 0.6  # a legend's mark and the space about it
EDGE = 0.15  # of a panel, that its legend keeps free on either side
SLANT = 50.0  # of the names below a map of shares, degrees
APART = 0.45  # of a line, between the dots of a name
SEAMS = "_:,=/"
"""Letters after which a word that is longer than a line is broken."""
NAMED = (BarPanel, DotPanel, HeatPanel)
"""Panels with a name for each row."""

SLACK = 0.92
"""Share of the room that is used: Liberation Sans and Arial are narrower, Verdana is
as wide as DejaVu Sans."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A drawing with its words in lines, and the room that they need, in inches."""

    drawing: Drawing  # with line breaks in its words
    # margins about the axes of every panel, and of each panel what is below its axes
    left: float
    top: float
    bottoms: Sequence[float]
    width: float  # of every panel with its margins
    ups: Sequence[float]  # height of the axes of each panel

    @property
    def heights(self) -> tuple[float, ...]:
        """Height of each panel with its margins."""
        return tuple(
            up + bottom + self.top
            for up, bottom in zip(self.ups, self.bottoms, strict=True)
        )

    @property
    def parts(self) -> tuple["Layout", ...]:
        """Each panel alone, with the margins that all have."""
        return tuple(
            replace(self, drawing=_alone(self.drawing, i), bottoms=[bottom], ups=[up])
            for i, (bottom, up) in enumerate(zip(self.bottoms, self.ups, strict=True))
        )


def _alone(drawing: Drawing, number: int) -> Drawing:
    """A drawing of one panel, with a name and an alternative of its own."""
    panel = drawing.panels[number]
    if len(drawing.panels) == 1:
        return drawing
    x, y = (
        getattr(panel, name, "").replace("\n", " ") for name in ("x_label", "y_label")
    )
    labels = ", ".join(s.label for s in getattr(panel, "series", ()) if s.label)
    words = (panel.title, f"{y} against {x}" if x and y else x, labels)
    return replace(
        drawing,
        name=f"{drawing.name}-{number + 1}",
        alternative="; ".join(part for part in words if part).replace("\n", " "),
        panels=[panel],
    )


def laid_out(drawing: Drawing) -> Layout:
    """Break the words of a drawing into lines and find the margins."""
    globes = all(isinstance(panel, SpherePanel) for panel in drawing.panels)
    width = WIDTHS.get(drawing.columns, WIDTH)
    room = NAMES if drawing.columns > 1 else WIDE_NAMES
    panels = [_names_broken(panel, room) for panel in drawing.panels]
    ups = [_up(panel) for panel in panels]
    alike = max(
        [u for u, p in zip(ups, panels, strict=True) if _in_rows(p)], default=0.0
    )
    ups = [alike if _in_rows(p) else u for u, p in zip(ups, panels, strict=True)]
    panels = [
        _changed(panel, "y_label", up) for panel, up in zip(panels, ups, strict=True)
    ]
    sides = [_names_width(panel) + LINE * _more(panel, "y_label") for panel in panels]
    left = RIGHT if globes else LEFT + max(sides)
    for word in ("title", "x_label"):
        panels = [_changed(panel, word, width - left - RIGHT) for panel in panels]
    panels = [_legend_broken(panel, width) for panel in panels]
    return Layout(
        drawing=replace(drawing, panels=panels),
        left=left,
        bottoms=[RIGHT if globes else BOTTOM + _below(p, width) for p in panels],
        top=TOP + LINE * max(_more(panel, "title") for panel in panels),
        width=width,
        ups=ups,
    )


def _in_rows(panel: AnyPanel) -> bool:
    return isinstance(panel, NAMED)


def _up(panel: AnyPanel) -> float:
    """Height of the axes: as usual, or what the names of its rows need."""
    if isinstance(panel, SpherePanel):
        return DISC - 2.0 * RIGHT  # a disc as wide as high
    usual = UP * panel.height if isinstance(panel, Panel) else UP * 0.6
    return max(usual, LINE * _rows(panel))


def _below(panel: AnyPanel, width: float) -> float:
    """What is below the axes of a panel beyond one line of words."""
    _, lines = legend_rows(panel, width)
    return max(LINE * (_more(panel, "x_label") + lines), _slanted(panel))


def legend_rows(panel: AnyPanel, width: float) -> tuple[int, int]:
    """Number of columns of a legend below the axes, as many as fit, and its lines."""
    labels = entries(panel)
    room = width - 2.0 * EDGE
    for count in range(len(labels), 0, -1):
        columns = [list(c) for c in np.array_split(np.array(labels, object), count)]
        wide = sum(HANDLE + max(map(_legend_width, column)) for column in columns)
        if wide <= room or count == 1:
            height = max(sum(_lines(label) for label in c) for c in columns)
            return count, height
    return 1, 0


def entries(panel: AnyPanel) -> list[str]:
    """Labels of the legend of a panel, in the order in which they are drawn."""
    if isinstance(panel, BarPanel):
        return ["measured", "predicted"]
    labels = [s.label for s in getattr(panel, "series", ())]
    labels += [label for _, label in getattr(panel, "references", ())]
    return [label for label in labels if label]


def _legend_width(label: str) -> float:
    return max(_width(line, SMALL) for line in label.split("\n")) / SLACK


def _lines(label: str) -> int:
    return label.count("\n") + 1


def broken(text: str, room: float, size: float = SIZE) -> str:
    """Break words into lines, between them or, where one is too long, within."""
    lines = [""]
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if _width(longer, size) <= SLACK * room:
            lines[-1] = longer
            continue
        lines += [word] if lines[-1] else []
        lines[-1] = word
        while _width(lines[-1], size) > SLACK * room and len(lines[-1]) > 1:
            most = _fitting(lines[-1], room, size)
            lines[-1:] = [lines[-1][:most], lines[-1][most:]]
    return "\n".join(lines)


def _fitting(word: str, room: float, size: float) -> int:
    """Number of letters of a word that fit a line, at least one; up to a seam."""
    fit = (n for n in range(len(word), 1, -1) if _width(word[:n], size) <= SLACK * room)
    most = next(fit, 1)
    return max((word.rfind(seam, 0, most) for seam in SEAMS), default=-1) + 1 or most


@cache
def _width(text: str, size: float) -> float:
    font = FontProperties(family="DejaVu Sans", size=size)
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, False)
    return float(width) / POINTS


def _changed(panel: AnyPanel, word: str, room: float) -> AnyPanel:
    if not hasattr(panel, word):
        return panel
    size = TITLE if word == "title" else SIZE
    changes: Any = {word: broken(getattr(panel, word), room, size)}
    return replace(panel, **changes)


def _more(panel: AnyPanel, word: str) -> int:
    """Lines beyond the first, which the least margin holds."""
    return str(getattr(panel, word, "")).count("\n")


def _names_broken(panel: AnyPanel, room: float) -> AnyPanel:
    if not isinstance(panel, NAMED):
        return panel
    return replace(panel, names=[broken(name, room) for name in panel.names])


def _names_width(panel: AnyPanel) -> float:
    """What the names of bars need beyond the place of a number."""
    if not isinstance(panel, NAMED):
        return 0.0
    lines = [line for name in panel.names for line in name.split("\n")]
    widest = max((_width(line, SIZE) for line in lines), default=0.0)
    return max(0.0, widest / SLACK + TICK - LEFT)


def _rows(panel: AnyPanel) -> float:
    """Lines that the names of bars take, a little apart, or the dots of a name."""
    if not isinstance(panel, NAMED):
        return 0
    lines: float = max(name.count("\n") + 1 for name in panel.names)
    if isinstance(panel, DotPanel):
        lines = max(lines, APART * (1 + len(panel.series)))
    return lines * len(panel.names)


def _slanted(panel: AnyPanel) -> float:
    """Height of the slanted names below a map, inches beyond a line."""
    if not isinstance(panel, HeatPanel):
        return 0.0
    longest = max(_width(name, SMALL) for name in panel.columns)
    return float(np.sin(np.radians(SLANT))) * longest / SLACK + TICK - BOTTOM


def _legend_broken(panel: AnyPanel, width: float) -> AnyPanel:
    if not isinstance(panel, Panel | DotPanel):
        return panel
    room = width - 2.0 * EDGE - HANDLE
    series = [replace(s, label=broken(s.label, room, SMALL)) for s in panel.series]
    return replace(panel, series=series)
