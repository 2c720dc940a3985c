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
    return ", ".join(row.statistic.entries)


def entry(place: int) -> Label:
    """One entry of a row."""
    return lambda row: row.statistic.entries[place]


def predictor(row: Row) -> str:
    """The theory that a row is compared with."""
    return row.predictor


def words(row: Row) -> str:
    """Family of a row, and its entries."""
    return ": ".join((row.statistic.family.words, *row.statistic.entries))


def of_calibration(row: Row) -> Unit:
    """Unit of a parameter of an accelerometer, by the first letter of its entry."""
    return OF_A_CALIBRATION.get(row.statistic.entries[0][:1], COUNT)


def along_entry(row: Row) -> float:
    """The number along which a row of a family is measured: its last entry."""
    return float(row.statistic.entries[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """Common part of a figure of rows and a figure of an artifact.

    Attributes
    ----------
    name : str
        Unique on the page; its file name.
    asked : str
        Question that it answers, as a person would ask it.
    caption : str
        What the reader sees below it.
    says : str
        Sentence made of the rows: ``{most}`` and ``{least}`` with ``{most_of}`` and
        ``{least_of}``, whose they are; ``{each}``, the least and greatest of each
        line, ``{most_each}`` the greatest alone; and ``{gains}`` by theory from
        ``{few}`` to ``{many}``, the ends of the axis.
    about : sequence of Family or Statistic
        Rows that the sentence is about, where they are not those drawn.
    named : callable, str or None
        What the sentence calls a row; None is its line.
    unit : Unit, callable or None
        In which a person reads the values; None is that of the rows.
    fold : str
        Words of the fold that it is behind; with ``{claim}`` what it claims, and then
        it is open if that is not so.
    section : str
        Section of the report, where it is not that of its study.
    columns : int
        Panels side by side.
    """

    name: str
    caption: str
    asked: str = ""
    says: str = ""
    about: Sequence[Family | Statistic] = ()
    named: Label | str | None = None
    unit: Unit | Callable[[Row], Unit] | None = None
    fold: str = ""
    section: str = ""
    columns: int = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure(Picture):
    """A figure of rows: points along an axis, or a bar for each row.

    Attributes
    ----------
    what : str
        Subject of the sentence that says whether the rows are as predicted; several,
        with a semicolon between, are about one of the families each.
    rows : sequence of Family or Statistic
        Rows that are drawn; of a family all without control variates.
    claimed : sequence of Family or Statistic
        Rows that the sentence is about, where they are not those drawn.
    by : str or None
        Their predictor; None takes any.
    along : str or callable
        Parameter or family of the cell, or number of the row; empty draws bars.
    axis, value : str
        Words of both axes, where they are not those of the parameter and the family.
    panels : callable or None
        Divides the rows; None makes a panel of each group of cells.
    lines : callable, str or None
        What tells lines or bars of a panel apart: of the rows, or a parameter.
    compared : bool
        Whether predictions are drawn and the rows claimed to be at them.
    bound : str
        Predictor that is dotted below.
    theories : sequence of str
        Predictors with a line each, where there are several.
    theory : str
        What the predictor is called in the sentence.
    level : float or None
        Height of a line across.
    resolved : mapping
        Of a panel the family whose standard error over its prediction is dotted: what
        lies below cannot be seen.
    scale : tuple or None
        Family, predictor and words of what the values are told as a share of, where
        none of them can be told from zero.
    slope : float, mapping or None
        Leading order along the axis, or that of each line: gives a table of slopes.
    least : sequence of str
        Parameters of which the cells with the least value alone are drawn.
    each : bool
        Whether each group of cells has a figure of its own.
    single : bool
        Whether the group of cells with the most places is drawn alone.
    over : sequence of str
        Parameters in which the cells of one line differ; each cell is a line then.
    several : bool
        Whether groups of cells with one place on the axis are left out.
    floor : Statistic, Family or None
        Value of the cell that is dotted across, or family of values along the axis.
    where : callable
        Which cells it is about, by their parameters.
    log_x, log_y : bool or None
        Whether an axis is logarithmic; None if its values span more than a decade.
    ratio : bool
        Whether measured over predicted stands below.
    beside : sequence of Figure
        Whose panels stand beside its own.
    """

    rows: Sequence[Family | Statistic]
    what: str = ""
    claimed: Sequence[Family | Statistic] = ()
    by: str | None = None
    along: str | Callable[[Row], float] = ""
    axis: str = ""
    value: str = ""
    panels: Label | None = None
    lines: Label | str | None = None
    compared: bool = True
    bound: str = ""
    theories: Sequence[str] = ()
    theory: str = "theory"
    level: float | None = None
    resolved: Mapping[str, Family] = field(default_factory=dict)
    scale: tuple[Family, str, str] | None = None
    slope: float | Mapping[str, float] | None = None
    least: Sequence[str] = ()
    each: bool = False
    single: bool = False
    over: Sequence[str] = ()
    several: bool = False
    floor: Statistic | Family | None = None
    where: Callable[[Parameters], bool] = lambda parameters: True
    log_x: bool | None = True
    log_y: bool | None = True
    ratio: bool = True
    beside: Sequence["Figure"] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact(Picture):
    """A figure of the artifact files of cells.

    Attributes
    ----------
    file : callable
        Name of the artifact of a cell's parameters.
    axis : str
        Words of the axis.
    each : bool
        Whether each cell has a figure of its own; else each has panels.
    most : int
        Cells that are drawn, evenly from the first to the last; for the page's size.
    """

    file: Callable[[Parameters], str]
    axis: str
    each: bool = False
    most: int = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution(Artifact):
    """The share of values of an artifact that are at most each value.

    Attributes
    ----------
    arrays : callable
        Names of the arrays of each line of each panel: ``{panel: {line: name}}``.
    value : str
        Words of the other axis.
    references : sequence of float
        Shares with a line across.
    upright : mapping
        Lines upright, by what they are.
    """

    arrays: Callable[[Parameters], Mapping[str, Mapping[str, str]]]
    value: str = "share"
    references: Sequence[float] = ()
    upright: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """Axes of a trace.

    Attributes
    ----------
    value : str
        Words of the other axis.
    array : str
        What is drawn, (n,), or (n, k) of a column for each of `names`; empty draws
        every array of the artifact with a mark for each value.
    names : sequence of str
        Of the columns, where there are several.
    along : str
        Array of the axis, where it is not that of the trace.
    title : str
        Words above; empty is the cell's.
    shaded : str
        Array of the intervals of the axis that are shaded, (m, 2).
    level : str
        Array of one value that is a line across, and what it is called.
    log_y : bool
        Whether the values have a logarithmic axis.
    """

    value: str
    array: str = ""
    names: Sequence[str] = ("x", "y", "z")
    along: str = ""
    title: str = ""
    shaded: str = ""
    level: str = ""
    log_y: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace(Artifact):
    """Arrays of an artifact along time, or along their places.

    Attributes
    ----------
    strips : sequence of Strip
        One below the other.
    along : str
        Array of the axis; empty counts the values from 0.
    tells : callable
        What the arrays of a cell say, in words, where no rows say it.
    """

    strips: Sequence[Strip]
    along: str = ""
    tells: Callable[[Mapping[str, Array]], str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Listing:
    """A table of rows: a line for each cell and key, a column for each statistic.

    Attributes
    ----------
    name : str
        Unique on the page; its file name.
    caption : str
        What it holds; also the words of its fold.
    rows : sequence of Family or Statistic
        Rows that stand in it.
    keys : mapping
        Title of a column and what of a row stands in it; rows with the same keys are
        one line.
    column : callable
        Title of the column in which a row's value stands.
    parameters : sequence of str
        Of the cells, that have a column though they do not vary.
    unit : callable
        In which a person reads the values, where it is not that of the rows.
    predicted : bool
        Whether each column has one with its predictions beside it.
    open : bool
        Whether it stands at once, without a fold.
    claim : str
        Subject of a sentence for the fold: that the rows are as predicted.
    section : str
        Section of the report, where it is not that of its study.
    where : callable
        Which cells it is about, by their parameters.
    """

    name: str
    caption: str
    rows: Sequence[Family | Statistic]
    keys: Mapping[str, Label]
    column: Label = words
    parameters: Sequence[str] = ()
    unit: Callable[[Row], Unit | None] = lambda row: None
    predicted: bool = False
    open: bool = False
    claim: str = ""
    section: str = ""
    where: Callable[[Parameters], bool] = lambda parameters: True


@dataclass(frozen=True, slots=True, kw_only=True)
class Quote:
    """A number of a sentence: a row's value, or that over its prediction.

    Attributes
    ----------
    of : Statistic
        Of which row.
    by : str
        Its predictor.
    unit : Unit or None
        In which it is told without its error; None tells value and error as they are.
    digits : int
        Of a number in a unit.
    angle : bool
        Whether it is an angle, told in degrees or, if small, in milliradians.
    over : bool
        Whether it is told over its prediction.
    root : bool
        Whether its root is told, as of a variance.
    times : float
        Factor before all.
    """

    of: Statistic
    by: str = ""
    unit: Unit | None = None
    digits: int = 2
    angle: bool = False
    over: bool = False
    root: bool = False
    times: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """One-sentence summary of a study on the first screen.

    Attributes
    ----------
    says : str
        With a place for each quote.
    quotes : mapping
        Numbers by their places; the first says how great the error of a cell is.
    """

    says: str
    quotes: Mapping[str, Quote]


Shown = Figure | Distribution | Trace | Listing


def belongs(row: Row, wanted: Sequence[Family | Statistic]) -> bool:
    """True if a row is of these families, without control variates, or statistics."""
    what = row.statistic
    return what in wanted or (what.family in wanted and not what.controlled)
