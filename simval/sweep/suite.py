"""Suite files: TOML that is validated and expanded to cells.

    title = "What it measures"
    seed = 1                        # or a list: the whole grid for each seed

    [attitude]                      # a study by name
    noise_std = [0.005, 0.01]       # a list is an axis of the grid
    samples = 1_000_000             # a scalar is the same in every cell

    [[need]]                        # what its numbers must keep: see `needs`
    quantity = "attitude.rms"
    below = "0.02"

Each value is checked against the study's own parameters; what is left out takes the
study's default. `--set attitude.noise_std=1e-3,1e-2` on the command line wins.

Paths in a suite file are relative to its folder, and so are words of a command that are
files in it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
)
from pydantic.fields import FieldInfo

from simval.errors import InputError
from simval.files import MOST_DOCUMENT, parsed, read_text, toml
from simval.plugins.names import located
from simval.studies import STUDIES
from simval.studies.plugin import PluginParameters
from simval.studies.study import Cell, StudyParameters
from simval.sweep.needs import Need
from simval.text import as_whole, did_you_mean, shown
from simval.vocabulary import builtin_suites

Model = TypeVar("Model", bound=BaseModel)
NonEmpty = Field(min_length=1)
WHOLE = BeforeValidator(as_whole)
MOST_CELLS: Final = 200_000
"""All cells of a run are held in memory, with some 80 rows of 0.3 kB each."""
MOST_FAULTS = 20
"""Errors of a file that are listed, at most."""
Seed = Annotated[int, Field(ge=0, lt=2**63), WHOLE]


Grid = Mapping[str, Any]
"""Title, seeds and the table of each study, as a file has them."""


@dataclass(frozen=True, slots=True)
class Suite:
    """A validated suite: its cells in order, and its file."""

    name: str  # built-in, or the file's stem
    title: str  # one line for people
    cells: Sequence[Cell]  # all of the grid for each seed in turn
    grid: Grid  # the file's content after overrides, for the manifest
    question: str = ""  # that it is to answer
    needs: Sequence[Need] = ()


def suite_model() -> type[BaseModel]:
    """Pydantic model of a suite file, with an optional table for each study."""
    return _model_of(tuple(STUDIES))


@cache
def _model_of(studies: tuple[str, ...]) -> type[BaseModel]:
    strict = ConfigDict(extra="forbid", frozen=True, strict=True)
    tables: dict[str, Any] = {}
    for name, study in ((each, STUDIES[each]) for each in studies):
        axes: dict[str, Any] = {}
        for key, info in study.parameters.model_fields.items():
            element: Any = _annotated(info)
            either: Any = element | Annotated[list[element], NonEmpty]
            field = Field(default=info.default, description=info.description)
            axes[key] = (either, field)
        table = create_model(f"{name}_grid", __config__=strict, **axes)
        tables[name] = (table | None, Field(default=None, description=study.title))
    seeds = Seed | Annotated[list[Seed], NonEmpty]
    return create_model(
        "simval suite",
        __config__=strict,
        title=(str, Field(default="", description="One line for people.")),
        seed=(seeds, Field(default=1, description="Seed, or one grid for each.")),
        question=(str, Field(default="", description="What it is to answer.")),
        need=(list[Need], Field(default=[], description="Quantities, with limits.")),
        **tables,
    )


def suite_schema() -> dict[str, Any]:
    """JSON Schema of a suite file, for editors and other programs.

    Returns
    -------
    dict
        The schema.
    """
    return suite_model().model_json_schema()


def load_suite(
    name: str, overrides: Iterable[str] = (), seed: int | None = None
) -> Suite:
    """Read a suite, apply overrides, and expand its grid to cells.

    Parameters
    ----------
    name : str
        A built-in name, or the path of a TOML file.
    overrides : iterable of str
        ``study.key=value[,value...]``, each replacing the file's entry.
    seed : int, optional
        Replaces the file's seed.

    Returns
    -------
    Suite
        The suite, validated and expanded.

    Raises
    ------
    InputError
        If there is no such suite, or the file is not valid: the message gives the
        path to the key, what was given and what is allowed.
    """
    stem, text = _read(name)
    try:
        content = parsed(toml, text)
    except ValueError as error:
        msg = f"suite {name} is not valid TOML: {error}"
        raise InputError(msg) from None
    content = beside(content, Path(name).parent)
    for override in overrides:
        _override(content, override)
    if seed is not None:
        content["seed"] = seed
    return expand(stem, content)


def expand(name: str, content: Grid) -> Suite:
    """Validate a suite's content, and expand its grid to cells.

    Raises
    ------
    InputError
        If a key is unknown, a value has the wrong type or range, a list is empty,
        two cells are the same, or there is no study at all.
    """
    model = validated(f"suite {name}", suite_model(), content)
    studies = [key for key in STUDIES if getattr(model, key) is not None]
    if not studies:
        msg = (
            f"suite {name} names no study, so it would measure nothing; add a "
            f"table for one of {', '.join(STUDIES)}"
        )
        raise InputError(msg)
    _require_size(name, model)
    points = [
        (study, parameters)
        for study in studies
        for parameters in _points(name, study, getattr(model, study))
    ]
    seeds = _as_list(model.seed)  # type: ignore[attr-defined]
    cells = tuple(Cell(study, own, seed) for seed in seeds for study, own in points)
    _check_names(name, cells)
    grid = {"seed": seeds} | {key: getattr(model, key).model_dump() for key in studies}
    words = model.model_dump(include={"title", "question"})
    needs: list[Need] = getattr(model, "need")  # noqa: B009 - a field made above
    for need in needs:
        if need.study not in studies:
            near = did_you_mean(need.study, studies)
            msg = (
                f"suite {name} needs {need.quantity}, and has no study `{need.study}`"
                f"{near}: it has {', '.join(studies)}"
            )
            raise InputError(msg)
    return Suite(name=name, cells=cells, grid=grid, needs=needs, **words)


def _points(name: str, study: str, content: BaseModel) -> Iterator[StudyParameters]:
    """All combinations of a study's axes; the last axis changes fastest."""
    model = STUDIES[study].parameters
    axes = {key: _as_list(value) for key, value in content.model_dump().items()}
    for values in product(*axes.values()):
        point = dict(zip(axes, values, strict=True))
        yield validated(f"suite {name}, {study}", model, point)


