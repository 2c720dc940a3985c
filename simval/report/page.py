"""The page: the sections in order, in one template."""

from dataclasses import replace
from types import ModuleType

from simval.errors import InputError
from simval.gate import judge_run
from simval.report.environment import template
from simval.report.notes import located
from simval.report.panels import Drawing
from simval.report.section import Context, Section, Shown
from simval.report.sections import (
    algorithms,
    attitude,
    budget,
    calibration,
    checks,
    closeness,
    convergence,
    disagreements,
    estimators,
    failures,
    filters,
    geometries,
    gyroscope,
    ladder,
    magnetometer,
    numbers,
    orders,
    other,
    overview,
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
from simval.statistics import Statistic
from simval.studies import STUDIES
from simval.sweep import Run
from simval.verdict import ALPHA

SECTIONS: tuple[ModuleType, ...] = (
    summary,
    algorithms,
    overview,
    failures,
    disagreements,
    calibration,
    poses,
    ladder,
    magnetometer,
    gyroscope,
    attitude,
    orders,
    geometries,
    closeness,
    ranges,
    vectors,
    estimators,
    statistics,
    convergence,
    statics,
    filters,
    budget,
    other,
    scene,
    checks,
    numbers,
    provenance,
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
    context = replace(context, run=located(run))
    return tuple(
        replace(section, elsewhere=_elsewhere(context, module))
        for module in SECTIONS
        if (section := module.section(context)) is not None
    )


def _elsewhere(context: Context, module: ModuleType) -> tuple[str, ...]:
    """Statistics of a section's study that the section does not show."""
    study, shown = getattr(module, "SHOWN", Shown("", ()))
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
    """Refuse a run whose cells lack parameters that the sections read."""
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
