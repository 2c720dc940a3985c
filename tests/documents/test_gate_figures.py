"""The documented figures of the gate are the printed ones."""

import re

import pytest
from places import ROOT
from power.random_settings import SETTINGS

DOCS = ROOT / "docs"


def test_the_documented_figures_are_the_printed_ones():
    printed = (DOCS / "experiments" / "gate_rates.txt").read_text()
    seen = re.findall(r"│ (?:att|cal).*? │ ([\d.]+) +│ ([\d.]+) +│", printed)
    text = (DOCS / "gate.md").read_text()
    rows = re.findall(
        r"\| (?:attitude|calibration).*? \| ([\d.]+) % \| ([\d.]+) % \|", text
    )
    assert [(float(a), float(b)) for a, b in seen] == [
        (pytest.approx(float(a) / 100), pytest.approx(float(b) / 100)) for a, b in rows
    ]
    assert len(seen) == 9
    assert printed.count("│ 0.99   │ 1    │ 0.9905 to 1   │ 400  │") == 5


def test_the_documented_counts_are_the_printed_ones():
    text = (DOCS / "experiments" / "gate_tails.txt").read_text()
    printed = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.split("│")[1:-1]]
        if len(cells) == 7:
            study, check, runs, rows, level, expected, seen = cells
            found = printed.setdefault((study, check, int(runs)), [rows])
            found += [expected, seen] if level == "0.01" else [seen]
    page = (DOCS / "gate.md").read_text()
    table = re.findall(
        r"^\| `(\w+)` \| [\d.]+ \| (\w+) \| (\d+) \| ([\d ]+) "
        r"\| (\d+) \((.*?)\) \| (\d+) \| (\d+) \|$",
        page,
        re.M,
    )
    assert {line[0] for line in table} == set(SETTINGS)
    for study, check, runs, rows, first, expected, second, third in table:
        whole = [rows.replace(" ", ""), expected.replace("±", "+-"), first]
        assert printed[study, check, int(runs)] == [*whole, second, third]
