"""What a study is: a name, its parameters, and a pure function of a cell."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from simval.arguments import MOST
from simval.figures import Headline, Shown
from simval.results import Outcome
from simval.streams import Streams, cell_key
from simval.text import as_whole


@dataclass(frozen=True, slots=True)
class Cost:
    """What a cell is expected to cost, for planning only."""

    seconds: float  # CPU time on a processor of a few GHz, s
    rows: int  # rows that it leaves


def _ends(field: FieldInfo) -> bool:
    """Whether a field says itself how great it may be."""
    return any(hasattr(limit, "le") or hasattr(limit, "lt") for limit in field.metadata)


class StudyParameters(BaseModel):
    """Base of every study's parameters: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False
    )

    @field_validator("*", mode="before")
    @classmethod
    def _whole(cls, value: Any, info: ValidationInfo) -> Any:
        """Take 1e5 for an integer where one is asked for."""
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
        """Cost of a cell if a study does not state it: a second and fifty rows."""
        return Cost(1.0, 50)

    plugin: ClassVar[str] = ""
    """Field that names a plug-in; only there a slash is more than text."""

    no_noise: ClassVar[tuple[str, ...]] = ()
    """Fields on which the random streams do not depend: their cells share the noise."""

    def named(self) -> dict[str, Any]:
        """Values as a name, a store and a table hold them."""
        return self.model_dump()

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of the files that the study's code is made of, beside the package."""
        return ()


@dataclass(frozen=True, slots=True)
class Study:
    """A named experiment.

    Attributes
    ----------
    name : str
        As suites and the command line call it: the name of its module.
    title : str
        One line for people.
    parameters : type of StudyParameters
        Model of one cell's parameters.
    run : callable
        ``run(parameters, streams) -> Outcome``, pure.
    section : str or None
        Section of the report that shows it; None draws it along what varies.
    shown : sequence of Figure, Distribution and Listing
        What the section shows of it.
    about : str
        What the section says before them.
    headline : Headline or None
        By which it is told on the first screen; None takes its first statistics.
    """

    name: str
    title: str
    parameters: type[StudyParameters]
    run: Callable[[Any, Streams], Outcome]
    section: str | None
    shown: Sequence[Shown] = ()
    about: str = ""
    headline: Headline | None = None


def study_of(module: Any) -> Study:
    """Study of a module with the names that `simval.studies` asks for."""
    return Study(
        name=module.__name__.rpartition(".")[2],
        title=module.TITLE,
        parameters=module.Parameters,
        run=module.run,
        section=module.SECTION,
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
        """Canonical name without the seed: study and sorted parameters."""
        return self._named(())

    @property
    def name(self) -> str:
        """Unique name in a run: the canonical name and the seed."""
        return f"{self.key_name}@{self.seed}"

    @property
    def streams(self) -> Streams:
        """The cell's random streams, fixed by its seed and its name alone.

        Of the name without the fields that do not count, where there are such.
        """
        return Streams(self.seed, cell_key(self._named(self.parameters.no_noise)))

    def _named(self, without: tuple[str, ...]) -> str:
        values = self.parameters.named().items()
        return spelled(self.study, {k: v for k, v in values if k not in without})


def spelled(study: str, parameters: Mapping[str, Any]) -> str:
    """Name of a cell without its seed: what every name is made by, and checked."""
    inside = (f"{k}={canonical(v)}" for k, v in sorted(parameters.items()))
    return f"{study}({','.join(inside)})"


def canonical(value: Any) -> str:
    """One spelling for each parameter value, as used in cell names."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(value)
