"""Studies with their parameters, suites, scenes, statistics and predictors."""

import inspect
import json
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from docs.site.equations import ROOT
from docs.site.markdown import code, definitions, page, plain
from simval import statistics
from simval.judge import BASELINE
from simval.plugins import Calibrator, Estimator, Filter
from simval.plugins.loading import BUILTIN
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
        "a key of its table, with one value or with a list, which is an axis of the "
        "grid. Units are in the words; what has no unit is a ratio or a count. "
        "`simval list` prints the same."
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
    own = [(code(name), _algorithm(point.load())) for name, point in BUILTIN.items()]
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
        "## Built-in algorithms, compared with yours",
        "[What each of them does](../plugins.md#side-by-side).",
        definitions(own),
    )


def _algorithm(thing: Estimator | Calibrator | Filter) -> str:
    word = type(thing).__name__
    kind = f" of the class *{thing.kind}*" if getattr(thing, "kind", None) else ""
    return f"{word}{kind}, measured by [{word.lower()}](studies.md#{word.lower()})"


def statistics_page() -> str:
    """Page of the families of statistics and of the predictors."""
    families, theories = measured()
    found = [
        (
            code(f.name),
            f"{plain(_capital(f.words))}. *Unit {plain(f.unit)}, margin {_margin(f)}.* "
            + _studies(families.get(f.name, ())),
        )
        for f in FAMILIES.values()
    ]
    theory = [
        (code(value), _studies(theories.get(value, ())))
        for value in predictors().values()
    ]
    return page(
        "Statistics and predictors",
        "What a row of `results.csv` measures, and the theory that it is compared "
        "with. After each are the studies that measure it in the suite `smoke`.",
        "## Statistics",
        "A statistic is a member of a family: `bias[K_x]` is the bias of one entry. "
        "The unit is that of the family, unless a study states another. The margin is "
        "the change that counts as none where two runs do not share their noise.",
        definitions(found),
        "## Predictors",
        definitions(theory),
        "## Predictors that a study makes",
        definitions((code(name), plain(words)) for name, words in _made()),
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


def _studies(found: Collection[str]) -> str:
    return ", ".join(f"[{s}](studies.md#{s})" for s in STUDIES if s in found)


def measured() -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Studies of the smoke suite by the families and by the predictors they have."""
    families: dict[str, set[str]] = {}
    theories: dict[str, set[str]] = {}
    stored = json.loads((ROOT / BASELINE).read_text(encoding="utf-8"))
    for cell in stored["cells"].values():
        for name, (*_, beside) in cell["statistics"].items():
            statistic, _, against = name.partition(" against ")
            family = statistic.removeprefix("control ").partition("[")[0]
            families.setdefault(family, set()).add(cell["study"])
            for theory in (against, *(key.partition(" ")[2] for key in beside)):
                theories.setdefault(theory, set()).add(cell["study"])
    return families, theories
