"""What a run of the league found of attitude filters, and their table.

Beside the errors stand what each filter declares, what it lacks, and the time of a row:
the least of eight parts of a run by itself. The frame finder has confirmed the world,
or the filter is refused.
"""

import re

import numpy as np

from simval.errors import PluginError
from simval.plugins import Filter, find_plugin
from simval.plugins.runs import run_filter
from simval.studies.filter import Parameters, sensors_of, told_of
from simval.studies.filter_scenarios import course, drawn

TOLD = re.compile(r" (told|tuned)$")
TIMED = 4.0  # s, of one trial, or of some at once
BATCH = 40


def own_facts(name):
    """World of a filter, what it lacks, and microseconds a row."""
    plugin = find_plugin(name, Filter)
    found = {"world": plugin.world or "", "lacks": []}
    if not plugin.magnetometer:
        found["lacks"].append("magnetometer")
    if "start" not in plugin.reads:
        found["lacks"].append("start")
    try:
        answers = _short_run(plugin)
    except PluginError:
        return found
    lacks = [word for word in ("bias", "covariance") if getattr(answers, word) is None]
    found["lacks"] += lacks
    found["microseconds"] = float(f"{1e6 * np.min(answers.seconds):.2g}")
    return found


def _short_run(plugin):
    parameters = Parameters(seconds=TIMED)
    way = course(parameters.scenario, parameters.rate, parameters.seconds)
    sensors, told = sensors_of(parameters, way), told_of(parameters, way)
    trials = BATCH if plugin.batch else 1
    given, _ = drawn(way, sensors, told, trials, np.random.default_rng(0))
    return run_filter(plugin, given, np.array([len(way.dt) - 1]), plugin.world)


def filter_table(study, own, cell):
    """Lines of Markdown: a row for each filter, by its own settings and by others."""
    scenarios = list(dict.fromkeys(s for each in study.values() for s in each))
    rows = {}
    for name in study:
        rows.setdefault(TOLD.sub("", name), {})[bool(TOLD.search(name))] = name
    kinds = [
        f"{s}, {k}" for s in scenarios for k in ("own settings", "true noise or tuned")
    ]
    head = ["filter", "world", *kinds, "µs per row", "has no"]
    lines = [head, ["---"] * len(head)]
    for base, names in rows.items():
        cells = [
            cell(study[names[told]][s]) if told in names else ""
            for s in scenarios
            for told in (False, True)
        ]
        facts = own[next(iter(names.values()))]
        time = " / ".join(
            f"{own[n]['microseconds']:g}"
            for n in names.values()
            if "microseconds" in own[n]
        )
        lines.append(
            [f"`{base}`", facts["world"], *cells, time, ", ".join(facts["lacks"])]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
