"""Ink of a panel: its axes, points, lines, bars and shares.

`framed` turns a panel of any kind into a `Frame`, whose ink is made when its axes have
their place on a sheet (`Scale`). Lengths are points, from the upper left corner.

Long curves are drawn with fewer points, which leaves the same dots on a screen: a line
keeps its ends and extremes in every `FINE` part of the axis, less those that lie within
`FLAT` of the axes' height of the line through their neighbours; bars in the same point
of the axis are joined where they overlap, and of marks within two points of each other
one is drawn.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from itertools import compress
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.report.interactivity import entries_of, names_of
from simval.report.panels import (
    AREA,
    GREY,
    INK,
    LONG_CURVE,
    MANY,
    SHARE,
    SIMULATED,
    THEORY,
    BarPanel,
    DotPanel,
    HeatPanel,
    Panel,
    Series,
    SpherePanel,
    near,
)
from simval.shapes import Float

SIZE, TITLE, SMALL = 10.0, 11.0, 8.5
"""Of labels, of titles, of words on a panel and of a legend, points."""
MARK, CAP = 4.4, 2.0  # across a mark; half of a bar's end
SPREAD = 2.0 / 3.0  # of a row, over which the dots of a name are spread
MARGIN = 0.05  # of an axis beyond its data
WIDEST = 10.0
"""Greatest value over the least up to which an axis of ratios is linear."""
FAINT, FULL = 0.12, 0.6
"""Opacity of the least and of the whole share: words on it keep a contrast of 5."""
RIM = 1.7  # half of a map of directions
MOST_TICKS = 8
MINOR = 60
"""Ticks without names of a logarithmic axis, at most."""
SHARP, DIGITS = 4, 12
FINE, FLAT, TINY = 500, 0.003, 1e-12

MANTISSAS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Ticks within a decade of a logarithmic axis, the fewest first."""
ENOUGH, PLACES = 3, 6
"""Labels that an axis has where it can; places of data that are named one by one."""
GAP = 0.15
"""Least distance of two labels along an axis, as a share of it: five digits."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DASHES = {"-": "", "--": "5.2 2.2", "-.": "9 2.2 1.4 2.2", ":": "1.4 2.3"}
LONG, SHORT = "4.8 2.4", "1.4 3"  # of references
SAMPLE = 17.0  # of a line in a legend
SAMPLE_LINE = np.array([[0.0, 0.0], [SAMPLE, 0.0]])
SAMPLE_BOX = np.array([[0.0, -3.0], [SAMPLE, -3.0], [SAMPLE, 3.0], [0.0, 3.0]])
REST: Any = {"colour": GREY, "opacity": 0.25, "filled": True}  # what is shaded
FAR = 1e4  # from a sheet

# ---- ink


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines, or areas without an outline."""

    paths: Sequence[Array]  # (n, 2) each
    colour: str = INK
    width: float = 0.8
    dash: str = ""  # lengths of strokes and gaps
    opacity: float = 1.0
    filled: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks of one kind."""

    places: Array  # (n, 2)
    marker: str
    colour: str
    hollow: bool = False


@dataclass(frozen=True, slots=True)
class Words:
    """Text of one or more lines."""

    text: str
    x: float
    y: float  # of the middle of the first line's letters
    size: float = SIZE
    anchor: str = "middle"  # start, middle or end
    turn: float = 0.0  # against the clock, degrees


Ink = Lines | Marks | Words


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Ink that the page's script can show and hide together."""

    ink: Sequence[Ink]
    attributes: str = ""
    inside: bool = True  # cut off at the ends of the axes


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """An entry of a legend."""

    label: str
    ink: Sequence[Lines | Marks]  # from 0 to `SAMPLE` across, at height 0
    key: str = ""  # of the series that it shows and hides


