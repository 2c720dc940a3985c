"""What a figure shows, as data; `paint` makes SVG or PNG of it.

No drawing here: a section computes panels, a panel is arrays and words.

What a colour, a marker and a line mean, the same on the whole page.

What was simulated or measured is blue, or of the colours beside it where several groups
share axes, each with a marker of its own. Theory is a thin line in the ink of the
words; where formulas are compared, the second order is ochre, the source's fourth order
pink, the complete fourth order green, the exact answer dotted in ink. The Cramér-Rao
bound is grey and dotted.

On light paper and in print a colour is what it is here, on dark paper that of `DARK`.
Each has a contrast of at least 3 to its paper, and is told apart with every kind of
colour vision, or by its marker or line (tests/report/test_curves.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.report.formatting import slug
from simval.shapes import Float

DARK = {
    "#1d5fa6": "#7ab4f5", "#b4540a": "#f0a25c", "#558822": "#bbee77",
    "#884488": "#cc88cc", "#009999": "#55ccbb", "#cc3366": "#ff88aa",
    "#bb8800": "#ddaa33", "#ee3388": "#ff88bb", "#118844": "#55bb77",
    "#776666": "#998888",
}  # fmt: skip
"""Colours, and what each is on dark paper."""
COLOURS = tuple(DARK)[:6]
"""What was measured, by group: residuals, numbers of poses, algorithms, axes x y z."""

MARKERS = ("o", "s", "^", "D", "v", "P")
"""Of each group: not told apart by colour alone."""

SIMULATED = COLOURS[0]
# the last: equation (63) as the source prints it
ORDER_2, ORDER_4_SOURCE, ORDER_4_COMPLETE, ORDER_2_PRINTED = tuple(DARK)[6:]
INK = "#010203"
"""The colour of the words: it becomes ``currentColor``, so it is dark or light."""
THEORY = EXACT = INK
GREY = "#8c8c8c"
BOUND = GREY
SHARE = "#d55e00"
"""Of a map of shares that fail, more or less opaque."""
AREA = "area"
"""Line style of a band without its middle: what is stated, expected or allowed."""
LONG_CURVE = 100
"""Points of a curve beyond which its figure is wide and the page's script zooms it."""
MANY = 1500
"""Points of a series beyond which it is drawn with fewer, and they say no values."""
FARTHEST = 1e290  # an axis multiplies its ends by some factors of ten


def near(values: Array) -> Any:
    """Mask of values that an axis can show: finite and far from overflow."""
    return np.abs(values) < FARTHEST  # NaN is not


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """One curve of a panel."""

    label: str  # for the legend; empty leaves it out
    # Points, (n,). What is not finite, or not positive on a logarithmic axis, is not
    # drawn.
    x: Float[Array, " n"]
    y: Float[Array, " n"]
    # half width of the confidence band about each y
    band: Float[Array, " n"] | None = None
    colour: str = COLOURS[0]
    line: str = ""  # Matplotlib line style, or `AREA`; empty draws points
    marker: str = "o"  # Matplotlib marker of the points
    # what the page says of each point on request, in words; empty says nothing
    notes: Sequence[str] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One set of axes with curves."""

    # words, with units
    title: str
    x_label: str
    y_label: str
    series: Sequence[Series] = field(default_factory=tuple)  # curves, drawn in order
    log_x: bool = True
    log_y: bool = True
    references: Sequence[tuple[float, str]] = ()  # horizontal lines: height and label
    # shaded intervals of x, and what they are
    spans: Sequence[tuple[float, float]] = ()
    shaded: str = "at rest"
    limits: tuple[float, float] | None = None  # of y; None fits them to what is drawn
    height: float = 1.0  # of its axes, in that of most
    strips: Sequence["Panel"] = ()  # below it on the same axis

    @property
    def long(self) -> bool:
        """True if it has a curve with many points over a linear axis, such as time."""
        return not self.log_x and any(len(s.x) > LONG_CURVE for s in self.series)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpherePanel:
    """Directions on an equal-area map of one half of the sphere."""

    title: str
    # unit vectors; those of the other half are not drawn
    directions: Float[Array, "n 3"]
    sign: float  # 1 for z >= 0, -1 for z <= 0
    # those to be set apart, where something is still to come
    wanted: Float[Array, "m 3"] = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BarPanel:
    """Measured parts of a whole, each beside its prediction."""

    # words, with the unit
    title: str
    x_label: str
    names: Sequence[str]  # the parts, from top to bottom
    # value, half width of its confidence band and prediction; a prediction that is not
    # finite is not drawn
    measured: Float[Array, " n"]
    band: Float[Array, " n"]
    predicted: Float[Array, " n"]
    # what the page says of each part on request; empty says nothing
    notes: Sequence[str] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DotPanel:
    """Values of named things along one axis, several for each."""

    # words, with the unit
    title: str
    x_label: str
    names: Sequence[str]  # the things, from top to bottom
    # x is the value, y the place of its name, the first 0; band is about x
    series: Sequence[Series]
    reference: tuple[float, str]  # a vertical line: its place and what it is
    y_label: str = ""  # what the things are


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeatPanel:
    """A share from 0 to 1 for each pair of names."""

    title: str
    names: Sequence[str]  # from top to bottom
    columns: Sequence[str]  # from left to right
    shares: Float[Array, "n m"]  # NaN where none was measured
    expected: Float[Array, "n m"]  # 1 where the share was declared beforehand, else 0


AnyPanel = Panel | SpherePanel | BarPanel | DotPanel | HeatPanel


def shade(colour: str) -> str:
    """A colour for the page, which has other colours in dark mode (``style.css``)."""
    return f"var(--x{colour[1:]},{colour})" if colour in DARK else colour


def told(panel: AnyPanel) -> str:
    """Text alternative of a panel: its title, axes and legend."""
    x, y = getattr(panel, "x_label", ""), getattr(panel, "y_label", "")
    labels = ", ".join(s.label for s in getattr(panel, "series", ()) if s.label)
    words = (panel.title, f"{y} against {x}" if x and y else x, labels)
    return "; ".join(part for part in words if part)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """A figure: panels, a caption, and a text for those who cannot see it."""

    # unique on the page: part of every id in the figure, and its file name; a slug
    # (`simval.report.formatting.slug`)
    name: str
    caption: str  # what the reader sees below it
    panels: Sequence[AnyPanel]
    # what it shows, in words; without, its question and its panels
    alternative: str = ""
    columns: int = 3  # panels side by side
    asked: str = ""  # the question that it answers, as a person would ask it
    finding: str = ""  # the answer in one sentence, made from the numbers
    fold: str = ""  # words of the fold that it is behind; empty shows it at once
    # what the finding or the fold claims of which rows (`simval.report.findings.Claim`)
    claims: Sequence[object] = ()
    # what the run has of this kind and the figure does not draw, each by its name; the
    # page says so below the caption
    left_out: Sequence[str] = ()

    def __post_init__(self) -> None:
        assert self.name == slug(self.name), self.name
        if not self.alternative:
            titles = f"Panels: {'; '.join(panel.title for panel in self.panels)}"
            words = told(self.panels[0]) if len(self.panels) == 1 else titles
            object.__setattr__(self, "alternative", f"{self.asked} {words}".strip())
