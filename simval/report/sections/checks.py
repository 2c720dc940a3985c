"""Every check against theory: counts by family, then each check, failing ones first."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from simval.change import EFFORT
from simval.judge.findings import reproduce
from simval.report.curves import PREFERRED, numeric, varying
from simval.report.notes import described
from simval.report.section import Context, Section, made
from simval.report.sections.disagreements import Key, figure_names, key_of
from simval.report.table import Column, Table
from simval.report.words import sign_of_entries, spelled
from simval.results import CellName
from simval.sweep import Run
from simval.verdict import WORST_FIRST, Answer, Verdict

MAX_ROWS = 300  # for the size of a page; the rest is counted


def section(context: Context) -> Section | None:
    """Make the section."""
    verdicts = sorted(context.verdicts, key=_rank)
    figures = figure_names(context.verdicts)
    linked = sorted({figures[k] for v in verdicts if (k := key_of(v)) in figures})
    return made(
        "checks",
        "Checks",
        tables=[_families(context), _each(context, verdicts, figures)],
        open=bool(verdicts) and verdicts[0].answer != "pass",
        alpha=context.alpha,
        linked=linked,
        found=_counted(context.judged.counts),
    )


def _counted(counts: Mapping[Answer, int]) -> str:
    """How many checks ended how."""
    told = [f"{counts[word]:,} {word}" for word in WORST_FIRST if counts.get(word)]
    return f"{', '.join(told)}." if told else ""


def _families(context: Context) -> Table:
    groups: dict[tuple[str, str, str], Counter[Answer]] = {}
    for v in context.judged.verdicts:
        key = (v.cell.study, v.row.predictor, str(v.row.check))
        groups.setdefault(key, Counter())[v.answer] += 1
    return Table(
        name="families",
        caption="Answers of each family of checks",
        columns=(
            Column("study"),
            Column("predictor"),
            Column("check"),
            Column("pass", "number"),
            Column("fail", "number"),
            Column("inconclusive", "number"),
        ),
        rows=[
            (*key, answers["pass"], answers["fail"], answers["inconclusive"])
            for key, answers in sorted(groups.items())
        ],
    )


def _each(context: Context, verdicts: list[Verdict], figures: dict[Key, str]) -> Table:
    places, folder = _places(context.run), context.folder
    rows = [
        (
            v.answer,
            spelled(v.cell.study),
            str(v.row.statistic),
            v.row.predictor,
            *places.get(v.cell, (None, None, spelled(str(v.cell)))),
            reproduce(v.cell, folder) or None,
            (v.row.value, v.row.standard_error),
            v.row.unit,
            v.row.prediction,
            v.row.remainder,
            v.sigmas if v.p_value is not None else None,
            v.p_value,
            v.limit if v.limit == v.limit else None,
            v.row.n,
            figures.get(key_of(v)) if v.answer == "fail" else None,
        )
        for v in verdicts
    ]
    return Table(
        name="verdicts",
        caption="Each check: failing ones first, then by p-value"
        + sign_of_entries(v.row.statistic for v in verdicts),
        columns=(
            Column("verdict", "answer", choice=True),
            Column("study", choice=True),
            Column("statistic"),
            Column("against", choice=True),
            Column("noise", "number", choice=True),
            Column("poses", "number", choice=True),
            Column("what else varies"),
            Column("command", "command"),
            Column("measured", "measured"),
            Column("unit", "unit"),
            Column("predicted", "number"),
            Column("allowed remainder", "number", 3),
            Column("standard errors", "number", 3),
            Column("p", "number", 2),
            Column("limit", "number", 2),
            Column("n", "number", 12),
            Column("figure", "figure"),
        ),
        rows=rows,
        shown=MAX_ROWS,
    )


def _places(run: Run) -> dict[CellName, tuple[Any, ...]]:
    """Noise and poses of each cell, and in words what else varies in its study."""
    keys = {
        study: [key for key in varying(run.of(study)) if key not in EFFORT]
        for study in {cell.study for cell in run.cells}
    }
    many = len({cell.seed for cell in run.cells}) > 1
    places = {}
    for cell in run.cells:
        numbers = {key: numeric(cell.parameters.get(key)) for key in PREFERRED}
        others = {
            key: cell.parameters.get(key)
            for key in keys[cell.study]
            if numbers.get(key) is None
        }
        words = described(cell.study, others | ({"seed": cell.seed} if many else {}))
        places[cell.named] = (*numbers.values(), words)
    return places


def _rank(verdict: Verdict) -> tuple[int, float, CellName]:
    p = verdict.p_value if verdict.p_value is not None else 1.0
    return WORST_FIRST.index(verdict.answer), p, verdict.cell