# ---- axes


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One axis of a panel."""

    low: float
    high: float
    log: bool = False
    label: str = ""
    # places and names; None chooses round numbers
    ticks: Sequence[tuple[float, str]] | None = None
    whole: bool = False  # numbers between two whole ones are none
    grid: bool = True
    marked: bool = True  # ticks have strokes


@dataclass(frozen=True, slots=True)
class Scale:
    """An axis, placed on a sheet."""

    axis: Axis
    start: float
    stop: float

    def __call__(self, values: Array | float) -> Array:
        """Places of values on the sheet; what is far outside is brought nearer."""
        ends = np.array([self.axis.low, self.axis.high])
        values = np.asarray(values, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.axis.log:  # what has no logarithm is far below
                ends, values = np.log(ends), np.nan_to_num(np.log(values), nan=-np.inf)
            shares = (values - ends[0]) / (ends[1] - ends[0])
        return np.clip(self.start + shares * (self.stop - self.start), -FAR, FAR)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A panel with its axes."""

    title: str
    x: Axis
    y: Axis
    draw: Callable[[Scale, Scale], list[Group]]
    points: Sequence[Series] = ()  # where they are drawn
    # numbers that are drawn, each with what it is: across, up, half of its bar
    data: Sequence[tuple[str, Sequence[Sequence[Any]]]] = ()
    upward: str = ""  # what the second of them is, where it is not what the axis says
    entries: Sequence[Entry] = ()
    # that may be named at their ends, each with what the page's script knows it by
    named: Sequence[tuple[Series, str]] = ()
    slant: float = 0.0  # of the names below, degrees
    bare: bool = False  # without axes, and as high as wide


def ends(values: Iterable[Array | Sequence[float]], *, log: bool = False) -> Array:
    """Ends of an axis around some values, with a margin."""
    every = np.concatenate([np.empty(0), *values])
    every = every[near(every)]
    if not every.size:
        return np.array([0.0, 1.0])
    found = np.array([every.min(), every.max()])
    if log:
        return np.exp(ends([np.log(found)])) if found[0] < found[1] else found
    width = found[1] - found[0]
    if not width > 1e-12 * np.abs(found).max():
        width = abs(float(found[1])) or 1.0
    return found + MARGIN * width * np.array([-1.0, 1.0])


def ticks_of(axis: Axis, room: float, *, along: bool) -> Sequence[tuple[float, str]]:
    """Ticks with names that fit on an axis of this length."""
    if axis.ticks is not None:
        return axis.ticks
    if axis.log:
        return [(x, spelled(x)) for x in log_ticks(axis.low, axis.high, np.empty(0))]
    found: list[tuple[float, str]] = []
    for most in range(MOST_TICKS, 1, -1):
        ticks = even_ticks(axis.low, axis.high, most, whole=axis.whole)
        found = list(zip(ticks, decimals(ticks), strict=True))
        longest = max((len(name) for _, name in found), default=0)
        need = (0.62 * longest + 1.0) * SIZE if along else 2.0 * SIZE
        if need * len(found) <= room:
            break
    return found


def even_ticks(
    low: float, high: float, most: int, *, whole: bool = False
) -> list[float]:
    """A few multiples of 1, 2, 2.5 or 5 times a power of ten."""
    width = (high - low) / most
    power = 10.0 ** np.floor(np.log10(width))
    for factor in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0):
        step = factor * power
        if step < width or (whole and step != np.rint(step)):
            continue
        first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
        return [float(f"{k * step:.12g}") for k in np.arange(first, last + 1.0)]
    return even_ticks(np.ceil(low), np.ceil(low) + most, most)  # a step of one


def decimals(ticks: Sequence[float]) -> list[str]:
    """Spell numbers with equally many decimals."""
    greatest = max(map(abs, ticks), default=0.0)
    if greatest and not 1e-3 <= greatest < 1e5:
        names = [spelled(abs(x)) if x else "0" for x in ticks]
    else:
        parts = [f"{x:.9f}".rstrip("0").partition(".")[2] for x in ticks]
        places = max(map(len, parts), default=0)
        names = [f"{abs(x):.{places}f}" for x in ticks]
    signs = ["−" if x < 0.0 else "" for x in ticks]
    return [sign + name for sign, name in zip(signs, names, strict=True)]


