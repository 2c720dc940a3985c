"""The page: the sections in order, in one template."""

import re
from dataclasses import replace

from simval.errors import InputError
from simval.gate import judge_run
from simval.report.environment import template
from simval.report.panels import Drawing
from simval.report.section import Context, Section
from simval.report.sections import (
    attitude,
    budget,
    calibration,
    checks,
    closeness,
    convergence,
    disagreements,
    estimators,
    failures,
    ladder,
    numbers,
    orders,
    other,
    poses,
    provenance,
    scene,
    statics,
    statistics,
    summary,
)
from simval.report.table import Table
from simval.studies import STUDIES
from simval.sweep import Run

SHOWN = {
    "calibration": ("calibration", "rms|sd|bias|recovery"),
    "poses": ("scene", "condition"),
    "ladder": ("ladder", r"scale_bias|bias\[K.*"),
    "attitude": ("attitude", "bias|covariance"),
    "orders": ("attitude_order", "(bias|covariance)_(error|order)"),
    "closeness": ("attitude_limits", "limit_ratio|flip_rate|other_selection_rate"),
    "estimators": ("attitude_efficiency", "(simulated_)?rms_ratio"),
    "statistics": ("coverage", "coverage|nees"),
    "statics": ("detector", "precision|recall|impure|nees"),
    "budget": ("end_to_end", "budget"),
}
"""Study of a section, and which of its statistics the section draws or tabulates: a
statistic, or its name before the bracket. The others are named below it."""

SECTIONS = (
    summary.section,
    failures.section,
    disagreements.section,
    calibration.section,
    poses.section,
    ladder.section,
    attitude.section,
    orders.section,
    closeness.section,
    estimators.section,
    statistics.section,
    convergence.section,
    statics.section,
    budget.section,
    other.section,
    scene.section,
    checks.section,
    numbers.section,
    provenance.section,
)


def render(run: Run, alpha: float = 1e-3) -> str:
    """Render a run as one HTML page.

    Parameters
    ----------
    run : Run
        The run; cells that are missing or failed are shown as such.
    alpha : float, default 1e-3
        False-alarm rate that the sampling checks share.

    Returns
    -------
    str
        The page; the same run gives the same bytes.

    Raises
    ------
    InputError
        If an artifact of the run is damaged.
    """
    title = run.manifest["title"] or run.manifest["suite"]
    return template("page").render(
        title=title,
        sections=sections(run, alpha),
        version=run.manifest["versions"]["simval"],
        source=f"the run folder {run.folder.name}",
    )


def sections(run: Run, alpha: float = 1e-3) -> tuple[Section, ...]:
    """Make the sections of the page.

    Parameters
    ----------
    run : Run
        The run.
    alpha : float, default 1e-3
        False-alarm rate that the sampling checks share.

    Returns
    -------
    tuple of Section
        In the order of the page.
    """
    names = dict.fromkeys((*STUDIES, *(cell.study for cell in run.cells)))
    titles = {n: STUDIES[n].title if n in STUDIES else n for n in names}
    _require_parameters(run)
    context = Context(run=run, judged=judge_run(run, alpha=alpha), titles=titles)
    found = (make(context) for make in SECTIONS)
    return tuple(
        replace(section, elsewhere=_elsewhere(context, section.anchor))
        for section in found
        if section is not None
    )


def _elsewhere(context: Context, anchor: str) -> tuple[str, ...]:
    """Statistics of a section's study that the section does not show."""
    if anchor not in SHOWN:
        return ()
    study, shown = SHOWN[anchor]
    names: dict[str, None] = {}
    for cell in context.cells(study):
        for row in cell.rows:
            family = row.statistic.partition("[")[0]
            if not any(re.fullmatch(shown, name) for name in (row.statistic, family)):
                # where a part of a family is shown, the others by their full names
                partly = re.search(rf"\b{re.escape(family)}\\\[", shown)
                names[row.statistic if partly else family] = None
    return tuple(names)


def _require_parameters(run: Run) -> None:
    """Refuse a run whose cells lack what the sections read; extra ones do no harm."""
    for cell in run.cells:
        if cell.study in STUDIES:
            known = STUDIES[cell.study].parameters.model_fields
            lost = [name for name in known if name not in cell.parameters]
            if lost:
                msg = (
                    f"cell {cell.name} has no parameter `{lost[0]}`, which its study "
                    "has now; make the report with the version of simval that ran it"
                )
                raise InputError(msg)


def drawings(run: Run) -> tuple[Drawing, ...]:
    """Every figure of the report.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    tuple of Drawing
        Their names are unique.
    """
    return tuple(d for section in sections(run) for d in section.drawings)


def tables(run: Run) -> tuple[Table, ...]:
    """Every table of the report, whole.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    tuple of Table
        Their names are unique.
    """
    return tuple(t for section in sections(run) for t in section.tables)
