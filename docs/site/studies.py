"""Studies with their parameters, suites, scenes, statistics and predictors."""

import ast
import inspect
import json
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from docs.site.equations import ROOT
from docs.site.markdown import code, definitions, page, plain, table
from simval import statistics
from simval.plugins.builtin import BUILTIN
from simval.scene import scenes
from simval.statistics import FAMILIES
from simval.studies import STUDIES, Study
from simval.sweep import load_suite
from simval.sweep.suite import builtin_suites

_TYPES = {
    "integer": "whole number", "number": "number", "string": "text",
    "boolean": "true or false", "null": "nothing",
}  # fmt: skip
_LIMITS = (
    ("minimum", "at least"), ("exclusiveMinimum", "above"),
    ("maximum", "at most"), ("exclusiveMaximum", "below"),
)  # fmt: skip


def studies_page() -> str:
    """Page of all studies."""
    lead = (
        "A suite is a TOML file with a table for each study; every parameter below is "
        "a key of its table, alone or as a list, which is an axis of the grid. Units "
        "stand in the words; 1 is a ratio. `simval list` prints the same."
    )
    return page("Studies and their parameters", lead, *map(_study, STUDIES.values()))


def _study(study: Study) -> str:
    module = inspect.getmodule(study.run)
    words = inspect.getdoc(module) or ""
    about = words.partition("\n\n")[0].partition(": ")[2] or words.partition("\n")[0]
    return "\n\n".join(
        (
            f"## {study.name}",
            f"**{plain(study.title)}**",
            plain(_capital(about)),
            definitions(_parameters(study)),
        )
    )


def _parameters(study: Study) -> Iterator[tuple[str, str]]:
    schema = study.parameters.model_json_schema()
    for key, entry in schema["properties"].items():
        kind = kind_of(entry, schema.get("$defs", {}))
        default = f"default `{json.dumps(entry['default'])}`"
        yield code(key), f"{plain(entry['description'])} *{_capital(kind)}; {default}.*"


def kind_of(entry: Mapping[str, Any], defs: Mapping[str, Any]) -> str:
    """Type and limits of a JSON Schema entry, in words."""
    if "$ref" in entry:
        return kind_of(defs[entry["$ref"].rpartition("/")[2]], defs)
    if "anyOf" in entry:
        return " or ".join(kind_of(choice, defs) for choice in entry["anyOf"])
    if "const" in entry:
        return code(entry["const"])
    if "enum" in entry:
        return "one of " + ", ".join(map(code, entry["enum"]))
    limits = [f"{words} {entry[key]:g}" for key, words in _LIMITS if key in entry]
    return ", ".join([_TYPES[entry["type"]], *limits])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def suites_page() -> str:
    """Page of suites, scenes and the algorithms that suites may name."""
    suites = [(name, load_suite(name)) for name in builtin_suites()]
    listed = [
        (code(name), f"{plain(suite.title)} ({len(suite.cells)} cells)")
        for name, suite in suites
    ]
    seen = [(code(s.name), plain(s.summary)) for s in scenes().values()]
    own = [(code(name), f"`{point.value}`") for name, point in BUILTIN.items()]
    return page(
        "Suites, scenes and algorithms",
        "## Keys of a suite",
        definitions(
            (
                ("`title`", "One line for people."),
                ("`seed`", "A whole number, or a list: the whole grid for each."),
                (
                    "`[STUDY]`",
                    "A table for each [study](studies.md), with its parameters.",
                ),
            )
        ),
        "## Suites that are shipped",
        definitions(listed),
        "## Scenes",
        definitions(seen),
        "## Algorithms of its own, measured beside yours",
        definitions(own),
    )


def statistics_page() -> str:
    """Page of the families of statistics and of the predictors."""
    used = uses()
    names = {id(f): name for name, f in vars(statistics).items()}
    rows = [
        [
            code(f.name),
            plain(f.words),
            plain(f.unit),
            _margin(f),
            _studies(used, names[id(f)]),
        ]
        for f in FAMILIES.values()
    ]
    theory = [[code(v), _studies(used, name)] for name, v in predictors().items()]
    made = [[code(name), plain(words)] for name, words in _made()]
    return page(
        "Statistics and predictors",
        "What a row of `results.csv` measures, and the theory it is set beside.",
        "## Statistics",
        "A statistic is a member of a family: `bias[K_x]` is the bias of one entry. "
        "The unit is that of the family, unless a study states another. The margin is "
        "the change that counts as none where two runs do not share their noise "
        "([decision 0068](../decisions/0068-one-place-decides-a-change.md)).",
        table(("name", "what", "unit", "margin", "studies"), rows),
        "## Predictors",
        table(("name", "studies"), theory),
        "Some are made where a study needs them:",
        table(("name", "what"), made),
    )


def _margin(family: statistics.Family) -> str:
    of = {
        "value": "",
        "variances": " of the variances",
        "sample": " of one sample's spread",
    }
    return f"{100 * family.margin:g} %{of[family.scale]}"


def predictors() -> dict[str, str]:
    """Predictors by the names of their constants."""
    return {
        name: value
        for name, value in vars(statistics).items()
        if name.isupper() and isinstance(value, str)
    }


def _made() -> Iterator[tuple[str, str]]:
    made = {
        statistics.class_of: statistics.class_of("KIND"),
        statistics.claim_of: statistics.claim_of("ORDER"),
        statistics.order: statistics.order(0).replace("0", "N"),
    }
    return ((name, inspect.getdoc(make) or "") for make, name in made.items())


def _studies(used: Mapping[str, set[str]], name: str) -> str:
    found = [study for study in STUDIES if name in used[study]]
    return ", ".join(f"[{study}](studies.md#{study})" for study in found) or "—"


@cache
def uses() -> dict[str, set[str]]:
    """Names of `simval.statistics` that each study's modules import."""
    return {study: _imported(f"simval.studies.{study}", set()) for study in STUDIES}


def _imported(module: str, seen: set[str]) -> set[str]:
    path = ROOT / (module.replace(".", "/") + ".py")
    if module in seen or not path.exists():
        return set()
    seen.add(module)
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or node.module is None:
            continue
        if node.module == "simval.statistics":
            found |= {alias.name for alias in node.names}
        if node.module.startswith("simval.studies"):
            found |= _imported(node.module, seen)
    return found
