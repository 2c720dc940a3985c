"""The page: the sections in order, in one template."""

from collections.abc import Mapping
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
    geometries,
    ladder,
    numbers,
    orders,
    other,
    poses,
    provenance,
    ranges,
    scene,
    statics,
    statistics,
    summary,
    vectors,
)
from simval.report.table import Table
from simval.statistics import (
    BIAS,
    BIAS_ERROR,
    BIAS_ORDER,
    BUDGET,
    CONDITION,
    COVARIANCE,
    COVARIANCE_ERROR,
    COVARIANCE_ORDER,
    COVERAGE,
    FLIP_RATE,
    IMPURE,
    INCONSISTENT_RATE,
    LEADING_ERROR_RATIO,
    LEADING_TERM_OFF,
    LIMIT_RATIO,
    NEARER,
    NEES,
    NEXT_ORDER,
    OTHER_SELECTION_RATE,
    PRECISION,
    RECALL,
    RECOVERY,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SD,
    SIMULATED_RMS_RATIO,
    SQUARED_ERROR,
    UNIT_LENGTH,
    Family,
    Statistic,
)
from simval.studies import STUDIES
from simval.sweep import Run
from simval.verdict import ALPHA

SHOWN: Mapping[str, tuple[str, tuple[Family | Statistic, ...]]] = {
    "calibration": ("calibration", (RMS, SD, BIAS, RECOVERY)),
    "poses": ("scene", (CONDITION,)),
    "ladder": ("ladder", (SCALE_BIAS, *BIAS.each(("K_x", "K_y", "K_z")))),
    "attitude": ("attitude", (BIAS, COVARIANCE, UNIT_LENGTH)),
    "orders": (
        "attitude_order",
        (BIAS_ERROR, BIAS_ORDER, COVARIANCE_ERROR, COVARIANCE_ORDER),
    ),
    "closeness": ("attitude_limits", (LIMIT_RATIO, FLIP_RATE, OTHER_SELECTION_RATE)),
    "geometries": (
        "attitude_geometries",
        (LEADING_ERROR_RATIO, NEARER, LEADING_TERM_OFF),
    ),
    "ranges": ("attitude_map", (LIMIT_RATIO, NEXT_ORDER)),
    "vectors": (
        "attitude_vectors",
        (RMS_OVER_BOUND, SQUARED_ERROR, NEES, INCONSISTENT_RATE),
    ),
    "estimators": ("attitude_efficiency", (RMS_RATIO, SIMULATED_RMS_RATIO)),
    "statistics": ("coverage", (COVERAGE, NEES)),
    "statics": ("detector", (PRECISION, RECALL, IMPURE, NEES)),
    "budget": ("end_to_end", (BUDGET,)),
}
"""Study of a section, and which families or single statistics of it the section draws
or tabulates. The others are named below it."""

SECTIONS = (
    summary.section,
    failures.section,
    disagreements.section,
    calibration.section,
    poses.section,
    ladder.section,
    attitude.section,
    orders.section,
    geometries.section,
    closeness.section,
    ranges.section,
    vectors.section,
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


def render(run: Run, alpha: float = ALPHA) -> str:
    """Render a run as one HTML page.

    Parameters
    ----------
    run : Run
        The run; cells that are missing or failed are shown as such.
    alpha : float, default ALPHA
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


def sections(run: Run, alpha: float = ALPHA) -> tuple[Section, ...]:
    """Make the sections of the page."""
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
    partly = {each.family for each in shown if isinstance(each, Statistic)}
    names: dict[str, None] = {}
    for cell in context.cells(study):
        for row in cell.rows:
            what = row.statistic
            if what in shown or (what.family in shown and not what.controlled):
                continue
            # where a part of a family is shown, the others by their full names
            whole = what if what.family in partly else replace(what, entries=())
            names[str(whole)] = None
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