def log_ticks(low: float, high: float, places: Float[Array, " n"]) -> list[float]:
    """Ticks of a logarithmic axis: at its data if they are few, else round numbers."""
    if not 0.0 < low < high < np.inf:
        return []
    inside = [float(x) for x in places if low <= x <= high]
    if 2 <= len(inside) <= PLACES and len(inside) == len(places):
        apart = np.diff(np.log(inside)) / np.log(high / low)
        if np.all(apart >= GAP) and all(len(spelled(x)) <= 5 for x in inside):
            return inside
    # decades, thinned where they are many; parts of them where they are few
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for mantissas in MANTISSAS:
        every = [float(f"{m:g}e{power}") for power in powers for m in mantissas]
        ticks = [tick for tick in every if low <= tick <= high]
        if len(ticks) >= ENOUGH:
            step = -(-len(ticks) // PLACES) if mantissas == (1.0,) else 1
            return ticks[::step]
    return even_ticks(low, high, 4)


def minor_ticks(axis: Axis) -> list[float]:
    """Minor ticks of a logarithmic axis, 2 to 9 in each decade if decades are few."""
    if not (axis.log and 0.0 < axis.low < axis.high < np.inf):
        return []
    first, last = np.floor(np.log10([axis.low, axis.high])).astype(int).tolist()
    every = [m * 10.0**power for power in range(first, last + 1) for m in range(2, 10)]
    inside = [tick for tick in every if axis.low <= tick <= axis.high]
    return inside if len(inside) <= MINOR else []


def spelled(x: float) -> str:
    """Spell a number on an axis: 0.1, 10⁻⁵, 3×10⁻⁵."""
    if 1e-3 <= x < 1e5:
        return f"{x:.6g}"
    head, _, power = f"{x:.2e}".partition("e")
    raised = f"10{str(int(power)).translate(SUPERSCRIPTS)}"
    head = head.rstrip("0").rstrip(".")
    return raised if head == "1" else f"{head}×{raised}"


# ---- kinds of panels


@singledispatch
def framed(panel: object, labels: Sequence[str]) -> Frame:
    """Axes and ink of a panel; `labels` are those of its whole figure."""
    raise TypeError(type(panel))


@framed.register
def _(panel: Panel, labels: Sequence[str]) -> Frame:
    names, panel = names_of(panel, labels), _drawable(panel)
    across, up = _across(panel, panel.series), _up(panel)
    series = [_fewer(s, across, up) for s in panel.series]
    labelled = [label for _, label in panel.references if label]
    dashes = [SHORT if label in labelled[1:] else LONG for _, label in panel.references]
    limits = [s for s in series if not _whole(s, panel.log_y).all()][:1]

    def draw(x: Scale, y: Scale) -> list[Group]:
        spans = [_box(x(span[0]), x(span[1]), y.start, y.stop) for span in panel.spans]
        ink = [Lines(spans, **REST)]
        for (height, _), dash in zip(panel.references, dashes, strict=True):
            path = np.array([[x.start, y(height)], [x.stop, y(height)]])
            ink.append(Lines([path], GREY, 1.2, dash))
        draws = [_curve if s.line else _points for s in series]
        return [Group(ink)] + [
            Group(draw(s, x, y), own)
            for s, draw, own in zip(series, draws, names, strict=True)
            if len(s.x)
        ]

    def end(s: Series) -> Series:  # an upper limit is drawn at the end of its bar
        band = 0.0 if s.band is None or s.line else s.band
        return replace(s, y=np.where(_whole(s, panel.log_y), s.y, s.y + band))

    more: list[Entry] = [
        Entry(label, [Lines([SAMPLE_LINE], GREY, 1.2, dash)])
        for (_, label), dash in zip(panel.references, dashes, strict=True)
    ]
    more += [Entry(panel.shaded, [Lines([SAMPLE_BOX], **REST)])] * bool(panel.spans)
    more += [Entry("upper limit: the bar reaches 0", [_limit(s)]) for s in limits]
    points = [end(s) for s in series]
    return Frame(
        title=panel.title,
        x=across,
        y=up,
        draw=draw,
        points=points,
        named=_named(points, names),
        entries=_entries(panel, labels) + [entry for entry in more if entry.label],
        data=[_numbers(s, s.y) for s in series],
    )


def _named(series: Sequence[Series], names: Sequence[str]) -> list[tuple[Series, str]]:
    """Series that may be named at their ends: no two ends have one colour."""
    plain = INK, GREY  # of theory, a bound, a limit
    own = [
        (s, name)
        for s, name in zip(series, names, strict=True)
        if len(s.x) and s.colour not in plain and s.line != AREA
    ]
    ends = {(s.colour, s.x[-1], s.y[-1]) for s, _ in own}
    found = [each for each in own if each[0].label]
    return found if len(ends) == len(found) else []


def _numbers(s: Series, y: Sequence[Any] | Array) -> tuple[str, list[Sequence[Any]]]:
    """The data of a series that is drawn."""
    band = [""] * len(s.x) if s.band is None else s.band
    return s.label, [*zip(s.x, y, band, strict=True)]


def _drawable(panel: Panel) -> Panel:
    """Leave out points that no axis can show; without data the axes are linear."""
    series = []
    for s in panel.series:
        with np.errstate(over="ignore", invalid="ignore"):  # such are left out
            top = s.y if s.line or s.band is None else s.y + s.band  # an upper limit
        good = near(s.x) & near(s.y) & near(top)
        good &= (s.x > 0.0) | (not panel.log_x)
        good &= (top > 0.0) | (not panel.log_y)
        band = None if s.band is None else np.where(near(s.band), s.band, 0.0)[good]
        notes = tuple(compress(s.notes, good))
        series.append(replace(s, x=s.x[good], y=s.y[good], band=band, notes=notes))
    left = any(len(s.x) for s in series)
    log_x, log_y = panel.log_x and left, panel.log_y and left
    return replace(panel, series=series, log_x=log_x, log_y=log_y)


def _across(panel: Panel, series: Sequence[Series]) -> Axis:
    places = [s.x for s in panel.series]
    low, high = ends([*(s.x for s in series), *panel.spans], log=panel.log_x)
    if not panel.log_x:
        whole = bool(places) and all(np.array_equal(x, np.rint(x)) for x in places)
        return Axis(low=low, high=high, label=panel.x_label, whole=whole)
    found = np.unique(np.concatenate(places))
    if len(found) == 1:  # a single place gets the middle
        low, high = found[0] / 2.2, found[0] * 2.2
    ticks = [(x, spelled(x)) for x in log_ticks(low, high, found)]
    return Axis(low=low, high=high, log=True, label=panel.x_label, ticks=ticks)


def _up(panel: Panel) -> Axis:
    """Vertical axis with room for what is drawn."""
    heights = [np.array([height for height, _ in panel.references], dtype=float)]
    for s in panel.series:
        heights.append(np.asarray(s.y, dtype=float))
        if s.band is not None:
            heights += [s.y + s.band] if panel.log_y else [s.y + s.band, s.y - s.band]
    values = np.concatenate(heights)
    values = values[near(values) & ((values > 0.0) | (not panel.log_y))]
    low, high = ends([values])
    if panel.log_y and values.size:
        low, high = values.min() / 1.5, values.max() * 1.5
    ticks = None
    if panel.limits:  # of a ratio: one tick on each side of 1, if it is in the middle
        low, high = panel.limits
        *_, far = even_ticks(0.0, 0.9 * (high - 1.0), 3)
        if 1.0 - low > far:
            ticks = [(x, f"{x:g}") for x in (1.0 - far, 1.0 + far)]
    return Axis(low=low, high=high, log=panel.log_y, label=panel.y_label, ticks=ticks)


def _curve(s: Series, x: Scale, y: Scale) -> list[Ink]:
    ink: list[Ink] = _stroke(s, _path(s.x, s.y, x, y))
    if s.band is not None:
        low, high = (_path(s.x, s.y + k * s.band, x, y) for k in (-1.0, 1.0))
        area = np.vstack([low, high[::-1]])
        ink.insert(0, Lines([area], s.colour, opacity=0.2, filled=True))
    return ink


def _stroke(s: Series, path: Array) -> list[Any]:
    """Line of a curve; thin for theory, none for an area."""
    width = 1.0 if s.colour == INK else 1.4
    dash = DASHES.get(s.line)
    return [] if dash is None else [Lines([path], s.colour, width, dash)]


def _points(s: Series, x: Scale, y: Scale) -> list[Ink]:
    """Points with bars; on a logarithmic axis an upper limit if a bar reaches 0."""
    whole = _whole(s, y.axis.log)
    if s.band is None:
        return [_marks(s, x(s.x), y(s.y))]
    low, high = y(s.y - s.band)[whole], y(s.y + s.band)[whole]
    limits = x(s.x)[~whole], y(s.y + s.band)[~whole]
    return [
        Lines(_bars(x(s.x)[whole], low, high), s.colour, 1.2),
        replace(_limit(s), places=_marks(s, *limits).places),
        _marks(s, x(s.x)[whole], y(s.y)[whole]),
    ]


def _limit(s: Series) -> Marks:
    """The mark of an upper limit."""
    return Marks(SAMPLE_LINE.mean(axis=0, keepdims=True), "v", s.colour, hollow=True)


def _flat_points(s: Series, x: Scale, y: Scale) -> list[Ink]:
    ink: list[Ink] = [_marks(s, x(s.x), y(s.y))]
    if s.band is not None:
        low, high = x(s.x - s.band), x(s.x + s.band)
        wide = near(s.band)  # what is not sampled has no bar
        bars = _bars(y(s.y)[wide], low[wide], high[wide], flat=True)
        ink.insert(0, Lines(bars, s.colour, 1.2))
    return ink


def _whole(s: Series, upper_limits: bool) -> Any:
    """Mask of the points that are no upper limits."""
    if s.line or not upper_limits or s.band is None:
        return np.ones(len(s.x), dtype=bool)
    return ~(s.y - s.band <= 0.0)


def _path(values: Array, heights: Array, x: Scale, y: Scale) -> Array:
    return np.column_stack([x(values), y(heights)])


def _fewer(s: Series, across: Axis, up: Axis) -> Series:
    """A line with many points, reduced to those that can be seen."""
    if not s.line or len(s.x) <= LONG_CURVE:
        return s
    half: Any = 0.0 if s.band is None else s.band
    x = Scale(across, 0.0, FINE)(s.x)
    edges = [Scale(up, 0.0, 1.0)(s.y + k * half) for k in (-1.0, 1.0)]
    kept = np.unique(np.concatenate([_seen(x, y) for y in edges]))
    # to a ten-thousandth of the axis, where that is even
    length = 0.0 if up.log else up.high - up.low
    digits = SHARP - int(np.floor(np.log10(length))) if length else DIGITS
    band = None if s.band is None else s.band[kept].round(digits)
    return replace(s, x=s.x[kept], y=s.y[kept].round(digits), band=band)


def _seen(x: Array, y: Array) -> Any:
    """Indices of the points of a line that matter: ends, extremes and bends.

    A point is left out within `FLAT` of the chord of its neighbours, every second one
    at a time, until none is; so a smooth line is off by less than twice that.
    """
    runs = np.append(0, np.cumsum(np.diff(np.floor(x)) != 0.0))
    order = np.lexsort((y, runs))
    edges = np.flatnonzero(np.diff(runs)) + 1
    first, last = np.append(0, edges), np.append(edges, len(x)) - 1
    kept = np.unique([first, last, order[first], order[last]])
    before = 0
    while before != len(kept):
        before = len(kept)
        for start in (1, 2):
            here = np.arange(start, len(kept) - 1, 2)
            a, b, c = kept[here - 1], kept[here], kept[here + 1]
            share = (x[b] - x[a]) / np.maximum(x[c] - x[a], TINY)
            off = y[b] - y[a] - share * (y[c] - y[a])
            kept = np.delete(kept, here[np.abs(off) < FLAT])
    return kept


def _marks(s: Series, x: Array, y: Array) -> Marks:
    places = np.column_stack([x, y])
    return Marks(places[_apart(places)], s.marker, s.colour)


def _apart(places: Array) -> Any:
    """Which marks to draw: one of any within two points of each other."""
    if len(places) <= MANY:
        return slice(None)
    return np.sort(np.unique(np.rint(places / 2.0), axis=0, return_index=True)[1])


def _bars(across: Array, low: Array, high: Array, *, flat: bool = False) -> list[Array]:
    """Bars with ends; if there are many, the stretches that they cover."""
    low, high, caps = np.minimum(low, high), np.maximum(low, high), CAP
    if len(across) > MANY:
        columns, caps = np.rint(across), 0.0
        order = np.lexsort((low, columns))
        across, low, high = columns[order], low[order], high[order]
        # a new column begins anew, whatever was covered before
        shift = (across - across[0]) * 4.0 * FAR
        reach = np.maximum.accumulate(high + shift)
        fresh = np.append(True, (low + shift)[1:] > reach[:-1])
        last = np.append(np.flatnonzero(fresh)[1:], len(low)) - 1
        across, low, high = across[fresh], low[fresh], (reach - shift)[last]
    bars = [np.array([[across, low], [across, high]])]
    if caps:
        bars += [
            np.array([[across - caps, e], [across + caps, e]]) for e in (low, high)
        ]
    paths = np.moveaxis(np.array(bars), -1, 0).reshape(-1, 2, 2)
    return [*(paths[..., ::-1] if flat else paths)]


def _box(left: Any, right: Any, low: Any, high: Any) -> Array:
    return np.array([[left, low], [right, low], [right, high], [left, high]])


def _entries(panel: Panel | DotPanel, labels: Sequence[str]) -> list[Entry]:
    """Legend entries of some series."""
    found = []
    for s, key in entries_of(panel, labels):
        middle, none, reach = np.array([SAMPLE / 2.0]), np.zeros(1), np.full(1, 5.0)
        ink: list[Any] = (
            _stroke(s, SAMPLE_LINE) if s.line else [_marks(s, middle, none)]
        )
        if s.band is not None and s.line:
            box = Lines([SAMPLE_BOX], s.colour, opacity=0.2, filled=True)
            ink.insert(0, box)
        elif s.band is not None:
            flat = isinstance(panel, DotPanel)
            ends = (
                (none, middle - reach, middle + reach)
                if flat
                else (middle, -reach, reach)
            )
            ink.insert(0, Lines(_bars(*ends, flat=flat), s.colour, 1.2))
        found.append(Entry(s.label, ink, key))
    return found


@framed.register
def _(panel: SpherePanel, labels: Sequence[str]) -> Frame:
    def draw(x: Scale, y: Scale) -> list[Group]:
        angle = np.linspace(0.0, 2.0 * np.pi, 121)
        radii = 2.0 * np.sin(np.radians([30.0, 60.0, 90.0]) / 2.0)
        rings = [_path(r * np.cos(angle), r * np.sin(angle), x, y) for r in radii]
        ink: list[Ink] = [Lines(rings, GREY, 0.6)]
        for directions, mark, colour in (
            (panel.directions, "o", SIMULATED),
            (panel.wanted, "D", THEORY),
        ):
            half = _half(panel, directions)
            # Lambert's azimuthal equal-area projection about the pole
            flat = half[:, :2] * np.sqrt(2.0 / (1.0 + np.abs(half[:, 2:])))
            places = np.column_stack([x(flat[:, 0]), y(flat[:, 1])])
            ink.append(Marks(places[_apart(places)], mark, colour))
        rim = 1.1 * radii[-1]
        for words, across, up in (("x", rim, 0.0), ("y", 0.0, rim)):
            ink.append(Words(words, float(x(across)), float(y(up)), SMALL))
        return [Group(ink)]

    axis, middle = Axis(low=-RIM, high=RIM), SAMPLE_LINE.mean(axis=0, keepdims=True)
    kinds = [("pose", panel.directions, "o", SIMULATED)]
    kinds += [("where one more would help most", panel.wanted, "D", THEORY)]
    shown = [kind for kind in kinds if len(kind[1])]
    return Frame(
        title=panel.title,
        x=axis,
        y=axis,
        draw=draw,
        bare=True,
        entries=[Entry(kind[0], [Marks(middle, *kind[2:])]) for kind in shown],
        data=[(name, [(*each, "") for each in _half(panel, unit)[:, :2]])
              for name, unit, *_ in shown],
    )  # fmt: skip


def _half(panel: SpherePanel, directions: Array) -> Array:
    return directions[panel.sign * directions[:, 2] >= 0.0]


def _rows(names: Sequence[str], *, marked: bool = False) -> Axis:
    """The axis of named rows, from top to bottom."""
    ticks = [(float(i), name) for i, name in enumerate(reversed(names))]
    high = len(names) - 0.5
    return Axis(low=-0.5, high=high, ticks=ticks, grid=False, marked=marked)


@framed.register
def _(panel: BarPanel, labels: Sequence[str]) -> Frame:
    rows = np.arange(float(len(panel.names)))[::-1]
    measured, band, predicted = (
        np.where(near(values), values, np.nan)
        for values in (panel.measured, panel.band, panel.predicted)
    )
    reach = np.concatenate([measured, measured - band, measured + band, predicted])
    low, high = ends([[0.0], reach])
    if not np.any(reach < 0.0):
        low = 0.0  # bars begin at the axis

    def draw(x: Scale, y: Scale) -> list[Group]:
        seen = near(measured)
        sides = np.column_stack([x(measured), y(rows - 0.3), y(rows + 0.3)])[seen]
        bars = [_box(float(x(0.0)), *each) for each in sides]
        seen &= near(band)
        left, right = x((measured - band)[seen]), x((measured + band)[seen])
        places = np.column_stack([x(predicted), y(rows)])[near(predicted)]
        return [
            Group(
                [
                    Lines(bars, SIMULATED, opacity=0.5, filled=True),
                    Lines(_bars(y(rows[seen]), left, right, flat=True), width=1.2),
                    Marks(places, "D", THEORY),
                ]
            )
        ]

    good = near(panel.measured)
    notes = tuple(compress(panel.notes, good))
    bar = Lines([_box(0.0, SAMPLE, -3.0, 3.0)], SIMULATED, opacity=0.5, filled=True)
    diamond = Marks(np.array([[SAMPLE / 2.0, 0.0]]), "D", THEORY)
    return Frame(
        title=panel.title,
        x=Axis(low=low, high=high, label=panel.x_label),
        y=_rows(panel.names, marked=True),
        draw=draw,
        points=[Series(label="measured", x=measured[good], y=rows[good], notes=notes)],
        entries=[Entry("measured", [bar]), Entry("predicted", [diamond])],
        data=[
            (name, [numbers])
            for name, *numbers in zip(
                panel.names, measured, predicted, band, strict=True
            )
        ],
        upward="predicted",
    )


@framed.register
def _(panel: DotPanel, labels: Sequence[str]) -> Frame:
    reference, rows, count = panel.reference[0], len(panel.names), len(panel.series)
    names, series = names_of(panel, labels), []
    for i, s in enumerate(panel.series):
        shift = 0.0 if count == 1 else (i / (count - 1) - 0.5) * SPREAD
        good = near(s.x)
        y = rows - 1 - s.y[good] - shift
        band = None if s.band is None else s.band[good]
        notes = tuple(compress(s.notes, good))
        series.append(replace(s, x=s.x[good], y=y, band=band, notes=notes))
    # a linear axis with the reference on it, or a logarithmic one for many tens
    every = np.concatenate([[reference], *(s.x for s in series)])
    log = bool(np.all(every > 0.0) and every.max() > WIDEST * every.min())
    bands = [s.x + k * s.band for s in series if s.band is not None for k in (-1, 1)]
    reach = np.concatenate([every, *bands])
    low, high = ends([reach[reach > 0.0] if log else reach], log=log)
    if not log and not high - low >= 0.02 * abs(reference):  # but the reference nothing
        low, high = reference - 0.01, reference + 0.01

    def draw(x: Scale, y: Scale) -> list[Group]:
        shaded = [  # every second row
            _box(x.start, x.stop, *y(np.array([low - 0.5, low + 0.5])))
            for low in range(1, rows, 2)
        ]
        line = np.array([[x(reference), y.start], [x(reference), y.stop]])
        ink = [Lines(shaded, GREY, opacity=0.12, filled=True)]
        ink.append(Lines([line], GREY, 1.2, LONG))
        return [Group(ink)] + [
            Group(_flat_points(s, x, y), own)
            for s, own in zip(series, names, strict=True)
        ]

    return Frame(
        title=panel.title,
        x=Axis(low=low, high=high, log=log, label=panel.x_label),
        y=replace(_rows(panel.names), label=panel.y_label),
        draw=draw,
        points=series,
        entries=_entries(panel, labels)
        + [Entry(panel.reference[1], [Lines([SAMPLE_LINE], GREY, 1.2, LONG)])]
        * bool(panel.reference[1]),
        data=[
            _numbers(s, [panel.names[int(place)] for place in s.y])
            for s in panel.series
        ],
    )


@framed.register
def _(panel: HeatPanel, labels: Sequence[str]) -> Frame:
    rows, columns = panel.shares.shape

    def draw(x: Scale, y: Scale) -> list[Group]:
        across, up = (
            x(np.arange(columns + 1) - 0.5),
            y(rows - 0.5 - np.arange(rows + 1)),
        )
        edges = [np.array([[c, y.start], [c, y.stop]]) for c in across[1:-1]]
        edges += [np.array([[x.start, c], [x.stop, c]]) for c in up[1:-1]]
        ink: list[Ink] = [Lines(edges, GREY, 0.5, opacity=0.35)]
        for i, j in np.ndindex(rows, columns):
            share = float(panel.shares[i, j])
            words = percent(share) if share > 0.0 else "" if share == 0.0 else "?"
            box = _box(across[j], across[j + 1], up[i], up[i + 1])
            if share > 0.0:
                alpha = FAINT + (FULL - FAINT) * share
                ink.append(Lines([box], SHARE, opacity=alpha, filled=True))
            if panel.expected[i, j] and words:
                words = f"({words})"
            middle = box.mean(axis=0).tolist()
            ink.append(Words(words, middle[0], middle[1], SMALL))
        return [Group(ink)]

    names = [(float(j), name) for j, name in enumerate(panel.columns)]
    return Frame(
        title=panel.title,
        x=Axis(low=-0.5, high=columns - 0.5, ticks=names, grid=False, marked=False),
        y=_rows(panel.names),
        draw=draw,
        slant=50.0,
        data=[
            (
                name,
                [
                    (column, share, "")
                    for column, share in zip(panel.columns, shares, strict=True)
                ],
            )
            for name, shares in zip(panel.names, panel.shares, strict=True)
        ],
        upward="share that fails",
    )


def percent(share: float) -> str:
    """Spell a share in percent; 0 and 100 only if none or all fail."""
    if share < 0.01:
        return "<1"
    return ">99" if 0.99 < share < 1.0 else f"{100.0 * share:.0f}"
