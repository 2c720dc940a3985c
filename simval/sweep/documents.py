"""The documents of a run, checked: its manifest, its times, its digests.

Extra keys are accepted; all that the gate, the comparison and the report read is
checked here, once.
"""

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simval.errors import InputError
from simval.sweep.inside import MEBIBYTE, is_inside, read_inside

MOST_TIMES = 256 * MEBIBYTE
"""Bytes of the times of a run; those of a million cells take 100 MB."""

Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]


class DamagedError(InputError):
    """Something in a run folder that is damaged, with its name."""


class _Document(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class _Git(_Document):
    commit: str | None
    dirty: bool | None


class _Machine(_Document):
    system: str
    processor: str
    kernels: list[str]
    linear_algebra: str = ""
    threads: Count = 0  # not said
    libc: str = ""


class _Environment(_Document):
    machine: _Machine
    cells: Count


class _Grid(_Document):
    seed: Annotated[list[Count], Field(min_length=1)]
    __pydantic_extra__: dict[str, dict[str, Any]]


class _Versions(_Document):
    simval: str
    __pydantic_extra__: dict[str, str]


class _Manifest(_Document):
    suite: str
    title: str
    grid: _Grid
    versions: _Versions
    git: _Git
    models: dict[str, str]
    machine: _Machine
    cells: Count
    source: str = ""
    files: dict[str, str] = Field(default_factory=dict)
    environments: list[_Environment] = Field(default_factory=list)


class _Started(_Document):
    plugins: dict[str, dict[str, str]] = {}


class _Call(_Document):
    seconds: Positive
    builtin_seconds: Positive
    ratio: Positive
    items: Positive


class _Timing(_Started):
    wall_seconds: Seconds
    cpu_seconds: Seconds
    workers: Count | str
    calls: dict[str, _Call] = {}
    started: str = ""
    committed: str | None = None


def checked_manifest(text: Any) -> dict[str, Any]:
    """Read a manifest."""
    return _checked("manifest", text, _Manifest)


def read_timing(folder: Path) -> dict[str, Any]:
    """Read the times of a run."""
    file = folder / "timing.json"
    try:
        if not is_inside(folder, file.name):
            return {}
        text = read_inside(folder, file.name, MOST_TIMES).decode()
        content = _checked("file", text, _Started)
        started = content.keys() <= {"plugins"}
        return content if started else _checked("file", text, _Timing)
    except FileNotFoundError:
        return {}
    except (DamagedError, UnicodeDecodeError) as error:
        msg = f"{file} is damaged: {error}; run the suite again, or remove the file"
        raise InputError(msg) from None


def checked_call(name: str, content: Any) -> dict[str, Any]:
    """What was timed in a cell."""
    return _required(name, content, _Call)


def checked_environment(content: Any) -> dict[str, Any]:
    """A machine with the number of its cells."""
    return _required("entry of machines", content, _Environment)


def read_json(name: str, text: Any) -> Any:
    """Read JSON that can be written again as UTF-8."""
    try:
        content = json.loads(text)
        json.dumps(content, ensure_ascii=False).encode()  # no half of a character
    except (ValueError, TypeError, RecursionError) as error:
        msg = f"{name} cannot be read as JSON ({error})"
        raise DamagedError(msg) from None
    return content


def _checked(name: str, text: Any, model: type[_Document]) -> dict[str, Any]:
    return _required(name, read_json(f"the {name}", text), model)


def _required(name: str, content: Any, model: type[_Document]) -> dict[str, Any]:
    try:
        model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(str(part) for part in first["loc"])
        where = f"`{path}` of the {name}" if path else f"the {name}"
        given = f"{first['input']!r:.60}"
        absent = first["type"] == "missing"
        words = "is missing" if absent else f"is {given}: {first['msg']}"
        msg = f"{where} {words}"
        raise DamagedError(msg) from None
    return dict(content)
