"""What runs of the league found: `facts.json`, and the tables of `README.md`.

python facts.py RUN [RUN ...]
"""

import json
import re
import sys
import tomllib
from pathlib import Path

from filter_facts import filter_table, own_facts

from simval.judge.algorithms import over_bound
from simval.sweep import load_run

HERE = Path(__file__).parent
MARK = "<!-- made by facts.py -->"
WORDS = 100  # of a refusal
FILTER = "filter"


def _found(cell):
    """How a cell ended; of one that was measured where it fails, and how large."""
    if cell.status != "done":
        ended, _, words = cell.error.partition(": ")
        ended = ended if ended == "refused" else "crashed"
        return {"ended": ended, "words": _first(words or cell.error)}
    rows = {str(row.statistic): row.value for row in cell.rows}
    shares = {
        name.removeprefix("failures[").removesuffix("]"): value
        for name, value in rows.items()
        if name.startswith("failures[") and value > 0.0
    }
    over, found = over_bound(cell), {"ended": "measured"}
    if over is not None:
        found["over_bound"] = round(over.value, 4)
    elif "left" in rows:
        found["left"] = round(rows["left"], 4)
    if "nees" in rows:
        found["nees"] = round(rows["nees"], 3)
    return found | ({"fails": shares} if shares else {})


def _first(words):
    """The first words of a refusal, up to a clause."""
    line = words.strip().splitlines()[-1] if words.strip() else ""
    clause = re.split(r"; |, as it is declared", line)[0]
    return clause if len(clause) <= WORDS else f"{clause[: WORDS - 3]}..."


def facts_of(run):
    """Facts by study, algorithm and noise or scenario."""
    facts = {}
    for cell in run.cells:
        study = facts.setdefault(cell.study, {})
        own = study.setdefault(cell.parameters["algorithm"], {})
        own[_kind(cell.parameters)] = _found(cell)
    return facts


def _kind(parameters):
    return parameters.get("noise") or parameters.get("scenario") or "poses"


def versions_of(run):
    """Versions of what was measured."""
    manifest = run.manifest
    files = manifest["files"].items()
    measured = {n: v for n, v in files if not n.endswith((".py", ".json", ".md"))}
    return measured | {name: manifest["versions"][name] for name in ("numpy", "scipy")}


def table(study):
    """Lines of Markdown: a row for each algorithm."""
    kinds = list(dict.fromkeys(kind for own in study.values() for kind in own))
    heads = [f"error over bound, {kind}" for kind in kinds]
    head = ["algorithm", *heads, "exact cases that fail"]
    lines = [head, ["---"] * len(head)]
    for name, own in study.items():
        cells = [_cell(own[kind]) for kind in kinds]
        lines.append([f"`{name}`", *cells, _failing(own.values())])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(found):
    if found["ended"] != "measured":
        return f"{found['ended']}: {found['words']}"
    nees = f", NEES {found['nees']}" if "nees" in found else ""
    if "over_bound" not in found:
        return f"leaves {found['left']} m/s²" if "left" in found else "no number"
    return f"{found['over_bound']}{nees}"


def _failing(found):
    worst = {}
    for each in found:
        for name, share in each.get("fails", {}).items():
            worst[name] = max(share, worst.get(name, 0.0))
    return ", ".join(f"{name} {_percent(share)} %" for name, share in worst.items())


def _percent(share):
    return f"{100 * share:.0f}" if share >= 0.1 else f"{100 * share:.2g}"


def tables(facts, filters):
    """Tables of all studies."""
    return "\n\n".join(
        filter_table(study, filters, _cell) if name == FILTER else table(study)
        for name, study in facts.items()
    )


def main():
    """Write both files; a study that no run has stays as it is."""
    place = HERE / "facts.json"
    stored = json.loads(place.read_text())
    facts, versions = stored["facts"], stored["versions"]
    fresh = {}
    for run in map(load_run, sys.argv[1:]):
        for study, found in facts_of(run).items():
            for name, own in found.items():
                fresh.setdefault(study, {}).setdefault(name, {}).update(own)
        versions |= versions_of(run)
    facts |= fresh
    filters = stored.get("filters", {})
    if FILTER in fresh:
        facts[FILTER] = _in_order(fresh[FILTER])
        filters = {name: own_facts(_place(name)) for name in facts[FILTER]}
    last = ("numpy", "scipy")
    names = sorted(set(versions) - set(last)) + list(last)
    versions = {name: versions[name] for name in names}
    text = {"versions": versions, "facts": facts, "filters": filters}
    place.write_text(json.dumps(text, indent=1) + "\n")
    page = HERE / "README.md"
    before, _, rest = page.read_text().partition(MARK)
    _, _, after = rest.partition(MARK)
    named = ", ".join(f"{name} {version}" for name, version in versions.items())
    made = f"{tables(facts, filters)}\n\nWith {named}."
    page.write_text(f"{before}{MARK}\n\n{made}\n\n{MARK}{after}")


def _in_order(found):
    """In the order of the suite."""
    suite = tomllib.loads((HERE / "filters.toml").read_text())
    return {name: found[name] for name in suite[FILTER]["algorithm"] if name in found}


def _place(name):
    return name if ":" in name and ".py" not in name else str(HERE / name)


if __name__ == "__main__":
    main()
