"""The studies: named experiments, one module each. Read this first.

A study wires the layers below it into one experiment:

    scene -> readings -> algorithm -> errors -> moments, beside theory's prediction

It is a module with four names:

- ``TITLE``: one line for people;
- ``Parameters``: a pydantic model (subclass of `StudyParameters`) of one cell's
  parameters, scalars only, each with its unit in the description and a default, and
  with ``cost()``, the expected cost of a cell;
- ``run(parameters, streams) -> Outcome``: a pure function of these parameters and
  of the cell's random streams (``streams.block(i)`` is the generator of block i).
  It returns rows (`simval.results`) of statistics (`simval.statistics`), and
  artifacts for the report;
- ``SECTION``: the section of the report that shows it, or None: then its numbers are
  drawn and tabulated along what varies.

A study that runs a user's code has a fifth, ``compute``: what ``run`` asks a child
process to do.

To add a study, write the module and put it into `_MODULES`; suites, the command line,
the gate and the report take it from there. A study never plots, prints or judges.
"""

from collections.abc import Mapping
from types import MappingProxyType

from simval.errors import InputError
from simval.studies import (
    attitude,
    attitude_efficiency,
    attitude_geometries,
    attitude_limits,
    attitude_map,
    attitude_order,
    attitude_vectors,
    calibration,
    calibrator,
    coverage,
    custom_scene,
    detector,
    end_to_end,
    estimator,
    ladder,
    scene,
    solvers,
)
from simval.studies.study import Study, StudyParameters, study_of

__all__ = ["STUDIES", "Study", "StudyParameters", "find_study"]

_MODULES = (
    scene,
    calibration,
    ladder,
    coverage,
    solvers,
    attitude,
    attitude_order,
    attitude_efficiency,
    attitude_limits,
    attitude_vectors,
    attitude_geometries,
    attitude_map,
    detector,
    end_to_end,
    estimator,
    calibrator,
    custom_scene,
)
"""In the order of the page."""

STUDIES: Mapping[str, Study] = MappingProxyType(
    {study.name: study for study in map(study_of, _MODULES)}
)


def find_study(name: str) -> Study:
    """Find a study by its name.

    Parameters
    ----------
    name : str
        A key of `STUDIES`.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    InputError
        If there is no such study; the message lists those there are.
    """
    if name not in STUDIES:
        msg = f"there is no study `{name}`; the studies are {', '.join(STUDIES)}"
        raise InputError(msg)
    return STUDIES[name]
