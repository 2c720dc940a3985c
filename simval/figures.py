"""Figures and tables of a study, declared as data.

A study declares them beside its experiment and draws nothing: the report draws every
figure the same way. Measured values have bars that hold for all of a figure together,
predictions are lines or diamonds, their ratio stands below, where it can be seen, and
the sentence above says of all rows whether they are as predicted.

A figure takes the rows of some families. Rows of one cell are told apart by `panels`
and `lines`; cells are told apart by their parameters: those of the axis and of `lines`
apart, each group of cells is a panel, or a line where `panels` divides the rows.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from simval.arrays import Array
from simval.results import Row
from simval.statistics import Family, Statistic
from simval.units import COUNT, OF_A_CALIBRATION, Unit

Parameters = Mapping[str, Any]
VARYING = "*"
"""An axis that is whatever number varies most over the cells."""
Label = Callable[[Row], str]
"""What tells a row from others of its cell, in words."""


def entries(row: Row) -> str:
    """All entries of a row."""
    return ", ".join(row.statistic.printed)


def entry(place: int) -> Label:
    """A label: the entry at one place of a row's statistic."""
    return lambda row: row.statistic.printed[place]


def predictor(row: Row) -> str:
    """A label: the theory that a row is compared with."""
    return row.predictor


def family_words(row: Row) -> str:
    """A label: the family of a row's statistic, in words."""
    return row.statistic.family.words


def words(row: Row) -> str:
    """A label: the family of a row's statistic and its entries, in words."""
    return ": ".join((row.statistic.family.words, *row.statistic.printed))


def of_calibration(row: Row) -> Unit:
    """Unit in which a person reads an accelerometer's parameter, T, K or B."""
    return OF_A_CALIBRATION.get(row.statistic.entries[0][:1], COUNT)


