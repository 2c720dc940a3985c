"""What a study is: a name, its parameters, and a pure function of a cell.

Whether every trial of some noise and some poses has an answer shows only when they are
drawn. Where one has none, what the others say is of a chosen few, so nothing is stated
of them: the cell is refused, in words (`refusing`), as a plug-in is that breaks its
word.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from simval.arguments import MOST, instance
from simval.errors import (
    InputError,
    PluginError,
    RefusedError,
    SimulationError,
    UnmeasurableError,
)
from simval.figures import Headline, Shown
from simval.results import Outcome
from simval.streams import Streams, cell_key
from simval.text import as_whole


@dataclass(frozen=True, slots=True)
class Cost:
    """Expected cost of a cell, for planning only."""

    seconds: float  # CPU time on a processor of a few GHz, s
    rows: int  # rows that it leaves


def _ends(field: FieldInfo) -> bool:
    """True if a field states its own upper limit."""
    return any(hasattr(limit, "le") or hasattr(limit, "lt") for limit in field.metadata)


class StudyParameters(BaseModel):
    """Base of every study's parameters: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False
    )

    @field_validator("*", mode="before")
    @classmethod
    def _whole(cls, value: Any, info: ValidationInfo) -> Any:
        """Accept 1e5 for an integer."""
        field = cls.model_fields[info.field_name or ""]
        number = as_whole(value) if field.annotation is int else value
        if type(number) is int and number > MOST and not _ends(field):
            kind, msg = (
                "less_than_equal",
                "Input should be less than or equal to {most}",
            )
            raise PydanticCustomError(kind, msg, {"most": MOST})
        return number

    def cost(self) -> Cost:
        """Default cost of a cell: one second and fifty rows."""
        return Cost(1.0, 50)

    plugin: ClassVar[str] = ""
    """Field that names a plug-in; only there a slash is more than text."""

    no_noise: ClassVar[tuple[str, ...]] = ()
    """Fields on which the random streams do not depend: their cells share the noise."""

    def named(self) -> dict[str, Any]:
        """Values as they appear in names, stores and tables."""
        return self.model_dump()

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of files that the study's code has outside the package."""
        return ()


Geometry = Annotated[
    int,
    Field(
        ge=0,
        lt=2**63,
        description="Number of the random attitude and vectors, a seed.",
    ),
]
"""A random geometry by its number."""


def described(default: Any, words: str) -> Any:
    """A parameter that is a choice or a name: default and description."""
    return Field(default, description=words)


def ranged(default: float, words: str, least: float, most: float | None = None) -> Any:
    """A parameter that is a number: default, description and range."""
    return Field(default, description=words, ge=least, le=most)


@dataclass(frozen=True, slots=True)
class Study:
    """A named experiment: parameters, and a function that measures something at them.

    Attributes
    ----------
    name : str
        Name in suites and on the command line, which is that of its module.
    title : str
        What it measures, in one line for people.
    parameters : type of StudyParameters
        Model of the parameters of one cell, with their defaults and ranges.
    run : callable
        ``run(parameters, streams) -> Outcome``. It draws random numbers from `streams`
        alone, so that equal arguments give equal numbers.
    section : str or None
        Section of the page that shows it. None has one made, with its statistics along
        whatever parameter varies.
    shown : sequence of Figure, Distribution, Trace and Listing
        Figures and tables of the section.
    about : str
        Paragraph above them.
    headline : Headline or None
        Sentence about it on the first screen; None takes its first statistics.
    """

    name: str
    title: str
    parameters: type[StudyParameters]
    run: Callable[[Any, Streams], Outcome]
    section: str | None
    shown: Sequence[Shown] = ()
    about: str = ""
    headline: Headline | None = None


def study_of(name: str, module: Any) -> Study:
    """Make the study of a module, from the names that every study has."""
    parameters = instance("Parameters", module.Parameters, type)
    if not issubclass(parameters, StudyParameters):
        msg = "`Parameters` must be a subclass of simval.studies.study.StudyParameters"
        raise InputError(msg)
    return Study(
        name=name,
        title=instance("TITLE", module.TITLE, str),
        parameters=parameters,
        run=module.run,
        section=getattr(module, "SECTION", None),
        shown=getattr(module, "FIGURES", ()),
        about=getattr(module, "ABOUT", ""),
        headline=getattr(module, "HEADLINE", None),
    )


@dataclass(frozen=True, slots=True)
class Cell:
    """One unit of work of a sweep: a study at one set of parameters and one seed."""

    study: str  # name of the study
    parameters: StudyParameters  # its parameters
    seed: int  # the run's seed

    @property
    def key_name(self) -> str:
        """Name without the seed: the study and its parameters, sorted."""
        return self._named(())

    @property
    def name(self) -> str:
        """Name of the cell, unique in a run."""
        return f"{self.key_name}@{self.seed}"

    @property
    def streams(self) -> Streams:
        """Random streams of the cell, set by its seed and name alone.

        Of the name without the fields that do not count, where there are such.
        """
        return Streams(self.seed, cell_key(self._named(self.parameters.no_noise)))

    def _named(self, without: tuple[str, ...]) -> str:
        values = self.parameters.named().items()
        return spelled(self.study, {k: v for k, v in values if k not in without})


def spelled(study: str, parameters: Mapping[str, Any]) -> str:
    """Name of a cell without its seed."""
    inside = (f"{k}={canonical(v)}" for k, v in sorted(parameters.items()))
    return f"{study}({','.join(inside)})"


def canonical(value: Any) -> str:
    """Standard spelling of a parameter value in cell names."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(value)


Model = TypeVar("Model")
Run = Callable[[Model, Streams], Outcome]

LEAST_NOISE = 1e-9
"""Of quantities about 1 or 10: rounding, 1e-15 of them, is then a millionth of it, and
its square, which theory takes, is far from where floats end."""


def refusing(advice: str) -> Callable[[Run[Model]], Run[Model]]:
    """Refuse a cell in which trials have no answer, and advise a change.

    A simulation that fails its checks is no such case, nor is a plug-in.
    """

    def decorated(run: Run[Model]) -> Run[Model]:
        @wraps(run)
        def refused(parameters: Any, streams: Streams) -> Outcome:
            try:
                return run(parameters, streams)
            except (SimulationError, PluginError):
                raise
            except RefusedError as error:
                msg = f"these parameters cannot be measured: {error}; {advice}"
                raise UnmeasurableError(msg) from None

        return refused

    return decorated