def _check_names(name: str, cells: Iterable[Cell]) -> None:
    known: dict[str, Cell] = {}
    for cell in cells:
        other = known.setdefault(cell.name, cell)
        if other is cell:
            continue
        msg = f"suite {name} has the cell {cell.name} twice; remove the repeated value"
        theirs, ours = (c.parameters.model_dump() for c in (other, cell))
        clash = [
            repr(v) for k in ours if ours[k] != theirs[k] for v in (theirs[k], ours[k])
        ]
        if clash:
            msg = (
                f"suite {name}: {' and '.join(clash)} would both be the cell "
                f"{cell.name}, since its name omits folders; rename one of the files"
            )
        raise InputError(msg)


def _annotated(info: FieldInfo) -> Any:
    """Type of a field with its constraints."""
    annotation: Any = info.annotation
    for constraint in info.metadata:
        annotation = Annotated[annotation, constraint]
    return Annotated[annotation, WHOLE] if info.annotation is int else annotation


def _read(name: str) -> tuple[str, str]:
    if name in builtin_suites():
        file = resources.files("simval.sweep") / "suites" / f"{name}.toml"
        return name, file.read_text(encoding="utf-8")
    path = Path(name)
    try:
        is_there = path.exists() and not path.is_dir()
    except OSError:  # a name that no file can have
        is_there = False
    if not is_there:
        near = did_you_mean(name, builtin_suites())
        msg = (
            f"there is no suite `{name}`{near}: the built-in ones are "
            f"{', '.join(builtin_suites())}; anything else must be the path of a "
            "TOML file"
        )
        raise InputError(msg)
    try:
        return path.stem, read_text(path, MOST_DOCUMENT, "utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"suite {name} cannot be read: {error}"
        raise InputError(msg) from None


def _override(content: dict[str, Any], override: str) -> None:
    path, equals, text = override.partition("=")
    study, dot, key = path.strip().partition(".")
    if not (equals and dot and key and text.strip()) or "." in key:
        msg = (
            f"`--set {override:.60}` is not of the form STUDY.KEY=VALUE[,VALUE...], "
            "for example attitude.noise_std=1e-3,1e-2"
        )
        raise InputError(msg)
    table = content.setdefault(study, {})
    if not isinstance(table, dict):
        msg = f"`--set {override:.60}`: `{study}` is no study; use {', '.join(STUDIES)}"
        raise InputError(msg)
    whole = literal(text.strip())
    if isinstance(whole, list):
        table[key] = whole
        return
    values = [literal(part.strip()) for part in text.split(",")]
    table[key] = values if len(values) > 1 else values[0]


def literal(text: str) -> Any:
    """Read a TOML literal; anything else is text."""
    try:
        content = parsed(toml, f"value = {text}")
    except ValueError:
        return text
    return content["value"] if len(content) == 1 else text


def validated(where: str, model: type[Model], content: Mapping[str, Any]) -> Model:
    """Validate content by a model, with readable errors."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = [e for e in error.errors() if not _other_arm(e)] or error.errors()
        told = dict.fromkeys(_explain(e, model) for e in faults[:MOST_FAULTS])
        more = len(faults) - MOST_FAULTS
        msg = f"{where}: {'; '.join(told)}" + (f"; and {more:,} more" * (more > 0))
        raise InputError(msg) from None


def _other_arm(error: Any) -> bool:
    """True if an error is about the alternative of `value | list` not used."""
    listed = any("list[" in str(part) for part in error["loc"])
    if error["type"] == "list_type":
        return listed
    return isinstance(error["input"], list) and not listed


def _explain(error: Any, model: type[BaseModel]) -> str:
    words = [str(part) for part in error["loc"]]
    if error["type"] == "value_error" and not words:  # of all parameters together
        return str(error["msg"]).removeprefix("Value error, ")
    names = [w for w in words if w.isidentifier() and w not in ("int", "float", "str")]
    path = ".".join(names[:2]) or "the file"
    if error["type"] == "extra_forbidden":
        known = tuple(model.model_fields)
        if len(words) > 1 and words[0] in STUDIES:
            known = tuple(STUDIES[words[0]].parameters.model_fields)
        elif words[0] == "need":
            known = tuple(Need.model_fields)
        near = did_you_mean(words[-1], known)
        return f"`{path}` is not a known key{near}; known here: {', '.join(known)}"
    given = f"(given {shown(error['input'])})"
    numeric = error["type"] in ("float_type", "int_type")
    if numeric and isinstance(error["input"], str) and len(names) > 1:
        study = STUDIES[names[0]].parameters.model_fields
        return (
            f"`{path}`: Input should be a number, without unit or quotes {given}: "
            f"{(study[names[1]].description or '').rstrip('.')}"
        )
    return f"`{path}`: {error['msg'].removeprefix('Value error, ')} {given}"


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _require_size(name: str, suite: BaseModel) -> None:
    """Refuse a suite with too many cells, before they are made."""
    content = suite.model_dump(exclude_none=True)
    axes = {"seed": len(_as_list(content.pop("seed", 1)))}
    cells = 0
    for study, grid in content.items():
        if isinstance(grid, dict):
            own = {f"{study}.{k}": len(_as_list(v)) for k, v in grid.items()}
            cells += axes["seed"] * prod(own.values())
            axes |= own
    if cells > MOST_CELLS:
        longest = max(axes, key=axes.__getitem__)
        msg = (
            f"suite {name} has {cells:,} cells ({axes[longest]:,} of `{longest}`); a "
            f"run may have {MOST_CELLS:,}, so shorten an axis, or split the suite"
        )
        raise InputError(msg)


def plugins_of(grid: Grid) -> Iterator[tuple[str, str, list[Any]]]:
    """Studies that take plug-ins, with their fields and the names in a suite."""
    for study, table in grid.items():
        field = STUDIES[study].parameters.plugin if study in STUDIES else ""
        if isinstance(table, Mapping) and field in table:
            yield study, field, _as_list(table[field])


def respelled(grid: Grid, spell: Callable[[str], str]) -> dict[str, Any]:
    """A grid with its plug-ins spelled in another way."""
    found = dict(grid)
    for study, field, texts in plugins_of(grid):
        words = [spell(each) if isinstance(each, str) else each for each in texts]
        listed = isinstance(grid[study][field], list)
        found[study] = {**grid[study], field: words if listed else words[0]}
    return found


def beside(content: Grid, folder: Path) -> dict[str, Any]:
    """Content of a suite file, with paths of plug-ins relative to its folder."""
    return respelled(content, lambda each: located(each, str(folder)))


def require_plugins(cells: Iterable[Cell]) -> None:
    """Check that all plug-ins exist before anything is computed."""
    for cell in cells:
        own = cell.parameters
        if isinstance(own, PluginParameters) and (gone := own.missing()):
            msg = (
                f"`{cell.study}.{own.plugin}`: {gone}; give FILE.py, FILE.py:NAME or "
                "the name of an installed plug-in, in a suite relative to its file"
            )
            raise InputError(msg)