def along_entry(row: Row) -> float:
    """The number along which a row is plotted: the last entry of its statistic."""
    return float(row.statistic.entries[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What a figure of rows and a figure of an artifact have in common."""

    name: str  # unique on the page; its file name
    caption: str  # what the reader sees below it
    asked: str = ""  # question that it answers, as a person would ask it
    # sentence made of the rows: ``{most}`` and ``{least}`` with ``{most_of}`` and
    # ``{least_of}``, whose they are; ``{each}``, the least and greatest of each
    # line, ``{most_each}`` the greatest alone; and ``{gains}`` by theory from
    # ``{few}`` to ``{many}``, the ends of the axis
    says: str = ""
    # rows that the sentence is about, where they are not those drawn
    about: Sequence[Family | Statistic] = ()
    named: Label | str | None = None  # what the sentence calls a row; None is its line
    # in which a person reads the values; None is that of the rows
    unit: Unit | Callable[[Row], Unit] | None = None
    # title of the fold that hides it; ``{claim}`` in it stands for its claim, and the
    # figure is unfolded if that fails
    fold: str = ""
    section: str = ""  # section of the report, where it is not that of its study
    columns: int = 3  # panels side by side


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure(Picture):
    """A figure of rows against an axis, or as bars; a study declares it as data.

    Each row that `rows` names is a point. Its place is the value of the parameter
    `along` in its cell; without `along` each row is a bar. Cells that differ in that
    parameter alone make a line, and `lines` and `panels` divide the rows further.
    Points are drawn with 95 % intervals that hold for all of a figure together, and
    predictions as lines with the ratio of both below. The sentence above the figure
    says whether the rows agree with their predictions; `what` is its subject.
    """

    # statistics that are drawn; a family means all of its rows, but for those sampled
    # with control variates
    rows: Sequence[Family | Statistic]
    # subject of the sentence that says whether the rows are as predicted; several
    # subjects, with a semicolon between, are about one of the families each
    what: str = ""
    # rows that the sentence is about, where they are not those drawn
    claimed: Sequence[Family | Statistic] = ()
    by: str | None = None  # the theory to compare with; None takes any
    # parameter of the cell, or function of the row, that is the axis; empty draws bars
    along: str | Callable[[Row], float] = ""
    # names of both axes, where they are not those of the parameter and the family
    axis: str = ""
    value: str = ""
    # title of the panel that a row is in; None makes a panel of each group of cells
    panels: Label | None = None
    # name of the line or bar that a row is in, or a parameter that tells lines apart
    lines: Label | str | None = None
    # whether predictions are drawn, and the sentence compares the rows with them
    compared: bool = True
    bound: str = ""  # theory that is a bound, drawn as a dotted line
    theories: Sequence[str] = ()  # further theories, drawn as a line each
    theory: str = "theory"  # what the sentence calls the theory
    level: float | None = None  # height of a level line
    # by panel, the family whose relative standard error is a dotted line: what lies
    # below it cannot be seen
    resolved: Mapping[str, Family] = field(default_factory=dict)
    # family, theory and name of what values are stated as a share of, where none of
    # them can be distinguished from zero
    scale: tuple[Family, str, str] | None = None
    # theory's leading order along the axis, for all lines or each; adds a table of
    # fitted slopes
    slope: float | Mapping[str, float] | None = None
    # parameters of which only the cells with the least value are drawn
    least: Sequence[str] = ()
    each: bool = False  # whether each group of cells has a figure of its own
    # whether the group of cells with the most places is drawn alone
    single: bool = False
    # parameters in which the cells of one line differ; each cell is a line then
    over: Sequence[str] = ()
    # whether groups of cells with one place on the axis are left out
    several: bool = False
    # value of a cell drawn as a dotted level, or family of values along the axis
    floor: Statistic | Family | None = None
    # which cells are drawn, by their parameters
    where: Callable[[Parameters], bool] = lambda parameters: True
    # whether an axis is logarithmic; None: if its values span more than a decade
    log_x: bool | None = True
    log_y: bool | None = True
    ratio: bool = True  # whether measured over predicted is drawn below
    beside: Sequence["Figure"] = ()  # figures whose panels are drawn beside its own


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact(Picture):
    """A figure of the artifact files that cells have left."""

    file: Callable[[Parameters], str]  # name of the artifact of a cell's parameters
    axis: str  # name of the axis
    # whether each cell has a figure of its own; else each has panels
    each: bool = False
    # cells that are drawn, evenly from the first to the last; for the page's size
    most: int = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution(Artifact):
    """Cumulative distributions of the arrays in an artifact."""

    # names of the arrays of each line of each panel: ``{panel: {line: name}}``
    arrays: Callable[[Parameters], Mapping[str, Mapping[str, str]]]
    value: str = "share"  # name of the other axis
    references: Sequence[float] = ()  # shares with a line across
    # lines upright, by what they are
    upright: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """One pair of axes of a trace."""

    value: str  # name of the other axis
    # what is drawn, (n,), or (n, k) of a column for each of `names`; empty draws
    # every array of the artifact with a mark for each value
    array: str = ""
    names: Sequence[str] = ("x", "y", "z")  # of the columns, where there are several
    along: str = ""  # array of the axis, where it is not that of the trace
    title: str = ""  # words above; empty is the cell's
    shaded: str = ""  # array of the intervals of the axis that are shaded, (m, 2)
    level: str = ""  # array of one value that is a line across, and what it is called
    log_y: bool = True  # whether the values have a logarithmic axis


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace(Artifact):
    """Arrays of an artifact over time, or in their order."""

    strips: Sequence[Strip]  # one below the other
    along: str = ""  # array of the axis; empty counts the values from 0
    # what the arrays of a cell say, in words, where no rows say it
    tells: Callable[[Mapping[str, Array]], str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """A table of rows: a line for each cell and key, a column for each statistic."""

    name: str  # unique on the page; its file name
    caption: str  # what it holds; also the title of its fold
    rows: Sequence[Family | Statistic]  # rows that stand in it
    # title of a column and what of a row stands in it; rows with the same keys
    # are one line
    keys: Mapping[str, Label]
    column: Label = words  # title of the column in which a row's value stands
    # of the cells, that have a column though they do not vary
    parameters: Sequence[str] = ()
    # in which a person reads the values, where it is not that of the rows
    unit: Callable[[Row], Unit | None] = lambda row: None
    # whether each column is followed by one with its predictions
    predicted: bool = False
    open: bool = False  # whether it stands at once, without a fold
    # subject of a sentence for the fold: that the rows are as predicted
    claim: str = ""
    section: str = ""  # section of the report, where it is not that of its study
    # which cells it is about, by their parameters
    where: Callable[[Parameters], bool] = lambda parameters: True


@dataclass(frozen=True, slots=True, kw_only=True)
class Quote:
    """A number in a sentence: the value of a row, or its ratio to the prediction."""

    of: Statistic  # statistic of the row
    by: str = ""  # its predictor
    unit: Unit | None = None  # unit to state it in; None: that of the row
    # whether it is an angle, stated in degrees or, if small, in milliradians
    angle: bool = False
    over: bool = False  # whether its ratio to the prediction is stated
    root: bool = False  # whether its square root is stated, as of a variance
    times: float = 1.0  # factor to multiply it by before anything else


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """The sentence with which the first screen sums up a study."""

    says: str  # with a place for each quote
    # numbers by their places; the first says how great the error of a cell is
    quotes: Mapping[str, Quote]


Shown = Figure | Distribution | Trace | Listing


def belongs(row: Row, wanted: Sequence[Family | Statistic]) -> bool:
    """True if a row is of the wanted families (no control variates) or statistics."""
    what = row.statistic
    return what in wanted or (what.family in wanted and not what.controlled)
