"""Markers of a figure, read back through its axes: independent of how it was drawn.

An axis is what its labels say: the straight line through their numbers, or logarithms,
and their places on the sheet. The place of a marker is the middle of its outline.
"""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from simval.report.paint import shown
from simval.report.panels import MANY, BarPanel, DotPanel, Panel

SVG = "{http://www.w3.org/2000/svg}"
OFF = 0.5
"""Points that a marker may be off: its place and those of the labels are rounded by
0.05, and an axis reaches at most some four times as far out as its labels."""
FOOT = 3.6  # of a label below its middle
REACH = 4.4  # of the cut beyond the axes
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def svg(drawing):
    """The ``svg`` elements of a figure on a page."""
    return "".join(shown(drawing)[1])


def number(words):
    """The number that a label says, NaN of one that says none."""
    text = re.sub(
        "(×|)10(?=[⁻⁰¹²³⁴-⁹])", lambda ten: "e" if ten[1] else "1e", words or ""
    )
    try:
        return float(text.translate(RAISED))
    except ValueError:
        return np.nan


def law(labels, log):
    """Place on the sheet of a value, by the labels of its axis."""
    values, places = np.array([each for each in labels if np.isfinite(each[0])]).T
    slope, start = np.polyfit(np.log(values) if log else values, places, 1)
    return lambda x: start + slope * (np.log(x) if log else np.asarray(x))


def laws(panel, root, sizes):
    """Laws of both axes, and their ends: left, top, right and foot."""
    (cut,) = root.iter(f"{SVG}rect")
    start, size = (
        np.array([float(cut.get(key)) for key in keys])
        for keys in (("x", "y"), ("width", "height"))
    )
    (left, top), (_, foot) = box = start + REACH, start + size - REACH
    words = [w for w in root.iter(f"{SVG}text") if w.get("x")]
    at = [
        (w.get("text-anchor"), number(w.text), float(w.get("x")), float(w.get("y")))
        for w in words
    ]
    below = [(v, x) for side, v, x, y in at if side == "middle" and y > foot]
    if isinstance(panel, Panel):
        beside = [(v, y - FOOT) for side, v, x, y in at if side == "end" and x < left]
        return law(below, panel.log_x), law(beside, panel.log_y), box
    rows = len(panel.names)
    log = (
        isinstance(panel, DotPanel) and min(sizes) > 0 and max(sizes) > 10 * min(sizes)
    )
    return law(below, log), lambda y: top + (foot - top) * (y + 0.5) / rows, box


def marks(root):
    """Middles of the outlines that are drawn on the axes, by their colour."""
    found = {}
    for path in root.iterfind(f".//{SVG}g[@clip-path]/{SVG}path"):
        colour = path.get("fill") if path.get("stroke") is None else path.get("stroke")
        colour = re.sub(r"var\(.*,(.*)\)", r"\1", colour)  # that of light paper
        outlines = re.findall(r"M(\S+) ([-\d.]+)(?:h0|l([-\d. ]+)z)", path.get("d"))
        for x, y, steps in outlines:
            steps = np.array(steps.split(), float).reshape(-1, 2)
            corners = np.cumsum([[float(x), float(y)], *steps], axis=0)
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            found.setdefault(colour, []).append(middle)
    return {colour: np.array(middles) for colour, middles in found.items()}


def data(panel):
    """Colour, x and y of each series that has markers."""
    if isinstance(panel, BarPanel):
        return [("#010203", panel.predicted, np.arange(len(panel.names)))]
    found = []
    for s in panel.series:
        y = np.asarray(s.y, float)
        if isinstance(panel, Panel) and panel.log_y and s.band is not None:
            y = np.where(y <= s.band, y + s.band, y)  # an upper limit: its bar's end
        if not s.line:
            found.append((s.colour, np.asarray(s.x, float), y))
    return found


@np.errstate(invalid="ignore", divide="ignore")  # what has no logarithm has no place
def off_datum(drawing):
    """Data without a marker at their place, and markers without a datum, by panel."""
    found, count = [], 0
    every = [(p, *getattr(p, "strips", ())) for p in drawing.panels]
    for panel in (panel for part in every for panel in part):
        panel = replace(panel, strips=()) if isinstance(panel, Panel) else panel
        every = data(panel) if isinstance(panel, Panel | BarPanel | DotPanel) else []
        if not any(np.isfinite(x).any() for _, x, _ in every):
            continue
        alone = replace(drawing, panels=[panel], name="a", alternative="a")
        root = ElementTree.fromstring(svg(alone))
        across, up, (start, end) = laws(
            panel, root, np.concatenate([x for _, x, _ in every])
        )
        drawn, wanted = marks(root), {}
        for colour, x, y in every:
            colour = "currentColor" if colour == "#010203" else colour
            places = np.column_stack([across(x), up(y)])
            inside = np.all((places > start - OFF) & (places < end + OFF), axis=1)
            wanted.setdefault(colour, []).append(places[inside])
        # of a row of dots the place within the row is free
        row = (
            (end - start)[1] / len(panel.names) / 2.0
            if isinstance(panel, DotPanel)
            else 0.0
        )
        for colour, parts in wanted.items():
            places, own = np.concatenate(parts), drawn.get(colour, np.empty((0, 2)))
            far = np.abs(places[:, None] - own)
            far[..., 1] = np.maximum(far[..., 1] - row, 0.0)
            far = far.max(axis=-1)
            few = len(places) <= MANY
            lost = places[far.min(axis=1, initial=np.inf) > OFF] if few else []
            strange = own[far.min(axis=0, initial=np.inf) > OFF]
            found += [(panel.title, *each) for each in (*lost, *strange)]
            count += len(own)
    return found, count


NONE = re.compile("(^|[^a-z])[ml]?[+-]?(nan|inf|infinity)([^a-z]|$)", re.IGNORECASE)


def not_numbers(page):
    """Attributes of a page, or of a figure, with a number that is none."""
    every = re.findall(r' ([\w-]+)="([^"]*)"', page)
    return [each for each in every if each[0] != "src" and NONE.search(each[1])]
