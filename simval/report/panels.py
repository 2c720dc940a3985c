"""What a figure shows, as data; `paint` turns it into SVG or PNG.

No drawing here: a section computes panels, a panel is arrays and words.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from jaxtyping import Float

from simval.arrays import Array
from simval.report.words import slug

# Okabe and Ito's palette: told apart with every kind of colour vision
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
GREY = "#8c8c8c"
# and not by colour alone
MARKERS = ("o", "s", "^", "D", "v", "P")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """One curve of a panel.

    Attributes
    ----------
    label : str
        For the legend; empty leaves it out.
    x, y : Array
        Points, (n,). What is not finite, or not positive on a logarithmic axis, is
        not drawn.
    band : Array or None
        Half width of the confidence band about each y.
    colour : str
        A colour.
    line : str
        Matplotlib line style; empty draws points.
    marker : str
        Matplotlib marker of the points.
    """

    label: str
    x: Float[Array, " n"]
    y: Float[Array, " n"]
    band: Float[Array, " n"] | None = None
    colour: str = COLOURS[0]
    line: str = ""
    marker: str = "o"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One set of axes with curves.

    Attributes
    ----------
    title, x_label, y_label : str
        Words, with units.
    series : sequence of Series
        Curves, drawn in order.
    log_x, log_y : bool
        Logarithmic axes.
    references : sequence of (float, str)
        Horizontal lines: height and label.
    spans : sequence of (float, float)
        Shaded intervals of x.
    dodge : bool
        Set the points of different series at the same x side by side.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series] = field(default_factory=tuple)
    log_x: bool = True
    log_y: bool = True
    references: Sequence[tuple[float, str]] = ()
    spans: Sequence[tuple[float, float]] = ()
    dodge: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpherePanel:
    """Directions in an equal-area map of one half sphere.

    Attributes
    ----------
    title : str
        Words.
    directions : Array
        Unit vectors; those of the other half are not drawn.
    sign : float
        1 for z >= 0, -1 for z <= 0.
    """

    title: str
    directions: Float[Array, "n 3"]
    sign: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BarPanel:
    """Measured parts of a whole beside what was predicted for each.

    Attributes
    ----------
    title, x_label : str
        Words, with the unit.
    names : sequence of str
        The parts, from top to bottom.
    measured, band, predicted : Array
        Value, half width of its confidence band and prediction; a prediction
        that is not finite is not drawn.
    """

    title: str
    x_label: str
    names: Sequence[str]
    measured: Float[Array, " n"]
    band: Float[Array, " n"]
    predicted: Float[Array, " n"]


AnyPanel = Panel | SpherePanel | BarPanel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """A figure: panels, a caption and a text for those who cannot see it.

    Attributes
    ----------
    name : str
        Unique on the page: part of every id in the figure, and its file name; a slug
        (`simval.report.words.slug`).
    caption : str
        What the reader sees below it.
    alternative : str
        What the figure shows, in words.
    panels : sequence of panels
        One or more.
    columns : int
        Panels side by side.
    left_out : sequence of str
        What the run has of this kind and the figure does not draw, each by its name;
        the page says so below the caption.
    """

    name: str
    caption: str
    alternative: str
    panels: Sequence[AnyPanel]
    columns: int = 3
    left_out: Sequence[str] = ()

    def __post_init__(self) -> None:
        assert self.name == slug(self.name), self.name
