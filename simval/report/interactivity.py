"""Interactive figures: notes on points, and legends that show and hide series.

The figure is one image for a screen reader. Over it lie its points, each an invisible
disc with a title, which every browser shows where the pointer rests. The page's script
makes a box of text of them, lets the keyboard reach them and makes buttons of the
entries of a legend, which know their series by the place of a label among those of the
figure; without it nothing is lost but these. Of more than `MANY` points a series has
neither.
"""

from collections.abc import Iterable, Sequence
from html import escape

from simval.arrays import Array
from simval.report.panels import MANY, AnyPanel, DotPanel, Drawing, Panel, Series

DISC = 5.0
"""Radius within which a point is met, points: somewhat more than its mark."""


def labels_of(every: Iterable[AnyPanel]) -> list[str]:
    """Legend entries of all panels of a figure."""
    return list(dict.fromkeys(s.label for p in every for s in _series(p) if s.label))


def names_of(panel: AnyPanel, labels: Sequence[str]) -> list[str]:
    """HTML attribute of each series: the legend entries that show and hide it."""
    series = _series(panel)
    keys = [
        sorted(
            {labels.index(o.label) for o in series if o.label and _holds(o, s, series)}
        )
        for s in series
    ]
    return [f'data-keys="{" ".join(map(str, own))}"' for own in keys]


def entries_of(panel: AnyPanel, labels: Sequence[str]) -> list[tuple[Series, str]]:
    """Legend entries with their keys; series that look alike share one."""
    alike = {(s.label, s.colour, s.line, s.marker): s for s in reversed(_series(panel))}
    return [
        (s, str(labels.index(s.label))) for s in reversed(alike.values()) if s.label
    ]


def discs(
    panel: AnyPanel,
    drawn: Sequence[Series],
    places: Sequence[Array],
    labels: Sequence[str],
    box: tuple[float, float, float, float],
) -> str:
    """Discs with notes over the points of a panel."""
    # those of bars are not switched
    names = names_of(panel, labels) or ['data-keys=""' for _ in drawn]
    left, top, right, bottom = box
    groups = []
    for series, name, points in zip(drawn, names, places, strict=True):
        if not len(series.notes) == len(series.x) <= MANY:
            continue
        inside = "".join(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{DISC:g}" '
            f'role="img"><title>{escape(words, quote=False)}</title></circle>\n'
            for (x, y), words in zip(points.tolist(), series.notes, strict=True)
            if left - 1.0 <= x <= right + 1.0 and top - 1.0 <= y <= bottom + 1.0
        )
        if inside:
            label = " ".join(f"{panel.title}, {series.label}".strip(", ").split())
            groups.append(
                f'<g class="points" {name} role="group" '
                f'aria-label="{escape(label)}">\n{inside}</g>\n'
            )
    return "".join(groups)


def silent(drawing: Drawing) -> bool:
    """True if its points have notes but are too many to show them."""
    every = [series for panel in drawing.panels for series in _series(panel)]
    return any(len(series.notes) > MANY for series in every)


def _series(panel: AnyPanel) -> Sequence[Series]:
    return panel.series if isinstance(panel, Panel | DotPanel) else ()


def _holds(entry: Series, s: Series, series: Sequence[Series]) -> bool:
    """True if a legend entry belongs to a series.

    Its own does. A line without one, and the line that stands in the legend for such
    lines of its style, belongs to the marks of its colour as well.
    """
    if entry.label == s.label:
        return True
    alike = bool(s.line) and any(not o.label and o.line == s.line for o in series)
    if s.label and not alike:
        return False
    beside = entry.colour == s.colour and bool(entry.line) != bool(s.line)
    return beside or (not s.label and bool(s.line) and entry.line == s.line)
